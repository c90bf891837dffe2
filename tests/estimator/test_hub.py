from __future__ import annotations

import shutil
import sys
from pathlib import Path

import huggingface_hub
import pytest
from helpers.estimators import same, untrained
from helpers.untrained_models import turned

from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator

load = ViewpointEstimator.from_pretrained


def cached(estimator: ViewpointEstimator, cache: Path, name: str) -> None:
    """A model in the cache of the hub's library."""
    repository = cache / f"models--{name.replace('/', '--')}"
    estimator.save_pretrained(repository / "snapshots" / "c0ffee")
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text("c0ffee")


def test_the_hub_s_models_are_read_from_its_cache(images, tmp_path):
    estimator = untrained(rotation=turned(20))
    cached(estimator, tmp_path, "someone/cars")
    found = load("someone/cars", cache_dir=tmp_path, local_files_only=True)
    assert same(found.predict(images), estimator.predict(images), 0)
    for name, options in (("someone/boats", {}), ("someone/cars", {"revision": "v2"})):
        with pytest.raises(ViewnetError, match=rf"{name}: .* no such model \(") as told:
            load(name, cache_dir=tmp_path, local_files_only=True, **options)
        assert "\n" not in str(told.value)


def test_without_the_hub_s_library_folders_are_all_there_is(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    untrained().save_pretrained(tmp_path)
    load(tmp_path)
    with pytest.raises(ViewnetError, match=r'"viewnet\[hub\]"'):
        load("someone/cars")


def test_models_go_to_the_hub(tmp_path, monkeypatch, images):
    class Api:
        def __init__(self, token=None):
            assert token == "secret"

        def create_repo(self, repo_id, private, exist_ok):
            assert (private, exist_ok) == (True, True)
            return huggingface_hub.RepoUrl(f"https://huggingface.co/{repo_id}")

        def upload_folder(self, repo_id, folder_path, allow_patterns, **_):
            there = tmp_path / "hub" / repo_id
            shutil.copytree(folder_path, there, ignore=lambda _, names: set(names) - set(allow_patterns))
            return f"https://huggingface.co/{repo_id}/commit/1"

    monkeypatch.setattr(huggingface_hub, "HfApi", Api)
    estimator = untrained()
    estimator.save_pretrained(tmp_path / "cars")
    (tmp_path / "cars" / "private.txt").write_text("stays here")
    options = {"push_to_hub": True, "private": True, "token": "secret"}
    address = estimator.save_pretrained(tmp_path / "cars", repo_id="someone/cars", **options)
    assert address == "https://huggingface.co/someone/cars/commit/1"
    assert same(load(tmp_path / "hub" / "someone" / "cars").predict(images), estimator.predict(images), 0)
    assert not (tmp_path / "hub" / "someone" / "cars" / "private.txt").exists()
    with pytest.raises(ViewnetError, match=r"someone/cars: .* takes no model"):
        estimator.save_pretrained(tmp_path / "cars", repo_id="someone/cars", **options)
