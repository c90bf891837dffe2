"""A stand-in for Objectron in its layout: built-in CAD models filmed by hand before cluttered backgrounds.

Numbers measured on it are numbers of the stand-in. A video is a smooth arc of 60 to 180 degrees about one object;
height, aim, focal length, light and exposure change, and motion blurs. Its frames are written as images, with a record,
and with two kinds of masks, like those of a supervised (masks/) and of a weakly supervised network (WEAK).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage

from viewnet.config import known
from viewnet.data.readers.objectron import CLASSES, MASKS
from viewnet.data.readers.objectron_record import AXES, UNIT_BOX, Sequence
from viewnet.data.synthetic import scenes
from viewnet.data.synthetic.stand_in import StandIn, as_image, built_in_mesh
from viewnet.errors import ViewnetError
from viewnet.render import render_cameras
from viewnet.render.camera import DISTANCE, FOCAL, look_from
from viewnet.render.mesh import Mesh
from viewnet.runtime.files import write_text

WEAK = "masks_weak"
"""The folder of masks like a weakly supervised network's: blobs without legs that include some surroundings."""
MODEL_SEED = 2000  # added to the seed, so that models differ from those of a training with the same one
SIZE = (180, 240)  # width and height of an image, pixels: three to four, as of a phone held upright
BATCH = 50  # videos in a batch
TEST = 0.2  # the share of videos in the test list

# Axes of the sensor as columns, in the image's frame (right, up, back). It lies on its side: its x points down in the
# image, its y to the right.
_SENSOR = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_NEAR, _FAR = 0.01, 1000.0


Shots = tuple[np.ndarray, np.ndarray, np.ndarray]
"""The cameras of the frames: world_from_camera (F, 3, 3), focal lengths (F,) and principal points (F, 2) in pixels."""


@dataclass(frozen=True)
class ObjectronStandIn(StandIn):
    """`videos` videos of as many models: images of `size` (width, height), masks, records and lists.

    A video depends on (seed, category, its number, frames, size) only.
    """

    FOLDER = "objectron-stand-in"
    VERSION = 2
    category: str = "chair"
    videos: int = 20
    frames: int = 40
    seed: int = 0
    size: tuple[int, int] = SIZE

    def prepare(self, root: Path) -> list[Callable[[], None]]:
        """See StandIn.prepare. ViewnetError for categories that Objectron does not have, and small sizes."""
        known(self.category, CLASSES, "category of Objectron")
        if min(self.size) < 32:
            raise ViewnetError(f"stand-in: size {self.size}: expected 32 or more pixels a side")
        kind = CLASSES[self.category]
        names = [f"{kind}/batch-{number // BATCH + 1}/{number % BATCH}" for number in range(self.videos)]
        test = set(names[:: round(1 / TEST)][: self.videos // 2])
        for split, listed in (("test", test), ("train", set(names) - test)):
            lines = "".join(f"{name}\n" for name in names if name in listed)
            write_text(root / "index" / f"{kind}_annotations_{split}", lines)
        return [partial(_write_video, root, name, number, self) for number, name in enumerate(names)]


def _write_video(root: Path, name: str, number: int, made: ObjectronStandIn) -> None:
    source = [made.seed, list(CLASSES).index(made.category), number]
    rng = np.random.default_rng(source)
    mesh = built_in_mesh(made.category, number, made.seed + MODEL_SEED)
    shots = _shots(rng, made.frames, made.size)
    cameras, *_ = shots
    renderings = render_cameras(mesh, cameras, _lights(rng, cameras), max(made.size), 2, "raycast")
    images, masks = _filmed(rng, shots, renderings, made.size)
    folders = {part: root / part / name for part in ("videos", MASKS, WEAK)}
    for folder in folders.values():
        folder.mkdir(parents=True)
    # Generators of their own, so that masks do not change anything else.
    rngs = [np.random.default_rng([*source, kind]) for kind in (1, 2)]
    for place, (image, mask) in enumerate(zip(images, masks, strict=True)):
        image.save(folders["videos"] / f"{place:06d}.jpg", "JPEG", quality=88)
        _faulty(rngs[0], mask).save(folders[MASKS] / f"{place:06d}.png")
        _weak(rngs[1], mask).save(folders[WEAK] / f"{place:06d}.png")
    record = root / "annotations" / f"{name}.pbdata"
    record.parent.mkdir(parents=True, exist_ok=True)
    record.write_bytes(_record(rng, shots, mesh, made.size).SerializeToString(deterministic=True))


def _shots(rng: np.random.Generator, frames: int, size: tuple[int, int]) -> Shots:
    """Cameras on an arc around the object, never tilted; a wandering aim shifts the principal point."""
    width, height = size
    sweep = rng.uniform(60, 180) * rng.choice([-1, 1])
    time = np.linspace(0, 1, frames)
    jitter = rng.normal(0, 0.3, (2, frames))
    azimuth = rng.uniform(0, 360) + sweep * (time + 0.04 * _drift(rng, frames)) + jitter[0]
    elevation = (rng.uniform(8, 38) + 12 * _drift(rng, frames) + jitter[1]).clip(-5, 75)
    zoom = rng.uniform(0.9, 1.25) * (1 + 0.1 * _drift(rng, frames))
    x = 0.5 + 0.05 * _drift(rng, frames)
    y = 0.5 + 0.06 * _drift(rng, frames)
    return look_from(azimuth % 360, elevation), FOCAL * width * zoom, np.stack([x * width, y * height], axis=1)


def _drift(rng: np.random.Generator, frames: int) -> np.ndarray:
    """A smooth curve (frames,) mostly within -1 and 1, like a wandering hand."""
    time = np.linspace(0, 1, frames)
    waves = [rng.normal() / k * np.sin(2 * np.pi * (0.7 * k * time + rng.random())) for k in (1, 2, 3)]
    return np.clip(np.sum(waves, axis=0) / 1.5, -1.5, 1.5)


def _lights(rng: np.random.Generator, cameras: np.ndarray) -> np.ndarray:
    """Unit directions (frames, 3) to a lamp that wanders a little, for cameras (frames, 3, 3)."""
    lamp = rng.normal(0, 0.6, 3) + np.array([0.0, 0.0, 1.0])
    wander = 0.2 * np.stack([_drift(rng, len(cameras)) for _ in range(3)], axis=1)
    # Some of the light comes from the camera, so that no visible side is dark.
    light = lamp + wander + 0.4 * cameras[:, :, 2]
    return light / np.linalg.norm(light, axis=1, keepdims=True)


def _filmed(
    rng: np.random.Generator, shots: Shots, renderings: np.ndarray, size: tuple[int, int]
) -> tuple[list[Image.Image], list[Image.Image]]:
    """The images and true masks of a video, from renderings (frames, S, S, 4) of its object."""
    width, height = size
    wide, high = round(1.8 * width), round(1.3 * height)
    kind = (scenes.room, scenes.clutter, scenes.facade)[int(rng.integers(3))]
    background = Image.fromarray(kind(rng, wide, high).clip(0, 255).astype(np.uint8))
    background = background.filter(ImageFilter.GaussianBlur(rng.uniform(0, 0.006) * width))
    frames = len(renderings)
    pan = [0.5 + 0.5 * np.clip(_drift(rng, frames), -1, 1) for _ in range(2)]
    gain, tint = np.exp(0.25 * _drift(rng, frames)), np.exp(rng.normal(0, 0.05, 3))
    grain = rng.uniform(0, 0.02)
    images, masks = [], []
    _, focals, centres = shots
    previous = centres[0]
    for place, (focal, centre, rendering) in enumerate(zip(focals, centres, renderings, strict=True)):
        left, upper = pan[0][place] * (wide - width), pan[1][place] * (high - height)
        image = background.resize(size, Image.Resampling.BILINEAR, box=(left, upper, left + width, upper + height))
        # The rendering, scaled and shifted as the shot's camera has it.
        side = focal / FOCAL
        scale = rendering.shape[1] / side
        affine = (scale, 0.0, scale * (side / 2 - centre[0]), 0.0, scale, scale * (side / 2 - centre[1]))
        # Colours times alpha, so that scaling does not mix the black around the object into its edge.
        colour = (rendering[..., :3] * (rendering[..., 3:].astype(np.float64) / 255) + 0.5).astype(np.uint8)
        thing = Image.fromarray(np.dstack([colour, rendering[..., 3]]))
        thing = thing.transform(size, Image.Transform.AFFINE, affine, Image.Resampling.BILINEAR)
        pixels = np.asarray(thing, dtype=np.float64)
        alpha = pixels[..., 3:] / 255
        mixed = pixels[..., :3] + (1 - alpha) * np.asarray(image, dtype=np.float64)
        step = np.subtract(centre, previous) * rng.uniform(0.3, 1.2) + rng.normal(0, 0.4, 2)
        # Frames far apart in time would be blurred too much.
        step *= min(1.0, 0.02 * width / max(np.hypot(*step), 1e-9))
        previous = centre
        blurred = _moved(Image.fromarray(mixed.clip(0, 255).astype(np.uint8)), step)
        exposed = (blurred / 255 * gain[place] * tint).clip(0, 1) + rng.normal(0, grain, blurred.shape)
        images.append(as_image(exposed))
        masks.append(Image.fromarray(((alpha[..., 0] > 0.5) * 255).astype(np.uint8)))
    return images, masks


def _moved(image: Image.Image, step: np.ndarray, copies: int = 5) -> np.ndarray:
    """The mean (height, width, 3) of an image and its copies along a movement of `step` pixels about it."""
    total = np.zeros((image.height, image.width, 3))
    for share in np.linspace(-0.5, 0.5, copies):
        affine = (1.0, 0.0, float(share * step[0]), 0.0, 1.0, float(share * step[1]))
        moved = image.transform(image.size, Image.Transform.AFFINE, affine, Image.Resampling.BILINEAR)
        inside = Image.new("L", image.size, 255).transform(image.size, Image.Transform.AFFINE, affine)
        total += np.asarray(Image.composite(moved, image, inside), dtype=np.float64)
    return total / copies


def _faulty(rng: np.random.Generator, mask: Image.Image) -> Image.Image:
    """A mask like a network's: too small or too large by a pixel or two, rounded, with holes and a wrong spot."""
    if kind := int(rng.integers(3)):
        mask = mask.filter((ImageFilter.MinFilter, ImageFilter.MaxFilter)[kind - 1](3))
    mask = mask.filter(ImageFilter.MedianFilter(3))
    box = mask.getbbox()
    if box is None:
        return mask

    def spot(box: tuple[int, int, int, int], most: float, value: int) -> None:
        x, y = rng.uniform(box[0], box[2]), rng.uniform(box[1], box[3])
        reach = rng.uniform(0.01, most) * min(mask.size)
        ImageDraw.Draw(mask).ellipse((x - reach, y - reach, x + reach, y + reach), value)

    for _ in range(int(rng.integers(0, 4))):
        spot(box, 0.05, 0)
    if rng.random() < 0.2:
        spot((0, 0, *mask.size), 0.03, 255)
    return mask


def _weak(rng: np.random.Generator, mask: Image.Image, cells: int = 12) -> Image.Image:
    """A mask like a weakly supervised network's: its coarse shape, and some of its surroundings."""
    box = mask.getbbox()
    if box is None:
        return mask
    shape = np.asarray(mask) / 255
    # Such networks predict a coarse grid, in which thin parts vanish.
    blur = max(box[2] - box[0], box[3] - box[1]) / cells
    soft = ndimage.gaussian_filter(shape, blur)
    noise = ndimage.gaussian_filter(rng.normal(size=shape.shape), 2 * blur)
    level = rng.uniform(0.3, 0.5) + 0.12 * noise / max(noise.std(), 1e-9)
    return Image.fromarray(((soft > level.clip(0.1, 0.75)) * 255).astype(np.uint8))


def _record(rng: np.random.Generator, shots: Shots, mesh: Mesh, size: tuple[int, int]) -> Any:
    """The record of a video whose object stands somewhere in the world (y up), rotated about the vertical."""
    width, height = size
    turn = rng.uniform(0, 2 * np.pi)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    where = rng.normal(0, 1, 3)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    scale = AXES.T @ (high - low)
    translation = rotation @ AXES.T @ ((low + high) / 2) + where
    corners = (UNIT_BOX * scale) @ rotation.T + translation
    sequence = Sequence()
    thing = sequence.objects.add(id=1)
    thing.rotation.extend(rotation.ravel())
    thing.translation.extend(translation)
    thing.scale.extend(scale)
    for number, (world_from_camera, focal, (x, y)) in enumerate(zip(*shots, strict=True)):
        pose = np.eye(4)
        pose[:3, :3] = rotation @ AXES.T @ world_from_camera @ _SENSOR
        pose[:3, 3] = rotation @ AXES.T @ (DISTANCE * world_from_camera[:, 2]) + where
        to_camera = np.linalg.inv(pose)
        projection = np.zeros((4, 4))  # from the sensor's frame to its clip space
        projection[0, [0, 2]] = 2 * focal / height, 1 - 2 * y / height
        projection[1, [1, 2]] = 2 * focal / width, 1 - 2 * x / width
        projection[2:, 2:] = [-(_FAR + _NEAR) / (_FAR - _NEAR), -2 * _FAR * _NEAR / (_FAR - _NEAR)], [-1, 0]
        frame = sequence.frame_annotations.add(frame_id=number, timestamp=number / 30)
        frame.camera.transform.extend(pose.ravel())
        frame.camera.view_matrix.extend(to_camera.ravel())
        frame.camera.projection_matrix.extend(projection.ravel())
        frame.camera.intrinsics.extend((focal, 0, y, 0, focal, x, 0, 0, 1))
        frame.camera.image_resolution_width, frame.camera.image_resolution_height = height, width
        seen = frame.annotations.add(object_id=1, visibility=1)
        in_camera = corners @ to_camera[:3, :3].T + to_camera[:3, 3]
        clip = np.column_stack([in_camera, np.ones(len(in_camera))]) @ projection.T
        for place, (point, (right, up)) in enumerate(zip(in_camera, clip[:, :2] / clip[:, 3:], strict=True)):
            keypoint = seen.keypoints.add(id=place)
            keypoint.point_3d.x, keypoint.point_3d.y, keypoint.point_3d.z = point
            # In the image, which is the sensor's rotated by a quarter turn.
            keypoint.point_2d.x, keypoint.point_2d.y, keypoint.point_2d.depth = (1 + up) / 2, (1 + right) / 2, -point[2]
    return sequence
