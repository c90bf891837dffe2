"""What configurations need: what is kept and what would be made, and how long that takes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from helpers.fake_steps import STEPS

from viewnet import paths
from viewnet.config import RunConfig, VideoConfig
from viewnet.data.build import view_store
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.recipes import make_config
from viewnet.runs.needs import needs, views
from viewnet.runs.run_store import ensure, untrained
from viewnet.runtime.files import read_json, write_json


@pytest.fixture(autouse=True)
def no_tables(folders, monkeypatch):
    monkeypatch.setenv("VIEWNET_TABLES", str(folders / "tables"))


def config(seed: int = 0, category: str = "car", **settings) -> RunConfig:
    sizes = {"models": 30, "views": 2, "image_size": 16}
    return make_config("viewnet", category, "smoke", seed=seed, **{**sizes, **settings})


def real_views(config, **how) -> ViewStore:
    return view_store(config, 1, progress=False)


STEPS_ON_VIEWS = replace(STEPS, views=real_views, open=ViewStore.open)


def test_what_is_made_is_kept_and_tells_how_long_the_others_take():
    configs = [config(), config(1), config(0, "chair"), config(epochs=9), untrained("random", config())]
    before = needs(configs)
    assert [row["kept"] for row in (*before.stores.values(), *before.runs.values())] == [False] * 7
    assert [row["seconds"] for row in before.runs.values()] == [None] * 4 + [0]
    (run,) = ensure(configs[:1], 1, progress=False, steps=STEPS_ON_VIEWS)
    result = read_json(run.folder / "result.json")
    write_json(run.folder / "result.json", result | {"training": result["training"] | {"seconds": 1800.0}})
    found = needs(configs)
    assert [row["kept"] for row in found.stores.values()] == [True, False]
    assert [row["kept"] for row in found.runs.values()] == [True, False, False, False, False]
    assert found.runs[configs[0]]["folder"] == str(run.folder)
    # Of other epochs nothing is known, and nothing is to be trained for what is drawn at random.
    assert [row["seconds"] for row in found.runs.values()] == [1800, 1800, 1800, None, 0]
    lines = list(found.lines())
    assert lines[0] == "views: 1 of 2 kept, about 0.1 MB to make"
    assert lines[2] == "runs: 1 of 5 kept, about 0.5 MB to make, about 1 core-hours, and 1 of unknown length"
    assert list(needs(configs[:1]).lines()) == [
        "views: 1 of 1 kept, nothing to make",
        "runs: 1 of 1 kept, nothing to make",
    ]


def test_the_planned_store_is_the_one_that_is_made():
    for backgrounds in (None, "drawn"):
        asked = config(backgrounds=backgrounds, models=40)
        (row,) = views([asked]).stores.values()
        store = real_views(asked.data)
        assert row["folder"] == str(store.folder)
        assert row["bytes"] == store.images.size
        (run,) = ensure([asked], 1, progress=False, steps=STEPS_ON_VIEWS)
        assert needs([asked]).runs[asked]["folder"] == str(run.folder)


def test_videos_are_not_known_before_their_stand_in_is_made():
    video = VideoConfig("car", kind="freiburg", sequences=(1, 2), frames=4, size=32, split_rule="all")
    asked = config(video=video, select_by="reconstruction")
    (before,) = views([asked]).stores.values()
    assert (before["folder"], before["bytes"], before["kept"]) == (None, None, False)
    assert not paths.data().exists()
    store = real_views(asked.data)
    (after,) = views([asked]).stores.values()
    assert (after["folder"], after["kept"]) == (str(store.folder), True)


def test_what_later_runs_need_is_not_known_yet():
    found = needs([config()], later=[config(1)])
    assert [row["folder"] for row in found.runs.values()] == [None, None]


def test_a_setting_that_is_wrong_is_refused():
    with pytest.raises(ViewnetError, match="volume_size 33: expected a power of two"):
        needs([config(volume_size=33)])
