"""Tables as LaTeX (booktabs), to \\input as they stand."""

from __future__ import annotations

import functools
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from viewnet.tables.published import DASH, text

if TYPE_CHECKING:
    import pandas as pd

    from viewnet.tables.table import Table

Cells = set[tuple[str, str, str]]
"""(row, category, metric)."""

HEADINGS = {
    "acc30": r"Accuracy (\%) $\uparrow$",
    "median": r"Median error ($^\circ$) $\downarrow$",
    "dva": r"Discretized viewpoint accuracy (\%) $\uparrow$",
}
SHORT = {"aeroplane": "airplane", "bicycle": "bike", "diningtable": "table", "motorbike": "mbike", "tvmonitor": "tv"}
"""What the paper calls categories where room is scarce."""
WIDE = 4
"""With more categories than this, printed and measured numbers stand one above the other."""


def side_by_side(table: Table) -> str:
    """Metrics side by side, each with two columns a category: printed and measured."""
    categories, headings = table.categories, [HEADINGS[metric] for metric in table.layout.metrics]
    width = 2 * len(headings) * len(categories)
    out = io.StringIO()
    out.write(f"\\begin{{tabular}}{{l{'r' * width}}}\n\\toprule\n")
    out.write(_header(headings, [len(categories) * 2] * len(headings)))
    out.write(_header(list(categories) * len(headings), [2] * (width // 2)))
    out.write(_line(["", *["print", "ours"] * (width // 2)]) + "\\midrule\n")
    best = table.best()
    for row in table.rows:
        pairs = (
            _pair(table, row, category, metric, best) for metric in table.layout.metrics for category in categories
        )
        out.write(_line([escape(row), *(part for pair in pairs for part in pair)]))
    out.write("\\bottomrule\n")
    for line in _told(table):
        out.write(f"\\multicolumn{{{width + 1}}}{{l}}{{\\footnotesize {line}}} \\\\\n")
    out.write("\\end{tabular}\n")
    return out.getvalue()


def blocks(table: Table) -> str:
    """Metrics one below the other, as Table 3 has them; the note and remarks in a box below.

    Up to WIDE categories have two columns each, printed and measured; more of them one, with what was measured in
    italics below what is printed, in a smaller font and with little room between columns.
    """
    categories, wide = table.categories, len(table.categories) > WIDE
    width = len(categories) * (1 if wide else 2)
    out = io.StringIO()
    if wide:
        out.write("{\\footnotesize\\setlength{\\tabcolsep}{3pt}\n")
    out.write(f"\\begin{{tabular}}{{l{'r' * width}}}\n\\toprule\n")
    if wide:
        out.write(_line(["", *(SHORT.get(category, category) for category in categories)]))
    else:
        out.write(_header(categories, [2] * len(categories)))
        out.write(_line(["", *["print", "ours"] * len(categories)]))
    best = table.best()
    for metric in table.layout.metrics:
        out.write(f"\\midrule\n\\multicolumn{{{width + 1}}}{{l}}{{{HEADINGS[metric]}}} \\\\\n")
        for row in table.rows:
            shown = table.layout.own.get(row, metric)
            pairs = [_pair(table, row, category, shown, best) for category in categories]
            if not wide:
                out.write(_line([escape(row), *(part for pair in pairs for part in pair)]))
                continue
            variant = dict(table.layout.rows)[table.labels.get(row, row)]
            if any(printed != DASH for printed, _ in pairs) or variant is None:
                out.write(_line([escape(row), *(printed for printed, _ in pairs)]))
                name = "\\quad\\textit{ours}"
            else:
                name = f"{escape(row)}, \\textit{{ours}}"
            if variant is not None:
                out.write(_line([name, *(f"\\textit{{{ours}}}" for _, ours in pairs)]))
    out.write("\\bottomrule\n\\end{tabular}\n")
    if lines := _told(table):
        box = "\\\\\n".join(lines)
        out.write(f"\n\\smallskip\\noindent\\parbox{{\\linewidth}}{{\\footnotesize\\raggedright {box}}}\n")
    if wide:
        out.write("}\n")
    return out.getvalue()


def measured(cells: pd.DataFrame, headings: Mapping[str, str], digits: Mapping[str, int], note: str = "") -> str:
    """Measured numbers alone: a column for each metric of `headings`, a block of rows for each category.

    `cells` has a line for each row, category and metric, with its number in "measured" (NaN where there is none).
    """
    out = io.StringIO()
    out.write(f"\\begin{{tabular}}{{l{'r' * len(headings)}}}\n\\toprule\n" + _line(["", *headings.values()]))
    for category in dict.fromkeys(cells["category"]):
        out.write(f"\\midrule\n\\multicolumn{{{len(headings) + 1}}}{{l}}{{{escape(category)}}} \\\\\n")
        mine = cells[cells["category"] == category]
        values = mine.pivot(index="row", columns="metric", values="measured")
        for row in dict.fromkeys(mine["row"]):
            shown = (values.loc[row, metric] for metric in headings)
            told = [DASH if np.isnan(v) else f"{v:.{digits[m]}f}" for v, m in zip(shown, headings, strict=True)]
            out.write(_line([escape(row), *told]))
    out.write("\\bottomrule\n")
    if note:
        out.write(f"\\multicolumn{{{len(headings) + 1}}}{{l}}{{\\footnotesize {escape(note)}}} \\\\\n")
    out.write("\\end{tabular}\n")
    return out.getvalue()


def _told(table: Table) -> list[str]:
    """What stands below a table, line by line."""
    return [escape(line) for line in (f"ours: {table.note}" if table.note else "", *table.remarks) if line]


def escape(plain: str) -> str:
    """Plain text for LaTeX."""
    return plain.translate(_specials())


@functools.cache
def _specials() -> dict[int, str]:
    return str.maketrans(
        {c: f"\\{c}" for c in "&%$#_{}"}
        | {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"}
    )


def _pair(table: Table, row: str, category: str, metric: str, best: Cells) -> tuple[str, str]:
    """Printed and measured, the best of each in bold."""
    cell = table.cell(row, category, metric)
    if cell is None:
        return DASH, DASH
    ours = _bold(text(cell["measured"], metric), (row, category, metric) in best)
    return _bold(cell["printed"] or DASH, bool(cell["bold"])), ours


def _line(cells: Iterable[str]) -> str:
    return " & ".join(cells) + " \\\\\n"


def _header(labels: Sequence[str], spans: Sequence[int]) -> str:
    cells = [f"\\multicolumn{{{span}}}{{c}}{{{label}}}" for label, span in zip(labels, spans, strict=True)]
    ends = np.cumsum(spans) + 1
    rules = [f"\\cmidrule(lr){{{end - span + 1}-{end}}}" for end, span in zip(ends, spans, strict=True)]
    return _line(["", *cells]) + " ".join(rules) + "\n"


def _bold(shown: str, bold: bool) -> str:
    return f"\\textbf{{{shown}}}" if bold else shown
