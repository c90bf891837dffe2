"""The stand-in for Freiburg cars: its layout, read like the data set, and reproducible."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from viewnet.data.masks import from_files
from viewnet.data.readers import freiburg
from viewnet.data.synthetic.freiburg_standin import SEQUENCES, FreiburgStandIn
from viewnet.errors import ViewnetError


def test_sequences_are_read_as_the_data_set_is(tmp_path, monkeypatch):
    monkeypatch.setattr("viewnet.data.synthetic.freiburg_standin.NO_MASK", 0.0)
    FreiburgStandIn((46, 3), 6).write(tmp_path / "root", workers=1, progress=False)
    clips, rejected = freiburg.read(tmp_path / "root")
    assert not rejected and [(clip.id, clip.split) for clip in clips] == [("car003", "train"), ("car046", "val")]
    for clip in clips:
        azimuths = np.array([frame.azimuth for frame in clip.frames])
        turns = np.diff(azimuths) % 360
        assert (abs(turns - 60) <= 1).all() or (abs(turns - 300) <= 1).all()
        follow = from_files().follow(clip)
        for frame, file in zip(clip.frames, sorted(clip.source.iterdir()), strict=True):
            with Image.open(file) as image:
                mask = follow(frame.number, file.stem, image) > 127
            x0, y0, x1, y1 = (round(value) for value in frame.box)
            filled = mask[y0:y1, x0:x1]
            # A car fills much of its box, its mask is nearly right, and no part of it is elsewhere.
            assert 0.45 < filled.mean() < 0.98 and x1 - x0 > 40
            outside = mask.sum() - filled.sum()
            assert outside < 0.08 * mask.sum()

    (tmp_path / "again").mkdir()
    FreiburgStandIn((3,), 6).write(tmp_path / "again", workers=1, progress=False)
    for file in sorted((tmp_path / "again").rglob("*.*")):
        assert file.read_bytes() == (tmp_path / "root" / file.relative_to(tmp_path / "again")).read_bytes()


def test_what_it_refuses_and_what_decides_it(tmp_path):
    one, same, other = (FreiburgStandIn(*made).describe() for made in (((2, 1), 5), ((1, 2), 5), ((1, 2), 5, 1)))
    assert len(SEQUENCES) == 48 and one == same != other
    with pytest.raises(ViewnetError, match="frames 0"):
        FreiburgStandIn((1,), 0).write(tmp_path)
    with pytest.raises(ViewnetError, match="sequences"):
        FreiburgStandIn(()).write(tmp_path)
    (tmp_path / "file").write_text("?")
    with pytest.raises(ViewnetError, match="is not empty"):
        FreiburgStandIn((1,), 2).write(tmp_path)
