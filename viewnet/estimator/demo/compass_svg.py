"""A viewpoint drawn for people as SVG and HTML: from above, from the side, in words, and every hypothesis with a bar.

From above the object's front points down, to the reader, as on a turntable's dial: azimuth 0 is below and 90, the left
side, on the right. Hypotheses are told apart by number, width and dashes as well as by colour, which are of Okabe and
Ito's palette; lines and letters are of the page's own colour, so they suit light pages and dark ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from html import escape

from viewnet.estimator.viewpoints import Hypothesis, Viewpoint

CHOSEN, OTHER = "#d55e00", "#0072b2"
SIDE = 260
"""Of a drawing, in its own units."""
RING = 84
"""The radius on which the camera stands, from above."""
ARC, CENTRE = 104, (82.0, SIDE / 2)
"""And from the side, about the object."""
BODY = 'fill="currentColor" fill-opacity="0.14" stroke="currentColor" stroke-linejoin="round"'
"""How the object itself is drawn."""
SECTORS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
LEVELS = ((-60, "from below"), (-15, "from a little below"), (15, "level"), (60, "from a little above"))
"""Up to which elevation it is called what; beyond them it is from above."""


def words(azimuth: float, elevation: float) -> str:
    """What an annotated viewpoint shows, as people say it.

    >>> words(100, 20)
    'the left, from a little above'
    """
    side = SECTORS[round(azimuth / 45) % 8]
    height = next((name for limit, name in LEVELS if elevation < limit), "from above")
    return f"the {side}, {height}"


def from_above(found: Viewpoint) -> str:
    """SVG: the object seen from above, and from where each hypothesis has it looked at."""
    said = f"Seen from above: the camera stands at azimuth {found.azimuth:.0f} degrees"
    if found.aligned:
        said += f", and sees {words(found.azimuth, found.elevation)}"
    return _svg(said, "".join([*_ring(found.aligned), *_cameras(found, _above)]))


def from_the_side(found: Viewpoint) -> str:
    """SVG: the horizon seen from the side, and how high each hypothesis has the camera."""
    said = f"Seen from the side: the camera stands at elevation {found.elevation:.0f} degrees"
    return _svg(said, "".join([*_horizon(found.aligned), *_cameras(found, _beside)]))


def table(found: Viewpoint) -> str:
    """HTML: every hypothesis with its angles and its probability, as a number and as a bar."""
    rows = []
    for one in found.ranked():
        share = f"{100 * one.probability:.1f} %"
        colour = CHOSEN if one.chosen else OTHER
        bar = f'<span class="bar" style="width:{100 * one.probability:.1f}%;background:{colour}"></span>'
        told = " (the answer)" if one.chosen else ""
        rows.append(
            f'<tr><th scope="row">{one.number}{told}</th><td>{one.azimuth:.1f}°</td><td>{one.elevation:.1f}°</td>'
            f'<td>{share}</td><td class="bars" aria-hidden="true">{bar}</td></tr>'
        )
    head = "".join(f'<th scope="col">{name}</th>' for name in ("hypothesis", "azimuth", "elevation", "probability"))
    return f'<table class="hypotheses"><thead><tr>{head}<td></td></tr></thead><tbody>{"".join(rows)}</tbody></table>'


Point = tuple[float, float]


def _above(one: Hypothesis) -> tuple[Point, Point]:
    """Where a camera stands, and the unit step from there to the object."""
    angle = math.radians(one.azimuth)
    x, y = math.sin(angle), math.cos(angle)
    return (SIDE / 2 + RING * x, SIDE / 2 + RING * y), (-x, -y)


def _beside(one: Hypothesis) -> tuple[Point, Point]:
    angle = math.radians(one.elevation)
    x, y = math.cos(angle), -math.sin(angle)
    return (CENTRE[0] + ARC * x, CENTRE[1] + ARC * y), (-x, -y)


def _ring(aligned: bool) -> Iterator[str]:
    middle = SIDE / 2
    yield f'<circle cx="{middle}" cy="{middle}" r="{RING}" fill="none" stroke="currentColor" opacity="0.45"/>'
    names = ("front", "left", "back", "right") if aligned else ("", "", "", "")
    for quarter, name in enumerate(names):
        x, y = math.sin(quarter * math.pi / 2), math.cos(quarter * math.pi / 2)
        inner, outer = RING - 4, RING + 4
        yield _line((middle + inner * x, middle + inner * y), (middle + outer * x, middle + outer * y), 1.0)
        anchor = "middle" if abs(x) < 0.5 else "start" if x > 0 else "end"
        place = (middle + (RING + 18) * x, middle + (RING + 26) * y)
        yield _text((place[0], place[1] - (3 if name else -4)), f"{90 * quarter}°", anchor)
        if name:
            yield _text((place[0], place[1] + 11), name, anchor, bold=True)
    if aligned:
        # A body whose nose is where the front is.
        body = f"M {middle - 20} {middle - 30} h 40 v 44 l -20 20 l -20 -20 z"
        yield f'<path d="{body}" {BODY}/>'
    else:
        yield f'<circle cx="{middle}" cy="{middle}" r="26" {BODY}/>'


def _horizon(aligned: bool) -> Iterator[str]:
    x, y = CENTRE
    yield (
        f'<path d="M {x} {y - ARC} A {ARC} {ARC} 0 0 1 {x} {y + ARC}" fill="none" stroke="currentColor" '
        'opacity="0.45"/>'
    )
    yield _line((4, y), (SIDE - 44, y), 0.45, dashed=True)
    for degrees in (-90, -45, 0, 45, 90):
        c, s = math.cos(math.radians(degrees)), -math.sin(math.radians(degrees))
        yield _line((x + (ARC - 4) * c, y + (ARC - 4) * s), (x + (ARC + 4) * c, y + (ARC + 4) * s), 1.0)
        yield _text((x + (ARC + 16) * c + (0 if c > 0.1 else -16), y + (ARC + 14) * s + 4), f"{degrees}°", "start")
    yield f'<rect x="{x - 22}" y="{y - 16}" width="44" height="32" rx="7" {BODY}/>'
    yield _text((4, y - 6), "horizon" if aligned else "0°", "start")


def _cameras(found: Viewpoint, place: Callable[[Hypothesis], tuple[Point, Point]]) -> Iterator[str]:
    """Arrows from the cameras towards the object, the most probable on top."""
    for one in reversed(found.ranked()):
        (x, y), (dx, dy) = place(one)
        colour, width = (CHOSEN, 4.0) if one.chosen else (OTHER, 1.2 + 3 * one.probability)
        dashes = "" if one.chosen else ' stroke-dasharray="5 3"'
        end, tip = (x + 38 * dx, y + 38 * dy), (x + 48 * dx, y + 48 * dy)
        yield (
            f'<g class="hypothesis" data-number="{one.number}"><title>{one.number}: azimuth {one.azimuth:.1f}°, '
            f"elevation {one.elevation:.1f}°, {100 * one.probability:.1f} %</title>"
            f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" stroke="{colour}" '
            f'stroke-width="{width:.1f}"{dashes}/>'
            f'<path d="M {tip[0]:.1f} {tip[1]:.1f} L {end[0] - 6 * dy:.1f} {end[1] + 6 * dx:.1f} '
            f'L {end[0] + 6 * dy:.1f} {end[1] - 6 * dx:.1f} z" fill="{colour}"/>'
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{11 if one.chosen else 9}" fill="{colour}" stroke="#fff" '
            'stroke-width="1.5"/>'
            f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle" fill="#fff" font-size="12" '
            f'font-weight="bold">{one.number}</text></g>'
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


def _svg(said: str, inside: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIDE} {SIDE}" role="img" aria-label="{escape(said)}" '
        f'font-family="sans-serif">{inside}</svg>'
    )
