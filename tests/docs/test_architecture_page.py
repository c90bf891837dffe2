"""docs/architecture.md shows the rooms as they are, and the files that it names for changes exist."""

from __future__ import annotations

import functools
import re

import grimp
from helpers.documents import PACKAGE, ROOT, page

CHANGES = (
    *("renderer", "row of a table", "reader", "recipe", "look of a table", "command", "metric"),
    *("loss", "backbone", "output of viewnet predict", "figure", "peer"),
)


def room(module: str) -> str:
    """A module's folder, "cli" for the entry of the command line, "reference", "root" for the other files."""
    _, name, *_ = f"{module}.".split(".")
    return (
        name if name in ("cli", "reference", "") or (PACKAGE / name).is_dir() else {"__main__": "cli"}.get(name, "root")
    )


@functools.cache
def arrows() -> dict[str, set[str]]:
    """Room -> the rooms directly below it in the diagram."""
    (diagram,) = [block.text for block in page("docs/architecture.md").blocks if block.language == "mermaid"]
    below: dict[str, set[str]] = {}
    for line in diagram.splitlines()[1:]:
        upper, lower = (re.findall(r"\w+", re.sub(r"\[.*\]", "", side)) for side in line.split("-->"))
        for name in upper:
            below.setdefault(name, set()).update(lower)
    return below


def reachable(name: str) -> set[str]:
    return arrows().get(name, set()).union(*(reachable(lower) for lower in arrows().get(name, ())))


def test_the_diagram_has_every_room():
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")} | {"cli", "reference", "root"}
    assert set(arrows()).union(*arrows().values()) == rooms
    (table,) = [rows[1:] for rows in page("docs/architecture.md").tables if rows[0][0] == "room"]
    named = {row[0].rstrip("/").removesuffix(".py") for row in table}
    assert named == (rooms - {"cli", "root"}) | {"files at the root"}


def test_every_import_follows_the_diagram():
    graph = grimp.build_graph("viewnet", cache_dir=None)
    imported = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    pairs = {(room(module), room(name)) for module, names in imported.items() for name in names}
    assert {(upper, lower) for upper, lower in pairs if upper != lower and lower not in reachable(upper)} == set()


def test_three_files_at_most_for_each_change():
    rows = page("docs/architecture.md").table("to change or add", "open", "and")
    assert len(rows) == len(CHANGES)
    for word, (change, files, how) in zip(CHANGES, rows, strict=True):
        assert word in change
        names = files.split(", ")
        assert len(names) <= 3
        assert [name for name in names if not (ROOT / name).exists()] == []
        assert how


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 1000
