"""Deconvolution against the Fisher information, computed with NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import gauss, gaussian_response

import periscope

DT_PS, SD_PS = 50.0, 51.0


def fisher_sd_ps(time_ps: np.ndarray, arrivals_ps: list[float], heights: list[float], variance: np.ndarray) -> np.ndarray:
    """Cramer-Rao bound of the arrivals, with heights and a line fitted along."""
    shapes = [gauss(time_ps - arrival, SD_PS) for arrival in arrivals_ps]
    slopes = [
        height * shape * (time_ps - arrival) / SD_PS**2
        for height, shape, arrival in zip(heights, shapes, arrivals_ps)
    ]
    columns = np.stack([*slopes, *shapes, np.ones_like(time_ps), (time_ps - time_ps.mean()) / np.ptp(time_ps)])
    covariance = np.linalg.inv(columns / variance @ columns.T)
    return np.sqrt(np.diag(covariance)[: len(arrivals_ps)])


def test_two_pulses_closer_than_the_response_is_wide(rng: np.random.Generator) -> None:
    time_ps, sd = 1000.0 + DT_PS * np.arange(100), 5e-4
    arrivals_ps, heights = [3000.0, 3060.0], [0.8, 0.5]
    clean = 0.002 + sum(height * gauss(time_ps - at, SD_PS) for at, height in zip(arrivals_ps, heights))
    response = gaussian_response(SD_PS)
    pulls = []
    for _ in range(20):
        pulses = periscope.deconvolve(clean + rng.normal(0.0, sd, 100), sd, response, dt_ps=DT_PS, t0_ps=1000.0)
        assert len(pulses) == 2, pulses
        bound_ps = fisher_sd_ps(time_ps, arrivals_ps, heights, np.full(100, sd**2))
        np.testing.assert_allclose(pulses.time_sd_ps, bound_ps, rtol=0.25)
        np.testing.assert_allclose(pulses.time_sd_ps, np.sqrt(np.diag(pulses.covariance_ps2)), rtol=1e-12)
        np.testing.assert_allclose(pulses.covariance_ps2, pulses.covariance_ps2.T, rtol=1e-9)
        pulls.append((pulses.time_ps - arrivals_ps) / pulses.time_sd_ps)
        assert (pulses.evidence > pulses.evidence_min).all() and pulses.baseline == pytest.approx(0.002, abs=5e-4)
        np.testing.assert_allclose(pulses.amplitude, heights, atol=6 * pulses.amplitude_sd.max())
    assert 0.6 < np.std(pulls) < 1.5 and np.abs(np.mean(pulls)) < 0.6


def test_what_is_ignored_and_what_is_asked_for_count() -> None:
    time_ps = DT_PS * np.arange(120)
    mean = 0.5 * gauss(time_ps - 2000.0, SD_PS) - 0.3 * gauss(time_ps - 4500.0, SD_PS)
    response = gaussian_response(SD_PS)
    signed = periscope.deconvolve(mean, 1e-3, response, dt_ps=DT_PS, signed=True)
    np.testing.assert_allclose(signed.time_ps, [2000.0, 4500.0], atol=0.1)
    np.testing.assert_allclose(signed.amplitude, [0.5, -0.3], atol=1e-3)
    assert len(periscope.deconvolve(mean, 1e-3, response, dt_ps=DT_PS, signed=True, pulses_max=1)) == 1
    sd = np.where(time_ps > 3500.0, np.inf, 1e-3)
    (only,) = periscope.deconvolve(mean, sd, response, dt_ps=DT_PS, signed=True).time_ps
    assert only == pytest.approx(2000.0, abs=0.1)
    none = periscope.deconvolve(mean, 1e-3, response, dt_ps=DT_PS, evidence_min=1e9)
    assert len(none) == 0 and none.covariance_ps2.shape == (0, 0)


def test_correlated_noise_widens_the_error_bars() -> None:
    mean = 0.5 * gauss(DT_PS * np.arange(200) - 4000.0, SD_PS)
    response, acf = gaussian_response(SD_PS), 0.8 ** np.arange(24)
    white = periscope.deconvolve(mean, 1e-2, response, dt_ps=DT_PS)
    coloured = periscope.deconvolve(mean, 1e-2, response, dt_ps=DT_PS, acf=acf)
    assert coloured.time_sd_ps[0] != pytest.approx(white.time_sd_ps[0], rel=0.05)
    covariance = 1e-4 * 0.8 ** np.abs(np.subtract.outer(np.arange(200), np.arange(200)))
    time_ps = DT_PS * np.arange(200)
    shape = gauss(time_ps - 4000.0, SD_PS)
    columns = np.stack([0.5 * shape * (time_ps - 4000.0) / SD_PS**2, shape, np.ones(200), time_ps / time_ps.max()])
    bound_ps = np.sqrt(np.linalg.inv(columns @ np.linalg.solve(covariance, columns.T))[0, 0])
    assert coloured.time_sd_ps[0] == pytest.approx(bound_ps, rel=0.1)


def test_a_histogram_of_photons(rng: np.random.Generator) -> None:
    time_ps = DT_PS * np.arange(200)
    photons = 300.0 * gauss(time_ps - 3000.0, SD_PS) + 80.0 * gauss(time_ps - 6010.0, SD_PS) + 2.0
    pulls = []
    for _ in range(20):
        pulses = periscope.deconvolve_counts(
            rng.poisson(photons), gaussian_response(SD_PS), cycles=100_000_000, dt_ps=DT_PS
        )
        assert len(pulses) == 2, pulses
        bound_ps = fisher_sd_ps(time_ps, [3000.0, 6010.0], [300.0, 80.0], photons)
        np.testing.assert_allclose(pulses.time_sd_ps, bound_ps, rtol=0.3)
        pulls.append((pulses.time_ps - [3000.0, 6010.0]) / pulses.time_sd_ps)
    assert 0.6 < np.std(pulls) < 1.5


def test_wrong_arguments_are_refused() -> None:
    response = gaussian_response(SD_PS)
    with pytest.raises(ValueError, match=r"sd\[0\] is 0; standard deviations must be above 0"):
        periscope.deconvolve([0.0, 1.0], 0.0, response, dt_ps=1.0)
    with pytest.raises(ValueError, match="sd has 3 values; 2 are needed"):
        periscope.deconvolve([0.0, 1.0], [1.0, 1.0, 1.0], response, dt_ps=1.0)
    with pytest.raises(ValueError, match="dt_ps is -1; it must be above 0"):
        periscope.deconvolve([0.0, 1.0], 1.0, response, dt_ps=-1.0)
    with pytest.raises(ValueError, match=r"mean\[1\] is inf"):
        periscope.deconvolve([0.0, np.inf], 1.0, response, dt_ps=1.0)
    with pytest.raises(ValueError, match='give "none", "constant" or "line"'):
        periscope.deconvolve([0.0, 1.0], 1.0, response, dt_ps=1.0, baseline="flat")  # pyright: ignore
    with pytest.raises(ValueError, match="-3 is no number of photons"):
        periscope.deconvolve_counts([1, -3], response, cycles=10, dt_ps=1.0)


def test_the_bound_of_times_is_the_inverse_of_the_fisher_information() -> None:
    time_ps = 1000.0 + DT_PS * np.arange(100)
    arrivals_ps, heights, response = [3000.0, 3060.0], [0.8, 0.5], gaussian_response(SD_PS)
    grid = {"samples": 100, "dt_ps": DT_PS, "t0_ps": 1000.0}
    sd = np.linspace(2e-4, 8e-4, 100)
    bound = periscope.time_bound(arrivals_ps, heights, response, sd, **grid)
    np.testing.assert_allclose(bound.time_sd_ps, fisher_sd_ps(time_ps, arrivals_ps, heights, sd**2), rtol=1e-3)
    np.testing.assert_allclose(bound.time_sd_ps, np.sqrt(np.diag(bound.covariance_ps2)), rtol=1e-12)
    # Correlated noise: the dense covariance, inverted.
    lags = np.abs(np.subtract.outer(np.arange(100), np.arange(100)))
    correlation = np.where(lags == 0, 1.0, np.where(lags == 1, 0.4, np.where(lags == 2, 0.1, 0.0)))
    weights = np.linalg.inv(sd[:, None] * correlation * sd)
    shapes = np.stack([gauss(time_ps - at, SD_PS) for at in arrivals_ps])
    slopes = [h * shape * (time_ps - at) / SD_PS**2 for h, shape, at in zip(heights, shapes, arrivals_ps)]
    columns = np.stack([*slopes, *shapes, np.ones(100)])
    covariance = np.linalg.inv(columns @ weights @ columns.T)
    bound = periscope.time_bound(arrivals_ps, heights, response, sd, acf=[1.0, 0.4, 0.1], baseline="constant", **grid)
    np.testing.assert_allclose(bound.covariance_ps2, covariance[:2, :2], rtol=1e-3)
    np.testing.assert_allclose(bound.amplitude_sd, np.sqrt(np.diag(covariance)[2:4]), rtol=1e-3)


def test_what_has_no_bound_is_refused() -> None:
    response = gaussian_response(SD_PS)
    grid = {"samples": 100, "dt_ps": DT_PS}
    for times, heights in [([2000.0, 2000.0], 0.5), ([9000.0], 0.5), ([2000.0], 0.0)]:
        with pytest.raises(periscope.UndeterminedError, match="do not determine"):
            periscope.time_bound(times, heights if len(times) == 1 else [heights] * 2, response, 1e-3, **grid)
    with pytest.raises(ValueError, match="positive definite"):
        periscope.time_bound([2000.0], 0.5, response, 1e-3, acf=[1.0, 0.9, -0.9], **grid)
