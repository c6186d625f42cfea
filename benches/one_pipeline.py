"""The pipeline `scene` beside the special ones, over simulated campaigns of scope files; for docs/one-pipeline.md.

    python benches/one_pipeline.py PERISCOPE SEEDS [SCENE ...]

Needs NumPy and Polars. Each scene is simulated for each seed, solved by both pipelines from its files, and compared with
the truth: patches that were not found, patches that the scene does not have, rms errors beside the stated standard
deviations, chi-square per degree of freedom. Where nothing fixes the frame, a rotation (or reflection) about the laser
by the visible patches comes first.
"""

import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
import polars as pl

SCENES = Path(__file__).resolve().parent.parent / "pipelines" / "scenes"
# Scene, special pipeline, its table of positions.
CASES = [
    ("tiny", "all-visible", "patches"),
    ("all-visible", "all-visible", "patches"),
    ("photodiode", "all-visible", "patches"),
    ("no-reference", "all-visible", "patches"),
    ("dome", "all-visible", "patches"),
    ("flatland", "all-visible", "patches"),
    ("paper-mirror", "mirror", "patches"),
    ("barcode", "barcode", "patches"),
]
# A hidden patch nearer to a true one than this is it.
NEAR_M = 0.03


def table(results: Path, view: str) -> pl.DataFrame:
    files = sorted((results / view).rglob("*.parquet"))
    return pl.concat([pl.read_parquet(file) for file in files]) if files else pl.DataFrame()


def places(rows: pl.DataFrame) -> np.ndarray:
    return rows.select("x_m", "y_m", "z_m").to_numpy()


def solve(program: str, pipeline: str, campaign: Path, results: Path) -> tuple[int, float]:
    start = time.perf_counter()
    command = [program, "run", pipeline, "--campaign", str(campaign), "--out", str(results)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        print(done.stderr[-600:], file=sys.stderr)
    return done.returncode, time.perf_counter() - start


def compare(campaign: Path, results: Path, view: str) -> dict:
    truth = table(campaign / "truth", "patches") if (campaign / "truth/patches").is_dir() else pl.read_parquet(
        campaign / "truth/patches.parquet"
    )
    rows = table(results, view)
    if rows.is_empty():
        return {"missed": len(truth), "extra": 0}
    rows = rows.filter(pl.col("alternative") == 0)
    declared = tomllib.loads((campaign / "campaign.toml").read_text()).get("patches", {}).values()
    is_fixed = any("position_m" in patch or "ray" in patch for patch in declared)
    seen = rows.filter(pl.col("kind") != "hidden").join(truth, on="patch", suffix="_true")
    own, true = places(seen), seen.select("x_m_true", "y_m_true", "z_m_true").to_numpy()
    turn = np.eye(3)
    if not is_fixed and len(seen):
        u, _, vt = np.linalg.svd(own.T @ true)
        turn = u @ vt
    errors = np.linalg.norm(own @ turn - true, axis=1)
    sds = seen["sd_m"].to_numpy().astype(float)
    hidden = rows.filter(pl.col("kind") == "hidden")
    open_ = [row for row in truth.iter_rows(named=True) if row["patch"] not in set(seen["patch"])]
    found, hidden_sds, extra = [], [], 0
    for at, sd in zip(places(hidden) @ turn, hidden["sd_m"].to_list()):
        gaps = [np.linalg.norm(at - np.array([row["x_m"], row["y_m"], row["z_m"]])) for row in open_]
        if gaps and min(gaps) < NEAR_M:
            k = int(np.argmin(gaps))
            open_.pop(k)
            found.append(gaps[k])
            hidden_sds.append(sd)
        else:
            extra += 1
    fits = table(results, f"{view}.fits")
    chi2 = float(fits["chi2"][0] / fits["degrees_of_freedom"][0]) if len(fits) and fits["degrees_of_freedom"][0] else None
    rms = lambda values: float(np.sqrt(np.mean(np.square(values)))) if len(values) else None
    return {
        "missed": len(open_), "extra": extra, "visible_mm": rms(errors), "visible_sd_mm": rms(sds),
        "hidden_mm": rms(found), "hidden_sd_mm": rms(hidden_sds), "hidden": len(found), "chi2": chi2,
    }


def show(value: float | None, factor: float = 1.0) -> str:
    return "" if value is None else f"{factor * value:.3f}"


def main() -> None:
    program, seeds, only = sys.argv[1], int(sys.argv[2]), sys.argv[3:]
    print("| scene | seed | pipeline | missed | extra | visible rms, mm | its sd | hidden rms, mm | its sd | chi2/dof | exit | s |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    for scene, special, view in CASES:
        if only and scene not in only:
            continue
        for seed in range(1, seeds + 1):
            with tempfile.TemporaryDirectory() as folder:
                campaign = Path(folder) / "campaign"
                subprocess.run([program, "simulate", str(SCENES / f"{scene}.toml"), "--seed", str(seed), "--out", str(campaign)], check=True, capture_output=True)
                for pipeline, at in [(special, view), ("scene", "patches")]:
                    results = Path(folder) / pipeline
                    code, seconds = solve(program, pipeline, campaign, results)
                    r = compare(campaign, results, at)
                    cells = [scene, seed, pipeline, r["missed"], r["extra"]]
                    cells += [show(r.get(key), 1e3) for key in ("visible_mm", "visible_sd_mm", "hidden_mm", "hidden_sd_mm")]
                    cells += [show(r.get("chi2")), code, f"{seconds:.1f}"]
                    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


main()
