"""Plots, labelled arrays, columns, the verdict in notebooks, the bar of a run, and plans."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import matplotlib
import numpy as np
import polars as pl
import pytest
from conftest import REPOSITORY, command, gauss, gaussian_response

import periscope

TINY = REPOSITORY / "pipelines/scenes/tiny.toml"
WALL = REPOSITORY / "pipelines/scenes/wall.toml"


@pytest.fixture(autouse=True)
def no_windows() -> None:
    matplotlib.use("Agg")


def test_columns_are_those_of_polars(results: periscope.Results) -> None:
    for name in results:
        frame = pl.DataFrame(results[name])
        for column in results[name].columns:
            theirs = frame[column]
            if theirs.dtype == pl.List(pl.Struct):
                with pytest.raises(ValueError, match="read the table through Arrow"):
                    results[name][column]
                continue
            ours = results[name][column]
            if ours.dtype.kind == "f":
                np.testing.assert_array_equal(ours, theirs.cast(pl.Float64).fill_null(np.nan).to_numpy())
            elif ours.dtype == object:
                listed = [value.tolist() if isinstance(value, np.ndarray) else value for value in ours]
                assert json.dumps(listed, default=repr) == json.dumps(theirs.to_list(), default=repr), f"{name}.{column}"
            else:
                np.testing.assert_array_equal(ours, theirs.to_numpy())
    with pytest.raises(KeyError, match="has no column"):
        results.patches["no such column"]


def test_waveforms_means_and_pulses_draw_what_they_hold(campaign: Path, rng: np.random.Generator) -> None:
    shots = periscope.read(campaign / "raw/scene/s1_L1_P2_C1.trc")
    (line,) = shots[0].plot().lines
    np.testing.assert_allclose(line.get_xdata(), shots[0].time_ps() / 1000.0)
    np.testing.assert_array_equal(line.get_ydata(), shots[0].volts())
    time_ps = 50.0 * np.arange(120)
    mean = periscope.average(0.5 * gauss(time_ps - 3000.0, 60.0) + rng.normal(0.0, 1e-3, (9, 120)), None, 50.0)
    assert mean.dt_ps == 50.0 and periscope.average(np.zeros((2, 5))).dt_ps is None
    ax = mean.plot()
    assert ax.lines[0].get_xdata()[60] == pytest.approx(3.0)
    pulses = periscope.deconvolve(mean.values, 1e-3, gaussian_response(60.0), dt_ps=50.0)
    assert pulses.plot(ax) is ax
    (stem,) = ax.collections[0].get_segments()
    np.testing.assert_allclose(stem, [[3.0, 0.0], [3.0, 0.5]], atol=2e-3)


def test_results_draw_their_patches(results: periscope.Results) -> None:
    ax = results.plot()
    assert ax.get_title() == results.verdict[0]
    drawn = np.concatenate([np.transpose(points._offsets3d) for points in ax.collections])
    assert len(drawn) == len(results.patches) and np.isin(drawn[:, 0], results.patches["x_m"]).all()


def test_what_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch, results: periscope.Results) -> None:
    for module in ("matplotlib.pyplot", "xarray", "tqdm.auto"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match="plot needs matplotlib; install it: pip install matplotlib"):
        results.plot()
    with pytest.raises(ImportError, match="to_xarray needs xarray; install it: pip install xarray"):
        results.to_xarray()
    with pytest.raises(ImportError, match="needs tqdm"):
        periscope.run(results.path.with_name("campaign"), "all-visible", results.path, progress="tqdm")


def test_profiles_become_a_labelled_array(results: periscope.Results, tmp_path: Path) -> None:
    dataset = results.to_xarray()
    assert dataset.mean_v.dims == ("lit", "seen", "time") and dataset.sizes["lit"] == 4
    for row in pl.DataFrame(results["profiles"]).iter_rows(named=True):
        one = dataset.sel(lit=row["lit"], seen=row["seen"])
        kept = one.mean_v.notnull().values
        np.testing.assert_allclose(one.mean_v.values[kept], row["mean_v"])
        np.testing.assert_allclose(one.time_ps.values[kept][0], row["t0_ps"], atol=0.1)
        assert one.shots == row["shots"]
    with pytest.raises(ValueError, match="there are no profiles of sensor 's9'"):
        results.to_xarray("s9")
    starts = {(1, 1): 0.0, (1, 2): 17.0}
    pulse = gauss(50.0 * np.arange(80) - 3336.0, 90.0)
    campaign = periscope.write_campaign(
        tmp_path / "counts",
        {pair: np.round(900.0 * pulse) for pair in starts},
        dt_ps=50.0,
        t0_ps=starts,
        kind="counts",
        cycles=10**9,
        response=np.round(1e5 * pulse),
        response_path_m=1.0,
        response_t0_ps=0.0,
    )
    apart = periscope.run(campaign, "all-visible", until="profiles", progress="none").to_xarray()
    assert apart.time_ps.dims == ("lit", "seen", "time") and apart.counts.max() == np.round(900.0 * pulse).max()
    # A profile of counts has no mean in the table: here it has one level below its counts.
    np.testing.assert_allclose(np.ptp(apart.counts.values - apart.mean_v.values, axis=-1), 0.0, atol=1e-9)
    np.testing.assert_allclose(apart.se_v.max(), np.sqrt(apart.counts.max()))
    assert float(apart.time_ps.sel(lit=1, seen=2)[0] - apart.time_ps.sel(lit=1, seen=1)[0]) == pytest.approx(17.0)


def test_a_notebook_shows_the_verdict_of_the_report(results: periscope.Results) -> None:
    word, reasons = results.verdict
    page, shown = results.report_html(), results._repr_html_()
    assert word in page and word in shown and "<svg" in shown and len(reasons) > 0
    assert shown.count("<li>") == min(len(reasons), 6)


def test_a_run_shows_a_bar(campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    periscope.run(campaign, "all-visible", tmp_path / "out", until="profiles", progress="tqdm")
    shown = capsys.readouterr().err
    assert "profiles" in shown and "100%" in shown and "B/s" in shown
    again = periscope.run(campaign, "all-visible", tmp_path / "silent", until="profiles", progress="none")
    assert capsys.readouterr().err == "" and len(again["profiles"]) == 16


def test_a_plan_is_that_of_the_command() -> None:
    plan = periscope.design(TINY)
    assert plan == json.loads(command("design", TINY, "--format", "json"))
    bounds = periscope.bounds(TINY)
    assert len(bounds) == 4 and bounds.covariance_m2.shape == (12, 12)
    # The plan follows light over one bounce more, which blends with little.
    np.testing.assert_allclose(bounds.sd_m, [patch["sd_m"] for patch in plan["patches"]], rtol=1e-6)
    blocks = bounds.covariance_m2.diagonal().reshape(4, 3)
    np.testing.assert_allclose(bounds.sd_m, np.sqrt(blocks.sum(axis=1)), rtol=1e-12)
    first = [pulse for pulse in bounds.pulses if pulse.path == [1]]
    assert first and all(pulse.time_sd_ps is not None and 0.0 < pulse.time_sd_ps < 5.0 for pulse in first)
    with pytest.raises(ValueError, match="has no meaning for a wall"):
        periscope.design(WALL, bounces=2)
    with pytest.raises(ValueError, match="light is followed over 1 to 5"):
        periscope.design(TINY, bounces=6)
    with pytest.raises(ValueError, match="threshold_sigma is 0"):
        periscope.bounds(TINY, threshold_sigma=0.0)
    with pytest.raises(periscope.CampaignError):
        periscope.bounds(REPOSITORY / "no-such-scene.toml")


def test_the_plan_of_a_wall_is_that_of_the_command(tmp_path: Path) -> None:
    text = WALL.read_text()
    few = tmp_path / "wall.toml"
    few.write_text(re.sub(r"points = \[\d+, \d+\]", "points = [8, 8]", text, count=1))
    surfaces = periscope.design(few)
    assert surfaces == json.loads(command("design", few, "--format", "json"))
    assert len(surfaces) == text.count("[surfaces.") and all(one["histograms"] == 64 for one in surfaces)
    assert any(one["points"] > 10 and 0.0 < one["sd_m"] < 0.1 for one in surfaces), surfaces
    fewer = periscope.design(few, threshold_sigma=1e6)
    assert all(one["points"] == 0 and one["sd_m"] is None for one in fewer)


def test_error_bars_of_a_run_do_not_beat_the_bound(results: periscope.Results) -> None:
    bound_m = np.sqrt(np.mean(periscope.bounds(TINY).sd_m ** 2))
    stated_m = np.sqrt(np.mean(results.patches["sd_m"] ** 2))
    assert 0.8 * bound_m < stated_m < 3.0 * bound_m
