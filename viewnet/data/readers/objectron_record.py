"""A record of Objectron: the camera's viewpoint of the annotated object, and the object's box, in each frame.

Objectron's objects have y up, z to the front and x to their left side. In this project x is the front, y the left side
and z up (viewnet.geometry): the same axes in another order,

    AXES = [[0, 0, 1],      ours x (front)  =  theirs z
            [1, 0, 0],      ours y (left)   =  theirs x
            [0, 1, 0]]      ours z (up)     =  theirs y

and `AXES @ place` takes a place in the object's frame from theirs to ours. An object's pose (R, t) takes its own frame
to the world. A camera's `view_matrix` takes the world to the camera, whose x is right and y up as its landscape sensor
lies, and which looks along -z; its `transform` is the inverse of that. The phone was mostly held upright, so the sensor
lies on its side; this rotates the image and not the camera's place, which alone is the viewpoint:

    place = R^T (c - t),    c = the camera's place in the world

Keypoints in the image are fractions of the upright image. The nine keypoints in the camera's frame give the camera's
place again: a frame in which the two disagree is not used.
"""

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, text_format

from viewnet.data.crop import Box
from viewnet.errors import ViewnetError
from viewnet.geometry import azimuth_elevation

AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
LARGEST = 16 * 2**20  # bytes of a record file: ten times a minute's record; in memory it can be 30 times as large
MOST_FRAMES = 100_000  # frames of a record, and objects annotated in all of them together, at most
BEYOND = 0.1  # keypoints may be outside of the image by this share of its side: the box extends beyond the object in it
VISIBLE = 0.5  # the share of an object that has to be visible, where that is annotated
DISAGREE = 5.0  # degrees between the viewpoints of the camera and of the keypoints in its frame, at most

UNIT_BOX = np.array([(0, 0, 0), *((x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5))])
"""Places of the nine keypoints in a box of side 1: its centre, then its corners."""

_schema = Path(__file__).with_name("objectron.textproto").read_text(encoding="utf-8")
# A pool of its own: the published schema, were it loaded too, has the same names in the default one.
_pool = descriptor_pool.DescriptorPool()
_pool.Add(text_format.Parse(_schema, descriptor_pb2.FileDescriptorProto()))
Sequence: Any = message_factory.GetMessageClass(_pool.FindMessageTypeByName("Sequence"))
"""The message of a record file, built here, so that no compiler and no generated code is needed."""

_SLACK = 0.01  # of rotations in single precision, and of what cameras' poses were optimised to


@dataclass(frozen=True)
class View:
    """A frame in which the object can be used."""

    number: int
    azimuth: float  # degrees
    elevation: float
    box: Box  # fractions of the image as it is shown, within it
    size: tuple[int, int] | None  # width and height of that image, pixels, if the camera recorded them
    upright: bool | None  # whether the image is the sensor's rotated by a quarter turn; None where that is unknown


@dataclass(frozen=True)
class Record:
    """The views of a record's main object, which is the largest in the image on average."""

    frames: tuple[int, ...]  # the numbers of all frames in the record
    views: tuple[View, ...]  # those that can be used, by number
    rejected: tuple[tuple[int, str], ...]  # (frame number, reason) of the others
    others: tuple[int, ...]  # ids of the other annotated objects


def read_record(path: Path) -> Record:
    """Read a record file. Raises ViewnetError where nothing of it can be used: unreadable, no frame, no object."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise ViewnetError(f"record cannot be read ({type(error).__name__})") from None
    if len(content) > LARGEST:
        raise ViewnetError(f"record larger than {LARGEST >> 20} MiB")
    try:
        sequence = Sequence.FromString(content)
    except Exception as error:  # Its class depends on the library's version and back end.
        raise ViewnetError(f"record is damaged ({type(error).__name__})") from None
    return interpret(sequence)


def interpret(sequence: Any) -> Record:
    """The views of a `Sequence`. Raises ViewnetError as `read_record` does."""
    count = len(sequence.frame_annotations)
    if not 1 <= count <= MOST_FRAMES:
        raise ViewnetError(f"record of too many frames ({count})" if count else "record without frames")
    if (objects := sum(len(frame.annotations) for frame in sequence.frame_annotations)) > MOST_FRAMES:
        raise ViewnetError(f"record of too many objects ({objects})")
    frames: dict[int, Any] = {}
    views, rejected = [], []
    for frame in sequence.frame_annotations:
        if frame.frame_id < 0 or frames.setdefault(frame.frame_id, frame) is not frame:
            reason = "frame number below 0" if frame.frame_id < 0 else "frame annotated twice"
            rejected.append((int(frame.frame_id), reason))
    main, others = _main_object(frames.values())
    rotation, translation = _object_pose(sequence.objects, main)
    for number, frame in sorted(frames.items()):
        try:
            views.append(_view(frame, main, rotation, translation))
        except ViewnetError as error:
            rejected.append((int(number), str(error)))
    return Record(tuple(sorted(frames)), tuple(views), tuple(sorted(rejected)), others)


def _main_object(frames: Iterable[Any]) -> tuple[int, tuple[int, ...]]:
    """The id of the object that covers most of the images, and those of all others."""
    covered = defaultdict[int, float](float)
    for frame in frames:
        for annotation in frame.annotations:
            if len(annotation.keypoints) != len(UNIT_BOX):
                continue
            points = _in_image(annotation).clip(0, 1)
            area = float(np.prod(points.max(axis=0) - points.min(axis=0)))
            covered[annotation.object_id] += area if math.isfinite(area) else 0.0
    if not covered:
        raise ViewnetError("record without an annotated object")
    main = min(covered, key=lambda name: (-covered[name], name))
    return int(main), tuple(sorted(int(name) for name in covered if name != main))


def _object_pose(objects: Iterable[Any], main: int) -> tuple[np.ndarray, np.ndarray]:
    poses = [(item.rotation, item.translation) for item in objects if item.id == main]
    if len(poses) != 1:
        raise ViewnetError(f"object {'without' if not poses else 'with more than one'} pose")
    rotation, translation = (np.array(values, dtype=np.float64) for values in poses[0])
    if rotation.size != 9 or translation.size != 3 or not np.isfinite(translation).all():
        raise ViewnetError("object's pose is not nine and three finite numbers")
    rotation = rotation.reshape(3, 3)
    if not _is_rotation(rotation):
        raise ViewnetError("object's rotation matrix is invalid")
    return rotation, translation


def _view(frame: Any, main: int, rotation: np.ndarray, translation: np.ndarray) -> View:
    annotation = next((item for item in frame.annotations if item.object_id == main), None)
    if annotation is None:
        raise ViewnetError("object not annotated")
    if (count := len(annotation.keypoints)) != len(UNIT_BOX):
        raise ViewnetError(f"not nine keypoints ({count})")
    points = _in_image(annotation)
    if not np.isfinite(points).all():
        raise ViewnetError("keypoints are not finite")
    to_camera = _world_to_camera(frame.camera)
    place = rotation.T @ (-to_camera[:3, :3].T @ to_camera[:3, 3] - translation)
    in_camera = np.array([(k.point_3d.x, k.point_3d.y, k.point_3d.z) for k in annotation.keypoints], dtype=np.float64)
    if in_camera.any():
        _check(in_camera, place)
    elif (to_camera[:3, :3] @ translation + to_camera[:3, 3])[2] >= 0:
        raise ViewnetError("object behind the camera")
    # Proto 3 does not distinguish zero from a missing value; the keypoints decide then.
    if 0 < annotation.visibility < VISIBLE:
        raise ViewnetError("object mostly hidden or outside of the image")
    low, high = points.min(axis=0), points.max(axis=0)
    if (low < -BEYOND).any() or (high > 1 + BEYOND).any():
        raise ViewnetError("object partly outside of the image")
    x0, y0, x1, y1 = (float(value) for value in np.concatenate([low, high]).clip(0, 1))
    if not np.linalg.norm(place) > 1e-6:
        raise ViewnetError("camera at the object's centre")
    azimuth, elevation = azimuth_elevation(torch.from_numpy(AXES @ place))
    upright = _is_upright(frame.camera, in_camera, points)
    # The image is on its side only where the projection says so.
    short, long = sorted((int(frame.camera.image_resolution_width), int(frame.camera.image_resolution_height)))
    size = None if short < 1 else (long, short) if upright is False else (short, long)
    return View(int(frame.frame_id), azimuth.item(), elevation.item(), (x0, y0, x1, y1), size, upright)


def _in_image(annotation: Any) -> np.ndarray:
    """Keypoints (9, 2) as fractions of the image."""
    return np.array([(keypoint.point_2d.x, keypoint.point_2d.y) for keypoint in annotation.keypoints], dtype=np.float64)


def _world_to_camera(camera: Any) -> np.ndarray:
    """(4, 4): the recorded one, else the inverse of the camera's pose."""
    recorded = len(camera.view_matrix) > 0
    values = np.array(camera.view_matrix if recorded else camera.transform, dtype=np.float64)
    if values.size != 16:
        raise ViewnetError("camera's pose is not sixteen numbers")
    if not np.isfinite(values).all():
        raise ViewnetError("camera's pose is not finite")
    matrix = values.reshape(4, 4)
    if not _is_rotation(matrix[:3, :3]) or not np.allclose(matrix[3], (0, 0, 0, 1), atol=_SLACK):
        raise ViewnetError("camera's pose is not a rigid transform")
    return matrix if recorded else np.linalg.inv(matrix)


def _is_rotation(matrix: np.ndarray) -> bool:
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 2:
        return False
    return bool(np.allclose(matrix @ matrix.T, np.eye(3), atol=_SLACK) and np.linalg.det(matrix) > 0)


def _check(in_camera: np.ndarray, place: np.ndarray) -> None:
    """Raise unless the keypoints (9, 3) in the camera's frame lie before it and give the same place."""
    if not np.isfinite(in_camera).all():
        raise ViewnetError("keypoints are not finite")
    if (in_camera[:, 2] >= 0).any():
        raise ViewnetError("object behind the camera")
    # The box to the camera's frame: edges (as columns) and centre, by least squares.
    edges = in_camera.T @ UNIT_BOX / 2  # the sum of squares of each of the unit box's coordinates is 2
    lengths = np.linalg.norm(edges, axis=0)
    centre = in_camera.mean(axis=0)
    if lengths.min() <= 1e-6 * np.linalg.norm(centre):
        raise ViewnetError("keypoints do not form a box")
    again = -(edges / lengths).T @ centre
    cosine = again @ place / (np.linalg.norm(again) * np.linalg.norm(place) or 1.0)
    if not cosine >= math.cos(math.radians(DISAGREE)):
        raise ViewnetError("camera and keypoints disagree")


def _is_upright(camera: Any, in_camera: np.ndarray, points: np.ndarray) -> bool | None:
    """Whether the image is the sensor's rotated by a quarter turn, by the projection of the keypoints (9, 2)."""
    matrix = np.array(camera.projection_matrix, dtype=np.float64)
    if matrix.size != 16 or not np.isfinite(matrix).all() or not in_camera.any():
        return None
    clip = np.column_stack([in_camera, np.ones(len(in_camera))]) @ matrix.reshape(4, 4).T
    if (np.abs(clip[:, 3]) < 1e-9).any():
        return None
    right, up = (clip[:, :2] / clip[:, 3:]).T
    # When rotated, the sensor's right points down and its up points right.
    shown = {True: np.column_stack([1 + up, 1 + right]) / 2, False: np.column_stack([1 + right, 1 - up]) / 2}
    apart = {rotated: float(np.abs(places - points).mean()) for rotated, places in shown.items()}
    best = min(apart, key=lambda rotated: apart[rotated])
    return best if apart[best] < 0.05 else None
