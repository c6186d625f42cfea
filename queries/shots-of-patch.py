"""Which shots made this patch: the exposures behind every onset that its position rests on, with file and segment.

Needs the table `traces`, an index or with its codes. `periscope explain RESULTS patch=3` says the same and more.

    python shots-of-patch.py RESULTS [PATCH]
"""

import sys

import polars as pl


def answer(results="results", patch=3):
    capture = ["campaign", "sensor", "lit", "seen"]
    onsets = pl.scan_parquet(f"{results}/patches.residuals/*.parquet").filter("used", pl.col("path").list.contains(int(patch)))
    return (
        pl.scan_parquet(f"{results}/traces/*.parquet")
        .filter(pl.col("role") == "scene")
        .join(onsets.select(capture).unique(), on=capture)
        .select(*capture, "shot", "is_reference", "file", "segment", "acquired_at")
        .sort(*capture, "shot", "is_reference")
        .collect()
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
