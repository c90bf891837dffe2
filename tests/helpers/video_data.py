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
    shape = (size[1], size[0], 3)
    encode(file, [np.clip(grey + rng.integers(-noise, noise + 1, shape), 0, 255) for grey in greys])


def encode(file: Path, frames: Sequence[np.ndarray], codec: str = "mpeg4", pixels: str = "yuv420p") -> None:
    """A video of frames (H, W, 3) of 0 to 255, every one an image of its own."""
    with av.open(str(file), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.pix_fmt, stream.gop_size = pixels, 1
        stream.height, stream.width = frames[0].shape[:2]
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame.astype(np.uint8), format="rgb24")))
        container.mux(stream.encode())


def box_masks(count: int, size: tuple[int, int] = (64, 48)) -> list[np.ndarray]:
    """White boxes (H, W, 3) on black, one pixel further every frame, from the 10th column and the 8th row on."""
    masks = [np.zeros((size[1], size[0], 3), np.uint8) for _ in range(count)]
    for number, mask in enumerate(masks):
        mask[8:40, 10 + number : 50 + number] = 255
    return masks


def write_uco3d(root: Path, sequences: Sequence[str], frames: int = 4, masks: int | None = None) -> None:
    """The layout of uCO3D: videos of <super>/<category>/<sequence>, and of as many masks or `masks`."""
    for number, name in enumerate(sequences):
        (root / name / "gaussian_splats").mkdir(parents=True)
        write_video(root / name / "rgb_video.mp4", [20 * (number + k) % 256 for k in range(frames)])
        (root / name / "depth_maps.h5").write_bytes(b"?")
        encode(root / name / "mask_video.mkv", box_masks(frames if masks is None else masks), "libx264", "gray")
    (root / "metadata.sqlite").write_bytes(b"?")
    (root / "set_lists").mkdir()


def write_freiburg(root: Path, sequences: Sequence[int], frames: int = 3) -> None:
    """The layout of Freiburg static cars, azimuths 10 degrees a frame."""
    for number in sequences:
        write_frames(root / f"car{number:03d}", {f"{k + 1}.png": 20 * k for k in range(frames)})
        lines = [f"car{number:03d}/{k + 1}.jpg\t8 6 40 30\t{10 * k}\n" for k in range(frames)]
        (root / "annotations").mkdir(exist_ok=True)
        (root / f"annotations/{number}_annot.txt").write_text("".join(lines))
