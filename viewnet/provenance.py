"""Where a number comes from: the code, the commit, the machine and the libraries."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import io
import os
import platform
import subprocess
import tokenize
from collections.abc import Sequence
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parent
LIBRARIES = ("torch", "numpy", "scipy", "pandas", "numba", "safetensors", "trimesh", "embreex")


@functools.cache
def code_identity(modules: tuple[str, ...]) -> str:
    """12 hex digits of some modules of this package (paths below it), comments, docstrings and blank lines apart.

    Editing a comment leaves finished runs valid, editing a statement does not.
    """
    digest = hashlib.sha256()
    for module in modules:
        digest.update(f"{module}\n{bare(PACKAGE.joinpath(module).read_text(encoding='utf-8'))}\n".encode())
    return digest.hexdigest()[:12]


def bare(source: str) -> str:
    """Python source without comments, docstrings, blank lines and trailing space."""
    lines = source.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            for statement in node.body:
                if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                    for row in range(statement.lineno, (statement.end_lineno or statement.lineno) + 1):
                        lines[row - 1] = ""
    return "\n".join(line.rstrip() for line in lines if line.strip())


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


def cores() -> int:
    """Processor cores this process may use: its affinity, and its container's quota where there is one."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = Path("/sys/fs/cgroup/cpu.max")
    if quota.exists():
        allowed, _, period = quota.read_text().partition(" ")
        if allowed.isdigit():
            count = min(count, max(1, int(allowed) // int(period)))
    return count


def versions(libraries: Sequence[str] = LIBRARIES) -> dict[str, str]:
    """Python and the libraries that have a part in the numbers, as far as they are installed."""
    found = {"python": platform.python_version()}
    for name in libraries:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
