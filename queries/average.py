"""The average of a capture by hand: the mean of all shots in volts, less its own first tenth (the baseline).

Equal to `profiles.mean_v` where nothing is aligned and nothing rejected: no reference channel, every shot with the same t0_ps,
`rejected` 0. Elsewhere the difference is what aligning the shots is worth. Needs the table `traces`, and the campaign folder where that
is an index; 8-bit signed codes.

    python average.py RESULTS [LIT SEEN] [CAMPAIGN]
"""

import os
import sys

import polars as pl


def codes(record, campaign):
    """The codes of a record, a byte each: of the table, or from the raw file that an index names."""
    if record["codes"] is not None:
        return record["codes"]
    file, start, stride = record["codes_file"], record["codes_offset_bytes"], record["codes_stride_bytes"]
    if campaign is None or start is None:
        where = "not as plain numbers" if start is None else "so give the campaign folder"
        raise ValueError(f'the samples lie in {file}, {where}; `codes = "zstd"` under [traces] archives them')
    with open(os.path.join(campaign, file), "rb") as raw:
        raw.seek(start)
        return raw.read(stride * record["samples"])[::stride]


def answer(results="results", lit=1, seen=2, campaign=None):
    here = (pl.col("role") == "scene") & (pl.col("lit") == int(lit)) & (pl.col("seen") == int(seen))
    sensor = ["campaign", "sensor"]
    records = pl.read_parquet(f"{results}/traces/*.parquet").filter(here, ~pl.col("is_reference"), pl.col("code_type") == "i8")
    held = pl.Series([codes(record, campaign) for record in records.to_dicts()], dtype=pl.Binary)
    numbers = held.bin.reinterpret(dtype=pl.Array(pl.Int8, records["samples"][0])).arr.to_list()
    mean = (
        records.with_columns(code=numbers.cast(pl.List(pl.Float64)), sample=pl.int_ranges("samples"))
        .explode("code", "sample")
        .group_by(*sensor, "sample")
        .agg(
            pl.col("samples").first(),
            time_ps=(pl.col("t0_ps") + pl.col("sample") * pl.col("dt_ps")).mean(),
            shots=pl.len().cast(pl.Int64),
            mean_v=(pl.col("gain_v") * pl.col("code") + pl.col("offset_v")).mean(),
        )
    )
    is_baseline = pl.col("sample") < (pl.col("samples") / 10).round()
    baseline = mean.filter(is_baseline).group_by(sensor).agg(baseline_v=pl.col("mean_v").mean())
    profile = (
        pl.read_parquet(f"{results}/profiles/*.parquet")
        .filter(here)
        .select(*sensor, profile_v="mean_v", sample=pl.int_ranges(pl.col("mean_v").list.len()))
        .explode("profile_v", "sample")
    )
    return (
        mean.join(baseline, on=sensor)
        .join(profile, on=[*sensor, "sample"], how="left")
        .select(*sensor, pl.col("sample").cast(pl.Int32), "time_ps", "shots", "profile_v", by_hand_v=pl.col("mean_v") - pl.col("baseline_v"))
        .sort(*sensor, "sample")
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
