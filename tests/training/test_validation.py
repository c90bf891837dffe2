"""Which views training is validated on."""

import torch

from viewnet.data.pairs import Views
from viewnet.training.validation import VALIDATION_VIEWS, validation_rows


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
