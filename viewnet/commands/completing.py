"""Completion in shells: viewnet completion."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from viewnet import paths
from viewnet.commands import shared
from viewnet.config import CATEGORIES
from viewnet.errors import ViewnetError
from viewnet.recipes import PROFILES, RECIPES, VARIANTS

COMPLETING = """
eval "$(viewnet completion bash)"                               in ~/.bashrc
viewnet completion zsh > ~/.zfunc/_viewnet                      with fpath+=~/.zfunc before compinit in ~/.zshrc
viewnet completion tcsh > ~/.viewnet.tcsh                       with source ~/.viewnet.tcsh in ~/.tcshrc
"""
SHELLS = ("bash", "zsh", "tcsh")
VALUES = {"categories": CATEGORIES, "variant": VARIANTS, "profile": PROFILES, "recipe": RECIPES}
"""Arguments whose values are few; which of them are allowed is checked by what uses them."""
FILES, FOLDERS = ("FILE", "IMAGE", "WHERE"), ("FOLDER",)
"""What arguments that take files and folders are called in the help."""


def add(commands: Any) -> None:
    """Its parser."""
    completion = shared.add(
        commands,
        "completion",
        "print a script that completes commands in a shell",
        "Print a script that completes commands, options, names and files.",
        COMPLETING,
    )
    completion.add_argument("shell", choices=SHELLS)
    completion.set_defaults(run=_completion)


def _completion(options: argparse.Namespace) -> None:
    import shtab

    from viewnet import cli

    parser = cli.parser()
    for action in _actions(parser):
        if action.metavar in FOLDERS:
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif action.type is Path or action.metavar in FILES:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        elif action.metavar == "NOTEBOOK":
            action.choices = _notebooks()
        elif action.dest in VALUES:
            action.choices = list(VALUES[action.dest])
    print(shtab.complete(parser, options.shell))


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Of a parser and its commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from _actions(inner)
        else:
            yield action


def _notebooks() -> list[str]:
    try:
        return sorted(path.stem for path in paths.part("notebooks").glob("*.ipynb"))
    except ViewnetError:  # installed without them
        return []
