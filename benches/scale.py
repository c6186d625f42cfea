"""What more than one process costs and brings, for docs/scale.md: a shard beside its work, two workers on two cores, many captures, captures in pieces.

PERISCOPE=target/release/periscope target/python-cluster/bin/python benches/scale.py shards    # or many, or pieces
"""

from __future__ import annotations

import json
import os
import random
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "pipelines/cluster"))

import dask_run  # noqa: E402  # where it is used from

PROGRAM = os.environ["PERISCOPE"]
PIPELINE = ROOT / "pipelines/scene.toml"
SHOTS = 400
SHARDS = 24
MANY = 20_000
REPEATS = 3


def call(*words: str | Path) -> tuple[float, str]:
    """Seconds that a command of the program takes, and what it prints."""
    begun = time.monotonic()
    done = subprocess.run([PROGRAM, *words], check=True, capture_output=True, text=True)
    return time.monotonic() - begun, done.stdout


def cpu_s() -> float:
    """Seconds of CPU that commands have taken so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def options(folder: Path, out: str, workers: int) -> dask_run.Options:
    """A job of the driver; raw traces are not kept, as in any job of this kind."""
    words = [str(PIPELINE), "--campaign", str(folder / "campaign"), "--out", str(folder / out), "--shards", str(SHARDS), "--workers", str(workers)]
    return dask_run.parse([*words, "--until", "onsets", "--set", "traces.keep=false", "--periscope", PROGRAM])


def shards(folder: Path) -> None:
    """One process for all, a process a shard, and what two workers bring."""
    scene = (ROOT / "pipelines/scenes/around-the-corner.toml").read_text()
    (folder / "scene.toml").write_text(scene.replace("shots = 200\n", f"shots = {SHOTS}\n"))
    call("simulate", folder / "scene.toml", "--out", folder / "campaign")
    keys = folder / "campaign/campaign.toml"
    keys.write_text(keys.read_text().replace("[campaign]\n", "[campaign]\npart_bytes = 1\n", 1))
    size = sum(file.stat().st_size for file in (folder / "campaign/raw").rglob("*") if file.is_file())
    cpu: dict[str, list[float]] = {"one process": [], "plan": [], "shards in a row": []}
    rows: dict[str, list[float]] = {name: [] for name in ("one process", "plan", "shards in a row", "finished shards", "two at a time", "dask 1", "dask 2")}
    for turn in range(REPEATS):
        where = ["--campaign", str(folder / "campaign"), "--until", "onsets", "--set", "traces.keep=false", "--out", str(folder / f"one-{turn}")]
        before = cpu_s()
        rows["one process"].append(call("run", PIPELINE, *where, "--threads", "1")[0])
        cpu["one process"].append(cpu_s() - before)
        for name, workers in (("shards in a row", 1), ("two at a time", 2)):
            job = options(folder, f"{name.replace(' ', '-')}-{turn}", workers)
            begun, before = time.monotonic(), cpu_s()
            planned = dask_run.plan(job)
            rows["plan"].append(time.monotonic() - begun)
            cpu["plan"].append(cpu_s() - before)
            commands = [dask_run.shard_command(job, shard)[1:] for shard in planned]
            with ThreadPoolExecutor(workers) as pool:
                begun, before = time.monotonic(), cpu_s()
                list(pool.map(lambda words: call(*words), commands))
                rows[name].append(time.monotonic() - begun)
                if workers == 1:
                    cpu[name].append(cpu_s() - before)
                begun = time.monotonic()
                list(pool.map(lambda words: call(*words), commands))
                if workers == 1:
                    rows["finished shards"].append(time.monotonic() - begun)
        for workers in (1, 2):
            job = options(folder, f"dask-{workers}-{turn}", workers)
            planned = dask_run.plan(job)
            with dask_run.client_of(job) as client:
                client.wait_for_workers(workers)
                begun = time.monotonic()
                dask_run.compute(client, job, planned)
                rows[f"dask {workers}"].append(time.monotonic() - begun)
    middle = {name: statistics.median(times) for name, times in rows.items()}
    print(f"{size / 1e6:.0f} MB of raw files, {SHARDS} shards; seconds, median of {REPEATS} (all):")
    for name, times in rows.items():
        print(f"  {name:16} {middle[name]:7.3f}  ({', '.join(f'{seconds:.3f}' for seconds in times)})")
    of_cpu = {name: statistics.median(times) for name, times in cpu.items()}
    for what, of in (("by the clock", middle), ("of CPU", of_cpu)):
        beside = of["shards in a row"] - (of["one process"] - of["plan"])
        print(f"a shard beside its work, {what}: {1000 * beside / SHARDS:.1f} ms")
    print(f"a finished shard: {1000 * middle['finished shards'] / SHARDS:.1f} ms by the clock")
    print(f"two workers: {middle['shards in a row'] / middle['two at a time']:.2f} times as fast; with Dask {middle['dask 1'] / middle['dask 2']:.2f} times")


def many(folder: Path) -> None:
    """Plans of many small captures."""
    raw = folder / "many/raw"
    raw.mkdir(parents=True)
    rule = "[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n"
    (folder / "many/campaign.toml").write_text(f"[campaign]\nname = 'many'\npart_bytes = 1000000\n[sensors.s1]\n{rule}")
    head = "{'descr': '<i2', 'fortran_order': False, 'shape': (4, 250), }"
    head += " " * (118 - len(head) - 1) + "\n"
    content = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + bytes(2000)
    for number in range(MANY):
        (raw / f"L{number // 150 + 1}_P{number % 150 + 200}.npy").write_bytes(content)
    pipeline = folder / "average.toml"
    pipeline.write_text("[traces]\nstage = 'ingest'\nkeep = false\n[profiles]\nstage = 'average'\nfrom = 'traces'\n")
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    used = cpu_s()
    seconds, _ = call("plan", pipeline, "--campaign", folder / "many", "--out", folder / "out", "--shards", "100")
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    bytes_of_shards = sum(file.stat().st_size for file in (folder / "out/.shelf/shards").iterdir())
    each = f"at most {max(before, memory) / 1024:.0f} MiB, {bytes_of_shards / MANY:.0f} bytes a capture in the shards"
    print(f"plan of {MANY} captures: {seconds:.2f} s, {cpu_s() - used:.2f} s of CPU, {each}")


def pieces(folder: Path) -> None:
    """One capture in pieces: long records without jitter, and short ones with a reference channel."""
    (folder / "arrays/raw").mkdir(parents=True)
    rule = "[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n"
    (folder / "arrays/campaign.toml").write_text(f"[campaign]\nname = 'arrays'\n[sensors.s1]\n{rule}")
    head = "{'descr': '<i2', 'fortran_order': False, 'shape': (60000, 10000), }"
    head += " " * (118 - len(head) - 1) + "\n"
    dice = random.Random(1)  # noqa: S311  # noise, no secret
    light = range(5000, 5100)
    shots = [b"".join((dice.randrange(-6, 7) + 900 * (n in light)).to_bytes(2, "little", signed=True) for n in range(10_000)) for _ in range(50)]
    with (folder / "arrays/raw/L1_P1.npy").open("wb") as file:
        file.write(b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode())
        file.writelines(dice.choice(shots) for _ in range(60_000))
    (folder / "arrays.toml").write_text("[traces]\nstage = 'ingest'\n[profiles]\nstage = 'average'\nfrom = 'traces'\n")
    scene = (ROOT / "pipelines/scenes/around-the-corner.toml").read_text()
    (folder / "scene.toml").write_text(scene.replace("\nshots = 200\n", "\nshots = 100000\nlit = [2]\nseen = [3]\n"))
    call("simulate", folder / "scene.toml", "--out", folder / "sequence")
    (folder / "sequence.toml").write_text(PIPELINE.read_text().split("[anchors]")[0])
    for name, part_bytes in (("arrays", 16_000_000), ("sequence", 4_000_000)):
        keys = folder / name / "campaign.toml"
        keys.write_text(keys.read_text().replace("[campaign]\n", f"[campaign]\npart_bytes = {part_bytes}\n", 1))
        size = sum(file.stat().st_size for file in (folder / name / "raw").rglob("*") if file.is_file())
        cpu: dict[str, list[float]] = {"one process": [], "plan": [], "piece": [], "gather": []}
        state = 0.0
        for turn in range(REPEATS):
            out = folder / f"{name}-{turn}"
            where: list[str | Path] = [folder / f"{name}.toml", "--campaign", folder / name, "--set", "traces.keep=false", "--out"]
            before = cpu_s()
            call("run", *where, folder / f"one-{name}-{turn}", "--threads", "1")
            cpu["one process"].append(cpu_s() - before)
            before = cpu_s()
            lines = json.loads(call("plan", *where, out, "--shards", str(SHARDS), "--format", "json")[1])
            cpu["plan"].append(cpu_s() - before)
            before = cpu_s()
            for line in lines:
                call("run-shard", line["key"], "--out", out, "--threads", "1")
            cpu["piece"].append((cpu_s() - before) / len(lines))
            state = statistics.mean(file.stat().st_size for file in (out / ".shelf/shards").glob("*.subtotals.parquet"))
            before = cpu_s()
            call("gather", "--out", out, "--threads", "1")
            cpu["gather"].append(cpu_s() - before)
        middle = {what: statistics.median(times) for what, times in cpu.items()}
        print(f"{name}: {size / 1e6:.0f} MB in {len(lines)} pieces; seconds of CPU, median of {REPEATS} (all):")
        for what, times in cpu.items():
            print(f"  {what:12} {middle[what]:7.4f}  ({', '.join(f'{seconds:.4f}' for seconds in times)})")
        work = (middle["one process"] - middle["plan"]) / len(lines)
        beside, joining = middle["piece"] - work, middle["gather"] / len(lines)
        print(f"  a piece beside its work: {1000 * beside:.1f} ms; it leaves {state / 1e3:.0f} kB; to gather: {1000 * joining:.1f} ms a piece")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        {"shards": shards, "many": many, "pieces": pieces}[sys.argv[1]](Path(temporary))
