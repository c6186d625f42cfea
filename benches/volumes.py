#!/usr/bin/env python3
"""Points of hidden surfaces by volume methods, beside those of periscope on the same scans: light-cone transform, f-k
migration and directional light-cone transform, each as its paper has it. Prints a table of docs/surfaces.md.

usage: cargo bench --bench surfaces -- write SCANS 1 64 2000
       volumes.py PERISCOPE SCANS

SCANS: a folder of THING-PHOTONS-SEED.mat with points of the true surface beside each (.csv). Volumes give a depth for
each column whose largest voxel is among the brightest tenth, looked for at depths of 0.4 to 1 m alone; normals are
those of the depths' gradient, or of the directional volume itself. A point's error is its distance from the true
surface. Points of periscope are those whose standard deviation is below 20 mm, normals those of its smooth points.
Needs NumPy, SciPy, h5py and PyArrow.

Sources: O'Toole et al., Nature 555, 338 (2018); Lindell et al., ACM Trans. Graph. 38, 116 (2019); Young et al., CVPR
2020.
"""
import pathlib
import subprocess
import sys
import tempfile
import time

import h5py
import numpy as np
import pyarrow.parquet as pq
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

LIGHT_M_PS = 2.99792458e-4
DT_PS, FWHM_PS, GATE_PS = 8.0, 60.0, 900.0
# Noise over signal of the Wiener filters, as the papers' code has it for diffuse surfaces.
NOISE = 1 / 8e-1
BRIGHT = 0.9
SD_MAX_M = 0.02
# Distance of the true points.
PITCH_M = 0.004
# Depths among which volumes are searched: all things lie there.
NEAREST_M, FARTHEST_M = 0.4, 1.0


def scan(path):
    """Histograms [y, x, bin] without the wall's own light, and half the wall's width."""
    with h5py.File(path) as file:
        counts, half_m = file["rect_data"][()], float(file["width"][()].item())
    counts = np.moveaxis(counts, 0, -1).astype(float)
    counts[..., : int(GATE_PS / DT_PS)] = 0
    # A response of symmetric width is centred: its half width is no delay.
    return np.maximum(counts - np.median(counts[..., -100:]), 0), half_m


def resampling(bins):
    """The matrix that turns times into their squares, and back by its transpose (O'Toole et al., section 2)."""
    size = int(2 ** np.ceil(np.log2(bins)))
    matrix = np.zeros((size, bins))
    edges = np.sqrt(np.arange(size + 1) / size) * bins
    for n in range(size):
        first, last = edges[n], edges[n + 1]
        for bin in range(int(first), min(int(np.ceil(last)), bins)):
            matrix[n, bin] = max(0, min(last, bin + 1) - max(first, bin))
    return matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1e-12)


def cone(side, size, slope):
    """The light cone's point spread function over twice the extent, its axes [y, x, squared depth], and its offsets."""
    across = np.arange(2 * side) - side
    y, x = np.meshgrid(across / side * 2, across / side * 2, indexing="ij")
    depth = np.arange(2 * size) / size
    of_cone = (slope**2) * (x**2 + y**2)
    kernel = np.zeros((2 * side, 2 * side, 2 * size))
    nearest = np.rint(of_cone * size).astype(int)
    inside = nearest < 2 * size
    row, column = np.nonzero(inside)
    kernel[row, column, nearest[inside]] = 1
    kernel /= np.sqrt((kernel**2).sum())
    return kernel, x, y, depth


def light_cone(histograms, half_m, directional):
    """Volume, or three of them (albedo times normal), over [y, x, depth]; depths."""
    side, _, bins = histograms.shape
    reach_m = bins * DT_PS * LIGHT_M_PS / 2
    slope = half_m / reach_m
    depths_m = (np.arange(bins) + 0.5) / bins * reach_m
    # Diffuse surfaces: light falls with the fourth power of the distance.
    data = histograms * depths_m**4
    to_squares = resampling(bins)
    size = len(to_squares)
    padded = np.zeros((2 * side, 2 * side, 2 * size))
    padded[:side, :side, :size] = data @ to_squares.T
    kernel, x, y, _ = cone(side, size, slope)
    spectrum = np.fft.rfftn(padded)
    kernels = [kernel]
    if directional:
        # A facet's light goes with the cosine between its normal and the way to the wall.
        kernels = [kernel * (x * half_m)[..., None], kernel * (y * half_m)[..., None], kernel * np.mean(depths_m)]
    transfers = [np.fft.rfftn(np.roll(one, (-side, -side), axis=(0, 1))) for one in kernels]
    energy = sum(np.abs(one) ** 2 for one in transfers)
    solved = [
        np.fft.irfftn(spectrum * np.conj(one) / (energy + NOISE * energy.mean()), padded.shape, axes=(0, 1, 2))[:side, :side, :size]
        for one in transfers
    ]
    return [volume @ to_squares for volume in solved], depths_m


def migration(histograms, half_m):
    """f-k migration: energy over [y, x, depth]; depths."""
    side, _, bins = histograms.shape
    reach_m = bins * DT_PS * LIGHT_M_PS / 2
    depths_m = (np.arange(bins) + 0.5) / bins * reach_m
    data = np.sqrt(histograms * depths_m**2)
    padded = np.zeros((2 * bins, 2 * side, 2 * side))
    padded[:bins, :side, :side] = np.moveaxis(data, -1, 0)
    spectrum = np.fft.fftshift(np.fft.fftn(padded))
    z = np.arange(-bins, bins) / bins
    across = np.arange(-side, side) / side
    grid_z, grid_y, grid_x = np.meshgrid(z, across, across, indexing="ij")
    slope = side * reach_m / (bins * half_m) / 2
    moved = np.sqrt(slope**2 * (grid_x**2 + grid_y**2) + grid_z**2)
    places = [(np.sign(grid_z) * moved + 1) * bins, (grid_y + 1) * side, (grid_x + 1) * side]
    stretched = map_coordinates(spectrum.real, places, order=1) + 1j * map_coordinates(spectrum.imag, places, order=1)
    stretched *= (grid_z > 0) * np.abs(grid_z) / np.maximum(moved, 1e-9)
    volume = np.abs(np.fft.ifftn(np.fft.ifftshift(stretched))) ** 2
    return np.moveaxis(volume[:bins, :side, :side], 0, -1), depths_m


def surface(volume, depths_m, half_m, normals=None):
    volume = np.where((depths_m > NEAREST_M) & (depths_m < FARTHEST_M), volume, volume.min())
    """Points and normals of the columns whose largest voxel is among the brightest tenth."""
    side = volume.shape[0]
    deepest = volume.argmax(axis=-1).clip(1, volume.shape[-1] - 2)
    rows, columns = np.indices(deepest.shape)
    before, peak, after = (volume[rows, columns, deepest + k] for k in (-1, 0, 1))
    curvature = before - 2 * peak + after
    shift = np.where(curvature < 0, 0.5 * (before - after) / np.minimum(curvature, -1e-30), 0).clip(-0.5, 0.5)
    z = depths_m[deepest] + shift * (depths_m[1] - depths_m[0])
    along = np.linspace(-half_m, half_m, side)
    bright = peak >= np.quantile(peak, BRIGHT)
    points = np.stack([along[columns], along[rows], z], axis=-1)[bright]
    if normals is None:
        by_y, by_x = np.gradient(z, along[1] - along[0])
        directions = np.stack([by_x, by_y, -np.ones_like(z)], axis=-1)[bright]
    else:
        directions = np.stack([one[rows, columns, deepest] for one in normals], axis=-1)[bright]
        directions[directions[:, 2] > 0] *= -1
    return points, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def by_volume(name, histograms, half_m):
    if name == "f-k migration":
        return surface(*migration(histograms, half_m), half_m)
    volumes, depths_m = light_cone(histograms, half_m, name == "directional light cone")
    if len(volumes) == 1:
        return surface(volumes[0], depths_m, half_m)
    x, y, z = volumes
    # The normal points back to the wall, where depth is less.
    return surface(np.abs(z), depths_m, half_m, (-x * np.sign(z), -y * np.sign(z), -np.abs(z)))


def by_periscope(periscope, path):
    with tempfile.TemporaryDirectory() as folder:
        work = pathlib.Path(folder)
        run = lambda *words: subprocess.run([periscope, *map(str, words)], check=True, capture_output=True)
        run("convert", path, "--out", work / "scan", "--fwhm-ps", FWHM_PS, "--dt-ps", DT_PS)
        began = time.perf_counter()
        run("run", "first-returns", "--campaign", work / "scan", "--out", work / "out")
        seconds = time.perf_counter() - began
        rows = pq.read_table(work / "out" / "surface").to_pylist()
    rows = [row for row in rows if row["sd_m"] < SD_MAX_M]
    vector = lambda *names: np.array([[row[name] for name in names] for row in rows])
    normals = vector("normal_x", "normal_y", "normal_z")
    normals[[row["kind"] != "smooth" for row in rows]] = np.nan
    return vector("x_m", "y_m", "z_m"), normals, seconds


def distances(points, truth, tree):
    """Distances from a surface that is known by points 4 mm apart, and the numbers of the nearest of these."""
    _, nearest = tree.query(points)
    way, normal = points - truth[nearest, :3], truth[nearest, 3:]
    along = (way * normal).sum(axis=1)
    across = np.linalg.norm(way - along[:, None] * normal, axis=1)
    return np.hypot(along, np.maximum(across - PITCH_M, 0)), nearest


def main(periscope, folder):
    print("| scene | photons | method | points | median distance (mm) | 95 % of distances below (mm) | "
          "median turn of the normal (degrees) | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    for path in sorted(pathlib.Path(folder).glob("*.mat")):
        thing, photons, _ = path.stem.rsplit("-", 2)
        truth = np.loadtxt(path.with_suffix(".csv"), delimiter=",", skiprows=1)
        tree = cKDTree(truth[:, :3])
        histograms, half_m = scan(path)
        for name in ("periscope", "light cone", "f-k migration", "directional light cone"):
            began = time.perf_counter()
            if name == "periscope":
                points, normals, seconds = by_periscope(periscope, path)
            else:
                points, normals = by_volume(name, histograms, half_m)
                seconds = time.perf_counter() - began
            off_m, nearest = distances(points, truth, tree)
            cosine = np.abs((normals * truth[nearest, 3:]).sum(axis=1)).clip(0, 1)
            print(f"| {thing} | {photons} | {name} | {len(points):,} | {1e3 * np.median(off_m):.2f} | "
                  f"{1e3 * np.quantile(off_m, 0.95):.1f} | {np.degrees(np.nanmedian(np.arccos(cosine))):.1f} | {seconds:.1f} |")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
