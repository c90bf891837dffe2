"""Public classes and functions have docstrings that name the errors they raise, and the examples in them run."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import re
from collections.abc import Iterator

import pytest
from helpers.documents import PUBLIC, dotted

SHOWN = {
    "viewnet.data.catalogue",
    "viewnet.estimator.viewpoint_estimator",
    "viewnet.estimator.viewpoints",
    "viewnet.evaluation.alignment",
    "viewnet.evaluation.evaluate",
    "viewnet.evaluation.metrics",
    "viewnet.evaluation.predictions",
    "viewnet.evaluation.run",
    "viewnet.evaluation.submitted_predictions",
    "viewnet.experiments",
    "viewnet.experiments.own_method",
    "viewnet.geometry",
    "viewnet.model.volume",
    "viewnet.recipes",
}
"""Modules that a user's own code calls: they have examples."""
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


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
    return missing + [
        name
        for name, node in public(tree.body)
        if not ast.get_docstring(node) and node.name not in ("forward", "backward")  # their class describes them
    ]


def silent_errors(source: str) -> list[str]:
    """Functions that raise ViewnetError and do not say so; constructors say it in their class."""
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
def test_everything_public_has_a_docstring_that_names_its_errors(path):
    source = path.read_text(encoding="utf-8")
    assert undocumented(source) == []
    assert silent_errors(source) == []


def test_what_is_missing_is_found():
    source = (
        "def f():\n    raise ViewnetError('x')\nclass C:\n    def g(self):\n        '''Told.'''\n"
        "    def __init__(self):\n        raise ViewnetError('x')\n    def _h(self): ...\n"
    )
    assert undocumented(source) == ["the module", "f", "C"]
    assert silent_errors(source) == ["f", "C"]
    assert silent_errors(source.replace("def f():", "def f():\n    '''Raises ViewnetError.'''")) == ["C"]


EXAMPLES = [dotted(path) for path in PUBLIC if ">>> " in path.read_text(encoding="utf-8")]


def test_modules_that_users_call_have_examples():
    assert set(EXAMPLES) >= SHOWN


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_run(name, tmp_path, monkeypatch):
    for variable in ("DATA", "RUNS", "TABLES"):
        monkeypatch.setenv(f"VIEWNET_{variable}", str(tmp_path))
    module = importlib.import_module(name)
    assert "+SKIP" not in inspect.getsource(module)
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0
