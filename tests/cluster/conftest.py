"""One campaign for all tests."""

import signal
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "pipelines/cluster"))  # where the driver lies

from lab import Lab

# What runs in the background of a shell ignores Ctrl-C, and so does all that it starts; a handler of one's own is not inherited.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """The campaign."""
    return Lab(tmp_path_factory.mktemp("lab"))
