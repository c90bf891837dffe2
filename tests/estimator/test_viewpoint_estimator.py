from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.estimators import PHOTOS, SQUARE, STRETCHED, estimator_of, photograph, same, turntable_of, untrained
from helpers.untrained_models import finished_run, turned, untrained_renderer
from PIL import Image

from viewnet.config import VideoConfig
from viewnet.data.crop import Crop, bounds, cut
from viewnet.data.photo_store import Photograph, Photographs, photo_store
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator, volume_mesh
from viewnet.estimator.inputs import InputImage, read_image
from viewnet.estimator.preprocess import OPAQUE, Framing, batches, crop_to_object
from viewnet.evaluation.predict import predict
from viewnet.geometry import look_at
from viewnet.recipes import make_config


@pytest.mark.parametrize("overrides", [{}, SQUARE, STRETCHED], ids=["whole", "square", "stretched"])
def test_views_get_the_answers_that_runs_are_scored_by(store, images, overrides):
    renderer = untrained_renderer(store, **overrides)
    said = estimator_of(renderer).predict(images)
    assert np.allclose(said.hypotheses, renderer.aligned.hypotheses, atol=1e-6)
    assert np.array_equal(said.choice, renderer.aligned.predictions.choice)
    assert np.allclose(said.vector, renderer.aligned.selected, atol=1e-6)
    logits = torch.tensor(renderer.aligned.predictions.logits)
    assert np.allclose(said.probabilities, logits.softmax(1))


def test_photographs_get_the_answers_that_they_are_scored_by(tmp_path):
    boxes = [(5, 8, 70, 41), (-3, 10, 40, 80), (30.5, 2, 61, 59)]
    listed, files = [], []
    for number, split in enumerate(("val", "test", "test")):
        files.append(tmp_path / "images" / f"{number}.png")
        files[-1].parent.mkdir(exist_ok=True)
        Image.fromarray(photograph(seed=number)).save(files[-1])
        listed.append(Photograph(str(number), "car", split, files[-1], boxes[number], 0.0, 0.0))
    for overrides in (PHOTOS, SQUARE):
        estimator = untrained(**overrides)
        crop = Crop(64, square=overrides is SQUARE)
        photos = photo_store(
            Photographs(tmp_path, listed), tmp_path / f"store-{crop.square}", crop, {"made": str(crop)}
        )
        scored = predict(estimator.network, photos)
        assert np.allclose(estimator.predict(files, boxes=boxes).hypotheses, scored.hypotheses, atol=1e-6)


def test_all_types_of_input_give_the_same_viewpoint(tmp_path):
    estimator, array = untrained(**PHOTOS), photograph()
    tensor = torch.tensor(array).movedim(-1, 0)
    Image.fromarray(array).save(tmp_path / "a.png")
    rotated = Image.fromarray(array).transpose(Image.Transpose.ROTATE_90)
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was held so that the image has to be rotated by 90 degrees clockwise
    rotated.save(tmp_path / "turned.png", exif=exif)
    expected = estimator.predict(array)
    for image in (
        Image.fromarray(array),
        str(tmp_path / "a.png"),
        tmp_path / "a.png",
        tmp_path / "turned.png",
        array / 255,
        (array / 255).astype(np.float32),
        tensor,
        tensor.double() / 255,
        np.dstack([array, np.full(array.shape[:2], 255, np.uint8)]),
    ):
        assert same(estimator.predict(image), expected)
    both = [array, array[:, ::-1]]
    several = estimator.predict(both)
    assert same(several[:1], expected)
    assert not same(several[1:], expected)
    stacked = np.stack(both)
    for images in (stacked, stacked / 255, torch.tensor(stacked).movedim(-1, 1), [Image.fromarray(a) for a in both]):
        assert same(estimator.predict(images, batch_size=1), several)


def test_grey_images_are_images():
    estimator, grey = untrained(**PHOTOS), photograph()[..., 0]
    expected = estimator.predict(np.dstack([grey] * 3))
    for image in (grey, grey[..., None], Image.fromarray(grey), torch.tensor(grey)[None]):
        assert same(estimator.predict(image), expected)


@pytest.mark.parametrize("overrides", [{}, PHOTOS, SQUARE])
def test_images_that_are_ready_are_not_cut(overrides):
    estimator = untrained(**overrides)
    ready = np.stack([photograph(32, 32, seed) // 20 for seed in range(3)])
    at_once, one_by_one = estimator.predict(ready), estimator.predict(list(ready))
    assert same(at_once, one_by_one)
    assert same(estimator.predict(torch.tensor(ready / 255).movedim(-1, 1)), one_by_one)
    assert same(estimator.predict((ready / 255).astype(">f4")), one_by_one)
    backwards = ready[::-1]
    backwards.flags.writeable = False
    assert same(estimator.predict(backwards), one_by_one[::-1])


def test_many_images_are_answered_as_each_alone(tmp_path):
    estimator, mask = untrained(**SQUARE), np.zeros((60, 80), np.uint8)
    mask[10:50, 20:70] = 255
    images, masks, boxes = [], [], []
    for number in range(45):
        images.append(photograph(80, 60, number))
        masks.append(mask if number % 3 == 1 else None)
        boxes.append((number, 5, 79, 55) if number % 3 == 2 else None)
    alone = [estimator.predict(image, [m], [box]) for image, m, box in zip(images, masks, boxes, strict=True)]
    for batch_size in (256, 40, 7):
        together = estimator.predict(images, masks, boxes, batch_size)
        assert np.allclose(together.hypotheses, np.concatenate([each.hypotheses for each in alone]), atol=1e-6)


def test_images_that_fail_are_left_out_where_failures_are_asked_for(tmp_path):
    estimator = untrained(**PHOTOS)
    images: list = [photograph(80, 60, number) for number in range(12)]
    for row in (0, 1, 2, 3, 7):
        images[row] = tmp_path / f"{row}.png"
    for batch_size in (256, 4):  # of four the whole first batch fails
        failures: dict[int, str] = {}
        found = estimator.predict(images, batch_size=batch_size, failures=failures)
        assert failures == dict.fromkeys((0, 1, 2, 3, 7), "no such image")
        assert same(found, estimator.predict([image for image in images if not isinstance(image, Path)]))
        sizes = [len(each) for each in batches(images, None, None, estimator.framing, estimator.device, batch_size, {})]
        assert sizes == ([7] if batch_size == 256 else [3, 4])
    assert len(estimator.predict(images[:2], failures={})) == 0


def test_images_are_read_a_batch_at_a_time(monkeypatch):
    estimator, files = untrained(**PHOTOS), []

    def read(image, mask=None, box=None):
        files.append(image)
        return read_image(image, mask, box)

    monkeypatch.setattr("viewnet.estimator.preprocess.read_image", read)
    groups = batches([photograph()] * 50, None, None, estimator.framing, estimator.device, 20)
    assert [(len(next(groups)), len(files)) for _ in range(3)] == [(20, 20), (20, 40), (10, 50)]


def test_reading_images_leaves_the_number_of_threads(tmp_path, one_thread):
    estimator, found = untrained(**PHOTOS), []
    torch.set_num_threads(2)
    estimator.predict([photograph()] * 40)
    with pytest.raises(ViewnetError, match=r"missing\.png: no such image"):
        estimator.predict([photograph(), tmp_path / "missing.png"])
    later = threading.Thread(target=lambda: found.append(torch.get_num_threads()))
    later.start()
    later.join()
    assert [*found, torch.get_num_threads()] == [2, 2]


def seen(estimator: ViewpointEstimator, images, masks=None) -> torch.Tensor:
    """What the viewpoint network sees of images that make one batch."""
    (found,) = batches(images, masks, None, estimator.framing, estimator.device, 99)
    return found.viewpoint


def placed(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A view (S, S, 4) twice as large, off the centre of a larger image; and its mask."""
    large = np.asarray(Image.fromarray(image).resize((64, 64), Image.Resampling.BICUBIC))
    canvas = np.zeros((120, 200, 4), np.uint8)
    canvas[50:114, 20:84] = large
    return canvas[..., :3].copy(), canvas[..., 3]


@pytest.mark.parametrize("overrides", [SQUARE, STRETCHED])
def test_a_masked_object_is_seen_as_in_training_wherever_it_is(images, overrides):
    estimator = untrained(**overrides)
    found = [placed(whole) for whole in images]
    cutouts, masks = [image for image, _ in found], [mask for _, mask in found]
    cut_out, whole = seen(estimator, cutouts, masks), seen(estimator, list(images))
    apart = (cut_out[:, None] - whole[None]).abs().flatten(2).mean(2)
    assert torch.equal(apart.argmin(1), torch.arange(len(images)))
    assert apart.diagonal().mean() < apart.mean() / 3
    # Transparency is a mask, and so is any array that marks the object.
    transparent = [np.dstack(both) for both in found]
    expected = estimator.predict(cutouts, masks)
    assert same(estimator.predict(transparent), expected)
    solid = estimator.predict(cutouts, [mask > 127 for mask in masks])
    for kind in ([Image.fromarray(mask > 127) for mask in masks], [(mask > 127).astype(np.uint8) for mask in masks]):
        assert same(estimator.predict(cutouts, kind), solid)


def test_what_is_beside_a_mask_is_seen_by_those_who_always_saw_something(images):
    image, mask = placed(images[0])
    other = np.where(mask[..., None] > 0, image, 200).astype(np.uint8)
    black, photos = untrained(), untrained(**PHOTOS)
    assert (seen(photos, [image], mask) - seen(photos, [other], mask)).abs().max() > 0.5
    assert (seen(black, [image], mask) - seen(black, [other], mask)).abs().max() == 0
    assert same(photos.predict(other, mask), photos.predict(other, boxes=bounds(mask)))
    # Transparent pixels have no colour.
    clear = np.dstack([other, np.where(mask > 127, 255, 0).astype(np.uint8)])
    solid = np.where(mask[..., None] > 127, image, OPAQUE).astype(np.uint8)
    assert same(photos.predict(clear), photos.predict(solid, mask))


def test_of_a_mask_what_lies_in_the_box_is_the_object():
    mask = np.zeros((60, 90), np.uint8)
    mask[10:30, 5:25] = mask[20:50, 60:80] = 255
    alone = mask.copy()
    alone[:, 30:] = 0
    found = read_image(photograph(), mask, (4.0, 9.0, 26.0, 31.0))
    assert np.array_equal(found.mask, alone)
    assert found.box == (5, 10, 25, 30)


def test_filmed_objects_are_cut_out_as_frames_were():
    video = VideoConfig("car", size=48, margin=0.1)
    mask = np.zeros((60, 90), np.uint8)
    mask[10:30, 20:60] = 255
    given = InputImage(Image.fromarray(photograph()), mask, bounds(mask))
    framing = Framing.of(make_config(profile="smoke", video=video))
    assert np.array_equal(crop_to_object(given, framing).pixels, cut(given.image, given.box, Crop(48, 0.1), mask))
    # Trained without masks: frames were used as they are, and so is the image.
    framing = Framing.of(make_config(profile="smoke", video=replace(video, masks="none"), crop="square"))
    assert np.array_equal(crop_to_object(given, framing).pixels, cut(given.image, given.box, Crop(64, 0.1)))


def test_images_unlike_those_of_training_are_named(caplog):
    bright, dark = photograph(), photograph() // 30
    untrained(**SQUARE).predict([dark, bright])
    untrained(**SQUARE).predict([dark, bright], [np.ones((60, 90), bool)] * 2)
    untrained(**PHOTOS).predict(bright)
    assert [record.message.partition(" is not")[0] for record in caplog.records] == ["image 1"]


def test_the_first_box_that_lies_mostly_outside_of_its_image_is_named(caplog):
    boxes = [(0, 0, 90, 100), (40, 0, 160, 60), (-90, -60, 90, 60)]  # a third more, 50 of 120 columns, a quarter inside
    untrained(**PHOTOS).predict([photograph()] * 3, boxes=boxes, batch_size=1)
    assert [record.message for record in caplog.records] == [
        "image 1: most of its box lies outside of it: is the box of this image, and in its pixels?"
    ]


def test_networks_that_see_whole_views_say_so_of_what_is_cut(caplog):
    dark, box = photograph() // 30, (5, 5, 50, 50)
    untrained().predict(dark)
    untrained(video=VideoConfig("car")).predict(dark, boxes=box)
    untrained(**SQUARE).predict(dark, boxes=box)
    assert not caplog.records
    untrained().predict([dark, dark], boxes=[box, None], batch_size=1)
    assert [record.message.partition(":")[0] for record in caplog.records] == [
        "the network was trained on whole views as a rendering camera frames them"
    ]


def test_viewpoints_are_rows(store, images):
    said = estimator_of(untrained_renderer(store)).predict(images)
    assert len(said) == 9
    assert [one.azimuth for one in said] == said.azimuth.tolist()
    assert said[4].hypotheses.shape == (3, 3)
    assert isinstance(said[4].choice, int)
    assert np.array_equal(said[-1].vector, said.vector[8])
    assert np.array_equal(said[[2, 0]].elevation, said.elevation[[2, 0]])
    assert len(said[said.azimuth < -1]) == 0
    frame = said.to_frame()
    assert frame.shape == (9, 4 + 3 * 3)
    chosen = frame.to_numpy()[np.arange(9), 4 + 3 * said.choice]
    assert np.allclose(chosen, frame["azimuth"])
    assert np.allclose(said.probabilities.sum(1), 1)
    assert (said.confidence >= said.probabilities.max(1) - 1e-12).all()
    assert np.allclose(said.frame, look_at(torch.tensor(said.vector)).numpy())
    assert repr(said).splitlines()[0] == "9 viewpoints in the annotated frame"
    assert f"{said.azimuth[3]:.1f}°" in repr(said).splitlines()[5]
    assert repr(said[[0] * 20]).splitlines()[-1] == "  and 8 more"


def test_in_plane_rotation_is_in_the_frames(images):
    rotation = turned(50)
    own, there = untrained(True).predict(images), untrained(True, rotation).predict(images)
    assert not np.allclose(own.frame, look_at(torch.tensor(own.vector)).numpy(), atol=1e-2)
    assert np.allclose(there.frame, rotation @ own.frame, atol=1e-6)
    assert np.allclose((there.azimuth - own.azimuth) % 360, 50, atol=1e-4)


def test_without_alignment_the_frame_is_the_network_s(images):
    estimator = untrained()
    said = estimator.predict(images)
    assert not estimator.aligned
    assert not said.aligned
    assert not said[0].aligned
    assert "own frame: not aligned" in repr(estimator)
    assert "own frame: not aligned" in repr(said)
    with torch.no_grad():
        seen = torch.tensor(images).movedim(-1, 1).float() / 255
        seen[:, :3] *= seen[:, 3:]
        found = estimator.network.viewpoint(estimator.network.composite(seen))
    assert np.allclose(said.hypotheses, found.vectors, atol=1e-2)


def test_volumes_and_meshes_are_those_of_the_run(store, images):
    renderer = untrained_renderer(store)
    estimator = estimator_of(renderer)
    volume = renderer.encode([4]).volume[0]
    assert torch.allclose(estimator.volume(images[4]), volume, atol=1e-4)
    expected = volume_mesh.surface(volume, renderer.rotation, 0.3)
    mesh = estimator.mesh(images[4], level=0.3)
    assert np.allclose(mesh.bounds, expected.bounds, atol=1e-3)
    assert mesh.is_watertight
    hologan = estimator_of(untrained_renderer(store, variant="hologan_decoder"))
    for ask in (hologan.volume, hologan.mesh):
        with pytest.raises(ViewnetError, match="HoloGAN decoder has no volume"):
            ask(images[4])
    assert hologan.reconstruct(images[:2]).shape == (2, 16, 16, 3)


def test_networks_that_saw_objects_cut_out_still_do(store, images):
    for cut_out in (False, True):
        renderer = untrained_renderer(store, recipe="photos", crop="none", cut_out=cut_out)
        alone = renderer.network.encode(renderer.images([4], 32))[1][0]
        assert torch.equal(renderer.encode([4]).volume[0], alone) == cut_out
        assert torch.allclose(estimator_of(renderer).volume(images[4]), alone, atol=1e-3) == cut_out


def test_drawing_without_a_mask_is_told_where_objects_were_cut_out_in_training(caplog):
    image, mask = photograph(40, 30), np.zeros((30, 40), bool)
    mask[5:25, 8:32] = True
    for cut_out, backgrounds in ((True, "drawn"), (True, None), (False, "drawn")):
        estimator = untrained(recipe="photos", cut_out=cut_out, backgrounds=backgrounds)
        estimator.predict(image)
        estimator.reconstruct([image, image], masks=[mask, mask])
        assert "cut out, as in training: give a mask" not in caplog.text
        estimator.reconstruct([image, image], masks=[mask, None])
        assert ("cut out, as in training: give a mask" in caplog.text) == (cut_out and backgrounds is not None)
        caplog.clear()


def test_reconstructions_are_those_of_the_run(store, images):
    renderer = untrained_renderer(store)
    found = estimator_of(renderer).reconstruct(images, size=24)
    expected = renderer.displayed(renderer.reconstruct(list(range(9)), 24))
    assert np.abs(found.astype(int) - expected).max() <= 1


def test_photographs_are_drawn_cut_to_their_object():
    drawn = untrained(**PHOTOS).reconstruct([photograph(seed=seed) for seed in range(2)])
    assert (drawn.min(-1) < 250).any(2).sum(1).min() >= drawn.shape[1] - 2


def test_appearance_is_the_object_s_alone_before_what_is_there():
    estimator = untrained(**PHOTOS)
    mask = np.zeros((60, 90), bool)
    mask[10:50, 20:70] = True
    mask[10:20, 20:30] = False
    (shown,) = batches(photograph(), mask, None, estimator.framing, estimator.device, 1)
    assert torch.allclose(shown.appearance[:, 3].mean(), torch.tensor(0.95), atol=0.01)
    assert torch.allclose(
        estimator.network.composite(shown.appearance, shown.background), shown.viewpoint[:, :3], atol=0.005
    )


def test_the_view_from_the_predicted_viewpoint_is_the_reconstruction(store, images):
    estimator = estimator_of(untrained_renderer(store, turned(70)))
    said = estimator.predict(images)
    again = estimator.novel_view(images, said.azimuth, said.elevation, size=24)
    assert np.abs(again.astype(int) - estimator.reconstruct(images, size=24)).max() <= 2
    other = estimator.novel_view(images, 10, 20, size=24)
    assert np.abs(again.astype(int) - other).max() > 20
    for azimuth in ([1.0, 2.0], np.nan):
        with pytest.raises(ViewnetError, match=r"azimuth .*: .* one number or 9"):
            estimator.novel_view(images, azimuth, 0)


def test_turntables_are_those_of_the_run(store, images, tmp_path):
    renderer = untrained_renderer(store)
    frames = estimator_of(renderer).turntable(images[5], tmp_path / "a.gif", steps=5, hold=0, size=64)
    expected = turntable_of(renderer, 5, steps=5, hold=0, size=64)
    assert len(frames) == len(expected) == 5
    assert max(np.abs(one.astype(int) - other).max() for one, other in zip(frames, expected, strict=True)) <= 2
    with Image.open(tmp_path / "a.gif") as back:
        assert back.n_frames == 5
    with pytest.raises(ViewnetError, match=r"a\.webm: unknown kind of animation"):
        untrained().turntable(images[5], tmp_path / "a.webm")
    with pytest.raises(ViewnetError, match="9 images: expected one"):
        untrained().turntable(images)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"steps": 0}, "steps 0"),
        ({"size": 100_000}, "size 100000: expected an even number of 64 to 1024 pixels"),
        ({"steps": 10**9}, "steps 1000000000, hold 12: .* together at most 3640 at size 192"),
        ({"size": 1024, "steps": 120}, "steps 120, hold 12: .* together at most 128 at size 1024"),
    ],
)
def test_turntables_that_fill_the_memory_are_refused(given, message, images, monkeypatch):
    monkeypatch.setattr(ViewpointEstimator, "render", lambda *_: pytest.fail("rendered"))
    with pytest.raises(ViewnetError, match=message):
        untrained().turntable(images[5], **given)


@pytest.mark.parametrize(
    ("image", "given", "message"),
    [
        ([], {}, "images: none were given"),
        (7, {}, "images: got int"),
        ([7], {}, "image 0: got int: expected a PIL image"),
        (np.zeros((4, 5, 2), np.uint8), {}, r"image 0: image is \(4, 5, 2\): expected \(H, W\)"),
        (torch.zeros(5, 4, 3), {}, r"image is \(5, 4, 3\): expected .*\(3, H, W\)"),
        (np.zeros((0, 5, 3), np.uint8), {}, r"image is \(0, 5, 3\)"),
        (np.zeros((4, 5, 3), np.int64), {}, "image is of int64: expected uint8"),
        (np.full((4, 5, 3), 2.0), {}, "values from 2 to 2: expected 0 to 1"),
        (np.full((4, 5, 3), np.nan), {}, "values from nan to nan"),
        (np.full((2, 32, 32, 3), np.nan), {}, "images have values from nan"),
        (np.zeros((2, 32, 32, 3), np.int32), {}, "image 0: image is of int32"),
        (torch.zeros(2, 3, 32, 32, dtype=torch.int32), {}, "images are of torch.int32"),
        (photograph(), {"masks": np.zeros((60, 90), bool)}, "image 0: mask is empty"),
        (photograph(), {"masks": np.ones((90, 60), bool)}, "mask is 60 x 90, its image 90 x 60"),
        (photograph(), {"masks": [None, None]}, "masks: 2 for 1 images"),
        (photograph(), {"masks": [np.zeros((2, 2, 2))]}, r"mask is \(2, 2, 2\): expected \(H, W\)"),
        (photograph(), {"masks": "nowhere.png"}, "no such mask nowhere.png"),
        (photograph(), {"boxes": (5, 5, 5, 9)}, r"box .* x0 below x1"),
        (photograph(), {"boxes": [(1, 2, 3)]}, r"box \(1, 2, 3\): expected four numbers"),
        (photograph(), {"boxes": [(1, 2, 3, 4)] * 2}, "boxes: 2 for 1 images"),
        (photograph(), {"boxes": 3}, "boxes 3: expected x0, y0, x1, y1"),
        ([photograph()] * 2, {"boxes": [None, (200, 0, 210, 5)]}, "image 1: box has no part in the image"),
        (photograph(), {"batch_size": 0}, "batch_size 0: expected"),
        (np.zeros((8, 8, 4), np.uint8), {}, "image 0: mask is empty"),
    ],
)
def test_errors_of_images_masks_and_boxes(image, given, message):
    with pytest.raises(ViewnetError, match=message):
        untrained().predict(image, **given)


def test_unreadable_files_are_named(tmp_path):
    (tmp_path / "text.jpg").write_text("no image")
    Image.fromarray(photograph()).save(tmp_path / "whole.jpg")
    (tmp_path / "half.jpg").write_bytes((tmp_path / "whole.jpg").read_bytes()[:-300])
    truncated = r"image does not decode \(image file is truncated"
    for name, message in (
        ("text.jpg", "image does not decode"),
        ("missing.jpg", "no such image"),
        ("half.jpg", truncated),
    ):
        with pytest.raises(ViewnetError, match=rf"{name}: {message}"):
            untrained().predict(tmp_path / name)


FRESH = """
import json, sys
from viewnet.estimator import ViewpointEstimator
print(ViewpointEstimator.from_pretrained(sys.argv[1], device="cpu").predict(sys.argv[2]).azimuth[0])
print(json.dumps(sorted(sys.modules)))
"""


def test_one_answer_needs_no_heavy_library(store, tmp_path):
    run = finished_run(tmp_path / "run", store)
    image = tmp_path / "a.png"
    Image.fromarray(photograph() // 30).save(image)
    root = Path(__file__).resolve().parents[2]
    environment = os.environ | {"PYTHONPATH": str(root), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", FRESH, run.folder, image], env=environment, capture_output=True, text=True, check=True
    )
    azimuth, modules = done.stdout.splitlines()
    assert float(azimuth) == pytest.approx(ViewpointEstimator.from_pretrained(run.folder).predict(image).azimuth[0])
    heavy = {"pandas", "scipy", "matplotlib", "trimesh", "numba", "skimage", "torchvision", "av", "huggingface_hub"}
    assert heavy & set(json.loads(modules)) == set()
