"""benchmarks/finding.py: the old store is found, and files are read only where they are to be."""

from __future__ import annotations

import hashlib
import importlib.util
from pathlib import Path

from viewnet.data import contents

spec = importlib.util.spec_from_file_location("finding", Path(__file__).parents[2] / "benchmarks" / "finding.py")
finding = importlib.util.module_from_spec(spec)
spec.loader.exec_module(finding)


def test_both_rows_find_the_store_and_one_reads_files(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(contents, "SETTLED", 0)
    real, read = hashlib.file_digest, []
    monkeypatch.setattr(hashlib, "file_digest", lambda file, kind: read.append(file.name) or real(file, kind))
    table = finding.measure(tmp_path, 10, 2)
    assert list(table.index) == ["every file read", "nothing changed"]
    assert (table > 0).all(axis=None)
    assert len(read) == 20 * (1 + 2), "two files a model: once for the store, and in each turn of one row"
