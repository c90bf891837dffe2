"""`viewnet bench`: renderer and training step against the textbook version of the same work, in one run.

The two do the work in turn on one machine, so that only their ratio is claimed; `benchmarks/README.md` says what is
compared and how to read it.
"""

from __future__ import annotations

import datetime
import math
import statistics
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from viewnet.bench import contestants, textbook
from viewnet.bench.contestants import BOTH, EXACT, FORWARD, STEP, VIEWS, Work
from viewnet.bench.roofline import Need, Rates, drawing_need, lit_samples, step_need
from viewnet.config import RunConfig
from viewnet.errors import ViewnetError
from viewnet.model import volume
from viewnet.model.kernels import volume_cpu
from viewnet.recipes import make_config
from viewnet.runtime import provenance
from viewnet.runtime.parallel import cores
from viewnet.runtime.progress import bar
from viewnet.tables.benchmark import CONTESTANTS

SCHEMA = 1
SIZES = (32, 64, 128)
QUICK_SIZES = (8, 16)
BATCH, BATCH_GPU, BATCH_QUICK = 16, 64, 4
GOALS = (("car", 80), ("car", 90), ("aeroplane", 80))
"""Category of built-in models, and accuracy on validation views in per cent."""
COLUMNS = (
    "work", "volume", "size", "device", "images",
    "textbook_s", "textbook_low", "textbook_high", "viewnet_s", "viewnet_low", "viewnet_high",
    "speedup", "speedup_low", "speedup_high", "textbook_images_per_s", "viewnet_images_per_s",
    "textbook_bytes", "viewnet_bytes", "memory_ratio",
    "growth_expected", "textbook_growth", "viewnet_growth", "textbook_memory_growth", "viewnet_memory_growth",
    "floor_s", "textbook_over_floor", "viewnet_over_floor",
)  # fmt: skip
"""Of a row. Seconds are of one call, the median with the least and the most; empty where nothing was measured."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """What is measured. Raises ViewnetError for what cannot be.

    sizes       voxels along a side, and pixels of the image, of the renderer's rows
    batch       target images of a training step; the renderer's rows draw a quarter as many volumes, two at least
    repeat      measurements of each contestant
    quick       everything small: a check that it works, and no measurement
    threads     of the processor
    accuracy    seeds from which the recipe `matting` is trained on built-in models, for the time it takes to learn
    """

    sizes: tuple[int, ...] = SIZES
    batch: int = BATCH
    repeat: int = 5
    quick: bool = False
    threads: int = 1
    accuracy: int = 0

    def __post_init__(self) -> None:
        for name, value, least, most in (
            *(("size", size, 8, 512) for size in self.sizes),
            ("batch", self.batch, 2, 4096),
            ("repeat", self.repeat, 1, 1000),
            ("threads", self.threads, 1, 1024),
            ("accuracy", self.accuracy, 0, 100),
        ):
            if not least <= value <= most:
                raise ViewnetError(f"{name} {value}: expected {least} to {most}")
        if list(self.sizes) != sorted(set(self.sizes)):
            raise ViewnetError(f"sizes {' '.join(map(str, self.sizes))}: name each once, the smallest first")

    @classmethod
    def default(cls, **given: Any) -> Settings:
        """With what is None, or not given, by the machine."""
        quick = given.get("quick", False)
        gpu = torch.cuda.is_available()
        usual: dict[str, Any] = {
            "sizes": QUICK_SIZES if quick else SIZES,
            "batch": BATCH_QUICK if quick else BATCH_GPU if gpu else BATCH,
            "repeat": 2 if quick else 5,
            "threads": cores(),
        }
        return cls(**usual | {name: value for name, value in given.items() if value is not None})

    @property
    def volumes(self) -> int:
        """How many volumes the renderer's rows draw."""
        return max(2, self.batch // 4)

    def works(self) -> list[Work]:
        """In the order of the table."""
        volumes = self.volumes
        found = [Work(FORWARD, "object", size, volumes) for size in self.sizes]
        found += [Work(BOTH, "object", size, volumes, memory=not self.quick) for size in self.sizes]
        found += [Work(kind, "dense", size, volumes) for kind in (FORWARD, BOTH) for size in self.sizes]
        found += [Work(EXACT, "object", size, volumes) for size in self.sizes]
        for profile in ("smoke",) if self.quick else ("tiny", "paper"):
            size = contestants.step_config(profile).model.volume_size
            found += [Work(STEP, kind, size, self.batch, profile, memory=kind == "object") for kind in OCCUPANCIES]
        return found


OCCUPANCIES = ("object", "initial")


def measure(settings: Settings, progress: bool = True) -> dict[str, Any]:
    """Everything, as `bench.json` has it: settings, machine, and rows as COLUMNS."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    before, started = torch.get_num_threads(), datetime.datetime.now(datetime.UTC)
    torch.set_num_threads(settings.threads)
    works = settings.works()
    shown = bar(progress, total=len(works) + 1 + bool(settings.accuracy), unit="row")
    try:
        volume_cpu.warm_up()
        rates = Rates.measure(device, settings.quick)
        shown.update()
        rows = []
        for work in works:
            shown.set_description(f"{work.kind}, {work.occupancy}, {work.size}")
            rows.append(_row(work, settings, rates, device))
            shown.update()
        if device.type == "cpu":
            rows += [_named(work.kind, work.occupancy, work.size, "cuda", work.profile) for work in _on_gpu(works)]
        if settings.accuracy:
            shown.set_description("training to accuracy")
        rows += _accuracy(settings, device, progress)
        shown.update(bool(settings.accuracy))
    finally:
        shown.close()
        torch.set_num_threads(before)
    return {
        "schema": SCHEMA,
        "started": started.isoformat(timespec="seconds"),
        "settings": {
            "sizes": list(settings.sizes),
            "batch": settings.batch,
            "volumes": settings.volumes,
            "views": VIEWS,
            "repeat": settings.repeat,
            "quick": settings.quick,
            "threads": settings.threads,
            "device": device.type,
            "perceptual": "none",
        },
        "hardware": provenance.hardware(settings.threads),
        "rates": {
            "float32_multiply_adds_per_s": rates.float32,
            "bfloat16_multiply_adds_per_s": rates.bfloat16,
            "copy_bytes_per_s": rates.copy,
        },
        "versions": provenance.versions((*provenance.LIBRARIES, "triton")),
        "git": provenance.commit(),
        "rows": _with_growth(rows),
    }


def _on_gpu(works: Iterable[Work]) -> list[Work]:
    """What would be measured first on a GPU: told to be missing where there is none."""
    return [work for work in works if work.memory]


def _named(kind: str, occupancy: str, size: int | None, device: str, profile: str = "") -> Row:
    """A row with nothing measured yet."""
    named = {"work": f"{kind}, {profile}" if profile else kind, "volume": occupancy, "size": size, "device": device}
    return dict.fromkeys(COLUMNS) | named


def _row(work: Work, settings: Settings, rates: Rates, device: torch.device) -> Row:
    row = _named(work.kind, work.occupancy, work.size, device.type, work.profile)
    calls = {name: contestants.prepare(work, name, device) for name in CONTESTANTS}
    found = contestants.in_turn(calls, settings.repeat, device, 0.0 if settings.quick else 0.2)
    del calls
    for name, times in found.items():
        row |= dict(zip((f"{name}_s", f"{name}_low", f"{name}_high"), _spread(times), strict=True))
        row[f"{name}_images_per_s"] = work.images / row[f"{name}_s"]
    # Measurements of one round are neighbours in time: what slows one down is likely to slow the other.
    pairs = [slow / fast for slow, fast in zip(found["textbook"], found["viewnet"], strict=True)]
    row |= dict(zip(("speedup", "speedup_low", "speedup_high"), _spread(pairs), strict=True))
    if work.memory:
        for name in CONTESTANTS:
            row[f"{name}_bytes"] = contestants.peak_memory(work, name, device, settings.threads)
        row["memory_ratio"] = _ratio(row["textbook_bytes"], row["viewnet_bytes"])
    floor = need(work, device).seconds(rates)
    row |= {"images": work.images, "floor_s": floor}
    return row | {f"{name}_over_floor": row[f"{name}_s"] / floor for name in CONTESTANTS}


def need(work: Work, device: torch.device) -> Need:
    """What a work cannot do without: layers, and ray samples where there is something that light reaches.

    A training step draws each head's image forward and the best one's backward.
    """
    module, size = textbook, work.size
    occupancy = "dense" if work.occupancy == "initial" else work.occupancy
    shape = volume.squash(contestants.logits(occupancy, size, 1).to(device), None, None)
    cameras = contestants.frames(VIEWS).to(device)
    with torch.no_grad():
        shapes = shape.expand(VIEWS, -1, -1, -1, -1)
        rotated = module.rotate(shapes, cameras, torch.tensor(contestants.FOCAL, device=device), size, size)
    samples = lit_samples(rotated) / VIEWS
    if work.kind != STEP:
        backward = work.kind != FORWARD
        return drawing_need(samples * work.images, work.batch * size**3, work.images * size**2, backward)
    config = contestants.step_config(work.profile).model
    heads = config.heads * work.batch
    drawing = drawing_need(samples * heads, work.batch * size**3, heads * size**2, False)
    again = drawing_need(samples * work.batch, work.batch * size**3, work.batch * size**2, True)
    return step_need(module, config, work.batch) + drawing + again


def _with_growth(rows: list[Row]) -> list[Row]:
    """Rows of the renderer with how much more each is than the one before it, of the next smaller size."""
    before: dict[tuple[str, str, str], Row] = {}
    for row in rows:
        key = (row["work"], row["volume"], row["device"])
        if (last := before.get(key)) and row["textbook_s"] is not None:
            # Voxels, and points on all rays together, grow by the third power; only pixels by the second.
            row["growth_expected"] = (row["size"] / last["size"]) ** 3
            for name in CONTESTANTS:
                row[f"{name}_growth"] = row[f"{name}_s"] / last[f"{name}_s"]
                row[f"{name}_memory_growth"] = _ratio(row[f"{name}_bytes"], last[f"{name}_bytes"])
        before[key] = row
    return rows


def _accuracy(settings: Settings, device: torch.device, progress: bool) -> list[Row]:
    """A row for each of GOALS: seconds of training, validation after every epoch included; the textbook has none.

    The median over the seeds, where more than half of them came so far, and the least and the most of those that did.
    """
    rows = [_named(f"time to {level} % of validation views", category, None, device.type) for category, level in GOALS]
    if not settings.accuracy:
        return rows
    profile = "smoke" if settings.quick else "tiny"
    logs: dict[str, list[pd.DataFrame]] = {}
    for (category, level), row in zip(GOALS, rows, strict=True):
        configs = [
            make_config("viewnet", category, profile, "matting", s, validate_every=1) for s in range(settings.accuracy)
        ]
        if category not in logs:
            logs[category] = [_trained(config, settings.threads, progress) for config in configs]
        times = [seconds for log in logs[category] if (seconds := first_reached(log, level)) is not None]
        row["size"] = configs[0].model.volume_size
        if 2 * len(times) > len(configs):
            middle = statistics.median_high(times + [math.inf] * (len(configs) - len(times)))
            row |= {"viewnet_s": middle, "viewnet_low": min(times), "viewnet_high": max(times)}
    return rows


def _trained(config: RunConfig, threads: int, progress: bool) -> pd.DataFrame:
    """The log of a training that is not kept."""
    from viewnet.data.build import view_store
    from viewnet.training.train import train

    views = view_store(config.data, progress=progress)
    with tempfile.TemporaryDirectory() as folder:
        train(config, views, Path(folder), threads=threads, progress=progress)
        return pd.read_csv(Path(folder) / "log.csv")


def first_reached(log: pd.DataFrame, level: float) -> float | None:
    """Seconds of a training's log when validation accuracy was first `level` percent or more, or None."""
    reached = log.loc[log["val_accuracy"] >= level, "seconds"]
    return float(reached.iloc[0]) if len(reached) else None


def _spread(values: list[float]) -> tuple[float, float, float]:
    return statistics.median(values), min(values), max(values)


def _ratio(above: float | None, below: float | None) -> float | None:
    return above / below if above and below else None
