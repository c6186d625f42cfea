"""What moved between two analyses of one scene?

Distances do not depend on the frame, which a patch that moves may turn. Of a patch that moved most distances change; of the others only
those to it. Patch 0 is laser and sensor. The first row moved, if its share is far above the others'.

    python moved.py RESULTS EARLIER_RESULTS
"""

import sys

import polars as pl


def answer(results="results", earlier="earlier-results"):
    now, before = (pl.read_parquet(f"{folder}/distances/*.parquet") for folder in (results, earlier))
    pairs = now.join(before, on=["a", "b"], suffix="_before").select(
        "a", "b",
        change_m=pl.col("distance_m") - pl.col("distance_m_before"),
        sd_m=(pl.col("sd_m") ** 2 + pl.col("sd_m_before") ** 2).sqrt(),
    )
    ends = pl.concat([pairs.select(pl.col(end).alias("patch"), "change_m", "sd_m") for end in "ab"])
    change, sd = pl.col("change_m"), pl.col("sd_m")
    return (
        ends.group_by("patch")
        .agg(
            distances=pl.len().cast(pl.Int64),
            changed=(change.abs() > 4 * sd).sum().cast(pl.Int64),
            most_m=change.abs().max(),
            rms_in_sd=((change / sd) ** 2).mean().sqrt(),
        )
        .sort("rms_in_sd", descending=True)
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
