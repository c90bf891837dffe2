"""Running the project's notebooks: parameters checked before a kernel starts, problems told in one line."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from viewnet import paths
from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.experiments.cad import Experiment
from viewnet.experiments.request import accepted
from viewnet.runtime.files import replacing

PATIENCE = 600
"""Seconds to wait for a kernel: on a busy machine the usual minute is not enough."""


def folder() -> Path:
    """Where the notebooks are: under the project's root, else in the checkout this package lies in."""
    return paths.part("notebooks")


def find(name: str) -> Path:
    """The file of a notebook, named with or without its ending. ViewnetError naming those there are."""
    files = {path.stem: path for path in sorted(folder().glob("*.ipynb"))}
    return files[known(name.removesuffix(".ipynb"), files, "notebook")]


def parameters(path: Path) -> dict[str, dict[str, str]]:
    """The declared parameters of a notebook: name -> inferred_type_name, default and help, as text.

    Nothing in it is executed. Raises ViewnetError for a file that is no notebook.
    """
    import papermill

    try:
        return {name: dict(found) for name, found in papermill.inspect_notebook(str(path)).items()}
    except Exception as error:  # papermill and nbformat raise whatever a damaged file makes them stumble over
        raise ViewnetError(f"{path}: not a notebook that can be read ({type(error).__name__})") from None


def checked(path: Path, values: Sequence[tuple[str, str]]) -> tuple[dict[str, Any], Experiment]:
    """Values given as text in the types the notebook declares, and the experiment they ask for.

    Ids keep their zeros and words like "false" stay words, since nothing is guessed. Raises ViewnetError for unknown
    and repeated names, and for values that the notebook would refuse.
    """
    declared = parameters(path)
    found: dict[str, Any] = {}
    for name, text in values:
        known(name, declared, f"parameter of {path.stem}")
        if name in found:
            raise ViewnetError(f"parameter {name} is given twice")
        found[name] = _typed(name, text, declared[name]["inferred_type_name"])
    taken = accepted(path.stem)
    return found, experiment(path.stem, **{name: value for name, value in found.items() if name in taken})


def _typed(name: str, text: str, kind: str) -> Any:
    kinds = {part.strip() for part in kind.split("|")}
    if "int" in kinds:
        try:
            return int(text)
        except ValueError:
            if "str" not in kinds:
                raise ViewnetError(f"parameter {name} {text!r}: expected a whole number") from None
    return text


def run(name: str, values: Sequence[tuple[str, str]] = (), output: Path | None = None) -> Path:
    """Execute a notebook with parameters given as text; the executed copy's path.

    The copy goes to `output`, else to `<paths.runs()>/notebooks/<name>[-<what is not the default>].ipynb`. Raises
    ViewnetError for bad parameters before a kernel starts, for a ViewnetError in the notebook, and where any other
    cell fails.
    """
    import papermill

    source = find(name)
    given, asked = checked(source, values)
    if output is None:
        stem = f"{source.stem}-{asked.label}" if asked.label else source.stem
        output = paths.runs() / "notebooks" / f"{stem}.ipynb"
    if output.resolve() == source.resolve():
        raise ViewnetError(f"{output}: is the notebook itself: choose another output")
    output.parent.mkdir(parents=True, exist_ok=True)
    try:
        # Progress bars are on the kernel's stderr; here they reach the terminal as well as the copy.
        papermill.execute_notebook(
            str(source),
            str(output),
            given,
            kernel_name="python3",
            start_timeout=PATIENCE,
            progress_bar=False,
            stderr_file=sys.stderr,
        )
    except papermill.PapermillExecutionError as error:
        _explain(error.ename, error.evalue, output)
    except Exception as error:
        _explain(type(error).__name__, str(error), output)
    return output


def refresh(name: str) -> Path:
    """Execute a notebook with its own defaults and keep the outputs in it, without timings and machine names."""
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError

    source = find(name)
    checked(source, [])
    notebook = nbformat.read(source, as_version=4)
    environment = dict(os.environ, TQDM_DISABLE="1")
    try:
        client = NotebookClient(
            notebook, kernel_name="python3", timeout=None, startup_timeout=PATIENCE, record_timing=False
        )
        client.execute(env=environment)
    except CellExecutionError as error:
        _explain(error.ename, error.evalue, source)
    except Exception as error:
        _explain(type(error).__name__, str(error), source)
    notebook.metadata.pop("language_info", None)
    for cell in notebook.cells:
        if "outputs" in cell:  # progress is told on stderr
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    with replacing(source) as temporary:
        nbformat.write(notebook, temporary)
    return source


def _explain(kind: str, message: str, path: Path) -> NoReturn:
    first = (message.strip().splitlines() or [""])[0]
    if kind == "ViewnetError":
        raise ViewnetError(first)
    if kind == "NoSuchKernel":
        raise ViewnetError("no Jupyter kernel named python3: install one with pip install ipykernel")
    raise ViewnetError(f"{path.stem} failed: {kind}: {first} (see {path})")
