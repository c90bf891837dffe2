"""Killing a process and all of its children at some moment of its work."""

from __future__ import annotations

import contextlib
import signal
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from subprocess import Popen, TimeoutExpired

import psutil
from helpers.interrupted_work import Work, damage, differences

PATIENCE = 1800
"""Seconds after which unfinished work counts as hung."""


@dataclass
class Tally:
    """Counts of kills of one kind of work, and of their outcomes."""

    seconds: float = 0.0  # of undisturbed work
    trials: int = 0  # pieces of work that were killed once or more and then finished
    kills: int = 0
    resumed: int = 0  # kills of a call that was resuming after a kill
    late: int = 0  # moments after the work had ended: nothing was killed
    phases: Counter[str] = field(default_factory=Counter)
    identical: int = 0  # trials with the same result as undisturbed work
    problems: list[str] = field(default_factory=list)


def begun(root: Path, process: Popen[bytes]) -> bool:
    """Wait until work takes its first lock; False if it ended before."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if next(root.rglob(".*.lock"), None):
            return True
        if process.poll() is not None:
            return False
        time.sleep(0.01)
    raise TimeoutError(f"{root}: nothing has begun, see output.txt there")


def kill_all(process: Popen[bytes]) -> bool:
    """SIGKILL to a process and all that descend from it, kernels in sessions of their own included; False: too late."""
    parent = psutil.Process(process.pid)
    doomed: set[psutil.Process] = set()
    # Those that are stopped start nothing more, so this comes to an end.
    while fresh := {parent, *parent.children(recursive=True)} - doomed:
        for one in fresh:
            with contextlib.suppress(psutil.NoSuchProcess):
                one.suspend()
        doomed |= fresh
    for one in doomed:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()
    psutil.wait_procs(doomed - {parent}, timeout=60)
    return process.wait() == -signal.SIGKILL


def finish(work: Work, root: Path, data: Path | None) -> None:
    """Finish the work; AssertionError with its output if it fails."""
    if work.start(root, data).wait(PATIENCE):
        raise AssertionError(f"{work.name}: {(root / 'output.txt').read_text()[-2000:]}")


def undisturbed(work: Work, root: Path, data: Path | None) -> float:
    """Do the work once and return the seconds from its first lock to its end."""
    process = work.start(root, data)
    begun(root, process)
    start = time.perf_counter()
    if process.wait(PATIENCE):
        raise AssertionError(f"{work.name}: {(root / 'output.txt').read_text()[-2000:]}")
    return time.perf_counter() - start


def trial(work: Work, root: Path, reference: Path, data: Path | None, rng: Random, kills: int, tally: Tally) -> None:
    """Kill the work up to some number of times, restarting it with the same command, then let it end and compare."""
    for number in range(kills):
        for lock in root.rglob(".*.lock"):  # nobody holds them; a new one shows that the next call is at work
            lock.unlink()
        process = work.start(root, data)
        if begun(root, process):
            with contextlib.suppress(TimeoutExpired):
                process.wait(rng.uniform(0, tally.seconds))
        if process.poll() is not None or not kill_all(process):
            tally.late += 1
            break
        tally.kills += 1
        tally.resumed += number > 0
        tally.phases[work.phase(root)] += 1
        tally.problems += [f"after kill {tally.kills}: {what}" for what in damage(root, reference, work.makes)]
    finish(work, root, data)
    tally.trials += 1
    found = differences(root, reference, work.makes)
    tally.identical += not found
    tally.problems += [f"at the end of trial {tally.trials}: {what}" for what in found]
