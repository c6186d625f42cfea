"""Classical timing against closed forms and the scatter of noisy pulses."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import gauss

import periscope

DT_PS, SD_PS = 10.0, 60.0
TIME_PS = 500.0 + DT_PS * np.arange(150)


def test_a_leading_edge_lies_where_the_pulse_has_its_fraction() -> None:
    arrivals_ps = np.array([1000.0, 1100.0, 1250.0])
    onsets = periscope.leading_edge(
        0.3 * gauss(TIME_PS - arrivals_ps[:, None], SD_PS), dt_ps=DT_PS, t0_ps=500.0, fraction=0.2
    )
    assert len(onsets) == 3
    np.testing.assert_allclose(onsets.time_ps, arrivals_ps - SD_PS * np.sqrt(2 * np.log(5)), atol=0.2)
    np.testing.assert_allclose(onsets.level, 0.06)


def test_a_constant_fraction_does_not_walk_and_a_level_does() -> None:
    pulse = gauss(TIME_PS - 1234.0, SD_PS)
    heights = np.array([0.1, 1.0, 10.0])
    fraction = periscope.constant_fraction(heights[:, None] * pulse, 80.0, dt_ps=DT_PS, t0_ps=500.0)
    assert np.ptp(fraction.time_ps) < 1e-9
    level = periscope.threshold_crossing(heights[:, None] * pulse, 0.05, dt_ps=DT_PS, t0_ps=500.0)
    expected_ps = 1234.0 - SD_PS * np.sqrt(2 * np.log(heights / 0.05))
    np.testing.assert_allclose(level.time_ps, expected_ps, atol=0.6)


@pytest.mark.parametrize(
    ("time", "least"),
    [
        (lambda rows: periscope.leading_edge(rows, dt_ps=DT_PS, t0_ps=500.0, noise_sd=0.01), 0.85),
        (lambda rows: periscope.constant_fraction(rows, 80.0, dt_ps=DT_PS, t0_ps=500.0, noise_sd=0.01), 0.85),
        # Its error bar counts the noise of one sample; the crossing lies between two.
        (lambda rows: periscope.threshold_crossing(rows, 0.4, dt_ps=DT_PS, t0_ps=500.0, noise_sd=0.01), 0.7),
    ],
)
def test_error_bars_are_the_scatter(time, least: float, rng: np.random.Generator) -> None:
    onsets = time(gauss(TIME_PS - 1234.0, SD_PS) + rng.normal(0.0, 0.01, (2000, 150)))
    assert least < onsets.time_ps.std() / onsets.time_sd_ps.mean() < 1.15


def test_rows_without_a_pulse_have_no_time() -> None:
    onsets = periscope.threshold_crossing(np.zeros((2, 20)), 0.5, dt_ps=1.0)
    assert np.isnan(onsets.time_ps).all() and np.isnan(onsets.time_sd_ps).all()
    one = periscope.leading_edge([0.0, 0.0, 1.0, 0.0], dt_ps=1.0)
    assert one.time_ps == pytest.approx([1.5])
    with pytest.raises(ValueError, match="it must lie between 0 and 1"):
        periscope.leading_edge([0.0, 1.0], dt_ps=1.0, fraction=1.0)
    with pytest.raises(ValueError, match="give a sample of 10 ps at least"):
        periscope.constant_fraction([0.0, 1.0], 3.0, dt_ps=10.0)
    with pytest.raises(ValueError, match=r"give \(samples,\) or \(profiles, samples\)"):
        periscope.leading_edge(np.zeros((2, 2, 2)), dt_ps=1.0)
    with pytest.raises(ValueError, match="not finite"):
        periscope.leading_edge([0.0, np.nan], dt_ps=1.0)
