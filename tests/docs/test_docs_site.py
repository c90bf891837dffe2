"""The built documentation: complete, with links that have targets, and without network access."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from helpers.documents import NOTEBOOKS, PAGES, PUBLIC, ROOT, dotted, script


def builder():
    return script("build")


class Page(HTMLParser):
    """A page's links, the files it loads, and its anchors."""

    def __init__(self, text: str):
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.ids: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.ids |= {found[name] for name in ("id", "name") if found.get(name)}
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        elif tag in ("script", "img", "iframe", "link", "source"):
            self.loads += [found[name] for name in ("src", "href") if found.get(name)]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> dict[Path, Page]:
    folder = tmp_path_factory.mktemp("docs")
    builder().build(folder)
    paths = [path for path in folder.rglob("*.html") if "files" not in path.relative_to(folder).parts]
    return {path: Page(path.read_text(encoding="utf-8")) for path in paths}


def folder_of(site: dict[Path, Page]) -> Path:
    (index,) = [path for path in site if path.name == "index.html"]
    return index.parent


@pytest.mark.slow
@pytest.mark.filterwarnings("error::UserWarning")
def test_every_module_page_and_notebook_is_there(site):
    folder = folder_of(site)
    pages = {path.relative_to(folder).with_suffix("").as_posix().replace("/", ".") for path in site}
    assert {dotted(path) for path in PUBLIC} <= pages
    assert {Path(document.name).stem for document in NOTEBOOKS} <= pages
    assert {document.name for document in PAGES} == set(builder().PROSE)
    assert set(builder().PROSE.values()) <= pages


@pytest.mark.slow
def test_links_lead_somewhere_and_nothing_is_loaded_from_elsewhere(site):
    broken = []
    for path, page in site.items():
        for link in [*page.links, *page.loads]:
            parts = urlsplit(link)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                broken += [(path.name, link)] if link in page.loads else []
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            known = site.get(target)
            if not target.exists() or (parts.fragment and (known is None or unquote(parts.fragment) not in known.ids)):
                broken.append((path.name, link))
    assert broken == []


@pytest.mark.slow
def test_the_reference_links_names_shows_source_and_is_searched(site):
    folder = folder_of(site)
    viewpoints = (folder / "viewnet" / "estimator" / "viewpoints.html").read_text(encoding="utf-8")
    assert 'href="../geometry.html"' in viewpoints
    assert "View Source" in viewpoints
    (text,) = re.findall(r"docs = (.*?);?\n", (folder / "search.js").read_text(encoding="utf-8"))
    assert json.loads(text)
    assert "viewnet.evaluation.metrics.geodesic_error" in text
    assert "Neighbours of each head" in text


def test_aligned_lists_become_tables_and_nothing_else_does():
    tabled = builder().tabled
    listed = "What it is.\n\nids     a row an image: <id>\n        in their order\nups     (N, 3) or | none"
    assert tabled(listed).splitlines()[2:] == [
        "| name | meaning |",
        "|---|---|",
        "| `ids` | a row an image: &lt;id> in their order |",
        "| `ups` | (N, 3) or &#124; none |",
    ]
    for text in ("One line.", "Two lines\nof text.", "    code  is\n    left  <alone>", "`<root>/data`, as it is", ""):
        assert tabled(text) == text


def test_links_go_to_pages_and_to_copies_of_other_files(tmp_path):
    text = "[a](../README.md#x) [b](recipes.md) [c](../LICENSE) [d](https://e.org/f) [e](#g) ![f](../CITATION.cff)"
    build = builder()
    found = build.linked(text, "docs/speed.md", build.PROSE, tmp_path)
    assert re.findall(r"\]\(([^)]*)\)", found) == [
        "overview.html#x",
        "recipes.html",
        "files/LICENSE",
        "https://e.org/f",
        "#g",
        "files/CITATION.cff",
    ]
    assert (tmp_path / "files" / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_a_folder_of_something_else_is_not_emptied(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    for place in (tmp_path, tmp_path / "mine.txt"):
        with pytest.raises(SystemExit):
            builder().main([str(place)])
        assert "holds something else than this documentation" in capsys.readouterr().err
    assert (tmp_path / "mine.txt").read_text() == "mine"
