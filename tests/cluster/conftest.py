"""One campaign for all tests."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "pipelines/cluster"))  # where the driver lies

from lab import Lab


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """The campaign."""
    return Lab(tmp_path_factory.mktemp("lab"))
