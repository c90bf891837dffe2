"""`viewnet bench`: renderer and training step against the textbook version of the same work, in one run.

The two take turns on one machine, so that only their ratio is claimed; see `benchmarks/README.md`.
"""

import datetime
import math
import statistics
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from viewnet import reference
from viewnet.bench import contestants
from viewnet.bench.contestants import BOTH, EXACT, FORWARD, STEP, VIEWS, Work
from viewnet.bench.roofline import Need, Rates, lit_samples, render_need, step_need
from viewnet.config import RunConfig
from viewnet.data.build import view_store
from viewnet.errors import ViewnetError
from viewnet.model import volume
from viewnet.model.kernels import volume_cpu
from viewnet.recipes import make_config
from viewnet.runtime import parallel, provenance
from viewnet.runtime.progress import bar
from viewnet.tables.benchmark import CONTESTANTS
from viewnet.training.train import train

SCHEMA = 1
GOALS = {"car": (80, 90), "aeroplane": (80,)}
"""Category of built-in models, and accuracies on validation views in per cent."""
COLUMNS = (
    "work", "volume", "size", "device", "images",
    "textbook_s", "textbook_low", "textbook_high", "viewnet_s", "viewnet_low", "viewnet_high",
    "speedup", "speedup_low", "speedup_high", "textbook_images_per_s", "viewnet_images_per_s",
    "textbook_bytes", "viewnet_bytes", "memory_ratio",
    "growth_expected", "textbook_growth", "viewnet_growth", "textbook_memory_growth", "viewnet_memory_growth",
    "floor_s", "textbook_over_floor", "viewnet_over_floor",
)  # fmt: skip
"""The columns of a row. Seconds are per call: median, least and most; None where nothing was measured."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """The settings of a measurement. Raises ViewnetError for a value out of range.

    sizes       voxels along a side, and pixels of the image, of the renderer's rows
    batch       target images of a training step; the renderer's rows have a quarter as many volumes, two at least
    repeat      measurements of each contestant
    quick       everything small: a check that it works, and no measurement
    threads     CPU threads
    accuracy    seeds from which the recipe `matting` is trained on built-in models, for the time to an accuracy
    """

    sizes: tuple[int, ...] = (32, 64, 128)
    batch: int = 16
    repeat: int = 5
    quick: bool = False
    threads: int = 1
    accuracy: int = 0

    def __post_init__(self) -> None:
        ranges = {"batch": (2, 4096), "repeat": (1, 1000), "threads": (1, 1024), "accuracy": (0, 100)}
        values = [("size", size, 8, 512) for size in self.sizes]
        values += [(name, getattr(self, name), *limits) for name, limits in ranges.items()]
        for name, value, least, most in values:
            if not least <= value <= most:
                raise ViewnetError(f"{name} {value}: expected {least} to {most}")
        if list(self.sizes) != sorted(set(self.sizes)):
            raise ViewnetError(f"sizes {' '.join(map(str, self.sizes))}: name each once, the smallest first")

    @classmethod
    def default(cls, **given: Any) -> "Settings":
        """With the machine's defaults for values that are None or not given."""
        defaults: dict[str, Any] = {"batch": 64} if torch.cuda.is_available() else {}
        if given.get("quick", False):
            defaults = {"sizes": (8, 16), "batch": 4, "repeat": 2}
        given = {name: value for name, value in given.items() if value is not None}
        return cls(**{"threads": parallel.cores(), **defaults, **given})

    @property
    def volumes(self) -> int:
        """Volumes in the renderer's rows."""
        return max(2, self.batch // 4)

    def works(self) -> list[Work]:
        """In the order of the table."""
        works = []
        renderings = (FORWARD, "object"), (BOTH, "object"), (FORWARD, "dense"), (BOTH, "dense"), (EXACT, "object")
        for kind, occupancy in renderings:
            memory = kind == BOTH and occupancy == "object" and not self.quick
            works += [Work(kind, occupancy, size, self.volumes, memory=memory) for size in self.sizes]
        for profile in ("smoke",) if self.quick else ("tiny", "paper"):
            size = contestants.step_config(profile).model.volume_size
            works += [Work(STEP, kind, size, self.batch, profile, kind == "object") for kind in ("object", "initial")]
        return works


def measure(settings: "Settings", progress: bool = True) -> dict[str, Any]:
    """Everything, as `bench.json` has it: settings, machine, and rows with the columns COLUMNS."""
    works = settings.works()

    def measured(device: torch.device, rates: Rates) -> list[Row]:
        rows = []
        steps = bar(progress, iterable=works, unit="row")
        for work in steps:
            steps.set_description(f"{work.kind}, {work.occupancy}, {work.size}")
            rows.append(_row(work, settings, rates, device))
        if device.type == "cpu":  # a GPU's rows, named and empty
            rows += [_empty(w.kind, w.occupancy, w.size, "cuda", w.profile) for w in works if w.memory]
        return _with_growth(rows + time_to_accuracy(settings, device, progress))

    told = {name: value for name, value in asdict(settings).items() if name != "accuracy"}
    told |= {"sizes": list(settings.sizes), "volumes": settings.volumes, "views": VIEWS, "perceptual": "none"}
    return recorded(settings, told, measured)


def recorded(
    settings: "Settings", told: dict[str, Any], measure: Callable[[torch.device, Rates], list[Row]]
) -> dict[str, Any]:
    """What a measurement's file holds: the settings that are `told`, the machine, and the rows that are measured."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    threads_before, started = torch.get_num_threads(), datetime.datetime.now(datetime.UTC)
    torch.set_num_threads(settings.threads)
    try:
        volume_cpu.warm_up()
        rates = Rates.measure(device, settings.quick)
        rows = measure(device, rates)
    finally:
        torch.set_num_threads(threads_before)
    return {
        "schema": SCHEMA,
        "started": started.isoformat(timespec="seconds"),
        "settings": told | {"device": device.type},
        "hardware": provenance.hardware(settings.threads),
        "rates": {
            "float32_multiply_adds_per_s": rates.float32,
            "bfloat16_multiply_adds_per_s": rates.bfloat16,
            "copy_bytes_per_s": rates.copy,
        },
        "versions": provenance.versions((*provenance.LIBRARIES, "triton")),
        "git": provenance.commit(),
        "rows": rows,
    }


def _empty(kind: str, occupancy: str, size: int | None, device: str, profile: str = "") -> Row:
    """A row with nothing measured yet."""
    name = f"{kind}, {profile}" if profile else kind
    return dict.fromkeys(COLUMNS) | {"work": name, "volume": occupancy, "size": size, "device": device}


def _row(work: Work, settings: "Settings", rates: Rates, device: torch.device) -> Row:
    row = _empty(work.kind, work.occupancy, work.size, device.type, work.profile)
    calls = {name: contestants.prepare(work, name, device) for name in CONTESTANTS}
    times = contestants.in_turn(calls, settings.repeat, device, 0.0 if settings.quick else 0.2)
    del calls
    floor = need(work, device).seconds(rates)
    row |= {"images": work.images, "floor_s": floor}
    for name in CONTESTANTS:
        row |= _spread(name, "_s", times[name])
        seconds = row[f"{name}_s"]
        row |= {f"{name}_images_per_s": work.images / seconds, f"{name}_over_floor": seconds / floor}
        if work.memory:
            row[f"{name}_bytes"] = contestants.peak_memory(work, name, device, settings.threads)
    row["memory_ratio"] = _ratio(row["textbook_bytes"], row["viewnet_bytes"])
    # Measurements of one round are neighbours in time: what slows one down is likely to slow the other.
    pairs = [slow / fast for slow, fast in zip(times["textbook"], times["viewnet"], strict=True)]
    return row | _spread("speedup", "", pairs)


def need(work: Work, device: torch.device) -> Need:
    """The least amount of a work: layers, and ray samples that are not empty and that light reaches.

    A training step renders each head's image forward and the best one's backward.
    """
    size = work.size
    occupancy = "dense" if work.occupancy == "initial" else work.occupancy
    shape = volume.squash(contestants.logits(occupancy, size, 1).to(device), None).expand(VIEWS, -1, -1, -1, -1)
    cameras, focal = contestants.camera_frames(VIEWS).to(device), torch.tensor(contestants.FOCAL, device=device)
    with torch.no_grad():
        samples = lit_samples(reference.rotate(shape, cameras, focal, size, size)) / VIEWS

    def rendering(images: int, backward: bool) -> Need:
        return render_need(samples * images, work.batch * size**3, images * size**2, backward)

    if work.kind != STEP:
        return rendering(work.images, work.kind != FORWARD)
    config = contestants.step_config(work.profile).model
    return step_need(config, work.batch) + rendering(config.heads * work.batch, False) + rendering(work.batch, True)


def _with_growth(rows: list[Row]) -> list[Row]:
    """Rows with their growth over the row of the next smaller size."""
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


def time_to_accuracy(settings: "Settings", device: torch.device, progress: bool) -> list[Row]:
    """A row for each of GOALS: seconds of the package's training, validation after every epoch included.

    The median over the seeds, where more than half of them reached the accuracy, and least and most of those that did.
    """
    profile = "smoke" if settings.quick else "tiny"
    rows = []
    for category, levels in GOALS.items():
        make = partial(make_config, "viewnet", category, profile, "matting", validate_every=1)
        configs = [make(seed=seed) for seed in range(settings.accuracy)]
        logs = [training_log(config, settings.threads, progress) for config in configs]
        for level in levels:
            row = _empty(f"time to {level} % of validation views", category, None, device.type)
            row["size"] = configs[0].model.volume_size if configs else None
            times = [seconds for log in logs if (seconds := first_reached(log, level)) is not None]
            if 2 * len(times) > len(logs):
                middle = statistics.median_high(times + [math.inf] * (len(logs) - len(times)))
                row |= {"viewnet_s": middle, "viewnet_low": min(times), "viewnet_high": max(times)}
            rows.append(row)
    return rows


def training_log(config: RunConfig, threads: int, progress: bool) -> pd.DataFrame:
    """The log of a training that is thrown away."""
    views = view_store(config.data, progress=progress)
    with tempfile.TemporaryDirectory() as folder:
        train(config, views, Path(folder), threads=threads, progress=progress)
        return pd.read_csv(Path(folder) / "log.csv")


def first_reached(log: pd.DataFrame, level: float) -> float | None:
    """Seconds of a training's log when validation accuracy was first `level` per cent or more, or None."""
    reached = log.loc[log["val_accuracy"] >= level, "seconds"]
    return float(reached.iloc[0]) if len(reached) else None


def _spread(name: str, unit: str, values: list[float]) -> Row:
    return {f"{name}{unit}": statistics.median(values), f"{name}_low": min(values), f"{name}_high": max(values)}


def _ratio(above: float | None, below: float | None) -> float | None:
    return above / below if above and below else None
