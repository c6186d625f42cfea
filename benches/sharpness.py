#!/usr/bin/env python3
"""How sharp the light-cone transform and f-k migration are: full width at half maximum of a point across and in depth,
largest lobes near it, and its height over the noise. Prints the tables of docs/real-light.md.

usage: sharpness.py PERISCOPE WORK                    points behind a wall, made here
       sharpness.py PERISCOPE WORK SCAN.mat DT_PS     a capture of retroreflective surfaces

WORK: a folder for campaigns and results. Needs NumPy, SciPy and PyArrow.
"""
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import scipy.io
from scipy.interpolate import CubicSpline

LIGHT_M_PS = 2.99792458e-4
FWHM_PS = 60.0
SIGMA_PS = FWHM_PS / 2.354820045
SIDE, HALF_M, BINS, DT_PS, GATE_PS = 64, 0.3, 512, 8.0, 1000
PLACES_M = [(0.003 * n, 0.1 - 0.047 * n, 0.40 + 0.021 * n) for n in range(5)]
METHODS = ["light-cone", "f-k"]
# Lobes are sought beyond so many widths from the peak, up to a distance.
BEYOND, REACH_M = 1.5, 0.15


def response(time_ps):
    late = np.maximum(time_ps, 0)
    tail = 0.06 * (1 - np.exp(-late / 30)) * np.exp(-late / 500)
    return (np.exp(-0.5 * (time_ps / SIGMA_PS) ** 2) + tail) / 92.2


def write_scan(path, place_m, photons, seed):
    """A diffuse point that faces the wall, or nothing where it has no photons."""
    rng = np.random.default_rng(seed)
    time_ps = (np.arange(BINS) + 0.5) * DT_PS
    rates = 0.2 + 3e4 * (92.2 * response(time_ps) + 0.03 * np.exp(-time_ps / 250))
    along_m = np.linspace(-HALF_M, HALF_M, SIDE)
    x_m, y_m = np.meshgrid(along_m, along_m, indexing="ij")
    leg_m = np.sqrt((x_m - place_m[0]) ** 2 + (y_m - place_m[1]) ** 2 + place_m[2] ** 2)
    height = leg_m**-6
    height *= photons * DT_PS / height.mean()
    rates = rates + height[..., None] * response(time_ps - 2 * leg_m[..., None] / LIGHT_M_PS)
    scipy.io.savemat(path, {"rect_data": rng.poisson(rates).astype(np.int32), "width": np.array([[HALF_M]])})


def image(periscope, work, scan, dt_ps, options):
    """Volume (rows, columns, depths), its depths, and the tables of the image and its voxels, by method."""
    campaign = work / "campaign"
    shutil.rmtree(campaign, ignore_errors=True)

    def run(*args):
        subprocess.run([periscope, *map(str, args)], check=True, capture_output=True)

    run("convert", scan, "--out", campaign, "--dt-ps", dt_ps, "--fwhm-ps", FWHM_PS)
    for method in METHODS:
        results = work / "results"
        settings = [f"voxels.method={method}", "voxels.volume=true", *options]
        run("run", "image", "--campaign", campaign, "--out", results, *(x for s in settings for x in ("--set", s)))
        run("export", results, work / "volume.npy")
        about = pq.read_table(results / "voxels.images").to_pylist()[0]
        ends_m = np.array([about["depth_min_m"], about["depth_max_m"]])
        power = 2 if method == "light-cone" else 1
        depths_m = np.linspace(*ends_m**power, about["depths"]) ** (1 / power)
        yield method, np.load(work / "volume.npy"), depths_m, about, pq.read_table(results / "voxels")
    shutil.rmtree(work / "results")


def width(places, values):
    """Full width at half maximum about the largest value."""
    fine = np.linspace(places[0], places[-1], 50 * len(places))
    curve = CubicSpline(places, values)(fine)
    peak = curve.argmax()
    below = curve < 0.5 * curve[peak]
    left, right = below[:peak].nonzero()[0], below[peak:].nonzero()[0]
    if len(left) == 0 or len(right) == 0:
        return np.nan
    return fine[peak + right[0]] - fine[left[-1]]


def of_point(volume, depths_m, place_m):
    """Peak, its widths across and in depth, the largest lobes over and under zero near it as shares of the peak, number
    of its depth."""
    coordinates = [np.linspace(-HALF_M, HALF_M, SIDE)] * 2 + [depths_m]
    offsets = [c - p for c, p in zip(coordinates, (place_m[1], place_m[0], place_m[2]))]
    distance = np.sqrt(sum(o**2 for o in np.meshgrid(*offsets, indexing="ij")))
    y, x, z = np.unravel_index(np.where(distance < 0.03, volume, -np.inf).argmax(), volume.shape)
    peak = volume[y, x, z]
    lines = volume[:, x, z], volume[y, :, z], volume[y, x, :]
    widths = [width(c, line) for c, line in zip(coordinates, lines)]
    off = np.meshgrid(*(c - c[n] for c, n in zip(coordinates, (y, x, z))), indexing="ij")
    outside = sum((o / (BEYOND * w)) ** 2 for o, w in zip(off, widths)) > 1
    near = volume[outside & (distance < REACH_M)]
    return peak, np.mean(widths[:2]), widths[2], near.max() / peak, near.min() / peak, z


def print_row(*cells):
    print("|", " | ".join(map(str, cells)), "|")


def points(periscope, work):
    print_row("photons", "method", "width across (mm)", "width in depth (mm)", "lobe over zero", "lobe under zero",
              "peak over its sd", "peak over the scatter of an empty scan")
    print_row(*["---"] * 8)
    options = [f"voxels.gate_ps={GATE_PS}"]
    scan = work / "scan.mat"
    write_scan(scan, PLACES_M[0], 0, 0)
    empty = {method: volume for method, volume, *_ in image(periscope, work, scan, DT_PS, options)}
    for photons in [30, 300, 3000]:
        rows = {method: [] for method in METHODS}
        for seed, place_m in enumerate(PLACES_M, 1):
            write_scan(scan, place_m, photons, seed)
            for method, volume, depths_m, about, _ in image(periscope, work, scan, DT_PS, options):
                *shape, z = of_point(volume, depths_m, place_m)
                scatter = empty[method][16:48, 16:48, z - 2 : z + 3].std()
                rows[method].append([*shape[1:], about["largest"], shape[0] / scatter])
        for method in METHODS:
            across, deep, over, under, stated, seen = np.median(rows[method], axis=0)
            print_row(photons, method, f"{1e3 * across:.1f}", f"{1e3 * deep:.1f}", f"{over:.2f}", f"{under:.2f}",
                      f"{stated:,.0f}", f"{seen:,.0f}")


def capture(periscope, work, scan, dt_ps):
    """Of the brightest third of columns the width in depth; of the view from the front that of its autocorrelation."""
    print_row("method", "voxels above the threshold", "largest significance", "width in depth (mm)",
              "width of the view's autocorrelation (mm)", "least value over largest")
    print_row(*["---"] * 6)
    for method, volume, depths_m, about, voxels in image(periscope, work, scan, dt_ps, ["voxels.falloff=2"]):
        front = volume.max(axis=2)
        bright = front >= np.quantile(front, 2 / 3)
        deep = np.nanmedian([width(depths_m, line) for line in volume[bright]])
        view = front - front.mean()
        spectrum = np.abs(np.fft.fft2(view, [2 * n for n in view.shape])) ** 2
        correlation = np.fft.fftshift(np.fft.ifft2(spectrum).real)
        rows, columns = view.shape
        lags_m = about["pitch_m"] * np.arange(-rows, rows)
        across = np.mean([width(lags_m, correlation[:, columns]), width(lags_m, correlation[rows, :])])
        print_row(method, f"{voxels.num_rows:,}", f"{about['largest']:.0f}", f"{1e3 * deep:.1f}", f"{1e3 * across:.1f}",
                  f"{volume.min() / volume.max():.2f}")


periscope, work = sys.argv[1], pathlib.Path(sys.argv[2])
work.mkdir(parents=True, exist_ok=True)
if len(sys.argv) > 3:
    capture(periscope, work, *sys.argv[3:5])
else:
    points(periscope, work)
