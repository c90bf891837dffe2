"""Which category and seed each task of docs/train.slurm trains, with a stand-in for srun."""

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "train.slurm"


def called(folder: Path, categories: str, task: int) -> subprocess.CompletedProcess[str]:
    srun = folder / "srun"
    srun.write_text('#!/bin/sh\necho "$@"\n')
    srun.chmod(0o755)
    settings = {"CATEGORIES": categories, "SLURM_ARRAY_TASK_ID": str(task), "SLURM_CPUS_PER_TASK": "2"}
    environment = {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", **settings}
    return subprocess.run(["bash", str(SCRIPT), "--profile", "small"], env=environment, capture_output=True, text=True)


@pytest.mark.parametrize("between", [" ", "\n", " \n\t"])
def test_a_task_is_a_category_and_a_seed(tmp_path, between):
    found = called(tmp_path, f"car{between}chair", 3)
    assert found.stdout == "--cpus-per-task=2 viewnet train chair --seed 1 --workers 1 --profile small\n"


def test_no_categories_are_named(tmp_path):
    found = called(tmp_path, " \n", 0)
    assert (found.returncode, found.stdout) == (2, "") and "CATEGORIES is blank" in found.stderr
