"""What was rejected, and why: reasons that differ only in numbers are one kind; one example of each with its file.

    python rejects.py RESULTS
"""

import sys

import polars as pl


def answer(results="results"):
    return (
        pl.scan_parquet(f"{results}/rejects/*.parquet")
        .with_columns(kind=pl.col("reason").str.replace_all("[0-9]+", "#"), file=pl.col("file").fill_null(""))
        .group_by("stage", "kind")
        .agg(records=pl.len().cast(pl.Int64), first_file=pl.col("file").min(), example=pl.col("reason").min())
        .sort("records", "stage", "kind", descending=[True, False, False])
        .collect()
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
