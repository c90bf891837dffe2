"""Text that is not the project's own in LaTeX: it prints as it is written, at any place."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from helpers.latex import assert_tabular

from viewnet.tables.latex import boxed, escape, line, measured, tabular

LABELS = [
    "[Ours] <0.5> | v2",
    "*best*",
    "  [indented",
    "\\input{x} \\\\[1cm]",
    "50 % & a_b #1 {x} $y$ ~^",
    "v1--v2 '' `` ---",
    "two\nlines\n\nand a paragraph",
    'a "quote" é ß',
]


def test_a_label_at_the_start_of_a_row_is_no_option_of_the_row_before():
    assert escape("[Ours] <0.5> | v2") == r"{[}Ours{]} \textless{}0.5\textgreater{} \textbar{} v2"
    assert escape("*best*") == "{*}best*"
    table = tabular("lr", [line([escape(label), "1"]) for label in LABELS], LABELS)
    assert_tabular(table)
    assert not re.search(r"\\\\\s*[\[*]", table + boxed(LABELS))


def test_no_two_characters_become_another_one():
    assert escape("v1---v2 '' ``") == "v1-{}-{}-v2 '{}' `{}`"
    assert escape("a-b 'c' `d`") == "a-b 'c' `d`"


def test_a_text_of_several_lines_stays_in_its_cell():
    assert escape("two\n\nlines\tand") == "two  lines and"


def test_labels_compile(tmp_path: Path):
    rows = [{"row": label, "category": "car", "metric": "acc30", "measured": 1.0} for label in LABELS]
    alone = tabular("l", [line([escape(label)]) for label in LABELS])
    tables = [measured(pd.DataFrame(rows), ["acc30"], LABELS[0]), boxed(LABELS), alone]
    packages = "\\documentclass{article}\\usepackage[utf8]{inputenc}\\usepackage{booktabs}\\begin{document}\n"
    (tmp_path / "a.tex").write_text(packages + "\n\n".join(tables) + "\n\\end{document}\n", encoding="utf-8")
    if not (pdflatex := shutil.which("pdflatex")):
        pytest.skip("no pdflatex on this machine")
    command = [pdflatex, "-halt-on-error", "-interaction=nonstopmode", "a.tex"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout[-2000:]
