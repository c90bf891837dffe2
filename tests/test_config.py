from __future__ import annotations

import dataclasses
import json
import re

import pytest
import torch

from viewnet import config as settings_of
from viewnet.config import CATEGORIES, LIMITS, SYNSETS, RunConfig, VideoConfig, settings
from viewnet.errors import ViewnetError
from viewnet.model.viewnet import ViewNet
from viewnet.peers import registry
from viewnet.recipes import ABLATIONS, FILMED, PEERS, PROFILES, RECIPES, VARIANTS, make_config

GROUPS = [each for name, each in vars(settings_of).items() if re.fullmatch("[A-Z].*Config", name)]
NUMBER = re.compile(r"\b(int|float)\b")
EVERY = [(v, p, r) for v in VARIANTS for p in PROFILES for r in RECIPES]


@pytest.mark.parametrize(("variant", "profile", "recipe"), EVERY)
def test_every_configuration_survives_json(variant, profile, recipe):
    config = make_config(variant, "chair", profile, recipe, seed=3)
    text = json.dumps(config.to_dict())
    assert RunConfig.from_dict(json.loads(text)) == config
    assert hash(RunConfig.from_dict(json.loads(text))) == hash(config)


@pytest.mark.parametrize("profile", PROFILES)
def test_the_network_of_every_variant_can_be_built(profile):
    with torch.device("meta"):
        for variant in (*VARIANTS, *PEERS):
            settings = make_config(variant, profile=profile, recipe="matting").model
            network = registry.make(variant, settings) if variant in PEERS else ViewNet(settings)
            assert sum(weight.numel() for weight in network.parameters()) > 0


def test_no_two_configurations_share_a_key():
    keys = {make_config(v, c, p, r, seed=s).key("views") for v, p, r in EVERY for c in ("car", "sofa") for s in (0, 1)}
    # One pair of names stands for one configuration, even where two recipes or variants come to the same settings.
    assert len(keys) == 4 * len(EVERY)


def test_the_key_follows_every_field_and_every_identity():
    config = make_config(profile="smoke")
    keys = {config.key(), config.key("a"), config.key("b"), config.key("a", "b")}
    for section, change in (("data", {"views": 6}), ("model", {"focal": 0.5}), ("train", {"amp": "off"})):
        changed = dataclasses.replace(getattr(config, section), **change)
        keys.add(dataclasses.replace(config, **{section: changed}).key())
    assert len(keys) == 7
    assert all(len(key) == 12 and int(key, 16) >= 0 for key in keys)
    assert make_config(profile="smoke").key("a") == config.key("a")


def at(values, place):
    """The value of nested dictionaries at a place, None where there is none."""
    for step in place:
        values = values.get(step) if isinstance(values, dict) else None
    return values


def has(values, place):
    """Whether nested dictionaries have a value, None perhaps, at a place."""
    return not place or (isinstance(values, dict) and place[0] in values and has(values[place[0]], place[1:]))


@pytest.mark.parametrize("variant", [v for v in VARIANTS if v != "viewnet"])
@pytest.mark.parametrize("recipe", RECIPES)
def test_a_variant_changes_what_it_is_named_after_and_nothing_else(variant, recipe):
    base = make_config("viewnet", recipe=recipe).to_dict()
    config = make_config(variant, recipe=recipe).to_dict()
    changed = {place: at(config, place) for _, place in settings() if at(config, place) != at(base, place)}
    given = json.loads(json.dumps(VARIANTS[variant]))  # tuples as lists
    expected = {place: at(given, place) for _, place in settings() if has(given, place)}
    if recipe.startswith("paper") or variant in ("over_black", "behind_both"):
        # It has none of what the ablations of the other recipe take away, nor, without photographs, backgrounds.
        expected = {place: value for place, value in expected.items() if value != at(base, place)}
    assert changed == expected


def differences(one, other):
    one, other = one.to_dict(), other.to_dict()
    return {name for name, place in settings() if at(one, place) != at(other, place)}


def test_each_setting_of_our_recipe_is_taken_away_by_an_ablation():
    paper, ours = (make_config(profile="paper", recipe=recipe) for recipe in ("paper", "matting"))
    ablated = [
        differences(ours, make_config(f"without_{name}", profile="paper", recipe="matting")) for name in ABLATIONS
    ]
    assert all(ablated)
    features, labels, cycles = {"perceptual", "pixel_weight"}, {"select_by"}, {"cycle_weight", "cycle_head"}
    assert differences(paper, ours) - set().union(*ablated) == features | labels | cycles
    assert len(differences(paper, ours)) == 17


def test_the_paper_recipe_is_what_is_printed():
    config = make_config(profile="paper")
    assert config.recipe == "paper"
    assert (config.train.batch_size, config.train.patience, config.train.select_by) == (64, 30, "accuracy")
    assert (config.model.heads, config.model.code_size, config.model.appearance_size) == (3, 1024, 256)
    assert config.data.views == 5
    assert config.train.perceptual == "vgg16"


def test_overrides_reach_their_section():
    config = make_config(epochs=3, volume_size=16, views=7, elevation_limits=[-10, 30])
    assert (config.train.epochs, config.model.volume_size, config.data.views) == (3, 16, 7)
    assert config.model.elevation_limits == (-10.0, 30.0)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"epochs": 0}, "epochs 0: expected 1 to 1000000"),
        ({"targets_per_object": 5}, "batch_size 32 with targets_per_object 5: expected a multiple"),
        ({"targets_per_object": 32}, "is one object a step"),
        ({"seed": 2**32}, "seed 4294967296: expected 0 to 4294967295"),
        ({"patience": -1}, "patience -1: expected 1 to 1000000"),
        ({"validate_every": 0}, "validate_every 0: expected 1 to"),
        ({"batch_size": 10**6}, "batch_size 1000000: expected 1 to 4096"),
        ({"heads": 0}, "heads 0: expected 1 to 1024"),
        ({"heads": 10**7}, "heads 10000000: expected 1 to 1024"),
        ({"volume_size": 512}, "volume_size 512: expected 8 to 256"),
        ({"encoder_channels": [8, 0]}, r"encoder_channels \(8, 0\): expected 1 to 2048"),
        ({"generator_channels": []}, "generator_channels: 0 of them: expected 1 to 16"),
        ({"encoder_channels": [8] * 10**6}, "encoder_channels: 1000000 of them"),
        ({"learning_rate": -1.0}, "learning_rate -1.0: expected 1e-12 to"),
        ({"neighbours": -3.0}, "neighbours -3.0: expected 0 to 180"),
        ({"search": 2.0}, "search 2.0: expected 0 to 1"),
        ({"search_views": 10**6}, "search_views 1000000: expected 1 to 1024"),
        ({"betas": [0.9, 1.0]}, r"betas \(0.9, 1.0\): expected 0 to 0.999999"),
        ({"backdrop": float("nan")}, "backdrop nan: expected 0 to 1"),
        ({"models": -1}, "models -1: expected 0 to 1000000"),
        ({"image_size": 10**5}, "image_size 100000: expected 1 to 4096"),
        ({"elevation_limits": [30, 10]}, "expected the lower angle first"),
        ({"elevation_range": [-20, 91]}, "elevation_range .*: expected -90 to 90"),
        ({"video": {"category": "car", "size": 10**5}}, "size 100000: expected 1 to 1024"),
        ({"video": {"category": "car", "frames": 10**9}}, "frames 1000000000: expected 1 to"),
    ],
)
def test_what_cannot_be_trained_with_is_refused_before_anything_is_made(overrides, message):
    with pytest.raises(ViewnetError, match=message):
        make_config(**overrides)


def test_every_number_among_the_settings_has_its_limits():
    numbers = [(cls, each) for cls in GROUPS for each in dataclasses.fields(cls)]
    numbers = [(cls, each) for cls, each in numbers if NUMBER.search(str(each.type))]
    assert {each.metadata.get("setting", each.name) for _, each in numbers} == set(LIMITS)


def test_videos_are_part_of_a_configuration():
    videos = VideoConfig("car", root="somewhere", kind="freiburg", split_rule="all", count=10, sequences=(1, 2))
    config = make_config(profile="tiny", recipe="photos", video=videos)
    assert config.data.video == videos
    assert RunConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert make_config(profile="tiny", recipe="photos", video=dataclasses.asdict(videos)) == config
    assert config.train.epochs == FILMED["tiny"]["train"]["epochs"]
    assert make_config(profile="tiny", recipe="photos", video=videos, epochs=3).train.epochs == 3
    others = [dataclasses.replace(videos, count=11), dataclasses.replace(videos, kind="auto"), None]
    assert len({config.key(), *(make_config(recipe="photos", video=other).key() for other in others)}) == 4
    with pytest.raises(ViewnetError, match=r"unknown config\.data\.video\.kind 'coco': choose one of auto, freiburg"):
        make_config(video={"category": "car", "kind": "coco"})


def test_a_start_leaves_out_what_only_a_beginning_needs():
    train = make_config(profile="tiny", start="0123456789ab").train
    assert (train.start, train.search.share) == ("0123456789ab", 0)
    assert make_config(profile="tiny", start="0123456789ab", search=0.2).train.search.share == 0.2
    assert make_config(profile="tiny").train.search.share > 0


def test_field_names_are_unique_across_sections():
    """An override names a field without its section."""
    names = [name for name, _ in settings()]
    assert len(names) == len(set(names))


def test_a_collection_is_used_whole_unless_asked_otherwise():
    assert make_config(data_root="somewhere").data.models == 0
    assert make_config(data_root="somewhere", models=40).data.models == 40
    assert make_config(profile="smoke", data_root="somewhere").data.models == PROFILES["smoke"]["data"]["models"]


def test_synsets_are_text_with_all_their_digits():
    assert all(isinstance(s, str) and len(s) == 8 and s.isdigit() for s in SYNSETS.values())
    assert len(CATEGORIES) == len(set(SYNSETS.values())) == 12


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"variant": "viewnt"}, "unknown variant 'viewnt': choose one of viewnet, viewnet_cycle"),
        ({"category": "02958343"}, "unknown category '02958343': choose one of aeroplane"),
        ({"profile": "big"}, "unknown profile 'big': choose one of smoke, tiny, pocket, small, paper"),
        ({"recipe": "secret"}, "unknown recipe 'secret': choose one of paper, matting"),
        ({"seed": -1}, "seed -1: expected a whole number"),
        ({"seed": 1.5}, "seed 1.5: expected a whole number"),
        ({"seed": True}, "seed True: expected a whole number"),
        ({"epoch": 3}, "unknown setting 'epoch': viewnet train --settings lists all. Did you mean 'epochs'?"),
        ({"nothing": 3}, "unknown setting 'nothing': viewnet train --settings lists all"),
        ({"epochs": "3"}, "config.train.epochs: expected int, got '3'"),
        ({"epochs": True}, "config.train.epochs: expected int, got True"),
        ({"learning_rate": "1e-4"}, "config.train.optimiser.learning_rate: expected float, got '1e-4'"),
        ({"augment": 1}, "config.train.augment: expected bool, got 1"),
        ({"schedule": "linear"}, "unknown config.train.optimiser.schedule 'linear': choose one of constant, cosine"),
        ({"generator_last_kernel": 3}, "unknown config.model.generator_last_kernel 3: choose one of 2, 4"),
        ({"elevation_limits": (1.0,)}, "config.model.elevation_limits: expected"),
        ({"encoder_channels": ("a",)}, "config.model.encoder_channels: expected int, got 'a'"),
    ],
)
def test_what_is_wrong_is_said_with_what_is_right(arguments, message):
    with pytest.raises(ViewnetError) as error:
        make_config(**arguments)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("seed"), "config: 'seed' is missing"),
        (lambda d: d.update(sed=1), "config: unknown setting 'sed'"),
        (lambda d: d["model"].update(head=1), "config.model: unknown setting 'head'"),
        (lambda d: d.update(data=[1]), "config.data: expected a mapping"),
        (lambda d: d["train"].update(epochs=None), "config.train.epochs: expected int, got None"),
    ],
)
def test_a_damaged_file_is_refused(change, message):
    values = make_config().to_dict()
    change(values)
    with pytest.raises(ViewnetError, match=message):
        RunConfig.from_dict(values)
