"""What printed numbers of constant predictors can and cannot be, by each definition of the error in print.

A constant says the same viewpoint of every image, so its scores depend on nothing but the test set's viewpoints. With
a list of those, a printed score can be held against each definition (viewnet.evaluation.metrics) and each test set: against the
constants that the paper may have meant, and against all constants there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from viewnet import geometry
from viewnet.config import known
from viewnet.data.annotated_viewpoints import read, sample
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.predictions import Floats, true_vectors
from viewnet.runtime.files import write_text
from viewnet.tables import reported

STEP = 2.0
"""Degrees between neighbours of the grid of all constants."""
COVER = float(np.degrees(2 * np.arccos(np.cos(np.radians(STEP / 4)) ** 2)))
"""No viewpoint is further from the grid, degrees: for level cameras cos(error / 2) = cos(da / 2) cos(de / 2)."""
REPRODUCED = {"acc30": 1.0, "median": 0.5, "dva": 1.0}
"""How far from print a constant that the paper may have meant may be: annotations and lists differ a little."""
ROUNDING = {"acc30": 0.5, "median": 0.05, "dva": 0.5, "confidence_index": 0.005}
VERDICTS = ("reproduced", "possible", "no one constant", "excluded")
TABLES = {"table2_ablation": ("acc30", "median"), "table3_pascal3d": ("acc30", "median"), "table4_dva": ("dva",)}


@dataclass(frozen=True)
class Audit:
    """The outcome.

    constants   a row for each printed cell (table, category), test set and definition: what is printed, the bounds that
                no constant passes, the closest of the constants that the paper may have meant, and a verdict
    confidence  a row for each category and test set: the printed confidence index and that of the list
    left_out    rows of the list that could not be used: reason -> how many
    stand_in    whether the list was drawn, so that verdicts on PASCAL3D+ are no evidence
    """

    constants: pd.DataFrame
    confidence: pd.DataFrame
    left_out: dict[str, int]
    stand_in: bool = False

    @property
    def note(self) -> str:
        """How much was held against print, and what was left out, in a line."""
        images = self.confidence.groupby("category")["images"].max()
        left = "".join(f"; {count} left out: {reason}" for reason, count in self.left_out.items())
        drawn = ", drawn as a stand-in" if self.stand_in else ""
        return f"{images.sum()} test viewpoints of {len(images)} categories{drawn}{left}"

    def table(self, name: str) -> pd.DataFrame:
        """Every number compared for one table, rounded: a line for each category, test set and definition."""
        cells = self.constants[self.constants["table"] == known(name, TABLES, "table")].drop(columns="table")
        return cells.set_index(["category", "test_set", "definition"]).dropna(axis=1, how="all").round(1)

    def summary(self) -> pd.DataFrame:
        """A line for each printed cell; for each definition the best verdict over test sets, and where it holds."""
        lines: dict[tuple[str, str], dict[str, str]] = {}
        for (table, category, definition), cells in self.constants.groupby(
            ["table", "category", "definition"], sort=False
        ):
            best = min(cells["verdict"], key=VERDICTS.index)
            where = cells.loc[cells["verdict"] == best, "test_set"]
            text = best if len(where) == len(cells) else f"{best} ({', '.join(where)})"
            lines.setdefault((table, category), {"printed": cells["printed"].iloc[0]})[definition] = text
        frame = pd.DataFrame.from_dict(lines, orient="index")
        frame.index = pd.MultiIndex.from_tuples(frame.index, names=["table", "category"])
        return frame

    def write(self, folder: Path) -> list[Path]:
        """`audit_constants.csv` and `audit_confidence.csv` (`stand_in_...` of one): every number that was compared."""
        stem = "stand_in" if self.stand_in else "audit"
        files = [folder / f"{stem}_constants.csv", folder / f"{stem}_confidence.csv"]
        for path, frame in zip(files, (self.constants, self.confidence), strict=True):
            write_text(path, frame.round(3).to_csv(index=False, lineterminator="\n"))
        return files


def audit_list(path: Path | None = None) -> Audit:
    """`audit` of the list at `path` (viewnet.data.annotated_viewpoints.read); without one, of a stand-in that is always the same."""
    if path is None:
        return replace(audit(sample(np.random.default_rng(0))), stand_in=True)
    return audit(*read(path))


def audit(viewpoints: pd.DataFrame, left_out: dict[str, int] | None = None) -> Audit:
    """Every printed cell of the rows Constant, and the confidence index, against a list (viewnet.data.annotated_viewpoints.read).

    Categories that the list lacks are left out. Table 2's test set is not a list: its viewpoints are drawn evenly
    (section 4.2), so an even lattice stands for it, and that is audited whatever the list holds. Raises ViewnetError
    where the list has no row of a split "val" or "test" at all.
    """
    tested = [(name, rows) for name, rows in test_sets(viewpoints) if len(rows)]
    if not tested:
        splits = ", ".join(sorted(viewpoints["split"].unique()))
        raise ViewnetError(f"audit: the list has viewpoints of the splits {splits} only: val is what was tested on")
    even = lattice()
    cells = _examine("drawn evenly", "", even, {"drawn evenly": even}, ("table2_ablation",))
    for category in dict.fromkeys(viewpoints["category"]):
        mine = viewpoints[viewpoints["category"] == category]
        for test_set, rows in test_sets(mine):
            if len(rows):
                cells += _examine(test_set, category, rows, dict(_sources(mine)), ("table3_pascal3d", "table4_dva"))
    cells.sort(key=lambda cell: list(TABLES).index(cell["table"]))
    return Audit(pd.DataFrame(cells), _confidence(viewpoints), left_out or {})


def test_sets(viewpoints: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """The sets that PASCAL3D+ results are reported on, by name; empty where the list has nothing of one."""
    held_out = viewpoints[viewpoints["split"].isin(("val", "test"))]
    for subset in ("imagenet", "pascal", "all"):
        rows = held_out[held_out["subset"] == subset]
        yield f"{subset} val", rows
        if rows["easy"].any():
            yield f"{subset} val, easy", rows[rows["easy"]]
    if held_out["subset"].nunique() > 1:
        yield "both val", held_out


def lattice() -> pd.DataFrame:
    """Azimuths all around and elevations from -20 to 40 degrees, evenly: Table 2's views, and Table 1's."""
    azimuth, elevation = np.meshgrid(np.arange(0.5, 360), np.arange(-19.5, 40), indexing="ij")
    return pd.DataFrame({"azimuth": azimuth.ravel(), "elevation": elevation.ravel()})


def mean_view(truth: Floats) -> Floats:
    """The camera frame (3, 3), held level, of the mean of view vectors (N, 3). ViewnetError where they cancel out."""
    mean = truth.mean(axis=0)
    if (length := float(np.linalg.norm(mean))) < 1e-9:
        raise ViewnetError("constant predictor: the viewpoints cancel out, so they have no mean direction")
    return geometry.look_at(torch.from_numpy(mean / length)).numpy()


def mean_rotation(truth: Floats) -> Floats:
    """The rotation (3, 3) closest to the camera frames of view vectors (N, 3), in the sum of squared entries."""
    u, _, vt = np.linalg.svd(_frames(truth).mean(axis=0))
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt


MEANS = {"mean view vector": mean_view, "mean rotation": mean_rotation}


def bounds(errors: Floats, azimuths: Floats, definition: str) -> dict[str, float]:
    """What no constant held level passes: acc30 and dva from above, the median from below.

    `errors` (K, N) are geodesic errors of the grid of constants. Any other constant is within COVER of one of them, and
    by every definition its errors are within COVER of that one's.
    """
    e = metrics.DEFINITIONS[definition](errors)
    return {
        "acc30": float((e < 30 + COVER).mean(axis=1).max()) * 100,
        "median": max(0.0, float(np.median(e, axis=1).min()) - COVER),
        "dva": float(metrics.bin_accuracies(e, azimuths, 30 + COVER).mean(axis=-1).max()),
    }


def scores(errors: Floats, azimuths: Floats) -> dict[str, float]:
    """acc30, median and dva of errors (N,) by any definition."""
    return {
        "acc30": metrics.accuracy(errors, 30),
        "median": metrics.median(errors),
        "dva": metrics.dva(errors, azimuths),
    }


def _examine(
    test_set: str, category: str, rows: pd.DataFrame, sources: dict[str, pd.DataFrame], tables: Sequence[str]
) -> list[dict[str, Any]]:
    """The rows of Audit.constants for one test set: one for each table, category (all of a table's, if "") and
    definition."""
    truth, azimuths = _frames(true_vectors(rows)), rows["azimuth"].to_numpy()
    meant = {
        f"{mean} of {source}": _angles(frame(true_vectors(viewpoints))[None], truth)[0]
        for source, viewpoints in sources.items()
        for mean, frame in MEANS.items()
    }
    grid = _angles(_grid(around=bool(category)), truth)
    cells = []
    for definition, made in metrics.DEFINITIONS.items():
        errors, bound = made(grid), bounds(grid, azimuths, definition)
        found = {name: scores(made(e), azimuths) for name, e in meant.items()}
        for table in tables:
            for column, printed in _printed(table).items():
                if category in ("", column):
                    verdict, closest = _judge(printed, found, bound, errors)
                    cells.append(
                        {"table": table, "category": column, "test_set": test_set, "images": len(rows)}
                        | {"definition": definition, "verdict": verdict}
                        | {"printed": " / ".join(f"{value:g}" for value in printed.values()), "closest": closest}
                        | {f"closest_{name}": found[closest][name] for name in printed}
                        | {f"bound_{name}": bound[name] for name in printed}
                    )
    return cells


def _judge(
    printed: dict[str, float], found: dict[str, dict[str, float]], bound: dict[str, float], errors: Floats
) -> tuple[str, str]:
    """One of VERDICTS, and which of the constants that may be meant, `found`, comes closest to print."""
    distance = {name: _distance(printed, score) for name, score in found.items()}
    closest = min(distance, key=distance.__getitem__)
    if any(_beyond(name, value, bound[name]) for name, value in printed.items()):
        return "excluded", closest
    if distance[closest] <= 1:
        return "reproduced", closest
    if len(printed) > 1 and not _some_constant(errors, printed):
        return "no one constant", closest
    return "possible", closest


def _distance(printed: dict[str, float], found: dict[str, float]) -> float:
    """How far a constant's scores are from print, in units of what counts as reproduced: the worst of them."""
    return max(abs(found[name] - value) / REPRODUCED[name] for name, value in printed.items())


def _beyond(name: str, value: float, bound: float) -> bool:
    return value - ROUNDING[name] > bound if name != "median" else value + ROUNDING[name] < bound


def _some_constant(errors: Floats, printed: dict[str, float]) -> bool:
    """Whether one viewpoint of the grid, errors (K, N), may score all that is printed: within what COVER allows."""
    low, high = ((errors < 30 + shift).mean(axis=1) * 100 for shift in (-COVER, COVER))
    acc, median = printed["acc30"], np.median(errors, axis=1)
    fits = (low - REPRODUCED["acc30"] <= acc) & (acc <= high + REPRODUCED["acc30"])
    return bool((fits & (np.abs(median - printed["median"]) <= COVER + REPRODUCED["median"])).any())


def _sources(viewpoints: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """What a constant may be the mean of: main text and supplement differ (validation or training data)."""
    for (subset, split), rows in viewpoints.groupby(["subset", "split"]):
        yield f"{subset} {split}", rows
    if viewpoints["subset"].nunique() > 1:
        for split, rows in viewpoints.groupby("split"):
            yield f"both {split}", rows


def _confidence(viewpoints: pd.DataFrame) -> pd.DataFrame:
    printed = _printed("table4_dva", "Confidence index", ("confidence_index",))
    cells = []
    for category in dict.fromkeys(viewpoints["category"]):
        wanted = printed[category]["confidence_index"]
        for test_set, rows in test_sets(viewpoints[viewpoints["category"] == category]):
            if len(rows):
                index = metrics.confidence_index(rows["azimuth"].to_numpy())
                same = abs(index - wanted) <= ROUNDING["confidence_index"] + 1e-9
                cells.append(
                    {"category": category, "test_set": test_set, "images": len(rows), "printed": wanted}
                    | {"confidence_index": index, "equal": same}
                )
    return pd.DataFrame(cells)


def _printed(table: str, row: str = "Constant", names: Sequence[str] = ()) -> dict[str, dict[str, float]]:
    """Category -> what is printed in `row`, by measure."""
    frame = reported.load(table)
    frame = frame[(frame["row"] == row) & (frame["value"] != "") & frame["metric"].isin(names or TABLES[table])]
    found: dict[str, dict[str, float]] = {}
    for category, name, value in zip(frame["category"], frame["metric"], frame["value"], strict=True):
        found.setdefault(category, {})[name] = float(value)
    return found


def _grid(around: bool) -> Floats:
    """Camera frames (K, 3, 3) of all constants; where azimuths are spread evenly one azimuth stands for all."""
    azimuth = np.arange(0, 360 if around else STEP, STEP)
    elevation = np.arange(-90 + STEP / 2, 90, STEP)
    a, e = (torch.from_numpy(part.ravel()) for part in np.meshgrid(azimuth, elevation, indexing="ij"))
    return geometry.look_at(geometry.view_vector(a, e)).numpy()


def _frames(truth: Floats) -> Floats:
    return geometry.look_at(torch.from_numpy(np.array(truth))).numpy()


def _angles(constants: Floats, truth: Floats) -> Floats:
    """Geodesic errors (K, N), degrees, of frames (K, 3, 3) and (N, 3, 3): tr(A^T B) sums products of entries."""
    cosine = constants.reshape(-1, 9) @ truth.reshape(-1, 9).T  # many numbers: changed in place from here on
    cosine -= 1
    cosine /= 2
    np.clip(cosine, -1, 1, out=cosine)
    return np.degrees(np.arccos(cosine, out=cosine), out=cosine)
