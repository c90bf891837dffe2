"""The image of docs/estimator.md: a view, and the axes of its camera as each program has them.

python docs/camera_axes.py [FILE]        (default: docs/camera_axes.png)
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from viewnet.data.synthetic.stand_in import built_in_mesh
from viewnet.estimator.camera_axes import COLUMNS, MEANINGS
from viewnet.estimator.viewpoints import Viewpoint, Viewpoints
from viewnet.geometry import view_vector
from viewnet.render import render_mesh
from viewnet.render.camera import look_from, project

FILE = Path(__file__).resolve().with_suffix(".png")
AZIMUTH, ELEVATION = 30.0, 20.0
"""The viewpoint whose matrices the page writes down."""
ONLOOKER = np.array([350.0]), np.array([42.0])
"""Azimuth and elevation from which object and camera are seen together."""
AWAY, CENTRE, SHRINK = 1.25, np.array([0.5, 0.4, 0.2]), 0.5
"""The camera's distance, and what the onlooker sees in the middle and at which scale, so that all is in the image."""
COLOURS = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}
SIZE = 800  # pixels


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str, label: str, offset: float) -> None:
    """An arrow between two places in pixels, with a label `offset` points beyond its end."""
    head = {"arrowstyle": "-|>", "color": colour, "lw": 2.2, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 13}
    axes.annotate("", end, start, arrowprops=head)
    along = (end - start) * [1, -1] / np.linalg.norm(end - start)  # y is down in images
    where = {"xytext": offset * along, "textcoords": "offset points", "ha": "center", "va": "center"}
    axes.annotate(label, end, **where, color=colour, fontsize=10, weight="bold")


def view(axes: Axes, viewpoint: Viewpoint) -> None:
    """The object from the viewpoint, with its own axes."""
    (image,) = render_mesh(built_in_mesh("car", 9, 0), np.array([AZIMUTH]), np.array([ELEVATION]), SIZE, 3)
    axes.imshow(image)
    ends = np.diag([0.72, 0.5, 0.38])
    middle, *seen = SIZE * project(np.concatenate([np.zeros((1, 3)), ends]), viewpoint.frame[None])[0]
    for name, end, side, offset in zip("xyz", seen, ("front", "left", "up"), (18, 27, 9), strict=True):
        arrow(axes, middle, end, COLOURS[name], f"{name}: {side}", offset)
    axes.set(xlim=(0, SIZE), ylim=(0.84 * SIZE, 0.08 * SIZE))


def scene(axes: Axes, viewpoint: Viewpoint, frame: str) -> None:
    """Object and camera as an onlooker sees them, with the camera's axes as a program's matrix has them."""
    mesh = built_in_mesh("car", 9, 0)
    (image,) = render_mesh(replace(mesh, vertices=SHRINK * (mesh.vertices - CENTRE)), *ONLOOKER, SIZE, 3)
    axes.imshow(image)

    def places(*points: np.ndarray) -> np.ndarray:
        return SIZE * project(SHRINK * (np.stack(points) - CENTRE), look_from(*ONLOOKER))[0]

    camera = AWAY * viewpoint.vector
    right, up, back = viewpoint.frame.T
    axes.plot(*places(np.zeros(3), camera).T, color="0.5", lw=1, ls=":")
    sides = ((1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1))
    corners = [camera - 0.2 * back + 0.11 * x * right + 0.08 * y * up for x, y in sides]
    for line in (corners, *([camera, corner] for corner in corners)):
        axes.plot(*places(*line).T, color="0.25", lw=1.1)
    rotation = viewpoint.rotation(frame)
    for name, axis in zip("xyz", rotation.T if frame in COLUMNS else rotation, strict=True):
        arrow(axes, *places(camera, camera + 0.42 * axis), COLOURS[name], name, 8)
    directions = MEANINGS[frame].removeprefix("camera ").partition(";")[0]
    of_matrix = "columns" if frame in COLUMNS else "rows"
    axes.set_title(f"{frame}\n{directions}: the {of_matrix} of R", fontsize=9)
    axes.set(xlim=(0.16 * SIZE, 0.84 * SIZE), ylim=(0.82 * SIZE, 0.26 * SIZE))


def main(path: Path = FILE) -> None:
    """Render the view and the four cameras, and write the figure."""
    vector = view_vector(*torch.tensor([AZIMUTH, ELEVATION], dtype=torch.float64)).numpy()
    (viewpoint,) = Viewpoints.of([[vector]], [[0.0]], None, aligned=True)
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.2))
    shown = left.subplots()
    view(shown, viewpoint)
    shown.set_title(
        f"the view from azimuth {AZIMUTH:.0f}°, elevation {ELEVATION:.0f}°\nand the object's axes", fontsize=9
    )
    panels = right.subplots(2, 2)
    for axes, frame in zip(panels.flat, MEANINGS, strict=True):
        scene(axes, viewpoint, frame)
    for axes in (shown, *panels.flat):
        axes.axis("off")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
