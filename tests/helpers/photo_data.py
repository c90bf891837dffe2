"""Synthetic photographs: view stores whose images encode their viewpoint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from viewnet.config import CATEGORIES, PhotoConfig
from viewnet.data import augment
from viewnet.data.store import ViewStore, write_store
from viewnet.evaluation import features


def keep_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put runs, data, tables and weights of a test into `tmp_path`, whatever the environment; small features.

    And few backgrounds, as a thousand take ten seconds to draw.
    """
    monkeypatch.delenv("VIEWNET_PROFILE", raising=False)
    for name in ("VIEWNET_VGG16_WEIGHTS", "VIEWNET_SQUEEZENET_WEIGHTS"):
        monkeypatch.delenv(name, raising=False)
    for name in ("RUNS", "DATA", "TABLES"):
        monkeypatch.setenv(f"VIEWNET_{name}", str(tmp_path / name.lower()))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setattr(features, "SIZE", 32)
    monkeypatch.setattr(augment, "COUNT", 20)
    return tmp_path


def fake_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[PhotoConfig]:
    """Have experiments use made photographs; what configurations they ask for is in the list."""
    configs: list[PhotoConfig] = []

    def views(config: PhotoConfig, workers: int | None = None, progress: bool = True) -> ViewStore:
        configs.append(config)
        folder = tmp_path / "photos" / config.category
        if folder.exists():
            return ViewStore.open(folder)
        return make_photos(folder, category=config.category, seed=CATEGORIES.index(config.category))

    monkeypatch.setattr("viewnet.data.build.photo_views", views)
    monkeypatch.setattr(
        "viewnet.data.photo_store.summary", lambda store: f"{len(store)} used, {len(store.rejected)} left out"
    )
    return configs


def write_crops(
    root: Path, viewpoints: Sequence[tuple[float, float]], category: str = "chair", suffix: str = ".jpg"
) -> None:
    """Crops of noise with a list of their azimuths and elevations, in the layout of benchmarks of orientation."""
    rng = np.random.default_rng(0)
    (root / "test_crop").mkdir(parents=True)
    lines = ["img_idx,category_name,azi,ele,rot"]
    for number, (azimuth, elevation) in enumerate(viewpoints):
        pixels = rng.integers(0, 255, (24, 32, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(root / f"test_crop/{number}{suffix}")
        lines.append(f"{number},{category},{azimuth},{elevation},0")
    (root / f"{root.name}_meta.csv").write_text("\n".join(lines) + "\n")


def make_photos(
    folder: Path, count: int = 80, category: str = "car", size: int = 24, seed: int = 0, spread: float = 180.0
) -> ViewStore:
    """`count` photographs, half to calibrate on ("val") and half to score ("test"), azimuths within `spread` of 0.

    The position of a bright square encodes the azimuth, its brightness the elevation.
    """
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-spread, spread, count), rng.uniform(-10, 30, count)
    images = rng.integers(0, 30, (count, size, size, 4), dtype=np.uint8)
    images[..., 3] = 255
    turn = np.deg2rad(azimuth)
    places = (size / 2 + 0.3 * size * np.stack([np.sin(turn), np.cos(turn)], axis=1)).astype(int)
    for image, (row, column), height in zip(images, places, elevation, strict=True):
        image[row - 3 : row + 3, column - 3 : column + 3, :3] = int(160 + 2 * height)
    index = pd.DataFrame(
        {
            "model_id": [f"{category}-{i:04}" for i in range(count)],
            "category": category,
            "split": np.where(np.arange(count) % 2, "test", "val"),
            "view": np.zeros(count, np.int64),
            "azimuth": azimuth % 360,
            "elevation": elevation,
            "source": [f"{i:04}.jpg" for i in range(count)],
        }
    )
    made_by = {"photographs": [category, count, size, seed, spread]}
    return write_store(folder, [images], index, made_by, [("lost", "lost.jpg", "no such image")])
