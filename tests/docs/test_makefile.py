"""The Makefile's virtual environment: what it makes, and what it leaves alone."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STAMPS = (".locked", ".installed")
# It installs nothing; an environment that it makes has itself as Python.
PYTHON = """#!/bin/sh
[ "$1 $2" = "-m venv" ] || exit 0
[ "$3" != --clear ] || { shift; rm -rf "$3"/* "$3"/.[!.]*; }
mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && cp "$0" "$3/bin/uv"
"""


@pytest.fixture
def checkout(tmp_path) -> Path:
    """A folder with the Makefile and what its set-up and cleaning read."""
    folder = tmp_path / "checkout"
    for name in ("viewnet", "tests", "notebooks"):
        (folder / name).mkdir(parents=True)
    shutil.copy(ROOT / "Makefile", folder)
    for name in ("environment.lock", "pyproject.toml"):
        (folder / name).touch()
    (tmp_path / "python").write_text(PYTHON)
    (tmp_path / "python").chmod(0o755)
    return folder


def environment(folder: Path, *stamps: str) -> Path:
    """An environment with a file of somebody's, and stamps older than the lock; the file."""
    for name in ("bin/python", "kept", *stamps):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder.parents[1] / "python", folder / name)
        os.utime(folder / name, (0, 0))
    return folder / "kept"


def make(checkout: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    given = [f"PYTHON={checkout.parent / 'python'}", *arguments]
    clean = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "VENV")}
    return subprocess.run(["make", *given], cwd=checkout, env=clean, capture_output=True, text=True)


def refusal(result: subprocess.CompletedProcess[str]) -> str:
    """What the Makefile says, in one line above that of make itself."""
    assert result.returncode == 2
    line, of_make = result.stderr.splitlines()
    assert of_make.startswith("make: ***")
    return line


@pytest.mark.parametrize("target", ["docs", "setup"])
@pytest.mark.parametrize("name", [".venv", ".venv/"])
@pytest.mark.parametrize("stamps", [(), STAMPS])
def test_nothing_is_cleared_through_a_link(checkout, target, name, stamps):
    kept = environment(checkout / "theirs", *stamps)
    (checkout / ".venv").symlink_to(kept.parent)
    told = refusal(make(checkout, f"VENV={name}", target))
    assert told == f"make: {name} is a symbolic link: remove it, or make VENV=other {target}"
    assert kept.is_file()
    make(checkout, f"VENV={name}", "clean")
    assert kept.is_file()


@pytest.mark.parametrize("target", ["docs", "setup", "clean"])
def test_an_environment_without_a_stamp_stays(checkout, target):
    kept = environment(checkout / ".venv")
    result = make(checkout, target)
    if target == "clean":
        assert result.stdout.startswith("make: .venv stays: not made by make\n")
    else:
        assert refusal(result).endswith(f"remove it, or make VENV=other {target}")
    assert kept.is_file()


@pytest.mark.parametrize("stamps", [STAMPS, STAMPS[:1], STAMPS[1:]])
@pytest.mark.parametrize("target", ["docs", "setup", "clean"])
def test_only_setup_and_clean_remove_an_environment_that_is_out_of_date(checkout, target, stamps):
    kept = environment(checkout / ".venv", *stamps)
    result = make(checkout, target)
    assert kept.is_file() == (target == "docs")
    if target == "docs":
        assert refusal(result) == "make: .venv is not as environment.lock says: make setup makes it anew"
    else:
        assert result.returncode == 0
        assert (checkout / ".venv").exists() == (target == "setup")


@pytest.mark.parametrize("before", ["nothing", "an empty folder"])
def test_an_environment_is_made_where_there_is_none_and_kept(checkout, before):
    if before != "nothing":
        (checkout / ".venv").mkdir()
    assert make(checkout, "docs").returncode == 0
    (kept := checkout / ".venv" / "kept").touch()
    assert all((checkout / ".venv" / stamp).is_file() for stamp in STAMPS)
    assert make(checkout, "docs").returncode == 0
    assert kept.is_file()


def test_a_set_up_that_was_interrupted_is_begun_again(checkout):
    python = checkout.parent / "python"
    python.write_text(PYTHON.replace("exit 0", '[ "$2" != pip ]; exit'))
    assert make(checkout, "setup").returncode == 2
    python.write_text(PYTHON)
    assert make(checkout, "setup").returncode == 0


@pytest.mark.parametrize("pip", [True, False])
def test_pip_installs_where_uv_cannot(checkout, pip):
    python = checkout.parent / "python"
    refuses = '[ "$1" != pip ]' if pip else '[ "$1" != pip ] && [ "$2" != pip ]'  # uv pip, and python -m pip
    python.write_text(PYTHON.replace("exit 0", f"{{ {refuses}; exit; }}"))
    result = make(checkout, "setup")
    assert result.returncode == (0 if pip else 2)
    assert "pip installs instead" in result.stdout
    assert (checkout / ".venv" / ".installed").exists() == pip
