"""Reading rates of Periscope's format readers beside Python's, in turn, from the page cache.

    cargo bench --bench readers --no-run       # prints where the program is
    python benches/readers.py PROGRAM WORK [ROUNDS]

Needs numpy, lecroyscope, tm_data_types and RigolWFM. Makes its files in WORK (about 0.5 GB) by `periscope`'s own layouts, written here
a second time from the vendors' descriptions, so that a fast misreading would show: the sums of all readers are compared.
"""

import struct
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np

warnings.filterwarnings("ignore")
SAMPLES = 200_000_000


def codes(n):
    rng = np.random.default_rng(1)
    block = rng.integers(-100, 100, 1_000_000, dtype=np.int8)
    return np.tile(block, n // block.size)


def lecroy(path, data):
    head = bytearray(346)
    put = lambda at, fmt, *values: struct.pack_into("<" + fmt, head, at, *values)
    head[0:8] = b"WAVEDESC"
    head[16:26] = b"LECROY_2_3"
    put(32, "HH", 0, 1)
    put(36, "i", 346)
    put(60, "i", data.size)
    head[76:84] = b"LECROY-X"
    put(116, "iii", data.size, data.size, 0)
    put(128, "i", data.size - 1)
    put(144, "i", 1)
    put(156, "ff", 0.001, 0.0)
    put(172, "h", 8)
    put(176, "f", 5e-11)
    put(180, "d", -1e-9)
    head[196:197] = b"V"
    head[244:245] = b"S"
    put(296, "dbbbbhh", 1.0, 1, 1, 1, 1, 2026, 0)
    with open(path, "wb") as out:
        out.write(b"#9%09d" % (346 + data.size))
        out.write(head)
        data.tofile(out)


def tektronix(path, data):
    head = bytearray(838)
    put = lambda at, fmt, *values: struct.pack_into("<" + fmt, head, at, *values)
    head[0:2] = b"\x0f\x0f"
    head[2:10] = b":WFM#003"
    put(10, "B", 9)
    put(11, "i", 838 + data.size + 8 - 15)
    put(15, "B", 1)
    put(16, "i", 838)
    put(76, "H", 838 - 78)
    put(78, "i", 0)
    put(82, "I", 1)
    put(110, "I", 1)
    put(114, "II", 1, 1)
    put(122, "i", 2)
    put(166, "H", 0)
    put(168, "d", 0.001)
    put(176, "d", 0.0)
    put(184, "I", 256)
    head[188:189] = b"V"
    put(240, "i", 7)
    put(488, "d", 5e-11)
    put(496, "d", -1e-9)
    put(504, "I", data.size)
    head[508:509] = b"s"
    put(784, "Iddi", 0, 0.25, 0.5, 1_700_000_000)
    put(808, "IihIIIII", 0, 0, 0, 0, 0, data.size, data.size, data.size)
    total = sum(head) + int(data.view(np.uint8).sum(dtype=np.uint64))
    with open(path, "wb") as out:
        out.write(head)
        data.tofile(out)
        out.write(struct.pack("<Q", total))


def keysight(path, data):
    volts = (data.astype(np.float32) * np.float32(0.001))[: data.size // 4]
    head = bytearray(140)
    put = lambda at, fmt, *values: struct.pack_into("<" + fmt, head, at, *values)
    put(0, "iiiii", 140, 1, 1, volts.size, 1)
    put(20, "f", volts.size * 5e-11)
    put(24, "ddd", -1e-9, 5e-11, -1e-9)
    put(48, "ii", 2, 1)
    head[88:94] = b"MSO:X1"
    head[112:113] = b"1"
    with open(path, "wb") as out:
        out.write(b"AG10" + struct.pack("<ii", 12 + 140 + 12 + volts.nbytes, 1))
        out.write(head)
        out.write(struct.pack("<ihhi", 12, 1, 4, volts.nbytes))
        volts.tofile(out)


def best(job, rounds):
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return min(times)


def main():
    program, work = sys.argv[1], Path(sys.argv[2])
    rounds = int(sys.argv[3]) if len(sys.argv) > 3 else 5
    work.mkdir(parents=True, exist_ok=True)
    data = codes(SAMPLES)
    files = {"trc": lecroy, "wfm": tektronix, "bin": keysight}
    for kind, write in files.items():
        write(work / f"a.{kind}", data)

    def by_lecroyscope():
        import lecroyscope

        return lecroyscope.Trace(str(work / "a.trc")).voltage

    def by_tm():
        from tm_data_types import read_file

        return read_file(str(work / "a.wfm")).normalized_vertical_values

    def by_rigolwfm(kind):
        import RigolWFM.wfm as rigol

        return lambda: rigol.Wfm.from_file(str(work / f"a.{kind}")).channels[0].volts

    def by_numpy(kind):
        offset, dtype, scale = {"trc": (357, np.int8, 0.001), "wfm": (838, np.int8, 0.001), "bin": (164, np.float32, 1.0)}[kind]
        size = {"wfm": SAMPLES}.get(kind, -1)
        return lambda: np.fromfile(work / f"a.{kind}", dtype, size, offset=offset) * np.float64(scale)

    readers = {
        "trc": [("lecroyscope", by_lecroyscope), ("numpy.fromfile, no header", by_numpy("trc"))],
        "wfm": [("tm_data_types", by_tm), ("numpy.fromfile, no header", by_numpy("wfm"))],
        "bin": [("RigolWFM", by_rigolwfm("bin")), ("numpy.fromfile, no header", by_numpy("bin"))],
    }
    print("| file | reader | gives | GB/s | periscope is faster by |")
    print("|---|---|---|---|---|")
    for kind in files:
        path = work / f"a.{kind}"
        size = path.stat().st_size
        path.read_bytes()
        ours = {}
        rows = []
        for what in ["codes", "volts"]:
            out = subprocess.run([program, what, path, str(rounds)], check=True, capture_output=True, text=True)
            ours[what] = float(out.stdout)
            rows.append((f"periscope", what, ours[what]))
        for name, job in readers[kind]:
            try:
                rows.append((name, "volts", best(job, min(rounds, 3))))
            except Exception as error:  # a reader that refuses the file is a row, not the end
                print(f"| {path.name} | {name} | {type(error).__name__}: {error} | | |")
        for name, what, seconds in rows:
            print(f"| {path.name}, {size / 1e6:.0f} MB | {name} | {what} | {size / seconds / 1e9:.2f} | {seconds / ours[what]:.1f} |")


main()
