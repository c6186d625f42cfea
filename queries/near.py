"""How far every patch lies from points that were measured by other means.

The points: a table `name, x_m, y_m, z_m` (CSV) in the frame of `patches`. The nearest point of each patch, the distance, and its standard
deviation (that of the patch along the line between them).

    python near.py RESULTS POINTS.csv
"""

import sys

import polars as pl


def answer(results="results", points="points.csv"):
    patches = pl.read_parquet(f"{results}/patches/*.parquet").filter(pl.col("alternative") == 0)
    known = pl.read_csv(points).select(point="name", qx="x_m", qy="y_m", qz="z_m")
    dx, dy, dz = (pl.col(f"{axis}_m") - pl.col(f"q{axis}") for axis in "xyz")
    square = dx**2 + dy**2 + dz**2
    along = dx**2 * pl.col("cov_xx_m2") + dy**2 * pl.col("cov_yy_m2") + dz**2 * pl.col("cov_zz_m2")
    across = dx * dy * pl.col("cov_xy_m2") + dx * dz * pl.col("cov_xz_m2") + dy * dz * pl.col("cov_yz_m2")
    return (
        patches.join(known, how="cross")
        .select("patch", "kind", "point", distance_m=square.sqrt(), sd_m=((along + 2 * across) / square).sqrt())
        .sort("patch", "distance_m")
        .unique("patch", keep="first", maintain_order=True)
    )


if __name__ == "__main__":
    print(answer(*sys.argv[1:]))
