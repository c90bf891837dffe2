"""What the notebooks make: each runs what is missing and writes its tables and figures into the request's folders."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from viewnet.estimator import turntable, volume_mesh
from viewnet.evaluation.run import Run
from viewnet.experiments.alignment_study import study_alignment
from viewnet.experiments.own_method import Submission
from viewnet.experiments.reported_constants import audit_file
from viewnet.recipes import make_config
from viewnet.runtime.files import write_csv
from viewnet.tables import definitions, failures, image_grids, novel_view_scores, plots, run_renderer
from viewnet.tables.architecture import architectures
from viewnet.tables.table import Table

Runs = Sequence[Run]


def write(request: Any, submissions: Sequence[Submission] = ()) -> list[Path]:
    """The files of a request (viewnet.experiments.experiment), made now; `submissions` are rows for "your_method".

    Raises ViewnetError as Experiment.run does, and AssertionError for a table with a row that was not measured.
    """
    if request.name == "architecture":
        parts = architectures(make_config(profile=request.profile).model)
        return [path for part in parts for path in part.write(request.folder)]
    if request.name == "audit_metrics":
        return audit_file(request.viewpoints).write(request.folder)
    runs = request.run()
    if request.name == "your_method":
        tables = request.score(runs, submissions).values()
        return [path for table in tables for path in _written(table, request.folder)]
    return [path for paths in PARTS.get(request.name, _table)(request, runs) for path in paths]


def _written(table: Table, folder: Path) -> list[Path]:
    assert table.complete, f"{table.name}: not every row of ours is measured in every category"
    return table.write(folder)


def _saved(request: Any, runs: Runs, figure: Figure, name: str, beside_tables: bool = False) -> list[Path]:
    """A figure, with a note of its runs in it."""
    commits = ", ".join(sorted({str(run.result["git"]["commit"])[:7] for run in runs}))
    folder = request.folder if beside_tables else request.figures
    return plots.save(figure, folder, name, f"{request.note}; commit {commits}")


Parts = Iterator[list[Path]]
"""The files of one table or figure after another."""


def _table(request: Any, runs: Runs) -> Parts:
    table = request.table(runs)
    yield _written(table, request.folder)
    if table.name == "table2_ablation":
        yield [definitions.write(table, request.folder)]
    if table.name == "test_sets":
        yield [write_csv(request.folder / "test_sets_nearest.csv", request.nearness(), index=True)]


def _study(request: Any, runs: Runs) -> Parts:
    study = study_alignment(request, runs)
    yield study.write(request.folder)
    yield _saved(request, runs, plots.calibration_curves(study.scores), "alignment_calibration", True)
    yield _saved(request, runs, plots.collapse_curves(study.collapse), "alignment_collapse", True)


def _azimuth(request: Any, runs: Runs) -> Parts:
    yield _saved(request, runs, plots.azimuth_scatter(runs), "figure3_azimuth", True)
    yield _saved(request, runs, image_grids.candidate_figure(runs), "figure3_candidates", True)


def _failures(request: Any, runs: Runs) -> Parts:
    return (_saved(request, [run], failures.gallery(run), f"failures_{run.config.category}") for run in runs)


def _volumes(request: Any, runs: Runs) -> Parts:
    """Images; the first test object of each run as a mesh, and on a turntable from its predicted viewpoint on."""
    for run, renderer in zip(runs, run_renderer.renderers(runs), strict=True):
        category, ids = run.config.category, renderer.aligned.predictions.ids.iloc[0]
        yield _saved(request, [run], image_grids.volumes([run]), f"volumes_{category}")
        encoded = renderer.encode([0])
        mesh = volume_mesh.surface(encoded.volume[0], renderer.rotation)
        path = request.figures / "meshes" / category / f"{ids['model_id']}-{ids['view']}.glb"
        image, frame = renderer.test_images([0])[0], renderer.predicted_frames([0])[0]
        images = turntable.animate(renderer, image, encoded, frame)
        yield [volume_mesh.write(mesh, path), turntable.save(images, request.figures / f"turntable_{category}.gif")]


def _novel_views(request: Any, runs: Runs) -> Parts:
    yield novel_view_scores.write(novel_view_scores.cells(runs), request.folder, request.note)
    for category in request.categories:
        mine = [run for run in runs if run.config.category == category]
        yield _saved(request, mine, image_grids.around(mine), f"novel_views_{category}")


def _reconstructions(request: Any, runs: Runs) -> Parts:
    photographs = request.stores()
    drawn = image_grids.reconstructions(runs, lambda run: photographs[run.config.category], count=6)
    yield _saved(request, runs, drawn, "reconstructions")


def _curves(request: Any, runs: Runs) -> Parts:
    logs = plots.training_logs(runs)
    yield [write_csv(request.figures / "training_curves.csv", logs.round(4))]
    yield _saved(request, runs, plots.training_curves(logs), "training_curves")


PARTS: dict[str, Callable[[Any, Runs], Parts]] = {
    "alignment_study": _study,
    "figure3_azimuth": _azimuth,
    "failures": _failures,
    "learned_volumes": _volumes,
    "novel_views": _novel_views,
    "reconstructions": _reconstructions,
    "training_curves": _curves,
}
"""Notebook -> what writes its files; of others, the table of their name."""
