"""Tables as LaTeX (booktabs), to \\input as they stand."""

import re
from collections.abc import Iterable, Iterator, Sequence

import pandas as pd

from viewnet.tables.columns import DASH, METRICS, Key, best, by_key, text, upper_bound
from viewnet.tables.layouts import Layout

# The paper's short names of categories.
SHORT = {"aeroplane": "airplane", "bicycle": "bike", "diningtable": "table", "motorbike": "mbike", "tvmonitor": "tv"}
NAMED = {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"}
NAMED |= {"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"}  # other characters in TeX's old fonts
# Special characters of LaTeX -> how they are written; what may be an option of the \\ before it is kept apart.
SPECIAL = str.maketrans(
    NAMED | {c: f"\\{c}" for c in "&%$#_{}"} | {c: f"{{{c}}}" for c in "[]"} | dict.fromkeys("\t\n\v\f\r", " ")
)
SUPERVISION = "supervision"  # the heading of the second column
LABELS = 2  # columns before those of numbers
WIDE = 4  # with more categories than this, a measured number stands below the reported one and not beside it


def side_by_side(cells: pd.DataFrame, layout: Layout, lines: Sequence[str]) -> str:
    """Metrics side by side, each with two columns for a category, reported and measured; `lines` of text at the end."""
    categories, pairs = list(dict.fromkeys(cells["category"])), _pairs(cells)
    headings = [METRICS[metric].latex for metric in layout.metrics]
    count = len(headings) * len(categories)  # each of two columns
    body = [
        spanned(headings, 2 * len(categories)),
        spanned(categories * len(headings), 2),
        line(["", SUPERVISION, *["print", "ours"] * count]) + "\\midrule\n",
    ]
    for row, supervision, rule in _labels(cells):
        shown = (pairs.get((row, c, metric), (DASH, DASH)) for metric in layout.metrics for c in categories)
        body.append(rule + line([escape(row), supervision, *(part for pair in shown for part in pair)]))
    return tabular(f"ll{'r' * 2 * count}", body, lines)


def blocks(cells: pd.DataFrame, layout: Layout, lines: Sequence[str]) -> str:
    """Metrics one below the other, as Table 3 has them; `lines` of text in a box below.

    Up to WIDE categories have two columns each, reported and measured; more of them one, measured below reported.
    """
    categories, pairs = list(dict.fromkeys(cells["category"])), _pairs(cells)
    measured_rows = set(cells.loc[cells["variant"] != "", "row"])  # others have no line of ours
    if wide := len(categories) > WIDE:
        body = [line(["", SUPERVISION, *(SHORT.get(category, category) for category in categories)])]
    else:
        heads = line(["", SUPERVISION, *["print", "ours"] * len(categories)])
        body = [spanned(categories, 2), heads]
    width = len(categories) * (1 if wide else 2)
    for metric in layout.metrics:
        body.append(_heading(METRICS[metric].latex, width + LABELS))
        for row, supervision, rule in _labels(cells):
            shown = [pairs.get((row, c, layout.own.get(row, metric)), (DASH, DASH)) for c in categories]
            if not wide:
                body.append(rule + line([escape(row), supervision, *(part for pair in shown for part in pair)]))
                continue
            label, words = f"{escape(row)}, \\textit{{ours}}", supervision
            if row not in measured_rows or any(reported != DASH for reported, _ in shown):
                body.append(rule + line([escape(row), supervision, *(reported for reported, _ in shown)]))
                label, words, rule = "\\quad\\textit{ours}", "", ""  # the row is named above
            if row in measured_rows:
                body.append(rule + line([label, words, *(f"\\textit{{{measured}}}" for _, measured in shown)]))
    table = tabular(f"ll{'r' * width}", body) + (f"\n{boxed(lines, 'footnotesize')}\n" if lines else "")
    return f"{{\\footnotesize\\setlength{{\\tabcolsep}}{{3pt}}\n{table}}}\n" if wide else table


def measured(cells: pd.DataFrame, metrics: Sequence[str], note: str = "") -> str:
    """Measured numbers alone: a column for each of `metrics`, a block of rows for each category.

    `cells` has a line for each row, category and metric, with its number in "measured" (NaN for none).
    """
    body = [line(["", *(METRICS[metric].latex for metric in metrics)])]
    for category, part in cells.groupby("category", sort=False):
        body.append(_heading(escape(str(category)), len(metrics) + 1))
        values = part.pivot(index="row", columns="metric", values="measured")
        for row in dict.fromkeys(part["row"]):
            body.append(line([escape(row), *(text(values.loc[row, metric], metric) for metric in metrics)]))
    return tabular(f"l{'r' * len(metrics)}", body, [note] if note else [])


def tabular(columns: str, body: Iterable[str], lines: Sequence[str] = ()) -> str:
    """A booktabs tabular: rules around the rows of `body`, then `lines` of plain text over its whole width."""
    under = (f"\\multicolumn{{{len(columns)}}}{{l}}{{\\footnotesize {escape(text)}}} \\\\\n" for text in lines)
    rows = "".join([*body, "\\bottomrule\n", *under])
    return f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{rows}\\end{{tabular}}\n"


def boxed(lines: Sequence[str], size: str = "") -> str:
    """Lines of plain text in a box below a table."""
    size = f"\\{size}" if size else ""
    text = "\\\\\n".join(map(escape, lines))
    return f"\\smallskip\\noindent\\parbox{{\\linewidth}}{{{size}\\raggedright {text}}}"


def line(cells: Iterable[str]) -> str:
    """A row of a tabular."""
    return " & ".join(cells) + " \\\\\n"


def spanned(labels: Sequence[str], span: int) -> str:
    """A row of headings after the columns of labels, each over `span` columns, with a rule below each."""
    cells = [f"\\multicolumn{{{span}}}{{c}}{{{label}}}" for label in labels]
    ends = (LABELS + span * count for count in range(1, len(labels) + 1))
    rules = [f"\\cmidrule(lr){{{end - span + 1}-{end}}}" for end in ends]
    return line([*[""] * LABELS, *cells]) + " ".join(rules) + "\n"


def escape(plain: str) -> str:
    """Plain text for LaTeX, at any place: it prints as it is written."""
    apart = re.sub(r"([-'`,])(?=\1)", r"\1{}", plain.translate(SPECIAL))  # two of them are another character
    return re.sub(r"^(\s*)\*", r"\1{*}", apart)


def _heading(latex: str, width: int) -> str:
    return f"\\midrule\n\\multicolumn{{{width}}}{{l}}{{{latex}}} \\\\\n"


def _labels(cells: pd.DataFrame) -> Iterator[tuple[str, str, str]]:
    """Of each row: its label, what is known in training, and the rule above it: over the first upper bound."""
    above = False
    rows = cells.drop_duplicates("row")
    for row, supervision in zip(rows["row"], rows["supervision"], strict=True):
        bound = upper_bound(supervision)
        yield row, escape(supervision), "\\midrule\n" if bound and not above else ""
        above = bound


def _pairs(cells: pd.DataFrame) -> dict[Key, tuple[str, str]]:
    """(row, category, metric) -> reported and measured number, the best of each in bold."""
    top = best(cells, lambda metric: METRICS[metric].digits)  # of numbers as they are printed
    pairs = {}
    for key, cell in by_key(cells).items():
        ours = _bold(text(cell["measured"], key[2], cell["degenerate"]), key in top)
        pairs[key] = _bold(cell["printed"] or DASH, cell["bold"]), ours
    return pairs


def _bold(number: str, bold: bool) -> str:
    return f"\\textbf{{{number}}}" if bold else number
