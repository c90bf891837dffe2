"""Every reader of the package on damaged files: does it end in a result or in one error that names the file?

    python benchmarks/fuzz.py [--cases 300] [--seed 0] [--readers NAME ...] [-o paper_tables/trust/fuzz.csv]

Strategies and readers are those of the tests (tests/readers.py, tests/kept_readers.py), which draw a few cases each and
the same every time; here are as many as asked for. Writes a row a reader: cases, results, named errors, failures, the
slowest case in processor seconds, and the most memory in MiB beside what was there before; with --readers, rows of the
others stay as they are in the file. Failures are printed, the
first file of each is kept in the folder that VIEWNET_FUZZ_KEEP names, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("TQDM_DISABLE", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import pandas as pd
from helpers.kept_readers import KEPT
from helpers.readers import READERS, Reader, contents
from helpers.survival import Broken, survives
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from viewnet import paths
from viewnet.runtime.files import replacing


def fuzz(reader: Reader, cases: int, number: int) -> tuple[dict[str, Any], Counter[str]]:
    """A row of the report, and how often which failure was seen."""
    row: dict[str, Any] = {"reader": reader.name, "cases": 0, "results": 0, "named errors": 0, "failures": 0}
    slowest, peak, failures = 0.0, 0, Counter[str]()
    with tempfile.TemporaryDirectory(prefix="viewnet-fuzz-") as place:
        folder = Path(place) / "input"
        folder.mkdir()
        reader.write(folder)
        survives(lambda: reader.read(folder), ()), survives(lambda: reader.read(folder), ())  # compiled, imported
        files = reader.spoilt(folder)
        for share, (file, other) in enumerate(files):
            original = file.read_bytes()

            def tried(content: bytes, file: Path = file) -> None:
                nonlocal slowest, peak
                file.write_bytes(content)
                row["cases"] += 1
                begun = time.process_time()
                try:
                    outcome = survives(lambda: reader.read(folder), reader.places(folder, file))
                except Broken as broken:
                    row["failures"] += 1
                    what = f"{file.relative_to(folder)}: {broken}"
                    if failures[what] == 0 and (kept := os.environ.get("VIEWNET_FUZZ_KEEP")):
                        Path(kept, f"{reader.name}-{len(failures)}-{file.name}").write_bytes(content)
                    failures[what] += 1
                else:
                    row["named errors" if outcome.error else "results"] += 1
                    peak = max(peak, outcome.peak)
                slowest = max(slowest, time.process_time() - begun)

            draw_all(contents(original, other), cases // len(files) + (share < cases % len(files)), number, tried)
            file.write_bytes(original)
    return row | {"slowest_s": round(slowest, 2), "peak_mib": peak >> 20}, failures


def draw_all(strategy: st.SearchStrategy[bytes], cases: int, number: int, then: Callable[[bytes], None]) -> None:
    """`then` of so many examples of a strategy, drawn by a seed."""

    @seed(number)
    @settings(
        max_examples=cases,
        database=None,
        deadline=None,
        derandomize=False,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def case(content: bytes) -> None:
        then(content)

    case()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    everything = {reader.name: reader for reader in (*READERS, *KEPT)}
    parser.add_argument("--cases", type=int, default=300, help="of each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readers", nargs="+", choices=everything, default=list(everything), metavar="NAME")
    parser.add_argument("-o", "--output", type=Path, default=paths.tables() / "trust" / "fuzz.csv")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    rows, found = [], 0
    for name in options.readers:
        row, failures = fuzz(everything[name], options.cases, options.seed)
        rows.append(row)
        print(*(f"{key} {value}" for key, value in row.items()), sep=", ", flush=True)
        for what, times in failures.most_common():
            print(f"    {times} times {what}", flush=True)
        found += row["failures"]
    if options.output.is_file():
        kept = pd.read_csv(options.output).to_dict("records")
        rows += [row for row in kept if row["reader"] in set(everything) - set(options.readers)]
    rows.sort(key=lambda row: list(everything).index(row["reader"]))
    with replacing(options.output) as temporary:
        pd.DataFrame(rows).to_csv(temporary, index=False, lineterminator="\n")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
