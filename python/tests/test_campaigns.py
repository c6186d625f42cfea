"""Runs and results, against the command."""

from __future__ import annotations

import hashlib
import json
import shutil
import tomllib
import warnings
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from conftest import REPOSITORY, command

import periscope


def digests(results: Path) -> dict[str, str]:
    """Digest of each file of the tables of a result folder."""
    files = [file for table in periscope.Results(results) for file in sorted((results / table).glob("*.parquet"))]
    return {str(file.relative_to(results)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_tables_are_byte_for_byte_those_of_the_command(
    campaign: Path, results: periscope.Results, tmp_path: Path
) -> None:
    assert results.path == campaign.with_name("campaign-results")
    other = tmp_path / "by-command"
    command("run", "all-visible", "--campaign", campaign, "--out", other, codes=(0, 3))
    ours, theirs = digests(results.path), digests(other)
    assert len(ours) > 5 and ours == theirs
    rows = json.loads(command("tables", "--format", "json", results.path))
    assert {row["table"]: row["rows"] for row in rows} == {row["table"]: len(results[row["table"]]) for row in rows}
    assert "done" in command("tables", results.path)  # the record of the run


def test_a_simulated_campaign_is_that_of_the_command(campaign: Path, tmp_path: Path) -> None:
    command("simulate", REPOSITORY / "pipelines/scenes/tiny.toml", "--out", tmp_path / "campaign")
    for file in (tmp_path / "campaign").rglob("*.trc"):
        assert file.read_bytes() == (campaign / file.relative_to(tmp_path / "campaign")).read_bytes(), file
    with pytest.raises(periscope.CampaignError, match="not empty; choose another folder"):
        periscope.simulate(REPOSITORY / "pipelines/scenes/tiny.toml", campaign)


def test_tables_stream_into_polars_and_pyarrow(results: periscope.Results) -> None:
    for name in results:
        table, files = results[name], sorted((results.path / name).glob("*.parquet"))
        frame = pl.DataFrame(table)
        assert frame.equals(pl.read_parquet(files)) if files else frame.is_empty(), name
        arrow = pa.table(table)
        assert arrow.num_rows == len(table) and arrow.column_names == table.columns
        again = pa.RecordBatchReader.from_stream(table).read_all()
        assert again == arrow
    assert {"patch", "x_m", "y_m", "z_m"} <= set(results.patches.columns) and len(results.patches) > 3


def test_tables_stream_into_duckdb_and_pandas(results: periscope.Results) -> None:
    onsets = results["onsets"]
    times_ps = pl.DataFrame(onsets)["time_ps"].to_numpy()
    with duckdb.connect() as connection:
        ((count, total_ps),) = connection.execute("SELECT count(*), sum(time_ps) FROM onsets").fetchall()
    assert count == len(onsets) and total_ps == pytest.approx(times_ps.sum())
    np.testing.assert_array_equal(pd.DataFrame.from_arrow(onsets)["time_ps"], times_ps)


def test_positions_are_near_the_truth(campaign: Path, results: periscope.Results) -> None:
    patches = pl.DataFrame(results.patches).sort("patch")
    scene = tomllib.loads((REPOSITORY / "pipelines/scenes/tiny.toml").read_text())["patches"]
    true_m = np.array([scene[str(patch)]["position_m"] for patch in patches["patch"] if str(patch) in scene])
    patches = patches.filter(pl.col("patch").cast(pl.String).is_in(list(scene)))
    points_m = patches.select("x_m", "y_m", "z_m").to_numpy()
    between = lambda points: np.linalg.norm(points[:, None] - points[None], axis=2)  # noqa: E731
    assert len(points_m) >= 3
    assert np.abs(between(points_m) - between(true_m)).max() < 0.05


def test_a_second_run_reuses_tables_and_a_parameter_changes_them(campaign: Path, tmp_path: Path) -> None:
    first = periscope.run(campaign, "all-visible", tmp_path / "out", progress="none")
    before = digests(first.path)
    records = sorted((tmp_path / "out/.shelf/runs").glob("*.json"))
    again = periscope.run([campaign], "all-visible", tmp_path / "out", progress="none")
    assert digests(again.path) == before
    (new,) = set((tmp_path / "out/.shelf/runs").glob("*.json")) - set(records) or {records[-1]}
    assert json.loads(new.read_text())["ending"] == "done"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = periscope.run(
            campaign, "all-visible", tmp_path / "out", {"onsets.threshold_sigma": 9}, until="onsets", progress="none"
        )
    onsets = digests(other.path)
    assert {name for name in before if before[name] != onsets.get(name)} >= {
        name for name in before if name.startswith("onsets/")
    }


def test_origins_are_those_that_the_command_explains(results: periscope.Results) -> None:
    patch = pl.DataFrame(results.patches)["patch"].to_list()[-1]
    ours = results.explain(patch=patch)
    assert ours == json.loads(command("explain", results.path, f"patch={patch}", "--format", "json"))
    assert ours["captures"][0]["raw"]
    with pytest.raises(ValueError, match="name one row"):
        results.explain()
    with pytest.raises(ValueError, match="name one row"):
        results.explain(patch=1, distance=(1, 2))
    with pytest.raises(periscope.ResultsError):
        results.explain(patch=4711)


def test_the_report_is_that_of_the_command(results: periscope.Results, tmp_path: Path) -> None:
    page = results.report(tmp_path / "page.html")
    command("report", results.path, "--to", tmp_path / "other.html")
    assert page.read_text() == (tmp_path / "other.html").read_text()
    shown = results._repr_html_()
    assert "<td>patches</td>" in shown and "<svg" in shown


def test_what_is_wrong_has_its_exception(campaign: Path, results: periscope.Results, tmp_path: Path) -> None:
    with pytest.raises(periscope.CampaignError, match=r"campaign\.toml"):
        periscope.run(tmp_path)
    with pytest.raises(periscope.PipelineError, match="no-such-pipeline"):
        periscope.run(campaign, "no-such-pipeline")
    with pytest.raises(periscope.PipelineError, match="threshold_sigma"):
        periscope.run(campaign, "all-visible", tmp_path / "out", {"onsets.threshold_sigma": "much"})
    with pytest.raises(periscope.ResultsError):
        periscope.Results(tmp_path / "absent")
    with pytest.raises(KeyError, match="has no table 'no such table'|has no table \"no such table\""):
        results["no such table"]
    with pytest.raises(ValueError, match="give it as `out`"):
        periscope.run([campaign, campaign])
    with pytest.raises(periscope.RunError, match="--until"):
        periscope.run(campaign, "all-visible", tmp_path / "out", until="no such table", progress="none")
    assert "patches" in results and len(results) == len(results.tables) and "no such table" not in results


def test_a_damaged_table_is_an_error_and_not_rows(campaign: Path, results: periscope.Results, tmp_path: Path) -> None:
    shutil.copytree(results.path, tmp_path / "damaged", symlinks=True)
    file = next((tmp_path / "damaged/onsets").resolve().glob("*.parquet"))
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 1
    file.chmod(0o644)
    file.write_bytes(content)
    with pytest.raises(Exception, match=r"onsets|digest|damage"):
        pa.table(periscope.Results(tmp_path / "damaged")["onsets"])


def test_captures_that_are_left_out_are_warned_of(campaign: Path, tmp_path: Path) -> None:
    partial = tmp_path / "partial"
    shutil.copytree(campaign, partial)
    (partial / "raw").mkdir(exist_ok=True)
    (partial / "raw/stray.trc").write_bytes(next(campaign.rglob("*.trc")).read_bytes())
    with pytest.warns(UserWarning, match="stray"):
        periscope.run(partial, "all-visible", progress="none")
