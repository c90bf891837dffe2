"""Every link in the documents has a target."""

from __future__ import annotations

import re
from urllib.parse import unquote, urlsplit

import pytest
from helpers.documents import NOTEBOOKS, PAGES, ROOT, Document

EXTERNAL = {"http", "https", "ftp"}


def problem(link: str, source: Document) -> str | None:
    """The problem with a link, or None. External addresses are parsed, not requested."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        whole = parts.scheme in EXTERNAL and re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.hostname or "")
        return None if whole and not re.search(r"\s", link) else "not an address"
    target = (source.path.parent / unquote(parts.path)).resolve() if parts.path else source.path
    if target != source.path and not (target.is_relative_to(ROOT) and target.exists()):
        return "no such file"
    if not parts.fragment:
        return None
    if target.suffix not in (".md", ".ipynb"):
        return "a fragment of what has no headings"
    anchors = (source if target == source.path else Document.read(target)).anchors
    return None if unquote(parts.fragment) in anchors else f"no such heading, only {', '.join(sorted(anchors))}"


@pytest.mark.parametrize("document", [*PAGES, *NOTEBOOKS], ids=lambda document: document.name)
def test_links_lead_somewhere(document):
    assert {link: why for link in document.links if (why := problem(link, document))} == {}


def test_there_are_links_to_check():
    kinds = {bool(urlsplit(link).scheme) for document in PAGES for link in document.links}
    assert kinds == {True, False}
    assert any("#" in link for document in PAGES for link in document.links)


@pytest.mark.parametrize(
    ("link", "expected"),
    [
        ("README.md", None),
        ("docs/recipes.md#results-on-cad-models", None),
        ("#a-heading-with-code", None),
        ("#a-heading-with-code-1", None),
        ("https://example.org/a?b#c", None),
        ("docs", None),
        ("nothing.md", "no such file"),
        ("../outside.md", "no such file"),
        ("#a-heading-with-code-2", "no such heading, only a-heading-with-code, a-heading-with-code-1"),
        ("LICENSE#text", "a fragment of what has no headings"),
        ("https://", "not an address"),
        ("https://exam ple.org", "not an address"),
        ("htps://example.org", "not an address"),
        ("//example.org/a", "not an address"),
    ],
)
def test_what_leads_nowhere_is_found(link, expected):
    source = Document(ROOT / "made_up.md", "# A heading, with `code`\n\n## A heading with code")
    assert problem(link, source) == expected
