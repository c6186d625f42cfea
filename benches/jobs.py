#!/usr/bin/env python3
"""Times whole runs of periscope beside other programs on the same data, all in turn, and compares their onsets.

usage: jobs.py avg|each INPUT PEERS PERISCOPE WORK [--runs 5] [--strax PYTHON] [--dspeed PYTHON] [--limits PROGRAM] [--without-traces] [--sequences] [--cores]
INPUT: folder with raw.npy (groups x repeats x samples, int16), impulse.npy, params.json, and raw.lh5, raw_each.lh5 for dspeed; PEERS: folder with
bench_numpy_tuned.py and the like; the interpreters of --strax and --dspeed have those packages, this one numpy, scipy and pyarrow; --limits is a
program that reads and sums a file, `limits FILE`, and prints its rates; --without-traces leaves out the runs that archive as many bytes again; --sequences reads the same shots from
LeCroy sequences too, alone and with a reference channel (512 samples a shot, a pulse with noise) to which each is aligned; --cores confines runs to
one core, and adds those of a job that computes more than it reads: impulses by sparse deconvolution in place of the fixed filter.
Job avg: the shots of a capture averaged, deconvolved, timed (pipelines/average.toml). Job each: every shot for itself.
Wall, CPU and peak memory are those of the whole process (wait4). MB = 1e6 bytes of raw samples.
"""
import argparse, glob, json, os, re, shutil, statistics, struct, subprocess, sys, time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

parser = argparse.ArgumentParser(usage=__doc__)
parser.add_argument("job", choices=["avg", "each"])
for name in ("input", "peers", "periscope", "work"):
    parser.add_argument(name, type=os.path.abspath)
parser.add_argument("--runs", type=int, default=5)
for name in ("without-traces", "sequences", "cores"):
    parser.add_argument(f"--{name}", action="store_true")
for name in ("strax", "dspeed", "limits"):
    parser.add_argument(f"--{name}", type=os.path.abspath)
args = parser.parse_args()
p = json.load(open(f"{args.input}/params.json"))
G, R, L = p["groups"], p["repeats"], p["samples"]
mb = G * R * L * 2 / 1e6
here = os.path.dirname(os.path.abspath(__file__))
os.makedirs(args.work, exist_ok=True)
CAMPAIGN = """[campaign]
name = "average"
[sensors.s1]
[[captures]]
role = "scene"
files = "{files}"
dt_ps = 50.0
"""
SCALE = """segments = {segments}
t0_ps = 0.0
gain_v = 1.0
offset_v = 0.0
"""
PULSE = np.exp(-0.5 * (np.arange(-12, 13) / 2.5) ** 2)


def campaign(folder):
    """A file a capture; for job each one file, of which each shot is a capture. The response is a calibration to import."""
    if os.path.exists(f"{folder}/campaign.toml"):
        return
    os.makedirs(f"{folder}/raw")
    offset = np.load(f"{args.input}/raw.npy", mmap_mode="r").offset
    for g in range(G):
        shots = np.fromfile(f"{args.input}/raw.npy", "<i2", count=R * L, offset=offset + g * R * L * 2).reshape(R, L)
        np.save(f"{folder}/raw/L{g + 1}_P1.npy", shots)
    files, segments = ("raw/L{lit}_P1.npy", '"seen"') if args.job == "each" else ("raw/L{lit}_P{seen}.npy", '"shot"')
    open(f"{folder}/campaign.toml", "w").write((CAMPAIGN + SCALE).format(files=files, segments=segments))
    calibration("calibration")


def calibration(name, **more):
    h = np.load(f"{args.input}/impulse.npy")
    numbers = ["step_ps", "response_t0_ps", "latency_ps", "latency_sd_ps", "width_ps"]
    row = dict(campaign=["average"], sensor=["s1"], shots=[0], rejected=[0], **{name: [0.0] for name in numbers})
    row["step_ps"] = [50.0]
    table = pa.table({**row, "response": pa.array([h.astype("f4")], pa.list_(pa.float32())), **more})
    pq.write_table(table, f"{args.work}/{name}.parquet")


def sequence(file, shots):
    """Shots as a LeCroy sequence (template LECROY_2_3): descriptor, a trigger time and offset of 0 for each, codes."""
    head = bytearray(346)
    head[0:8], head[16:26] = b"WAVEDESC", b"LECROY_2_3"
    segments, samples = shots.shape
    for at, kind, value in (
        (32, "h", 1), (34, "h", 1), (36, "i", 346), (48, "i", 16 * segments), (60, "i", 2 * shots.size), (116, "i", shots.size), (128, "i", shots.size - 1),
        (136, "i", 1), (144, "i", segments), (156, "f", 1.0), (164, "f", 32767.0), (168, "f", -32768.0), (172, "h", 12), (174, "h", segments),
        (176, "f", 50e-12), (328, "f", 1.0),
    ):
        struct.pack_into(f"<{kind}", head, at, value)
    head[76:83], head[196:197], head[244:245] = b"LECROYX", b"V", b"S"
    struct.pack_into("<dBBBBh", head, 296, 0.0, 0, 0, 1, 1, 2026)
    body = bytes(head) + np.stack([np.arange(segments) * 1e-3, np.zeros(segments)], 1).astype("<f8").tobytes() + shots.astype("<i2").tobytes()
    open(file, "wb").write(b"#9%09d" % len(body) + body)


def sequences():
    """The same shots as sequences, and with a reference channel."""
    rng = np.random.default_rng(1)
    for folder in ("sequences", "aligned"):
        folder = f"{args.work}/{folder}"
        if os.path.exists(f"{folder}/campaign.toml"):
            continue
        os.makedirs(f"{folder}/raw")
        rule = CAMPAIGN.format(files="raw/L{lit}_P{seen}.trc")
        if folder.endswith("aligned"):
            rule += 'reference = { files = "raw/reference_L{lit}_P{seen}.trc" }\n'
        open(f"{folder}/campaign.toml", "w").write(rule)
        for g in range(G):
            sequence(f"{folder}/raw/L{g + 1}_P1.trc", np.load(f"{args.work}/campaign/raw/L{g + 1}_P1.npy"))
            if folder.endswith("aligned"):
                pulses = rng.normal(0, 20, (R, 512))
                pulses[:, 88:113] += 4000 * PULSE
                sequence(f"{folder}/raw/reference_L{g + 1}_P1.trc", np.rint(pulses))
    calibration("aligned", reference_t0_ps=[-600.0], reference=pa.array([PULSE.astype("f4")], pa.list_(pa.float32())))
    with_reference = 'from = "traces"\nwith = { calibration = "calibration" }'
    plain = open(f"{args.work}/plain.toml").read()
    aligned = plain.replace('"calibration.parquet"', '"aligned.parquet"').replace('from = "traces"', with_reference)
    open(f"{args.work}/aligned.toml", "w").write(aligned)


def written(folder):
    """Bytes of all files below a folder over those of the raw samples; a file with several names counts once."""
    files = [os.lstat(os.path.join(root, name)) for root, _, names in os.walk(folder) for name in names]
    return sum({file.st_ino: file.st_size for file in files}.values()) / (mb * 1e6)


def once(command, cwd, cores=None):
    """Wall s, CPU s and peak MiB of a process that may use these cores, else all."""
    confine = (lambda: os.sched_setaffinity(0, cores)) if cores else None
    start = time.perf_counter()
    child = subprocess.Popen(command, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, preexec_fn=confine)
    err = child.stderr.read().decode()
    _, status, usage = os.wait4(child.pid, 0)
    wall = time.perf_counter() - start
    if status:
        raise SystemExit(f"{command} failed:\n{err}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


out = f"{args.work}/out"
changes = 0
text = open(os.path.join(here, "..", "pipelines", "average.toml")).read()
if args.job == "each":  # the others keep onsets only
    for stage in ("average", "deconvolve"):
        text = text.replace(f'stage = "{stage}"', f'stage = "{stage}"\nkeep = false')
for name, keep in (
    ("plain", "keep = false"),
    ("index", "keep = true"),
    ("kept", 'keep = true\nparams = { codes = "zstd" }'),
    ("open", 'keep = true\nparams = { codes = "none" }'),
):
    open(f"{args.work}/{name}.toml", "w").write(text.replace("keep = false", keep))
text, filters = re.subn(r'params = \{ method = "wiener".*', 'params = { method = "sparse" }', text)
text, edges = re.subn(r'params = \{ method = "leading-edge".*', 'params = { method = "impulses" }', text)
assert filters == edges == 1
open(f"{args.work}/sparse.toml", "w").write(text)


def ours(pipeline="plain", notes=True, threads=None, campaign="campaign", cores=None):
    """A run that computes all tables; with the content hashes that an earlier run noted, or as a first run, which hashes all files."""
    kept = f"{args.work}/notes"
    shutil.rmtree(kept, ignore_errors=True)
    if notes:
        shutil.copytree(f"{out}/.shelf/notes", kept)
    shutil.rmtree(out, ignore_errors=True)
    if notes:
        os.makedirs(f"{out}/.shelf")
        shutil.copytree(kept, f"{out}/.shelf/notes")
    command = [args.periscope, "run", f"{pipeline}.toml", "--campaign", campaign, "--out", out, "--progress", "none"]
    return once(command + (["--threads", str(threads)] if threads else []), args.work, cores) + (written(out),)


def again(pipeline):
    """The averages and what follows, made anew in a result folder that has the traces, or else the hashes of the raw files."""
    global changes
    changes += 1
    command = [args.periscope, "run", f"{pipeline}.toml", "--campaign", "campaign", "--out", out, "--progress", "none"]
    return once(command + ["--set", f"profiles.recovery_ps={1000 + changes}"], args.work) + (written(out),)


def peer(name, python, script, *extra):
    folder = f"{args.work}/{name}"
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    return once([python, f"{args.peers}/{script}", args.input, folder, *extra], args.peers) + (written(folder),)


campaign(f"{args.work}/campaign")
with open(f"{args.input}/raw.npy", "rb") as raw:  # warm pages, in small pieces
    while raw.read(1 << 20):
        pass
each = "each_" if args.job == "each" else ""
tuned = "bench_each_numpy.py" if each else "bench_numpy_tuned.py"
jobs = {"numpy tuned, 2 threads": lambda: peer("numpy", sys.executable, tuned, "2")}
if args.sequences:
    sequences()
    jobs["periscope, sequences, first run (hashes)"] = lambda: ours(notes=False, campaign="sequences")
    jobs["periscope, sequences, hashes known"] = lambda: ours(campaign="sequences")
    jobs["periscope, sequences and reference channel, first run (hashes)"] = lambda: ours("aligned", notes=False, campaign="aligned")
    jobs["periscope, sequences and reference channel, hashes known"] = lambda: ours("aligned", campaign="aligned")
jobs |= {
    "periscope, first run (hashes)": lambda: ours(notes=False),
    "periscope, hashes known": ours,
    "periscope, hashes known, 1 thread": lambda: ours(threads=1),
}
if args.cores:
    jobs["periscope, sparse deconvolution, hashes known"] = lambda: ours("sparse")
    jobs["periscope, sparse deconvolution, hashes known, 1 thread"] = lambda: ours("sparse", threads=1)
    jobs["periscope, sparse deconvolution, hashes known, one core"] = lambda: ours("sparse", cores={0})
    jobs["periscope, hashes known, one core"] = lambda: ours(cores={0})
if args.job == "avg":
    jobs["periscope, analysed again from raw files"] = lambda: again("plain")
if args.job == "avg":
    jobs["periscope, first run (hashes), traces as index (default)"] = lambda: ours("index", notes=False)
    jobs["periscope, hashes known, traces as index"] = lambda: ours("index")
    jobs["periscope, analysed again beside the index"] = lambda: again("index")
if args.job == "avg" and not args.without_traces:
    jobs["periscope, hashes known, traces archived, zstd"] = lambda: ours("kept")
    jobs["periscope, analysed again from these"] = lambda: again("kept")
    jobs["periscope, hashes known, traces archived, not compressed"] = lambda: ours("open")
    jobs["periscope, analysed again from those"] = lambda: again("open")
if args.strax:
    jobs["strax, 2 workers"] = lambda: peer("strax", args.strax, f"bench_{each}strax.py", "2")
if args.dspeed:
    jobs["dspeed"] = lambda: peer("dspeed", args.dspeed, f"bench_{each}dspeed.py")
results = {name: [] for name in jobs}
loads = []
for turn in range(args.runs + 1):  # turn 0 warms up
    for name, job in jobs.items():
        loads.append(os.getloadavg()[0])
        result = job()
        if turn:
            results[name].append(result)
base = [wall for wall, *_ in results["numpy tuned, 2 threads"]]
print(f"{mb:.0f} MB, {G} captures of {R} shots of {L} samples, {args.runs} runs in turn; load average {min(loads):.1f} to {max(loads):.1f}\n")
print("| job | wall s (min, median, max) | MB/s (median) | CPU s | peak MiB | written / raw | rate over numpy (paired: min, median, max) |\n|---|---|---|---|---|---|---|")
for name, result in results.items():
    wall, cpu, rss, bytes_written = zip(*result)
    ratio = [b / w for b, w in zip(base, wall)]
    med = statistics.median
    print(f"| {name} | {min(wall):.3f}, {med(wall):.3f}, {max(wall):.3f} | {mb / med(wall):.0f} | {med(cpu):.2f} | {max(rss):.0f} | {max(bytes_written):.3f} | {min(ratio):.2f}, {med(ratio):.2f}, {max(ratio):.2f} |")
mine = pa.concat_tables([pq.read_table(f) for f in sorted(glob.glob(f"{out}/onsets/*.parquet"))]).sort_by([("lit", "ascending"), ("seen", "ascending")])
reference = np.load(f"{args.work}/numpy/onsets.npy")
samples = mine["time_ps"].to_numpy() / 50.0
print(f"\nonsets: {len(samples)} of {np.isfinite(reference).sum()}")
if len(samples) == len(reference):
    print(f"largest difference {np.nanmax(np.abs(samples - reference)):.2e} sample")
if args.limits:
    print("\n" + subprocess.run([args.limits, f"{args.input}/raw.npy"], capture_output=True, text=True, check=True).stdout)
