"""Distances and positions, against NumPy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import periscope

M_PER_PS = 2.99792458e-4
POINTS_M = np.array(
    [[1.0, 0.2, 0.4], [-0.5, 1.5, 0.3], [0.1, 0.7, 2.0], [1.2, 1.1, -0.6], [0.3, -1.0, 0.8], [-1.1, 0.4, 0.9]]
)
PATHS = [(i,) for i in range(6)] + list(itertools.permutations(range(6), 2))


def lengths_m(points_m: np.ndarray, paths: list[tuple[int, ...]]) -> np.ndarray:
    """Lengths of closed paths from the origin."""
    legs = [np.stack([np.zeros(3), *points_m[list(path)], np.zeros(3)]) for path in paths]
    return np.array([np.linalg.norm(np.diff(leg, axis=0), axis=1).sum() for leg in legs])


def distances_m(points_m: np.ndarray) -> np.ndarray:
    nodes = np.vstack([np.zeros(3), points_m])
    return np.linalg.norm(nodes[:, None] - nodes[None], axis=2)


def test_t2_inverts_first_and_second_bounces_with_their_covariance() -> None:
    first, second = PATHS[:6], PATHS[6:]
    times_ps = lengths_m(POINTS_M, PATHS) * 1.5 / M_PER_PS
    lit, seen = (np.array(second) + 1).T
    result = periscope.t2_distances(
        np.arange(1, 7), times_ps[:6], 2.0, lit, seen, times_ps[6:], np.full(30, 3.0), group_index=1.5
    )
    true_m = distances_m(POINTS_M)
    np.testing.assert_allclose(result.distance_m, true_m[result.a, result.b], rtol=1e-12)
    assert len(result.distance_m) == 21 and not result.skipped and not result.disagreeing
    # d_0i = l_i / 2 and d_ij = (l_ij + l_ji) / 2 - l_i / 2 - l_j / 2: a matrix from lengths to distances.
    rows = np.zeros((21, 36))
    for row, a, b in zip(rows, result.a, result.b):
        if a == 0:
            row[b - 1] = 0.5
        else:
            row[[a - 1, b - 1]] = -0.5
            row[[6 + second.index((a - 1, b - 1)), 6 + second.index((b - 1, a - 1))]] = 0.5
    sd_m = np.array([2.0] * 6 + [3.0] * 30) * M_PER_PS / 1.5
    np.testing.assert_allclose(result.covariance_m2, rows @ np.diag(sd_m**2) @ rows.T, rtol=1e-9, atol=1e-20)
    assert len(first) == 6


def test_t2_reports_what_it_cannot_use() -> None:
    result = periscope.t2_distances([1], [4000.0], 1.0, [1, 1, 2], [2, 1, 1], [9000.0, 5000.0, 9900.0], 1.0)
    assert result.skipped == [(1, 1), (1, 2)] or (1, 2) in result.skipped
    with pytest.raises(ValueError, match="lit has 2 values and seen 1, for 1 times"):
        periscope.t2_distances([1], [4000.0], 1.0, [1, 1], [2], [9000.0], 1.0)
    with pytest.raises(ValueError, match="of second_ps is not finite"):
        periscope.t2_distances([1], [4000.0], 1.0, [1, 1], [2, 2], [9000.0, 9000.0], [1.0, np.inf])


def test_t3_inverts_sums_of_ranges_by_least_squares(rng: np.random.Generator) -> None:
    hidden_m = np.array([0.4, 0.6, 3.0])
    range_m = np.linalg.norm(POINTS_M - hidden_m, axis=1)
    pairs = list(itertools.combinations_with_replacement(range(6), 2))
    design = np.array([[float(i == k) + float(j == k) for k in range(6)] for i, j in pairs])
    sd_ps = rng.uniform(1.0, 3.0, len(pairs))
    sum_ps = design @ range_m / M_PER_PS + rng.normal(0.0, sd_ps)
    lit, seen = np.array(pairs).T + 1
    ranges = periscope.t3_ranges(lit, seen, sum_ps, sd_ps)
    weight = 1.0 / (sd_ps * M_PER_PS) ** 2
    covariance = np.linalg.inv(design.T * weight @ design)
    estimate = covariance @ design.T @ (weight * sum_ps * M_PER_PS)
    np.testing.assert_array_equal(ranges.patch, np.arange(1, 7))
    np.testing.assert_allclose(ranges.range_m, estimate, rtol=1e-9)
    np.testing.assert_allclose(ranges.covariance_m2, covariance, rtol=1e-6, atol=1e-15)
    residual = (design @ estimate - sum_ps * M_PER_PS) * np.sqrt(weight)
    assert ranges.chi2 == pytest.approx(residual @ residual) and ranges.degrees_of_freedom == 15
    even = periscope.t3_ranges([1], [2], [1000.0], 1.0)
    assert len(even.patch) == 0 and even.open == [[1, 2]]


def test_missing_distances_are_shortest_paths() -> None:
    given = np.array([[0, 3.0, 4.0, np.nan], [3.0, 0, np.nan, 1.0], [4.0, np.nan, 0, np.inf], [np.nan, 1.0, np.inf, 0]])
    whole = periscope.complete_distances(given)
    np.testing.assert_allclose(whole, [[0, 3, 4, 4], [3, 0, 7, 1], [4, 7, 0, 8], [4, 1, 8, 0]])
    alone = np.full((3, 3), np.nan)
    with pytest.raises(periscope.UndeterminedError, match="no chain of measured distances"):
        periscope.complete_distances(alone)


@pytest.mark.parametrize("embed", [periscope.classical_scaling, periscope.iso_embed])
def test_embeddings_have_the_distances(embed) -> None:
    true_m = distances_m(POINTS_M)
    points_m = embed(true_m)
    assert points_m.shape == (6, 3)
    np.testing.assert_allclose(distances_m(points_m), true_m, atol=1e-9)
    flat_m = distances_m(POINTS_M * [1, 1, 0])
    np.testing.assert_allclose(distances_m(embed(flat_m, dimensions=2)), flat_m, atol=1e-9)
    with pytest.raises(ValueError, match="dimensions is 4"):
        embed(true_m, 4)
    with pytest.raises(ValueError, match="symmetric"):
        embed(np.triu(true_m))


def test_classical_scaling_is_double_centring(rng: np.random.Generator) -> None:
    noisy_m = distances_m(POINTS_M) + np.triu(rng.normal(0.0, 0.01, (7, 7)), 1)
    noisy_m = np.triu(noisy_m, 1) + np.triu(noisy_m, 1).T
    centre = np.eye(7) - 1 / 7
    values, vectors = np.linalg.eigh(-0.5 * centre @ noisy_m**2 @ centre)
    expected = vectors[:, -3:] * np.sqrt(values[-3:])
    ours = periscope.classical_scaling(noisy_m)
    np.testing.assert_allclose(distances_m(ours), distances_m(expected[1:] - expected[0]), atol=1e-9)


def test_smacof_lowers_the_stress(rng: np.random.Generator) -> None:
    true_m = distances_m(POINTS_M)
    weights = np.triu(rng.uniform(0.5, 2.0, (7, 7)), 1)
    weights += weights.T
    start_m = POINTS_M + rng.normal(0.0, 0.05, POINTS_M.shape)
    points_m, stress = periscope.smacof(start_m, true_m, weights)
    assert stress < 1e-6 * (np.triu(weights) * (distances_m(start_m) - true_m) ** 2).sum()
    np.testing.assert_allclose(distances_m(points_m), true_m, atol=1e-2)
    with pytest.raises(periscope.UndeterminedError, match="do not connect"):
        periscope.smacof(start_m, true_m, np.zeros((7, 7)))


def fisher_covariance_m2(points_m: np.ndarray, sd_m: float) -> np.ndarray:
    """Inverse Fisher matrix without the three rotations about the origin, by differences."""
    step = 1e-6
    columns = []
    for n in range(points_m.size):
        shift = np.zeros(points_m.size)
        shift[n] = step
        shift = shift.reshape(points_m.shape)
        columns.append((lengths_m(points_m + shift, PATHS) - lengths_m(points_m - shift, PATHS)) / (2 * step))
    jacobian = np.array(columns).T / sd_m
    return np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-9, hermitian=True)


def test_positions_are_found_from_nothing_and_reach_the_bound(rng: np.random.Generator) -> None:
    sd_ps = 2.0
    times_ps = lengths_m(POINTS_M, PATHS) / M_PER_PS + rng.normal(0.0, sd_ps, len(PATHS))
    solution = periscope.solve_positions(PATHS, times_ps, sd_ps)
    error_m = np.abs(distances_m(solution.points_m) - distances_m(POINTS_M)).max()
    assert error_m < 10 * sd_ps * M_PER_PS
    expected = fisher_covariance_m2(solution.points_m, sd_ps * M_PER_PS)
    np.testing.assert_allclose(solution.covariance_m2, expected * solution.misfit, rtol=1e-3, atol=1e-10)
    np.testing.assert_allclose(solution.sd_m.ravel(), np.sqrt(np.diag(solution.covariance_m2)))
    residual_ps = times_ps - lengths_m(solution.points_m, PATHS) / M_PER_PS
    np.testing.assert_allclose(solution.residual_ps, residual_ps, atol=1e-6)
    assert solution.free_rotations == [3] and solution.open == [] and solution.delay_ps is None
    assert solution.degrees_of_freedom == len(PATHS) - 18 + 3 and len(solution) == 6 and solution.is_exact


def test_anchors_stations_and_a_delay_fix_the_frame(rng: np.random.Generator) -> None:
    stations_m = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.1]])
    legs = lengths_m(POINTS_M, PATHS) + np.array(
        [np.linalg.norm(POINTS_M[path[-1]] - stations_m[1]) - np.linalg.norm(POINTS_M[path[-1]]) for path in PATHS]
    )
    times_ps = (legs / M_PER_PS) * 1.1 + 7.0
    solution = periscope.solve_positions(
        PATHS,
        times_ps,
        1.0,
        stations_m=stations_m,
        source=[0] * len(PATHS),
        sensor=[1] * len(PATHS),
        start_m=POINTS_M + rng.normal(0.0, 0.05, POINTS_M.shape),
        delay_sd_ps=1000.0,
        anchors=[(0, tuple(POINTS_M[0]), 1e-4), (1, tuple(POINTS_M[1]), 1e-4), (2, tuple(POINTS_M[2]), 1e-4)],
        group_index=1.1,
        loss="squared",
    )
    np.testing.assert_allclose(solution.points_m, POINTS_M, atol=1e-3)
    assert solution.delay_ps is not None and solution.delay_ps[0] == pytest.approx(7.0, abs=0.1)
    assert solution.free_rotations == [0]


def test_a_patch_that_nothing_determines_is_open() -> None:
    times_ps = lengths_m(POINTS_M, PATHS) / M_PER_PS
    paths = [*PATHS[:6], *(path for path in PATHS[6:] if 5 not in path)]
    kept_ps = np.array([times_ps[PATHS.index(path)] for path in paths])
    solution = periscope.solve_positions(paths, kept_ps, 1.0, start_m=POINTS_M)
    assert 5 in solution.open or [5] in solution.parts
    if 5 in solution.open:
        assert np.isnan(solution.sd_m[5]).all() and np.isfinite(solution.sd_m[:5]).all()


def test_wrong_paths_are_refused() -> None:
    with pytest.raises(ValueError, match="1 paths and 2 times"):
        periscope.solve_positions([(0,)], [1.0, 2.0], 1.0)
    with pytest.raises(ValueError, match="names a station beyond the 1 given"):
        periscope.solve_positions([(0,)], [1.0], 1.0, source=[1])
    with pytest.raises(ValueError, match="there are 1 patches"):
        periscope.solve_positions([(3,)], [1.0], 1.0, start_m=[[0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="a path meets no patch"):
        periscope.solve_positions([(0,), ()], [1.0, 1.0], 1.0)
    with pytest.raises(ValueError, match='loss is "cubic"'):
        periscope.solve_positions([(0,)], [1.0], 1.0, loss="cubic")  # pyright: ignore
