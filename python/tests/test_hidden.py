"""Hidden patches and surfaces from arrays, against the scenes that the tests draw."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from conftest import gauss, gaussian_response

import periscope

M_PER_PS = 2.99792458e-4
WALL_M = np.array([[x, y, 0.0] for y in (-0.4, -0.1, 0.2, 0.5) for x in (-0.5, -0.2, 0.15, 0.45)])
HIDDEN_M = np.array([[0.1, 0.2, 0.9], [-0.4, 0.1, 0.7]])
LASER_M = (0.0, 0.3, 1.5)


def over_ps(hidden_m: np.ndarray, lit: int, seen: int) -> float:
    return (np.linalg.norm(hidden_m - WALL_M[lit]) + np.linalg.norm(hidden_m - WALL_M[seen])) / M_PER_PS


def test_hidden_patches_are_where_third_bounces_put_them(rng: np.random.Generator) -> None:
    pairs = list(itertools.combinations(range(16), 2))
    times = [
        np.sort([over_ps(hidden_m, *pair) + rng.normal(0.0, 3.0) for hidden_m in HIDDEN_M] + [rng.uniform(0, 15_000)])
        for pair in pairs
    ]
    patches = periscope.find_hidden(WALL_M, pairs, times, 3.0, (0.0, 15_000.0), source_m=LASER_M)
    assert len(patches) == 2
    for hidden_m in HIDDEN_M:
        patch = min(patches, key=lambda one: float(np.linalg.norm(one.point_m - hidden_m)))
        off_m = patch.point_m - hidden_m
        assert off_m @ np.linalg.solve(patch.covariance_m2, off_m) < 16.3  # 99.9 % of three coordinates
        assert np.sqrt(np.trace(patch.covariance_m2)) < 0.002
        assert patch.evidence > 20.0 and patch.seen > 0.9 and patch.snr is None
    lists = [np.full(len(some), 3.0) for some in times]
    again = periscope.find_hidden(WALL_M, pairs, times, lists, (0.0, 15_000.0), source_m=LASER_M)
    np.testing.assert_array_equal([one.point_m for one in again], [one.point_m for one in patches])
    assert periscope.find_hidden(WALL_M, pairs, [[]] * len(pairs), 3.0, (0.0, 15_000.0)) == []


def test_a_matched_filter_is_the_correlation_with_whitened_samples(rng: np.random.Generator) -> None:
    time_ps = 50.0 * np.arange(200)
    mean = 0.02 * gauss(time_ps - 4000.0, 120.0) + 0.003 + rng.normal(0.0, 0.01, 200)
    at_ps = np.array([3900.0, 4000.0, 6000.0])
    scores, gains = periscope.matched_filter(mean, 0.01, gaussian_response(120.0), at_ps, dt_ps=50.0)
    for score, gain, at in zip(scores, gains, at_ps):
        columns = np.stack([gauss(time_ps - at, 120.0), np.ones(200), time_ps - time_ps.mean()]) / 0.01
        covariance = np.linalg.inv(columns @ columns.T)
        amplitude = (covariance @ columns @ (mean / 0.01))[0]
        assert gain == pytest.approx(1.0 / np.sqrt(covariance[0, 0]), rel=2e-3)
        assert score == pytest.approx(amplitude / np.sqrt(covariance[0, 0]), abs=0.02)
    given, _ = periscope.matched_filter(mean, 0.01, gaussian_response(120.0), [4000.0], dt_ps=50.0, given_ps=[4000.0])
    assert given == pytest.approx([0.0])


def test_a_patch_too_weak_for_an_onset_shows_in_all_profiles_together(rng: np.random.Generator) -> None:
    pairs = list(itertools.combinations(range(16), 2))
    time_ps, response, hidden_m = 50.0 * np.arange(200), gaussian_response(120.0), HIDDEN_M[0]
    at_ps = np.arange(3000.0, 9000.0, 24.0)
    both = [
        periscope.matched_filter(
            0.009 * gauss(time_ps - over_ps(hidden_m, *pair), 120.0) + rng.normal(0.0, 0.01, 200),
            0.01,
            response,
            at_ps,
            dt_ps=50.0,
        )
        for pair in pairs
    ]
    scores, gains = (np.array([one[n] for one in both]) for n in (0, 1))
    where = {"first_ps": at_ps[0], "step_ps": 24.0, "response_width_ps": response.width_ps, "source_m": LASER_M}
    patch = periscope.search_hidden(WALL_M, pairs, scores, gains, **where)
    assert patch is not None and patch.evidence > -np.log(1e-3) and patch.snr is not None and patch.snr > 5.0
    off_m = patch.point_m - hidden_m
    assert off_m @ np.linalg.solve(patch.covariance_m2, off_m) < 16.3
    noise = periscope.search_hidden(WALL_M, pairs, rng.normal(0.0, 1.0, scores.shape), gains, **where)
    assert noise is None or noise.evidence < -np.log(1e-3)


def test_what_cannot_be_searched_is_refused() -> None:
    with pytest.raises(periscope.UndeterminedError, match="lie in one line"):
        periscope.find_hidden([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [(0, 1)], [[5.0]], 1.0, (0.0, 9.0))
    with pytest.raises(ValueError, match="visible_m has 16 rows"):
        periscope.find_hidden(WALL_M, [(0, 16)], [[5.0]], 1.0, (0.0, 9.0))
    with pytest.raises(ValueError, match="time_ps has 1 lists for 2 pairs"):
        periscope.find_hidden(WALL_M, [(0, 1), (0, 2)], [[5.0]], 1.0, (0.0, 9.0))
    with pytest.raises(ValueError, match="span_ps must rise"):
        periscope.find_hidden(WALL_M, [(0, 1)], [[5.0]], 1.0, (9.0, 0.0))
    with pytest.raises(ValueError, match="for 1 pairs"):
        periscope.search_hidden(
            WALL_M, [(0, 1)], np.zeros((2, 9)), np.ones((2, 9)), first_ps=0.0, step_ps=1.0, response_width_ps=10.0
        )


SIDE = 20
SCAN_M = np.array([[x, y, 0.0] for y in np.linspace(-0.5, 0.5, SIDE) for x in np.linspace(-0.5, 0.5, SIDE)])
BIN_PS, SIGMA_PS = 8.0, 30.0


def histograms(surface_m: np.ndarray, area: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Photons [point of the wall, bin] of small facets that face the wall: each wall point lit and seen itself."""
    counts = np.zeros((len(SCAN_M), 900))
    for row, wall_m in enumerate(SCAN_M):
        distance_m = np.linalg.norm(surface_m - wall_m, axis=1)
        light = area * (surface_m[:, 2] / distance_m) ** 2 / distance_m**4
        counts[row] = np.histogram(2 * distance_m / M_PER_PS / BIN_PS, bins=900, range=(-0.5, 899.5), weights=light)[0]
    kernel = gauss(BIN_PS * np.arange(-20, 21), SIGMA_PS)
    mean = np.array([np.convolve(row, kernel / kernel.sum(), "same") for row in counts])
    return rng.poisson(mean * (300.0 / mean.max()) + 0.2)


def test_first_light_shows_a_flat_surface_with_its_normal(rng: np.random.Generator) -> None:
    across_m = np.linspace(-0.7, 0.7, 500)
    x, y = (grid.ravel() for grid in np.meshgrid(across_m, across_m))
    plane_m = np.stack([x, y, 0.9 + 0.15 * x], axis=1)
    counts = histograms(plane_m, np.ones(len(plane_m)), rng)
    returns = periscope.first_returns(counts, gaussian_response(SIGMA_PS, 2.0), dt_ps=BIN_PS)
    assert len(returns) == len(SCAN_M) and returns.time_ps.shape == (len(SCAN_M), 3)
    normal = np.array([0.15, 0.0, -1.0]) / np.hypot(0.15, 1.0)
    distance_m = -(SCAN_M[returns.place] - [0.0, 0.0, 0.9]) @ normal * -1.0
    step_m = 0.5 * M_PER_PS * returns.time_ps[:, 0]
    assert np.median(np.abs(step_m - distance_m)) < 0.002
    surface = periscope.surface_points(returns, SCAN_M, front_m=(0.0, 0.0, 1.0))
    assert len(surface) > 0.9 * len(SCAN_M) and surface.covariance_m2.shape == (len(surface), 3, 3)
    off_m = (surface.points_m - [0.0, 0.0, 0.9]) @ normal
    sd_m = np.sqrt(np.einsum("i,nij,j->n", normal, surface.covariance_m2, normal))
    assert np.median(np.abs(off_m)) < 0.003 and np.mean(np.abs(off_m) < 3.0 * sd_m) > 0.9
    assert np.median(surface.normals @ normal) > 0.99
    (shape,) = surface.shapes()
    assert shape.kind == "plane" and shape.radius_m is None and shape.axis is not None
    assert abs(shape.axis @ normal) > 0.9999 and len(shape.members) > 0.8 * len(surface)
    (field,) = surface.height_fields()
    assert np.median(np.abs((field.points_m - [0.0, 0.0, 0.9]) @ normal)) < 0.003
    assert len(field) == len(field.sd_m) == len(field.grid)


def test_walls_without_first_light_or_in_a_line_have_no_surface(rng: np.random.Generator) -> None:
    response = gaussian_response(SIGMA_PS, 2.0)
    dark = periscope.first_returns(rng.poisson(0.2, (40, 500)), response, dt_ps=BIN_PS, threshold_sigma=8.0)
    assert len(dark) == 0 and len(periscope.surface_points(dark, SCAN_M[:40], front_m=(0.0, 0.0, 1.0))) == 0
    levels = gauss(BIN_PS * np.arange(500) - 2000.0, 100.0) + rng.normal(0.0, 0.01, (20, 500))
    some = periscope.first_returns(levels, response, dt_ps=BIN_PS, sd=0.01)
    assert len(some) == 20
    with pytest.raises(periscope.UndeterminedError, match="lie in one line"):
        periscope.surface_points(some, np.outer(np.arange(20.0), [1.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="seen_m has 3 rows"):
        periscope.surface_points(some, SCAN_M[:3])
    with pytest.raises(ValueError, match="must be a pulse above 0"):
        periscope.first_returns(levels, periscope.Response(-10.0, 10.0, [0.0, -1.0, 0.0]), dt_ps=BIN_PS)
