"""The command `viewnet`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from viewnet.errors import ViewnetError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code: 0, 2 for what the user can mend (told in one line), 130 when interrupted."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except ViewnetError as error:
        print(f"viewnet: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("viewnet: interrupted: the same command goes on where it was", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="viewnet", description="ViewNet, replicated: tables and figures of the paper."
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    notebook = commands.add_parser(
        "notebook",
        help="make a table or figure: run its notebook",
        description="Run a notebook with papermill. Whatever it needs and is not there is rendered and trained first.",
    )
    notebook.add_argument("name", help="for example table2_ablation")
    notebook.add_argument(
        "-p", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"), dest="values", help="a parameter"
    )
    notebook.add_argument("-o", "--output", type=Path, help="the executed copy (default: runs/notebooks/NAME.ipynb)")
    notebook.add_argument("--parameters", action="store_true", help="list the parameters and stop")
    notebook.add_argument("--refresh", action="store_true", help="run with the defaults and keep the outputs in place")
    notebook.set_defaults(run=_notebook)
    audit = commands.add_parser(
        "audit",
        help="hold the printed numbers of constants against a list of viewpoints",
        description="What the printed scores of constants, and the confidence index, can and cannot be by each "
        "definition of the error in print.",
    )
    audit.add_argument(
        "--viewpoints",
        type=Path,
        required=True,
        metavar="FILE",
        help="a CSV with category, azimuth_deg, elevation_deg, and if there are: subset, split, easy, annotated",
    )
    audit.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="where every number goes, as CSV files")
    audit.set_defaults(run=_audit)
    bench = commands.add_parser(
        "bench",
        help="measure renderer and training step against a textbook version",
        description="Time and memory of the volume renderer and of the training step, beside those of a plain "
        "textbook version, measured in turn; on the GPU where there is one. See benchmarks/README.md.",
    )
    bench.add_argument("--sizes", type=int, nargs="+", metavar="N", help="voxels along a side (default: 32 64 128)")
    bench.add_argument("--batch", type=int, metavar="N", help="targets of a training step (default: 16; 64 on a GPU)")
    bench.add_argument("--repeat", type=int, metavar="N", help="measurements of each (default: 5)")
    bench.add_argument("--threads", type=int, metavar="N", help="of the processor (default: its cores)")
    bench.add_argument("--accuracy", action="store_true", help="train on built-in cars too, which takes minutes")
    bench.add_argument("--quick", action="store_true", help="all small, in seconds: whether it works, no measurement")
    bench.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="where the files go (default: paper_tables/benchmarks)"
    )
    bench.set_defaults(run=_bench)
    return parser


def _bench(options: argparse.Namespace) -> None:
    from viewnet import bench, bench_report, paths

    settings = bench.Settings.default(
        sizes=None if options.sizes is None else tuple(options.sizes),
        batch=options.batch,
        repeat=options.repeat,
        threads=options.threads,
        accuracy=options.accuracy,
        quick=options.quick,
    )
    found = bench.measure(settings)
    print(bench_report.as_text(found))
    print(*bench_report.write(found, options.output or paths.tables() / "benchmarks"), sep="\n")


def _audit(options: argparse.Namespace) -> None:
    from viewnet.audit import audit_list

    found = audit_list(options.viewpoints)
    print(found.note)
    print("\nRows Constant: verdict by each definition of the error, and the test sets where it holds")
    print(found.summary().to_string())
    print("\nConfidence index")
    print(found.confidence.to_string(index=False))
    if options.output:
        print(*found.write(options.output), sep="\n")


def _notebook(options: argparse.Namespace) -> None:
    from viewnet import notebook

    if options.parameters:
        for name, found in notebook.parameters(notebook.find(options.name)).items():
            print(f"{name} = {found['default']}  ({found['inferred_type_name']}) {found['help']}")
        return
    if options.refresh:
        if options.values or options.output:
            raise ViewnetError("--refresh takes neither -p nor --output: set VIEWNET_PROFILE for another profile")
        print(notebook.refresh(options.name))
        return
    print(notebook.run(options.name, [(name, value) for name, value in options.values], options.output))


if __name__ == "__main__":
    sys.exit(main())
