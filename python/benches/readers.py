"""Reading rates of the package next to other readers of Python: files of 200 MB in the page cache, in turn: the best of several
rounds, and the median ratio of the times of a round.

    python python/benches/readers.py WORK [ROUNDS]

Makes its files in WORK (0.6 GB), from the vendors' descriptions. A reader that is not installed has no row: sdtfile, ptufile,
tm_data_types. The sums of all readers are compared.
"""

from __future__ import annotations

import importlib.util
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import periscope

BYTES = 200_000_000
BINS = 4096
CURVES = BYTES // (2 * BINS)
INFO = b"*IDENTIFICATION\r\n  ID        : SPC Setup & Data File\r\n  Title     : rates\r\n*END\r\n\r\n"


def becker_hickl(path: Path, blocks: int) -> None:
    """Curves of 4,096 bins, in one block (a page) or in a block each."""
    description = bytearray(512)
    description[0:9], description[9:20], description[117:125] = b"12:34:56\0", b"10-25-2019\0", b"SPC-150\0"
    struct.pack_into("<f", description, 64, 5e-8)
    struct.pack_into("<h", description, 68, 4)
    struct.pack_into("<H", description, 82, BINS)
    start = 42 + len(INFO)
    header = bytearray(42)
    struct.pack_into("<H", header, 0, 0x280 | 15)
    struct.pack_into("<IH", header, 2, 42, len(INFO))
    struct.pack_into("<I", header, 14, start + 512)
    struct.pack_into("<H", header, 18, blocks)
    struct.pack_into("<IHH", header, 24, start, 1, 512)
    struct.pack_into("<H", header, 32, 0x5555)
    struct.pack_into("<H", header, 40, (0x55AA - sum(struct.unpack("<21H", header))) & 0xFFFF)
    curve = np.random.default_rng(1).integers(0, 60_000, BINS, dtype=np.uint16)
    curves = [(curve + np.uint16(n)).tobytes() for n in range(7)]
    each = CURVES // blocks
    with path.open("wb") as out:
        out.write(header + INFO + description)
        for block in range(blocks):
            data, length = out.tell() + 22, each * 2 * BINS
            kind = 0x01 if each == 1 else 0x11
            out.write(struct.pack("<BBIIHHII", 0, 0, data, data + length, kind, 0, block + 1, length))
            out.writelines(curves[(block * each + n) % 7] for n in range(each))


def tektronix(path: Path) -> None:
    """One record of 8 bit codes with the checksum at its end."""
    data = np.tile(np.random.default_rng(1).integers(-100, 100, 1_000_000, dtype=np.int8), BYTES // 1_000_000)
    head = bytearray(838)

    def put(at: int, form: str, *values: float) -> None:
        struct.pack_into("<" + form, head, at, *values)

    head[0:2], head[2:10] = b"\x0f\x0f", b":WFM#003"
    put(10, "Bi", 9, 838 + data.size + 8 - 15)
    put(15, "Bi", 1, 838)
    put(76, "HiI", 838 - 78, 0, 1)
    put(110, "IIIi", 1, 1, 1, 2)
    put(166, "Hdd", 0, 0.001, 0.0)
    put(184, "I", 256)
    head[188:189] = b"V"
    put(240, "i", 7)
    put(488, "ddI", 5e-11, -1e-9, data.size)
    head[508:509] = b"s"
    put(784, "Iddi", 0, 0.25, 0.5, 1_700_000_000)
    put(808, "IihIIIII", 0, 0, 0, 0, 0, data.size, data.size, data.size)
    total = sum(head) + int(data.view(np.uint8).sum(dtype=np.uint64))
    with path.open("wb") as out:
        out.write(head)
        data.tofile(out)
        out.write(struct.pack("<Q", total))


def picoquant(path: Path) -> None:
    """An image of 50 million photons of four channels: T3 records of 4 bytes."""
    import ptufile

    rng = np.random.default_rng(1)
    counts = rng.poisson(50_000_000 / (64 * 64 * 4 * 128), (64, 64, 4, 128)).astype(np.uint16)
    ptufile.imwrite(path, counts[np.newaxis], 5e-8, 3.2e-10)


def timed(job: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = job()
    return time.perf_counter() - start, result


def total(result: Any) -> float:
    arrays = result if isinstance(result, list) else [result]
    return sum(float(np.asarray(array).sum(dtype=np.float64)) for array in arrays)


def row(path: Path, name: str, gives: str, seconds: float, ratio: str = "") -> None:
    print(f"| `{path.name}`, {path.stat().st_size / 1e6:.0f} MB | {name} | {gives} | {path.stat().st_size / seconds / 1e9:.2f} | {ratio} |")


def compare(path: Path, gives: str, ours: Callable[[], Any], others: dict[str, Callable[[], Any]], rounds: int) -> None:
    path.read_bytes()
    jobs = {"periscope": ours, **others}
    times: dict[str, list[float]] = {name: [] for name in jobs}
    sums: dict[str, float] = {}
    for _ in range(rounds):
        for name, job in jobs.items():
            seconds, result = timed(job)
            times[name].append(seconds)
            if name not in sums:
                sums[name] = total(result)
            del result
    row(path, "periscope", gives, min(times["periscope"]))
    for name in others:
        np.testing.assert_allclose(sums[name], sums["periscope"], rtol=1e-9)
        ratio = np.median(np.divide(times[name], times["periscope"]))
        row(path, name, gives, min(times[name]), f"{ratio:.1f}")


def main() -> None:
    work, rounds = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 5
    work.mkdir(parents=True, exist_ok=True)
    has = {name: importlib.util.find_spec(name) is not None for name in ("sdtfile", "ptufile", "tm_data_types")}
    print("| file | reader | gives | GB/s | periscope is faster by |\n|---|---|---|---|---|")
    if has["sdtfile"]:
        import sdtfile

        for name, blocks in [("page.sdt", 1), ("blocks.sdt", CURVES)]:
            path = work / name
            becker_hickl(path, blocks)
            others = {"sdtfile": lambda path=path: sdtfile.SdtFile(path).data}
            compare(path, "codes", lambda path=path: periscope.read(path).codes(), others, rounds)
    if has["tm_data_types"]:
        from tm_data_types import read_file

        path = work / "record.wfm"
        tektronix(path)
        others = {"tm_data_types": lambda: read_file(str(path)).normalized_vertical_values}
        compare(path, "volts", lambda: periscope.read(path).volts(), others, rounds)
    if has["ptufile"]:
        import ptufile

        path = work / "image.ptu"
        picoquant(path)
        others = {"ptufile": lambda: ptufile.PtuFile(path).decode_histogram(dtype=np.uint32)}
        compare(path, "histograms", lambda: periscope.read(path).codes(), others, rounds)


main()
