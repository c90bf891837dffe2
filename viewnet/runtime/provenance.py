"""Where a number comes from: code, commit, machine and library versions."""

import ast
import contextlib
import functools
import hashlib
import importlib.metadata
import logging
import multiprocessing
import os
import platform
import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from viewnet.errors import ViewnetError
from viewnet.runtime.parallel import cores

PACKAGE = Path(__file__).resolve().parent.parent
COUNTED = (":(top)", ":(top,exclude)paper_tables")
"""Of a checkout, what decides results: tables are written there between one training and the next."""
LIBRARIES = ("torch", "numpy", "scipy", "pandas", "numba", "safetensors", "trimesh", "embreex")

log = logging.getLogger(__name__)


@functools.cache
def code_identity(modules: tuple[str, ...]) -> str:
    """12 hex digits of the top-level statements in modules of this package (paths below it), in any order.

    Comments, docstrings, imports and format do not count: documenting, formatting or moving code keeps finished runs
    valid, editing a statement does not.
    """
    trees = (_Bare().visit(ast.parse(PACKAGE.joinpath(module).read_text(encoding="utf-8"))) for module in modules)
    texts = sorted(ast.unparse(statement) for tree in trees for statement in tree.body)
    return hashlib.sha256("\n\n".join(texts).encode()).hexdigest()[:12]


class _Bare(ast.NodeTransformer):
    """Takes imports and docstrings away."""

    def visit_Import(self, node: ast.Import | ast.ImportFrom) -> None:
        return None

    visit_ImportFrom = visit_Import

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) else node


def commit() -> dict[str, Any]:
    """The git commit of this package's checkout, and whether tracked files were changed, but for tables of results.

    What cannot be told is None, and "unknown" says why. So does the log, once, of the process that started others.
    """
    known: dict[str, Any] = {"commit": None, "dirty": None}
    try:
        head = _git("rev-parse", "HEAD")
        _git("ls-files", "--error-unmatch", "errors.py")  # fails in another project that contains this folder
        known["commit"] = head
        known["dirty"] = bool(_git("status", "--porcelain", "--untracked-files=no", "--", *COUNTED))
    except ViewnetError as error:
        known["unknown"], remedy = _reason(str(error))
        if multiprocessing.parent_process() is None:
            warn_once(f"results do not name the commit that made them: {known['unknown']}: {remedy}")
    return known


def in_words(git: Mapping[str, Any]) -> str:
    """A commit as `commit` has it, in 7 digits; with a mark where the code was changed since.

    >>> in_words({"commit": "0123456789abcdef", "dirty": True}), in_words({"commit": None})
    ('0123456 (changed)', 'unknown')
    """
    return f"{(git.get('commit') or 'unknown')[:7]}{' (changed)' if git.get('dirty') else ''}"


def _git(*arguments: str) -> str:
    """What git says of this package's folder. ViewnetError with what it says instead."""
    command = ["git", "-C", str(PACKAGE), *arguments]
    try:
        environment = os.environ | {"LC_ALL": "C"}
        result = subprocess.run(command, capture_output=True, text=True, timeout=20, env=environment)
    except FileNotFoundError:
        raise ViewnetError("git is not installed") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ViewnetError(f"git does not answer ({type(error).__name__})") from None
    if result.returncode:
        raise ViewnetError(result.stderr.strip() or f"git fails ({result.returncode})")
    return result.stdout.strip()


def _reason(answer: str) -> tuple[str, str]:
    """Why git names no commit, of its answer, and what to do."""
    if not (PACKAGE.parent / ".git").exists():
        return "the package is installed without a checkout", "install it from one (pip install -e FOLDER)"
    if exception := re.search(r"git config .*safe\.directory .*", answer):
        return "git refuses a checkout of another owner", exception[0]
    return answer.splitlines()[0], "see to it that `git status` works in the checkout"


@functools.cache
def warn_once(line: str) -> None:
    """A line for the log, the first time that it comes."""
    log.warning("%s", line)


def hardware(threads: int | None = None) -> dict[str, Any]:
    """CPU model, usable cores, threads in use and the GPU that torch would train on (None without)."""
    import torch

    cpu, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists() and (name := re.search(r"^model name.*?:(.*)", info.read_text(errors="replace"), re.MULTILINE)):
        cpu = name[1].strip()
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": cpu,
        "cores": cores(),
        "threads": threads or torch.get_num_threads(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
    }


def versions(libraries: Sequence[str] = LIBRARIES) -> dict[str, str]:
    """The versions of Python and of those of the libraries that are installed."""
    installed = {"python": platform.python_version()}
    for name in libraries:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            installed[name] = importlib.metadata.version(name)
    return installed
