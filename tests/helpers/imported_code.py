"""Which modules of the package a module of it imports."""

from __future__ import annotations

import ast

from viewnet.runtime import provenance


def imports(module: str) -> set[str]:
    """Modules of this package that a module of it imports, anywhere in its source, as paths below the package."""
    found = set()
    for node in ast.walk(ast.parse((provenance.PACKAGE / module).read_text())):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "viewnet":
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.startswith("viewnet.")]
        for name in names:
            path = "/".join(name.split(".")[1:]) + ".py"
            if (provenance.PACKAGE / path).is_file():
                found.add(path)
    return found
