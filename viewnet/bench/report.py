"""What `viewnet bench` measured: as text, booktabs table, CSV, JSON and figure."""

from pathlib import Path
from typing import Any

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from viewnet.bench import steps
from viewnet.bench.measure import COLUMNS, Row
from viewnet.runtime.files import write_csv, write_json, write_text
from viewnet.tables import latex, plots
from viewnet.tables.benchmark import HEADINGS, NOT_MEASURED, aligned, cells, notes, number, steps_notes
from viewnet.tables.columns import DASH

COLUMN = 3.25  # inches: a column of the paper
RATIOS = {"time": "#009e73", "memory": "#e69f00"}


def as_text(result: dict[str, Any]) -> str:
    """One aligned table, and what it was measured on."""
    return "\n".join([*aligned([*HEADINGS, *(cells(row) for row in result["rows"])], 2), "", *notes(result), ""])


def steps_as_text(result: dict[str, Any]) -> str:
    """A table of what `viewnet.bench.steps` measured, and on what."""
    lines: list[tuple[str, ...]] = [("step", "part", "ms", "low", "high", "share", "calls", "floor, ms", "x floor")]
    before = ""
    for row in result["rows"]:
        title = f"{row['profile']}, {row['recipe']}, batch {row['batch']}, {row['phase']}"
        share = "" if row["share"] is None else f"{100 * row['share']:.0f} %"
        values = (number(row[name]) for name in ("calls", "floor_ms", "over_floor"))
        times = (number(row[name]) for name in ("ms", "ms_low", "ms_high"))
        lines.append(("" if title == before else title, row["part"], *times, share, *values))
        before = title
    return "\n".join([*aligned(lines, 2), "", *steps_notes(result), ""])


def write_steps(result: dict[str, Any], folder: Path, name: str = "steps", columns: Any = steps.COLUMNS) -> list[Path]:
    """`steps.json` and `steps.csv`, or by another name with other columns."""
    path = folder / f"{name}.json"
    write_json(path, result)
    table = pd.DataFrame(result["rows"], columns=list(columns), dtype=object)
    return [path, write_csv(path.with_suffix(".csv"), table)]


def write(result: dict[str, Any], folder: Path) -> list[Path]:
    """`bench.json`, `bench.csv`, `bench.tex`, `bench.png` and `bench.pdf`."""
    files = [*write_steps(result, folder, "bench", COLUMNS), folder / "bench.tex"]
    write_text(files[2], as_latex(result))
    return files + plots.save(figure(result), folder, "bench")


def as_latex(result: dict[str, Any]) -> str:
    """A booktabs tabular to \\input, as wide as a landscape page, with the notes in a box below."""
    spans = (("", 3), ("time", 3), ("memory", 3), ("growth", 3), (r"$\times$ floor", 2))
    names = ["work", "volume", "size", *["textbook", "ours", "ratio"] * 2, "expected", *["textbook", "ours"] * 2]
    body = [
        latex.line(f"\\multicolumn{{{span}}}{{c}}{{{label}}}" for label, span in spans),
        "\\cmidrule(lr){4-6}\\cmidrule(lr){7-9}\\cmidrule(lr){10-12}\\cmidrule(lr){13-14}\n",
        latex.line(names),
    ]
    work = None
    for row in result["rows"]:
        texts = cells(row)
        if row["work"] != work:
            body.append("\\midrule\n")
            work = row["work"]
        first = [f"{texts[0]} (GPU)" if row["device"] == "cuda" else texts[0], *texts[1:3]]
        numbers = [*texts[4:10], *texts[12:]]
        if NOT_MEASURED in texts:
            numbers = [DASH, DASH, *[""] * (len(numbers) - 2)]
        body.append(latex.line([*map(latex.escape, first), *numbers]))
    table = latex.tabular(f"ll{'r' * (len(names) - 2)}", body)
    return f"{{\\scriptsize\\setlength{{\\tabcolsep}}{{2.5pt}}\n{table}\n{latex.boxed(notes(result))}\n}}\n"


def figure(result: dict[str, Any]) -> Figure:
    """By how much the package is faster and smaller; of works at several sizes the largest, and those with memory."""
    rows = [row for row in result["rows"] if row["speedup"] is not None]
    sides = sorted(((row["work"], row["volume"], row["size"]) for row in rows), key=lambda side: side[2])
    largest = {(work, occupancy): size for work, occupancy, size in sides}
    shown = [row for row in rows if row["memory_ratio"] or row["size"] == largest[row["work"], row["volume"]]]
    with matplotlib.rc_context(plots.STYLE):
        image = Figure(figsize=(1.4 * COLUMN, max(2.6, 0.33 * len(shown) + 0.7)), layout="constrained")
        axes = image.subplots()
        _bars(axes, shown)
        axes.set_title("textbook / viewnet", fontsize=7)
    return image


def _bars(axes: Axes, rows: list[Row]) -> None:
    """A pair of bars a row: how many times the textbook version's time and memory are the package's."""
    for place, row in enumerate(rows):
        ends = {"time": (row["speedup_low"], row["speedup_high"]), "memory": (row["memory_ratio"],) * 2}
        for (name, colour), shift in zip(RATIOS.items(), (-0.2, 0.2), strict=True):
            if (value := row["speedup" if name == "time" else "memory_ratio"]) is None:
                continue
            axes.barh(place + shift, value - 1, 0.38, left=1, color=colour)
            axes.plot(ends[name], [place + shift] * 2, color="0.2", linewidth=0.8)
            axes.annotate(number(value), (max(value, *ends[name], 1), place + shift), (2, 0),
                          textcoords="offset points", va="center", fontsize=6)  # fmt: skip
    axes.axvline(1, color="0.2", linewidth=0.6)
    labels = [f"{row['work']}\n{row['volume']}, {row['size']}³" for row in rows]
    axes.set_yticks(range(len(rows)), labels, fontsize=6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.invert_yaxis()
    axes.set_xscale("log")
    plots.plain_ticks(axes.xaxis)
    axes.set_xlim(right=1.6 * axes.get_xlim()[1])  # room for the numbers
    axes.set_xlabel("times as much (thin lines: least to most)")
    handles = [Patch(color=colour, label=name) for name, colour in RATIOS.items()]
    axes.legend(handles=handles, frameon=False, fontsize=7, loc="lower right")
