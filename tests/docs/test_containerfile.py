"""What can be said of the Containerfile where no image can be built."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
CONTAINERFILE = (ROOT / "Containerfile").read_text()


def test_an_image_for_cpus_has_every_library_of_the_lock_file_at_its_version(tmp_path):
    (taken,) = re.findall(r"sed -n .*(?= > )", CONTAINERFILE)
    printed = subprocess.run(["sh", "-c", taken], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    constraints = [Requirement(line) for line in printed.splitlines()]
    locked = re.findall(r"^([a-z0-9][\w.-]*)==", (ROOT / "environment.lock").read_text(), flags=re.MULTILINE)
    assert [each.name for each in constraints] == [name for name in locked if not name.startswith("nvidia-")]
    here = [each.name for each in constraints if each.marker is None or each.marker.evaluate()]
    assert len(here) == len(set(here))  # one version each: others are for other versions of Python
    assert {"torch", "torchvision", "numba", "distributed"} <= {*here}


def test_extras_of_an_image_for_cpus_exist():
    (extras,) = re.findall(r'"\.\[(.*)\]"', CONTAINERFILE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {*extras.split(",")} <= {*project["optional-dependencies"]}


def test_a_machine_without_a_builder_is_told_what_is_needed():
    told = subprocess.run(["make", "image", "BUILDER="], cwd=ROOT, capture_output=True, text=True)
    assert told.returncode == 2
    assert told.stderr.startswith("make: no docker, podman or buildah here: install one of them\n")
