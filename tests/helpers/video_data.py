"""Synthetic clips: frames of one grey each, as a video or a folder, and data sets of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import av
import numpy as np
from PIL import Image


def write_frames(folder: Path, greys: Mapping[str, int], size: tuple[int, int] = (64, 48)) -> None:
    """Images of one grey each."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, grey in greys.items():
        Image.new("RGB", size, (grey,) * 3).save(folder / name)


def write_video(file: Path, greys: Sequence[int], size: tuple[int, int] = (64, 48), noise: int = 0) -> None:
    """A video of one grey a frame, or of noise about it; every frame is an image of its own."""
    rng = np.random.default_rng(0)
    with av.open(str(file), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.gop_size = 1
        for grey in greys:
            pixels = np.clip(grey + rng.integers(-noise, noise + 1, (size[1], size[0], 3)), 0, 255).astype(np.uint8)
            for packet in stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


def write_freiburg(root: Path, sequences: Sequence[int], frames: int = 3) -> None:
    """The layout of Freiburg static cars, azimuths 10 degrees a frame."""
    for number in sequences:
        write_frames(root / f"car{number:03d}", {f"{k + 1}.png": 20 * k for k in range(frames)})
        lines = [f"car{number:03d}/{k + 1}.jpg\t8 6 40 30\t{10 * k}\n" for k in range(frames)]
        (root / "annotations").mkdir(exist_ok=True)
        (root / f"annotations/{number}_annot.txt").write_text("".join(lines))
