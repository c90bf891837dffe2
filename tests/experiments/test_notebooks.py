"""The committed notebooks have the agreed form, and the command that runs them checks parameters first."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import nbformat
import pytest

from viewnet import cli
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment, notebooks
from viewnet.experiments.request import DESIGNS

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
PATHS = sorted(FOLDER.glob("*.ipynb"))
IGNORED = "nbval-ignore-output"
MEASURED = {"run", "table", "measured", "gain", "difference", "constant", "definitions", "nearness"}
"""Cells whose outputs depend on training: the only ones that are not compared."""
WRITTEN = {("your_method", "method")}
"""Cells in which a reader writes code: the only ones with a class of their own."""


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def code_cells(path: Path) -> list[nbformat.NotebookNode]:
    return [cell for cell in read(path).cells if cell.cell_type == "code"]


def tags(cell: nbformat.NotebookNode) -> set[str]:
    return set(cell.metadata.get("tags", []))


def test_every_design_has_a_notebook_and_every_notebook_a_design():
    assert {path.stem for path in PATHS} == set(DESIGNS)


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
class TestForm:
    def test_title_then_parameters_then_a_checked_request(self, path):
        cells = read(path).cells
        assert cells[0].cell_type == "markdown"
        assert cells[0].source.startswith("# ")
        code = code_cells(path)
        assert tags(code[0]) == {"parameters"}
        assert not any("parameters" in tags(cell) or "injected-parameters" in tags(cell) for cell in code[1:])
        assert f'"{path.stem}"' in code[1].source.replace("\n    ", "")
        assert "experiment(" in code[1].source

    def test_every_parameter_has_a_type_and_a_comment_and_is_used(self, path):
        declared = notebooks.parameters(path)
        assert declared
        for name, found in declared.items():
            assert found["inferred_type_name"] in ("str", "int"), name
            assert len(found["help"]) > 10, name
            assert re.search(rf"\b{name}\b", code_cells(path)[1].source), name
        # Nothing is in the cell that papermill would not see as a parameter.
        assert len(ast.parse(code_cells(path)[0].source).body) == len(declared)

    def test_defaults_are_valid(self, path, monkeypatch):
        monkeypatch.delenv("VIEWNET_PROFILE", raising=False)
        values = {n: ast.literal_eval(found["default"]) for n, found in notebooks.parameters(path).items()}
        values.pop("seed", None)
        assert experiment(path.stem, **values).label == ""

    def test_outputs_are_kept_in_order_and_whole(self, path):
        code = code_cells(path)
        assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
        for cell in code:
            for output in cell.outputs:
                assert output.output_type != "error"
                assert output.get("name") != "stderr"
        assert sum(bool(cell.outputs) for cell in code) >= len(code) - 1

    def test_only_what_was_trained_goes_uncompared(self, path):
        for cell in code_cells(path):
            assert (IGNORED in tags(cell)) == (cell.id in MEASURED), cell.id
            assert tags(cell) <= {"parameters", IGNORED}

    def test_it_is_thin(self, path):
        code = code_cells(path)
        assert len(code) <= 12
        for cell in code:
            for node in ast.walk(ast.parse(cell.source)):
                assert not isinstance(node, (ast.For, ast.While, ast.Try))
                if (path.stem, cell.id) not in WRITTEN:
                    assert not isinstance(node, (ast.FunctionDef, ast.ClassDef))
                else:
                    assert len(cell.source.splitlines()) <= 20
        assert any("assert " in cell.source for cell in code)

    def test_nothing_of_a_machine_is_in_it(self, path):
        text = path.read_text()
        assert not re.search(r"/(work|tmp|opt|root|home|Users)/", text)
        assert "papermill" not in read(path).metadata
        assert read(path).metadata.kernelspec.name == "python3"
        for cell in read(path).cells:
            assert set(cell.metadata) <= {"tags"}


def write(folder: Path, name: str, *sources: str) -> Path:
    cells = [nbformat.v4.new_code_cell(source) for source in sources]
    cells[0].metadata["tags"] = ["parameters"]
    spec = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    path = folder / "notebooks" / f"{name}.ipynb"
    path.parent.mkdir(exist_ok=True)
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata=spec), path)
    return path


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_ROOT", str(tmp_path))
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.delenv("VIEWNET_PROFILE", raising=False)
    return tmp_path


def test_values_get_the_declared_types_and_nothing_is_guessed(root):
    source = 'profile: str = "default"\ncategories: str = "all"\nworkers: int = 0\nseeds: str = "1"\nother: str = ""'
    path = write(root, "table1_shapenet", source)
    given, request = notebooks.check(
        path, [("workers", "2"), ("categories", "car,chair"), ("seeds", "3"), ("other", "003"), ("profile", "smoke")]
    )
    assert given == {"workers": 2, "categories": "car,chair", "seeds": "3", "other": "003", "profile": "smoke"}
    assert request.categories == ("car", "chair")
    assert request.seeds == (0, 1, 2)
    assert request.workers == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "sede", "3"], "table1_shapenet 'sede'"),
        (["-p", "workers", "two"], "parameter workers 'two'"),
        (["-p", "profile", "huge"], "unknown profile 'huge'"),
        (["-p", "categories", "02958343"], "unknown category '02958343'"),
        (["-p", "seeds", "1", "-p", "seeds", "2"], "parameter seeds is given twice"),
        (["-p", "data_root", "nowhere"], "data_root nowhere: no such folder"),
        (["--refresh", "-p", "seeds", "2"], "--refresh takes neither -p nor --output"),
        (["-o", str(FOLDER / "table1_shapenet.ipynb")], "is the notebook itself"),
    ],
)
def test_problems_are_told_in_one_line_before_a_kernel_starts(arguments, message, capsys, monkeypatch):
    monkeypatch.setattr("papermill.execute_notebook", lambda *a, **k: pytest.fail("a kernel was started"))
    assert cli.main(["notebook", "table1_shapenet", *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("viewnet: ")
    assert message in shown.err
    assert shown.err.count("\n") == 1


def test_unknown_notebooks_are_told(capsys):
    assert cli.main(["notebook", "table9"]) == 2
    assert "unknown notebook 'table9'" in capsys.readouterr().err


def test_parameters_are_listed(capsys):
    assert cli.main(["notebook", "table1_shapenet.ipynb", "--parameters"]) == 0
    assert 'profile = "default"  (str) smoke, tiny, small or paper' in capsys.readouterr().out


def test_a_notebook_is_run_with_its_parameters_and_the_copy_kept_apart(root, capsys):
    path = write(root, "architecture", 'profile: str = "paper"  # sizes', "print(profile + '!')")
    before = path.read_bytes()
    assert cli.main(["notebook", "architecture", "-p", "profile", "smoke"]) == 0
    copy = root / "runs" / "notebooks" / "architecture-smoke.ipynb"
    assert capsys.readouterr().out == f"{copy}\n"
    assert read(copy).cells[-1].outputs[0].text == "smoke!\n"
    assert path.read_bytes() == before


def test_a_viewnet_error_in_the_kernel_is_told_in_one_line(root, capsys):
    write(
        root,
        "architecture",
        "profile: str = 'paper'",
        "from viewnet.errors import ViewnetError",
        "raise ViewnetError('x: y')",
    )
    assert cli.main(["notebook", "architecture"]) == 2
    assert "viewnet: x: y\n" in capsys.readouterr().err


class NoSuchKernel(Exception):
    """Named as Jupyter's."""


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (KeyError("a"), r"^architecture failed: KeyError: 'a' \(see .*architecture\.ipynb\)$"),
        (OSError("first line\nsecond"), r"^architecture failed: OSError: first line \(see "),
        (NoSuchKernel("python3"), "pip install ipykernel"),
    ],
)
def test_other_failures_name_the_copy_to_look_at(root, monkeypatch, error, message):
    write(root, "architecture", 'profile: str = "paper"  # sizes')

    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr("papermill.execute_notebook", fail)
    with pytest.raises(ViewnetError, match=message):
        notebooks.run("architecture")


def test_refreshing_keeps_outputs_and_nothing_of_the_machine(root):
    path = write(
        root,
        "architecture",
        'profile: str = "paper"  # sizes',
        "import sys\nprint('1/2', file=sys.stderr)\nprint(profile)",
    )
    assert notebooks.refresh("architecture") == path
    kept = read(path)
    assert [cell.execution_count for cell in kept.cells] == [1, 2]
    assert [output.text for output in kept.cells[1].outputs] == ["paper\n"]
    assert set(kept.metadata) == {"kernelspec"}
    assert all(set(cell.metadata) <= {"tags"} for cell in kept.cells)
