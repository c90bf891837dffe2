"""Numbers and tables of the documents, rendered from the files in `paper_tables/`.

A page asks for them between the markers of cog, which fills in what follows (`make numbers`) and compares it with the
files (`make lint`). What is below is already imported there, with pandas as pd:

    <!-- [[[cog print(scores("table2_ablation.csv", ["ViewNet"], ["car"], ["acc30"])) ]]] -->
    ...
    <!-- [[[end]]] -->

A sentence is rendered the same way: `print(f"... {value('trust/fuzz.csv', 'cases', reader='obj'):.0f} files.")`.
"""

from __future__ import annotations

import functools
import json
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from viewnet.model.networks import parameters
from viewnet.model.viewnet import ViewNet
from viewnet.peers import registry
from viewnet.recipes import PEERS, VARIANTS, make_config
from viewnet.tables import claims, definitions, kept_predictions
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Table

__all__ = [
    "HEADINGS", "ROOT", "TABLES", "best_heads", "claims_by_verdict", "claims_explained", "definitions", "frame",
    "kept", "markdown", "methods", "pd", "printed_recipe", "recipes_compared", "score", "scores",
    "seeds_by_reconstruction", "tables_1_and_2", "trainings", "value", "what_is_lost",
]  # fmt: skip

ROOT = Path(__file__).resolve().parent.parent
TABLES = ROOT / "paper_tables"
HEADINGS = {"acc30": "Acc@30, %", "median": "median error, degrees", "dva": "DVA, %"}
"""Metric -> what the heading of its column says."""
DIGITS = {"ssim": 2, "iou": 2}
"""Metric -> decimals of measured values, where it is not one."""


def frame(file: str, **where: object) -> pd.DataFrame:
    """The rows of a CSV file in `paper_tables/` whose columns have the given values."""
    rows = pd.read_csv(TABLES / file, dtype={"printed": str})  # as the paper writes them
    for column, wanted in where.items():
        rows = rows[rows[column] == wanted]
    return rows


@functools.cache
def kept(file: str) -> Table:
    """The table of a JSON file in `paper_tables/`, with the predictions beside it."""
    return kept_predictions.read(TABLES / file)


def best_heads(file: str, row: str, category: str | None = None) -> list[float]:
    """Acc@30, %, of the hypotheses closest to the truth: of each run of a row, in one category or in all."""
    own = (entry for entry in kept(file).entries if entry.row == row and category in (None, entry.category))
    return [100 * float((entry.aligned().errors.min(axis=1) < 30).mean()) for entry in own]


def value(file: str, column: str = "measured", **where: object) -> float:
    """The value in a column of the only row of a CSV file that `where` leaves. ValueError: none, or several."""
    values = frame(file, **where)[column]
    if len(values) != 1:
        raise ValueError(f"{file}: {len(values)} rows with {where}, expected one")
    return values.item()


def score(
    file: str,
    row: str,
    category: str,
    metric: str,
    *,
    digits: int | None = None,
    interval: bool = True,
    reported: bool = True,
) -> str:
    """A cell of a table: the measured value, its 95 % interval in square brackets, the reported value in round ones.

    What was not measured is a dash, and "n.d." where an alignment is not determined; what the paper does not report is
    left out.
    """
    cells = frame(file, row=row, category=category, metric=metric)
    if len(cells) != 1:
        raise ValueError(f"{file}: {len(cells)} rows for {row}, {category}, {metric}, expected one")
    cell = cells.iloc[0]
    places = DIGITS.get(metric, 1) if digits is None else digits
    text = "-" if pd.isna(cell["measured"]) else f"{cell['measured']:.{places}f}"
    if pd.notna(cell.get("degenerate")) and cell["degenerate"]:
        text = "n.d."
    elif interval and not pd.isna(cell["low"]):
        text += f" [{cell['low']:.{places}f}, {cell['high']:.{places}f}]"
    if reported and not pd.isna(cell.get("printed")):
        text += f" ({cell['printed']})"
    return text


def scores(
    file: str,
    rows: Sequence[str] | Mapping[str, str] | None = None,
    categories: Iterable[str] = ("aeroplane", "car", "chair"),
    metrics: Iterable[str] = ("acc30", "median"),
    *,
    digits: int | None = None,
    interval: bool = True,
    reported: bool = True,
) -> str:
    """A Markdown table of scores, a column for each metric and category.

    rows  names in the file's column `row`, or label -> name; None for all that were measured
    """
    if rows is None:
        rows = list(frame(file).dropna(subset="measured")["row"].drop_duplicates())
    labels = dict(rows) if isinstance(rows, Mapping) else {name: name for name in rows}
    columns = [(metric, category) for metric in metrics for category in categories]
    header = ["", *(f"{category}: {HEADINGS.get(metric, metric)}" for metric, category in columns)]
    body = [
        [label, *(score(file, name, category, metric, digits=digits, interval=interval, reported=reported)
                  for metric, category in columns)]
        for label, name in labels.items()
    ]  # fmt: skip
    return markdown(header, body)


def tables_1_and_2(
    metrics: Iterable[str] = ("acc30", "median"), interval: bool = False, reported_alone: bool = False
) -> str:
    """Tables 1 and 2 as one Markdown table of scores: measured (reported); or of the rows alone that the paper has."""
    files: dict[str, str] = {}
    for file in ("table1_shapenet.csv", "table2_ablation.csv"):
        measured = frame(file).dropna(subset="measured")
        ours = measured["recipe"].notna() & (not reported_alone)
        for row in measured.loc[measured["printed"].notna() | ours, "row"]:
            files.setdefault(row, file)
    header, columns = [""], []
    for metric in metrics:
        header += [f"{HEADINGS[metric]}: aeroplane", "car", "chair"]
        columns += [(metric, category) for category in ("aeroplane", "car", "chair")]
    body = [
        [row.replace(" (matting)", ""), *(score(file, row, category, metric, interval=interval)
                                          for metric, category in columns)]
        for row, file in files.items()
    ]  # fmt: skip
    return markdown(header, body)


def recipes_compared(files: Mapping[str, Sequence[str]], row: str = "ViewNet") -> Table:
    """One table of a row by several recipes: name of a recipe -> JSON files of the tables with its seeds."""
    entries = [
        replace(entry, origin=entry.origin | {"recipe": recipe})
        for recipe, names in files.items()
        for name in names
        for entry in kept(name).entries
        if entry.row == row
    ]
    return Table.of("table2_ablation", entries)


def trainings() -> pd.DataFrame:
    """The trainings behind the tables that have their records, each once.

    Columns table, recipe, category, seed, core_hours (wall time times threads), processor, commit.
    """
    found = {}
    for path in sorted(TABLES.rglob("*.json"), key=lambda path: (not path.name.startswith("table"), path)):
        about = json.loads(path.read_text("utf-8"))
        runs = about.get("runs", {}) if isinstance(about, dict) else {}
        for run in (run for run in runs.values() if isinstance(run, dict) and run.get("training")):
            training = run["training"]
            hardware = training["hardware"]
            which = (run["variant"], run["recipe"], run["category"], run["seed"], training["started"])
            hours = training["seconds"] * (hardware["threads"] or 1) * training.get("processes", 1) / 3600
            found.setdefault(which, {
                "table": str(path.relative_to(TABLES).with_suffix("")), "recipe": run["recipe"],
                "category": run["category"], "seed": run["seed"], "core_hours": hours,
                "processor": hardware["gpu"] or hardware["processor"], "commit": training["git"]["commit"][:7],
            })  # fmt: skip
    return pd.DataFrame(list(found.values()))


def methods(table: str = "table1_shapenet") -> str:
    """A Markdown table of what each trained row of a table knows in training, and of what its trainings cost.

    Minutes and steps are medians over categories and seeds, of one thread of the processor named, with other trainings
    beside it; target images are means. Where no log is kept, they are those of all epochs.
    """
    runs = json.loads((TABLES / f"{table}.json").read_text("utf-8"))["runs"].values()
    logs = frame(f"{table}_logs.csv")
    seen = logs.groupby(["row", "category", "seed"])["targets"].max().groupby("row").mean()
    an_epoch = (logs["targets"] / logs["epoch"]).median()  # all are trained on equally many views
    rows = []
    for row in LAYOUTS[table].rows:
        if not (own := [run for run in runs if run["variant"] == row.variant and run["training"]]):
            continue
        config = make_config(own[0]["variant"], profile=own[0]["profile"], recipe=own[0]["recipe"])
        network = registry.make(config.variant, config.model) if config.variant in PEERS else ViewNet(config.model)
        targets = seen.get(row.label, config.train.epochs * an_epoch)
        seconds = statistics.median(run["training"]["seconds"] for run in own)
        rate = targets / config.train.batch_size / seconds
        machines = ", ".join(sorted({run["training"]["hardware"]["processor"] for run in own}))
        cost = [f"{parameters(network):,}", f"{targets:,.0f}", f"{seconds / 60:.1f}", f"{rate:.1f}", machines, len(own)]
        rows.append([row.label, row.supervision_as(row.label, own[0]["recipe"]), *cost])
    costs = ["parameters", "target images", "minutes", "steps a second", "processor", "trainings"]
    return markdown(["", "known in training", *costs], rows)


def seeds_by_reconstruction() -> pd.DataFrame:
    """A line for each of ViewNet's rows and categories: Acc@30, %, of the seed that reconstructs validation views best.

    That is `told`; `mean` is of all seeds, `scores` are each seed's, `spread` from lowest to highest.
    Rows are aligned by Procrustes. Those are left out of which a seed's log is not kept.
    """
    names = ["table1_shapenet", "table2_ablation", "table3_pascal3d", "real_cars_built_in/table3_pascal3d"]
    names += ["real_cars/table3_pascal3d", "table4_freiburg", "tiny-paper-viewnet/table2_ablation"]
    lines = []
    for name in names:
        runs: dict[tuple[str, str, str], dict[int, float]] = {}
        for entry in kept(f"{name}.json").entries:
            if entry.origin["variant"] in VARIANTS and entry.alignment == "procrustes":
                score = 100 * float((entry.aligned().selected_errors < 30).mean())
                runs.setdefault((entry.row, entry.recipe, entry.category), {})[entry.seed] = score
        errors = frame(f"{name}_logs.csv").groupby(["row", "recipe", "category", "seed"])["val_reconstruction"].min()
        for about, scores_of in runs.items():
            found = {seed: errors.get((*about, seed)) for seed in scores_of}
            if len(found) < 2 or None in found.values():
                continue
            all_seeds = list(scores_of.values())
            lines.append({
                "table": name, "row": about[0], "recipe": about[1], "category": about[2],
                "told": scores_of[min(found, key=lambda seed: found[seed])], "mean": statistics.mean(all_seeds),
                "spread": max(all_seeds) - min(all_seeds), "scores": all_seeds,
            })  # fmt: skip
    return pd.DataFrame(lines)


@functools.cache
def judged() -> list[claims.Judged]:
    """The claims of the paper with their verdicts."""
    return claims.judge(TABLES)


def printed_recipe() -> str:
    """What the paper's own recipe has on cars, by the released code's error and truly."""
    cars = definitions.of_seeds(kept("tiny-paper-viewnet/table2_ablation.json")).query("category == 'car'")
    folded, true = (", ".join(f"{x:.0f}" for x in cars[f"{name}_acc30"]) for name in ("folded", "geodesic"))
    return f"""By the paper's own recipe (tiny networks, SqueezeNet's features instead of VGG16's, a million images)
three seeds have {folded} % of cars right if opposite sides count as one, and {true} % if not (reported: 89;
[why](docs/recipes.md#the-recipe-paper))."""


def what_is_lost() -> str:
    """What cars on photographs lose by training without labels, and what by training without photographs."""
    photographs, views = "real_cars_built_in/photographs_study.csv", "table1_shapenet.csv"
    ours, labelled, student, drawn = (
        f"{frame(file, row=row, category='car', metric='acc30')['measured'].item():.0f} %"
        for file, row in (
            (photographs, "ViewNet (robust, photos)"),
            (photographs, "Viewpoints of CAD views"),
            (photographs, "Student of ViewNets over black (robust)"),
            (views, "Liao (trained here)"),
        )
    )
    return f"""ViewNet, trained on renderings, has {ours} of 700 photographs of cars right; the same encoder trained
with viewpoints {labelled} (the price of having no labels), a student of ViewNets' answers, without any, {student}
([study](docs/photographs.md)). Over black, training three times as long with viewpoints has {drawn} (the price of no
photographs, at most; [more](docs/peers.md#what-they-reach))."""


def claims_by_verdict() -> str:
    """A Markdown table of verdicts, how many claims of the paper have each, and which, with links to their page."""
    found = {verdict: [each.claim.id for each in judged() if each.verdict == verdict] for verdict in claims.VERDICTS}
    rows = [[verdict, len(ids), ", ".join(f"[{name.replace('_', ' ')}](docs/claims.md#{name})" for name in ids)]
            for verdict, ids in found.items() if ids]  # fmt: skip
    return markdown(["verdict", "", "claims of the paper"], rows)


def claims_explained() -> str:
    """The claims as a Markdown table, then the criterion and the evidence of each."""
    table = markdown(
        ["", "the paper says", "where", "verdict"],
        [[f"[{each.claim.id}](#{each.claim.id})", each.claim.says, each.claim.place, f"**{each.verdict}**"]
         for each in judged()],
    )  # fmt: skip
    parts = [f"{claims.counts(judged())}.\n{table}"]
    for each in judged():
        evidence = "".join(f"- {line}\n" for line in each.evidence)
        files = ", ".join(dict.fromkeys(f"[{rule.file}](../paper_tables/{rule.file})" for rule in each.claim.rules))
        scope = "decide the claim" if each.claim.scope == "full" else "can say it at toy scale only"
        about = f"*{each.claim.says}* ({each.claim.place}) **{each.verdict.capitalize()}.**"
        criterion = f"Criterion: {each.claim.criterion} The data here {scope}: {files}."
        parts.append(f"### {each.claim.id}\n\n{about}\n\n{criterion}\n\n{evidence}")
    return "\n".join(parts)


def markdown(header: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table between empty lines, which some renderers need."""
    lines = [list(header), ["---"] * len(header), *(list(row) for row in rows)]
    if any(len(line) != len(header) for line in lines):
        raise ValueError(f"a table of {len(header)} columns: a row has another number of cells")
    return "\n" + "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)
