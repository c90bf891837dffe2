"""The project's folders, and the environment variables that move them."""

from __future__ import annotations

from pathlib import Path

import pytest

from viewnet import paths
from viewnet.errors import ViewnetError


@pytest.mark.parametrize("name", ["root", "data", "runs", "tables"])
def test_a_variable_moves_its_folder_and_an_empty_one_moves_nothing(name, monkeypatch, tmp_path):
    variable = f"VIEWNET_{name.upper()}"
    monkeypatch.delenv(variable, raising=False)
    usual = getattr(paths, name)()
    monkeypatch.setenv(variable, "")
    assert getattr(paths, name)() == usual != Path()
    monkeypatch.setenv(variable, str(tmp_path))
    assert getattr(paths, name)() == tmp_path


def test_a_path_is_named_from_home_or_refused():
    assert paths.named("~/runs", "start") == Path.home() / "runs"
    for name in ("a" * 300, "a\0", "~nobody-of-that-name/runs"):
        with pytest.raises(ViewnetError, match=r"start '.*: not the name of a file or folder"):
            paths.named(name, "start")
