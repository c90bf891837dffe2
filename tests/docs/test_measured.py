"""Tables and numbers of the documents are rendered from paper_tables/, and those that stand there are up to date."""

from __future__ import annotations

import re
import tomllib

import pytest
from cogapp import Cog
from helpers.documents import PAGES, ROOT, page, script

measured = script("measured")


@pytest.fixture
def cog(monkeypatch):
    """What `make numbers` runs, in this process; its exit code."""
    monkeypatch.chdir(ROOT)
    options = ["-P", "-I", "docs", "-p", "from measured import *", "--verbosity=1"]
    return lambda *arguments: Cog().main(["cog", *options, *arguments])


def test_no_number_differs_from_its_file(cog):
    assert cog("--check", "--diff", *(document.name for document in PAGES)) == 0


def test_a_number_that_differs_is_noticed(cog, tmp_path):
    path = tmp_path / "page.md"
    path.write_text(
        "<!-- [[[cog print(value('trust/fuzz.csv', 'cases', reader='CAD model')) ]]] -->\n<!-- [[[end]]] -->\n"
    )
    assert cog("-r", str(path)) == 0
    assert cog("--check", str(path)) == 0
    path.write_text(re.sub(r"^\d+$", "7", path.read_text(), flags=re.MULTILINE))
    assert cog("--check", str(path)) != 0


@pytest.fixture
def tables(tmp_path, monkeypatch):
    monkeypatch.setattr(measured, "TABLES", tmp_path)
    (tmp_path / "scores.csv").write_text(
        "row,category,metric,printed,measured,low,high,degenerate\n"
        "ViewNet,car,acc30,89,89.66,86.8,92.5,False\n"
        "ViewNet,car,median,6.7,5.9863,,,False\n"
        "Older,car,acc30,87,,,,\n"
        "Older,car,median,,1.0,0.5,2,False\n"
        "Constant,car,acc30,9,3.2,3.0,3.4,True\n"
        "Constant,car,median,,88.1,87,89,True\n"
    )


def test_a_score_has_its_interval_and_what_the_paper_reports(tables):
    assert measured.score("scores.csv", "ViewNet", "car", "acc30") == "89.7 [86.8, 92.5] (89)"
    assert measured.score("scores.csv", "ViewNet", "car", "acc30", digits=0, reported=False) == "90 [87, 92]"
    assert measured.score("scores.csv", "ViewNet", "car", "median") == "6.0 (6.7)"
    assert measured.score("scores.csv", "Older", "car", "acc30") == "- (87)"
    assert measured.score("scores.csv", "Older", "car", "median", interval=False) == "1.0"


def test_a_score_without_a_determined_alignment_is_not_shown(tables):
    assert measured.score("scores.csv", "Constant", "car", "acc30") == "n.d. (9)"
    assert measured.score("scores.csv", "Constant", "car", "median") == "n.d."


def test_a_table_has_a_row_for_each_name_and_a_column_for_each_score(tables):
    assert measured.scores("scores.csv", {"ours": "ViewNet"}, ["car"], ["acc30"]).splitlines() == [
        "",
        "|  | car: Acc@30, % |",
        "| --- | --- |",
        "| ours | 89.7 [86.8, 92.5] (89) |",
    ]
    assert "| Older |" in measured.scores("scores.csv", None, ["car"])


def test_a_name_that_is_not_there_is_an_error(tables):
    with pytest.raises(ValueError, match="0 rows for ViewNet, boat, acc30"):
        measured.score("scores.csv", "ViewNet", "boat", "acc30")
    with pytest.raises(ValueError, match=r"2 rows with .*, expected one"):
        measured.value("scores.csv", row="ViewNet")
    with pytest.raises(ValueError, match="another number of cells"):
        measured.markdown(["a", "b"], [[1]])


def test_the_version_is_the_same_everywhere():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE) == [version]
    assert version in page("CHANGELOG.md").text
