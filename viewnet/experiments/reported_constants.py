"""Which definition of the error, and which test set, can explain the reported scores of constant predictors.

A constant's scores depend on nothing but the viewpoints of the test set. Given those, a reported score is compared,
under each definition and for each test set, with the constants that the paper may have meant and with bounds for all.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from scipy.spatial.transform import Rotation

from viewnet import geometry
from viewnet.data.annotated_viewpoints import read, sample
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, metrics
from viewnet.evaluation.predictions import Floats, true_vectors
from viewnet.runtime.files import write_csv
from viewnet.runtime.progress import bar
from viewnet.tables import reported

STEP = 2.0  # degrees between neighbours of the grid of all constants
# No viewpoint is further from the grid, degrees: for level cameras cos(error / 2) = cos(da / 2) cos(de / 2).
COVER = float(np.degrees(2 * np.arccos(np.cos(np.radians(STEP / 4)) ** 2)))
# Largest difference from the report of a constant that was meant: annotations and lists differ a little.
REPRODUCED = {"acc30": 1.0, "median": 0.5, "dva": 1.0}
ROUNDING = {"acc30": 0.5, "median": 0.05, "dva": 0.5, "confidence_index": 0.005}  # of the paper's last digit
VERDICTS = ("reproduced", "possible", "no one constant", "excluded")  # the best first


@dataclass(frozen=True)
class ConstantAudit:
    """The result.

    `constants` has a row for each reported cell (table, category), test set and definition: the reported scores, the
    bounds that no constant passes, the closest of the constants that the paper may have meant, and a verdict.
    """

    constants: pd.DataFrame
    confidence: pd.DataFrame  # a row for each category and test set: the reported confidence index and the list's
    left_out: dict[str, int]  # rows of the list that could not be used: reason -> how many
    stand_in: bool = False  # whether the list was sampled, so that verdicts on PASCAL3D+ are no evidence

    @property
    def note(self) -> str:
        """How many viewpoints were used, and how many left out and why, in one line."""
        images = self.confidence.groupby("category")["images"].max()  # test sets of a category overlap
        left = "".join(f"; {count} left out: {reason}" for reason, count in self.left_out.items())
        source = ", drawn as a stand-in" if self.stand_in else ""
        return f"{images.sum()} test viewpoints of {len(images)} categories{source}{left}"

    def summary(self) -> pd.DataFrame:
        """A line for each reported cell; for each definition the best verdict over test sets, and where it holds."""
        lines: dict[tuple[str, str], dict[str, str]] = {}
        groups = self.constants.groupby(["table", "category", "definition"], sort=False)
        for (table, category, definition), cells in groups:
            best = min(cells["verdict"], key=VERDICTS.index)  # one test set that explains the report is enough
            where = cells.loc[cells["verdict"] == best, "test_set"]
            text = best if len(where) == len(cells) else f"{best} ({', '.join(where)})"
            lines.setdefault((table, category), {"printed": cells["printed"].iloc[0]})[definition] = text
        return pd.DataFrame.from_dict(lines, orient="index").rename_axis(["table", "category"])

    def write(self, folder: Path) -> list[Path]:
        """`audit_constants.csv` and `audit_confidence.csv` (`stand_in_...` for a stand-in): all numbers compared."""
        stem = "stand_in" if self.stand_in else "audit"
        frames = {"constants": self.constants, "confidence": self.confidence}
        return [write_csv(folder / f"{stem}_{name}.csv", frame.round(3)) for name, frame in frames.items()]


def audit_file(path: Path | None = None, progress: bool = False) -> ConstantAudit:
    """The audit of a file (viewnet.data.annotated_viewpoints.read); without one, of a stand-in, always the same."""
    if path is None:
        return replace(audit_viewpoints(sample(np.random.default_rng(0)), progress=progress), stand_in=True)
    return audit_viewpoints(*read(path), progress)


def audit_viewpoints(
    viewpoints: pd.DataFrame, left_out: dict[str, int] | None = None, progress: bool = False
) -> ConstantAudit:
    """All reported cells of the rows Constant, and the confidence index, against a list of annotated viewpoints.

    Categories that the list lacks are left out. Table 2's viewpoints are evenly distributed (section 4.2), so an even
    lattice stands for them. Raises ViewnetError where the list has no row of a split "val" or "test" at all.
    """
    if not dict(test_sets(viewpoints)):
        splits = ", ".join(sorted(viewpoints["split"].unique()))
        raise ViewnetError(f"audit: the list has viewpoints of the splits {splits} only: val is what was tested on")
    even = lattice()  # Table 2's viewpoints, whatever the list holds
    cells = examine("drawn evenly", "", even, {"drawn evenly": even}, ("table2_ablation",))
    categories = list(dict.fromkeys(viewpoints["category"]))
    for category in bar(progress, iterable=categories, desc="audit", unit="category"):
        mine = viewpoints[viewpoints["category"] == category]
        for test_set, rows in test_sets(mine):
            cells += examine(test_set, category, rows, _sources(mine), ("table3_pascal3d", "table5_dva"))
    cells.sort(key=itemgetter("table"))  # stable: within a table by category and test set
    return ConstantAudit(pd.DataFrame(cells), confidence_indices(viewpoints), left_out or {})


def test_sets(viewpoints: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """The sets that PASCAL3D+ results are reported on, by name, as far as the list has some of them."""
    held_out = viewpoints[viewpoints["split"].isin(("val", "test"))]
    # Papers score on one subset or on both, with or without occluded and truncated objects.
    for subset in ("imagenet", "pascal", "all"):
        rows = held_out[held_out["subset"] == subset]
        if len(rows):
            yield f"{subset} val", rows
        if rows["easy"].any():
            yield f"{subset} val, easy", rows[rows["easy"]]
    if held_out["subset"].nunique() > 1:
        yield "both val", held_out


def lattice() -> pd.DataFrame:
    """Azimuths all around and elevations from -20 to 40 degrees, evenly: Table 2's views, and Table 1's."""
    azimuth, elevation = np.meshgrid(np.arange(0.5, 360), np.arange(-19.5, 40), indexing="ij")  # middles of degrees
    return pd.DataFrame({"azimuth": azimuth.ravel(), "elevation": elevation.ravel()})


def mean_view(truth: Floats) -> Floats:
    """The level camera frame (3, 3) of the mean of view vectors (N, 3). ViewnetError where they cancel out."""
    return level_frames(baselines.mean_vector(truth))


def mean_rotation(truth: Floats) -> Floats:
    """The rotation (3, 3) closest to the camera frames of view vectors (N, 3), in the sum of squared entries."""
    return np.asarray(Rotation.from_matrix(level_frames(truth)).mean().as_matrix())


MEANS = {"mean view vector": mean_view, "mean rotation": mean_rotation}


def bounds(errors: Floats, azimuths: Floats) -> dict[str, float]:
    """What no level constant passes: acc30 and dva from above, the median from below.

    `errors` (K, N), by any definition, are those of the grid of constants. Any other constant is within COVER of one of
    them, and by every definition its errors are within COVER of that one's.
    """
    return {
        "acc30": float((errors < 30 + COVER).mean(axis=1).max()) * 100,
        "median": max(0.0, float(np.median(errors, axis=1).min()) - COVER),
        "dva": float(metrics.bin_accuracies(errors, azimuths, 30 + COVER).mean(axis=-1).max()),
    }


def examine(
    test_set: str, category: str, rows: pd.DataFrame, sources: dict[str, pd.DataFrame], tables: Sequence[str]
) -> list[dict[str, Any]]:
    """The rows of ConstantAudit.constants for one test set and category ("": all that a table reports)."""
    truth, azimuths = level_frames(true_vectors(rows)), rows["azimuth"].to_numpy()
    candidates = {
        f"{mean} of {source}": angles(frame(true_vectors(viewpoints))[None], truth)[0]
        for (source, viewpoints), (mean, frame) in product(sources.items(), MEANS.items())
    }
    grid = angles(grid_frames(around=bool(category)), truth)  # (K, N), the same for every definition
    reports = [(table, *report) for table in tables for report in reported_scores(table).items()]
    cells = []
    for definition, defined in metrics.DEFINITIONS.items():
        errors = defined(grid)  # (K, N)
        bound = bounds(errors, azimuths)
        by_candidate = {name: metrics.summary(defined(e), azimuths) for name, e in candidates.items()}
        for table, column, report in reports:
            if category in ("", column):  # the even lattice stands for every category
                verdict, closest = _judge(report, by_candidate, bound, errors)
                cells.append(
                    {"table": table, "category": column, "test_set": test_set, "images": len(rows)}
                    | {"definition": definition, "verdict": verdict}
                    | {"printed": " / ".join(f"{value:g}" for value in report.values()), "closest": closest}
                    | {f"closest_{name}": by_candidate[closest][name] for name in report}
                    | {f"bound_{name}": bound[name] for name in report}
                )
    return cells


def _judge(
    report: dict[str, float], candidates: dict[str, dict[str, float]], bound: dict[str, float], errors: Floats
) -> tuple[str, str]:
    """One of VERDICTS, and the candidate that comes closest to the reported scores."""
    # In units of what counts as reproduced, the largest difference of the scores.
    distance = {
        name: max(abs(score[metric] - value) / REPRODUCED[metric] for metric, value in report.items())
        for name, score in candidates.items()
    }
    closest = min(distance, key=distance.__getitem__)
    # What no constant reaches was no constant's score, however close the closest comes.
    if any(
        value + ROUNDING[name] < bound[name] if name == "median" else value - ROUNDING[name] > bound[name]
        for name, value in report.items()
    ):
        return "excluded", closest
    if distance[closest] <= 1:
        return "reproduced", closest
    # Each score alone may be possible, but not both of one viewpoint.
    if len(report) > 1 and not _some_constant(errors, report):
        return "no one constant", closest
    return "possible", closest


def _some_constant(errors: Floats, report: dict[str, float]) -> bool:
    """Whether one viewpoint of the grid, errors (K, N), may have all reported scores, within what COVER allows."""
    # A viewpoint between those of the grid has errors within COVER of one of them.
    low, high = ((errors < 30 + shift).mean(axis=1) * 100 for shift in (-COVER, COVER))
    acc, median = report["acc30"], np.median(errors, axis=1)
    fits = (low - REPRODUCED["acc30"] <= acc) & (acc <= high + REPRODUCED["acc30"])
    return bool((fits & (np.abs(median - report["median"]) <= COVER + REPRODUCED["median"])).any())


def _sources(viewpoints: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """What a constant may be the mean of: main text and supplement differ (validation or training data)."""
    sources = {f"{subset} {split}": rows for (subset, split), rows in viewpoints.groupby(["subset", "split"])}
    # Of one subset it would be the same again.
    both = viewpoints.groupby("split") if viewpoints["subset"].nunique() > 1 else ()
    return sources | {f"both {split}": rows for split, rows in both}


def confidence_indices(viewpoints: pd.DataFrame) -> pd.DataFrame:
    """ConstantAudit.confidence of a list."""
    report = reported_scores("table5_dva", "Confidence index")
    cells = [
        {"category": category, "test_set": test_set, "images": len(rows)}
        | {"printed": report[category]["confidence_index"]}
        | {"confidence_index": metrics.confidence_index(rows["azimuth"].to_numpy())}
        for category in dict.fromkeys(viewpoints["category"])
        for test_set, rows in test_sets(viewpoints[viewpoints["category"] == category])
    ]
    frame = pd.DataFrame(cells)
    difference = (frame["confidence_index"] - frame["printed"]).abs()
    return frame.assign(equal=difference <= ROUNDING["confidence_index"] + 1e-9)


def reported_scores(table: str, row: str = "Constant") -> dict[str, dict[str, float]]:
    """Category -> metric -> the score reported in `row`."""
    frame = reported.load(table)  # as text, "" where there is a dash
    frame = frame[(frame["row"] == row) & (frame["value"] != "")]
    return {
        category: dict(zip(cells["metric"], cells["value"].astype(float), strict=True))
        for category, cells in frame.groupby("category", sort=False)
    }


def grid_frames(around: bool) -> Floats:
    """Camera frames (K, 3, 3) of all constants; without `around` at one azimuth, enough for evenly spread ones."""
    azimuth = np.arange(0, 360 if around else STEP, STEP)  # evenly spread viewpoints are alike from every azimuth
    elevation = np.arange(-90 + STEP / 2, 90, STEP)  # no poles, where azimuths do not matter
    a, e = (torch.from_numpy(part.ravel()) for part in np.meshgrid(azimuth, elevation, indexing="ij"))
    return geometry.look_at(geometry.view_vector(a, e)).numpy()


def level_frames(vectors: Floats) -> Floats:
    """Level camera frames (..., 3, 3) of view vectors (..., 3)."""
    return geometry.look_at(torch.from_numpy(np.array(vectors))).numpy()


def angles(constants: Floats, truth: Floats) -> Floats:
    """Geodesic errors (K, N), degrees, of frames (K, 3, 3) and (N, 3, 3): tr(A^T B) sums products of entries."""
    cosine = constants.reshape(-1, 9) @ truth.reshape(-1, 9).T  # (K, N), large: changed in place from here on
    cosine -= 1
    cosine /= 2
    np.clip(cosine, -1, 1, out=cosine)
    return np.degrees(np.arccos(cosine, out=cosine), out=cosine)
