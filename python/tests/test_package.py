"""The package as a whole: documentation, stubs, the command, and the page of the guide."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY, command

import periscope
from periscope import _periscope

PAGE = (REPOSITORY / "docs/guide/python.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_wheel_brings_the_command() -> None:
    assert command("--version").split() == ["periscope", periscope.__version__]


@pytest.mark.parametrize("name", [name for name in periscope.__all__ if name != "__version__"])
def test_every_public_name_has_documentation(name: str) -> None:
    thing = getattr(periscope, name)
    assert inspect.getdoc(thing), name
    if inspect.isbuiltin(thing):
        described = inspect.getdoc(thing) or ""
        for parameter in inspect.signature(thing).parameters:
            assert re.search(rf"^[\w, ]*\b{parameter}\b", described, re.MULTILINE), f"{name}: {parameter}"


def stub() -> dict[str, ast.AST]:
    """Names of the stub: functions, classes, and `Class.member`."""
    file = Path(_periscope.__file__).with_name("_periscope.pyi")
    names: dict[str, ast.AST] = {}
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names[node.name] = node
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{member.name}": member for member in node.body if isinstance(member, ast.FunctionDef)}
    return names


def test_stubs_name_what_is_there_with_its_parameters() -> None:
    names = stub()
    native = {name for name in vars(_periscope) if not name.startswith("_") and name != "VERSION"}
    assert {name for name in names if "." not in name} == native
    for name, node in names.items():
        owner, _, member = name.rpartition(".")
        if member in ("__iter__", "__init__"):  # Python makes the first of `__getitem__`; the second is `__new__`
            continue
        thing = getattr(getattr(_periscope, owner) if owner else _periscope, member)
        if isinstance(node, ast.FunctionDef) and inspect.isbuiltin(thing):
            ours = [argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)]
            assert ours == list(inspect.signature(thing).parameters), name
    for owner in (name for name in native if inspect.isclass(getattr(_periscope, name))):
        members = {name for name in vars(getattr(_periscope, owner)) if not name.startswith("_")}
        assert members == {name.split(".")[1] for name in names if name.startswith(f"{owner}.") and "._" not in name}


def test_the_package_needs_numpy_alone() -> None:
    code = "import sys, periscope; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "periscope" in loaded and not {"polars", "pyarrow", "pandas", "scipy", "matplotlib", "xarray", "tqdm"} & set(loaded)


def test_the_page_of_the_guide_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, campaign: Path) -> None:
    """All its Python, in order, in a folder with a campaign."""
    assert len(BLOCKS) >= 5
    (tmp_path / "my-campaign").symlink_to(campaign)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for number, block in enumerate(BLOCKS):
        exec(compile(block, f"python.md, block {number}", "exec"), names)
