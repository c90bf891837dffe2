"""The command `viewnet`."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from viewnet.commands import checking, completing, estimating, serving, showing, training
from viewnet.errors import ViewnetError

OUTCOMES = """exit codes:
  0    done
  1    viewnet tables: some notebooks failed, the others are done; elsewhere a defect, with its traceback
  2    something to mend, told in one line
  130  interrupted: the same command goes on where it was

Results go to the standard output, progress and errors to the standard error. TQDM_DISABLE=1 silences progress.
viewnet COMMAND --help has examples.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code (see OUTCOMES)."""
    options = parser().parse_args(arguments)
    try:
        return options.run(options) or 0
    except ViewnetError as error:
        if os.environ.get("WORLD_SIZE", "1") != "1":
            _fail_together(f"viewnet: {error}")
        print(f"viewnet: {error}", file=sys.stderr)
        return 2
    except Exception:
        if os.environ.get("WORLD_SIZE", "1") != "1":
            _fail_together(traceback.format_exc())
        raise
    except KeyboardInterrupt:
        print("viewnet: interrupted: the same command goes on where it was", file=sys.stderr)
        return 130


class _Parser(argparse.ArgumentParser):
    """One that tells what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"viewnet: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    found = _Parser(
        prog="viewnet",
        description="ViewNet, replicated: tables and figures of the paper, and viewpoints of your own images.",
        epilog=OUTCOMES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    version = f"viewnet {importlib.metadata.version('viewnet')}"
    found.add_argument("--version", action="version", version=version)
    commands = found.add_subparsers(required=True, metavar="COMMAND")
    for group in (showing, training, estimating, serving, checking, completing):
        group.add(commands)
    return found


def _fail_together(message: str) -> None:
    from viewnet.runtime import distributed

    if distributed.size() > 1:
        distributed.fail(message)


if __name__ == "__main__":
    sys.exit(main())
