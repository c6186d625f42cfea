#!/usr/bin/env python3
"""Times `periscope run pipelines/average.toml` beside a tuned NumPy program on the same data, in turn, and compares their onsets.

usage: average_job.py INPUT PEERS PERISCOPE WORK [RUNS]
INPUT: folder with raw.npy (groups x repeats x samples, int16), impulse.npy, params.json; PEERS: folder with bench_numpy_tuned.py.
Needs numpy, pyarrow, scipy. Wall, CPU and peak memory are those of the whole process (wait4). MB = 1e6 bytes of raw samples.
"""
import glob, json, os, shutil, statistics, subprocess, sys, time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

inp, peers, binary, work = (os.path.abspath(arg) for arg in sys.argv[1:5])
runs = int(sys.argv[5]) if len(sys.argv) > 5 else 5
p = json.load(open(f"{inp}/params.json"))
G, R, L = p["groups"], p["repeats"], p["samples"]
mb = G * R * L * 2 / 1e6
here = os.path.dirname(os.path.abspath(__file__))
pipeline = os.path.join(here, "..", "pipelines", "average.toml")


def campaign(folder):
    """One .npy file a capture, and the response as a calibration to import."""
    if os.path.exists(f"{folder}/campaign.toml"):
        return
    os.makedirs(f"{folder}/raw")
    offset = np.load(f"{inp}/raw.npy", mmap_mode="r").offset
    for g in range(G):
        shots = np.fromfile(f"{inp}/raw.npy", "<i2", count=R * L, offset=offset + g * R * L * 2).reshape(R, L)
        np.save(f"{folder}/raw/L{g + 1}_P1.npy", shots)
    open(f"{folder}/campaign.toml", "w").write(
        '[campaign]\nname = "average"\n[sensors.s1]\n[[captures]]\nrole = "scene"\nfiles = "raw/L{lit}_P{seen}.npy"\n'
        'segments = "shot"\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 1.0\noffset_v = 0.0\n'
    )
    h = np.load(f"{inp}/impulse.npy")
    row = dict(campaign=["average"], sensor=["s1"], shots=[0], rejected=[0], step_ps=[50.0], response_t0_ps=[0.0], latency_ps=[0.0], latency_sd_ps=[0.0], width_ps=[0.0])
    table = pa.table({**row, "response": pa.array([h.astype("f4")], pa.list_(pa.float32()))})
    pq.write_table(table, f"{work}/calibration.parquet")


def once(cmd, cwd):
    start = time.perf_counter()
    child = subprocess.Popen(cmd, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    err = child.stderr.read().decode()
    _, status, usage = os.wait4(child.pid, 0)
    wall = time.perf_counter() - start
    if status:
        raise SystemExit(f"{cmd} failed:\n{err}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


folder = f"{work}/campaign"
campaign(folder)
out = f"{work}/out"
run = [binary, "run", pipeline, "--campaign", "campaign", "--out", out, "--progress", "none"]


def ours(notes):
    """A run that computes all tables; `notes`: the content hashes that an earlier run noted, or none for a first run, which hashes all files."""
    kept = f"{work}/notes"
    shutil.rmtree(kept, ignore_errors=True)
    if notes:
        shutil.copytree(f"{out}/.shelf/notes", kept)
    shutil.rmtree(out, ignore_errors=True)
    if notes:
        os.makedirs(f"{out}/.shelf")
        shutil.copytree(kept, f"{out}/.shelf/notes")
    return once(run, work)


def numpy_tuned():
    shutil.rmtree(f"{work}/numpy", ignore_errors=True)
    os.makedirs(f"{work}/numpy")
    return once([sys.executable, f"{peers}/bench_numpy_tuned.py", os.path.abspath(inp), os.path.abspath(f"{work}/numpy"), "2"], peers)


with open(f"{inp}/raw.npy", "rb") as raw:  # warm pages, in small pieces
    while raw.read(1 << 20):
        pass
jobs = {"numpy tuned, 2 threads": numpy_tuned, "periscope, first run (hashes)": lambda: ours(False), "periscope, hashes known": lambda: ours(True)}
results = {name: [] for name in jobs}
for turn in range(runs + 1):  # turn 0 warms up
    for name, job in jobs.items():
        result = job()
        if turn:
            results[name].append(result)
base = [wall for wall, _, _ in results["numpy tuned, 2 threads"]]
print(f"{mb:.0f} MB, {G} captures of {R} shots of {L} samples, {runs} runs in turn\n")
print("| job | wall s (min, median, max) | MB/s (median) | CPU s | peak MiB | rate over numpy (paired: min, median, max) |\n|---|---|---|---|---|---|")
for name, result in results.items():
    wall, cpu, rss = zip(*result)
    ratio = [b / w for b, w in zip(base, wall)]
    med = statistics.median
    print(f"| {name} | {min(wall):.3f}, {med(wall):.3f}, {max(wall):.3f} | {mb / med(wall):.0f} | {med(cpu):.2f} | {max(rss):.0f} | {min(ratio):.2f}, {med(ratio):.2f}, {max(ratio):.2f} |")
mine = pa.concat_tables([pq.read_table(f) for f in sorted(glob.glob(f"{out}/onsets/*.parquet"))]).sort_by("lit")
reference = np.load(f"{work}/numpy/onsets.npy")
samples = mine["time_ps"].to_numpy() / 50.0
assert len(samples) == len(reference), (len(samples), len(reference))
print(f"\nonsets: {len(samples)}, largest difference {np.abs(samples - reference).max():.2e} sample")
