"""The documentation as HTML: the reference from the docstrings, and the Markdown pages and notebooks beside it.

    python docs/build.py [FOLDER]        (default: build/docs)

pdoc makes the pages, their search and the links between them. It documents modules, so a Markdown page is given to it
as the docstring of a module of that name. The result needs no network.
"""

from __future__ import annotations

import argparse
import dataclasses
import posixpath
import re
import shutil
import typing
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from urllib.parse import urlsplit

import jinja2
import nbconvert
import pdoc
import pdoc.doc
import pdoc.extract
import pdoc.render
from pdoc.render_helpers import to_markdown_with_context

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "viewnet"
PROSE = {
    "README.md": "overview",
    "docs/README.md": "documents",
    "docs/results.md": "results",
    "docs/claims.md": "claims",
    "docs/running.md": "running",
    "docs/estimator.md": "estimator",
    "docs/models.md": "models",
    "docs/own_category.md": "own_category",
    "docs/photographs.md": "photographs",
    "docs/real_data.md": "real_data",
    "docs/your_method.md": "your_method_guide",
    "docs/architecture.md": "architecture_guide",
    "docs/recipes.md": "recipes",
    "docs/trials.md": "trials",
    "docs/peers.md": "peers",
    "docs/compute.md": "compute",
    "docs/decisions.md": "decisions",
    "docs/scaling.md": "scaling",
    "docs/speed.md": "speed",
    "docs/trust.md": "trust",
    "docs/checklists.md": "checklists",
    "benchmarks/README.md": "benchmarks",
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changelog",
}
"""A page's path in the project -> its name in the documentation."""
INDEX = "search.js"
"""The search index. A folder that holds it was built before and may be emptied."""
FILES = "files"
"""The folder of files that pages link to and that are no pages themselves."""


def build(folder: Path) -> None:
    """Write the documentation to a folder, which is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    notebooks = {path.relative_to(ROOT).as_posix(): path.stem for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
    pages = PROSE | notebooks
    texts = {path: (ROOT / path).read_text(encoding="utf-8") for path in PROSE}
    texts |= {path: _notebook(path, folder) for path in notebooks}
    modules = {name: pdoc.doc.Module.from_name(name) for name in pdoc.extract.walk_specs([PACKAGE, rf"!{PACKAGE}\._"])}
    _resolve_inherited(modules.values())
    modules |= {pages[path]: _page(pages[path], linked(text, path, pages, folder)) for path, text in texts.items()}

    pdoc.render.configure(docformat="markdown", template_directory=ROOT / "docs" / "templates")
    pdoc.render.env.filters["to_markdown"] = _to_markdown
    pdoc.render.env.globals |= {
        "prose": list(PROSE.values()),
        "notebooks": list(notebooks.values()),
        "package": PACKAGE,
    }
    for name, module in modules.items():
        path = folder / f"{name.replace('.', '/')}.html"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(pdoc.render.html_module(module, modules), encoding="utf-8")
    (folder / "index.html").write_text(pdoc.render.html_index(modules), encoding="utf-8")
    (folder / INDEX).write_text(pdoc.render.search_index(modules), encoding="utf-8")


def _resolve_inherited(modules: Iterable[pdoc.doc.Module]) -> None:
    """Give constructors of dataclasses the types of fields inherited from another module, whose names theirs lacks."""
    for module in modules:
        for cls in module.classes:
            if dataclasses.is_dataclass(cls.obj) and any(map(dataclasses.is_dataclass, cls.obj.__bases__)):
                hints = typing.get_type_hints(cls.obj)
                annotations = cls.obj.__init__.__annotations__
                annotations |= {name: hint for name, hint in hints.items() if name in annotations}


def _page(name: str, text: str) -> pdoc.doc.Module:
    return pdoc.doc.Module(ModuleType(name, text))


def _notebook(path: str, folder: Path) -> str:
    """A notebook as Markdown, its images put where its page finds them."""
    text, resources = nbconvert.MarkdownExporter().from_filename(str(ROOT / path))
    for name, content in resources["outputs"].items():
        place = Path(FILES, path).with_suffix("") / name
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_bytes(content)
        text = text.replace(f"({name})", f"({place.as_posix()})")
    return text


def linked(text: str, source: str, pages: dict[str, str], folder: Path) -> str:
    """Markdown with links to built pages instead of Markdown files; other files that it links to are copied."""

    def to(match: re.Match[str]) -> str:
        parts = urlsplit(match[1])
        if parts.scheme or not parts.path or parts.path.startswith(f"{FILES}/"):
            return match[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), parts.path))
        fragment = f"#{parts.fragment}" if parts.fragment else ""
        if target in pages:
            return f"]({pages[target]}.html{fragment})"
        place = folder / FILES / target
        place.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / target).is_dir():
            shutil.copytree(ROOT / target, place, dirs_exist_ok=True)
        else:
            shutil.copy(ROOT / target, place)
        return f"]({FILES}/{target}{fragment})"

    return re.sub(r"\]\(([^()\s]+)\)", to, text)


@jinja2.pass_context
def _to_markdown(context: jinja2.runtime.Context, text: str) -> str:
    if context["module"].modulename.partition(".")[0] == PACKAGE:
        text = tabled(text)
    return to_markdown_with_context(context, text)


def tabled(docstring: str) -> str:
    """A docstring with Markdown tables for its aligned lists, and with `<` escaped where it could begin a tag."""
    lines = [
        line if line.startswith("    ") else re.sub(r"(`[^`]*`)|<(?=\w)", lambda m: m[1] or "&lt;", line)
        for line in docstring.splitlines()
    ]
    return "\n\n".join(_list("\n".join(lines).split("\n\n")))


def _list(paragraphs: list[str]) -> list[str]:
    """Replace paragraphs of aligned names and meanings by Markdown tables."""
    result = []
    for paragraph in paragraphs:
        first, *rest = paragraph.splitlines() or [""]
        start = re.match(r"\S+(?: \S+)*  +(?=\S)", first)
        column = start.end() if start else 0
        name = re.compile(rf"(?=\S)(.{{{column - 2}}}) [ ](?=\S)" if start else "$^")
        if not start or not all(name.match(line) or line.startswith(" " * column) for line in rest):
            result.append(paragraph)
            continue
        rows: list[list[str]] = []
        for line in (first, *rest):
            if line[:column].strip():
                rows.append([line[:column].strip(), line[column:]])
            else:
                rows[-1][1] += f" {line.strip()}"
        body = [f"| `{term}` | {meaning.replace('|', '&#124;')} |" for term, meaning in rows]
        result.append("\n".join(["| name | meaning |", "|---|---|", *body]))
    return result


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "docs", metavar="FOLDER",
                        help="emptied first (default: build/docs)")  # fmt: skip
    folder = parser.parse_args(arguments).folder
    if folder.exists() and not (folder / INDEX).is_file() and (not folder.is_dir() or any(folder.iterdir())):
        parser.error(
            f"{folder}: holds something else than this documentation, and would be emptied: name another folder"
        )
    build(folder)


if __name__ == "__main__":
    main()
