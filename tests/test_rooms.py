"""The rooms of the package: which may import which, how deep they lie, and how large their modules are."""

from __future__ import annotations

import functools
import graphlib
import subprocess
import sys
import tomllib
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "viewnet"
CONTRACTS = [
    contract["name"]
    for contract in tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
]
PLANTED = [
    ("rooms import in one direction", "runtime/files.py", "import viewnet.model.viewnet"),
    ("rooms import in one direction", "bench/report.py", "import viewnet.experiments"),
    ("rooms import in one direction", "training/train.py", "def f():\n    import viewnet.estimator"),
    ("rooms import in one direction", "training/train.py", "import viewnet.runs.run_store"),
    ("rooms import in one direction", "model/losses.py", "def f():\n    import viewnet.training.train"),
    ("rooms import in one direction", "evaluation/metrics.py", "import viewnet.training"),
    ("rooms import in one direction", "tables/table.py", "import viewnet.experiments.request"),
    (
        "rooms import in one direction",
        "bench/measure.py",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import viewnet.cli",
    ),
    ("rooms import in one direction", "cellar/shelf.py", "import viewnet.config"),
    ("data does not import model", "data/store.py", "import viewnet.model"),
    ("rooms import in one direction", "reference.py", "import viewnet.training.step"),
    ("the reference has networks, renderer and losses of its own", "reference.py", "import viewnet.model.losses"),
    ("neither the estimator nor tables import training", "estimator/hub.py", "import viewnet.training"),
    ("neither the estimator nor tables import training", "tables/table.py", "import viewnet.training.step"),
    ("no circle among siblings, in any room", "cad/car/__init__.py", "import viewnet.cad.chair"),
]
"""Contract, file and the import in it that breaks the contract. viewnet.cad.chair imports viewnet.cad.car."""


@functools.cache
def imports() -> dict[str, set[str]]:
    """Module -> modules of the package that it imports, anywhere in it."""
    graph = grimp.build_graph("viewnet", cache_dir=None)
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


def room(module: str) -> str:
    """A module's folder; the files at the root are one room, the command line's entry and the reference two more."""
    _, name, *within = f"{module}.".split(".")
    if name in ("cli", "__main__"):
        return "cli"
    if name == "reference":
        return name
    return name if (PACKAGE / name).is_dir() and within else ""


def lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the contracts over the package in a folder."""
    program = "from importlinter.cli import lint_imports_command as main; main()"
    options = ["--no-cache", "--config", str(ROOT / "pyproject.toml")]
    return subprocess.run([sys.executable, "-c", program, *options], cwd=folder, capture_output=True, text=True)


def test_the_package_keeps_its_contracts():
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout.partition("Broken contracts")[2]


@pytest.fixture
def skeleton(tmp_path) -> Path:
    """The package with modules that are empty, but for one import from chair to car."""
    for path in PACKAGE.rglob("*.py"):
        place = tmp_path / path.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
    (tmp_path / "viewnet" / "cad" / "chair" / "__init__.py").write_text("import viewnet.cad.car\n")
    assert lint_imports(tmp_path).returncode == 0
    return tmp_path


@pytest.mark.parametrize(("contract", "file", "code"), PLANTED)
def test_a_forbidden_import_breaks_its_contract(contract, file, code, skeleton):
    path = skeleton / "viewnet" / file
    path.parent.mkdir(exist_ok=True)
    (path.parent / "__init__.py").touch()
    path.write_text(code + "\n")
    result = lint_imports(skeleton)
    assert result.returncode == 1
    assert f"{contract} BROKEN" in result.stdout


def test_every_contract_is_tried():
    assert {contract for contract, _, _ in PLANTED} == set(CONTRACTS)


def test_no_modules_import_each_other_in_a_circle():
    assert list(graphlib.TopologicalSorter(imports()).static_order())


def test_rooms_lie_on_nine_levels_at_most():
    below: dict[str, set[str]] = {}
    for module, imported in imports().items():
        below.setdefault(room(module), set()).update({room(name) for name in imported} - {room(module)})
    levels: dict[str, int] = {}
    for name in graphlib.TopologicalSorter(below).static_order():
        levels[name] = 1 + max((levels[lower] for lower in below[name]), default=0)
    assert levels[""] == 1
    assert max(levels.values()) <= 9


def test_the_root_holds_nine_files_at_most():
    assert len(list(PACKAGE.glob("*.py"))) <= 9


def test_no_module_is_longer_than_400_lines():
    assert {str(path.relative_to(ROOT)): lines(path) for path in PACKAGE.rglob("*.py") if lines(path) > 400} == {}


def test_the_training_loop_is_short():
    assert lines(PACKAGE / "training" / "train.py") <= 250


def test_the_package_without_its_cad_models_and_peers_is_small():
    apart = {PACKAGE / "cad", PACKAGE / "peers"}
    assert sum(lines(path) for path in PACKAGE.rglob("*.py") if not apart & {*path.parents}) <= 27_108
