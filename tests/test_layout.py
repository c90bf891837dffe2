"""The layout of the tests: a folder for each room, shared code in helpers/, nothing private of the package."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
PACKAGE = TESTS.parent / "viewnet"
FILES = sorted(path for path in TESTS.rglob("*.py") if path != Path(__file__).resolve())
BESIDE = {"docs", "helpers", "trust", "web"}
"""Folders that belong to no room."""
PRIVATE = re.compile(r"_(?!_)\w*")


def names(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Module, and name of it, for every import (an empty name for `import module`)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.module or "", alias.name) for alias in node.names)


def imported_tests(source: str) -> list[str]:
    """Test modules that a module imports."""
    return [module for module, _ in names(ast.parse(source)) if module.split(".")[-1].startswith("test_")]


def private_names(source: str) -> list[str]:
    """Private names of the package that a module imports, reads from its modules or replaces."""
    tree = ast.parse(source)
    of_package = [(module, name) for module, name in names(tree) if module.split(".")[0] == "viewnet"]
    found = [f"{module}.{name}" for module, name in of_package]
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    modules = {
        alias.asname or alias.name
        for node in imports
        if (node.module or "").split(".")[0] == "viewnet"
        for alias in node.names
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            whole = ast.unparse(node)
            if whole.split(".")[0] in modules or whole.startswith("viewnet."):
                found.append(whole)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and re.match(r"viewnet[\w.]+$", node.value):
            found.append(node.value)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr") and len(node.args) > 1:
            target, name = node.args[:2]
            if ast.unparse(target).split(".")[0] in modules and isinstance(name, ast.Constant):
                found.append(f"{ast.unparse(target)}.{name.value}")
    return [name for name in found if any(PRIVATE.fullmatch(part) for part in name.split("."))]


def test_every_room_has_its_folder_and_no_other_is_there():
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    folders = {path.name for path in TESTS.iterdir() if path.is_dir() and list(path.glob("*.py"))}
    assert folders - BESIDE == rooms


def test_tests_lie_in_folders_but_for_those_of_the_root():
    roots = {f"test_{path.stem}.py" for path in PACKAGE.glob("*.py")} | {Path(__file__).name, "test_rooms.py"}
    assert {path.name for path in TESTS.glob("test_*.py")} <= roots


def test_only_the_folder_of_tests_is_searched_for_modules():
    options = tomllib.loads((TESTS.parent / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    assert options["pythonpath"] == ["tests"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(TESTS).as_posix())
def test_a_module_imports_no_test_and_nothing_private(path):
    source = path.read_text(encoding="utf-8")
    assert imported_tests(source) == []
    assert private_names(source) == []


def test_what_is_private_is_noticed():
    source = (
        "import viewnet.config\nfrom viewnet.data import store as kept, _hidden\nfrom test_store import f\n"
        "kept._write()\nviewnet.config._x\nmonkeypatch.setattr(kept, '_read', f)\n"
        "monkeypatch.setattr('viewnet.cli._main', f)\nkept.write.__name__\nself._x\nkept.open()\n"
    )
    assert sorted(private_names(source)) == [
        "kept._read",
        "kept._write",
        "viewnet.cli._main",
        "viewnet.config._x",
        "viewnet.data._hidden",
    ]
    assert imported_tests(source) == ["test_store"]
