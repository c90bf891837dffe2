"""Whatever a reader can call says what it takes, gives and refuses, and the examples it shows are so."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.documents import ROOT, page

PACKAGE = ROOT / "viewnet"
PUBLIC = [path for path in sorted(PACKAGE.rglob("*.py")) if not path.name.startswith("_") or path.stem == "__init__"]
SHOWN = {
    "alignment",
    "config",
    "data_sets",
    "estimates",
    "estimator",
    "evaluate",
    "experiment",
    "geometry",
    "method",
    "metrics",
    "prediction_file",
    "predictions",
    "runs",
    "volume",
}
"""Modules that a reader's own code calls: they have examples."""
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def dotted(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def public(body: list[ast.stmt], within: str = "") -> Iterator[tuple[str, Definition]]:
    """Classes, functions and methods, by qualified name, without overloads: these have their function's docstring."""
    for node in body:
        if not isinstance(node, Definition) or node.name.startswith("_"):
            continue
        if not any(ast.unparse(decorator) == "overload" for decorator in node.decorator_list):
            yield within + node.name, node
        if isinstance(node, ast.ClassDef):
            yield from public(node.body, f"{within}{node.name}.")


def raised(function: ast.AST) -> set[str]:
    """The names of the exceptions that a function itself raises."""
    found = [node.exc for node in ast.walk(function) if isinstance(node, ast.Raise) and node.exc is not None]
    return {ast.unparse(error.func if isinstance(error, ast.Call) else error) for error in found}


def undocumented(source: str) -> list[str]:
    tree = ast.parse(source)
    missing = [] if ast.get_docstring(tree) else ["the module"]
    return missing + [name for name, node in public(tree.body) if not ast.get_docstring(node)]


def untold(source: str) -> list[str]:
    """What raises ViewnetError and does not say so; constructors say it in their class."""
    found = []
    for name, node in public(ast.parse(source).body):
        parts: list[ast.AST] = [node]
        if isinstance(node, ast.ClassDef):
            parts = [f for f in node.body if getattr(f, "name", "") in ("__init__", "__post_init__")]
        told = "ViewnetError" in (text := ast.get_docstring(node) or "") or re.search(r"[Ee]rrors as in", text)
        if not told and any("ViewnetError" in raised(part) for part in parts):
            found.append(name)
    return found


@pytest.mark.parametrize("path", PUBLIC, ids=dotted)
def test_everything_public_has_a_docstring_that_tells_its_errors(path):
    source = path.read_text(encoding="utf-8")
    assert undocumented(source) == []
    assert untold(source) == []


def test_what_is_missing_is_found():
    source = (
        "def f():\n    raise ViewnetError('x')\nclass C:\n    def g(self):\n        '''Told.'''\n"
        "    def __init__(self):\n        raise ViewnetError('x')\n    def _h(self): ...\n"
    )
    assert undocumented(source) == ["the module", "f", "C"]
    assert untold(source) == ["f", "C"]
    assert untold(source.replace("def f():", "def f():\n    '''Raises ViewnetError.'''")) == ["C"]


EXAMPLES = [dotted(path) for path in PUBLIC if ">>> " in path.read_text(encoding="utf-8")]


def test_modules_that_readers_call_have_examples():
    assert {f"viewnet.{name}" for name in SHOWN} <= set(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_are_so(name, tmp_path, monkeypatch):
    for variable in ("DATA", "RUNS", "TABLES"):
        monkeypatch.setenv(f"VIEWNET_{variable}", str(tmp_path))
    module = importlib.import_module(name)
    assert "+SKIP" not in inspect.getsource(module)
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0


def test_the_readme_lists_every_module_once():
    (table,) = [rows[1:] for rows in page("README.md").tables if rows[0][0] == "in viewnet/"]
    listed = [name for row in table for name in row[0].split()]
    folders = {f"{path.parent.name}/" for path in PACKAGE.glob("*/__init__.py")}
    modules = {path.stem for path in PACKAGE.glob("*.py") if not path.name.startswith("_")}
    assert sorted(listed) == sorted(folders | modules)
