"""A viewpoint as SVG and HTML: compasses from above and from the side, and a table of the hypotheses.

From above the object's front points down, as on a turntable's dial. Hypotheses differ by number, width and dashes as
well as by colour (Okabe and Ito's palette); lines and letters have the page's own colour, light or dark.
"""

import math

from viewnet.estimator.templating import rendered
from viewnet.estimator.viewpoints import Viewpoint

COLOURS = {"chosen": "#d55e00", "other": "#0072b2"}
SIDE = 260  # width and height of a compass, in its own units
RING = 84  # radius of the camera's circle, from above
ARC, CENTRE = 104, (82.0, SIDE / 2)  # radius of the camera's arc from the side, and the object's place in it
SECTORS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
# Elevations below which each name holds; beyond the last it is "from above".
LEVELS = ((-60, "from below"), (-15, "from a little below"), (15, "level"), (60, "from a little above"))


def words(azimuth: float, elevation: float) -> str:
    """What an annotated viewpoint shows, in words.

    >>> words(100, 20)
    'the left, from a little above'
    """
    height = next((name for limit, name in LEVELS if elevation < limit), "from above")
    return f"the {SECTORS[round(azimuth / 45) % 8]}, {height}"


def from_above(viewpoint: Viewpoint) -> str:
    """SVG of the object from above, with the camera of each hypothesis."""
    title = f"Seen from above: the camera stands at azimuth {viewpoint.azimuth:.0f} degrees"
    title += f", and sees {words(viewpoint.azimuth, viewpoint.elevation)}" if viewpoint.aligned else ""
    return _compass(viewpoint, title, above=True)


def from_the_side(viewpoint: Viewpoint) -> str:
    """SVG of the horizon from the side, with the height of each hypothesis's camera."""
    title = f"Seen from the side: the camera stands at elevation {viewpoint.elevation:.0f} degrees"
    return _compass(viewpoint, title, above=False)


def table(viewpoint: Viewpoint) -> str:
    """HTML of every hypothesis with its angles and its probability, as a number and as a bar."""
    return rendered("hypotheses.html", ranked=viewpoint.ranked(), **COLOURS)


def _compass(viewpoint: Viewpoint, title: str, above: bool) -> str:
    centre, radius = ((SIDE / 2, SIDE / 2), RING) if above else (CENTRE, ARC)
    arrows = []
    for each in reversed(viewpoint.ranked()):  # the most probable on top
        degrees = each.azimuth - 90 if above else each.elevation
        # A camera's place, and the unit step from there to the object.
        arrows.append((each, _polar(centre, radius, degrees), _polar((0, 0), -1, degrees)))
    return rendered("compass.svg", title=title, above=above, aligned=viewpoint.aligned, arrows=arrows, **COLOURS)


def _polar(centre: tuple[float, float], radius: float, degrees: float) -> tuple[float, float]:
    """The point at a radius and an angle, counter-clockwise from the right."""
    angle = math.radians(degrees)
    return centre[0] + radius * math.cos(angle), centre[1] - radius * math.sin(angle)
