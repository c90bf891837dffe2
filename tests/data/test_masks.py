"""Masks: file formats, segmentation networks, and tracking one object through a clip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import nn
from torchvision.models import detection, segmentation

from viewnet.data import masks
from viewnet.data.clips import Clip
from viewnet.data.masks import from_alpha, from_files, from_segmenter, predicted, regions, segmenter
from viewnet.errors import ViewnetError

IMAGE = Image.new("RGB", (6, 4), (50, 60, 70))
HALF = np.zeros((4, 6), np.uint8)
HALF[:, 3:] = 255


def clip(folder: Path | None = None) -> Clip:
    return Clip("c", "car", "train", Path("c"), (), folder)


@pytest.mark.parametrize(
    "image",
    [
        Image.fromarray(HALF),
        Image.fromarray(HALF // 255),
        Image.fromarray(HALF > 0),
        Image.fromarray(np.dstack([HALF] * 3)),
        Image.fromarray(HALF.astype(np.uint16) * 257),
    ],
    ids=["grey", "ones", "bits", "colours", "16 bits"],
)
def test_files_of_any_kind_are_read(tmp_path, image):
    image.save(tmp_path / "frame7.png")
    assert (from_files().follow(clip(tmp_path))(0, "frame7", IMAGE) == HALF).all()


def test_a_palette_holds_numbers_of_classes_and_soft_edges_stay(tmp_path):
    labelled = Image.fromarray(HALF // 255 * 7).convert("P")
    labelled.putpalette([0] * 768)
    labelled.save(tmp_path / "000003.png")
    follow = from_files().follow(clip(tmp_path))
    assert (follow(3, "other name", IMAGE) == HALF).all()
    soft = HALF.copy()
    soft[:, 3] = 127
    Image.fromarray(soft).save(tmp_path / "soft.png")
    assert (follow(0, "soft", IMAGE) == soft).all()


def test_files_that_cannot_be_used(tmp_path):
    follow = from_files().follow(clip(tmp_path))
    Image.new("L", (4, 6)).save(tmp_path / "turned.png")
    (tmp_path / "broken.png").write_bytes(b"?")
    for name, reason in (
        ("none", "mask is missing"),
        ("turned", r"mask has another size than its image \(4 x 6\)"),
        ("broken", "mask does not decode"),
    ):
        with pytest.raises(ViewnetError, match=f"^{reason}"):
            follow(0, name, IMAGE)
    with pytest.raises(ViewnetError, match="mask is missing"):
        from_files().follow(clip(None))(0, "none", IMAGE)


def test_the_images_own_alpha():
    image = IMAGE.copy()
    image.putalpha(Image.fromarray(HALF))
    follow = from_alpha().follow(clip())
    assert (follow(0, "", image) == HALF).all()
    with pytest.raises(ViewnetError, match="the image has no alpha"):
        follow(0, "", IMAGE)


def test_the_largest_object_is_followed_even_when_another_becomes_larger():
    def objects(*spans: tuple[int, int]) -> np.ndarray:
        found = np.zeros((len(spans), 4, 20), bool)
        for mask, (first, last) in zip(found, spans, strict=True):
            mask[:, first:last] = True
        return found

    frames = iter([
        objects((0, 5), (10, 17)),  # the second is larger
        objects((0, 9), (9, 15)),  # the first is, but the second is where it was
        objects(),
        objects((8, 14), (14, 20)),
        objects((0, 2), (18, 19)),  # nothing at the old place: the larger
    ])  # fmt: skip
    follow = from_segmenter(lambda image: next(frames), {}).follow(clip())
    found = []
    for number in range(5):
        try:
            found.append(int(np.flatnonzero(follow(number, "", IMAGE)[0])[0]))
        except ViewnetError as error:
            assert str(error).startswith("mask is missing")
            found.append(None)
    assert found == [10, 9, None, 8, 0]


def test_regions_are_objects_and_specks_are_none():
    covered = np.zeros((20, 30), bool)
    covered[2:12, 2:12] = covered[5:10, 20:28] = covered[18, 29] = True
    assert sorted(region.sum() for region in regions(covered)) == [40, 100]
    assert len(regions(np.zeros((4, 4), bool))) == 0


def made_up(network: nn.Module, file: Path, **values: torch.Tensor) -> Path:
    """A small file of weights for a large network: zeros except variances and `values` by name (__ for a dot)."""
    state = {
        name: torch.full((), float(name.endswith("running_var")), dtype=value.dtype).expand(value.shape)
        for name, value in network.state_dict().items()
    }
    for name, value in values.items():
        assert name.replace("__", ".") in state
        state[name.replace("__", ".")] = value
    torch.save(state, file)
    assert file.stat().st_size < 1e6
    return file


def test_deeplab_finds_what_it_holds_for_the_category(tmp_path, monkeypatch):
    monkeypatch.setattr(masks, "SIDE", 32)
    network = segmentation.deeplabv3_resnet50(weights=None, weights_backbone=None, aux_loss=True)
    file = made_up(network, tmp_path / "deeplab.pth", classifier__4__bias=10 * torch.eye(21)[7])  # 7 is car
    monkeypatch.setenv("VIEWNET_DEEPLABV3_RESNET50_WEIGHTS", str(file))
    sources = [predicted("deeplabv3", category) for category in ("car", "chair")]
    cars, chairs = (source.follow(clip()) for source in sources)
    assert (cars(0, "", IMAGE.resize((60, 40))) == 255).all()
    with pytest.raises(ViewnetError, match=r"mask is missing \(nothing of the class"):
        chairs(0, "", IMAGE.resize((60, 40)))
    assert sources[0].described != sources[1].described and sources[0].described["masks"] == "deeplabv3"


@pytest.mark.slow
def test_mask_rcnn_gives_instances_of_the_category(tmp_path, monkeypatch):
    network = detection.maskrcnn_resnet50_fpn(weights=None, weights_backbone=None)
    names = detection.MaskRCNN_ResNet50_FPN_Weights.COCO_V1.meta["categories"]
    file = made_up(
        network,
        tmp_path / "maskrcnn.pth",
        # Every proposal is a couch with certainty, and its mask fills its box.
        roi_heads__box_predictor__cls_score__bias=20 * torch.eye(91)[names.index("couch")],
        roi_heads__mask_predictor__mask_fcn_logits__bias=torch.full((91,), 9.0),
    )
    monkeypatch.setattr(detection.mask_rcnn.MaskRCNN, "forward", _at_a_small_size(detection.mask_rcnn.MaskRCNN.forward))
    found = segmenter("maskrcnn", "sofa", file)(IMAGE.resize((60, 40)))
    assert found.dtype == bool and found.shape[1:] == (40, 60) and len(found) and found.any((1, 2)).all()
    assert not len(segmenter("maskrcnn", "car", file)(IMAGE.resize((60, 40))))


def _at_a_small_size(forward):
    def run(self, images, targets=None):
        self.transform.min_size, self.transform.max_size = (40,), 60
        return forward(self, images, targets)

    return run


def test_every_category_has_a_class_of_both_networks():
    coco = detection.MaskRCNN_ResNet50_FPN_Weights.COCO_V1.meta["categories"]
    voc = segmentation.DeepLabV3_ResNet50_Weights.COCO_WITH_VOC_LABELS_V1.meta["categories"]
    for category in masks.CATEGORIES:
        assert category in voc and masks.COCO.get(category, category) in coco


def test_missing_and_wrong_weights_are_told(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.delenv("VIEWNET_MASKRCNN_RESNET50_FPN_WEIGHTS", raising=False)
    with pytest.raises(ViewnetError, match=r"maskrcnn.*hub/checkpoints/.*_FPN_WEIGHTS"):
        predicted("maskrcnn", "car")
    torch.save({"backbone.body.conv1.weight": torch.zeros(3)}, tmp_path / "w.pth")
    with pytest.raises(ViewnetError, match=r"w\.pth does not hold maskrcnn"):
        segmenter("maskrcnn", "car", tmp_path / "w.pth")
    with pytest.raises(ViewnetError, match="masks 'yolo'"):
        predicted("yolo", "car")
