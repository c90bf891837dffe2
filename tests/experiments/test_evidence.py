"""What is stored in the notebooks is what the committed files say, and a number that is not theirs is found."""

from __future__ import annotations

import base64
import copy
import functools
import itertools
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd
import pytest

from viewnet import paths
from viewnet.experiments import notebooks, show
from viewnet.experiments.request import DESIGNS
from viewnet.tables import claims, definitions, kept_predictions, plots
from viewnet.tables.columns import METRICS

WITH_EVIDENCE = [name for name in DESIGNS if name != "quickstart"]
"""The other one is a tour that runs: its outputs are compared by nbval."""
CALL = re.compile(r'show\.evidence\("(\w+)"(?:, "([\w-]+)")?\)')
TABLES = paths.part("paper_tables")
NONE = "\u2013"
"""In place of a number that is not there."""
Parts = list[tuple[str, str]]
"""MIME type and content of each part of what a notebook shows."""


class Cells(HTMLParser):
    """The rows of an HTML table, as text."""

    def __init__(self, text: str):
        super().__init__()
        self.rows: list[list[str]] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data):
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data.replace("\n", "")


def stored(book: nbformat.NotebookNode) -> dict[tuple[str, str], Parts]:
    """Arguments of a cell that shows evidence -> what is stored below it, adjoining text joined."""
    found: dict[tuple[str, str], Parts] = {}
    for cell in book.cells:
        if cell.cell_type == "code" and (call := CALL.search(cell.source)):
            parts = found[call[1], call[2] or ""] = []
            for output in cell.outputs:
                if output.output_type == "stream":
                    parts.append(("text/plain", output.text))
                else:
                    (kind,) = {*output.data} - {"text/plain"}
                    parts.append((kind, output.data[kind].replace("\n", "") if "image" in kind else output.data[kind]))
    return found


@functools.cache
def committed(name: str, setting: str) -> Parts:
    return [(part.kind, part.content) for part in show.committed(name, setting)]


def wrong(book: nbformat.NotebookNode, name: str) -> list[str]:
    """The parts of a notebook that the committed files of its own name do not say."""
    found = []
    for (of, setting), parts in stored(book).items():
        expected = joined(committed(of, setting)) if of == name else []
        pairs = itertools.zip_longest(joined(parts), expected)
        found += [f"{of} {setting}: {here}" for here, there in pairs if here != there]
    return found


def joined(parts: Parts) -> Parts:
    """Parts with adjoining text in one, as kernels store it."""
    groups = itertools.groupby(parts, key=lambda part: part[0])
    return [
        each for kind, group in groups
        for each in ([(kind, "".join(text for _, text in group))] if kind == "text/plain" else group)
    ]  # fmt: skip


@pytest.mark.parametrize("name", WITH_EVIDENCE)
def test_every_stored_part_is_that_of_the_committed_files(name):
    book = notebooks.read(notebooks.find(name))
    assert ("text/plain", "") not in stored(book).values() and all(stored(book).values())
    assert wrong(book, name) == []


def plant(parts: list[nbformat.NotebookNode], kind: str, old: str, new: str) -> None:
    """Change the first of the outputs of a kind that has `old`."""
    for output in parts:
        text = output.get("text", "") if kind == "text" else output.get("data", {}).get(kind, "")
        if old in text:
            (output if kind == "text" else output.data)[kind] = text.replace(old, new, 1)
            return
    raise AssertionError(f"{old} is not there")


@pytest.mark.parametrize(
    ("name", "kind", "pattern"),
    [
        ("table1_shapenet", "text/html", r"<span[^>]*>(\d+\.\d)"),  # a measured number
        ("table1_shapenet", "text/html", r'class="print"><?b?>?(\d+)'),  # a reported one
        ("table2_ablation", "text/html", r"<small>\[(\d+\.\d)"),  # an end of an interval
        ("table1_shapenet", "text", r"commits? (\w{7})"),
        ("recipe_ablation", "text", r"Acc@30: .*?(\d+\.\d)"),  # a difference
        ("figure3_azimuth", "image/png", r"iVBOR\w{9}(\w{12})"),
    ],
)
def test_a_planted_number_is_found(name, kind, pattern):
    book = copy.deepcopy(notebooks.read(notebooks.find(name)))
    outputs = [output for cell in book.cells for output in cell.get("outputs", ())]
    texts = [o.get("text", "") if kind == "text" else o.get("data", {}).get(kind, "") for o in outputs]
    found = next(match for text in texts if (match := re.search(pattern, text)))
    old = found[0]
    number = old.replace(found[1], found[1][:-1] + ("1" if found[1][-1] != "1" else "2"))
    plant(outputs, kind, old, number)
    assert len(wrong(book, name)) == 1


def test_numbers_of_another_notebook_are_found():
    book = notebooks.read(notebooks.find("table1_shapenet"))
    for cell in book.cells:
        cell.source = cell.source.replace('evidence("table1_shapenet")', 'evidence("table2_ablation")')
    assert wrong(book, "table1_shapenet")


@pytest.mark.parametrize("name", WITH_EVIDENCE)
def test_every_number_of_a_table_is_in_its_file(name):
    """Read from the HTML by this test, not by the code that wrote it."""
    for (_, setting), parts in stored(notebooks.read(notebooks.find(name))).items():
        own = [TABLES / setting / f"{name}.json", TABLES / setting / "novel_views.csv"]
        files = [path for path in own if path.stem == name and path.is_file()]
        files += sorted((TABLES / name / setting).glob("*.json"))
        tables = [text for kind, text in parts if kind == "text/html" and 'class="measured' in text]
        assert len(files) == len(tables)
        for path, text in zip(files, tables, strict=True):
            cells = json.loads(path.read_text())["cells"] if path.suffix == ".json" else read_csv(path)
            assert read_cells(text) == {
                (f"{c['row']} {c.get('supervision', '')}".strip(), METRICS[c["metric"]].page, c["category"]): shown(c)
                for c in cells
            }


def read_csv(path: Path) -> list[dict]:
    frame = pd.read_csv(path).assign(printed="").astype(object)
    return frame.where(frame.notna(), None).to_dict("records")


def shown(cell: dict) -> tuple[str, ...]:
    digits = METRICS[cell["metric"]].page_digits
    if cell["measured"] is None:
        return (cell["printed"] or NONE, NONE)
    number, low, high = (math_text(cell[name], digits) for name in ("measured", "low", "high"))
    number = f"({number})" if cell.get("degenerate") else number
    return (cell["printed"] or NONE, f"{number} [{low}, {high}]" if low else number)


def math_text(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def read_cells(html: str) -> dict[tuple[str, str, str], tuple[str, ...]]:
    rows = Cells(html).rows
    categories = [text for text in rows[0] if text]
    reported = "print" in rows[1]
    metric, found = "", {}
    for row in rows[2 if reported else 1 :]:
        if len(row) == 1:
            metric = row[0]
            continue
        values = [text.strip() for text in row[1:]]
        pairs = zip(values[::2], values[1::2], strict=True) if reported else ((NONE, value) for value in values)
        found |= {(row[0], metric, c): pair for c, pair in zip(categories, pairs, strict=True)}
    return found


@pytest.mark.slow
def test_definitions_of_cars_are_those_of_the_predictions_beside_them():
    files = sorted(TABLES.rglob("*_definitions.csv"))
    assert files
    for path in files:
        table = kept_predictions.read(path.with_name(path.name.replace("_definitions.csv", ".json")))
        cars = replace(table, entries=tuple(entry for entry in table.entries if entry.category == "car"))
        kept = pd.read_csv(path, index_col=["row", "category"]).query("category == 'car'")
        again = definitions.by_definition(cars)
        pd.testing.assert_frame_equal(kept, again, check_dtype=False, atol=0.11)


def test_verdicts_stand_below_the_evidence_that_they_read():
    judged = [each for each in claims.judge(TABLES, ["novel_views.csv"])]
    assert len(judged) > 1
    assert show.committed("novel_views")[-1].content == "".join(f"{each}\n" for each in judged)
    assert not any("Claim " in part.content for part in show.committed("recipe_ablation") if part.kind == "text/plain")


def test_without_files_a_line_says_so(monkeypatch, tmp_path):
    (tmp_path / "paper_tables").mkdir()
    monkeypatch.setenv("VIEWNET_ROOT", str(tmp_path))
    (part,) = show.committed("table1_shapenet", "tiny-car")
    assert part.content.startswith("paper_tables/tiny-car has nothing of this notebook")


def test_figures_say_of_which_runs_they_are(tmp_path, capsys):
    logs = pd.DataFrame({"row": "ViewNet", "recipe": "paper", "category": "car", "seed": 0, "targets": [64, 128]})
    logs = logs.assign(val_accuracy=[1.0, 2.0])
    files = plots.save(plots.training_curves(logs), tmp_path, "training_curves", "made-up runs; commit abcdef0")
    first, image = show.drawn("training_curves", files)
    assert first.content == "made-up runs; commit abcdef0\n"
    assert base64.b64decode(image.content) == files[0].read_bytes()
    plots.save(plots.training_curves(logs), tmp_path, "training_curves")
    assert show.drawn("training_curves", files)[0].content == f"{show.UNKNOWN}\n"


def test_tables_without_predictions_have_no_verdict(tmp_path):
    source = TABLES / "recipe_ablation.json"
    copied = tmp_path / source.name
    copied.write_bytes(source.read_bytes())
    assert not kept_predictions.read(copied).verdict()
    assert not any("beside" in part.content for part in show.drawn("recipe_ablation", [copied]))
    cells = kept_predictions.read(copied).cells
    np.testing.assert_array_equal(cells["measured"], [c["measured"] for c in json.loads(copied.read_text())["cells"]])


def test_what_a_run_makes_is_shown_from_its_files(monkeypatch, capsys):
    files = [TABLES / "table1_shapenet.json"]
    monkeypatch.setattr(show, "write", lambda request, submissions: files)
    show.live(type("Request", (), {"name": "table1_shapenet"})())
    text = capsys.readouterr().out
    assert text.startswith("built-in models, ") and text.endswith(f"files: {Path(files[0])}\n")
