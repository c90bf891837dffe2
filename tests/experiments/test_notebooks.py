"""The committed notebooks have the agreed form, and the command that runs them checks parameters first."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import nbformat
import papermill
import pytest

from viewnet import cli
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment, notebooks
from viewnet.experiments.parameters import PARAMETERS
from viewnet.experiments.request import DESIGNS, TAKES, accepted

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
PATHS = sorted(FOLDER.glob("*.ipynb"))
TOUR = FOLDER / "quickstart.ipynb"
"""Shows small steps as code; the others show committed tables and figures, by as little code as can be."""
WRITTEN = ("your_method", "method")
"""The cell in which a reader writes code: the only one with a class."""


def code_cells(path: Path) -> list[nbformat.NotebookNode]:
    return [cell for cell in notebooks.read(path).cells if cell.cell_type == "code"]


def tags(cell: nbformat.NotebookNode) -> set[str]:
    return set(cell.metadata.get("tags", []))


def test_every_design_has_a_notebook_and_every_notebook_a_design():
    assert {path.stem for path in PATHS} == set(DESIGNS) == set(TAKES)


@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.stem)
class TestForm:
    def test_title_then_one_cell_of_parameters(self, path):
        cells = notebooks.read(path).cells
        assert cells[0].cell_type == "markdown" and cells[0].source.startswith("# ")
        assert [cell.id for cell in code_cells(path) if "parameters" in tags(cell)] == ["parameters"]

    def test_its_parameters_are_those_of_the_table(self, path):
        (cell,) = (cell for cell in code_cells(path) if "parameters" in tags(cell))
        # Nothing is in the cell that papermill would not see as a parameter.
        declared = papermill.inspect_notebook(str(path))
        assert tuple(declared) == accepted(path.stem) and len(ast.parse(cell.source).body) == len(declared)
        for name, found in declared.items():
            assert found["help"] == PARAMETERS[name].help and len(found["help"]) > 10
            assert ast.literal_eval(found["default"]) == PARAMETERS[name].default
            assert found["inferred_type_name"] == type(PARAMETERS[name].default).__name__
        assert cell.source.splitlines() == notebooks.parameters(path.stem)

    def test_defaults_are_valid(self, path, monkeypatch):
        monkeypatch.delenv("VIEWNET_PROFILE", raising=False)
        cell: dict[str, object] = {"something": "else"}
        exec("\n".join(notebooks.parameters(path.stem)), cell)
        assert experiment(path.stem, cell) == experiment(path.stem) and experiment(path.stem).label == ""

    def test_nothing_of_a_machine_is_in_it(self, path):
        text = path.read_text()
        assert not re.search(r"/(work|tmp|opt|root|home|Users)/", text)
        book = notebooks.read(path)
        assert set(book.metadata) == {"kernelspec"} and book.metadata.kernelspec.name == "python3"
        for cell in book.cells:
            assert set(cell.metadata) <= {"tags"}


@pytest.mark.parametrize("path", [path for path in PATHS if path != TOUR], ids=lambda p: p.stem)
class TestFormOfThoseWithEvidence:
    def test_evidence_first_and_one_live_cell_last(self, path):
        code = code_cells(path)
        assert code[0].source.startswith(f'from viewnet.experiments import show\n\nshow.evidence("{path.stem}"')
        assert f'show.live(experiment("{path.stem}", globals())' in code[-1].source

    def test_the_live_cell_alone_is_not_compared_and_has_nothing_stored(self, path):
        *compared, live = code_cells(path)
        assert tags(live) == {notebooks.LIVE} and not live.outputs and live.execution_count is None
        assert not any(notebooks.LIVE in tags(cell) for cell in compared)
        assert [cell.execution_count for cell in compared] == list(range(1, len(compared) + 1))

    def test_it_is_thin(self, path):
        code = code_cells(path)
        assert len(code) <= 5
        for cell in code:
            assert (
                len(cell.source.splitlines()) <= (20 if (path.stem, cell.id) == WRITTEN else 3)
                or cell.id == "parameters"
            )
            for node in ast.walk(ast.parse(cell.source)):
                assert not isinstance(node, (ast.For, ast.While, ast.Try, ast.If, ast.Assert))
                if (path.stem, cell.id) != WRITTEN:
                    assert not isinstance(node, (ast.FunctionDef, ast.ClassDef))


class TestFormOfTheTour:
    def test_every_cell_is_short_and_every_output_is_stored_and_compared(self):
        code = code_cells(TOUR)
        assert len(code) <= 12 and all(len(cell.source.splitlines()) < 10 for cell in code)
        assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
        assert not any(notebooks.LIVE in tags(cell) for cell in code)
        assert not any(output.output_type == "error" for cell in code for output in cell.outputs)
        assert sum(any("image" in kind for o in cell.outputs for kind in o.get("data", ())) for cell in code) >= 5

    def test_its_parameters_are_checked(self):
        request = experiment("quickstart", image="street.jpg", box="40, 60,380,250.5", model="KEY")
        assert (request.image, request.box, request.model) == (Path("street.jpg"), (40, 60, 380, 250.5), "KEY")
        for box in ("40,60,380", "40,60,380,250,1", "left,60,380,250"):
            with pytest.raises(ViewnetError, match=f"^box '{box}': expected left, top, right, bottom"):
                experiment("quickstart", box=box)


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


def test_values_are_text_and_nothing_is_guessed(root):
    request = notebooks.check("table1_shapenet", [("workers", "2"), ("categories", "car,chair"), ("seeds", "3")])
    assert (request.workers, request.categories, request.seeds) == (2, ("car", "chair"), (0, 1, 2))
    with pytest.raises(ViewnetError, match=r"^start 003: "):
        notebooks.check("table4_freiburg", [("start", "003")])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "sede", "3"], "unknown parameter of table1_shapenet 'sede': choose one of profile, recipe, rows"),
        (["-p", "workers", "two"], "workers 'two': expected a whole number"),
        (["-p", "profile", "huge"], "unknown profile 'huge': choose one of smoke, tiny, pocket, small, paper"),
        (["-p", "categories", "02958343"], "unknown category '02958343': choose one of aeroplane"),
        (["-p", "seeds", "1", "-p", "seeds", "2"], "parameter seeds is given twice"),
        (["-p", "data_root", "nowhere"], "data_root nowhere: no such folder"),
        (["--refresh", "-p", "seeds", "2"], "--refresh takes neither -p nor --output"),
        (["--refresh", "--dry-run"], "--refresh takes neither -p nor --output nor --dry-run"),
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
    assert 'profile: str = "default"  # smoke, tiny, pocket, small, paper' in capsys.readouterr().out


def test_a_notebook_is_run_with_its_parameters_and_the_copy_kept_apart(root, capsys):
    path = write(root, "architecture", 'profile: str = "paper"  # sizes', "print(profile + '!')")
    before = path.read_bytes()
    assert cli.main(["notebook", "architecture", "-p", "profile", "smoke"]) == 0
    copy = root / "runs" / "notebooks" / "architecture-smoke.ipynb"
    assert capsys.readouterr().out == f"{copy}\n"
    assert notebooks.read(copy).cells[-1].outputs[0].text == "smoke!\n"
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


def test_a_copy_goes_into_a_folder_that_is_there(root, monkeypatch):
    write(root, "architecture", 'profile: str = "paper"  # sizes')
    monkeypatch.setattr("papermill.execute_notebook", lambda *given, **options: None)
    assert notebooks.run("architecture", output=root) == root / "architecture.ipynb"
    assert notebooks.run("architecture", output=root / "copy.ipynb") == root / "copy.ipynb"


def test_refreshing_writes_parameters_and_runs_all_but_the_live_cell(root):
    cells = ['profile: str = "tiny"  # old', "import sys\nprint('1/2', file=sys.stderr)\nprint(profile)", "1 / 0"]
    path = write(root, "architecture", *cells)
    book = notebooks.read(path)
    book.cells[2].metadata["tags"] = [notebooks.LIVE]
    book.cells[2].outputs = [nbformat.v4.new_output("stream", text="90.0")]
    nbformat.write(book, path)
    assert notebooks.refresh(["architecture"]) == [path]
    kept = notebooks.read(path)
    assert [cell.execution_count for cell in kept.cells] == [1, 2, None]
    assert kept.cells[0].source.splitlines() == notebooks.parameters("architecture")
    assert [output.text for output in kept.cells[1].outputs] == ["default\n"] and not kept.cells[2].outputs


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "given"), [("table4_freiburg", {"start": 12345678901}), ("table1_shapenet", {"data_root": None})]
)
def test_papermill_itself_ends_in_the_same_line(name, given, tmp_path):
    (parameter, value) = next(iter(given.items()))
    with pytest.raises(papermill.PapermillExecutionError) as raised:
        papermill.execute_notebook(notebooks.find(name), tmp_path / "out.ipynb", given, progress_bar=False)
    assert raised.value.ename == "ViewnetError"
    assert raised.value.evalue.startswith(f"{parameter} {value}: expected text") and "\n" not in raised.value.evalue
