"""Time until an image's viewpoint is predicted, and the time that the estimator adds to the network's own.

    python benchmarks/predicting.py [--model car] [--image docs/car.jpg] [--times 9] [-o paper_tables/benchmarks]

Starts `viewnet predict` in fresh interpreters, in turns with ones that only import torch, and gives the same images,
many at once, to the estimator and, ready on its device, to the bare network, in turns as well. Then 1,000 image files
are predicted, from the disk's cache to the viewpoints, by the estimator and by the command. `predicting.csv` has a row
for each: the median, and the least and the most of all times.
"""

from __future__ import annotations

import argparse
import functools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from PIL import Image

from viewnet import paths
from viewnet.estimator.viewpoint_estimator import BATCH, ViewpointEstimator
from viewnet.runtime import provenance
from viewnet.runtime.files import replacing, write_json

IMAGES = 8 * BATCH
"""The number of images predicted at once: several batches."""
FILES = 1000
"""The number of image files."""
PHOTOGRAPH, BOX = (400, 300), (40, 60, 380, 250)
"""Size of an image to crop, and the box, in pixels."""
BARE, READY = "the bare network", "the estimator, images of just the size"
CUT = "the estimator, photographs of 400 x 300 cut to a box"
JPEG, PNG = "1,000 JPEG files of 400 x 300 cut to a box", "1,000 PNG files of just the size"


def seconds(work: Callable[[], object]) -> float:
    """Seconds of some work."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def in_turns(pieces: dict[str, Callable[[], object]], times: int) -> dict[str, list[float]]:
    """Seconds of each piece of work, done once before it is measured."""
    for work in pieces.values():
        work()
    found: dict[str, list[float]] = {name: [] for name in pieces}
    for _ in range(times):
        for name, work in pieces.items():
            found[name].append(seconds(work))
    return found


def fresh(*arguments: str) -> Callable[[], object]:
    """A call of Python with these arguments, which must succeed."""
    environment = {**os.environ, "TQDM_DISABLE": "1"}
    return lambda: subprocess.run([sys.executable, *arguments], check=True, capture_output=True, env=environment)


def cold(model: str, image: Path, box: list[str], times: int) -> list[dict[str, object]]:
    """Rows of one prediction in a fresh interpreter."""
    arguments = ["-m", "viewnet", "predict", str(image), "--model", model, "--box", *box]
    pieces = {"a fresh interpreter, import torch": fresh("-c", "import torch"), "viewnet predict": fresh(*arguments)}
    return [row(name, "seconds", values) for name, values in in_turns(pieces, times).items()]


def batched(model: str, times: int) -> list[dict[str, object]]:
    """Rows of many images at once."""
    estimator = ViewpointEstimator.from_pretrained(model)
    rng, size = np.random.default_rng(0), estimator.framing.size
    views = rng.integers(0, 256, (IMAGES, size, size, 3), np.uint8)
    ready = torch.from_numpy(views).movedim(-1, 1).to(estimator.device).float().div_(255).split(BATCH)

    @torch.no_grad()
    def bare() -> None:
        found = [estimator.network.viewpoint(part) for part in ready]
        found[-1].logits.cpu()  # a GPU is waited for

    photographs = [Image.fromarray(view).resize(PHOTOGRAPH) for view in views[:BATCH]]
    found = in_turns(
        {
            BARE: bare,
            READY: lambda: estimator.predict(views),
            CUT: lambda: estimator.predict(photographs, boxes=[BOX] * len(photographs)),
        },
        times,
    )
    counts = {BARE: len(views), READY: len(views), CUT: len(photographs)}
    rows = [row(name, "images a second", [counts[name] / value for value in found[name]]) for name in found]
    shares = [100 * one / other for one, other in zip(found[BARE], found[READY], strict=True)]
    return [*rows, row("the estimator against the bare network, in the same turn", "%", shares)]


def from_files(model: str, image: Path, times: int) -> list[dict[str, object]]:
    """Rows of many image files, each read and decoded: by the estimator, and by a fresh interpreter."""
    estimator = ViewpointEstimator.from_pretrained(model)
    photograph, size = Image.open(image).convert("RGB").resize(PHOTOGRAPH), estimator.framing.size
    edges, pieces = [str(edge) for edge in BOX], dict[str, Callable[[], object]]()
    with tempfile.TemporaryDirectory() as folder:
        jpeg = [Path(folder) / f"{number:04d}.jpg" for number in range(FILES)]
        png = [path.with_suffix(".png") for path in jpeg]
        for number, (large, small) in enumerate(zip(jpeg, png, strict=True)):
            view = Image.fromarray(np.roll(photograph, number, axis=1))  # no two files are the same
            view.save(large, quality=90)
            view.crop(BOX).resize((size, size)).save(small)
        for name, files, boxes, more in ((JPEG, jpeg, [BOX] * FILES, ["--box", *edges]), (PNG, png, None, [])):
            command = ["-m", "viewnet", "predict", *map(str, files), "--model", model, *more]
            pieces[f"the estimator, {name}"] = functools.partial(estimator.predict, files, boxes=boxes)
            pieces[f"viewnet predict, {name}"] = fresh(*command)
        found = in_turns(pieces, times)
    return [row(name, "images a second", [FILES / value for value in values]) for name, values in found.items()]


def row(name: str, unit: str, values: list[float]) -> dict[str, object]:
    """A line of the table."""
    return {"what": name, "unit": unit, "median": np.median(values), "least": min(values), "most": max(values)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    root = Path(__file__).resolve().parent.parent
    parser.add_argument("--model", default="car", help="what viewnet predict takes (default: %(default)s)")
    parser.add_argument("--image", type=Path, default=root / "docs" / "car.jpg")
    parser.add_argument("--box", nargs=4, default=["129", "108", "341", "200"], metavar=("X0", "Y0", "X1", "Y1"))
    parser.add_argument("--times", type=int, default=9)
    parser.add_argument("-o", "--output", type=Path, default=paths.tables() / "benchmarks")
    options = parser.parse_args()
    model, image, times = options.model, options.image, options.times
    rows = cold(model, image, options.box, times) + batched(model, times) + from_files(model, image, times)
    found = pd.DataFrame(rows).round(2)
    print(found.to_string(index=False))
    options.output.mkdir(parents=True, exist_ok=True)
    threads = torch.get_num_threads()
    measured = {"hardware": provenance.hardware(threads), "versions": provenance.versions(), "git": provenance.commit()}
    with replacing(options.output / "predicting.csv") as temporary:  # after git was asked what has changed
        found.to_csv(temporary, index=False)
    write_json(options.output / "predicting.json", {"model": model, "times": times, **measured})


if __name__ == "__main__":
    main()
