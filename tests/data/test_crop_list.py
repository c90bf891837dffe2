"""Crops with a list of angles: which are used, what is named, and the convention of the angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.photo_data import write_crops
from PIL import Image

from viewnet.config import PhotoConfig
from viewnet.data.build import photo_views
from viewnet.data.catalogue import check
from viewnet.data.photo_store import summary
from viewnet.data.readers import crop_list
from viewnet.errors import ViewnetError
from viewnet.evaluation.alignment import ALIGNMENTS
from viewnet.geometry import view_vector

RNG = np.random.default_rng(0)
VIEWPOINTS = [
    (float(azimuth), float(elevation)) for azimuth, elevation in RNG.uniform((0, -10), (360, 40), (40, 2)).round(1)
]


def vectors(root: Path) -> np.ndarray:
    """View vectors (N, 3) of all crops, in the order of the list."""
    crops = sorted(crop_list.read(root, "chair").usable, key=lambda crop: int(crop.id))
    angles = torch.tensor([(crop.azimuth, crop.elevation) for crop in crops], dtype=torch.float64)  # (N, 2)
    return view_vector(*angles.T).numpy()


@pytest.fixture
def bench(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    write_crops(tmp_path / "bench", VIEWPOINTS)
    return tmp_path / "bench"


def relist(root: Path, *rows: str, header: str = "img_idx,category_name,azi,ele,rot") -> None:
    (root / f"{root.name}_meta.csv").write_text("\n".join([header, *rows]) + "\n")


def test_crops_become_a_store(bench):
    store = photo_views(PhotoConfig("chair", str(bench), size=16), 1, False)
    assert summary(store) == "chair: 8 calibrate, 32 scored"
    by_id = store.index.set_index("model_id")
    assert [tuple(by_id.loc[str(k), ["azimuth", "elevation"]]) for k in range(40)] == VIEWPOINTS
    before = store.identity
    text = (bench / "bench_meta.csv").read_text()
    (bench / "bench_meta.csv").write_text(text.replace("chair,", "chair,1", 1))
    assert photo_views(PhotoConfig("chair", str(bench), size=16), 1, False).identity != before


def test_the_published_layout_of_objectron_s_crops_is_read_too(bench):
    (bench / "bench_data").mkdir()
    (bench / "test_crop").rename(bench / "bench_data/test_crop")
    assert len(crop_list.read(bench, "chair").usable) == 40 and check(bench).key == "crops"


def test_what_cannot_be_used_is_named(bench):
    Image.new("RGB", (8, 8)).save(bench / "test_crop/7.png")
    relist(
        bench,
        *("0,chair,370,5,0", "1,Couch,-10,5,350", "2,tv_monitor,0,5,0", "3,stool,0,5,0", "4,cereal_box,0,5,0"),
        *("99,chair,0,0,0", "5,chair,north,0,0", "6,chair,0,,0", "7,chair,0,0,0", "8,chair,0,91,0", "9,chair,0,0,-90"),
        *("10,chair,0,0,nan", "0,chair,1,1,0"),
    )
    found = crop_list.read(bench, "chair")
    assert [(crop.id, crop.azimuth, crop.elevation) for crop in found.usable] == [("0", 10, 5)]
    assert [(name, path, reason) for name, path, reason in found.rejected] == [
        ("99", "bench_meta.csv: line 7", "no such image (img_idx '99')"),
        ("5", "bench_meta.csv: line 8", "angle is no number (azi 'north')"),
        ("6", "bench_meta.csv: line 9", "angle is no number (ele '')"),
        ("7", "bench_meta.csv: line 10", "several images (7.jpg, 7.png)"),
        ("8", "bench_meta.csv: line 11", "elevation beyond 90 degrees (ele 91)"),
        ("9", "bench_meta.csv: line 12", "object lies on its side in the image (rot -90)"),
        ("10", "bench_meta.csv: line 13", "angle is no number (rot 'nan')"),
        ("0", "bench_meta.csv: line 14", "crop listed twice"),
    ]
    assert [crop.azimuth for crop in crop_list.read(bench, "sofa").usable] == [350]
    checked = check(bench)
    assert checked.counts["tvmonitor"] == {"objects to score": 1}
    assert not any(problem.startswith("chair: 2 left out: angle is no number") for problem in checked.problems)
    assert "chair: 3 left out: angle is no number: 5 and 2 more" in checked.problems
    assert "left out, of other categories: 1 stool, 1 cereal_box" in checked.problems


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        ("img_idx,category_name,azi,rot", ["0,chair,1,1"], r"bench_meta.csv: column 'ele' is missing"),
        ("img_idx,category_name,azi,ele", ["0,chair,1,1", "1,stool,1,1"], r"no crop of car .*1 chair, 1 stool"),
        ("img_idx,category_name,azi,ele", [], r"no crop of car .*no rows"),
    ],
)
def test_a_list_that_cannot_be_used_is_named(bench, header, rows, message):
    relist(bench, *rows, header=header)
    with pytest.raises(ViewnetError, match=message):
        crop_list.read(bench, "car")


def test_one_list_is_expected_and_there_are_no_flags(bench):
    with pytest.raises(ViewnetError, match="use keep='all'"):
        photo_views(PhotoConfig("chair", str(bench), keep="easy"), 1, False)
    (bench / "other_meta.csv").write_text("img_idx\n")
    with pytest.raises(ViewnetError, match=r"expected one list .*bench_meta.csv, other_meta.csv"):
        crop_list.read(bench, "chair")


def test_angles_are_those_of_the_published_rotations(bench):
    """The viewer is on the x axis of the frame that Rx(rot) Ry(ele) Rz(-azi) takes the object to."""

    def turn(axis: int, degrees: float) -> np.ndarray:
        cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        matrix = np.eye(3)
        matrix[np.ix_([(axis + 1) % 3, (axis + 2) % 3], [(axis + 1) % 3, (axis + 2) % 3])] = [
            [cosine, -sine],
            [sine, cosine],
        ]
        return matrix

    expected = [(turn(0, 20) @ turn(1, ele) @ turn(2, -azi)).T @ [1, 0, 0] for azi, ele in VIEWPOINTS]
    assert np.allclose(vectors(bench), expected, atol=1e-5)


def test_alignment_removes_another_zero_and_no_mirror(bench, tmp_path):
    truth = vectors(bench)
    lists = {"zero": [(azi + 37, ele) for azi, ele in VIEWPOINTS], "sense": [(-azi, ele) for azi, ele in VIEWPOINTS]}
    errors: dict[tuple[str, str], np.ndarray] = {}
    for name, viewpoints in lists.items():
        write_crops(tmp_path / name, viewpoints)
        theirs = vectors(tmp_path / name)
        for kind in ("procrustes", "yaw"):
            aligned = ALIGNMENTS[kind].fit(truth, theirs).apply(truth)
            errors[name, kind] = np.rad2deg(np.arccos((aligned * theirs).sum(axis=1).clip(-1, 1)))
    assert errors["zero", "procrustes"].max() < 0.1 > errors["zero", "yaw"].max()
    # Upside down, a mirrored list fits again but for elevations, which are off by twice their size.
    elevations = np.abs([elevation for _, elevation in VIEWPOINTS])
    assert np.corrcoef(errors["sense", "procrustes"], 2 * elevations)[0, 1] > 0.8
    assert np.median(errors["sense", "procrustes"]) > 20 and np.median(errors["sense", "yaw"]) > 60
