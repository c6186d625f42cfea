"""Campaigns from arrays: the same results as from files, and what contradicts itself is refused."""

from __future__ import annotations

import csv
import itertools
import tomllib
import warnings
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from conftest import command, gauss

import periscope

M_PER_PS = 2.99792458e-4
POINTS_M = np.array([[-0.6, -0.3, 0.8], [-0.15, 0.45, 1.1], [0.4, -0.2, 1.15], [0.62, -0.35, 0.7]])


def run(campaign: Path, pipeline: str | None = None) -> periscope.Results:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of rejected shots
        return periscope.run(campaign, pipeline, progress="none")


def onsets(results: periscope.Results) -> pl.DataFrame:
    return pl.DataFrame(results["onsets"]).sort("lit", "seen", "rank").select("lit", "seen", "time_ps", "time_sd_ps")


def test_arrays_of_shots_give_the_onsets_of_their_files(
    campaign: Path, results: periscope.Results, tmp_path: Path
) -> None:
    """With reference pulses, codes of the converter, and a time for each shot."""
    channels = {
        channel: [
            [periscope.read(campaign / f"raw/scene/s1_L{lit}_P{seen}_C{channel}.trc") for seen in range(1, 5)]
            for lit in range(1, 5)
        ]
        for channel in (1, 2)
    }
    pulse, second = (periscope.read(campaign / f"raw/response/s1_C{channel}.trc") for channel in (1, 2))
    shots = channels[1]
    assert shots[0][0][0].gain is not None and shots[0][0][0].offset is not None
    written = periscope.write_campaign(
        tmp_path / "arrays",
        np.array([[one.codes() for one in row] for row in shots]),
        dt_ps=pulse.dt_ps or 0.0,
        t0_ps=np.array([[one.t0_ps for one in row] for row in shots]),
        gain_v=shots[0][0][0].gain,
        offset_v=shots[0][0][0].offset,
        reference=np.array([[one.volts() for one in row] for row in channels[2]]),
        response=(pulse.volts() - shots[0][0][0].offset) / shots[0][0][0].gain,
        response_t0_ps=pulse.t0_ps,
        response_reference=second.volts(),
        response_path_m=1.0,
        response_path_sd_m=1e-4,
        settings={"campaign": tomllib.loads((campaign / "campaign.toml").read_text())["campaign"]},
    )
    command("check", "--campaign", written)
    ours, files = onsets(run(written, "all-visible")), onsets(results)
    assert len(ours) == len(files) == 16
    difference_ps = (ours["time_ps"] - files["time_ps"]).to_numpy()
    # The campaign of files also has fiducial captures, by which its times are freed of drift.
    assert np.abs(difference_ps / files["time_sd_ps"].to_numpy()).max() < 0.5


def flight_ps(*corners_m: np.ndarray) -> float:
    return sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(corners_m)) / M_PER_PS


def histograms(rng: np.random.Generator, dt_ps: float) -> np.ndarray:
    """Photon counts [lit, seen, bin] of first and second bounces, laser and sensor at the origin."""
    time_ps, origin = dt_ps * np.arange(700), np.zeros(3)
    counts = np.zeros((4, 4, 700), dtype=np.int64)
    for lit, seen in itertools.product(range(4), range(4)):
        over = [POINTS_M[lit]] if lit == seen else [POINTS_M[lit], POINTS_M[seen]]
        counts[lit, seen] = rng.poisson(800.0 * gauss(time_ps - flight_ps(origin, *over, origin), 40.0) + 0.5)
    return counts


def test_photon_counts_find_the_patches(tmp_path: Path, rng: np.random.Generator) -> None:
    counts = histograms(rng, 16.0)
    pulse = rng.poisson(50_000 * gauss(16.0 * np.arange(60) - 1.0 / M_PER_PS + 2900.0, 40.0))
    campaign = periscope.write_campaign(
        tmp_path / "counts",
        counts,
        dt_ps=16.0,
        kind="counts",
        cycles=10_000_000,
        response=pulse,
        response_path_m=1.0,
        response_t0_ps=2900.0,
        positions_m={1: POINTS_M[0], 2: POINTS_M[1], 3: POINTS_M[2]},
        settings={"campaign": {"group_index": 1.0}, "patches": {1: {"sd_m": 0.001}}},
    )
    patches = pl.DataFrame(run(campaign).patches).filter(pl.col("alternative") == 0).sort("patch")
    points_m = patches.select("x_m", "y_m", "z_m").to_numpy()
    assert np.abs(points_m - POINTS_M).max() < 0.003
    profile = pl.DataFrame(periscope.run(campaign, until="profiles", progress="none")["profiles"])
    row = profile.filter((pl.col("lit") == 2) & (pl.col("seen") == 3) & (pl.col("role") == "scene"))
    np.testing.assert_array_equal(row["counts"][0].to_numpy(), counts[1, 2])


def test_pairs_have_their_own_numbers_times_and_shots(tmp_path: Path, rng: np.random.Generator) -> None:
    """A mapping as an array with gaps: pairs that were not captured are in no table."""
    pulse = gauss(50.0 * np.arange(64) - 1.0 / M_PER_PS + 1800.0, 120.0)
    shots = pulse + rng.normal(0.0, 1e-3, (2, 3, 20, 64))
    shots[0, 1] = np.nan
    starts_ps = 50.0 * np.arange(6.0).reshape(2, 3)
    lit, seen = [7, 2], [7, 5, 9]
    periscope.write_campaign(tmp_path / "array", shots, dt_ps=50.0, t0_ps=starts_ps, lit=lit, seen=seen)
    places = [(i, k) for i, k in itertools.product(range(2), range(3)) if (i, k) != (0, 1)]
    mapping = periscope.write_campaign(
        tmp_path / "mapping",
        {(lit[i], seen[k]): shots[i, k] for i, k in places},
        dt_ps=50.0,
        t0_ps={(lit[i], seen[k]): starts_ps[i, k] for i, k in places},
        response=pulse + rng.normal(0.0, 1e-3, (50, 64)),
        response_path_m=1.0,
        response_t0_ps=np.full(50, 1800.0),
    )
    tables = [(tmp_path / name / "scene.csv").read_text() for name in ("array", "mapping")]
    assert tables[0] == tables[1]
    rows = list(csv.DictReader(tables[0].splitlines()))
    assert [(row["lit"], row["seen"], float(row["t0_ps"])) for row in rows] == [
        ("7", "7", 0.0), ("7", "9", 100.0), ("2", "7", 150.0), ("2", "5", 200.0), ("2", "9", 250.0)
    ]  # fmt: skip
    profiles = pl.DataFrame(periscope.run(mapping, "all-visible", until="profiles", progress="none")["profiles"])
    profiles = profiles.filter(pl.col("role") == "scene")
    assert set(profiles["shots"]) == {20} and len(profiles) == 5
    assert sorted(profiles["t0_ps"]) == pytest.approx([0.0, 100.0, 150.0, 200.0, 250.0])


def test_what_is_written_stands_in_campaign_toml(tmp_path: Path) -> None:
    written = periscope.write_campaign(
        tmp_path / "a b",
        {(1, 2): np.ones((3, 8), dtype=np.int16)},
        dt_ps=np.float64(50.0),
        laser_m=[0.0, 0.0, 1.0],
        sensor_m=np.array([0.1, 0.0, 1.0]),
        positions_m=POINTS_M[:2],
        averaged_shots=100,
        settings={
            "campaign": {"group_index": 1.5},
            "hidden": {"count": 1},
            "patches": {2: {"normal": np.array([0.0, 0.0, 1.0])}, 3: {"role": "hidden"}},
            "exclude": [{"match": {"lit": 7}, "reason": 'a "door", ä'}],
        },
    )
    assert tomllib.loads((written / "campaign.toml").read_text()) == {
        "campaign": {"name": "a-b", "group_index": 1.5},
        "stations": {"laser": {"position_m": [0.0, 0.0, 1.0]}, "s1": {"position_m": [0.1, 0.0, 1.0]}},
        "sensors": {"s1": {"station": "s1"}},
        "patches": {
            "1": {"position_m": POINTS_M[0].tolist()},
            "2": {"position_m": POINTS_M[1].tolist(), "normal": [0.0, 0.0, 1.0]},
            "3": {"role": "hidden"},
        },
        "captures": [
            {"role": "scene", "table": "scene.csv", "dt_ps": 50.0, "gain_v": 1, "offset_v": 0, "averaged_shots": 100}
        ],
        "hidden": {"count": 1},
        "exclude": [{"match": {"lit": 7}, "reason": 'a "door", ä'}],
    }
    saved = np.load(written / "raw/scene/L1_P2.npy")
    assert saved.dtype == np.int16 and saved.shape == (3, 8)


SHOTS = np.zeros((1, 2, 3, 16))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scene": np.zeros((3, 16))}, "scene has shape"),
        ({"lit": [1, 2]}, "1 different numbers"),
        ({"seen": [3, 3]}, "2 different numbers"),
        ({"scene": {(1, 2): SHOTS[0, 0]}, "lit": [1]}, "names its pairs itself"),
        ({"scene": np.full((1, 1, 16), np.nan)}, "no pair with samples"),
        ({"scene": np.where(np.arange(16) == 3, np.inf, SHOTS)}, "not finite"),
        ({"t0_ps": np.zeros((2, 2))}, "axes"),
        ({"t0_ps": np.zeros((1, 2, 4))}, "one for each of 3 shots"),
        ({"t0_ps": {(1, 1): 0.0}}, r"t0_ps has no value for the pair \(1, 2\)"),
        ({"response": SHOTS[0, 0]}, "needs response_path_m"),
        ({"response": SHOTS[0, 0], "response_path_m": 1.0, "t0_ps": np.zeros((1, 2))}, "give response_t0_ps"),
        ({"response": SHOTS[0, 0], "response_path_m": 1.0, "reference": SHOTS}, "both reference"),
        ({"reference": SHOTS[:, :, :2]}, "2 of the reference"),
        ({"kind": "counts"}, "cycles"),
        ({"kind": "counts", "cycles": 9, "scene": SHOTS + 0.5}, "no numbers of photons"),
        ({"kind": "photons"}, 'give "analog" or "counts"'),
        ({"sensor_m": [0.0, 0.0, 0.0]}, "needs laser_m"),
        ({"positions_m": [[0.0, 0.0]]}, "give x, y, z"),
        ({"settings": {"hidden": {"count": np.nan}}}, "is no value of campaign.toml"),
    ],
)
def test_what_contradicts_itself_is_refused(arguments: dict[str, object], message: str, tmp_path: Path) -> None:
    given = {"scene": SHOTS, "dt_ps": 50.0} | arguments
    with pytest.raises(ValueError, match=message):
        periscope.write_campaign(tmp_path / "refused", **given)  # pyright: ignore
    assert not (tmp_path / "refused/campaign.toml").exists()


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(periscope.CampaignError, match="not empty; choose another folder"):
        periscope.write_campaign(tmp_path, SHOTS, dt_ps=50.0)
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]


def test_what_campaign_toml_may_not_say_is_an_error_at_once(tmp_path: Path) -> None:
    with pytest.raises(periscope.CampaignError, match="path_m must be above 0"):
        periscope.write_campaign(tmp_path / "a", SHOTS, dt_ps=50.0, response=SHOTS[0, 0], response_path_m=0.0)
    with pytest.raises(periscope.CampaignError, match="no_such_key"):
        periscope.write_campaign(tmp_path / "b", SHOTS, dt_ps=50.0, settings={"hidden": {"no_such_key": 1}})
