"""Hostile files given to the commands and to the page: does each end in an answer or in a refusal that names the file?

    python benchmarks/doors.py [--cases 1000] [--seed 0] [-o paper_tables/trust/doors.csv]

A third of the files each goes to `viewnet predict`, to the page (an upload, and then the answer), and to
`viewnet render` (a model, material or texture among good ones). They are damaged images of seven formats and CAD files,
and files that are made to do harm (tests/helpers/damage.py, tests/helpers/hostile.py). Writes a row a door: cases,
answers, refusals, failures, the slowest case in seconds, and the most memory in MiB beside what was there before. More
than 10 s or 2 GiB is a failure; failures are printed, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import logging
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("TQDM_DISABLE", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import pandas as pd
from fuzz import draw_all
from gradio import Error
from gradio.utils import get_upload_folder
from helpers.damage import damaged
from helpers.hostile import CAD, EPS, HUGE, LONG
from helpers.readers import READERS
from helpers.survival import growth
from PIL import Image

from viewnet import cli, paths
from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.demo.app import Page
from viewnet.runtime.files import replacing

SECONDS, MEMORY = 10.0, 2**31
"""The most that one file may take: wall time, and bytes beside what was there before."""
FORMATS = ("png", "jpeg", "bmp", "gif", "tiff", "webp", "ppm")
HARM = (HUGE, LONG, EPS, b"", b"\0" * 100, b"text\n", b"<svg xmlns='http://www.w3.org/2000/svg'/>", b"%PDF-1.4\n")


class Door:
    """One way in, and how it went there."""

    def __init__(self, name: str, ask: Callable[[Path], str], named: Callable[[Path], list[str]]) -> None:
        self.name, self.ask, self.named = name, ask, named
        self.row: dict[str, Any] = {"door": name, "cases": 0, "answers": 0, "refusals": 0, "failures": 0}
        self.slowest, self.peak = 0.0, 0

    def tried(self, file: Path, what: str) -> None:
        """Give it a file. `ask` returns "" for an answer, or what the refusal says."""
        self.row["cases"] += 1
        grown, begun = growth(), time.monotonic()
        try:
            said = self.ask(file)
            problem = "" if not said or any(name in said for name in self.named(file)) else f"names no file: {said!r}"
        except Exception as error:
            said, problem = "", f"{type(error).__name__}: {error}"
        seconds, peak = time.monotonic() - begun, grown()
        self.slowest, self.peak = max(self.slowest, seconds), max(self.peak, peak)
        if seconds > SECONDS or peak > MEMORY:
            problem = problem or f"{seconds:.1f} s, {peak >> 20} MiB"
        self.row["failures" if problem else "refusals" if said else "answers"] += 1
        if problem:
            print(f"    {self.name}: {what}: {problem[:300]}", flush=True)

    def result(self) -> dict[str, Any]:
        """The row of the report."""
        return self.row | {"slowest_s": round(self.slowest, 2), "peak_mib": self.peak >> 20}


def command(*arguments: str) -> str:
    """Run one of viewnet's commands: what it refuses, or ""."""
    told = io.StringIO()
    with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
        status = cli.main(list(arguments))
    if status not in (0, 2, 3):
        raise AssertionError(f"exit status {status}: {told.getvalue()}")
    return told.getvalue() if status else ""


def uploaded(page: Page, file: Path) -> str:
    """Send the page an image and ask for the answer: what it refuses, or ""."""
    try:
        (*_, shown) = page.take({"path": str(file), "orig_name": file.name})
        page.predict(shown[0], None, "", without_3d=True)
    except Error as error:
        return str(error.message)
    return ""


def rendered(folder: Path) -> str:
    """Render the collection in a folder anew: what is refused or left out, or ""."""
    for kept in ("views", "cad"):
        shutil.rmtree(paths.data() / kept, ignore_errors=True)
    said = command("render", "car", "--data-root", str(folder), "--profile", "smoke", "--workers", "1")
    left_out = [line for file in paths.data().glob("views/*/rejected.csv") for line in file.read_text().split("\n")[1:]]
    return said or "".join(left_out)


def spoilt(content: bytes, cases: int, number: int) -> list[bytes]:
    """So many damaged versions of a file."""
    found: list[bytes] = []
    draw_all(damaged(content), cases, number, found.append)
    return found


def images(folder: Path, cases: int, number: int) -> Iterator[tuple[bytes, str]]:
    """So many hostile images, and what they are: those made to do harm, then damaged ones of every format."""
    yield from ((content, f"{content[:12]!r}...") for content in HARM[:cases])
    rest = max(0, cases - len(HARM))
    picture = Image.open(folder / "car.jpg").convert("RGB").resize((96, 72))
    for kind in FORMATS:
        picture.save(original := io.BytesIO(), kind)
        found = spoilt(original.getvalue(), rest // len(FORMATS) + 1, number)
        yield from ((content, f"damaged {kind} {position}") for position, content in enumerate(found))


def collections(folder: Path, cases: int, number: int) -> Iterator[tuple[Path, str]]:
    """So many times a collection of three good models and a hostile one, and what that is."""
    reader = READERS[0]
    reader.write(folder)
    (box,) = (path for path in folder.glob("*/box"))
    for name in ("good0", "good1", "good2"):
        shutil.copytree(box, box.with_name(name))
    original = {file: file.read_bytes() for file in box.rglob("*") if file.is_file()}

    def restore() -> None:
        shutil.rmtree(box)
        for file, content in original.items():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)

    for name, spoil, _ in CAD[:cases]:
        spoil(folder)
        yield folder, name
        restore()
    rest = max(0, cases - len(CAD))
    for file, content in original.items():
        for position, other in enumerate(spoilt(content, rest // len(original) + 1, number)):
            file.write_bytes(other)
            yield folder, f"damaged {file.name} {position}"
        file.write_bytes(content)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000, help="of all doors together, at least")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=paths.tables() / "trust" / "doors.csv")
    options = parser.parse_args(arguments)
    logging.disable(logging.WARNING)
    share, page = options.cases // 3, Page(ViewpointEstimator.from_pretrained("car"), [])
    predict = Door("predict", lambda file: command("predict", "--model", "car", str(file)), lambda file: [file.name])
    upload = Door("page", lambda file: uploaded(page, file), lambda file: [file.name])
    render = Door("render", rendered, lambda folder: [str(folder), "box"])
    with tempfile.TemporaryDirectory(prefix="viewnet-doors-") as place:
        os.environ["VIEWNET_DATA"] = f"{place}/data"
        shutil.copy(paths.part("docs") / "car.jpg", place)
        sent = Path(get_upload_folder()) / Path(place).name
        sent.mkdir(parents=True)
        for door, folder, cases in ((predict, Path(place), options.cases - 2 * share), (upload, sent, share)):
            for content, what in images(Path(place), cases, options.seed):
                (file := folder / "sent.png").write_bytes(content)
                door.tried(file, what)
        shutil.rmtree(sent)
        for folder, what in collections(Path(place) / "collection", share, options.seed):
            render.tried(folder, what)
    rows = [door.result() for door in (predict, upload, render)]
    for row in rows:
        print(*(f"{key} {value}" for key, value in row.items()), sep=", ")
    with replacing(options.output) as temporary:
        pd.DataFrame(rows).to_csv(temporary, index=False, lineterminator="\n")
    return int(any(row["failures"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
