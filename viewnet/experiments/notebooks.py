"""The project's notebooks: running them, one or all, and keeping what is stored in them true to code and files.

Parameters are checked before a kernel starts. A notebook's cell of parameters is written from their table, and all of
its outputs are stored but those of the cell that runs what is missing, which nothing committed would hold to account.
"""

import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from viewnet import paths
from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.experiments.cad import Experiment
from viewnet.experiments.parameters import PARAMETERS
from viewnet.experiments.request import DESIGNS, TAKES, accepted
from viewnet.runs.needs import Needs
from viewnet.runtime.files import replacing

START_TIMEOUT = 600
"""Seconds to wait for a kernel: on a busy machine the usual minute is not enough."""
ORDER = tuple(TAKES)
"""The notebooks in the order to run them."""
LIVE = "nbval-ignore-output"
"""The tag of the cell that runs what is missing, whose outputs nbval ignores and no committed notebook has."""

Values = Sequence[tuple[str, str]]
"""Parameters as text: name and value."""


def find(name: str) -> Path:
    """The file of a notebook, given with or without its ending. Raises ViewnetError naming those there are."""
    files = {path.stem: path for path in sorted(paths.part("notebooks").glob("*.ipynb"))}
    return files[known(name.removesuffix(".ipynb"), files, "notebook")]


def read(path: Path) -> Any:
    """A notebook. Raises ViewnetError for a file that is none."""
    import nbformat

    try:
        return nbformat.read(path, as_version=4)
    except Exception as error:  # nbformat lets any error of a damaged file through
        raise ViewnetError(f"{path}: not a notebook that can be read ({type(error).__name__})") from None


def parameters(name: str) -> list[str]:
    """The lines of a notebook's cell of parameters, as papermill reads them: `name: type = default  # meaning`.

    >>> parameters("architecture")[1]
    'output: str = ""  # for tables; empty: paper_tables'
    """
    declared = {key: PARAMETERS[key] for key in accepted(name)}
    return [f"{k}: {type(p.default).__name__} = {json.dumps(p.default)}  # {p.help}" for k, p in declared.items()]


def check(name: str, values: Values) -> Experiment:
    """The request of a notebook for values given as text, of which nothing is guessed: ids keep their zeros.

    Raises ViewnetError for unknown and repeated names, and for values that the notebook would refuse.
    """
    given: dict[str, str] = {}
    for key, text in values:
        if known(key, accepted(name), f"parameter of {name}") in given:
            raise ViewnetError(f"parameter {key} is given twice")
        given[key] = text
    found: Experiment = experiment(name, **given)
    return found


def run(name: str, values: Values = (), output: Path | None = None) -> Path:
    """Execute a notebook; the executed copy's path.

    The copy goes to `output`; in a folder, by default `<paths.runs()>/notebooks`, it is `<name>[-<label>].ipynb`.
    Raises ViewnetError for bad parameters before a kernel starts, and where any cell fails.
    """
    import papermill

    read(source := find(name))
    request = check(source.stem, values)
    stem = f"{source.stem}-{request.label}" if request.label else source.stem
    folder = paths.runs() / "notebooks" if output is None else output
    output = folder / f"{stem}.ipynb" if output is None or output.is_dir() else output
    if output.resolve() == source.resolve():
        raise ViewnetError(f"{output}: is the notebook itself: choose another output")
    output.parent.mkdir(parents=True, exist_ok=True)
    # Progress bars are on the kernel's stderr; here they reach the terminal as well as the copy.
    options: dict[str, Any] = {"kernel_name": "python3", "start_timeout": START_TIMEOUT, "stderr_file": sys.stderr}
    try:
        papermill.execute_notebook(str(source), str(output), dict(values), progress_bar=False, **options)
    except Exception as error:
        _raise_in_one_line(error, output)
    return output


def refresh(names: Sequence[str] = ORDER) -> list[Path]:
    """Write the cell of parameters of notebooks, and run their other cells but the live one; their paths.

    Nothing is trained: what runs shows committed files. All share a kernel, which takes its time to start. Raises
    ViewnetError where a cell fails.
    """
    import nbformat
    from nbclient import NotebookClient

    books = {(path := find(name)): read(path) for name in names}
    run_cells = []
    for path, book in books.items():
        code = [cell for cell in book.cells if cell.cell_type == "code"]
        for count, cell in enumerate(code, 1):
            tags = cell.metadata.get("tags", [])
            if "parameters" in tags:
                cell.source = "\n".join(parameters(path.stem))
            cell.outputs, cell.execution_count = [], None if LIVE in tags else count
        run_cells += [cell for cell in code if cell.execution_count]
    together = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell.source) for cell in run_cells])
    try:
        client = NotebookClient(together, kernel_name="python3", startup_timeout=START_TIMEOUT, record_timing=False)
        client.execute(env=dict(os.environ, TQDM_DISABLE="1"))
    except Exception as error:
        _raise_in_one_line(error, paths.part("notebooks"))
    for cell, ran in zip(run_cells, together.cells, strict=True):
        cell.outputs = [output for output in ran.outputs if output.get("name") != "stderr"]
        for output in cell.outputs:
            if "execution_count" in output:
                output.execution_count = cell.execution_count
    for path, book in books.items():
        book.metadata.pop("language_info", None)
        with replacing(path) as temporary:
            nbformat.write(book, temporary)
    return list(books)


def _raise_in_one_line(error: Exception, path: Path) -> NoReturn:
    """Raise a ViewnetError for an error in the notebook `path`, or on the way to run it."""
    # Errors of cells, papermill's and nbclient's, have the name and message of the exception in the kernel.
    kind = getattr(error, "ename", type(error).__name__)
    message = (str(getattr(error, "evalue", error)).strip().splitlines() or [""])[0]
    if kind == "ViewnetError":
        raise ViewnetError(message)
    if kind == "NoSuchKernel":
        raise ViewnetError("no Jupyter kernel named python3: install one with pip install ipykernel")
    raise ViewnetError(f"{path.stem} failed: {kind}: {message} (see {path})")


def plan(only: Sequence[str] | None = None, profile: str | None = None, seeds: str | None = None) -> dict[str, Values]:
    """The notebooks to run, all or `only` these, in the order of ORDER -> their checked parameters.

    `profile` is given to those that train, `seeds` to those that take several. Raises ViewnetError for an unknown
    notebook and for values that a notebook would refuse, before any is run.
    """
    names = {known(name.removesuffix(".ipynb"), ORDER, "notebook") for name in only or ORDER}
    planned: dict[str, Values] = {}
    for name in sorted(names, key=ORDER.index):
        given = {"profile": profile if DESIGNS[name].variants else None, "seeds": seeds}
        planned[name] = [(key, value) for key, value in given.items() if value is not None and key in accepted(name)]
        check(name, planned[name])
    return planned


def needs(planned: dict[str, Values]) -> Needs:
    """What the trainings of notebooks need, each view store and run once."""
    found = Needs()
    for name, values in planned.items():
        found |= check(name, values).needs()
    return found


def run_all(planned: dict[str, Values]) -> Iterator[dict[str, Any]]:
    """Run notebooks one after the other; of each name, seconds, executed copy and error as soon as they are known.

    Failures do not stop it.
    """
    for name, values in planned.items():
        start, copy, error = time.monotonic(), None, None
        try:
            copy = str(run(name, values))
        except ViewnetError as problem:
            error = str(problem)
        yield {"name": name, "seconds": round(time.monotonic() - start, 1), "copy": copy, "error": error}
