"""Raw codes to volts: every sample of one capture's exposures, as recorded, at its time after the trigger.

Needs the table `traces`, and the campaign folder where that is an index: then the samples come from the raw files. Formats that
are text, or packed, need `codes = "zstd"` under [traces].

    python volts.py RESULTS [LIT SEEN] [CAMPAIGN]
"""

import os
import sys

import polars as pl

TYPES = {"i8": pl.Int8, "u8": pl.UInt8, "i16": pl.Int16, "u16": pl.UInt16, "i32": pl.Int32, "u32": pl.UInt32, "f32": pl.Float32, "f64": pl.Float64}


def codes(record, campaign):
    """The codes of a record, little-endian: of the table, or from the raw file that an index names."""
    if record["codes"] is not None:
        return record["codes"]
    file, start, stride = record["codes_file"], record["codes_offset_bytes"], record["codes_stride_bytes"]
    if campaign is None or start is None:
        where = "not as plain numbers" if start is None else "so give the campaign folder"
        raise ValueError(f'the samples lie in {file}, {where}; `codes = "zstd"` under [traces] archives them')
    width = int(record["code_type"][1:]) // 8
    with open(os.path.join(campaign, file), "rb") as raw:
        raw.seek(start)
        data = raw.read(stride * (record["samples"] - 1) + width)
    order = -1 if record["codes_big_endian"] else 1
    if stride > width or order < 0:
        data = b"".join(data[i : i + width][::order] for i in range(0, len(data), stride))
    return data


def answer(results="results", lit=1, seen=2, campaign=None):
    here = (pl.col("role") == "scene") & (pl.col("lit") == int(lit)) & (pl.col("seen") == int(seen))
    records = pl.read_parquet(f"{results}/traces/*.parquet").filter(here)
    records = records.with_columns(codes=pl.Series([codes(record, campaign) for record in records.to_dicts()], dtype=pl.Binary))
    pieces = []
    # A record holds `samples` codes of its own type, little-endian.
    for (code_type, samples), alike in records.group_by("code_type", "samples"):
        numbers = pl.col("codes").bin.reinterpret(dtype=pl.Array(TYPES[code_type], samples), endianness="little")
        pieces.append(alike.with_columns(code=numbers.arr.to_list().cast(pl.List(pl.Float64)), sample=pl.int_ranges("samples")))
    return (
        pl.concat(pieces)
        .explode("code", "sample")
        .select(
            "campaign", "sensor", "lit", "seen", "shot", "is_reference", pl.col("sample").cast(pl.Int32),
            time_ps=pl.col("t0_ps") + pl.col("sample") * pl.col("dt_ps"),
            volts=pl.col("gain_v") * pl.col("code") + pl.col("offset_v"),
        )
        .sort("campaign", "sensor", "shot", "is_reference", "sample")
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
