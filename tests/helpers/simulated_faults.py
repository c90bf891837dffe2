"""Simulated faults: full disks, read-only folders, wrong clocks, NaN."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import torch

from viewnet.training import train as training


@contextlib.contextmanager
def file_limit(size: int) -> Iterator[None]:
    """Limit the size of this process's files in bytes: writing fails as on a full disk, with another errno."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def can_mount(place: Path) -> bool:
    """Whether this process may mount file systems. `place` is any folder."""
    if os.geteuid() or subprocess.run(["mount", "-t", "tmpfs", "tmpfs", place], capture_output=True).returncode:
        return False
    subprocess.run(["umount", place], check=True)
    return True


@contextlib.contextmanager
def small_disk(folder: Path, size: int) -> Iterator[None]:
    """`folder`, which must be empty, is a disk of so many bytes; see `grow`. What is on it is gone afterwards."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def grow(folder: Path, size: int) -> None:
    """Set the size of a `small_disk` in bytes."""
    subprocess.run(["mount", "-o", f"remount,size={size}", folder], check=True)


@contextlib.contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Nothing in `folder` can be written. The superuser, whom modes do not bind, must be able to mount."""
    folder.mkdir(parents=True, exist_ok=True)
    if os.geteuid():
        inside = [folder, *(path for path in folder.rglob("*") if path.is_dir())]
        for path in inside:
            path.chmod(0o555)
        try:
            yield
        finally:
            for path in inside:
                path.chmod(0o755)
        return
    subprocess.run(["mount", "--bind", folder, folder], check=True)
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", folder], check=True)
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def date_files(folder: Path, when: float) -> None:
    """Set the times of all files and folders, in seconds since 1970."""
    for path in (folder, *folder.rglob("*")):
        os.utime(path, (when, when))


@contextlib.contextmanager
def clock_going_back() -> Iterator[None]:
    """Each reading of Python's clock is an hour before the previous one."""
    now, asked = time.time(), iter(range(1, 10**9))
    with (
        mock.patch.object(time, "time", lambda: now - 3600.0 * next(asked)),
        mock.patch.object(time, "time_ns", lambda: int(1e9 * (now - 3600.0 * next(asked)))),
    ):
        yield


@contextlib.contextmanager
def loss_after(steps: int, value: float) -> Iterator[None]:
    """Make a training's loss `value` after some steps."""
    left, real = iter(range(steps)), training.step_loss

    def step_loss(*arguments, **options) -> dict[str, torch.Tensor]:
        terms = real(*arguments, **options)
        if next(left, None) is None:
            terms = {name: term * value for name, term in terms.items()}
        return terms

    with mock.patch.object(training, "step_loss", step_loss):
        yield


@contextlib.contextmanager
def weights_spoilt_at(step: int) -> Iterator[None]:
    """Make one weight NaN after this step, counted from 1."""
    steps, real = iter(range(1, step + 1)), torch.optim.Adam.step

    def spoiling(self: torch.optim.Adam, *arguments) -> None:
        real(self, *arguments)
        if next(steps, None) == step:
            self.param_groups[0]["params"][0].data.view(-1)[0] = float("nan")

    with mock.patch.object(torch.optim.Adam, "step", spoiling):
        yield
