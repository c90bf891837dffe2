"""Data, printed numbers and speed: viewnet data, audit and bench."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from viewnet.commands import shared
from viewnet.errors import ViewnetError

DATA = """
viewnet data                                                    what can be used, and where it is had
viewnet data check /data/PASCAL3D+_release1.1                   what a copy holds
viewnet data check /data/ShapeNetCore.v1 --json
"""
AUDIT = """
viewnet audit --viewpoints annotations.csv
viewnet audit --viewpoints annotations.csv -o numbers/ --json
"""
BENCH = """
viewnet bench                                                   into paper_tables/benchmarks/
viewnet bench --batch 64 --sizes 64 -o bench64/
viewnet bench --quick --json                                    whether it works, in seconds
"""


def add(commands: Any) -> None:
    """Their parsers."""
    data = shared.add(
        commands,
        "data",
        "what data the project reads, where it is had, and what a copy of it holds",
        "Say which data sets and weights are read, how a copy is named, its terms and where it is had; with `check`, "
        "what\na folder holds. Nothing is downloaded.",
        DATA,
    )
    data.add_argument("what", nargs="?", choices=["check"], help="check: read a folder instead")
    data.add_argument("folder", nargs="?", type=Path, metavar="FOLDER", help="the folder to check")
    shared.add_json(data)
    data.set_defaults(run=_data)
    audit = shared.add(
        commands,
        "audit",
        "hold the printed numbers of constants against a list of viewpoints",
        "What the printed scores of constants, and the confidence index, can and cannot be by each definition of the "
        "error\nin print.",
        AUDIT,
    )
    audit.add_argument(
        "--viewpoints",
        type=Path,
        required=True,
        metavar="FILE",
        help="a CSV with category, azimuth_deg, elevation_deg, and if there are: subset, split, easy, annotated",
    )
    audit.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="where every number goes, as CSV files")
    shared.add_json(audit)
    audit.set_defaults(run=_audit)
    bench = shared.add(
        commands,
        "bench",
        "measure renderer and training step against a textbook version",
        "Time and memory of the volume renderer and of the training step, beside those of a plain textbook version,\n"
        "measured in turn; on the GPU where there is one. See benchmarks/README.md.",
        BENCH,
    )
    bench.add_argument("--sizes", type=int, nargs="+", metavar="N", help="voxels along a side (default: 32 64 128)")
    bench.add_argument("--batch", type=int, metavar="N", help="targets of a training step (default: 16; 64 on a GPU)")
    bench.add_argument("--repeat", type=int, metavar="N", help="measurements of each (default: 5)")
    bench.add_argument("--threads", type=int, metavar="N", help="of the processor (default: its cores)")
    bench.add_argument(
        "--accuracy",
        type=int,
        default=0,
        metavar="SEEDS",
        help="train on built-in models too: minutes a seed (default: 0)",
    )
    bench.add_argument("--quick", action="store_true", help="all small, in seconds: whether it works, no measurement")
    bench.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="where the files go (default: paper_tables/benchmarks)"
    )
    shared.add_json(bench)
    bench.set_defaults(run=_bench)


def _data(options: argparse.Namespace) -> None:
    from viewnet.data import catalogue

    if options.what and options.folder is None:
        raise ViewnetError("data check: name the folder to check")
    found = catalogue.check(options.folder) if options.what else None
    if options.json:
        shared.print_json(catalogue.as_dict(found))
    else:
        print(catalogue.as_text(found))
    if found is not None and found.problems and not any(found.counts.values()):
        raise ViewnetError(f"{found.folder}: nothing in it can be used")


def _audit(options: argparse.Namespace) -> None:
    from viewnet.experiments.audit import audit_list

    found = audit_list(options.viewpoints)
    files = found.write(options.output) if options.output else []
    if options.json:
        shared.print_json(
            {
                "note": found.note,
                "left out": found.left_out,
                "constants": shared.records(found.constants),
                "confidence": shared.records(found.confidence),
                "files": [str(path) for path in files],
            }
        )
        return
    print(found.note)
    print("\nRows Constant: verdict by each definition of the error, and the test sets where it holds")
    print(found.summary().to_string())
    print("\nConfidence index")
    print(found.confidence.to_string(index=False))
    if files:
        print(*files, sep="\n")


def _bench(options: argparse.Namespace) -> None:
    from viewnet import paths
    from viewnet.bench import measure, report

    settings = measure.Settings.default(
        sizes=None if options.sizes is None else tuple(options.sizes),
        batch=options.batch,
        repeat=options.repeat,
        threads=options.threads,
        accuracy=options.accuracy,
        quick=options.quick,
    )
    found = measure.measure(settings)
    files = report.write(found, options.output or paths.tables() / "benchmarks")
    if options.json:
        shared.print_json(found | {"files": [str(path) for path in files]})
    else:
        print(report.as_text(found))
        print(*files, sep="\n")
