"""What several tests need: the repository, the command, a simulated campaign and its results."""

from __future__ import annotations

import os
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest

import periscope

REPOSITORY = Path(__file__).resolve().parents[2]
COMMAND = Path(sysconfig.get_path("scripts")) / "periscope"


def command(*arguments: str | Path, codes: tuple[int, ...] = (0,)) -> str:
    """Runs the bundled command; returns what it prints."""
    ended = subprocess.run([COMMAND, *arguments], capture_output=True, text=True, check=False)
    assert ended.returncode in codes, ended.stderr
    return ended.stdout


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Says loudly what was not tested."""
    for report in terminalreporter.stats.get("skipped", []):
        terminalreporter.write_line(f"!!! NOT TESTED: {report.nodeid}: {report.longrepr[2]}", red=True)


@pytest.fixture(scope="session")
def samples() -> Path:
    """Real oscilloscope files, where present."""
    folder = Path(os.environ.get("PERISCOPE_SAMPLES", REPOSITORY / "../shared/scope-samples"))
    if not (folder / "reference.json").exists():
        pytest.skip("no real oscilloscope files here; PERISCOPE_SAMPLES says where they are")
    return folder


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small simulated campaign."""
    folder = tmp_path_factory.mktemp("lab") / "campaign"
    periscope.simulate(REPOSITORY / "pipelines/scenes/tiny.toml", folder)
    return folder


@pytest.fixture(scope="session")
def results(campaign: Path) -> periscope.Results:
    """Its results, as Python makes them."""
    return periscope.run(campaign, "all-visible", progress="none")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def gauss(time_ps: np.ndarray, sd_ps: float) -> np.ndarray:
    """A pulse of height 1 at time 0."""
    return np.exp(-0.5 * (time_ps / sd_ps) ** 2)


def gaussian_response(sd_ps: float, step_ps: float = 5.0) -> periscope.Response:
    time_ps = np.arange(-6 * sd_ps, 6 * sd_ps + step_ps, step_ps)
    return periscope.Response(time_ps[0], step_ps, gauss(time_ps, sd_ps))
