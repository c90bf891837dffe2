from __future__ import annotations

import logging
import os
import shutil
import subprocess
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

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
    assert set(provenance.commit()) >= {"commit", "dirty"}
    assert provenance.hardware(threads=3)["threads"] == 3


# Where the commit cannot be told


@pytest.fixture
def checkout(tmp_path, monkeypatch) -> Path:
    """A checkout of a package with one commit, and a home without settings of git's."""
    (tmp_path / "home").mkdir()
    for name, value in {"HOME": str(tmp_path / "home"), "GIT_CONFIG_NOSYSTEM": "1"}.items():
        monkeypatch.setenv(name, value)
    root = tmp_path / "checkout"
    (root / "package").mkdir(parents=True)
    (root / "package" / "errors.py").touch()
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for command in (["init", "-q"], ["add", "."], [*who, "commit", "-qm", "one"]):
        subprocess.run(["git", "-C", str(root), *command], check=True)
    monkeypatch.setattr(provenance, "PACKAGE", root / "package")
    provenance.warn_once.cache_clear()
    return root


def of_another_owner(root, monkeypatch):
    if os.geteuid():
        monkeypatch.setenv("GIT_TEST_ASSUME_DIFFERENT_OWNER", "1")
        return
    for path in (root, *root.rglob("*")):
        os.chown(path, 12345, 12345)


def without_git(root, monkeypatch):
    monkeypatch.setenv("PATH", str(root))


def installed(root, monkeypatch):
    shutil.rmtree(root / ".git")


def installed_within_another_checkout(root, monkeypatch):
    monkeypatch.setattr(provenance, "PACKAGE", root / "venv" / "package")
    shutil.copytree(root / "package", root / "venv" / "package")


def damaged(root, monkeypatch):
    (root / ".git" / "HEAD").write_text("none")


@pytest.mark.parametrize(
    ("change", "reason", "remedy"),
    [
        (of_another_owner, "another owner", "git config --global --add safe.directory {root}"),
        (without_git, "git is not installed", "git status"),
        (installed, "without a checkout", "pip install -e"),
        (installed_within_another_checkout, "without a checkout", "pip install -e"),
        (damaged, "not a git repository", "git status"),
    ],
)
def test_an_unknown_commit_is_told_once_with_what_to_do(checkout, monkeypatch, caplog, change, reason, remedy):
    assert provenance.commit()["dirty"] is False and not caplog.records
    change(checkout, monkeypatch)
    first, second = provenance.commit(), provenance.commit()
    assert first == second == {"commit": None, "dirty": None, "unknown": first["unknown"]}
    assert reason in first["unknown"] and str(checkout) not in first["unknown"]
    (record,) = caplog.records
    line = record.getMessage()
    assert record.levelno == logging.WARNING
    assert first["unknown"] in line and remedy.format(root=checkout) in line and "\n" not in line


def test_the_exception_that_is_named_makes_the_commit_known(checkout, monkeypatch, caplog):
    of_another_owner(checkout, monkeypatch)
    assert provenance.commit()["commit"] is None
    monkeypatch.delenv("GIT_TEST_ASSUME_DIFFERENT_OWNER", raising=False)
    command = caplog.records[0].getMessage().rpartition(": ")[2]
    subprocess.run(command.split(), check=True)
    assert len(provenance.commit()["commit"]) == 40


def test_changes_that_cannot_be_told_are_not_taken_for_none(checkout, monkeypatch):
    (checkout / ".git" / "index").write_bytes(b"damaged")
    known = provenance.commit()
    assert known["dirty"] is None and known["unknown"]


def test_processes_that_another_one_started_leave_it_to_that_one(checkout, monkeypatch, capfd):
    without_git(checkout, monkeypatch)
    with ProcessPoolExecutor(1, get_context("fork")) as pool:
        assert pool.submit(provenance.commit).result()["unknown"]
    assert capfd.readouterr().err == ""


def test_tables_that_are_written_are_no_change_of_the_code(checkout):
    for name in ("paper_tables/table.csv", "settings.toml"):
        (checkout / name).parent.mkdir(exist_ok=True)
        (checkout / name).write_text("before")
    subprocess.run(["git", "-C", str(checkout), "add", "-A"], check=True)
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run(["git", "-C", str(checkout), *who, "commit", "-qm", "more"], check=True)
    (checkout / "paper_tables/table.csv").write_text("after")
    assert provenance.commit()["dirty"] is False
    (checkout / "settings.toml").write_text("after")
    assert provenance.commit()["dirty"] is True
