"""Onset statistics: how many arrivals there are of each number of bounces, how well they are timed, how far they stand out of the noise.

The label with alternative 0 is the likeliest path of an onset; 0 bounces: left unexplained. An onset that is read as two pulses counts as two.

    python onsets.py RESULTS
"""

import sys

import polars as pl


def answer(results="results"):
    onset = ["campaign", "sensor", "lit", "seen", "rank"]
    labels = pl.scan_parquet(f"{results}/labels/*.parquet").filter(pl.col("alternative") == 0)
    onsets = pl.scan_parquet(f"{results}/onsets/*.parquet").select(*onset, "time_sd_ps", "snr")
    return (
        labels.select(*onset, "bounces")
        .join(onsets, on=onset)
        .group_by("campaign", "sensor", "bounces")
        .agg(
            onsets=pl.len().cast(pl.Int64),
            median_sd_ps=pl.col("time_sd_ps").median(),
            worst_sd_ps=pl.col("time_sd_ps").max(),
            median_snr=pl.col("snr").median(),
            least_snr=pl.col("snr").min(),
        )
        .sort("campaign", "sensor", "bounces")
        .collect()
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
