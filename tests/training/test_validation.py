"""Which views training is validated on."""

from dataclasses import replace

import torch

from viewnet.data.pairs import Views
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import make_config
from viewnet.training import validation
from viewnet.training.validation import VALIDATION_VIEWS, validate, validation_rows


def views_of(counts: list[int]) -> Views:
    count = torch.tensor(counts)
    objects = torch.arange(len(counts)).repeat_interleave(count)
    empty = torch.zeros(len(objects), 4, 2, 2, dtype=torch.uint8)
    return Views(empty, None, objects, torch.zeros(len(objects), 2), count.cumsum(0) - count, count)


def test_ten_views_of_each_of_the_first_models():
    rows = validation_rows(views_of([10] * 40))
    assert rows.flatten().tolist() == list(range(VALIDATION_VIEWS))


def test_videos_are_not_judged_by_the_frames_of_the_first_few():
    views = views_of([118, 120, 114, 119])
    rows = validation_rows(views)
    assert views.objects[rows].tolist() == [[number] * 10 for number in range(4)]
    places = rows - views.first[:, None]
    assert (places[:, 0] == 0).all() and (places.diff(dim=1) >= 11).all() and (places < views.count[:, None]).all()


def test_of_objects_with_few_views_all_are_seen():
    assert validation_rows(views_of([3, 3])).tolist() == [[0, 1, 2], [3, 4, 5]]


def test_each_frame_is_reconstructed_from_the_next_one_of_its_video(monkeypatch, one_thread):
    config = make_config(profile="smoke")
    views, seen = views_of([30, 31]), []
    pixels = torch.zeros(61, 4, 32, 32, dtype=torch.uint8)
    pixels[:] = torch.arange(61)[:, None, None, None]  # a view's grey level is its row
    views = replace(views, pixels=pixels)

    def reconstruct(model, appearance, target, *rest):
        seen.append([(255 * images[:, 0, 0, 0]).round().long() for images in (appearance, target)])
        return actual(model, appearance, target, *rest)

    actual = validation.reconstruct
    monkeypatch.setattr(validation, "reconstruct", reconstruct)
    validate(ViewNet(config.model), views, config.train, torch.device("cpu"))
    appearance, target = (torch.cat(each) for each in zip(*seen, strict=True))
    assert torch.equal(target, validation_rows(views).flatten())
    assert torch.equal(appearance, views.next_views(target)) and target.max() > 50
