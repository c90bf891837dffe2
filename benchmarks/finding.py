"""Time until the views of a collection that has not changed are found again.

    python benchmarks/finding.py [--models 5000] [--times 9]

Writes a collection of small models with materials into a temporary folder, makes its view store with one small view of
each, and asks for the same again, in turns with reading every file anew. Prints seconds of wall time and of the
process (user and system): what other load on the machine does is in the first alone.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from viewnet import paths
from viewnet.config import SYNSETS, DataConfig
from viewnet.data import contents
from viewnet.data.build import view_store

OBJ = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl a\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


def write_models(root: Path, count: int) -> None:
    """A collection of tetrahedra in different colours, two files each."""
    for number in range(count):
        folder = root / SYNSETS["car"] / f"m{number:06d}"
        folder.mkdir(parents=True)
        (folder / "model.obj").write_text(OBJ)
        (folder / "m.mtl").write_text(f"newmtl a\nKd {number / count} 0.5 0.5\n")


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds of some work: wall time, and of this process."""
    wall, process = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - process


def measure(root: Path, count: int, times: int) -> pd.DataFrame:
    """What was done, and the medians of its seconds."""
    write_models(root / "collection", count)
    config = DataConfig("car", root=str(root / "collection"), views=1, image_size=8, models=0)
    before = view_store(config, progress=False).identity
    time.sleep(2 * contents.SETTLED / 1e9)  # files that have just been written are read again

    def find() -> None:
        assert view_store(config, progress=False).identity == before

    def read_anew() -> None:
        shutil.rmtree(paths.data() / "contents", ignore_errors=True)
        find()

    rows = []
    for _ in range(times):
        rows += [("every file read", *timed(read_anew)), ("nothing changed", *timed(find))]
    return pd.DataFrame(rows, columns=["models", "wall", "process"]).groupby("models").median().round(3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=int, default=5000)
    parser.add_argument("--times", type=int, default=9)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["VIEWNET_DATA"] = str(Path(folder) / "data")
        print(f"{options.models} models, median seconds\n{measure(Path(folder), options.models, options.times)}")


if __name__ == "__main__":
    main()
