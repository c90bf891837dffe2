"""viewnet tables: every notebook in turn; a failing one is reported, and the page is still written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from viewnet import cli, paths
from viewnet.errors import ViewnetError
from viewnet.experiments import notebooks
from viewnet.experiments.page import page
from viewnet.experiments.request import DESIGNS


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """Notebooks replaced by instant ones: name -> parameters; `table1_shapenet` fails."""
    for name in ("RUNS", "TABLES"):
        monkeypatch.setenv(f"VIEWNET_{name}", str(tmp_path / name.lower()))
    monkeypatch.delenv("VIEWNET_PROFILE", raising=False)
    monkeypatch.delenv("VIEWNET_CLUSTER", raising=False)
    found: dict[str, dict[str, str]] = {}

    def run(name, values=(), output=None):
        found[name] = dict(values)
        if name == "table1_shapenet":
            raise ViewnetError("1 of 6 runs failed: the loss is not finite")
        return Path("copies") / f"{name}.ipynb"

    monkeypatch.setattr(notebooks, "run", run)
    monkeypatch.setattr(page, "write", lambda folder: folder / "index.html")
    return found


def test_every_notebook_has_its_turn():
    assert sorted(notebooks.ORDER) == sorted(path.stem for path in paths.part("notebooks").glob("*.ipynb"))
    assert sorted(notebooks.ORDER) == sorted(DESIGNS)


def test_one_that_fails_is_told_and_the_others_go_on(ran, capsys, tmp_path):
    assert cli.main(["tables"]) == 1
    assert list(ran) == list(notebooks.ORDER)
    assert not any(ran.values())
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(ran) + 2
    assert lines[2].startswith("table1_shapenet: ") and lines[2].endswith(
        "s: failed: 1 of 6 runs failed: the loss is not finite"
    )
    assert lines[3].endswith("copies/table2_ablation.ipynb")
    assert lines[-2:] == [str(tmp_path / "tables" / "index.html"), f"1 of {len(ran)} notebooks failed: table1_shapenet"]


def test_parameters_go_to_those_that_take_them(ran, capsys):
    only = ["table2_ablation", "figure3_azimuth.ipynb", "architecture"]
    assert cli.main(["tables", "--only", *only, "--profile", "smoke", "--seeds", "3", "--json"]) == 0
    assert list(ran) == ["architecture", "table2_ablation", "figure3_azimuth"]
    assert ran["table2_ablation"] == {"profile": "smoke", "seeds": "3"}
    assert ran["figure3_azimuth"] == {"profile": "smoke"}  # it shows one seed
    assert ran["architecture"] == {}  # nothing is trained for it
    told = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in told["notebooks"]] == list(ran)
    assert told["notebooks"][1]["error"] is None and told["notebooks"][1]["copy"] == "copies/table2_ablation.ipynb"


def test_the_page_alone_runs_nothing(ran, capsys, tmp_path):
    assert cli.main(["tables", "--page"]) == 0
    assert not ran
    assert capsys.readouterr().out == f"{tmp_path / 'tables' / 'index.html'}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "table9"], "unknown notebook 'table9'"),
        (["--profile", "huge"], "unknown profile 'huge'"),
        (["--seeds", "none"], "seeds 'none': expected how many"),
        (["--page", "--profile", "smoke"], "--page cannot be combined"),
        (["--claims", "--seeds", "3"], "--claims cannot be combined"),
        (["--page", "--dry-run"], "--page cannot be combined"),
    ],
)
def test_what_cannot_be_run_is_said_before_anything_is(ran, arguments, message, capsys):
    assert cli.main(["tables", *arguments]) == 2
    assert capsys.readouterr().err.startswith(f"viewnet: {message}")
    assert not ran
