"""The image at the head of the README: a drawn car in its box, and its predicted viewpoint.

python docs/example.py [FILE]        (default: docs/example.png)
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from PIL import Image

from viewnet.estimator import ViewpointEstimator

FOLDER = Path(__file__).resolve().parent
BOX = (129, 108, 341, 200)
"""Of the car in docs/car.jpg: left, top, right, bottom, in pixels."""
COLOUR = "#d55e00"


def compass(axes: Axes, azimuth: float) -> None:
    """The camera's azimuth around the object as seen from above; the object's front points down, as in the demo."""
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5))
    circle = np.linspace(0, 2 * np.pi)
    axes.plot(np.cos(circle), np.sin(circle), color="0.6", lw=1)
    body = np.array([(-0.22, 0.35), (0.22, 0.35), (0.22, -0.15), (0, -0.38), (-0.22, -0.15)])
    axes.fill(*body.T, facecolor="0.88", edgecolor="0.2", lw=1)
    for angle, name in ((0, "front"), (90, "left"), (180, "back"), (270, "right")):
        x, y = np.sin(np.radians(angle)), -np.cos(np.radians(angle))
        axes.text(1.22 * x, 1.18 * y, f"{angle}°\n{name}", ha="center", va="center", fontsize=8, color="0.3")
    x, y = np.sin(np.radians(azimuth)), -np.cos(np.radians(azimuth))
    axes.annotate("", (0.45 * x, 0.45 * y), (x, y), arrowprops={"arrowstyle": "-|>", "color": COLOUR, "lw": 2})
    axes.plot(x, y, "o", color=COLOUR, ms=9)


def main(path: Path = FOLDER / "example.png") -> None:
    """Predict the viewpoint of docs/car.jpg, and write the figure."""
    estimator = ViewpointEstimator.from_pretrained("car")
    image = Image.open(FOLDER / "car.jpg").convert("RGB")
    (viewpoint,) = estimator.predict([image], boxes=[BOX])

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), width_ratios=(1.35, 1), layout="constrained")
    left.imshow(image)
    left.axis("off")
    left.add_patch(Rectangle(BOX[:2], BOX[2] - BOX[0], BOX[3] - BOX[1], fill=False, edgecolor=COLOUR, lw=2))
    left.set_title("one image and the object's box", fontsize=10)
    compass(right, viewpoint.azimuth)
    angles = f"azimuth {viewpoint.azimuth:.0f}°, elevation {viewpoint.elevation:.0f}°"
    right.set_title(f"predicted viewpoint: {angles}", fontsize=10)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
