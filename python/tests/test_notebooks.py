"""The notebooks: every code cell, in order, in an empty folder."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import matplotlib
import pytest
from conftest import REPOSITORY

NOTEBOOKS = sorted((REPOSITORY / "python/notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.stem)
def test_a_notebook_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    cells = json.loads(notebook.read_text())["cells"]
    assert not any(cell.get("outputs") for cell in cells), "commit notebooks without outputs"
    names: dict[str, object] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of rejected shots, which the text of the notebook explains
        for number, cell in enumerate(cells):
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), f"{notebook.name}, cell {number}", "exec"), names)


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) == 2
