"""Raw codes to volts: every sample of one capture's exposures, as recorded, at its time after the trigger.

Needs the table `traces` (keep = true).

    python volts.py RESULTS [LIT SEEN]
"""

import sys

import polars as pl

TYPES = {"i8": pl.Int8, "u8": pl.UInt8, "i16": pl.Int16, "u16": pl.UInt16, "i32": pl.Int32, "u32": pl.UInt32, "f32": pl.Float32, "f64": pl.Float64}


def answer(results="results", lit=1, seen=2):
    here = (pl.col("role") == "scene") & (pl.col("lit") == int(lit)) & (pl.col("seen") == int(seen))
    records = pl.read_parquet(f"{results}/traces/*.parquet").filter(here)
    pieces = []
    # A record holds `samples` codes of its own type, little-endian.
    for (code_type, samples), alike in records.group_by("code_type", "samples"):
        codes = pl.col("codes").bin.reinterpret(dtype=pl.Array(TYPES[code_type], samples), endianness="little")
        pieces.append(alike.with_columns(code=codes.arr.to_list().cast(pl.List(pl.Float64)), sample=pl.int_ranges("samples")))
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
