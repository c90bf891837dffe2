"""A stand-in for Freiburg static cars in its layout: built-in CAD cars, filmed once around, before synthetic scenes.

Numbers measured on it are numbers of the stand-in.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage

from viewnet.data.crop import bounds
from viewnet.data.readers.freiburg import ANNOTATIONS, AZIMUTH, CATEGORY, MASKS
from viewnet.data.synthetic import scenes
from viewnet.data.synthetic.stand_in import StandIn, add_shadow, as_image, built_in_mesh
from viewnet.errors import ViewnetError
from viewnet.render import render_cameras
from viewnet.render.camera import look_from
from viewnet.runtime.files import write_text

SEQUENCES = tuple(n for n in range(1, 53) if n not in (6, 20, 31, 36))
"""48 of 52, so that numbers have gaps as in the data set."""
MODEL_SEED = 2000  # added to the seed, so that models differ from those of a training and of the stand-in for PASCAL3D+
SIZE = (240, 135)  # width and height of a frame, pixels: a quarter of the data set's
OBJECT = 160  # pixels along a side of the rendering that a car is pasted from
NO_MASK = 0.02  # the share of frames without a mask


@dataclass(frozen=True)
class FreiburgStandIn(StandIn):
    """Sequences of these numbers, each a car of its own once around, from a low height that is not annotated.

    There are one light, a moving reflection, exposure that drifts, a camera that shakes and blurs, a background that
    moves along. Masks are imperfect, and some are missing. A sequence depends on (seed, its number, frames) only.
    """

    FOLDER = "freiburg-stand-in"
    VERSION = 1
    sequences: Sequence[int] = SEQUENCES
    frames: int = 120
    seed: int = 0

    def describe(self) -> dict[str, Any]:
        """See StandIn.describe."""
        return super().describe() | {"sequences": sorted(set(self.sequences))}

    def prepare(self, root: Path) -> list[Callable[[], None]]:
        """See StandIn.prepare. ViewnetError for numbers of sequences out of range."""
        numbers = sorted(set(self.sequences))
        if not numbers or numbers[0] < 1 or numbers[-1] > 999:
            raise ViewnetError(f"stand-in: sequences {numbers}: expected numbers from 1 to 999")
        return [partial(_write_sequence, root, number, self.frames, self.seed) for number in numbers]


def _write_sequence(root: Path, number: int, count: int, seed: int) -> None:
    rng = np.random.default_rng([seed, number, count])
    name = f"car{number:03d}"
    sense = rng.choice([-1.0, 1.0])
    azimuths = (rng.uniform(0, 360) + sense * 360 * np.arange(count) / count) % 360
    elevations = rng.uniform(2, 12) + np.cumsum(rng.normal(0, 0.3, count)).clip(-3, 3)
    cameras = look_from(azimuths, elevations)  # (frames, 3, 3)
    sun = np.array([*rng.normal(0, 1, 2), rng.uniform(0.8, 2)])
    # The sun stands still; the shade is lit by the sky, from the camera's side.
    lights = sun / np.linalg.norm(sun) + 0.9 * cameras[:, :, 2]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    mesh = built_in_mesh(CATEGORY, number, seed + MODEL_SEED)
    renderings = render_cameras(mesh, cameras, lights, OBJECT, 2, "raycast")
    panorama = _panorama(rng)
    scale = rng.uniform(0.85, 1.15) * SIZE[1] / OBJECT * 1.25
    shake = ndimage.gaussian_filter1d(rng.normal(0, 1, (count, 2)), 2, axis=0, mode="wrap") * [9, 4]
    exposure = np.exp(0.25 * _drift(rng, count))
    gloss = rng.uniform(0.2, 0.7)
    lines = []
    for k in range(count):
        glossy = _with_reflection(renderings[k], gloss, azimuths[k] - np.rad2deg(np.arctan2(sun[1], sun[0])))
        image, alpha = _frame(glossy, panorama, azimuths[k] / 360, scale, shake[k], rng)
        theirs = round(AZIMUTH[0] * (azimuths[k] - AZIMUTH[1]) % 360) % 360
        lines.append(f"{name}/{k + 1:04d}.png\t{' '.join(f'{edge:.0f}' for edge in bounds(alpha))}\t{theirs}\n")
        pixels = np.asarray(image, dtype=np.float64) / 255 * exposure[k]
        _save(as_image(pixels + rng.normal(0, 0.015, pixels.shape)), root / name / f"{k + 1:04d}.png")
        mask = _imperfect(alpha, rng)
        if rng.random() >= NO_MASK:
            _save(mask, root / MASKS / name / f"{k + 1:04d}.png")
    write_text(root / ANNOTATIONS / f"{number}_annot.txt", "".join(lines))


def _save(image: Image.Image, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    image.save(file, compress_level=1)


def _panorama(rng: np.random.Generator) -> np.ndarray:
    """The surroundings of the camera, (H, 4 W, 3), whose ends fit each other."""
    half = np.concatenate([scenes.sample(rng, *SIZE), scenes.sample(rng, *SIZE)], axis=1)
    # Scenes are blended over a sixth of a frame.
    seam, middle = SIZE[0] // 6, SIZE[0]
    share = np.linspace(0, 1, seam)[None, :, None]
    mixed = half[:, middle - seam : middle] * (1 - share) + half[:, middle : middle + seam] * share
    half = np.concatenate([half[:, : middle - seam], mixed.astype(np.uint8), half[:, middle + seam :]], axis=1)
    return np.concatenate([half, half[:, ::-1]], axis=1)


def _drift(rng: np.random.Generator, count: int) -> np.ndarray:
    """Smooth periodic noise (count,) of standard deviation about 1."""
    angles = 2 * np.pi * np.arange(count) / count
    waves = [rng.normal(0, 0.7) * np.cos(n * angles + rng.uniform(0, 2 * np.pi)) for n in (1, 2, 3)]
    return np.sum(waves, axis=0) / 1.2


def _with_reflection(rendering: np.ndarray, strength: float, turn: float) -> np.ndarray:
    """A rendering (S, S, 4) with the sky's reflection: a soft spot that moves over the car with the camera."""
    size = len(rendering)
    rows, columns = np.mgrid[:size, :size] / size
    ys = np.nonzero(rendering[..., 3].any(axis=1))[0] / size
    top, high = ys.min(initial=1), np.ptp(ys) if len(ys) else 1
    across = 0.5 - 0.4 * np.sin(np.deg2rad(turn))
    spot = np.exp(-(((columns - across) / 0.12) ** 2) - ((rows - top - 0.4 * high) / (0.35 * high + 1e-6)) ** 2)
    share = strength * (0.3 + 0.7 * max(0.0, np.cos(np.deg2rad(turn)))) * spot[..., None]
    colours = rendering[..., :3] + share * (255 - rendering[..., :3])
    return np.dstack([colours.astype(np.uint8), rendering[..., 3]])


def _frame(
    rendering: np.ndarray, panorama: np.ndarray, turn: float, scale: float, shake: np.ndarray, rng: np.random.Generator
) -> tuple[Image.Image, np.ndarray]:
    """A car composited over its surroundings, and its true alpha (H, W)."""
    (width, height), side = SIZE, round(OBJECT * scale)
    thing = Image.fromarray(rendering).resize((side, side), Image.Resampling.HAMMING)
    start = round(turn * panorama.shape[1])
    image = Image.fromarray(panorama[:, np.arange(start, start + width) % panorama.shape[1]])
    cover = Image.new("RGBA", SIZE)
    cover.paste(thing, (round((width - side) / 2 + shake[0]), round((height - side) / 2 + shake[1])))
    if box := cover.getchannel("A").getbbox():
        x0, _, x1, y1 = box
        add_shadow(image, (x0, y1 - 14, x1, y1 + 5), 170, 3)
    image.paste(cover, (0, 0), cover)
    # The camera moves while the shutter is open.
    length = int(rng.integers(1, 4))
    moved = ndimage.uniform_filter1d(np.asarray(image, dtype=np.float64), length, axis=1, mode="nearest")
    return Image.fromarray(moved.astype(np.uint8)), np.asarray(cover.getchannel("A"))


def _imperfect(alpha: np.ndarray, rng: np.random.Generator) -> Image.Image:
    """A mask like a segmentation network's: its outline is off by some pixels, in and out."""
    noise = ndimage.gaussian_filter(rng.normal(size=alpha.shape), 4)
    soft = ndimage.gaussian_filter(alpha / 255.0, 2.0)
    edge = 4 * soft * (1 - soft)
    return Image.fromarray(((soft + 0.25 * edge * noise / noise.std() > 0.5) * 255).astype(np.uint8))
