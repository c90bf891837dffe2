from __future__ import annotations

import av
import numpy as np
import pytest
from helpers.boxes import box_store
from helpers.estimators import turntable_of
from helpers.untrained_models import untrained_renderer
from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.estimator import turntable


@pytest.fixture(scope="module")
def renderer(tmp_path_factory):
    return untrained_renderer(box_store(tmp_path_factory.mktemp("turn") / "views", {"val": 2, "test": 2}))


def marked(frame: np.ndarray) -> bool:
    """Whether the frame is highlighted."""
    return bool((frame[1, -10] == turntable.MARK).all())


def test_it_starts_at_the_marked_prediction_and_goes_round(renderer):
    frames = turntable_of(renderer, 1, steps=4, hold=2, size=96)
    assert len(frames) == 6
    assert [marked(frame) for frame in frames] == [True] * 3 + [False] * 3
    assert all(side % 2 == 0 for side in frames[0].shape[:2])
    assert np.array_equal(frames[0], frames[2])
    right = [frame[4:100, 104:200] for frame in frames]
    assert not np.array_equal(right[2], right[4])
    # The image stays.
    assert np.array_equal(frames[0][4:100, 4:100], frames[5][4:100, 4:100])


def test_gif_has_every_frame(renderer, tmp_path):
    frames = turntable_of(renderer, 0, steps=5, hold=0, size=64)
    with Image.open(turntable.save(frames, tmp_path / "a" / "turn.gif", rate=10)) as back:
        assert back.n_frames == 5
        assert back.info["duration"] == 100
        assert np.abs(np.asarray(back.convert("RGB")).astype(int) - frames[0]).mean() < 5


def test_mp4_has_every_frame(renderer, tmp_path):
    frames = turntable_of(renderer, 0, steps=5, hold=0, size=64)
    with av.open(str(turntable.save(frames, tmp_path / "turn.mp4", rate=10))) as back:
        found = [frame.to_ndarray(format="rgb24") for frame in back.decode(video=0)]
    assert len(found) == 5
    assert np.abs(found[2].astype(int) - frames[2]).mean() < 10


def test_errors_of_writing(renderer, tmp_path):
    frames = [np.zeros((8, 8, 3), np.uint8)]
    with pytest.raises(ViewnetError, match=r"\.gif or \.mp4"):
        turntable.save(frames, tmp_path / "turn.webm")
    with pytest.raises(ViewnetError, match="no frames"):
        turntable.save([], tmp_path / "turn.gif")
    with pytest.raises(ViewnetError, match="size 65"):
        turntable_of(renderer, 0, size=65)
