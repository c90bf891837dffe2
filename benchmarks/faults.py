"""Full disks, folders that cannot be written to, broken downloads, wrong clocks, losses that are no numbers.

    python benchmarks/faults.py [-o paper_tables/trust/faults.csv]

Each fault meets the work it can meet: drawing a view store, training a run, making a table, opening a model. It has to
end in one error that names what is at fault and leaves nothing half-written, and when it is mended the same call has to
end as if nothing had been. Writes a row a fault and work: errors, how many of them named the place, files found
damaged, the end, and the first error. Disks are real ones where this process may mount them (the superuser may); rows
that could not be measured say why. Problems are printed, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

os.environ |= {"TQDM_DISABLE": "1", "CUDA_VISIBLE_DEVICES": "", "HF_HUB_OFFLINE": "1"}
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import pandas as pd
import torch
from helpers.interrupted_work import files
from helpers.simulated_faults import (
    can_mount,
    clock_going_back,
    date_files,
    file_limit,
    grow,
    loss_after,
    read_only,
    small_disk,
    weights_spoilt_at,
)
from helpers.work_in_process import TASKS, Task, at, config, train, undisturbed
from torchvision import models

from viewnet import paths
from viewnet.data import rendered_store as rendering
from viewnet.estimator import ViewpointEstimator
from viewnet.runs.make_run import STATE
from viewnet.runtime.files import replacing

SIZES = [4**power for power in range(3, 14)]
"""Of files and disks: 64 bytes to 64 MiB."""
CUTS = (0.0, 1e-4, 0.1, 0.5, 0.9, 0.99)
"""Shares of a file that had come when a download broke off."""


@dataclass
class Row:
    """What came of a fault during some work."""

    fault: str
    during: str
    errors: int = 0
    named: int = 0  # one line that names the place
    damaged: int = 0  # files
    afterwards: str = ""
    says: str = ""
    problems: list[str] = field(default_factory=list)

    def said(self, message: str, place: Path | str, root: Path) -> None:
        """Count an error's message."""
        self.errors += 1
        good = str(place) in message and "\n" not in message and ": " in message
        self.named += good
        self.says = self.says or message.replace(str(root), "")
        if not good:
            self.problems.append(f"does not name {place}: {message}")

    def found(self, damaged: list[str]) -> None:
        """Count damaged files."""
        self.damaged += len(damaged)
        self.problems += damaged

    def ended(self, differences: list[str], word: str = "identical") -> None:
        """Say how it ended."""
        self.afterwards = word if not differences else "differs"
        self.problems += differences


def squeezed(fault: str, task: Task, root: Path, reference: Path, sizes: list[int], limit: Callable[[int], Any]) -> Row:
    """A task with so little room that it fails, then with more and more. `limit` gives it the room of a size."""
    row = Row(fault, task.name)
    for size in sizes:
        with limit(size) or ExitStack():
            message = task.message()
        row.found(task.damage(root, reference))
        if not message:
            break
        row.said(message, root / task.place, root)
    if row.errors < 2:
        row.problems.append(f"failed {row.errors} times only")
    row.ended(task.differences(root, reference))
    return row


def full_disks(place: Path, reference: Path) -> Iterator[Row]:
    """Files that cannot grow, disks that are too small, and disks that others fill while views are drawn."""
    for task in TASKS:
        root = place / task.name
        with at(root, reference, task):
            yield squeezed("file size limit", task, root, reference, SIZES, file_limit)
    for task, kind in (*((task, "disk full") for task in TASKS), (TASKS[0], "disk filled by others")):
        if not can_mount(place):
            yield Row(kind, task.name, afterwards="not measured: needs the right to mount file systems")
            continue
        root = place / f"{task.name} {kind}"
        with ExitStack() as stack:
            stack.enter_context(at(root, reference, task))
            stack.enter_context(small_disk(root / task.place, 4096))
            if kind != "disk full":  # the room that was there when it began is gone
                stack.enter_context(mock.patch.object(rendering, "_check_room", lambda *_: None))
            sizes = [2**power for power in range(12, 27)]
            yield squeezed(
                kind, task, root, reference, sizes, lambda size, root=root, task=task: grow(root / task.place, size)
            )


def closed_folders(place: Path, reference: Path) -> Iterator[Row]:
    """Folders that cannot be written to: with the work still to do, and with all of it done."""
    for task in TASKS:
        row, root = Row("read-only folder", task.name), place / task.name
        if os.geteuid() == 0 and not can_mount(place):
            row.afterwards = "not measured: needs the right to mount file systems"
            yield row
            continue
        with at(root, reference, task):
            with read_only(root / task.place):
                row.said(task.message(), root / task.place, root)
            row.found(task.differences(root, root))
            row.ended([message] if (message := task.message()) else task.differences(root, reference))
        yield row
        row, copy = Row("read-only folder, work done", task.name), place / f"copy for {task.name}"
        shutil.copytree(reference, copy)
        inputs = ("data", "runs") if task.place == "tables" else (task.place,)
        with at(copy, copy, task), ExitStack() as stack:
            for folder in inputs:
                stack.enter_context(read_only(copy / folder))
            row.ended([message] if (message := task.message()) else task.differences(copy, reference))
        yield row


def broken_downloads(place: Path, reference: Path) -> Iterator[Row]:
    """Weights of which a part has come: of the perceptual loss, and of a model as the hub's cache keeps it."""
    task, root = TASKS[1], place / "perceptual"
    whole = place / "squeezenet1_1.pth"
    torch.manual_seed(0)
    torch.save(models.squeezenet1_1(weights=None).state_dict(), whole)
    part, asked = place / "part.pth", config(perceptual="squeezenet")
    row = Row("interrupted download", "training with a perceptual loss")
    with at(root, reference, task), mock.patch.dict(os.environ, VIEWNET_SQUEEZENET_WEIGHTS=str(part)):
        asking = Task("", "runs", lambda: train(asked))
        for share in CUTS:
            part.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
            row.said(asking.message(), part, place)
        shutil.copy(whole, part)
        row.ended([message] if (message := asking.message()) else [])
        row.afterwards = "trained" if row.afterwards == "identical" else row.afterwards
    yield row

    row = Row("interrupted download", "opening a model of the hub")
    (run,) = {file.parent for file in (reference / "runs").glob("viewnet/*/result.json")}
    saved = place / "cache" / "models--somebody--car" / "snapshots" / ("0" * 40)
    ViewpointEstimator.from_pretrained(run).save_pretrained(saved)
    reference_file = saved.parents[1] / "refs" / "main"
    reference_file.parent.mkdir()
    reference_file.write_text("0" * 40)

    def opened() -> dict[str, torch.Tensor]:
        return ViewpointEstimator.from_pretrained("somebody/car", cache_dir=place / "cache").network.state_dict()

    expected = opened()
    for file in (saved / "model.safetensors", saved / "config.json"):
        full = file.read_bytes()
        for share in CUTS:
            file.write_bytes(full[: int(share * len(full))])
            row.said(Task("", "", opened).message(), file, place)
        file.write_bytes(full)
    found = opened()
    row.ended([name for name in expected if not torch.equal(expected[name], found[name])])
    yield row


def wrong_clocks(place: Path, reference: Path) -> Iterator[Row]:
    """Files of other times, between and amid the work, and a clock that goes back all the time."""
    for task in TASKS:
        for fault, when in (("files of 1970", 1.0), ("files of 2100", 4.1e9)):
            row, root = Row(fault, task.name), place / f"{task.name} {fault}"
            shutil.copytree(reference, root)
            before = {file: file.stat().st_ino for file in files(root) if task.place != "tables"}
            date_files(root, when)
            with at(root, root, task):
                row.said(message, "", root) if (message := task.message()) else None
            remade = [f"{file}: made anew" for file, inode in before.items() if file.stat().st_ino != inode]
            row.ended(remade + task.differences(root, reference))
            yield row
        row, root = Row("clock going back", task.name), place / f"{task.name} back"
        with at(root, reference, task), clock_going_back():
            row.ended([message] if (message := task.message()) else task.differences(root, reference))
        yield row
    task = TASKS[1]
    for fault, when in (("files of 1970", 1.0), ("files of 2100", 4.1e9)):
        row, root = Row(fault, "training, broken off"), place / f"resumed {fault}"
        with at(root, reference, task):
            with loss_after(steps_of_an_epoch(reference) + 1, float("nan")):
                row.said(task.message(), root / task.place, root)
            date_files(root, when)
            row.ended([message] if (message := task.message()) else task.differences(root, reference))
        yield row


def steps_of_an_epoch(reference: Path) -> int:
    (log,) = (reference / "runs").glob("viewnet/*/log.csv")
    return int(pd.read_csv(log)["step"].iloc[0])


def losses(place: Path, reference: Path) -> Iterator[Row]:
    """A loss or a weight that is NaN for once, and a learning rate with which the loss explodes."""
    task, epoch = TASKS[1], steps_of_an_epoch(reference)
    for fault, spoilt, kept in (
        ("NaN in the first epoch", loss_after(1, float("nan")), False),
        ("NaN in the second epoch", loss_after(epoch + 1, float("nan")), True),
        ("NaN among the weights after the first epoch", weights_spoilt_at(epoch), False),
        ("NaN among the weights after the second epoch", weights_spoilt_at(2 * epoch), True),
    ):
        row, root = Row(fault, "training"), place / fault
        with at(root, reference, task):
            with spoilt:
                message = task.message()
            row.said(message, root / task.place, root)
            row.found(task.damage(root, reference))
            row.problems += state_problems(root, message, expected=kept)
            row.ended([again] if (again := task.message()) else task.differences(root, reference))
        yield row
    row, root = Row("exploding loss", "training"), place / "exploding"
    with at(root, reference, task):
        exploding = Task("", "runs", lambda: train(config(learning_rate=1e9)))
        first, second = exploding.message(), exploding.message()
        row.said(first, root / task.place, root)
        row.said(second, root / task.place, root)
        row.problems += state_problems(root, first, expected=False)
        row.ended([] if first == second else [f"then {second}"], "the same error")
    yield row


def state_problems(root: Path, message: str, expected: bool) -> list[str]:
    """What is wrong with the state that a training left, and with what its message says of it."""
    found = list((root / "runs").glob(f"*/*/{STATE}"))
    if not expected:
        return [f"{path}: there after no validation" for path in found]
    if len(found) != 1 or str(found[0]) not in message or "of epoch 1" not in message:
        return [f"{found}: expected one state, named in: {message}"]
    weights = torch.load(found[0], weights_only=True)["model"]
    return [f"{found[0]}: {name} is not finite" for name, value in weights.items() if not value.isfinite().all()]


PARTS: tuple[Callable[[Path, Path], Iterator[Row]], ...] = (
    full_disks,
    closed_folders,
    broken_downloads,
    wrong_clocks,
    losses,
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=paths.tables() / "trust" / "faults.csv")
    options = parser.parse_args()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="viewnet-faults-") as place:
        reference = Path(place) / "undisturbed"
        undisturbed(reference)
        for part in PARTS:
            (Path(place) / part.__name__).mkdir()
            for row in part(Path(place) / part.__name__, reference):
                rows.append(row)
                print(row.fault, row.during, row.errors, row.afterwards, row.says, sep=", ", flush=True)
                print(*row.problems, sep="\n", end="\n" if row.problems else "")
    columns = ["fault", "during", "errors", "named", "damaged", "afterwards", "says"]
    with replacing(options.output) as temporary:
        pd.DataFrame([vars(row) for row in rows])[columns].to_csv(temporary, index=False, lineterminator="\n")
    return int(any(row.problems for row in rows))


if __name__ == "__main__":
    # Mounts in a name space of its own vanish with this process, however it ends.
    if os.geteuid() == 0 and "--own-mounts" not in sys.argv and shutil.which("unshare"):
        probe = subprocess.run(["unshare", "--mount", "true"], capture_output=True)
        if probe.returncode == 0:
            os.execvp("unshare", ["unshare", "--mount", sys.executable, *sys.argv, "--own-mounts"])
    sys.argv = [argument for argument in sys.argv if argument != "--own-mounts"]
    sys.exit(main())
