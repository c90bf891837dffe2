"""One page of all tables and figures: `paper_tables/index.html`, a single file without scripts, made of the others.

The page says nothing that is not in the files of the folder, in the notebooks' first cells or in print, so it is the
same whenever it is written from the same files.
"""

from __future__ import annotations

import functools
import logging
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import jinja2
import mistune
import nbformat
from markupsafe import Markup

from viewnet.errors import ViewnetError
from viewnet.experiments import notebooks
from viewnet.experiments.page import blocks
from viewnet.experiments.page.blocks import Block, Content
from viewnet.experiments.page.images import SUFFIXES, EmbeddedImage, embedded
from viewnet.experiments.request import DESIGNS
from viewnet.runtime.files import read_json, write_text
from viewnet.runtime.progress import bar

log = logging.getLogger(__name__)

NAME = "index.html"
LIMIT = 8_000_000
"""Bytes; a page that would be larger has its figures shrunk."""
WIDTHS = (1700, 1000, 500)
"""Pixels that a figure has at most: the first that makes a page within the limit."""
LEFT_OUT = ("published/*", NAME, ".*")


@dataclass(frozen=True)
class Kind:
    """A section of the page: whose files it shows.

    name      of its notebook, or of what else makes it
    chapter   what it stands under
    patterns  its files' names
    folder    the folder of `paper_tables` that they lie in; what lies deeper is of another setting, named by its folder
    title, lead, command   what a section without a notebook is called, says, and is made by
    """

    name: str
    chapter: str
    patterns: tuple[str, ...]
    folder: str = ""
    title: str = ""
    lead: str = ""
    command: str = ""


def _table(name: str) -> Kind:
    return Kind(name, "Tables", (f"{name}.*",))


KINDS = (
    _table("table1_shapenet"),
    _table("table2_ablation"),
    _table("table3_pascal3d"),
    _table("table4_freiburg"),
    _table("table5_dva"),
    _table("objectron"),
    Kind("figure3_azimuth", "Figures", ("figure3_*",)),
    Kind("novel_views", "Figures", ("novel_views.*",)),
    Kind("novel_views", "Figures", ("novel_views_*",), "figures"),
    Kind("learned_volumes", "Figures", ("volumes_*", "turntable_*", "*.glb"), "figures"),
    Kind("reconstructions", "Figures", ("reconstructions.*",), "figures"),
    Kind("training_curves", "Figures", ("training_curves.*",), "figures"),
    Kind("failures", "Figures", ("failures_*",), "figures"),
    Kind("alignment_study", "Studies", ("alignment_*",)),
    Kind("audit_metrics", "Studies", ("audit_*", "stand_in_*")),
    Kind("architecture", "Studies", ("architecture_*",)),
    Kind(
        "predicting",
        "Machinery",
        ("predicting.*",),
        "benchmarks",
        "Answers",
        "How soon one image's viewpoint is told by a fresh interpreter, and how many images a second the estimator "
        "takes beside the bare network.",
        "python benchmarks/predicting.py",
    ),
    Kind(
        "bench",
        "Machinery",
        ("*",),
        "benchmarks",
        "Speed",
        "How long the volume renderer and the training step take, and how much memory, beside a plain textbook version "
        "of the same work, measured in turn on the same machine.",
        "viewnet bench",
    ),
    Kind(
        "fuzz",
        "Machinery",
        ("fuzz.*",),
        "trust",
        "Damaged files",
        "Every reader of files is given damaged ones. Each case has to end in a result, or in one error that names the "
        "file.",
        "python benchmarks/fuzz.py --cases 300",
    ),
    Kind(
        "crashes",
        "Machinery",
        ("crashes.*", "pairs.*"),
        "trust",
        "Killed work",
        "Views, runs and tables whose making is killed at any moment, or asked for by two processes at once: files "
        "that were damaged, and whether the end is that of undisturbed work.",
        "python benchmarks/crashes.py --kills 50 --pairs 20",
    ),
    Kind(
        "faults",
        "Machinery",
        ("faults.*",),
        "trust",
        "Disturbed work",
        "A full disk, a folder that is closed, a download that broke off, clocks that go wrong, a loss that is not "
        "finite: errors seen, those that name the place, what was damaged, and what the same command comes to then.",
        "python benchmarks/faults.py",
    ),
    Kind("your_method", "Other methods", ("*",), "your_method"),
    Kind("other", "Other files", ("*",), title="Other files", lead="Files that no notebook of this version writes."),
)


@dataclass(frozen=True)
class Setting:
    """What a section shows at one setting: one profile, data set or machine."""

    name: str  # of its folder, "" for the plain default
    blocks: tuple[Block, ...]
    notes: tuple[str, ...]
    origins: tuple[dict[str, str], ...]
    summary: str
    images: tuple[EmbeddedImage, ...]
    files: tuple[str, ...]  # relative to the page


@dataclass(frozen=True)
class Section:
    """A section of the page."""

    name: str
    chapter: str
    title: str
    lead: Markup
    command: str
    settings: tuple[Setting, ...]


def write(folder: Path) -> Path:
    """Write the page of the tables and figures in `folder`; returns its path.

    Raises ViewnetError for a folder without any, and naming the file where one cannot be read.
    """
    for widest in WIDTHS:
        page = render(sections(folder, widest))
        if len(page.encode()) <= LIMIT:
            break
        log.warning("the page has %.1f MB with figures of %d pixels", len(page.encode()) / 1e6, widest)
    write_text(folder / NAME, page)
    return folder / NAME


def render(found: list[Section]) -> str:
    """The page as HTML."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("viewnet.experiments.page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    chapters: dict[str, list[Section]] = {}
    for section in found:
        chapters.setdefault(section.chapter, []).append(section)
    there = {section.name for section in found}
    missing = [(k.name, heading(k)[0]) for k in KINDS if k.name in DESIGNS and k.name not in there]
    origins = {o["key"]: o for section in found for setting in section.settings for o in setting.origins}
    return environment.get_template("overview.html").render(
        chapters=chapters, missing=dict(missing), summary=_summary(origins.values()), runs=len(origins)
    )


def sections(folder: Path, widest: int = WIDTHS[0]) -> list[Section]:
    """What is in a folder of tables and figures, in the order of KINDS. ViewnetError where that is nothing."""
    files: dict[str, dict[str, list[Path]]] = {}
    for path in sorted(folder.rglob("*")):
        place = path.relative_to(folder)
        if path.is_file() and not any(fnmatch(str(place), pattern) for pattern in LEFT_OUT):
            name, setting = _place(place)
            files.setdefault(name, {}).setdefault(setting, []).append(path)
    if not files:
        raise ViewnetError(f"{folder}: no tables and no figures: make some first (viewnet tables)")
    known = _origins(path for settings in files.values() for paths in settings.values() for path in paths)
    kinds = {kind.name: kind for kind in reversed(KINDS)}
    found = []
    with bar(True, total=sum(map(len, files.values())), desc=NAME, unit="part", leave=False) as progress:
        for name in dict.fromkeys(kind.name for kind in KINDS if kind.name in files):
            settings = []
            for setting, paths in sorted(files[name].items()):
                settings.append(_setting(name, setting, paths, folder, known, widest))
                progress.update()
            found.append(Section(name, kinds[name].chapter, *heading(kinds[name]), tuple(settings)))
    return found


def _place(path: Path) -> tuple[str, str]:
    """The section and the setting of a file, by its path below the folder of tables."""
    folders = path.parts[:-1]
    for kind in sorted(KINDS, key=lambda kind: not kind.folder):  # a folder of its own decides before a name
        inside = folders[1:] if kind.folder else folders
        if kind.folder and folders[:1] != (kind.folder,):
            continue
        if any(fnmatch(path.name, pattern) for pattern in kind.patterns):
            if "meshes" in inside:  # a folder a category
                inside = inside[: inside.index("meshes")]
            return kind.name, "/".join(inside)
    raise AssertionError("the last kind takes all")


def _setting(
    name: str, setting: str, paths: list[Path], folder: Path, known: Mapping[str, dict[str, Any]], widest: int
) -> Setting:
    told = _told(name, {path.name: path for path in paths})
    origins = {key.partition("/")[0]: known.get(key, origin) for key, origin in (told.origins or {}).items()}
    shown = tuple({"key": key, **_origin(origin)} for key, origin in sorted(origins.items()))
    images = [path for path in paths if path.suffix in SUFFIXES]
    drawn = {path.stem for path in images}
    return Setting(
        setting,
        told.blocks,
        told.notes,
        shown,
        _summary(shown),
        tuple(
            embedded(
                p, widest, [q.relative_to(folder) for q in paths if q.stem == p.stem and q.suffix in (".pdf", p.suffix)]
            )
            for p in images
        ),
        tuple(
            path.relative_to(folder).as_posix()
            for path in paths
            if not (path.stem in drawn and path.suffix in (*SUFFIXES, ".pdf"))
        ),
    )


def _told(name: str, files: Mapping[str, Path]) -> Content:
    """What the files of a section hold; ViewnetError where they are not as this version writes them."""
    try:
        return blocks.READERS.get(name, blocks.tables)(files)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, ViewnetError):
            raise
        names = ", ".join(str(path) for path in files.values() if path.suffix in (".json", ".csv"))
        raise ViewnetError(
            f"{names}: not as this version writes it ({type(error).__name__}: {error}): make it again"
        ) from error


def _origins(paths: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """Every run that a table's JSON tells the origin of, by its key."""
    found: dict[str, dict[str, Any]] = {}
    for path in paths:
        if path.suffix == ".json" and isinstance(told := read_json(path), dict) and isinstance(told.get("runs"), dict):
            found |= told["runs"]
    return found


def _origin(origin: Mapping[str, Any]) -> dict[str, str]:
    """A run's origin as the page shows it; "" for what is not known of it."""
    training = origin.get("training") or {}
    git, hardware = training.get("git") or origin.get("git") or {}, training.get("hardware") or {}
    commit = (git.get("commit") or "")[:7] + (" (changed)" if git.get("dirty") else "")
    return {
        "what": " ".join(str(origin[name]) for name in ("variant", "category") if name in origin),
        **{name: str(origin.get(name, "")) for name in ("seed", "profile", "recipe")},
        "commit": commit,
        "date": (training.get("finished") or "")[:10],
        "minutes": f"{training['seconds'] / 60:.1f}" if "seconds" in training else "",
        "machine": hardware.get("gpu") or hardware.get("processor") or "",
        "threads": str(hardware.get("threads", "")),
    }


def _summary(origins: Iterable[Mapping[str, str]]) -> str:
    """Profiles, recipes, dates, machines and commits of runs, in a line."""
    listed = list(origins)
    parts = []
    for name in ("profile", "recipe", "date", "machine", "commit"):
        if values := sorted({origin[name] for origin in listed if origin[name]}):
            if name == "date":
                parts.append("trained " + " to ".join(dict.fromkeys((values[0], values[-1]))))
            else:
                parts.append(f"{name}{'s' * (len(values) > 1)} {', '.join(values)}")
    return " · ".join(parts)


def heading(kind: Kind) -> tuple[str, Markup, str]:
    """A section's title, what it shows, and the command that makes it: of a notebook by its first cell."""
    if kind.title:
        return kind.title, _html(kind.lead), kind.command
    return *_first_cell(notebooks.find(kind.name)), f"viewnet notebook {kind.name}"


@functools.cache
def _first_cell(path: Path) -> tuple[str, Markup]:
    try:
        source = str(nbformat.read(path, as_version=4).cells[0].source)
    except Exception as error:  # nbformat raises whatever a damaged file makes it stumble over
        raise ViewnetError(f"{path}: not a notebook that can be read ({type(error).__name__})") from None
    title, *paragraphs = re.split(r"\n\s*\n", source.strip())
    return title.lstrip("# ").strip(), _html(paragraphs[0] if paragraphs else "")


def _html(markdown: str) -> Markup:
    return Markup(mistune.create_markdown(escape=True)(markdown))
