"""Print a script that completes commands in a shell.

Print a script that completes commands, options, names and files.

Examples:

    eval "$(viewnet completion bash)"                               in ~/.bashrc
    viewnet completion zsh > ~/.zfunc/_viewnet                      with fpath+=~/.zfunc before compinit in ~/.zshrc
    viewnet completion tcsh > ~/.viewnet.tcsh                       with source ~/.viewnet.tcsh in ~/.tcshrc
"""

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path

from viewnet import paths
from viewnet.commands.options import Options, argument
from viewnet.config import CATEGORIES
from viewnet.errors import ViewnetError
from viewnet.recipes import PEERS, PROFILES, RECIPES, VARIANTS

# The values of arguments that have few; whatever uses an argument checks it.
VALUES = {"categories": CATEGORIES, "variant": VARIANTS | PEERS, "profile": PROFILES, "recipe": RECIPES}
FILES, FOLDERS = ("FILE", "IMAGE", "WHERE"), ("FOLDER",)  # metavars of arguments that take files and folders
ARGUMENTS = (argument("shell", choices=("bash", "zsh", "tcsh")),)


def run(options: Options) -> None:
    """Print the script for `options.parser`, the parser of the whole command line."""
    import shtab

    for action in _actions(options.parser):
        if action.metavar in FOLDERS:
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif action.type is Path or action.metavar in FILES:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        elif action.metavar == "NOTEBOOK":
            with contextlib.suppress(ViewnetError):  # installed without them
                action.choices = sorted(path.stem for path in paths.part("notebooks").glob("*.ipynb"))
        elif action.dest in VALUES:
            action.choices = list(VALUES[action.dest])
    print(shtab.complete(options.parser, options.shell))


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """The arguments of a parser and of its commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
        else:
            yield action
