from __future__ import annotations

import pytest

from viewnet.runtime import provenance

SOURCE = '''"""Doc."""
import os

X = 1  # why


def f(a):
    """Doc.

    More.
    """
    return "# no comment"


@property
def g(a):
    return a + X
'''
REORDERED = """import sys


@property
def g(a):
    return a + X


# why
def f(a):
    # reason
    return "# no comment"

X = 1
"""


@pytest.fixture
def identity(tmp_path, monkeypatch):
    """The identity of modules with the given sources, by path."""
    monkeypatch.setattr(provenance, "PACKAGE", tmp_path)

    def of(**sources: str) -> str:
        provenance.code_identity.cache_clear()
        for name, source in sources.items():
            (tmp_path / f"{name}.py").write_text(source)
        return provenance.code_identity(tuple(f"{name}.py" for name in sources))

    yield of
    provenance.code_identity.cache_clear()


def test_comments_docstrings_imports_order_and_place_do_not_count(identity):
    one = identity(a=SOURCE)
    assert one == identity(a=REORDERED), "comments, docstrings, imports and order"
    assert one == identity(b=SOURCE), "the path"
    x, rest = "X = 1\n", SOURCE.replace("X = 1  # why\n", "")
    assert one == identity(b=rest, a=x), "a statement that moved to another module"


@pytest.mark.parametrize(
    ("old", "new"), [("X = 1", "X = 2"), ("# no", "# a"), ("a + X", "X + a"), ("@property\n", ""), ("f(a)", "f(b)")]
)
def test_an_edited_statement_counts(identity, old, new):
    assert old in SOURCE
    assert identity(a=SOURCE) != identity(a=SOURCE.replace(old, new))


def test_what_is_written_tells_versions_commit_and_machine():
    assert {"python", "torch", "numpy"} <= set(provenance.versions())
    assert set(provenance.versions(["no-such-library"])) == {"python"}
    assert set(provenance.commit()) == {"commit", "dirty"}
    assert provenance.hardware(threads=3)["threads"] == 3
