"""The manifest of outputs: files that exist, commands that do, and no table of the paper left out."""

from __future__ import annotations

import re
import shlex

import pytest
import yaml
from helpers.documents import ROOT

from viewnet import cli

MANIFEST = yaml.safe_load((ROOT / "codecheck.yml").read_text())["manifest"]


@pytest.mark.parametrize("entry", MANIFEST, ids=lambda entry: entry["file"])
def test_every_output_is_there_and_its_command_is_taken(entry):
    assert (ROOT / entry["file"]).is_file()
    (command,) = re.findall(r"viewnet [^()]*[^() ]", entry["comment"])
    cli.parser().parse_args(shlex.split(command)[1:])


def test_every_table_at_the_profile_of_the_documents_is_listed():
    tables = {f"paper_tables/{path.name}" for path in (ROOT / "paper_tables").glob("*.tex")}
    assert tables <= {entry["file"] for entry in MANIFEST}
