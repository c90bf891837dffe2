"""What a notebook shows: the committed tables and figures, and in one more cell those that a run has just made.

Either is drawn from files, by the same code as the overview page, so that what is seen is what the files say. A run
makes what is missing and writes its tables and figures into the request's folders.
"""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from viewnet import paths
from viewnet.estimator import turntable, volume_mesh
from viewnet.evaluation.run import Run
from viewnet.experiments.alignment_study import study_alignment
from viewnet.experiments.cad import Experiment
from viewnet.experiments.own_method import Submission
from viewnet.experiments.page import page
from viewnet.experiments.page.images import captions
from viewnet.experiments.reported_constants import audit_file
from viewnet.recipes import make_config
from viewnet.runtime import provenance
from viewnet.runtime.files import write_csv
from viewnet.runtime.image_files import opened
from viewnet.tables import claims, definitions, image_grids, kept_predictions, novel_view_scores, plots, run_renderer
from viewnet.tables.architecture import architectures

UNKNOWN = "drawn by an earlier version: the files do not say from which runs"
"""Below figures that have no note."""


@dataclass(frozen=True)
class Shown:
    """A part of what a notebook shows: lines of text, HTML, or a PNG file in base64, by its MIME `kind`."""

    kind: str
    content: str
    about: str = ""  # of an image


def evidence(name: str, setting: str = "") -> None:
    """Show the committed tables and figures of a notebook; `setting` is a folder's name, "" for the usual one."""
    _display(committed(name, setting))


def live(request: Experiment, submissions: Sequence[Submission] = ()) -> None:
    """Run what is missing, write tables and figures, and show them; `submissions` are a user's own methods.

    Raises ViewnetError as Experiment.run does, and AssertionError for a table with a row that was not measured.
    """
    files = write(request, submissions)
    _display([*drawn(request.name, files), _text([f"files: {', '.join(map(str, files))}"])])


def committed(name: str, setting: str = "") -> list[Shown]:
    """What `evidence` shows, then the verdicts of claims that read it; a line says so where nothing is committed."""
    files = page.found(paths.part("paper_tables")).get(name, {}).get(setting, [])
    where = f"paper_tables/{setting}".rstrip("/")
    if not files:
        return [_text([f"{where} has nothing of this notebook yet: run it below"])]
    folder = paths.part("paper_tables")
    judged = claims.judge(folder, [path.relative_to(folder).as_posix() for path in files])
    return [*drawn(name, files), *([_text(list(map(str, judged)))] if judged else [])]


def drawn(name: str, files: Sequence[Path]) -> list[Shown]:
    """Tables with what they were measured on, `Table.verdict` where predictions are kept, and images.

    Raises ViewnetError for a file that this version does not write.
    """
    content = page.read(name, files)
    images = [path for path in files if path.suffix == ".png"]
    tables = [path for path in files if path.suffix == ".json" and path.with_suffix(".parquet").is_file()]
    notes = list(dict.fromkeys(map(_note, images)))
    above = int(any(path.suffix == ".json" for path in files))  # the note of what a table was measured on
    shown = [_text([line for line in (*content.notes[:above], page.summary(content.runs.values()), *notes) if line])]
    blocks = page.ENVIRONMENT.get_template("overview_blocks.html").module
    for block in content.blocks:
        html = str(blocks.measured(block) if hasattr(block, "parts") else blocks.plain(block))  # type: ignore[attr-defined]
        # Within Markdown, blank lines would end it and indented ones be code.
        shown.append(Shown("text/html", "\n".join(line.strip() for line in html.splitlines() if line.strip())))
    verdicts = [sentence for path in tables for sentence in kept_predictions.read(path).verdict()]
    shown += [_text([*verdicts, *content.notes[above:]])]
    for path in images:
        shown.append(Shown("image/png", base64.b64encode(path.read_bytes()).decode(), captions(path.stem)[1]))
    return [part for part in shown if part.content]


def _text(lines: Sequence[str]) -> Shown:
    return Shown("text/plain", "".join(f"{line}\n" for line in lines))


def _note(path: Path) -> str:
    """Of what runs a figure is."""
    with opened(path) as image:
        return str(image.info.get(plots.NOTE, UNKNOWN))


def _display(shown: Sequence[Shown]) -> None:
    from IPython.display import HTML, Image, display

    for part in shown:
        if part.kind == "text/plain":
            print(part.content, end="")
        elif part.kind == "text/html":
            display(HTML(part.content))
        else:
            display(Image(base64.b64decode(part.content), alt=part.about))


def write(request: Any, submissions: Sequence[Submission] = ()) -> list[Path]:
    """The files of a request (viewnet.experiments.experiment), made now; `submissions` are rows for "your_method".

    Raises ViewnetError as Experiment.run does, and AssertionError for a table with a row that was not measured.
    """
    return [path for paths in _parts(request, submissions) for path in paths]


def _parts(request: Any, submissions: Sequence[Submission]) -> Iterator[list[Path]]:
    """The files of one table or figure after another."""
    folder, runs = request.folder, request.run() if request.variants else []
    origins = [run.result for run in runs]

    def saved(
        figure: Figure, name: str, shown: Sequence[Mapping[str, Any]] = origins, place: Path = request.figures
    ) -> list[Path]:
        """A figure, with a note of the origins of its runs in it."""
        commits = ", ".join(sorted({provenance.in_words(about["git"]) for about in shown}))
        return plots.save(figure, place, name, f"{request.note}; commit {commits}")

    match request.name:
        case "architecture":
            yield from (part.write(folder) for part in architectures(make_config(profile=request.profile).model))
        case "audit_metrics":
            yield audit_file(request.viewpoints).write(folder)
        case "alignment_study":
            study = study_alignment(request, runs)
            origins += [entry.origin for entry in request.kept]
            yield study.write(folder)
            yield saved(plots.calibration_curves(study.scores), "alignment_calibration", place=folder)
            yield saved(plots.collapse_curves(study.collapse), "alignment_collapse", place=folder)
        case "figure3_azimuth":
            yield saved(plots.azimuth_scatter(runs), "figure3_azimuth", place=folder)
            yield saved(image_grids.candidate_figure(runs), "figure3_candidates", place=folder)
        case "failures":
            for run in runs:
                yield saved(image_grids.failures(run), f"failures_{run.config.category}", [run.result])
        case "learned_volumes":
            for run in runs:
                yield saved(image_grids.volumes([run]), f"volumes_{run.config.category}", [run.result])
                yield _first_object(run, request.figures)
        case "novel_views":
            yield novel_view_scores.write(novel_view_scores.cells(request.kept), folder, request.note)
            for category in request.categories:
                if mine := [run for run in runs if run.config.category == category]:
                    yield saved(image_grids.around(mine), f"novel_views_{category}", [run.result for run in mine])
        case "reconstructions":
            stores = request.stores()
            drawn = image_grids.reconstructions(runs, lambda run: stores[run.config.category], count=6)
            yield saved(drawn, "reconstructions")
        case "training_curves":
            logs = plots.training_logs(runs)
            yield [write_csv(request.figures / "training_curves.csv", logs.round(4))]
            yield saved(plots.training_curves(logs), "training_curves")
        case name:
            tables = request.score(runs, submissions).values() if name == "your_method" else [request.table(runs)]
            for table in tables:
                assert table.complete, f"{table.name}: not every row of ours is measured in every category"
                yield definitions.write_with(table, folder)
            if name == "photographs_study":
                yield saved(plots.reliability(request.answers(runs)), "reliability", place=folder)
            if name == "test_sets":
                yield [write_csv(folder / "test_sets_nearest.csv", request.nearness(), index=True)]


def _first_object(run: Run, folder: Path) -> list[Path]:
    """The first test object of a run as a mesh, and on a turntable from its predicted viewpoint on."""
    (renderer,) = run_renderer.renderers([run])
    category, ids = run.config.category, renderer.aligned.predictions.ids.iloc[0]
    encoded = renderer.encode([0])
    mesh = volume_mesh.surface(encoded.volume[0], renderer.rotation)
    path = folder / "meshes" / category / f"{ids['model_id']}-{ids['view']}.glb"
    image, frame = renderer.test_images([0])[0], renderer.predicted_frames([0])[0]
    images = turntable.animate(renderer, image, encoded, frame)
    return [volume_mesh.write(mesh, path), turntable.save(images, folder / f"turntable_{category}.gif")]
