"""Rotations between an object and a camera as OpenCV, OpenGL, PyTorch3D and Blender write them.

The object's axes are those of viewnet.geometry: x its front, y its left side, z up. Quaternions are (w, x, y, z) with
w >= 0. Euler angles are Blender's XYZ in degrees: R = Rz Ry Rx with ry from -90 to 90, and rz = 0 where ry is either of
these (gimbal lock). Both are those of R as it stands, PyTorch3D's too.
"""

import warnings

import numpy as np
from numpy.typing import NDArray

from viewnet.config import known

MEANINGS = {
    "opencv": "camera x right, y down, z forward; x_camera = R x_object + (0, 0, d)",
    "opengl": "camera x right, y up, z back; x_camera = R x_object - (0, 0, d)",
    "pytorch3d": "camera x left, y up, z forward; row vectors, x_camera = x_object R + (0, 0, d)",
    "blender": "camera x right, y up, z back; R is the camera's in the world, x_object = R x_camera + d v",
}
"""Frame -> what its R is, for a camera that looks at the object's centre from a distance d along the view vector v."""
SIGNS = {"opencv": (1, -1, -1), "opengl": (1, 1, 1), "pytorch3d": (-1, 1, -1), "blender": (1, 1, 1)}
"""Frame -> whether the camera's x, y and z point right, up and back (1), or left, down and forward (-1)."""
COLUMNS = ("pytorch3d", "blender")
"""Frames in which the camera's axes are the matrix's columns; in the others they are its rows."""
FORMS = {
    "matrix": tuple(f"r{row}{column}" for row in range(3) for column in range(3)),
    "quaternion": ("qw", "qx", "qy", "qz"),
    "euler": ("rx", "ry", "rz"),
}
"""How a rotation is written -> the names of its numbers."""


def rotation(camera: NDArray[np.float64], frame: str, form: str) -> NDArray[np.float64]:
    """Camera frames (..., 3, 3), columns right, up and back, as a frame of SIGNS has them, in a form of FORMS.

    matrix (..., 3, 3), quaternion (..., 4), euler (..., 3) in degrees. Raises ViewnetError for another frame or form.
    """
    known(frame, SIGNS, "frame of a rotation")
    known(form, FORMS, "form of a rotation")
    axes = camera * SIGNS[frame] + 0.0  # no negative zeros
    matrix = axes if frame in COLUMNS else axes.swapaxes(-1, -2)
    if form == "matrix":
        return matrix
    from scipy.spatial.transform import Rotation  # slow to import

    turned = Rotation.from_matrix(matrix.reshape(-1, 3, 3))
    if form == "quaternion":
        return turned.as_quat(canonical=True, scalar_first=True).reshape(*matrix.shape[:-2], 4)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # level cameras before and behind an object are there
        return turned.as_euler("xyz", degrees=True).reshape(*matrix.shape[:-2], 3)
