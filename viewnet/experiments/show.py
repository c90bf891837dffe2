"""What a notebook shows: the committed tables and figures, and in one more cell those that a run has just made.

Either is drawn from files, by the same code as the overview page, so that what is seen is what the files say.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from viewnet import paths
from viewnet.experiments import outputs
from viewnet.experiments.cad import Experiment
from viewnet.experiments.own_method import Submission
from viewnet.experiments.page import page
from viewnet.experiments.page.images import captions
from viewnet.runtime.image_files import opened
from viewnet.tables import kept_predictions
from viewnet.tables.plots import NOTE

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
    files = outputs.write(request, submissions)
    _display([*drawn(request.name, files), _text([f"files: {', '.join(map(str, files))}"])])


def committed(name: str, setting: str = "") -> list[Shown]:
    """What `evidence` shows; a line that says so where nothing is committed."""
    files = page.found(paths.part("paper_tables")).get(name, {}).get(setting, [])
    where = f"paper_tables/{setting}".rstrip("/")
    return drawn(name, files) if files else [_text([f"{where} has nothing of this notebook yet: run it below"])]


def drawn(name: str, files: Sequence[Path]) -> list[Shown]:
    """Tables with what they were measured on, `Table.verdict` where predictions are kept, and images.

    Raises ViewnetError for a file that this version does not write.
    """
    content, origins = page.read(name, files)
    images = [path for path in files if path.suffix == ".png"]
    tables = [path for path in files if path.suffix == ".json" and path.with_suffix(".parquet").is_file()]
    notes = list(dict.fromkeys(map(_note, images)))
    above = int(any(path.suffix == ".json" for path in files))  # the note of what a table was measured on
    shown = [_text([line for line in (*content.notes[:above], page.summary(origins), *notes) if line])]
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
        return str(image.info.get(NOTE, UNKNOWN))


def _display(shown: Sequence[Shown]) -> None:
    from IPython.display import HTML, display
    from IPython.display import Image as Picture

    for part in shown:
        if part.kind == "text/plain":
            print(part.content, end="")
        elif part.kind == "text/html":
            display(HTML(part.content))
        else:
            display(Picture(base64.b64decode(part.content), alt=part.about))
