"""The overview page of all tables and figures, `paper_tables/index.html`: a single file without scripts.

It holds only the content of the folder's files, of the notebooks' first cells and of the paper: the same files always
give the same page.
"""

import functools
import itertools
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
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
from viewnet.runtime.files import write_text
from viewnet.runtime.progress import bar
from viewnet.tables import claims

NAME = "index.html"
IGNORED = ("published/*", NAME, claims.NAME, ".*", "*_logs.csv")
_OPTIONS: Any = {"autoescape": True, "undefined": jinja2.StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
ENVIRONMENT = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATES), **_OPTIONS)


@dataclass(frozen=True)
class Setting:
    """A section's content at one setting: one profile, data set or machine."""

    name: str  # of its folder, "" for the default: part of its id
    title: str
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


RULES = tomllib.loads((TEMPLATES / "sections.toml").read_text("utf-8"))
KINDS = [Section(**rule) for rule in RULES["section"]]


def write(folder: Path) -> Path:
    """Write the page of a folder; returns its path. ViewnetError for an empty folder and for an unreadable file."""
    write_text(folder / NAME, render(sections(folder), claims.judge(folder)))
    return folder / NAME


def render(content: list[Section], judged: Sequence[claims.Judged] = ()) -> str:
    """The page as HTML, first the claims with their verdicts."""
    chapters = {name: list(group) for name, group in itertools.groupby(content, lambda section: section.chapter)}
    names = {section.name for section in content}
    missing = {k.name: headed(k).title for k in KINDS if k.name in DESIGNS and k.name not in names}
    origins = {o["key"]: o for section in content for setting in section.settings for o in setting.origins}
    return ENVIRONMENT.get_template("overview.html").render(
        chapters=chapters,
        missing=missing,
        summary=summary(origins.values()),
        runs=len(origins),
        claims=[(each, _places(each, content)) for each in judged],
        counts=claims.counts(judged),
    )


def _places(judged: claims.Judged, content: Iterable[Section]) -> dict[str, str]:
    """Where the page shows what a claim's rules read: the id of a section, or of one of its settings -> title."""
    titles = {section.name: section.title for section in content}
    places = dict.fromkeys(_place(Path(rule.file)) for rule in judged.claim.rules)
    return {
        "-".join(filter(None, (name, setting.replace("/", "-")))): ": ".join(
            filter(None, (titles[name], titled(setting)))
        )
        for name, setting in places
    }


def sections(folder: Path) -> list[Section]:
    """The sections of a folder of tables and figures, in the order of KINDS. ViewnetError for an empty folder."""
    files = found(folder)
    if not files:
        raise ViewnetError(f"{folder}: no tables and no figures: make some first (viewnet tables)")
    contents = {(name, setting): read(name, paths) for name, parts in files.items() for setting, paths in parts.items()}
    # A run may be told of elsewhere, and more fully.
    known = {key: run for content in contents.values() for key, run in content.runs.items() if run}
    kinds = {kind.name: kind for kind in reversed(KINDS)}  # of several of one name the first has its title
    result = []
    with bar(True, total=len(contents), desc=NAME, unit="part", leave=False) as progress:
        for name in dict.fromkeys(kind.name for kind in KINDS if kind.name in files):
            settings = []
            for setting, paths in sorted(files[name].items()):  # the default, "", comes first
                content = contents[name, setting]
                runs = {key: known.get(key) or blocks.origin({}) for key in sorted(content.runs)}
                settings.append(_setting(setting, content, runs, paths, folder))
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


def _setting(name: str, content: blocks.Content, runs: blocks.Runs, paths: list[Path], folder: Path) -> Setting:
    figures = []
    for image in [path for path in paths if path.suffix in SUFFIXES]:
        same = [path for path in paths if path.stem == image.stem and path.suffix in (".pdf", image.suffix)]
        figures.append(embedded(image, [path.relative_to(folder) for path in same]))
    shown = {file for figure in figures for file in figure.files}  # linked below their figure
    files = tuple(p.as_posix() for p in (path.relative_to(folder) for path in paths) if p not in shown)
    origins = tuple({"key": key, **run} for key, run in runs.items())
    return Setting(name, titled(name), content, origins, summary(origins), tuple(figures), files)


def titled(setting: str) -> str:
    """The title of a setting; of one whose folder has none in sections.toml, the words of the folder's name."""
    return str(RULES["titles"].get(setting) or re.sub(r"[-_/]+", " ", setting).strip())


def read(name: str, paths: Iterable[Path]) -> blocks.Content:
    """The content of a section's files. ViewnetError for files that this version does not write."""
    files = {path.name: path for path in paths}
    try:
        return blocks.READERS.get(name, blocks.tables)(files)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, ViewnetError):  # which names its file already
            raise
        names = ", ".join(str(path) for path in files.values() if path.suffix in (".json", ".csv"))
        reason = f"not as this version writes it ({type(error).__name__}: {error})"
        raise ViewnetError(f"{names}: {reason}: make it again") from error


def summary(origins: Iterable[Mapping[str, str]]) -> str:
    """Profiles, recipes, dates, machines and commits of runs, in a line."""
    origins, parts = list(origins), []
    for name in ("profile", "recipe", "date", "machine", "commit"):
        values = sorted({origin[name] for origin in origins if origin.get(name)})
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
