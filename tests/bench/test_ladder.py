"""benchmarks/ladder.py: from the paper's recipe to ours, one step after another."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from viewnet.config import settings
from viewnet.recipes import make_config

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "ladder.py"


def at(values, place):
    for step in place:
        values = values[step]
    return values


def different(one, other):
    one, other = one.to_dict(), other.to_dict()
    return {name for name, place in settings() if at(one, place) != at(other, place)}


def test_each_rung_adds_what_it_names_and_the_last_is_our_recipe():
    spec = importlib.util.spec_from_file_location("ladder", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    configs = module.configurations("car", 14, 1)
    rungs = [config for _, config in configs.items()]
    for added, below, rung in zip(list(module.RUNGS.values())[1:], rungs, rungs[1:], strict=False):
        assert different(below, rung) == set(added)
    paper, ours = (make_config(profile="tiny", recipe=recipe) for recipe in ("paper", "matting"))
    assert different(paper, rungs[0]) == {"epochs", "validate_every"}
    cycles = {"cycle_weight", "cycle_head"}  # of another variant
    size = {"batch_size", "targets_per_object", "patience", "validate_every"}
    assert different(rungs[-1], ours) == size | cycles
