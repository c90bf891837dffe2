"""The claims of the paper: a criterion for each, and the verdict that the files beside it give by that criterion.

`claims.toml` has the criteria, in words and as rules; verdicts are never stored, but made from the cells of tables and
from the predictions kept beside them. A rule asks for an interval within bounds, in each of its categories:

    holds                   the whole interval is within the bounds
    does not hold           the whole interval is beyond one of them
    inconclusive            neither; or fewer than SEEDS trainings of a row; or no score
    cannot be tested here   a row was not measured, or nothing that is kept tells

A claim holds where all of its rules do, and does not hold where one of them does not. Recipes are judged apart, and the
verdict is that of those which decide, if they agree. On data that are a mere likeness (scope "toy") it says so.
"""

import math
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from viewnet.config import build
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.baselines import ON_CALIBRATION, UNTRAINED
from viewnet.evaluation.evaluate import Aligned
from viewnet.evaluation.predictions import Floats
from viewnet.runtime.files import read_csv
from viewnet.runtime.progress import bar
from viewnet.tables import kept_predictions
from viewnet.tables.columns import METRICS, by_key
from viewnet.tables.image_grids import CAUSES, causes
from viewnet.tables.table import Table, named

NAME = "claims.toml"
SEEDS = 3
"""Trainings that a row needs for a verdict."""
WITHOUT_SEEDS = ("", *UNTRAINED, *ON_CALIBRATION, "view_regression", "video_regression")
"""Variants that are the same however often they are made."""
HOLDS, FAILS, INCONCLUSIVE, CANNOT = "holds", "does not hold", "inconclusive", "cannot be tested here"
FULL = {HOLDS: "verified", FAILS: "not reproduced"}
VERDICTS = (*FULL.values(), f"toy scale: {HOLDS}", f"toy scale: {FAILS}", INCONCLUSIVE, CANNOT)
"""From the best known to the least."""


@dataclass(frozen=True)
class Rule:
    """What must be within bounds: a value, or that of a row minus that of its `reference`.

    Of a table (JSON, or a CSV with its cells): `row` without its recipe, `metric` or one of MEASURES. Of another CSV
    file: the `column` of the line that `where` leaves ("name=value"), or its rank correlation `along` another column.
    """

    file: str  # below the folder of the tables
    categories: tuple[str, ...] = ()
    row: str = ""
    reference: str = ""
    metric: str = "acc30"
    where: tuple[str, ...] = ()
    column: str = ""
    along: str = ""
    over: float | None = None
    under: float | None = None
    cannot: str = ""  # why the file says nothing of it


@dataclass(frozen=True)
class Claim:
    """A claim of the paper."""

    id: str
    says: str  # in a sentence
    place: str  # in the paper
    criterion: str  # what its rules ask for
    scope: Literal["full", "toy"]  # whether the data here can decide it
    rules: tuple[Rule, ...]


@dataclass(frozen=True)
class Finding:
    """What a rule says of one category, by one recipe ("" where there is none)."""

    outcome: str
    about: str  # what is within bounds or not
    text: str  # the category with the numbers
    why: str = ""  # it is neither
    recipe: str = ""


@dataclass(frozen=True)
class Judged:
    """A claim with its verdict, one of VERDICTS, and what that comes from."""

    claim: Claim
    findings: tuple[Finding, ...]

    @property
    def by_recipe(self) -> dict[str, str]:
        """Recipe -> outcome; a finding without a recipe counts for each."""
        recipes = list(dict.fromkeys(f.recipe for f in self.findings if f.recipe)) or [""]
        found = {r: {f.outcome for f in self.findings if f.recipe in ("", r)} for r in recipes}
        worst_first = (FAILS, CANNOT, INCONCLUSIVE, HOLDS)
        return {recipe: next(o for o in worst_first if o in outcomes) for recipe, outcomes in found.items()}

    @property
    def verdict(self) -> str:
        """That of the recipes that decide; inconclusive where they disagree."""
        outcomes = set(self.by_recipe.values())
        decided = outcomes & {HOLDS, FAILS}
        if len(decided) == 1:
            (outcome,) = decided
            return FULL[outcome] if self.claim.scope == "full" else f"toy scale: {outcome}"
        return INCONCLUSIVE if decided or INCONCLUSIVE in outcomes else CANNOT

    @property
    def evidence(self) -> list[str]:
        """The findings in words: a line for what each rule is about and each outcome."""
        lines: dict[tuple[str, str], list[str]] = {}
        for found in self.findings:
            outcome = f"{found.outcome}: {found.why}" if found.why else found.outcome
            lines.setdefault((found.about, outcome), []).append(found.text)
        return [f"{about}: {'; '.join(texts)} ({outcome})" for (about, outcome), texts in lines.items()]

    def __str__(self) -> str:
        """In a line."""
        return f"Claim {self.claim.id}: {self.verdict}. {self.claim.says}"


def read(folder: Path) -> tuple[Claim, ...]:
    """The claims of `claims.toml`; none where it is missing. ViewnetError for a file that is not as Claim and Rule."""
    path = folder / NAME
    if not path.is_file():
        return ()
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))["claim"]
        found = tuple(build(Claim, entry, f"{path}: claim {number}") for number, entry in enumerate(entries, 1))
    except (ValueError, LookupError, TypeError) as error:
        raise ViewnetError(f"{path}: not a list of claims ({error})") from error
    if twice := [name for name, times in Counter(claim.id for claim in found).items() if times > 1]:
        raise ViewnetError(f"{path}: two claims are called {twice[0]!r}")
    if bare := [claim.id for claim in found if not claim.rules]:
        raise ViewnetError(f"{path}: claim {bare[0]!r} has no rule")
    return found


def judge(folder: Path, files: Collection[str] | None = None, progress: bool = False) -> list[Judged]:
    """The claims of a folder with their verdicts; of those that read one of `files` where these are given.

    Raises ViewnetError for a rule that names a file, row, category or column that is not there.
    """
    tables: dict[str, Table | pd.DataFrame] = {}
    result = []
    for claim in bar(progress, iterable=read(folder), desc="claims", unit="claim"):
        if files is None or any(rule.file in files for rule in claim.rules):
            try:
                found = tuple(finding for rule in claim.rules for finding in _findings(rule, folder, tables))
            except ViewnetError as error:
                raise ViewnetError(f"{folder / NAME}: claim {claim.id!r}: {error}") from error
            result.append(Judged(claim, found))
    return result


def counts(judged: Sequence[Judged]) -> str:
    """How many claims there are, and how many of each verdict, in a line."""
    number = Counter(each.verdict for each in judged)
    return f"{len(judged)} claim{'s' * (len(judged) != 1)}: " + ", ".join(
        f"{number[name]} {name}" for name in VERDICTS if number[name]
    )


def _findings(rule: Rule, folder: Path, tables: dict[str, Table | pd.DataFrame]) -> Iterator[Finding]:
    if not (path := folder / rule.file).is_file():
        raise ViewnetError(f"{path}: no such file")
    if rule.cannot:
        yield Finding(CANNOT, rule.file, rule.cannot)
        return
    if not rule.categories or (rule.over is None and rule.under is None):
        raise ViewnetError(f"{rule.file}: a rule needs categories and a bound")
    if rule.file not in tables:
        tables[rule.file] = _opened(path)
    table = tables[rule.file]
    if isinstance(table, Table):
        yield from _of_table(rule, table)
    else:
        yield from (_of_lines(rule, table, category) for category in rule.categories)


def _opened(path: Path) -> Table | pd.DataFrame:
    if path.suffix == ".json":
        return kept_predictions.read(path)
    frame = read_csv(path)
    if not {"row", "metric", "measured", "seeds"} <= set(frame.columns):
        return frame
    cells = frame.assign(recipe="", degenerate=0).fillna({"variant": ""})
    return Table(path.stem, "", cells, ())


def _of_table(rule: Rule, table: Table) -> Iterator[Finding]:
    """A finding for each category, by each recipe that the rule's rows are there with."""
    cells = by_key(table.cells)
    recipes = table.cells.drop_duplicates("row").set_index("row")["recipe"]
    mine, others = ({r: name for name, r in recipes.items() if name == named(label, r)} if label else {"": ""}
                    for label in (rule.row, rule.reference))  # fmt: skip
    pairs = [(r or s, mine[r], others[s]) for r, s in product(mine, others) if r == s or "" in (r, s)]
    if not pairs:
        raise ViewnetError(f"{rule.file}: no row {rule.row!r}, or no {rule.reference!r} by the same recipe")
    metric = "acc30" if rule.metric in MEASURES else rule.metric
    for (recipe, *rows), category in product(pairs, rule.categories):
        names = [name for name in rows if name]
        if missing := [name for name in names if (name, category, metric) not in cells]:
            raise ViewnetError(f"{rule.file}: no cell {missing[0]!r}, {category!r}, {metric!r}")
        found = [cells[name, category, metric] for name in names]
        about = f"{' minus '.join(names)}, {METRICS[metric].name if metric == rule.metric else rule.metric}"
        if without := [name for name, cell in zip(names, found, strict=True) if math.isnan(cell["measured"])]:
            yield Finding(CANNOT, about, category, f"{without[0]} is not measured", recipe)
            continue
        numbers = _difference(rule, table, *found) if rule.reference else _value(rule, table, found[0])
        trained = [cell["seeds"] for cell in found if cell["variant"] not in WITHOUT_SEEDS]
        digits = METRICS[metric].page_digits
        yield _bounded(rule, about, category, numbers, min(trained, default=SEEDS), digits, recipe)


Cell = dict[str, Any]
Numbers = tuple[float, float, float]
"""A value and its interval; infinite where one row has a score and the other has none; NaN for no score."""
NO_SCORE = (math.nan, math.nan, math.nan)


def _difference(rule: Rule, table: Table, row: Cell, reference: Cell) -> Numbers:
    """A row minus its reference.

    Where predictions determine no alignment in any seed, a row has no score, and stands below every row that has one.
    """
    below = [cell["degenerate"] / cell["seeds"] for cell in (row, reference)]  # the share of seeds without a score
    if any(below):
        side = {(1, 0): -math.inf, (0, 1): math.inf}.get((below[0], below[1]), math.nan)
        return side, side, side
    value = row["measured"] - reference["measured"]
    paired = table.interval(row["row"], reference["row"], row["category"]) if rule.metric == "acc30" else None
    # Without predictions the widest interval that both rows' own allow.
    low, high = paired or (row["low"] - reference["high"], row["high"] - reference["low"])
    return value, low, high


def _value(rule: Rule, table: Table, cell: Cell) -> Numbers:
    """A cell, or a measure of the predictions behind it."""
    if cell["degenerate"]:
        return NO_SCORE
    if rule.metric not in MEASURES:
        return cell["measured"], cell["low"], cell["high"]
    where = (cell["row"], cell["category"])
    seeds = [entry.aligned() for entry in table.entries if (table.label(entry), entry.category) == where]
    if not seeds:
        raise ViewnetError(f"{rule.file}: no predictions are kept beside it")
    values = [MEASURES[rule.metric](seed) for seed in seeds]  # (N,) each
    counted = [~np.isnan(each) for each in values]
    if not all(map(np.any, counted)):
        return NO_SCORE
    objects = [seed.predictions.objects[count] for seed, count in zip(seeds, counted, strict=True)]
    values = [each[count] for each, count in zip(values, counted, strict=True)]
    low, high = metrics.mean_interval(values, objects) or NO_SCORE[:2]
    return float(np.mean([each.mean() for each in values])), low, high


def _of_lines(rule: Rule, frame: pd.DataFrame, category: str) -> Finding:
    """A finding of a CSV file without cells; of several seeds the mean, with the least and the largest."""
    wanted = [text.partition("=") for text in (*rule.where, f"category={category}")]
    needed = [rule.column, *([rule.along] if rule.along else []), *(name for name, _, _ in wanted)]
    if missing := [name for name in needed if name not in frame.columns]:
        raise ViewnetError(f"{rule.file}: no column {missing[0]!r}")
    for name, _, value in wanted:
        frame = frame[frame[name].astype(str) == value]
    seeded = "seed" in frame.columns
    groups = [group for _, group in frame.groupby("seed")] if seeded else [frame]
    if not groups or any(len(group) < 3 if rule.along else len(group) != 1 for group in groups):
        raise ViewnetError(f"{rule.file}: {len(frame)} lines of {category!r} with {', '.join(rule.where)}")
    if rule.along:
        values = [group[[rule.column, rule.along]].corr(method="spearman").iloc[0, 1] for group in groups]
    else:
        values = [float(group[rule.column].iloc[0]) for group in groups]
    about = f"{rule.column}{f' along {rule.along}' if rule.along else ''} ({', '.join(rule.where)})"
    numbers = (float(np.mean(values)), min(values), max(values))
    return _bounded(rule, about, category, numbers, len(groups) if seeded else SEEDS)


def _bounded(
    rule: Rule, about: str, category: str, numbers: Numbers, seeds: int, digits: int = 2, recipe: str = ""
) -> Finding:
    """What an interval says of the bounds of a rule; nothing of fewer than SEEDS."""
    value, low, high = numbers
    over, under = rule.over, rule.under
    outcome, why = INCONCLUSIVE, ""
    if seeds < SEEDS:
        why = f"{seeds} seed{'s' * (seeds != 1)} of the {SEEDS} needed"
    elif (over is None or low > over) and (under is None or high < under):
        outcome = HOLDS
    elif (over is not None and high < over) or (under is not None and low > under):
        outcome = FAILS
    text = f"{value:.{digits}f}" + (f" [{low:.{digits}f}, {high:.{digits}f}]" if low < high else "")
    if not math.isfinite(value):
        text = {-math.inf: "the first has no score", math.inf: "the second has no score"}.get(value, "no score")
    place = Path(rule.file).parent.as_posix()
    return Finding(outcome, about if place == "." else f"{place}: {about}", f"{category} {text}", why, recipe)


def _of_causes(aligned: Aligned, half_turns: float, mirrored: float) -> Floats:
    """What errors (N,) of these causes count, others nothing."""
    why = causes(aligned.selected, aligned.predictions.truth)  # (N,)
    return np.select([why == "", why == CAUSES[0], why == CAUSES[1]], [np.nan, half_turns, mirrored], 0.0)


MEASURES: dict[str, Callable[[Aligned], Floats]] = {
    "symmetric errors": partial(_of_causes, half_turns=100, mirrored=100),
    "half turns minus mirrored": partial(_of_causes, half_turns=100, mirrored=-100),
    "selected minus best": lambda each: metrics.hits(each.selected_errors) - metrics.hits(each.errors.min(axis=1)),
}
"""Measures of predictions, in per cent, each view's value (N,), NaN where it does not count:

symmetric errors           of errors of 30 degrees or more those that are half a turn, or front and back mirrored
half turns minus mirrored  of the same, by how much the first are more than the second
selected minus best        accuracy of the selected hypothesis minus that of the best
"""
