"""The overview page of all tables and figures, `paper_tables/index.html`: a single file without scripts.

It holds only the content of the folder's files, of the notebooks' first cells and of the paper: the same files always
give the same page.
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
"""Bytes; the figures of a larger page are shrunk."""
WIDTHS = (1700, 1000, 500)
"""Maximal pixels across a figure, tried in turn until the page is within the limit."""
IGNORED = ("published/*", NAME, ".*")


@dataclass(frozen=True)
class Kind:
    """The rule for the files of a section.

    name      of its notebook, or of the program that writes the files
    chapter   the chapter it belongs to
    patterns  patterns of the files' names
    folder    the folder of `paper_tables` with the files; a folder inside it holds another setting, named like it
    title, lead, command   of a section without a notebook: heading, introduction, and the command that writes its files
    """

    name: str
    chapter: str
    patterns: tuple[str, ...]
    folder: str = ""
    title: str = ""
    lead: str = ""
    command: str = ""


TABLES = ("table1_shapenet", "table2_ablation", "table3_pascal3d", "table4_freiburg", "table5_dva", "objectron")
KINDS = (
    *(Kind(name, "Tables", (f"{name}.*",)) for name in TABLES),
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
        "predicting", "Software", ("predicting.*",), "benchmarks", "Time to predict",
        "Seconds for the viewpoint of one image in a fresh interpreter, and images per second of the estimator beside "
        "the bare network.",
        "python benchmarks/predicting.py",
    ),
    Kind(
        "bench", "Software", ("*",), "benchmarks", "Speed",
        "Time and memory of the volume renderer and of the training step, beside a plain textbook version of the same "
        "work, measured in turn on the same machine.",
        "viewnet bench",
    ),
    Kind(
        "fuzz", "Software", ("fuzz.*",), "trust", "Damaged files",
        "Every reader of files is given damaged ones. Each case must end in a result, or in one error that names the "
        "file.",
        "python benchmarks/fuzz.py --cases 300",
    ),
    Kind(
        "crashes", "Software", ("crashes.*", "pairs.*"), "trust", "Killed processes",
        "View stores, runs and tables, killed at any moment or requested by two processes at once: the number of "
        "damaged files, and whether the result is that of undisturbed work.",
        "python benchmarks/crashes.py --kills 50 --pairs 20",
    ),
    Kind(
        "faults", "Software", ("faults.*",), "trust", "Faults of the machine",
        "A full disk, a closed folder, a broken download, wrong clocks, a loss that is not finite: the errors raised, "
        "those that name the place, the damage, and the result of the same command afterwards.",
        "python benchmarks/faults.py",
    ),
    Kind("your_method", "Other methods", ("*",), "your_method"),
    Kind("other", "Other files", ("*",), title="Other files", lead="Files that no notebook of this version writes."),
)  # fmt: skip
"""In the order of the page. A file belongs to the first kind that fits, those with a folder before the others."""


@dataclass(frozen=True)
class Setting:
    """A section's content at one setting: one profile, data set or machine."""

    name: str  # of its folder, "" for the default
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


def render(content: list[Section]) -> str:
    """The page as HTML."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("viewnet.experiments.page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    chapters: dict[str, list[Section]] = {}
    for section in content:
        chapters.setdefault(section.chapter, []).append(section)
    names = {section.name for section in content}
    missing = {k.name: heading(k)[0] for k in KINDS if k.name in DESIGNS and k.name not in names}
    origins = {o["key"]: o for section in content for setting in section.settings for o in setting.origins}
    return environment.get_template("overview.html").render(
        chapters=chapters, missing=missing, summary=_summary(origins.values()), runs=len(origins)
    )


def sections(folder: Path, widest: int = WIDTHS[0]) -> list[Section]:
    """The sections of a folder of tables and figures, in the order of KINDS. ViewnetError for an empty folder."""
    files: dict[str, dict[str, list[Path]]] = {}
    for path in sorted(folder.rglob("*")):
        place = path.relative_to(folder)
        if path.is_file() and not any(fnmatch(str(place), pattern) for pattern in IGNORED):
            name, setting = _place(place)
            files.setdefault(name, {}).setdefault(setting, []).append(path)
    if not files:
        raise ViewnetError(f"{folder}: no tables and no figures: make some first (viewnet tables)")
    origins = _origins(path for settings in files.values() for paths in settings.values() for path in paths)
    kinds = {kind.name: kind for kind in reversed(KINDS)}
    result = []
    with bar(True, total=sum(map(len, files.values())), desc=NAME, unit="part", leave=False) as progress:
        for name in dict.fromkeys(kind.name for kind in KINDS if kind.name in files):
            settings = []
            for setting, paths in sorted(files[name].items()):
                settings.append(_setting(name, setting, paths, folder, origins, widest))
                progress.update()
            result.append(Section(name, kinds[name].chapter, *heading(kinds[name]), tuple(settings)))
    return result


def _place(path: Path) -> tuple[str, str]:
    """The section and the setting of a file, by its path below the folder of tables."""
    folders = path.parts[:-1]
    for kind in sorted(KINDS, key=lambda kind: not kind.folder):
        inside = folders[1:] if kind.folder else folders
        if kind.folder and folders[:1] != (kind.folder,):
            continue
        if any(fnmatch(path.name, pattern) for pattern in kind.patterns):
            if "meshes" in inside:  # a folder for each category, not a setting
                inside = inside[: inside.index("meshes")]
            return kind.name, "/".join(inside)
    raise AssertionError("the last kind fits every file")


def _setting(
    name: str, setting: str, paths: list[Path], folder: Path, known: Mapping[str, dict[str, Any]], widest: int
) -> Setting:
    content = _content(name, {path.name: path for path in paths})
    by_key = {key.partition("/")[0]: origin for key, origin in (content.origins or {}).items()}
    origins = tuple({"key": key, **_origin(known.get(key, origin))} for key, origin in sorted(by_key.items()))
    images = [path for path in paths if path.suffix in SUFFIXES]
    shown: set[Path] = set()
    figures = []
    for image in images:
        same = [path for path in paths if path.stem == image.stem and path.suffix in (".pdf", image.suffix)]
        shown.update(same)
        figures.append(embedded(image, widest, [path.relative_to(folder) for path in same]))
    files = tuple(path.relative_to(folder).as_posix() for path in paths if path not in shown)
    return Setting(setting, content.blocks, content.notes, origins, _summary(origins), tuple(figures), files)


def _content(name: str, files: Mapping[str, Path]) -> Content:
    """The content of a section's files. ViewnetError for files that this version does not write."""
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
    """Key -> origin of every run in a table's JSON."""
    origins: dict[str, dict[str, Any]] = {}
    for path in paths:
        if path.suffix == ".json" and isinstance(table := read_json(path), dict):
            runs = table.get("runs")
            origins |= runs if isinstance(runs, dict) else {}
    return origins


def _origin(origin: Mapping[str, Any]) -> dict[str, str]:
    """A run's origin as the page shows it; "" for unknown values."""
    training = origin.get("training") or {}
    git, hardware = training.get("git") or origin.get("git") or {}, training.get("hardware") or {}
    return {
        "what": " ".join(str(origin[name]) for name in ("variant", "category") if name in origin),
        **{name: str(origin.get(name, "")) for name in ("seed", "profile", "recipe")},
        "commit": (git.get("commit") or "")[:7] + (" (changed)" if git.get("dirty") else ""),
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
        values = sorted({origin[name] for origin in listed if origin[name]})
        if values and name == "date":
            parts.append("trained " + " to ".join(dict.fromkeys((values[0], values[-1]))))
        elif values:
            parts.append(f"{name}{'s' * (len(values) > 1)} {', '.join(values)}")
    return " · ".join(parts)


def heading(kind: Kind) -> tuple[str, Markup, str]:
    """A section's title, introduction and command: its own, or those of its notebook."""
    if kind.title:
        return kind.title, _html(kind.lead), kind.command
    return *_first_cell(notebooks.find(kind.name)), f"viewnet notebook {kind.name}"


@functools.cache
def _first_cell(path: Path) -> tuple[str, Markup]:
    """The title and the first paragraph of a notebook."""
    try:
        source = str(nbformat.read(path, as_version=4).cells[0].source)
    except Exception as error:  # nbformat lets any error of a damaged file through
        raise ViewnetError(f"{path}: not a notebook that can be read ({type(error).__name__})") from None
    title, *paragraphs = re.split(r"\n\s*\n", source.strip())
    return title.lstrip("# ").strip(), _html(paragraphs[0] if paragraphs else "")


def _html(markdown: str) -> Markup:
    return Markup(mistune.create_markdown(escape=True)(markdown))
