"""Where a number comes from: code, commit, machine and library versions."""

import ast
import contextlib
import functools
import hashlib
import importlib.metadata
import platform
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from viewnet.runtime.parallel import cores

PACKAGE = Path(__file__).resolve().parent.parent
LIBRARIES = ("torch", "numpy", "scipy", "pandas", "numba", "safetensors", "trimesh", "embreex")


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
    """The git commit of this package's checkout and whether tracked files were changed; None for both outside one."""
    if (head := _git("rev-parse", "HEAD")) is None or _git("ls-files", "--error-unmatch", "errors.py") is None:
        return {"commit": None, "dirty": None}  # no checkout, or one of another project that contains this folder
    return {"commit": head, "dirty": bool(_git("status", "--porcelain", "--untracked-files=no"))}


def _git(*arguments: str) -> str | None:
    try:
        result = subprocess.run(["git", "-C", str(PACKAGE), *arguments], capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() if result.returncode == 0 else None


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
