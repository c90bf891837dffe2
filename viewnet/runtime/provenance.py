"""Where a number comes from: the code, the commit, the machine and the libraries."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import io
import platform
import subprocess
import tokenize
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeGuard

from viewnet.runtime.parallel import cores

PACKAGE = Path(__file__).resolve().parent.parent
LIBRARIES = ("torch", "numpy", "scipy", "pandas", "numba", "safetensors", "trimesh", "embreex")


@functools.cache
def code_identity(modules: tuple[str, ...]) -> str:
    """12 hex digits of the statements in some modules of this package (paths below it).

    What does not decide a result is left out: comments, docstrings, imports, blank lines, the modules' names and the
    order of their functions. So a comment or a move leaves finished runs valid, and an edited statement does not.
    """
    found = [text for module in modules for text in statements(PACKAGE.joinpath(module).read_text(encoding="utf-8"))]
    return hashlib.sha256("\n\n".join(sorted(found)).encode()).hexdigest()[:12]


def statements(source: str) -> list[str]:
    """The top-level statements of Python source, without comments, docstrings, imports and blank lines."""
    lines = source.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)) or _is_text(node):
            lines[node.lineno - 1 : node.end_lineno] = [""] * ((node.end_lineno or node.lineno) - node.lineno + 1)
    found = []
    for node in tree.body:
        first = min([node.lineno, *(decorator.lineno for decorator in getattr(node, "decorator_list", []))])
        text = "\n".join(line.rstrip() for line in lines[first - 1 : node.end_lineno] if line.strip())
        found += [text] if text else []
    return found


def _is_text(node: ast.AST) -> TypeGuard[ast.Expr]:
    """Whether a statement is nothing but a string: a docstring, of whatever it stands in or under."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def commit() -> dict[str, Any]:
    """The git commit of this package's checkout and whether tracked files differ from it; None for both outside one."""
    head = _git("rev-parse", "HEAD")
    if head is None or _git("ls-files", "--error-unmatch", "errors.py") is None:
        return {"commit": None, "dirty": None}  # no checkout, or one of something else that contains this folder
    return {"commit": head, "dirty": bool(_git("status", "--porcelain", "--untracked-files=no"))}


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", "-C", str(PACKAGE), *arguments], capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def hardware(threads: int | None = None) -> dict[str, Any]:
    """Processor, cores in reach, threads in use and the GPU that torch would train on (None without)."""
    import torch

    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": cores(),
        "threads": threads or torch.get_num_threads(),
        "gpu": gpu,
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def versions(libraries: Sequence[str] = LIBRARIES) -> dict[str, str]:
    """Python and the libraries that have a part in the numbers, as far as they are installed."""
    found = {"python": platform.python_version()}
    for name in libraries:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
