from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from viewnet.estimator.demo import compass_svg
from viewnet.estimator.viewpoints import Viewpoint, Viewpoints
from viewnet.geometry import view_vector

SVG = "{http://www.w3.org/2000/svg}"


def told(angles: list[tuple[float, float]], logits: list[float], aligned: bool = True) -> Viewpoint:
    """The viewpoint of one image, from the azimuth and elevation of each hypothesis."""
    azimuth, elevation = torch.tensor(angles, dtype=torch.float64).T
    return Viewpoints.of(view_vector(azimuth, elevation)[None].numpy(), [logits], None, aligned)[0]


def cameras(svg: str) -> dict[int, tuple[np.ndarray, np.ndarray, float]]:
    """Of each hypothesis its camera's place, the arrow's end and width."""
    found = {}
    for group in ElementTree.fromstring(svg).iter(f"{SVG}g"):
        line = group.find(f"{SVG}line")
        x, y, u, v, width = (float(line.get(name)) for name in ("x1", "y1", "x2", "y2", "stroke-width"))
        found[int(group.get("data-number"))] = (np.array([x, y]), np.array([u, v]), width)
    return found


def letters(svg: str) -> dict[str, np.ndarray]:
    return {
        text.text: np.array([float(text.get("x")), float(text.get("y"))])
        for text in ElementTree.fromstring(svg).iter(f"{SVG}text")
    }


@pytest.mark.parametrize("azimuth, side", [(0, "front"), (90, "left"), (180, "back"), (270, "right")])
def test_the_camera_stands_at_the_side_that_it_sees_and_looks_at_the_object(azimuth, side):
    svg = compass_svg.from_above(told([(azimuth, 10)], [0.0]))
    camera, end, _ = cameras(svg)[1]
    places = letters(svg)
    sides = {name: np.linalg.norm(places[name] - camera) for name in ("front", "left", "back", "right")}
    assert min(sides, key=sides.get) == side
    middle = np.full(2, compass_svg.SIDE / 2)
    assert np.linalg.norm(end - middle) < np.linalg.norm(camera - middle)


@given(st.floats(0, 359.9), st.floats(-89, 89))
def test_angles_can_be_read_off_the_drawings(azimuth, elevation):
    found = told([(azimuth, elevation)], [0.0])
    x, y = cameras(compass_svg.from_above(found))[1][0] - compass_svg.SIDE / 2
    # The front is below, and azimuths are counter-clockwise as seen from above.
    assert abs((math.degrees(math.atan2(x, y)) - azimuth + 180) % 360 - 180) < 0.1
    x, y = cameras(compass_svg.from_the_side(found))[1][0] - compass_svg.CENTRE
    assert math.degrees(math.atan2(-y, x)) == pytest.approx(elevation, abs=0.1)


def test_every_hypothesis_is_numbered_and_as_wide_as_it_is_probable():
    found = told([(10, 0), (100, 30), (200, -20)], [0.0, 2.0, 1.0])
    listed = found.ranked()
    assert [round(one.azimuth) for one in listed] == [100, 200, 10]
    assert [one.number for one in listed] == [1, 2, 3]
    assert [one.chosen for one in listed] == [True, False, False]
    assert sum(one.probability for one in listed) == pytest.approx(1)
    for draw in (compass_svg.from_above, compass_svg.from_the_side):
        widths = [cameras(draw(found))[number][2] for number in (1, 2, 3)]
        assert widths == sorted(widths, reverse=True)
        assert len(set(widths)) == 3


def test_the_chosen_one_is_drawn_last_and_told_apart_without_colours():
    svg = compass_svg.from_above(told([(10, 0), (12, 0)], [0.0, 1.0]))
    groups = list(ElementTree.fromstring(svg).iter(f"{SVG}g"))
    assert [group.get("data-number") for group in groups] == ["2", "1"]
    dashes = [group.find(f"{SVG}line").get("stroke-dasharray") for group in groups]
    assert dashes[0]
    assert dashes[1] is None


def test_equal_hypotheses_begin_with_the_chosen_one():
    found = told([(10, 0), (100, 0)], [0.5, 0.5])
    assert [one.chosen for one in found.ranked()] == [True, False]


def test_without_an_alignment_there_is_neither_front_nor_horizon():
    angles, logits = [(40, 20)], [0.0]
    for draw, word in ((compass_svg.from_above, "front"), (compass_svg.from_the_side, "horizon")):
        assert word in letters(draw(told(angles, logits)))
        assert word not in letters(draw(told(angles, logits, aligned=False)))
    assert "sees" not in compass_svg.from_above(told(angles, logits, aligned=False))


@pytest.mark.parametrize("draw", [compass_svg.from_above, compass_svg.from_the_side])
def test_no_word_is_cut_off_at_the_sides(draw):
    root = ElementTree.fromstring(draw(told([(40, 20)], [0.0])))
    left, _, width, _ = map(float, root.get("viewBox").split())
    for text in root.iter(f"{SVG}text"):
        x, long = float(text.get("x")), 0.7 * float(text.get("font-size")) * len(text.text)  # of wide letters
        start = x - {"start": 0, "middle": long / 2, "end": long}[text.get("text-anchor")]
        assert left <= start and start + long <= left + width, text.text


def test_drawings_say_what_they_show():
    root = ElementTree.fromstring(compass_svg.from_above(told([(92, 20)], [0.0])))
    assert root.get("role") == "img"
    assert "azimuth 92 degrees" in root.get("aria-label")
    assert "the left, from a little above" in root.get("aria-label")


@pytest.mark.parametrize(
    ("azimuth", "elevation", "said"),
    [
        (0, 0, "the front, level"),
        (359, -30, "the front, from a little below"),
        (337, 80, "the front right, from above"),
        (135, -80, "the back left, from below"),
        (180, 14.9, "the back, level"),
        (270, 15, "the right, from a little above"),
    ],
)
def test_viewpoints_in_words(azimuth, elevation, said):
    assert compass_svg.words(azimuth, elevation) == said


def test_the_table_has_a_bar_as_long_as_each_probability():
    found = told([(10, 0), (100, 30), (200, -20)], [0.0, 2.0, 1.0])
    root = ElementTree.fromstring(compass_svg.table(found))
    rows = list(root.find("tbody"))
    for row, one in zip(rows, found.ranked(), strict=True):
        cells = [cell.text for cell in row][1:4]
        assert cells == [f"{one.azimuth:.1f}°", f"{one.elevation:.1f}°", f"{100 * one.probability:.1f} %"]
        assert f"width:{100 * one.probability:.1f}%" in row.find(".//span").get("style")
    assert "answer" in rows[0][0].text
    assert not any("answer" in row[0].text for row in rows[1:])
