"""Videos of one object each: which frames there are, and what is known of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from viewnet.data.crop import Box


@dataclass(frozen=True)
class Frame:
    """One image of a clip. What nobody annotated is NaN or None."""

    number: int  # from 0, in the order of time
    azimuth: float = math.nan  # degrees in [0, 360), as in viewnet.geometry
    elevation: float = math.nan  # degrees
    box: Box | None = None  # pixels from the image's left upper corner: x0, y0, x1, y1


@dataclass(frozen=True)
class Clip:
    """A video of one object."""

    id: str
    category: str
    split: str  # train, val or test
    source: Path  # a video file, or a folder of images whose names sort in the order of time
    frames: tuple[Frame, ...]  # those that may be used; an empty tuple stands for all, with nothing known of them
    masks: Path | None = None  # a folder of PNG masks named like the images (or %06d.png by frame number)
