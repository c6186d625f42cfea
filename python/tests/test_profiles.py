"""From shots to profiles, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import gauss

import periscope


@pytest.mark.parametrize("dtype", ["i1", "u1", "<i2", ">i2", "u2", "i4", "f4", "f8"])
def test_a_mean_without_jitter_is_that_of_numpy(dtype: str, rng: np.random.Generator) -> None:
    shots = rng.integers(0, 100, (40, 257)).astype(dtype)
    mean = periscope.average(shots)
    np.testing.assert_allclose(mean.values, shots.astype(float).mean(axis=0), rtol=1e-14)
    assert mean.shots == 40 and mean.phase_shots[0] == 40 and mean.phase_shots.sum() == 40
    np.testing.assert_array_equal(periscope.average(shots.T.copy().T).values, mean.values)  # not contiguous


def test_shots_are_aligned_by_their_trigger_times(rng: np.random.Generator) -> None:
    dt_ps, samples = 50.0, 400
    t0_ps = rng.integers(-160, 160, 200) * (dt_ps / 64)  # multiples of the grid, so that nothing is rounded
    time_ps = t0_ps[:, None] + dt_ps * np.arange(samples)
    mean = periscope.average(gauss(time_ps - 10_000.0, 150.0), t0_ps, dt_ps)
    grid_ps = mean.t0_ps + dt_ps * np.arange(len(mean.values))
    np.testing.assert_allclose(mean.values, gauss(grid_ps - 10_000.0, 150.0), atol=3e-4)
    blurred = gauss(time_ps - 10_000.0, 150.0).mean(axis=0)
    assert np.abs(blurred - gauss(dt_ps * np.arange(samples) - 10_000.0, 150.0)).max() > 0.02


def test_wrong_shots_are_refused_with_the_fix() -> None:
    with pytest.raises(ValueError, match="convert it to"):
        periscope.average(np.zeros((2, 3), dtype="i8"))
    with pytest.raises(ValueError, match="1 dimensions"):
        periscope.average(np.zeros(3))
    with pytest.raises(ValueError, match="give dt_ps too"):
        periscope.average(np.zeros((2, 3)), [0.0, 1.0])
    with pytest.raises(ValueError, match="not finite"):
        periscope.average(np.full((2, 3), np.nan))
    with pytest.raises(ValueError, match="covered by all shots"):
        periscope.average(np.zeros((2, 3)), [0.0, 1000.0], 1.0)
    with pytest.raises(ValueError, match="covered by all shots"):
        periscope.average(np.zeros((2, 3)), [0.0, 1e300], 1e-9)


def test_noise_is_that_of_the_process(rng: np.random.Generator) -> None:
    white = rng.normal(0.0, 2.0, (50, 4000))
    noise = periscope.estimate_noise(white, lags=4)
    assert noise.sd == pytest.approx(np.sqrt(white.var(axis=1, ddof=1).mean()), rel=1e-3)
    np.testing.assert_allclose(noise.acf, [1, 0, 0, 0], atol=0.01)
    coloured = white.copy()
    for n in range(1, coloured.shape[1]):
        coloured[:, n] += 0.6 * coloured[:, n - 1]
    noise = periscope.estimate_noise(coloured, lags=6)
    np.testing.assert_allclose(noise.acf, 0.6 ** np.arange(6), atol=0.02)
    assert noise.sd == pytest.approx(2.0 / np.sqrt(1 - 0.36), rel=0.02)
    smooth = periscope.autoregressive_acf(noise.acf, coloured.size)
    np.testing.assert_allclose(smooth, noise.acf[1] ** np.arange(6), atol=1e-3)
    one = periscope.estimate_noise(white[0])
    assert one.sd == pytest.approx(white[0].std(ddof=1), rel=0.01) and len(one.acf) == 32


def test_the_quietest_stretch_has_the_least_variance(rng: np.random.Generator) -> None:
    samples = rng.normal(0.0, 1.0, 500)
    samples[200:260] *= 0.1
    variances = np.lib.stride_tricks.sliding_window_view(samples, 50).var(axis=1)
    assert periscope.quietest(samples, 50) == variances.argmin()


def test_a_response_is_estimated_on_a_finer_grid(rng: np.random.Generator) -> None:
    dt_ps, sd_ps, height = 100.0, 130.0, 0.4
    arrival_ps = 8_000.0 + rng.uniform(-150.0, 150.0, 400)
    shots = height * gauss(dt_ps * np.arange(256) - arrival_ps[:, None], sd_ps) + rng.normal(0.0, 1e-3, (400, 256))
    estimate = periscope.estimate_response(shots, dt_ps)
    assert estimate.response.width_ps == pytest.approx(2 * np.sqrt(2 * np.log(2)) * sd_ps, rel=0.02)
    assert estimate.height == pytest.approx(height, rel=0.02)
    error_ps = estimate.time_ps - arrival_ps
    error_ps -= error_ps.mean()
    assert error_ps.std() < 1.3 * estimate.time_sd_ps.mean() < 1.0
    with pytest.raises(ValueError, match="t0_ps has 3 values; 400 are needed"):
        periscope.estimate_response(shots, dt_ps, [0.0, 1.0, 2.0])


def test_a_response_is_its_spline() -> None:
    time_ps = np.arange(-300.0, 301.0, 10.0)
    response = periscope.Response(-300.0, 10.0, gauss(time_ps, 60.0))
    np.testing.assert_allclose(response.value(time_ps), gauss(time_ps, 60.0), atol=1e-15)
    between_ps = np.arange(-255.0, 255.0, 10.0)
    np.testing.assert_allclose(response.value(between_ps), gauss(between_ps, 60.0), atol=1e-5)
    assert response.support_ps == (-300.0, 300.0) and response.value([400.0])[0] == 0.0
    assert response.peak_ps == pytest.approx(0.0, abs=1e-6) and response.height == pytest.approx(1.0)
    mean = response.averaged(50.0, [1] * 64)
    assert mean.width_ps > response.width_ps
    longer = response.averaged(50.0, [1] * 64, negligible=1e-7)
    assert longer.support_ps[0] < mean.support_ps[0] and longer.support_ps[1] > mean.support_ps[1]
    with pytest.raises(ValueError, match="64 counts"):
        response.averaged(50.0, [1, 2])
    with pytest.raises(ValueError, match="between samples of its shots"):
        response.averaged(1e-9, [1] * 64)
    with pytest.raises(ValueError, match=r"values\[1\] is NaN"):
        periscope.Response(0.0, 1.0, [0.0, np.nan])


def test_counts_are_freed_of_pile_up_as_coates_has_it(rng: np.random.Generator) -> None:
    cycles, photons = 10_000, 3_000 * gauss(np.arange(60.0) - 20.0, 5.0)
    counts, ready = np.zeros(60, dtype=int), np.full(60, cycles, dtype=float)
    for n in range(60):
        ready[n] = cycles - counts[max(0, n - 10) : n].sum()
        counts[n] = rng.binomial(int(ready[n]), -np.expm1(-photons[n] / cycles))
    corrected, ours = periscope.correct_pile_up(counts, cycles, dead_bins=10)
    np.testing.assert_array_equal(ours, ready)
    np.testing.assert_allclose(corrected, -cycles * np.log1p(-counts / ready), rtol=1e-12)
    with pytest.raises(periscope.UndeterminedError, match="more photons"):
        periscope.correct_pile_up([8, 8], 10, dead_bins=5)
