#!/usr/bin/env python3
"""Points of hidden surfaces from scans that this program renders, not periscope's own simulator. Prints a table of
docs/surfaces.md.

usage: shapes.py PERISCOPE WORK [THING ...] [--photons 3000] [--seeds 2] [--scans plain hard] [--side 32]

Surfaces are clouds of small facets that hide one another (the nearest one of each direction is seen). Scans are plain,
or have a flaw: `gloss` of the facets, squares of two `albedos`, a response with a `tail` and a background that declines,
`jitter` of 4 ps in the times of histograms; `hard` scans have all four. A scan has `side` x `side` points over a square metre,
bins of 8 ps, a response of 60 ps and so many photons of the thing in a mean histogram. The true point is the facet next
to the wall's point. Needs NumPy, SciPy, h5py, Polars.
"""
import argparse
import pathlib
import subprocess

import h5py
import numpy as np
import polars as pl
from scipy.spatial import cKDTree

LIGHT_M_PS = 2.99792458e-4
HALF_M, BINS, DT_PS, STEP_PS = 0.5, 900, 8.0, 2.0
SIGMA_PS = 60 / 2.355
# Cells of the depth buffer, and the depth within which facets of a cell count as one surface.
CELL_RAD, DEPTH_M = 0.008, 0.012
JITTER_PS = 4.0
# Distances of facets, added to the covariances of points, and how far from a facet its plane goes on.
PITCH_M, REACH_M = 0.001, 0.003
HOLDS = 7.815


def turn(x, y, z):
    (sx, sy, sz), (cx, cy, cz) = np.sin([x, y, z]), np.cos([x, y, z])
    about_x, about_y = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]), np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ about_y @ about_x


def ellipsoid(middle, axes, count=60_000):
    """Places, normals and areas of facets."""
    n = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * n / count), np.pi * (1 + 5**0.5) * n
    unit, axes = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], 1), np.array(axes)
    normal = unit / axes
    length = np.linalg.norm(normal, axis=1)
    return unit * axes + middle, normal / length[:, None], 4 * np.pi / count * axes.prod() * length


def block(middle, half, turned=np.eye(3), pitch=0.0025):
    sides = []
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        counts = [max(1, int(2 * half[axis] / pitch)) for axis in (a, b)]
        rows = np.stack(np.meshgrid(*[((np.arange(c) + 0.5) / c * 2 - 1) for c in counts]), -1).reshape(-1, 2)
        for sign in (-1, 1):
            place, normal = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
            place[:, a], place[:, b], place[:, k] = rows[:, 0] * half[a], rows[:, 1] * half[b], sign * half[k]
            normal[:, k] = sign
            area = 4 * half[a] * half[b] / np.prod(counts)
            sides.append((place @ turned.T + middle, normal @ turned.T, np.full(len(rows), area)))
    return join(*sides)


def join(*parts):
    return tuple(np.concatenate([part[k] for part in parts]) for k in range(3))


def mannequin():
    limbs = [((0, 0.28, 0), (0.08, 0.1, 0.085)), ((0, 0, 0.02), (0.17, 0.2, 0.1))]
    limbs += [((x, 0.03, 0), (0.05, 0.18, 0.056)) for x in (-0.23, 0.23)] + [((x, -0.3, 0.02), (0.07, 0.2, 0.076)) for x in (-0.09, 0.09)]
    return join(*[ellipsoid(*limb) for limb in limbs])


def rabbit():
    parts = [((0, 0, 0), (0.16, 0.144, 0.144)), ((-0.1, 0.16, -0.03), (0.1, 0.09, 0.09))]
    return join(*[ellipsoid(*part) for part in parts + [((x, y, z), (0.024, 0.08, 0.032)) for x, y, z in ((-0.08, 0.29, 0), (-0.15, 0.27, 0.02))]])


def chair():
    legs = [block((x, -0.17, z), (0.02, 0.15, 0.02)) for x in (-0.18, 0.18) for z in (-0.18, 0.18)]
    place, normal, area = join(block((0, 0, 0), (0.2, 0.02, 0.2)), block((0, 0.22, 0.18), (0.2, 0.2, 0.02)), *legs)
    turned = turn(0.5, 0.4, 0)
    return place @ turned.T, normal @ turned.T, area


def stairs():
    return join(*[block((0, -0.2 + 0.1 * k, 0.06 * k), (0.25, 0.05, 0.06)) for k in range(5)])


def bowl():
    place, normal, area = ellipsoid((0, 0, 0), (0.25, 0.25, 0.25))
    back = place[:, 2] > 0.12
    return place[back], -normal[back], area[back]


def cylinder():
    azimuth, height = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 2 * np.pi, 600, endpoint=False), np.linspace(-0.25, 0.25, 200)))
    normal = np.stack([np.cos(azimuth), 0 * azimuth, np.sin(azimuth)], 1)
    return normal * 0.1 + np.stack([0 * height, height, 0 * height], 1), normal, np.full(len(height), 2 * np.pi * 0.1 * 0.5 / len(height))


def two_plates():
    return join(block((-0.12, 0, 0), (0.1, 0.15, 0.001), turn(0, 0.4, 0)), block((0.12, 0.05, 0.12), (0.12, 0.12, 0.001), turn(0.3, -0.3, 0)))


THINGS = {thing.__name__.replace("_", " "): thing for thing in (mannequin, rabbit, chair, stairs, bowl, cylinder, two_plates)}


FLAWS = ("gloss", "albedos", "tail", "jitter")


def response(has_tail):
    after = np.arange(-200, 1500, STEP_PS)
    tail = 0.12 * np.exp(-after / 300) * (1 - np.exp(-after / 25)) if has_tail else 0.0
    values = np.exp(-0.5 * (after / SIGMA_PS) ** 2) + np.where(after > 0, tail, 0)
    return values / values.sum()


def seen(place, distance, wall):
    """Facets that no other one hides: those next to the nearest one of their direction."""
    x, y, z = (place - wall).T
    column, row = np.floor(np.arctan2(x, z) / CELL_RAD), np.floor(np.arctan2(y, np.hypot(x, z)) / CELL_RAD)
    cell = (column * 4000 + row).astype(int)
    order = np.lexsort((distance, cell))
    first = np.r_[True, np.diff(cell[order]) > 0]
    nearest = distance[order][first][np.cumsum(first) - 1]
    out = np.empty(len(place), bool)
    out[order] = distance[order] < nearest + DEPTH_M
    return out


def render(thing, photons, seed, flaws, side):
    """Counts (bins, rows, columns), facets, points of the wall, and the true point of each."""
    rng = np.random.default_rng(seed)
    middle, turned = rng.uniform([-0.05, -0.05, 0.6], [0.05, 0.05, 0.75]), turn(*rng.uniform(-0.2, 0.2, 3))
    place, normal, area = thing()
    place, normal = place @ turned.T + middle, normal @ turned.T
    squares = (np.floor(place[:, 0] / 0.06) + np.floor(place[:, 1] / 0.06)) % 2 > 0
    albedo = np.where(squares, 1, 0.25) if "albedos" in flaws else 1.0
    along = np.linspace(-HALF_M, HALF_M, side)
    walls = np.array([[x, y, 0.0] for y in along for x in along])
    has_tail = "tail" in flaws
    steps, pulse = int(BINS * DT_PS / STEP_PS), response(has_tail)
    light, truth = np.zeros((len(walls), BINS)), np.zeros((len(walls), 3))
    for n, wall in enumerate(walls):
        way = wall - place
        distance = np.linalg.norm(way, axis=1)
        way /= distance[:, None]
        cosine = (normal * way).sum(1)
        facing = cosine > 0
        truth[n] = place[np.argmin(np.where(facing, distance, np.inf))]
        gloss = 1 + 6 * np.clip(cosine, 0, 1) ** 20 if "gloss" in flaws else 1.0
        value = albedo * area * cosine**2 * gloss * way[:, 2] ** 2 / distance**4 * (facing & seen(place, distance, wall))
        at = 2 * distance / LIGHT_M_PS / STEP_PS
        here = np.bincount(at.astype(int), value * (1 - at % 1), steps + 1)[:steps] + np.bincount(at.astype(int) + 1, value * (at % 1), steps + 1)[:steps]
        late = int(round(rng.normal(0, JITTER_PS) / STEP_PS)) if "jitter" in flaws else 0
        light[n] = np.roll(np.convolve(here, pulse)[100 : 100 + steps], late).reshape(BINS, -1).sum(1)
    time = (np.arange(BINS) + 0.5) * DT_PS
    own = np.exp(-0.5 * (time / SIGMA_PS) ** 2) + has_tail * 0.12 * np.exp(-time / 300) * (1 - np.exp(-time / 25))
    background = 0.2 + 3e4 * own + has_tail * 1.5 * np.exp(-time / 2500)
    counts = rng.poisson(light * photons / light.sum(1).mean() + background).astype(float)
    return counts.T.reshape(BINS, side, side), (place, normal), walls, truth


def table(folder, name):
    files = list((folder / name).glob("*.parquet"))
    return pl.read_parquet(files) if files else pl.DataFrame()


def judge(out, facets, walls, truth):
    points, anchors = table(out, "shapes.points"), table(out, "anchors")
    if len(points) == 0:
        return [0, *[""] * 5, 0, "", "", 0, ""]
    later, points = points.filter(pl.col("rank") > 1), points.filter(pl.col("rank") == 1)
    behind = [len(later), f"{(nearest_square(later, facets[0]) < HOLDS).mean():.2f}" if len(later) else ""]
    if len(points) == 0:
        return [0, *[""] * 5, 0, "", "", *behind]
    places = dict(zip(anchors["patch"], anchors.select("x_m", "y_m", "z_m").to_numpy()))
    near = cKDTree(walls).query([places[seen] for seen in points["seen"]])[1]
    off = points.select("x_m", "y_m", "z_m").to_numpy() - truth[near]
    error_mm = np.linalg.norm(off, axis=1) * 1e3
    shapes = table(out, "shapes")["kind"].to_list() if len(table(out, "shapes")) else []
    held = (squares(off, points) < HOLDS).mean()
    cells = [len(points), f"{held:.2f}", f"{np.median(error_mm):.1f}", f"{np.quantile(error_mm, 0.95):.0f}", f"{points['sd_m'].median() * 1e3:.1f}", ", ".join(shapes)]
    nodes = table(out, "meshes.vertices")
    if len(nodes) == 0:
        return [*cells, 0, "", "", *behind]
    far = distance(nodes.select("x_m", "y_m", "z_m").to_numpy(), *facets)
    return [*cells, len(nodes), f"{(far < 1.96 * nodes['sd_m'].to_numpy()).mean():.2f}", f"{np.median(far) * 1e3:.2f}", *behind]


def squares(off, points):
    """Chi-squares of distances from points."""
    xx, xy, xz, yy, yz, zz = (points[f"cov_{axes}_m2"].to_numpy() for axes in ("xx", "xy", "xz", "yy", "yz", "zz"))
    covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1) + np.eye(3) * PITCH_M**2
    return np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[:, :, None])[:, :, 0])


def nearest_square(points, place):
    """Of each point the least chi-square of the facets near it: light that begins later is that of any part."""
    at = points.select("x_m", "y_m", "z_m").to_numpy()
    near = cKDTree(place).query(at, k=400)[1]
    return np.min([squares(place[near[:, k]] - at, points) for k in range(near.shape[1])], axis=0)


def distance(points, place, normal):
    """From the planes of the nearest facets, and from their borders."""
    near = cKDTree(place).query(points, k=8)[1]
    off = points[:, None] - place[near]
    above = np.abs((off * normal[near]).sum(-1))
    beside = np.sqrt(np.maximum((off**2).sum(-1) - above**2, 0))
    return np.hypot(above, np.maximum(beside - REACH_M, 0)).min(1)


def main():
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("periscope", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[2])
    parser.add_argument("--scans", choices=("plain", "hard", *FLAWS), nargs="+", default=["plain", "hard"])
    parser.add_argument("--photons", type=float, default=3000)
    parser.add_argument("--side", type=int, default=32, help="points of the wall along a side")
    parser.add_argument("things", nargs="*", default=list(THINGS))
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    print("| thing | scan | points | 95 % hold | median error (mm) | 95 % of errors below (mm) | median sd (mm) | shapes | nodes of meshes | 95 % hold | median distance (mm) | later points | 95 % have a facet |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for thing in args.things:
        for seed in args.seeds:
            for kind in args.scans:
                folder = args.work / f"{thing}-{args.photons:.0f}-{seed}-{kind}".replace(" ", "-")
                folder.mkdir(exist_ok=True)
                counts, facets, walls, truth = render(THINGS[thing], args.photons, seed, FLAWS if kind == "hard" else (kind,), args.side)
                with h5py.File(folder / "scan.mat", "w") as file:
                    file["rect_data"], file["width"] = counts, np.array([[HALF_M]])
                run = lambda *words: subprocess.run([args.periscope, *words], cwd=folder, check=True, capture_output=True)
                run("convert", "scan.mat", "--out", "campaign", "--dt-ps", str(DT_PS), "--fwhm-ps", "60")
                run("run", "first-returns", "--campaign", "campaign", "--out", "out")
                cells = judge(folder / "out", facets, walls, truth)
                print(f"| {thing} | {seed}, {kind} | " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
