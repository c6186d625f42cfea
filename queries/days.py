"""The same onset in two campaigns of one scene (two days, in one result folder): how far its time changed, in ps and in standard deviations.

What all onsets of a profile share (`jitter_ps`) counts on both days; the latency's own error, common to all onsets of a day, does not.

    python days.py RESULTS [ONE OTHER]
"""

import sys

import polars as pl


def answer(results="results", one="monday", other="tuesday"):
    onset = ["sensor", "lit", "seen", "rank"]
    variance = pl.col("time_sd_ps") ** 2 + pl.col("jitter_ps") ** 2
    onsets = pl.scan_parquet(f"{results}/onsets/*.parquet").select("campaign", *onset, "time_ps", var_ps2=variance)
    of_day = lambda day: onsets.filter(pl.col("campaign") == day).drop("campaign")
    return (
        of_day(one)
        .join(of_day(other), on=onset, suffix="_b")
        .select(*onset, later_ps=pl.col("time_ps_b") - pl.col("time_ps"), sd_ps=(pl.col("var_ps2") + pl.col("var_ps2_b")).sqrt())
        .with_columns(in_sd=pl.col("later_ps") / pl.col("sd_ps"))
        .sort(onset)
        .collect()
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
