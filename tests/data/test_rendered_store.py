from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers.cad_files import write_box
from helpers.executors import Mortal

from viewnet.config import SYNSETS
from viewnet.data.readers.shapenet import find_models
from viewnet.data.rendered_store import render_views
from viewnet.errors import ViewnetError


def test_rendering_on_an_executor_gives_the_same_bytes(tmp_path):
    root = tmp_path / "shapenet"
    for number in range(40):
        write_box(root, SYNSETS["car"], f"{number:03d}", scale=1 + number / 40)
    models = find_models(root, "car")
    here = render_views(models, tmp_path / "here", views=2, image_size=16, workers=1, progress=False)
    with ThreadPoolExecutor(3) as executor:
        there = render_views(models, tmp_path / "there", views=2, image_size=16, progress=False, executor=executor)
        for name in ("views.npy", "index.parquet", "meta.json", "rejected.csv"):
            assert (here.folder / name).read_bytes() == (there.folder / name).read_bytes()
    with pytest.raises(ViewnetError, match=r"a process that makes views .* died"):
        render_views(models, tmp_path / "dead", views=2, image_size=16, progress=False, executor=Mortal(1))
