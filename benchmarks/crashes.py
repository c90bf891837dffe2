"""Work killed at random moments, and work requested by two processes at once: is the result always the same?

    python benchmarks/crashes.py [--kills 50] [--pairs 20] [--seed 0] [-o paper_tables/trust]

Draws view stores, trains runs and makes a notebook's table in processes that are killed (SIGKILL to all of them) at
moments drawn evenly from the first lock that undisturbed work takes to its end, up to three times each before the same
command is let end. After each kill every file at its final name must be whole, and at each end everything that of
undisturbed work: bytes, but for when it was made and what tells of interruptions. `crashes.csv` has a row a kind of
work, `pairs.csv` one for each thing that two processes asked for at the same moment. Problems are printed, and the exit
status is 1.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import pandas as pd
from helpers.interrupted_work import Work, drawing, table, training
from helpers.killed_processes import Tally, finish, trial, undisturbed
from helpers.two_processes import QUESTIONS, two_processes

from viewnet import paths
from viewnet.runtime.files import replacing

SHARES = {"view store": 0.4, "run": 0.4, "table": 0.2}
"""Of all kills."""


def killed(work: Work, kills: int, place: Path, data: Path | None, rng: Random) -> Tally:
    """Work killed so many times; `data` are views that are there already."""
    reference, tally = place / "undisturbed", Tally()
    tally.seconds = undisturbed(work, reference, data)
    while tally.kills < kills:
        root = place / "killed"
        trial(work, root, reference, data, rng, min(1 + tally.trials % 3, kills - tally.kills), tally)
        shutil.rmtree(root)
        print(f"{work.name}: {tally.kills} of {kills} kills, {len(tally.problems)} problems", flush=True)
        if tally.late > 3 * kills:
            raise RuntimeError(f"{work.name}: ends before it is killed: is it too short?")
    return tally


def told(work: Work, tally: Tally) -> dict[str, Any]:
    """The row of a kind of work."""
    return {
        "what": work.name,
        "kills": tally.kills,
        "resumed": tally.resumed,
        "trials": tally.trials,
        "identical": tally.identical,
        "damaged_or_left": len(tally.problems),
        "phases": "; ".join(f"{phase} {times}" for phase, times in sorted(tally.phases.items())),
        "late": tally.late,
        "undisturbed_s": round(tally.seconds, 1),
    }


def asked_twice(question: str, pairs: int, place: Path, data: Path) -> tuple[dict[str, Any], list[str]]:
    """The row of a thing that two processes ask for, and what went wrong."""
    once, problems = QUESTIONS[question][1], []
    row: dict[str, Any] = {"what": question, "pairs": pairs, "waited": 0, "made_once": 0, "same": 0}
    with two_processes(data) as ask:
        for number in range(pairs):
            root = place / str(number)
            pair = ask(question, root)
            row["waited"] += pair.waited
            row["made_once"] += pair.made == once and pair.makers == 1
            row["same"] += pair.same
            problems += [f"pair {number}: {what}" for what in pair.problems]
            shutil.rmtree(root)
    return row | {"damaged_or_left": len(problems)}, problems


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50, help="of all kinds of work together")
    parser.add_argument("--pairs", type=int, default=20, help="of each thing that is asked for twice")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=paths.tables() / "trust")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="viewnet-crashes-") as place:
        return report(options, Path(place))


def report(options: argparse.Namespace, place: Path) -> int:
    """Both parts; the exit status."""
    failed = False
    # Kernels compiled, and the views that runs are trained on.
    finish(training(1), place / "views", None)
    data = place / "views" / "data"
    rows = []
    for number, work in enumerate((drawing(), training(), table())):
        kills = round(SHARES[work.name] * options.kills)
        own = None if "data" in work.makes else data
        tally = killed(work, kills, place / work.name, own, Random(f"{options.seed} {number}"))
        rows.append(told(work, tally))
        for problem in tally.problems:
            print(problem)
        failed |= bool(tally.problems) or tally.identical < tally.trials
    if options.kills:
        write(options.output / "crashes.csv", rows)
    rows = []
    for question in QUESTIONS if options.pairs else ():
        row, problems = asked_twice(question, options.pairs, place / f"pairs of {question}", data)
        rows.append(row)
        for problem in problems:
            print(problem)
        failed |= bool(problems) or not row["made_once"] == row["same"] == options.pairs
    if options.pairs:
        write(options.output / "pairs.csv", rows)
    return int(failed)


def write(file: Path, rows: list[dict[str, Any]]) -> None:
    for row in rows:
        print(*(f"{key} {value}" for key, value in row.items()), sep=", ", flush=True)
    with replacing(file) as temporary:
        pd.DataFrame(rows).to_csv(temporary, index=False, lineterminator="\n")


if __name__ == "__main__":
    sys.exit(main())
