"""Viewpoints: every conversion between angles, view vectors and camera frames.

World (object) frame: right-handed, z up, +x is the object's front, +y its left side. A viewpoint says where the camera
is as seen from the object. Azimuth runs counter-clockwise from +x: 0 shows the front and 90 the left side (the object
then faces left in the image), as in PASCAL3D+; elevation is the height above the horizon. Angles are degrees.

    view vector   v = (cos e cos a, cos e sin a, sin e), from the object to the camera
    camera frame  R, columns (right, up, back) in world coordinates, with back = v

so `R @ p` takes camera coordinates to world coordinates. The paper writes [v, w, u'] with w = v x u for the same frame
(section 3.1): another column order and the opposite sign of `right`.

>>> v = view_vector(torch.tensor(90.0), torch.tensor(0.0))
>>> [round(x, 6) + 0.0 for x in v.tolist()]
[0.0, 1.0, 0.0]
>>> [[round(x, 6) + 0.0 for x in row] for row in look_at(torch.tensor([0.0, 1.0, 0.0])).tolist()]
[[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
"""

import torch
from torch import Tensor

UP = (0.0, 0.0, 1.0)


def view_vector(azimuth: Tensor, elevation: Tensor) -> Tensor:
    """Unit vectors (..., 3) from object to camera for azimuth and elevation (...) in degrees.

    >>> view_vector(torch.tensor(60.0), torch.tensor(30.0))
    tensor([0.4330, 0.7500, 0.5000])
    """
    a, e = torch.deg2rad(azimuth), torch.deg2rad(elevation)  # radians only inside this module
    return torch.stack([e.cos() * a.cos(), e.cos() * a.sin(), e.sin()], dim=-1)  # (..., 3)


def azimuth_elevation(v: Tensor) -> tuple[Tensor, Tensor]:
    """Azimuth in [0, 360) and elevation in [-90, 90], degrees, of vectors (..., 3) of any positive length.

    >>> azimuth_elevation(torch.tensor([0.0, -2.0, 0.0]))
    (tensor(270.), tensor(0.))
    """
    azimuth = torch.rad2deg(torch.atan2(v[..., 1], v[..., 0])) % 360.0  # (...), from atan2's (-180, 180]
    # A tiny negative angle rounds up to 360 itself under the modulo.
    azimuth = torch.where(azimuth >= 360.0, torch.zeros_like(azimuth), azimuth)
    elevation = torch.rad2deg(torch.atan2(v[..., 2], torch.linalg.vector_norm(v[..., :2], dim=-1)))
    return azimuth, elevation


def look_at(v: Tensor, up: Tensor | None = None) -> Tensor:
    """Camera frames (..., 3, 3) of view vectors (..., 3): the orthogonalisation of section 3.1.

    `up` (..., 3) is the direction that points up in the image; the world's z without it. A learned `up` describes
    in-plane rotation too (the paper's general case). Where `v` and `up` are parallel the frame is undefined in the
    mathematics; here `right` is then the world's y, so that the result is always a rotation and gradients are finite.

    >>> right, up, back = look_at(torch.tensor([1.0, 0.0, 0.0])).unbind(-1)
    >>> right, up  # from the front the object's left side, +y, is on the right
    (tensor([0., 1., 0.]), tensor([0., 0., 1.]))
    """
    back = torch.nn.functional.normalize(v, dim=-1, eps=1e-12)  # the camera looks along -back
    y = back.new_tensor([0.0, 1.0, 0.0]).expand_as(back)  # (..., 3)
    right = y - (y * back).sum(-1, keepdim=True) * back  # orthogonal to `back`: a Gram-Schmidt step
    world = back.new_tensor(UP).expand_as(back)  # (..., 3)
    for direction in (world,) if up is None else (world, up.expand_as(back)):  # the last one that serves
        across = torch.linalg.cross(direction, back)  # u x v: minus the paper's w
        parallel = torch.linalg.vector_norm(across.detach(), dim=-1, keepdim=True) < 1e-6  # (..., 1); no gradient
        right = torch.where(parallel, right, across)
    right = torch.nn.functional.normalize(right, dim=-1, eps=1e-12)
    return torch.stack([right, torch.linalg.cross(back, right), back], dim=-1)  # (..., 3, 3)


def rotation_angle(a: Tensor, b: Tensor, turns: int = 1) -> Tensor:
    """Geodesic distance (...) in degrees, [0, 180], between rotations (..., 3, 3): the angle of a^T b.

    The least of those after so many turns about z, the whole one among them; after turns by any angle for `turns` 0.

    Computed as the atan2 of (twice) its sine and its cosine: exact at 0 and 180 degrees, where the usual
    arccos((trace - 1) / 2) loses half of its digits.

    >>> level = torch.zeros(2)
    >>> a, b = look_at(view_vector(torch.tensor([10.0, 350.0]), level))
    >>> round(rotation_angle(a, b).item(), 3)
    20.0
    """
    if turns != 1:
        a = _turned_towards(a, b, turns)
    relative = a.transpose(-1, -2) @ b  # (..., 3, 3)
    trace = relative.diagonal(dim1=-2, dim2=-1).sum(-1)  # (...), 1 + 2 cos of the angle
    axis = torch.stack(  # (..., 3), 2 sin of the angle along the rotation's axis
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        dim=-1,
    )
    return torch.rad2deg(torch.atan2(torch.linalg.vector_norm(axis, dim=-1), trace - 1.0))


def _turned_towards(a: Tensor, b: Tensor, turns: int) -> Tensor:
    """Rotations a (..., 3, 3) turned about z as `rotation_angle` may, to where they are nearest to b (..., 3, 3).

    The trace of R_z(t) a b^T is a cosine of t, plus a constant: nearer to its peak is always better.
    """
    product = b @ a.transpose(-1, -2)  # (..., 3, 3)
    peak = torch.atan2(product[..., 1, 0] - product[..., 0, 1], product[..., 0, 0] + product[..., 1, 1])  # (...)
    angle = (peak * turns / (2 * torch.pi)).round() * 2 * torch.pi / turns if turns else peak
    cos, sin, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    turn = torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], dim=-1)  # (..., 9)
    return turn.unflatten(-1, (3, 3)) @ a  # (..., 3, 3)


def vector_angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle (...) in degrees between vectors (..., 3) of any positive length.

    >>> round(vector_angle(torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.0, 3.0, 0.0])).item(), 3)
    90.0
    """
    a, b = torch.nn.functional.normalize(a, dim=-1), torch.nn.functional.normalize(b, dim=-1)
    return 2 * torch.rad2deg(  # |a - b| = 2 sin(x / 2), |a + b| = 2 cos(x / 2)
        torch.atan2(torch.linalg.vector_norm(a - b, dim=-1), torch.linalg.vector_norm(a + b, dim=-1))
    )
