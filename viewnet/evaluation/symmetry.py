"""Categories whose objects look alike from several sides: viewpoints are right or wrong up to a turn."""

from typing import NamedTuple


class Symmetry(NamedTuple):
    """Of a category's objects, about their vertical."""

    turns: int = 1  # that look alike: 1 the whole one alone, 2 half turns, 0 those by any angle
    alignment: str = ""  # that does not mind it (viewnet.evaluation.alignment)
    note: str = ""  # what is therefore unknown of viewpoints


SYMMETRIES = {
    "bottle": Symmetry(
        0, "any_turn", "Bottles look alike from all sides: azimuth means little, and confidence is of the elevation"
    ),
    "diningtable": Symmetry(
        2, "half_turns", "Tables look alike from opposite sides: azimuth and confidence are up to half a turn"
    ),
}


def symmetry(category: str) -> Symmetry:
    """That of a category; none of those that are not known to be symmetric."""
    return SYMMETRIES.get(category, Symmetry())
