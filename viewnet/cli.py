"""The command `viewnet`."""

import argparse
import errno
import importlib
import importlib.metadata
import inspect
import os
import re
import sys
import textwrap
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.runtime import parallel

COMMANDS = (
    *("notebook", "tables", "replicate", "render", "train", "evaluate", "predict", "turntable", "distil", "adapt"),
    *("runs", "save", "demo", "data", "audit", "bench", "completion"),
)
"""The modules of viewnet.commands, in the order of the help."""
NEGATIVE = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$|-inf(inity)?$|-nan$", re.IGNORECASE)
"""A word that is a value and no option; argparse's own expression knows no exponents."""
EXIT_CODES = """exit codes:
  0    done
  1    viewnet tables: some notebooks failed; adapt: no help, not written; else an internal error, with its traceback
  2    a mistake in the input, explained in one line
  3    viewnet predict: some images failed, each named in a line of the standard error; the others are answered
  130  interrupted: the same command continues where it stopped
  141  nobody reads the standard output any more

Results go to the standard output, progress and errors to the standard error. TQDM_DISABLE=1 silences progress.
viewnet COMMAND --help has examples.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code (see EXIT_CODES)."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller: the next file opened would get what is written there
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
    options = parser().parse_args(arguments)
    os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")  # PyTorch reads it later: large tensors on pages of 2 MiB
    try:
        parallel.threads_asked()  # said before PyTorch is imported, whose OpenMP would warn in words of its own
        code = options.run(options) or 0
        print(end="", flush=True)  # within reach of what follows
        return code
    except ViewnetError as error:
        _fail_together(f"viewnet: {error}")
        print(f"viewnet: {error}", file=sys.stderr)
        return 2
    except Exception as error:
        # Whoever reads the output has enough of it, as `head` has, or its disk is full; of other files it is named.
        closed, full = isinstance(error, BrokenPipeError), getattr(error, "errno", 0) == errno.ENOSPC
        if closed or full:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            if full:
                print("viewnet: the standard output cannot be written: no space left", file=sys.stderr)
            return 141 if closed else 2
        _fail_together(traceback.format_exc())
        raise
    except KeyboardInterrupt:
        print("viewnet: interrupted: the same command continues where it stopped", file=sys.stderr)
        return 130


class _Parser(argparse.ArgumentParser):
    """A parser that reports a mistake in one line, takes negative numbers for values, and keeps the lines of help."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **settings)
        self._negative_number_matcher = NEGATIVE

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None:
            what = action.metavar or "".join(action.option_strings[-1:]) or "argument"
            try:
                known(value, action.choices, str(what).lower())
            except ViewnetError as error:
                raise argparse.ArgumentError(None, str(error)) from None

    def error(self, message: str) -> NoReturn:
        word = message.partition(": ")[2]
        file = f": a file of this name is written ./{word}" if word[:1] == "-" and os.path.exists(word) else ""
        self.exit(2, f"viewnet: {message}{file} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    whole = _Parser(
        prog="viewnet",
        description="ViewNet, replicated: tables and figures of the paper, and viewpoints of your own images.",
        epilog=EXIT_CODES,
    )
    whole.set_defaults(parser=whole)
    whole.add_argument("--version", action="version", version=f"viewnet {importlib.metadata.version('viewnet')}")
    commands = whole.add_subparsers(required=True, metavar="COMMAND")
    for name in COMMANDS:
        module = importlib.import_module(f"viewnet.commands.{name}")
        text, _, examples = (inspect.getdoc(module) or "").partition("\n\nExamples:\n\n")
        summary, _, description = text.partition("\n\n")
        command = commands.add_parser(
            name,
            help=summary[:1].lower() + summary[1:].rstrip("."),
            description=description,
            epilog="examples:\n" + textwrap.indent(textwrap.dedent(examples), "  "),
        )
        for each in module.ARGUMENTS:
            exclusive = isinstance(each, list)
            place: Any = command.add_mutually_exclusive_group() if exclusive else command
            for names, settings in each if exclusive else [each]:
                place.add_argument(*names, **settings)
        command.set_defaults(run=module.run)
    return whole


def _fail_together(message: str) -> None:
    """End all processes of a training that spans several; return where there is only this one."""
    if os.environ.get("WORLD_SIZE", "1") != "1":
        from viewnet.runtime import distributed

        if distributed.size() > 1:
            distributed.fail(message)


if __name__ == "__main__":
    sys.exit(main())
