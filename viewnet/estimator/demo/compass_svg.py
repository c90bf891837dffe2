"""A viewpoint as SVG and HTML: compasses from above and from the side, and a table of the hypotheses.

From above the object's front points down, as on a turntable's dial: azimuth 0 is below and 90, the left side, on the
right. Hypotheses differ by number, width and dashes as well as by colour (Okabe and Ito's palette); lines and letters
have the page's own colour, for light pages and dark ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from html import escape

from viewnet.estimator.viewpoints import Hypothesis, Viewpoint

CHOSEN, OTHER = "#d55e00", "#0072b2"
SIDE = 260
"""Width and height of a compass, in its own units."""
RING = 84
"""Radius of the camera's circle, from above."""
ARC, CENTRE = 104, (82.0, SIDE / 2)
"""Radius of the camera's arc from the side, and the object's place in it."""
BODY = 'fill="currentColor" fill-opacity="0.14" stroke="currentColor" stroke-linejoin="round"'
"""Style of the object."""
SECTORS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
LEVELS = ((-60, "from below"), (-15, "from a little below"), (15, "level"), (60, "from a little above"))
"""Elevations below which each name holds; beyond the last it is "from above"."""
Point = tuple[float, float]
"""x and y in a compass's units."""


def words(azimuth: float, elevation: float) -> str:
    """What an annotated viewpoint shows, in words.

    >>> words(100, 20)
    'the left, from a little above'
    """
    side = SECTORS[round(azimuth / 45) % 8]
    height = next((name for limit, name in LEVELS if elevation < limit), "from above")
    return f"the {side}, {height}"


def from_above(viewpoint: Viewpoint) -> str:
    """SVG of the object from above, with the camera of each hypothesis."""
    title = f"Seen from above: the camera stands at azimuth {viewpoint.azimuth:.0f} degrees"
    if viewpoint.aligned:
        title += f", and sees {words(viewpoint.azimuth, viewpoint.elevation)}"
    return _svg(title, "".join([*_ring(viewpoint.aligned), *_cameras(viewpoint, _above)]))


def from_the_side(viewpoint: Viewpoint) -> str:
    """SVG of the horizon from the side, with the height of each hypothesis's camera."""
    title = f"Seen from the side: the camera stands at elevation {viewpoint.elevation:.0f} degrees"
    return _svg(title, "".join([*_horizon(viewpoint.aligned), *_cameras(viewpoint, _beside)]))


def table(viewpoint: Viewpoint) -> str:
    """HTML of every hypothesis with its angles and its probability, as a number and as a bar."""
    rows = []
    for each in viewpoint.ranked():
        share = 100 * each.probability
        colour = CHOSEN if each.chosen else OTHER
        bar = f'<span class="bar" style="width:{share:.1f}%;background:{colour}"></span>'
        chosen = " (the answer)" if each.chosen else ""
        rows.append(
            f'<tr><th scope="row">{each.number}{chosen}</th><td>{each.azimuth:.1f}°</td><td>{each.elevation:.1f}°</td>'
            f'<td>{share:.1f} %</td><td class="bars" aria-hidden="true">{bar}</td></tr>'
        )
    head = "".join(f'<th scope="col">{name}</th>' for name in ("hypothesis", "azimuth", "elevation", "probability"))
    return f'<table class="hypotheses"><thead><tr>{head}<td></td></tr></thead><tbody>{"".join(rows)}</tbody></table>'


def _polar(centre: Point, radius: float, degrees: float) -> Point:
    """The point at a radius and an angle, counter-clockwise from the right."""
    angle = math.radians(degrees)
    return centre[0] + radius * math.cos(angle), centre[1] - radius * math.sin(angle)


def _above(hypothesis: Hypothesis) -> tuple[Point, Point]:
    """A camera's place, and the unit step from there to the object."""
    degrees = hypothesis.azimuth - 90
    return _polar((SIDE / 2, SIDE / 2), RING, degrees), _polar((0, 0), -1, degrees)


def _beside(hypothesis: Hypothesis) -> tuple[Point, Point]:
    return _polar(CENTRE, ARC, hypothesis.elevation), _polar((0, 0), -1, hypothesis.elevation)


def _ring(aligned: bool) -> Iterator[str]:
    middle = SIDE / 2
    yield f'<circle cx="{middle}" cy="{middle}" r="{RING}" fill="none" stroke="currentColor" opacity="0.45"/>'
    for quarter, name in enumerate(("front", "left", "back", "right") if aligned else ("", "", "", "")):
        x, y = _polar((0, 0), 1, 90 * quarter - 90)
        inner, outer = (_polar((middle, middle), radius, 90 * quarter - 90) for radius in (RING - 4, RING + 4))
        yield _line(inner, outer, 1.0)
        anchor = "middle" if abs(x) < 0.5 else "start" if x > 0 else "end"
        place = (middle + (RING + 18) * x, middle + (RING + 26) * y)
        yield _text((place[0], place[1] - (3 if name else -4)), f"{90 * quarter}°", anchor)
        if name:
            yield _text((place[0], place[1] + 11), name, anchor, bold=True)
    if aligned:
        # A body with a nose at the front.
        body = f"M {middle - 20} {middle - 30} h 40 v 44 l -20 20 l -20 -20 z"
        yield f'<path d="{body}" {BODY}/>'
    else:
        yield f'<circle cx="{middle}" cy="{middle}" r="26" {BODY}/>'


def _horizon(aligned: bool) -> Iterator[str]:
    x, y = CENTRE
    arc = f"M {x} {y - ARC} A {ARC} {ARC} 0 0 1 {x} {y + ARC}"
    yield f'<path d="{arc}" fill="none" stroke="currentColor" opacity="0.45"/>'
    yield _line((4, y), (SIDE - 44, y), 0.45, dashed=True)
    for degrees in (-90, -45, 0, 45, 90):
        yield _line(_polar(CENTRE, ARC - 4, degrees), _polar(CENTRE, ARC + 4, degrees), 1.0)
        left = _polar(CENTRE, ARC + 16, degrees)[0] - (16 if abs(degrees) == 90 else 0)
        yield _text((left, _polar(CENTRE, ARC + 14, degrees)[1] + 4), f"{degrees}°", "start")
    yield f'<rect x="{x - 22}" y="{y - 16}" width="44" height="32" rx="7" {BODY}/>'
    yield _text((4, y - 6), "horizon" if aligned else "0°", "start")


def _cameras(viewpoint: Viewpoint, place: Callable[[Hypothesis], tuple[Point, Point]]) -> Iterator[str]:
    """Arrows from the cameras towards the object, the most probable on top."""
    for each in reversed(viewpoint.ranked()):
        (x, y), (dx, dy) = place(each)
        colour, width = (CHOSEN, 4.0) if each.chosen else (OTHER, 1.2 + 3 * each.probability)
        dashes = "" if each.chosen else ' stroke-dasharray="5 3"'
        end, tip = (x + 38 * dx, y + 38 * dy), (x + 48 * dx, y + 48 * dy)
        yield (
            f'<g class="hypothesis" data-number="{each.number}"><title>{each.number}: azimuth {each.azimuth:.1f}°, '
            f"elevation {each.elevation:.1f}°, {100 * each.probability:.1f} %</title>"
            f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" stroke="{colour}" '
            f'stroke-width="{width:.1f}"{dashes}/>'
            f'<path d="M {tip[0]:.1f} {tip[1]:.1f} L {end[0] - 6 * dy:.1f} {end[1] + 6 * dx:.1f} '
            f'L {end[0] + 6 * dy:.1f} {end[1] - 6 * dx:.1f} z" fill="{colour}"/>'
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{11 if each.chosen else 9}" fill="{colour}" stroke="#fff" '
            'stroke-width="1.5"/>'
            f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle" fill="#fff" font-size="12" '
            f'font-weight="bold">{each.number}</text></g>'
        )


def _line(start: Point, end: Point, opacity: float, dashed: bool = False) -> str:
    dashes = ' stroke-dasharray="4 4"' if dashed else ""
    return (
        f'<line x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" stroke="currentColor" '
        f'opacity="{opacity}"{dashes}/>'
    )


def _text(place: Point, text: str, anchor: str, bold: bool = False) -> str:
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{place[0]:.1f}" y="{place[1]:.1f}" text-anchor="{anchor}" fill="currentColor" '
        f'font-size="13"{weight}>{escape(text)}</text>'
    )


def _svg(title: str, content: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIDE} {SIDE}" role="img" aria-label="{escape(title)}" '
        f'font-family="sans-serif">{content}</svg>'
    )
