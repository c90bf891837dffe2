"""How alignment affects scores on photographs: which kind, fitted on how many, and whether the linear kind collapses.

The paper finds the linear regression of the starred rows ahead of the rigid rotation where photographs are taken from
few sides, and argues that its weights go to zero and leave the commonest viewpoint (section 4.3). The accuracy that it
adds and the spread that it leaves are measured here, on all photographs and on increasingly one-sided subsets.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from viewnet.config import RunConfig
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation import baselines, metrics
from viewnet.evaluation.alignment import Linear
from viewnet.evaluation.evaluate import Aligned, align
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments.photos import PhotoExperiment
from viewnet.runtime.files import write_csv
from viewnet.tables import kept_predictions
from viewnet.tables.columns import HEADLINE
from viewnet.tables.layouts import LAYOUTS
from viewnet.tables.table import Entry

TABLE = "table3_pascal3d"  # whose rows are studied
KINDS = ("procrustes", "robust", "linear", "per_angle")  # rigid ones first
METRICS = (*HEADLINE, "dva")
COUNTS = (16, 32, 64, 128, 256, 512)  # calibration photographs, as far as there are so many; all of them as well
DRAWS = 5  # of each number of photographs: how much depends on which they are
# How one-sided a subset is; 0: all photographs, 8: hardly any from beyond 45 degrees of the commonest side.
CONCENTRATIONS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
FEWEST = 16  # photographs that a subset must have to calibrate, and to score
EXPECTED = ("spread_linear", "acc30_gain", "dva_gain")  # what the paper's reasoning predicts, see Study.verdict
RANDOM = "Random"
RANDOM_SEED = 20211011  # used nowhere else: a stand-in sampled from the same seed would be predicted by them
FITTED = ("constant", "constant_rotation", "view_regression")  # predictors fitted on calibration photographs


@dataclass(frozen=True)
class Predictor:
    """A row of Table 3 for one category."""

    label: str
    category: str
    seed: int
    predict: Callable[[int | None, int], Predictions]  # of so many calibration photographs (None: all), from a seed
    fitted: bool  # on these: it predicts in the annotated frame and is scored unaligned, too

    @property
    def row(self) -> dict[str, Any]:
        """What identifies it in the tables of a study."""
        return {"predictor": self.label, "category": self.category, "seed": self.seed}


@dataclass(frozen=True)
class Study:
    """The result.

    scores    a row for each predictor, category, seed, alignment, number of calibration photographs and draw of them:
              acc30, median, dva on the same test photographs
    collapse  a row for each predictor that needs alignment, category, seed and concentration: photographs that
              calibrate (calibrating) and score (scored), side (share of the commonest azimuth bin), confidence_index,
              weights and bias (norms of the linear map), spread_rigid and spread_linear (of the aligned predictions, as
              a share of the true viewpoints': 0 is a constant), acc30 and dva by either and of the constant
    """

    scores: pd.DataFrame
    collapse: pd.DataFrame

    def by_count(self) -> pd.DataFrame:
        """Acc@30, median over draws and seeds with the lowest and the highest, by number of calibration photographs."""
        groups = self.scores.groupby(["category", "predictor", "alignment", "images"], sort=False)["acc30"]
        wide = groups.agg(lambda g: f"{g.median():.1f} [{g.min():.1f}, {g.max():.1f}]").unstack("images")
        # Of the table, not of the alphabet.
        order = self.scores[["category", "predictor", "alignment"]].drop_duplicates()
        return wide.loc[pd.MultiIndex.from_frame(order), sorted(wide.columns)].fillna("")

    def side_by_side(self) -> pd.DataFrame:
        """Each predictor by each alignment, calibrated on all photographs: means over seeds."""
        most = self.scores.groupby("category")["images"].transform("max")
        whole = self.scores[self.scores["images"] == most]  # categories differ in how many there are
        wide = whole.pivot_table(index=["category", "predictor"], columns="alignment", values=list(METRICS), sort=False)
        columns = [(m, kind) for m in METRICS for kind in ("none", *KINDS)]
        return wide[columns].round(1).rename_axis(columns=[None, None])

    def collapsed(self) -> pd.DataFrame:
        """Means of `collapse` over seeds, and the gain of linear over rigid alignment, rounded."""
        keys = ["category", "predictor", "concentration"]
        means = self.collapse.drop(columns="seed").groupby(keys, sort=False).mean()
        for metric in ("acc30", "dva"):
            means[f"{metric}_gain"] = means[f"{metric}_linear"] - means[f"{metric}_rigid"]
        finer = ("side", "confidence_index", "spread_rigid", "spread_linear", "weights", "bias")
        return means.round({name: 2 if name in finer else 1 for name in means.columns})

    def verdict(self) -> pd.DataFrame:
        """For each category and predictor, rank correlations over subsets of one-sidedness with what the paper says.

        spread_linear  expected below 0: the more one-sided, the closer linear alignment comes to a constant
        acc30_gain     expected above 0: the more one-sided, the more accuracy it adds to a rotation
        dva_gain       the same with equal weight for every side
        """
        groups = self.collapsed().groupby(["category", "predictor"], sort=False)
        # NaN where there are fewer than three subsets, or one side does not change.
        ranks = groups[["side", *EXPECTED]].corr(method="spearman", min_periods=3)
        correlations = ranks.xs("side", level=-1)[list(EXPECTED)].round(2)
        correlations.insert(0, "parts", groups.size())  # a correlation over three subsets says little
        return correlations

    def write(self, folder: Path) -> list[Path]:
        """`alignment_study_scores.csv` and `alignment_study_collapse.csv`."""
        frames = {"scores": self.scores, "collapse": self.collapse}
        return [write_csv(folder / f"alignment_study_{name}.csv", f.round(4)) for name, f in frames.items()]


class AlignmentStudy(PhotoExperiment):
    """The study's experiment: predictions that Table 3 has kept, of every seed, are taken in the place of runs."""

    @cached_property
    def kept(self) -> list[Entry]:
        """The entries of trained predictors that are kept beside Table 3 of the same parameters."""
        found = kept_predictions.entries(self.folder / f"{TABLE}.json")
        mine = {(config.variant, config.recipe, config.category) for config in self.configs}
        about = ("variant", "recipe", "category")
        return [entry for entry in found if tuple(entry.origin.get(name) for name in about) in mine]

    @property
    def to_run(self) -> list[RunConfig]:
        """The runs that are not kept."""
        kept = {entry.origin.get("settings") for entry in self.kept}
        return [config for config in self.configs if config.settings_key() not in kept]

    def trained_entries(self, runs: Sequence[Run], stores: dict[str, ViewStore]) -> list[Entry]:
        """What is kept, and runs. Raises ViewnetError where what is kept is of photographs of another version."""
        self.check_photographs(self.kept, stores)
        return [*self.kept, *super().trained_entries(runs, stores)]

    @property
    def kept_seeds(self) -> set[int]:
        """The seeds of the runs that are kept."""
        return {entry.seed for entry in self.kept}


def study_alignment(experiment: PhotoExperiment, runs: Sequence[Run]) -> Study:
    """The study of every predictor of Table 3, and a random one, on the photographs of an experiment."""
    rows, draws = list(predictors(experiment, runs)), 1 if experiment.smoke else DRAWS
    scores = pd.DataFrame([line for predictor in rows for line in score_rows(predictor, draws=draws)])
    collapse = pd.DataFrame([line for predictor in rows if not predictor.fitted for line in collapse_rows(predictor)])
    return Study(scores, collapse)


def predictors(experiment: PhotoExperiment, runs: Sequence[Run]) -> Iterator[Predictor]:
    """The runs, then what needs no training, category by category."""
    stores = experiment.stores()

    def fixed(label: str, category: str, seed: int, predictions: Predictions) -> Predictor:
        return Predictor(label, category, seed, lambda count, seed: predictions, fitted=False)

    def fitted(variant: str, category: str, count: int | None, seed: int) -> Predictions:
        return experiment.fitted(variant, stores[category], count, seed)[0]

    for entry in replace(experiment, name=TABLE).trained_entries(runs, stores):  # the study has no rows of its own
        if entry.alignment == "procrustes":  # the same predictions stand in rows of other alignments
            yield fixed(entry.row, entry.category, entry.seed, entry.predictions)
    for category, store in stores.items():
        # What linear alignment adds to random predictions it adds by the viewpoints' distribution alone.
        yield fixed(RANDOM, category, 0, baselines.random(store.index, seed=RANDOM_SEED))
        for row in LAYOUTS[TABLE].rows:
            if row.variant in FITTED:
                yield Predictor(row.label, category, 0, partial(fitted, row.variant, category), fitted=True)


def score_rows(predictor: Predictor, counts: Sequence[int] = COUNTS, draws: int = DRAWS) -> Iterator[dict[str, Any]]:
    """The rows of Study.scores for one predictor: `draws` of each number of photographs, and all of them once."""
    total = len(predictor.predict(None, 0).subset("val"))
    tries = [(count, draw) for count in counts if count < total for draw in range(draws)]
    for count, draw in [*tries, (total, 0)]:
        predictions = predictor.predict(count, draw)
        for kind in ("none", *KINDS) if predictor.fitted else KINDS:
            # A fitted predictor's calibration photographs are those it was fitted on.
            aligned = align(predictions, kind, min(count, len(predictions.subset("val"))), draw)
            yield {**predictor.row, "alignment": kind, "images": count, "draw": draw, **_scores(aligned)}


def collapse_rows(predictor: Predictor) -> Iterator[dict[str, Any]]:
    """The rows of Study.collapse for one predictor, without subsets of fewer than FEWEST photographs."""
    predictions = predictor.predict(None, 0)
    for concentration in CONCENTRATIONS:
        if (subset := one_sided(predictions, concentration)) is None:
            continue
        val, test = subset.subset("val"), subset.subset("test")
        azimuths = test.ids["azimuth"].to_numpy()
        linear = Linear.fit(val.selected, val.truth)  # weights near zero leave the mean viewpoint
        row = {**predictor.row, "concentration": concentration, "calibrating": len(val), "scored": len(test)}
        row |= {"side": side(azimuths), "confidence_index": metrics.confidence_index(azimuths)}
        row |= {name: float(np.linalg.norm(getattr(linear, name))) for name in ("weights", "bias")}
        constant = baselines.constant(subset.ids, source="val")  # what a collapsed alignment amounts to
        kinds = (("rigid", subset, "procrustes"), ("linear", subset, "linear"), ("constant", constant, "none"))
        for name, predicted, kind in kinds:
            aligned = align(predicted, kind)
            scores = _scores(aligned)
            if name != "constant":  # whose spread is 0
                row[f"spread_{name}"] = spread(aligned.selected) / spread(test.truth)  # 1: as varied as the truth
            row |= {f"{metric}_{name}": scores[metric] for metric in ("acc30", "dva")}
        yield row


def side(azimuths: np.ndarray) -> float:
    """The share of azimuths (N,), degrees, in the fullest of the twelve bins: from 1/12 to 1."""
    return float(np.bincount(metrics.azimuth_bins(azimuths)).max() / len(azimuths))


def spread(vectors: np.ndarray) -> float:
    """The variance of unit vectors (N, 3), 1 - |mean|^2: 0 where they are all alike, 1 where they cancel out."""
    return float(np.square(vectors - vectors.mean(axis=0)).sum(axis=1).mean())


def one_sided(predictions: Predictions, concentration: float) -> Predictions | None:
    """A random subset of images around their commonest azimuth: all at concentration 0, fewer sides the larger it is.

    An image at azimuth a is kept with probability exp(k (cos(a - m) - 1)), k the concentration and m the middle of the
    fullest bin of the split "val". None where a split is left with fewer than FEWEST images. ViewnetError for k < 0.
    """
    if concentration < 0:
        raise ViewnetError(f"concentration {concentration}: expected 0 or more")
    azimuths = predictions.ids["azimuth"].to_numpy()
    calibrating = (predictions.ids["split"] == "val").to_numpy()
    width = 360 / metrics.AZIMUTH_BINS  # degrees
    # Of the calibration photographs alone: the choice of the subset must not depend on what is scored.
    middle = (np.bincount(metrics.azimuth_bins(azimuths[calibrating])).argmax() + 0.5) * width
    probability = np.exp(concentration * (np.cos(np.deg2rad(azimuths - middle)) - 1))
    # Sampled in the order of names, so that every predictor keeps the same images whatever their order.
    rank = predictions.ids.sort_values(["model_id", "view"]).index.argsort()
    stays = np.random.default_rng(0).random(len(azimuths))[rank] < probability
    fewest = min(np.sum(stays & calibrating), np.sum(stays & ~calibrating))
    return None if fewest < FEWEST else predictions.take(stays)


def _scores(aligned: Aligned) -> dict[str, float]:
    values = metrics.summary(aligned.selected_errors, aligned.predictions.ids["azimuth"].to_numpy())
    return {metric: values[metric] for metric in METRICS}
