"""The content of image grids, and whether it fits."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg


def images(figure) -> list[list[np.ndarray | None]]:
    """The images, row by row; None for an empty cell."""
    result: dict[int, list[np.ndarray | None]] = {}
    for axes in figure.axes:
        line = int(axes.get_label().split()[0])
        result.setdefault(line, []).append(axes.images[0].get_array() if axes.images else None)
    return list(result.values())


def inside(figure) -> bool:
    """Whether all text lies within the figure."""
    renderer, room = FigureCanvasAgg(figure).get_renderer(), figure.bbox
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
    return all(b.x0 >= 0 and b.y0 >= 0 and b.x1 <= room.x1 and b.y1 <= room.y1 for b in boxes)
