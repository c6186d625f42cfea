"""Residuals by sensor and by day: is one sensor, or one day, off?

A mean far from 0 (see `mean_in_sd`) is a delay that calibration missed; a spread far above 1 is an error bar that is too small.
A day is that of the capture's first shot, in the instrument's own zone.

    python residuals.py RESULTS
"""

import sys

import polars as pl


def answer(results="results"):
    capture = ["campaign", "sensor", "lit", "seen"]
    captures = pl.scan_parquet(f"{results}/profiles/*.parquet").filter(pl.col("role") == "scene")
    days = captures.select(*capture, day=pl.col("acquired_at").str.head(10))
    residual = pl.col("residual_ps")
    return (
        pl.scan_parquet(f"{results}/patches.residuals/*.parquet")
        .join(days, on=capture)
        .group_by("campaign", "sensor", "day")
        .agg(
            onsets=pl.len().cast(pl.Int64),
            mean_ps=residual.mean(),
            mean_in_sd=residual.mean() / (residual.std() / pl.len().sqrt()),
            spread=(pl.col("standardised") ** 2).mean().sqrt(),
            suspects=(pl.col("suspect") | ~pl.col("used")).sum().cast(pl.Int64),
        )
        .sort("campaign", "sensor", "day")
        .collect()
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
