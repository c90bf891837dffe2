"""Running the project's notebooks, one or all: parameters are checked before a kernel starts."""

import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NoReturn

from viewnet import paths
from viewnet.config import known
from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.experiments.request import DESIGNS, Request, accepted
from viewnet.runtime.files import replacing

START_TIMEOUT = 600
"""Seconds to wait for a kernel: on a busy machine the usual minute is not enough."""
ORDER = (
    # Nothing is trained for these.
    *("architecture", "audit_metrics", "table1_shapenet"),
    # The runs of Table 2 serve the figures after it, those of Table 3 what scores photographs.
    *("table2_ablation", "figure3_azimuth", "failures", "learned_volumes", "training_curves", "novel_views"),
    *("test_sets", "recipe_ablation"),
    *("table3_pascal3d", "table5_dva", "alignment_study", "reconstructions"),
    *("table4_freiburg", "objectron", "your_method"),
)
"""Notebooks that share runs follow each other: the first trains them, the others take no time."""

Values = Sequence[tuple[str, str]]
"""Parameters as text: name and value."""


def folder() -> Path:
    """Where the notebooks are: under the project's root, else in the checkout this package lies in."""
    return paths.part("notebooks")


def find(name: str) -> Path:
    """The file of a notebook, given with or without its ending. Raises ViewnetError naming those there are."""
    files = {path.stem: path for path in sorted(folder().glob("*.ipynb"))}
    return files[known(name.removesuffix(".ipynb"), files, "notebook")]


def parameters(path: Path) -> dict[str, dict[str, str]]:
    """The declared parameters of a notebook: name -> inferred_type_name, default and help, as text.

    Nothing in it is executed. Raises ViewnetError for a file that is no notebook.
    """
    import papermill

    try:
        return {name: dict(declared) for name, declared in papermill.inspect_notebook(str(path)).items()}
    except Exception as error:  # papermill and nbformat raise anything at a damaged file
        raise ViewnetError(f"{path}: not a notebook that can be read ({type(error).__name__})") from None


def check(path: Path, values: Values) -> tuple[dict[str, Any], Request]:
    """Values in the types that the notebook declares, and its request for them.

    Nothing is guessed: ids keep their zeros, and words like "false" stay words. Raises ViewnetError for unknown and
    repeated names, and for values that the notebook would refuse.
    """
    declared = parameters(path)
    typed: dict[str, Any] = {}
    for name, text in values:
        known(name, declared, f"parameter of {path.stem}")
        if name in typed:
            raise ViewnetError(f"parameter {name} is given twice")
        typed[name] = _typed(name, text, declared[name]["inferred_type_name"])
    taken = accepted(path.stem)
    return typed, experiment(path.stem, **{name: value for name, value in typed.items() if name in taken})


def _typed(name: str, text: str, kind: str) -> Any:
    if "int" in (kinds := {part.strip() for part in kind.split("|")}):
        try:
            return int(text)
        except ValueError:
            if "str" not in kinds:
                raise ViewnetError(f"parameter {name} {text!r}: expected a whole number") from None
    return text


def run(name: str, values: Values = (), output: Path | None = None) -> Path:
    """Execute a notebook; the executed copy's path.

    The copy goes to `output`, else to `<paths.runs()>/notebooks/<name>[-<label of the request>].ipynb`. Raises
    ViewnetError for bad parameters before a kernel starts, for a ViewnetError in the notebook, and where any other
    cell fails.
    """
    import papermill

    source = find(name)
    typed, request = check(source, values)
    stem = f"{source.stem}-{request.label}" if request.label else source.stem
    output = output or paths.runs() / "notebooks" / f"{stem}.ipynb"
    if output.resolve() == source.resolve():
        raise ViewnetError(f"{output}: is the notebook itself: choose another output")
    output.parent.mkdir(parents=True, exist_ok=True)
    # Progress bars are on the kernel's stderr; here they reach the terminal as well as the copy.
    options: dict[str, Any] = {"kernel_name": "python3", "start_timeout": START_TIMEOUT, "stderr_file": sys.stderr}
    try:
        papermill.execute_notebook(str(source), str(output), typed, progress_bar=False, **options)
    except Exception as error:
        _raise_in_one_line(error, output)
    return output


def refresh(name: str) -> Path:
    """Execute a notebook with its own defaults and store the outputs in it, without timings and machine names."""
    import nbformat
    from nbclient import NotebookClient

    source = find(name)
    check(source, [])
    notebook = nbformat.read(source, as_version=4)
    options: dict[str, Any] = {"kernel_name": "python3", "timeout": None, "startup_timeout": START_TIMEOUT}
    try:
        client = NotebookClient(notebook, record_timing=False, **options)
        client.execute(env=dict(os.environ, TQDM_DISABLE="1"))
    except Exception as error:
        _raise_in_one_line(error, source)
    notebook.metadata.pop("language_info", None)
    for cell in notebook.cells:
        if "outputs" in cell:  # progress is on stderr
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    with replacing(source) as temporary:
        nbformat.write(notebook, temporary)
    return source


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


@dataclass(frozen=True)
class Outcome:
    """The executed copy of a notebook, or its error in one line."""

    name: str
    seconds: float
    copy: Path | None
    error: str | None

    def __str__(self) -> str:
        return f"{self.name}: {self.seconds:.0f} s: {f'failed: {self.error}' if self.error else self.copy}"

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self) | {"copy": None if self.copy is None else str(self.copy), "seconds": round(self.seconds, 1)}


def plan(only: Sequence[str] | None = None, profile: str | None = None, seeds: str | None = None) -> dict[str, Values]:
    """The notebooks to run, all or `only` these, in the order of ORDER -> their checked parameters.

    `profile` is given to those that train, `seeds` to those that take several. Raises ViewnetError for an unknown
    notebook and for values that a notebook would refuse, before any is run.
    """
    names = {known(name.removesuffix(".ipynb"), ORDER, "notebook") for name in only or ORDER}
    planned: dict[str, Values] = {}
    for name in sorted(names, key=ORDER.index):
        declared = parameters(path := find(name))
        given = {"profile": profile if DESIGNS[name].variants else None, "seeds": seeds}
        planned[name] = [(key, value) for key, value in given.items() if value is not None and key in declared]
        check(path, planned[name])
    return planned


def run_all(planned: dict[str, Values]) -> Iterator[Outcome]:
    """Run notebooks one after the other; each outcome as soon as it is known. Failures do not stop it."""
    for name, values in planned.items():
        start, copy, error = time.monotonic(), None, None
        try:
            copy = run(name, values)
        except ViewnetError as problem:
            error = str(problem)
        yield Outcome(name, time.monotonic() - start, copy, error)
