"""Categories whose objects look alike from several sides: viewpoints are right or wrong up to a turn."""

from typing import NamedTuple


class Symmetry(NamedTuple):
    """Of a category's objects, about their vertical."""

    turns: int = 1  # that look alike: 1 the whole one alone, 2 half turns, 0 those by any angle
    note: str = ""  # what is therefore unknown of viewpoints
    alignment: str = ""  # that does not mind it (viewnet.evaluation.alignment)


SYMMETRIES = {
    "bottle": Symmetry(0, "Bottles look alike from all sides: confidence is of the elevation alone", "any_turn"),
    "diningtable": Symmetry(2, "Tables look alike from opposite sides: all is up to half a turn", "half_turns"),
}


def symmetry(category: str) -> Symmetry:
    """That of a category; none of those that are not known to be symmetric."""
    return SYMMETRIES.get(category, Symmetry())
