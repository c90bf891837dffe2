"""The example for SLURM, run as it stands by a SLURM cluster of this machine alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import local_slurm
from helpers.local_slurm import slurm, until

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "train.slurm"
INSTALLED = local_slurm.CONTROLLER and local_slurm.NODE

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not INSTALLED, reason="needs SLURM: apt-get install slurm-wlm")]


@pytest.fixture
def environment(tmp_path):
    """SLURM's, with folders of the test's own and this environment's `viewnet`."""
    with local_slurm.cluster(tmp_path / "slurm") as found:
        own = {"VIEWNET_RUNS": str(tmp_path / "runs"), "VIEWNET_DATA": str(tmp_path / "data")}
        yield found | own | {"PATH": os.pathsep.join([str(Path(sys.executable).parent), found["PATH"]])}


def submitted(environment: dict[str, str], folder: Path, *arguments: str) -> str:
    """Submit the example in `folder`: its job's number."""
    return slurm(["sbatch", "--parsable", *arguments], environment, cwd=str(folder)).strip()


def ended(environment: dict[str, str]) -> bool:
    return not slurm(["squeue", "--noheader"], environment).strip()


def kept(environment: dict[str, str]) -> list[dict]:
    listed = subprocess.run(["viewnet", "runs", "--json"], env=environment, capture_output=True, text=True, check=True)
    return json.loads(listed.stdout)


def test_an_array_of_jobs_trains_every_category_and_seed(environment, tmp_path):
    chosen = environment | {"CATEGORIES": "car chair"}
    small = ["--cpus-per-task=1", "--array=0,3", str(SCRIPT), "--profile", "smoke"]
    job = submitted(chosen, tmp_path, *small)
    until(lambda: ended(environment), "the jobs ended")
    logs = [(tmp_path / f"viewnet-{job}_{task}.log").read_text() for task in (0, 3)]
    found = {(run["category"], run["seed"]) for run in kept(environment)}
    assert found == {("car", 0), ("chair", 1)}, logs


def test_a_job_that_is_taken_off_its_node_goes_on_from_its_last_validation(environment, tmp_path):
    long = [str(SCRIPT), "--profile", "smoke", "-s", "epochs=60"]
    job = submitted(environment | {"CATEGORIES": "car"}, tmp_path, "--cpus-per-task=1", *long)

    def log() -> list[str]:
        files = list((tmp_path / "runs").glob("viewnet/*/log.csv"))
        return files[0].read_text().splitlines() if files else []

    until(lambda: len(log()) > 3, "the run has validated")
    slurm(["scontrol", "requeue", job], environment)
    before = log()[:3]
    until(lambda: ended(environment), "the job ended")
    (run,) = (json.loads(file.read_text()) for file in (tmp_path / "runs").glob("viewnet/*/result.json"))
    assert run["training"]["resumed"] is True, (tmp_path / f"viewnet-{job}_4294967294.log").read_text()
    assert log()[:3] == before
