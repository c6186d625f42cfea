#!/usr/bin/env python3
"""Draws the picture of the README from the tables of a demonstration (needs NumPy and Polars):

    periscope demo hidden-plane
    python3 docs/figures/demo.py periscope-demo      # writes docs/figures/demo-hidden-plane.svg
"""

import itertools
import sys
from pathlib import Path

import numpy as np
import polars as pl

OUT = Path(__file__).resolve().parent / "demo-hidden-plane.svg"
# Errors and error bars are a thousandth of the scene: both are drawn larger by this factor.
LARGER = 60
STYLE = """<style>
.back{fill:#fff}.ink{fill:#24292f}.soft{fill:#57606a}.wall{stroke:#afb8c1;stroke-width:7;stroke-linecap:round}
.truth{fill:none;stroke:#24292f;stroke-width:1.6}.bar{stroke:#57606a;stroke-width:2}
.seen{fill:#3b7fc4}.hidden{fill:#d9822b}.ball{fill:#d9822b;fill-opacity:.22;stroke:#d9822b;stroke-width:1.4}
.path{fill:none;stroke:#d9822b;stroke-width:1.4;stroke-dasharray:6 4}.error{stroke:#d9822b;stroke-width:1.2}
text{font:13px system-ui,sans-serif}.b{font-weight:600}
@media(prefers-color-scheme:dark){.back{fill:#0d1117}.ink{fill:#e6edf3}.soft{fill:#9da7b1}.wall{stroke:#484f58}
.truth{stroke:#e6edf3}.bar{stroke:#9da7b1}}
</style>"""
COVARIANCE = [f"cov_{axes}_m2" for axes in ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz")]


def read(folder, hidden):
    """Numbers, positions and covariances of the best solution's patches of one kind."""
    rows = pl.read_parquet(folder).filter(pl.col("alternative") == 0, (pl.col("kind") == "hidden") == hidden).sort("patch")
    covariances = None
    if rows["cov_xx_m2"].null_count() == 0:
        covariances = rows.select([pl.col(name).alias(str(at)) for at, name in enumerate(COVARIANCE)]).to_numpy().reshape(-1, 3, 3)
    return rows["patch"].to_list(), rows.select("x_m", "y_m", "z_m").to_numpy(), covariances


def turn(of, onto):
    """The rotation or reflection about the laser that brings points closest to others."""
    u, _, vt = np.linalg.svd(of.T @ onto)
    return (u @ vt).T


class Panel:
    """Metres to pixels: two axes of the scene, the second one upwards."""

    def __init__(self, axes, left, bottom, x0, y0, scale):
        self.axes, self.left, self.bottom, self.x0, self.y0, self.scale = axes, left, bottom, x0, y0, scale

    def __call__(self, point):
        across, up = (point[axis] for axis in self.axes)
        return round(self.left + self.scale * (across - self.x0), 1), round(self.bottom - self.scale * (up - self.y0), 1)


def circle(at, radius, kind):
    return f'<circle cx="{at[0]}" cy="{at[1]}" r="{radius}" class="{kind}"/>'


def line(a, b, kind):
    return f'<line x1="{a[0]}" y1="{a[1]}" x2="{b[0]}" y2="{b[1]}" class="{kind}"/>'


def text(x, y, words, kind="soft", anchor="start"):
    return f'<text x="{x}" y="{y}" class="{kind}" text-anchor="{anchor}">{words}</text>'


def ellipse(panel, at, covariance):
    """Two standard deviations in the plane of the panel, larger by the factor."""
    plane = covariance[np.ix_(panel.axes, panel.axes)]
    variances, axes = np.linalg.eigh(plane)
    radii = 2 * LARGER * panel.scale * np.sqrt(variances)
    angle = round(-np.degrees(np.arctan2(axes[1, 1], axes[0, 1])), 1)
    size = f'rx="{radii[1]:.1f}" ry="{radii[0]:.1f}"'
    return f'<ellipse cx="{at[0]}" cy="{at[1]}" {size} transform="rotate({angle} {at[0]} {at[1]})" class="ball"/>'


def main():
    demo = Path(sys.argv[1])
    found, truth = demo / "out/all_patches/*.parquet", demo / "campaign/truth/patches/*.parquet"
    (_, seen, _), (_, true_seen, _) = read(found, False), read(truth, False)
    (_, hidden, covariances), (_, true_hidden, _) = read(found, True), read(truth, True)
    rotation = turn(seen, true_seen)
    hidden, seen = hidden @ rotation.T, seen @ rotation.T
    covariances = rotation @ covariances @ rotation.T
    # The solution numbers hidden patches in its own order: each has the nearest true one. A true one without any was
    # not found.
    nearest = [int(np.argmin(np.linalg.norm(true_hidden - point, axis=1))) for point in hidden]
    errors_mm = [1e3 * np.linalg.norm(point - true_hidden[at]) for at, point in zip(nearest, hidden)]
    print("errors of hidden patches (mm):", " ".join(f"{error:.2f}" for error in errors_mm))

    above = Panel((0, 1), 30, 395, -0.80, -0.12, 252)
    beside = Panel((1, 2), 590, 395, 0.48, -0.47, 408)
    parts = [text(16, 26, "The room from above", "ink b"), text(590, 26, "The hidden patches from the side", "ink b")]
    for a, b in (((-0.76, 0.5), (-0.72, 1.12)), ((-0.45, 1.28), (0.48, 1.28))):
        parts.append(line(above((*a, 0)), above((*b, 0)), "wall"))
    parts.append(line(above((0.4, -0.1, 0)), above((0.4, 0.55, 0)), "wall"))
    x, y = above((0.4, 0.2, 0))
    parts.append(text(x + 10, y, "door"))
    example = [np.zeros(3), true_seen[5], true_hidden[4], true_seen[3], np.zeros(3)]
    for a, b in itertools.pairwise(example):
        parts.append(line(above(a), above(b), "path"))
    for point in seen:
        parts.append(circle(above(point), 4, "seen"))
    for point in true_seen:
        parts.append(circle(above(point), 7, "truth"))
    parts += [circle(above(point), 4, "hidden") for point in hidden] + [circle(above(point), 7, "truth") for point in true_hidden]
    x, y = above((0, 0, 0))
    parts += [f'<rect x="{x - 9}" y="{y - 6}" width="18" height="12" rx="3" class="ink"/>', text(x, y + 24, "laser and sensor", "ink", "middle")]
    x, y = above((-0.05, 0.82, 0))
    parts.append(text(x - 20, y + 4, "a third bounce", "hidden", "middle"))

    for at, point, covariance in zip(nearest, hidden, covariances):
        truth = true_hidden[at]
        place = beside(truth + LARGER * (point - truth))
        parts += [ellipse(beside, place, covariance), line(beside(truth), place, "error"), circle(place, 3.4, "hidden")]
    parts += [circle(beside(point), 6, "truth") for point in true_hidden]
    for panel in (above, beside):
        x, y = panel.left + 6, panel.bottom + 14
        parts += [line((x, y), (round(x + 0.2 * panel.scale, 1), y), "bar"), text(round(x + 0.2 * panel.scale + 8, 1), y + 4, "20 cm")]
    parts += [circle((26, 442), 7, "truth"), text(40, 446, "true position"), circle((148, 442), 4, "seen"), text(160, 446, "visible patch, as found")]
    parts += [circle((326, 442), 4, "hidden"), text(338, 446, "hidden patch, as found")]
    parts += [f'<ellipse cx="516" cy="442" rx="14" ry="8" class="ball"/>', text(538, 446, f"two standard deviations; errors and ellipsoids are drawn {LARGER} times larger")]
    width, height = 1010, 462
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img">'
    title = "<title>Visible and hidden patches of a simulated room, with error ellipsoids, next to their true positions</title>"
    back = f'<rect width="{width}" height="{height}" class="back"/>'
    OUT.write_text("\n".join([head, title, STYLE, back, *parts, "</svg>", ""]), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
