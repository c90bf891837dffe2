from __future__ import annotations

import pytest
import torch
from helpers.boxes import box_store
from hypothesis import given, settings
from hypothesis import strategies as st

from viewnet.data.pairs import Views, load_views, sample_pairs, step_generator
from viewnet.errors import ViewnetError
from viewnet.runtime.images import resize

CPU = torch.device("cpu")


def views_of(counts: list[int]) -> Views:
    """Objects with the given numbers of views, without images."""
    count = torch.tensor(counts)
    objects = torch.arange(len(counts)).repeat_interleave(count)
    total = int(count.sum())
    return Views(torch.zeros(total, 4, 1, 1), None, objects, torch.zeros(total, 2), count.cumsum(0) - count, count)


# Pairs


@given(st.lists(st.integers(2, 6), min_size=1, max_size=12), st.integers(1, 8), st.integers(1, 4), st.integers(0, 99))
def test_a_target_shows_the_same_object_from_another_view(counts, objects, targets, step):
    views = views_of(counts)
    appearance, target = sample_pairs(views, objects, targets, 7, step)
    assert appearance.shape == (objects,)
    assert target.shape == (objects * targets,)
    assert torch.equal(views.objects[appearance].repeat_interleave(targets), views.objects[target])
    assert (appearance.repeat_interleave(targets) != target).all()
    for group in target.view(objects, targets):
        available = int(views.count[views.objects[group[0]]]) - 1
        assert len(set(group.tolist())) == min(targets, available)


@given(st.integers(2, 11), st.integers(1, 9), st.integers(0, 1000))
@settings(max_examples=20)
def test_every_object_is_visited_equally_often(total, objects, seed):
    views = views_of([3] * total)
    visits = torch.cat([views.objects[sample_pairs(views, objects, 1, seed, step)[0]] for step in range(total)])
    assert torch.equal(torch.bincount(visits, minlength=total), torch.full((total,), objects))


def test_every_pair_of_views_comes_up():
    views = views_of([4])
    pairs = {tuple(int(x) for x in torch.cat(sample_pairs(views, 1, 1, 0, step))) for step in range(200)}
    assert len(pairs) == 12


def test_a_draw_is_a_function_of_seed_and_step():
    views = views_of([5] * 20)

    def draw(seed: int, step: int) -> list[int]:
        return torch.cat(sample_pairs(views, 8, 2, seed, step)).tolist()

    torch.manual_seed(0)
    expected = draw(3, 10)
    torch.manual_seed(1)
    draw(3, 4)
    assert draw(3, 10) == expected
    assert draw(3, 11) != expected
    assert draw(4, 10) != expected
    one, other = (torch.rand(4, generator=step_generator(3, step)) for step in (10, 11))
    assert torch.equal(one, torch.rand(4, generator=step_generator(3, 10)))
    assert not torch.equal(one, other)


def test_a_single_view_cannot_be_paired():
    with pytest.raises(ViewnetError, match="two views or more of every object"):
        sample_pairs(views_of([3, 1]), 1, 1, 0, 0)


# Views of a store


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return box_store(tmp_path_factory.mktemp("views") / "boxes", {"train": 3, "val": 2}, views=3, size=32)


def test_views_of_a_split(store):
    views = load_views(store, "train", 32)
    assert views.pixels.shape == (9, 4, 32, 32)
    assert views.crops is None
    assert views.objects.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert views.first.tolist() == [0, 3, 6]
    assert views.count.tolist() == [3, 3, 3]
    rows = store.index[store.index["split"] == "train"]
    assert views.truth.numpy() == pytest.approx(rows[["azimuth", "elevation"]].to_numpy(), rel=1e-6)
    images = views.images(torch.tensor([4]), 32, CPU)
    straight = torch.from_numpy(store.images[4].copy()).permute(2, 0, 1).float() / 255
    assert (images[0, :3] - straight[:3] * straight[3:]).abs().max() <= 0.5 / 255 + 1e-6
    assert torch.equal(images[0, 3], straight[3])
    assert torch.equal(views.viewpoint_input(torch.tensor([4]), 32, CPU), images)


def test_smaller_images_are_means_of_weighted_colours(store):
    fine, coarse = load_views(store, "val", 32), load_views(store, "val", 16)
    rows = torch.arange(6)
    expected = resize(fine.images(rows, 32, CPU), 16)
    assert (coarse.images(rows, 16, CPU) - expected).abs().max() < 1.01 / 255
    assert torch.equal(fine.images(rows, 16, CPU), expected)


def test_crops_are_what_the_viewpoint_network_sees(store):
    views = load_views(store, "train", 32, crop=16)
    seen = views.viewpoint_input(torch.arange(9), 16, CPU)
    assert seen.shape == (9, 4, 16, 16)
    assert (seen[:, 3].mean((1, 2)) > views.images(torch.arange(9), 16, CPU)[:, 3].mean((1, 2))).all()


def test_a_split_without_views(store):
    with pytest.raises(ViewnetError, match="no views in split 'test'"):
        load_views(store, "test", 32)
