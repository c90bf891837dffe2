"""The project's documents as data: Markdown files, and the Markdown cells of notebooks."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import mistune
import nbformat

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (".", "docs", "benchmarks", "notebooks", "tests")
_parse = mistune.create_markdown(renderer="ast", plugins=["table"])


@dataclass(frozen=True)
class Block:
    """A block of code: the language that its fence names ("" where none does), and what is in it."""

    language: str
    text: str


@dataclass(frozen=True)
class Document:
    """A text in Markdown, and the folder that its links start from."""

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> Document:
        """A Markdown file, or all Markdown cells of a notebook."""
        if path.suffix != ".ipynb":
            return cls(path, path.read_text(encoding="utf-8"))
        cells = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "markdown"]
        return cls(path, "\n\n".join(cells))

    @property
    def name(self) -> str:
        """Its path within the project."""
        return self.path.relative_to(ROOT).as_posix()

    @cached_property
    def tokens(self) -> list[dict[str, Any]]:
        return list(_walk(_parse(self.text)))

    def of_type(self, kind: str) -> list[dict[str, Any]]:
        return [token for token in self.tokens if token["type"] == kind]

    @cached_property
    def links(self) -> list[str]:
        """What links and images lead to, HTML's included."""
        found = [token["attrs"]["url"] for token in self.tokens if token["type"] in ("link", "image")]
        html = "".join(token["raw"] for token in self.tokens if token["type"] in ("block_html", "inline_html"))
        return found + re.findall(r"""(?:href|src)=["']([^"']*)""", html)

    @cached_property
    def anchors(self) -> set[str]:
        """The fragments that lead to its headings."""
        found: set[str] = set()
        seen: Counter[str] = Counter()
        for heading in self.of_type("heading"):
            slug = re.sub(r"[^\w\- ]", "", plain(heading).strip().lower()).replace(" ", "-")
            found.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
            seen[slug] += 1
        return found

    @cached_property
    def blocks(self) -> list[Block]:
        return [Block(token.get("attrs", {}).get("info", ""), token["raw"]) for token in self.of_type("block_code")]

    @cached_property
    def spans(self) -> list[str]:
        """Code within sentences."""
        return [token["raw"] for token in self.of_type("codespan")]

    @cached_property
    def tables(self) -> list[list[list[str]]]:
        """The text of each table's cells, row by row, the header first."""
        tables = []
        for table in self.of_type("table"):
            head, *body = table["children"]
            rows = [head["children"], *(row["children"] for part in body for row in part["children"])]
            tables.append([[plain(cell) for cell in row] for row in rows])
        return tables

    def table(self, *header: str) -> list[list[str]]:
        """The rows below the only header that begins so."""
        (found,) = [rows[1:] for rows in self.tables if rows[0][: len(header)] == list(header)]
        return found

    @cached_property
    def prose(self) -> str:
        """The text as one line."""
        return " ".join(self.text.split())


def plain(token: dict[str, Any]) -> str:
    """The text of a token without its markup."""
    if "children" not in token:
        return " " if token["type"] == "softbreak" else token.get("raw", "")
    return "".join(map(plain, token["children"]))


def _walk(tokens: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for token in tokens:
        yield token
        yield from _walk(token.get("children", []))


PACKAGE = ROOT / "viewnet"
PUBLIC = [path for path in sorted(PACKAGE.rglob("*.py")) if not path.name.startswith("_") or path.stem == "__init__"]
"""The files of the package's public modules."""


def dotted(path: Path) -> str:
    """The name under which a file of the package is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


PAGES = [Document.read(path) for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.md"))]
NOTEBOOKS = [Document.read(path) for path in sorted((ROOT / "notebooks").glob("*.ipynb"))]


def page(name: str) -> Document:
    """The Markdown file of a path within the project."""
    (found,) = [document for document in PAGES if document.name == name]
    return found


def script(name: str, folder: str = "docs") -> ModuleType:
    """A Python file of a folder that is no package, as a module."""
    spec = importlib.util.spec_from_file_location(f"{folder}_{name}", ROOT / folder / f"{name}.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
