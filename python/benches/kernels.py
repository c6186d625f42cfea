"""Kernels next to SciPy and NumPy on the same arrays, and what a call costs beyond its kernel. Prints the tables of
docs/python-kernels.md.

    pip install scipy && python python/benches/kernels.py

Non-negative least squares of 2,048 columns takes minutes of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import scipy.ndimage
import scipy.optimize
import scipy.signal

import periscope

SAMPLES, DT_PS, SD_PS, NOISE = 2048, 50.0, 100.0, 0.005
FWHM_PS = 2.3548 * SD_PS
PROFILES = 8


def best_s(call: Callable[[], object], repeats: int = 7) -> float:
    """Shortest time of a call, in runs of about 10 ms."""
    start = time.perf_counter()
    call()
    runs = max(1, int(0.01 / (time.perf_counter() - start)))
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(runs):
            call()
        times.append((time.perf_counter() - start) / runs)
    return min(times)


def gauss(time_ps: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * (time_ps / SD_PS) ** 2)


TIME_PS = DT_PS * np.arange(SAMPLES)
RESPONSE = periscope.Response(-600.0, 10.0, gauss(np.arange(-600.0, 601.0, 10.0)))
KERNEL = gauss(DT_PS * np.arange(-12, 13))


def profile(rng: np.random.Generator, apart: float) -> tuple[np.ndarray, np.ndarray]:
    """Six pulses of different heights, or three pairs whose members are `apart` widths from each other."""
    first_ps = np.array([20_000.0, 48_000.0, 75_000.0]) + rng.uniform(-500.0, 500.0, 3)
    gap_ps = 9_000.0 if apart > 1.0 else apart * FWHM_PS
    arrivals_ps = np.sort(np.concatenate([first_ps, first_ps + gap_ps]))
    heights = np.array([1.0, 0.7, 0.4, 0.3, 0.2, 0.15])
    mean = (heights[:, None] * gauss(TIME_PS - arrivals_ps[:, None])).sum(axis=0)
    return mean + rng.normal(0.0, NOISE, SAMPLES), arrivals_ps


def by_periscope(mean: np.ndarray) -> np.ndarray:
    return periscope.deconvolve(mean, NOISE, RESPONSE, dt_ps=DT_PS).time_ps


MATRIX = gauss(TIME_PS[:, None] - TIME_PS[None, :])


def by_nnls(mean: np.ndarray) -> np.ndarray:
    """Centroids of runs of columns that non-negative least squares uses, above five standard deviations."""
    amplitudes, _ = scipy.optimize.nnls(MATRIX, mean)
    used = np.flatnonzero(amplitudes > 0.0)
    runs = np.split(used, np.flatnonzero(np.diff(used) > 2) + 1) if len(used) else []
    kept = [run for run in runs if amplitudes[run].sum() > 5 * NOISE]
    return np.array([np.average(TIME_PS[run], weights=amplitudes[run]) for run in kept])


def by_peaks(mean: np.ndarray) -> np.ndarray:
    """Maxima above five standard deviations of the smoothed profile, with a parabola through three samples."""
    smooth = np.convolve(mean, KERNEL / KERNEL.sum(), "same")
    sd = NOISE * np.linalg.norm(KERNEL / KERNEL.sum())
    peaks, _ = scipy.signal.find_peaks(smooth, height=5 * sd, prominence=5 * sd)
    left, top, right = smooth[peaks - 1], smooth[peaks], smooth[peaks + 1]
    return DT_PS * (peaks + 0.5 * (left - right) / (left - 2 * top + right))


def by_division(mean: np.ndarray) -> np.ndarray:
    """Polynomial division of `scipy.signal.deconvolve`, then maxima."""
    quotient, _ = scipy.signal.deconvolve(mean, KERNEL)
    peaks, _ = scipy.signal.find_peaks(quotient, height=5 * NOISE)
    return DT_PS * (peaks + 12)


def score(method: Callable[[np.ndarray], np.ndarray], apart: float) -> str:
    """How many pulses have a time within half a width, how far off these are, and how many times belong to none."""
    rng, near, errors_ps, false = np.random.default_rng(5), 0, [], 0
    for _ in range(PROFILES):
        mean, arrivals_ps = profile(rng, apart)
        times_ps = list(method(mean))
        for arrival_ps in arrivals_ps:
            close = [at for at in times_ps if abs(at - arrival_ps) < 0.5 * FWHM_PS]
            if close:
                at_ps = min(close, key=lambda at, arrival_ps=arrival_ps: abs(at - arrival_ps))
                times_ps.remove(at_ps)
                errors_ps.append(at_ps - arrival_ps)
                near += 1
        false += len(times_ps)
    rms_ps = f"{np.sqrt(np.mean(np.square(errors_ps))):.2f}" if errors_ps else "-"
    return f"{near} of {6 * PROFILES} | {rms_ps} | {false / PROFILES:.1f}"


def pulses() -> None:
    methods = {
        "`periscope.deconvolve`": by_periscope,
        "`scipy.optimize.nnls`": by_nnls,
        "`scipy.signal.find_peaks`, parabola": by_peaks,
        "`scipy.signal.deconvolve`, peaks": by_division,
    }
    for apart, what in ((9.0, "Six pulses apart"), (0.6, "Three pairs, 0.6 widths apart")):
        print(f"\n{what}:\n\n| method | ms a profile | pulses with a time | rms error (ps) | false times a profile |")
        print("|---|---|---|---|---|")
        mean, _ = profile(np.random.default_rng(1), apart)
        for name, method in methods.items():
            elapsed_s = best_s(lambda method=method, mean=mean: method(mean), repeats=3)
            print(f"| {name} | {1e3 * elapsed_s:.2f} | {score(method, apart)} |")


def others() -> None:
    rng = np.random.default_rng(2)
    shots = rng.integers(-100, 100, (1000, SAMPLES)).astype(np.int8)
    starts_ps = rng.uniform(0.0, 50.0, 1000)
    pulses_of_rows = gauss(TIME_PS[:200] - rng.uniform(4_000.0, 5_000.0, (1000, 1)))

    def edges() -> np.ndarray:
        times_ps = np.empty(1000)
        for n, row in enumerate(pulses_of_rows):
            peak = row.argmax()
            k = np.flatnonzero(row[:peak] < 0.5 * row[peak])[-1]
            times_ps[n] = DT_PS * (k + (0.5 * row[peak] - row[k]) / (row[k + 1] - row[k]))
        return times_ps

    ours_ps = periscope.leading_edge(pulses_of_rows, dt_ps=DT_PS).time_ps
    assert np.abs(ours_ps - edges()).max() < 1e-6
    assert np.abs(periscope.average(shots).values - shots.mean(axis=0)).max() < 1e-9
    points_m = rng.normal(0.0, 1.0, (100, 3))
    distances_m = np.linalg.norm(points_m[:, None] - points_m[None], axis=2)

    def eigh() -> np.ndarray:
        centre = np.eye(100) - 1.0 / 100
        values, vectors = np.linalg.eigh(-0.5 * centre @ distances_m**2 @ centre)
        return vectors[:, -3:] * np.sqrt(values[-3:])

    rows = {
        "mean of 1,000 int8 shots on one grid": (
            lambda: periscope.average(shots),
            lambda: shots.mean(axis=0),
            "`ndarray.mean`",
        ),
        "the same, aligned to 1/64 sample": (
            lambda: periscope.average(shots, starts_ps, DT_PS),
            lambda: scipy.ndimage.shift(shots.astype(float), (0.0, 0.3), order=3),
            "`ndimage.shift` (one shift)",
        ),
        "leading edges of 1,000 profiles of 200 samples": (
            lambda: periscope.leading_edge(pulses_of_rows, dt_ps=DT_PS),
            edges,
            "a loop over rows in NumPy",
        ),
        "positions of 100 points from distances": (
            lambda: periscope.classical_scaling(distances_m),
            eigh,
            "`numpy.linalg.eigh`",
        ),
    }
    print("\n| task | periscope (ms) | other (ms) | other |\n|---|---|---|---|")
    for task, (ours, other, name) in rows.items():
        print(f"| {task} | {1e3 * best_s(ours):.2f} | {1e3 * best_s(other):.2f} | {name} |")


def overhead() -> None:
    """Calls whose kernels take next to nothing: all of their time is the door's."""
    mean = profile(np.random.default_rng(3), 9.0)[0]
    listed = mean.tolist()
    two_m = np.array([[0.0, 1.0], [1.0, 0.0]])
    calls = {
        "`quietest(mean, 2048)`: lock held": lambda: periscope.quietest(mean, SAMPLES),
        "`autoregressive_acf` of 2 lags: lock released": lambda: periscope.autoregressive_acf([1.0, 0.1], SAMPLES),
        "`threshold_crossing` of 2,048 samples: lock released": lambda: periscope.threshold_crossing(
            mean, 0.05, dt_ps=DT_PS
        ),
        "`threshold_crossing` of a list of 2,048 floats": lambda: periscope.threshold_crossing(
            listed, 0.05, dt_ps=DT_PS
        ),
        "`complete_distances` of 2 points: handed to another thread": lambda: periscope.complete_distances(two_m),
        "`deconvolve` of 2,048 samples, kernel included": lambda: by_periscope(mean),
    }
    print("\n| call | microseconds |\n|---|---|")
    for name, call in calls.items():
        print(f"| {name} | {1e6 * best_s(call, 15):.1f} |")


if __name__ == "__main__":
    overhead()
    pulses()
    others()
