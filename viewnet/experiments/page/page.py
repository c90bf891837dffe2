"""The overview page of all tables and figures, `paper_tables/index.html`: a single file without scripts.

It holds only the content of the folder's files, of the notebooks' first cells and of the paper: the same files always
give the same page.
"""

import functools
import itertools
import logging
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import jinja2
import mistune
from markupsafe import Markup

from viewnet.errors import ViewnetError
from viewnet.experiments import notebooks
from viewnet.experiments.page import blocks
from viewnet.experiments.page.images import SUFFIXES, TEMPLATES, EmbeddedImage, embedded
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
_OPTIONS: Any = {"autoescape": True, "undefined": jinja2.StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
ENVIRONMENT = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATES), **_OPTIONS)


@dataclass(frozen=True)
class Setting:
    """A section's content at one setting: one profile, data set or machine."""

    name: str  # of its folder, "" for the default
    content: blocks.Content
    origins: tuple[dict[str, str], ...]
    summary: str
    images: tuple[EmbeddedImage, ...]
    files: tuple[str, ...]  # relative to the page


@dataclass(frozen=True)
class Section:
    """A section of the page, with the rule for its files as in templates/sections.toml."""

    name: str
    chapter: str
    patterns: list[str]
    folder: str = ""
    title: str = ""
    lead: str = ""
    command: str = ""
    settings: tuple[Setting, ...] = ()


KINDS = [Section(**rule) for rule in tomllib.loads((TEMPLATES / "sections.toml").read_text("utf-8"))["section"]]


def write(folder: Path) -> Path:
    """Write the page of a folder; returns its path. ViewnetError for an empty folder and for an unreadable file."""
    for widest in WIDTHS:
        page = render(sections(folder, widest))
        if len(page.encode()) <= LIMIT:
            break
        log.warning("the page has %.1f MB with figures of %d pixels", len(page.encode()) / 1e6, widest)
    write_text(folder / NAME, page)
    return folder / NAME


def render(content: list[Section]) -> str:
    """The page as HTML."""
    chapters = {name: list(group) for name, group in itertools.groupby(content, lambda section: section.chapter)}
    names = {section.name for section in content}
    missing = {k.name: headed(k).title for k in KINDS if k.name in DESIGNS and k.name not in names}
    origins = {o["key"]: o for section in content for setting in section.settings for o in setting.origins}
    return ENVIRONMENT.get_template("overview.html").render(
        chapters=chapters, missing=missing, summary=summary(origins.values()), runs=len(origins)
    )


def sections(folder: Path, widest: int = WIDTHS[0]) -> list[Section]:
    """The sections of a folder of tables and figures, in the order of KINDS. ViewnetError for an empty folder."""
    files = found(folder)
    if not files:
        raise ViewnetError(f"{folder}: no tables and no figures: make some first (viewnet tables)")
    origins = _origins(itertools.chain.from_iterable(p for settings in files.values() for p in settings.values()))
    kinds = {kind.name: kind for kind in reversed(KINDS)}  # of several of one name the first has its title
    result = []
    with bar(True, total=sum(map(len, files.values())), desc=NAME, unit="part", leave=False) as progress:
        for name in dict.fromkeys(kind.name for kind in KINDS if kind.name in files):
            settings = []
            for setting, paths in sorted(files[name].items()):  # the default, "", comes first
                settings.append(_setting(name, setting, paths, folder, origins, widest))
                progress.update()
            result.append(replace(headed(kinds[name]), settings=tuple(settings)))
    return result


def found(folder: Path) -> dict[str, dict[str, list[Path]]]:
    """The files of a folder of tables and figures: section -> setting -> paths."""
    files: dict[str, dict[str, list[Path]]] = {}
    for path in sorted(folder.rglob("*")):
        place = path.relative_to(folder)
        if path.is_file() and not any(fnmatch(str(place), pattern) for pattern in IGNORED):
            name, setting = _place(place)
            files.setdefault(name, {}).setdefault(setting, []).append(path)
    return files


def _place(path: Path) -> tuple[str, str]:
    """The section and the setting of a file, by its path below the folder of tables."""
    folders = path.parts[:-1]
    for kind in sorted(KINDS, key=lambda kind: not kind.folder):  # rules with a folder are the more special ones
        here = not kind.folder or folders[:1] == (kind.folder,)
        if here and any(fnmatch(path.name, pattern) for pattern in kind.patterns):
            inside = folders[1:] if kind.folder else folders
            # In `meshes` there is a folder for each category, not for each setting.
            return kind.name, "/".join(itertools.takewhile(lambda name: name != "meshes", inside))
    raise AssertionError("the last kind fits every file")


def _setting(
    name: str, setting: str, paths: list[Path], folder: Path, known: Mapping[str, dict[str, Any]], widest: int
) -> Setting:
    content, origins = read(name, paths, known)
    figures = []
    for image in [path for path in paths if path.suffix in SUFFIXES]:
        same = [path for path in paths if path.stem == image.stem and path.suffix in (".pdf", image.suffix)]
        figures.append(embedded(image, widest, [path.relative_to(folder) for path in same]))
    shown = {file for figure in figures for file in figure.files}  # linked below their figure
    files = tuple(p.as_posix() for p in (path.relative_to(folder) for path in paths) if p not in shown)
    return Setting(setting, content, origins, summary(origins), tuple(figures), files)


def read(
    name: str, paths: Iterable[Path], known: Mapping[str, dict[str, Any]] | None = None
) -> tuple[blocks.Content, tuple[dict[str, str], ...]]:
    """The content of a section's files and its runs, whose origins may be `known` elsewhere.

    ViewnetError for files that this version does not write.
    """
    files = {path.name: path for path in paths}
    try:
        content = blocks.READERS.get(name, blocks.tables)(files)
        by_key = {key.partition("/")[0]: origin for key, origin in (content.origins or {}).items()}
        origins = sorted(by_key.items())
        return content, tuple({"key": key, **_origin((known or {}).get(key, origin))} for key, origin in origins)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, ViewnetError):  # which names its file already
            raise
        names = ", ".join(str(path) for path in files.values() if path.suffix in (".json", ".csv"))
        reason = f"not as this version writes it ({type(error).__name__}: {error})"
        raise ViewnetError(f"{names}: {reason}: make it again") from error


def _origins(paths: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """Key -> origin of every run in a table's JSON."""
    origins: dict[str, dict[str, Any]] = {}
    for path in paths:
        table = read_json(path) if path.suffix == ".json" else None
        if isinstance(table, dict) and isinstance(runs := table.get("runs"), dict):
            origins |= runs
    return origins


def _origin(origin: Mapping[str, Any]) -> dict[str, str]:
    """A run's origin as the page shows it; "" for unknown values."""
    training = origin.get("training") or {}
    git, hardware = training.get("git") or origin.get("git") or {}, training.get("hardware") or {}
    return {
        "what": " ".join(str(origin[name]) for name in ("variant", "category") if name in origin),
        **{name: str(origin.get(name, "")) for name in ("seed", "profile", "recipe")},
        "commit": (git.get("commit") or "")[:7] + (" (changed)" if git.get("dirty") else ""),
        "date": (training.get("finished") or "")[:10],  # the day, of an ISO time
        "minutes": f"{training['seconds'] / 60:.1f}" if "seconds" in training else "",
        "machine": hardware.get("gpu") or hardware.get("processor") or "",
        "threads": str(hardware.get("threads", "")),
    }


def summary(origins: Iterable[Mapping[str, str]]) -> str:
    """Profiles, recipes, dates, machines and commits of runs, in a line."""
    origins, parts = list(origins), []
    for name in ("profile", "recipe", "date", "machine", "commit"):
        values = sorted({origin[name] for origin in origins if origin[name]})
        if values and name == "date":
            parts.append("trained " + " to ".join(dict.fromkeys((values[0], values[-1]))))  # ISO dates sort by time
        elif values:
            parts.append(f"{name}{'s' * (len(values) > 1)} {', '.join(values)}")
    return " · ".join(parts)


def headed(kind: Section) -> Section:
    """A section with its introduction as HTML; without a title, with title, lead and command of its notebook."""
    if kind.title:
        return replace(kind, lead=_html(kind.lead))
    title, lead = _first_cell(notebooks.find(kind.name))
    return replace(kind, title=title, lead=lead, command=f"viewnet notebook {kind.name}")


@functools.cache
def _first_cell(path: Path) -> tuple[str, Markup]:
    """The title and the first paragraph of a notebook."""
    source = str(notebooks.read(path).cells[0].source)
    title, *paragraphs = re.split(r"\n\s*\n", source.strip())
    return title.lstrip("# ").strip(), _html(paragraphs[0] if paragraphs else "")


def _html(markdown: str) -> Markup:
    return Markup(mistune.create_markdown(escape=True)(markdown))  # HTML in a notebook stays text
