"""What the notebooks make: each runs what is missing and writes its tables and figures into the request's folders."""

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from viewnet.estimator import turntable, volume_mesh
from viewnet.evaluation.run import Run
from viewnet.experiments.alignment_study import study_alignment
from viewnet.experiments.cad import Experiment
from viewnet.experiments.other_sets import OtherSetsExperiment
from viewnet.experiments.own_method import OwnMethodExperiment, Submission
from viewnet.experiments.photos import PhotoExperiment
from viewnet.experiments.reported_constants import audit_file
from viewnet.recipes import make_config
from viewnet.runtime.files import write_text
from viewnet.tables import definitions, failures, image_grids, novel_view_scores, plots, run_renderer
from viewnet.tables.architecture import architectures
from viewnet.tables.table import Table

Files = list[Path]


def write(request: Experiment, submissions: Sequence[Submission] = ()) -> Files:
    """The files of a request, made now; `submissions` are rows for tables that take them.

    Raises ViewnetError as Experiment.run does, and AssertionError where something does not hold that always must.
    """
    if isinstance(request, OwnMethodExperiment):
        tables = request.score(request.run(), submissions)
        return [path for table in tables.values() for path in _table(table, request.folder)]
    if request.name in UNTRAINED:
        return UNTRAINED[request.name](request)
    if request.name in TRAINED:
        return TRAINED[request.name](request, request.run())
    return _table(request.table(request.run()), request.folder)


def _hold(checks: dict[str, bool]) -> None:
    failed = [what for what, holds in checks.items() if not holds]
    assert not failed, f"does not hold: {'; '.join(failed)}"


def _figure(request: Experiment, runs: Sequence[Run], figure: Figure, folder: Path, name: str) -> Files:
    commits = ", ".join(sorted({(run.result["git"]["commit"] or "")[:7] for run in runs}))
    return plots.save(figure, folder, name, f"{request.note}; commit {commits}")


def _table(table: Table, folder: Path) -> Files:
    _hold(table.checks())
    return table.write(folder)


def _ablation(request: Experiment, runs: Sequence[Run]) -> Files:
    table = request.table(runs)
    return [*_table(table, request.folder), definitions.write(table, request.folder)]


def _test_sets(request: Experiment, runs: Sequence[Run]) -> Files:
    assert isinstance(request, OtherSetsExperiment)
    nearest = request.folder / "test_sets_nearest.csv"
    write_text(nearest, request.nearness().to_csv(lineterminator="\n"))
    return [*_table(request.table(runs), request.folder), nearest]


def _study(request: Experiment, runs: Sequence[Run]) -> Files:
    assert isinstance(request, PhotoExperiment)
    study = study_alignment(request, runs)
    _hold(study.checks())
    calibration = _figure(request, runs, plots.calibration_curves(study.scores), request.folder, "alignment_calibration")
    collapse = _figure(request, runs, plots.collapse_curves(study.collapse), request.folder, "alignment_collapse")
    return [*study.write(request.folder), *calibration, *collapse]


def _azimuth(request: Experiment, runs: Sequence[Run]) -> Files:
    azimuth = _figure(request, runs, plots.azimuth_scatter(runs), request.folder, "figure3_azimuth")
    return [*azimuth, *_figure(request, runs, image_grids.candidate_figure(runs), request.folder, "figure3_candidates")]


def _failures(request: Experiment, runs: Sequence[Run]) -> Files:
    drawn = [_figure(request, runs, failures.gallery(r), request.figures, f"failures_{r.config.category}") for r in runs]
    return [path for paths in drawn for path in paths]


def _volumes(request: Experiment, runs: Sequence[Run]) -> Files:
    """Images; the first test object of each run as a coloured mesh in `meshes/<category>/` (GLB), and on a turntable
    (GIF) that begins at the predicted viewpoint."""
    files: Files = []
    for renderer in run_renderer.renderers(runs):
        category, ids = renderer.config.category, renderer.aligned.predictions.ids.iloc[0]
        encoded = renderer.encode([0])
        mesh = volume_mesh.surface(encoded.volume[0], renderer.rotation)
        path = request.figures / "meshes" / category / f"{ids['model_id']}-{ids['view']}.glb"
        files.append(volume_mesh.write(mesh, path))
        image, frame = renderer.test_images([0])[0], renderer.predicted_frames([0])[0]
        images = turntable.animate(renderer, image, encoded, frame, renderer.aligned.selected[0])
        files.append(turntable.save(images, request.figures / f"turntable_{category}.gif"))
    for run in runs:
        files += _figure(request, runs, image_grids.volumes([run]), request.figures, f"volumes_{run.config.category}")
    return files


def _novel_views(request: Experiment, runs: Sequence[Run]) -> Files:
    files = novel_view_scores.write(novel_view_scores.cells(runs), request.folder, request.note)
    for category in request.categories:
        mine = [run for run in runs if run.config.category == category]
        files += _figure(request, runs, image_grids.around(mine), request.figures, f"novel_views_{category}")
    return files


def _reconstructions(request: Experiment, runs: Sequence[Run]) -> Files:
    assert isinstance(request, PhotoExperiment)
    photographs = request.stores()
    drawn = image_grids.reconstructions(runs, lambda run: photographs[run.config.category], count=6)
    return _figure(request, runs, drawn, request.figures, "reconstructions")


def _curves(request: Experiment, runs: Sequence[Run]) -> Files:
    logs = plots.training_logs(runs)
    table = request.figures / "training_curves.csv"
    write_text(table, logs.round(4).to_csv(index=False, lineterminator="\n"))
    return [table, *_figure(request, runs, plots.training_curves(logs), request.figures, "training_curves")]


def _architecture(request: Experiment) -> Files:
    parts = architectures(make_config(profile=request.profile).model)
    return [path for part in parts for path in part.write(request.folder)]


def _audit(request: Experiment) -> Files:
    audit = audit_file(request.viewpoints)
    _hold(audit.checks())
    return audit.write(request.folder)


TRAINED: dict[str, Callable[[Experiment, Sequence[Run]], Files]] = {
    "table2_ablation": _ablation,
    "test_sets": _test_sets,
    "alignment_study": _study,
    "figure3_azimuth": _azimuth,
    "failures": _failures,
    "learned_volumes": _volumes,
    "novel_views": _novel_views,
    "reconstructions": _reconstructions,
    "training_curves": _curves,
}
UNTRAINED: dict[str, Callable[[Experiment], Files]] = {"architecture": _architecture, "audit_metrics": _audit}
"""Notebook -> what writes its files; of others, the table of their name."""
