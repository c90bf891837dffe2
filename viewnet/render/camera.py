"""The rendering camera: pinhole, square images, looking at the origin from a fixed distance without tilt.

The values are those of the renders the paper's baselines are trained on (a 60 mm lens on a 32 mm sensor, 2 units
away), where an object's bounding box has a diagonal of 1.
"""

import numpy as np

DISTANCE = 2.0
FOCAL = 1.875  # in image widths: a field of view of 29.9 degrees
RADIUS = 0.5  # no vertex of a normalised mesh is farther from the origin, so every one lies in front of the camera


def look_from(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """world_from_camera (..., 3, 3), columns right, up, back, of viewpoints (...) in degrees (geometry.look_at)."""
    # torch is slow to import, and processes that only render are handed cameras.
    import torch

    from viewnet.geometry import look_at, view_vector

    angles = [torch.as_tensor(np.asarray(x, dtype=np.float64)) for x in (azimuth, elevation)]
    return look_at(view_vector(*angles)).numpy()


def project(points: np.ndarray, world_from_camera: np.ndarray) -> np.ndarray:
    """Image positions (V, P, 2) of world points (P, 3): x right, y down, (0, 0) and (1, 1) the image's corners."""
    camera = np.einsum("pi,vij->vpj", points, world_from_camera)  # (V, P, 3)
    depth = DISTANCE - camera[..., 2:]
    return 0.5 + np.array([FOCAL, -FOCAL]) * camera[..., :2] / depth
