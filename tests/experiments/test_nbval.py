"""nbval on the pytest that is installed: it has seen no release for a year, and pytest goes on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output


def checked(folder: Path, stored: str) -> subprocess.CompletedProcess[str]:
    """`pytest --nbval`, warnings as errors, of a notebook that prints 1."""
    printed = new_output("stream", name="stdout", text=f"{stored}\n")
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    notebook = new_notebook(cells=[new_code_cell("print(1)", outputs=[printed], execution_count=1)], metadata=kernel)
    nbformat.write(notebook, folder / "one.ipynb")
    options = ["--nbval", "-W", "error", "-p", "no:cacheprovider", "-c", "/dev/null", "--rootdir", str(folder)]
    command = [sys.executable, "-m", "pytest", *options, str(folder / "one.ipynb")]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder)


@pytest.mark.slow
def test_a_stored_output_that_its_cell_does_not_make_fails(tmp_path):
    right, wrong = checked(tmp_path, stored="1"), checked(tmp_path, stored="2")
    assert right.returncode == 0, right.stdout + right.stderr
    assert wrong.returncode == 1
    assert "one.ipynb::Cell 0" in wrong.stdout
