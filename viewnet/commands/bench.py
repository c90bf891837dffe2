"""Measure renderer and training step against a textbook version.

Time and memory of the volume renderer and of the training step, and of a plain textbook version of both, measured in
turn; on the GPU where there is one. See benchmarks/README.md.

Examples:

    viewnet bench                                                   into paper_tables/benchmarks/
    viewnet bench --batch 64 --sizes 64 -o bench64/
    viewnet bench --quick --json                                    checks that it works, in seconds
"""

from pathlib import Path

from viewnet.commands.options import Options, Parser, add_json, print_json


def add_arguments(parser: Parser) -> None:
    """The arguments of viewnet bench."""
    add = parser.add_argument
    add("--sizes", type=int, nargs="+", metavar="N", help="voxels along a side (default: 32 64 128)")
    add("--batch", type=int, metavar="N", help="targets of a training step (default: 16; 64 on a GPU)")
    add("--repeat", type=int, metavar="N", help="measurements of each (default: 5)")
    add("--threads", type=int, metavar="N", help="CPU threads (default: the number of cores)")
    accuracy = "also train on built-in models with so many seeds: minutes each (default: 0)"
    add("--accuracy", type=int, default=0, metavar="SEEDS", help=accuracy)
    add("--quick", action="store_true", help="small sizes, in seconds: checks that it works, measures nothing")
    files = "where the files go (default: paper_tables/benchmarks)"
    add("-o", "--output", type=Path, metavar="FOLDER", help=files)
    add_json(parser)


def run(options: Options) -> None:
    """Measure, write the reports and print them."""
    from viewnet import paths
    from viewnet.bench import measure, report

    names = ("batch", "repeat", "threads", "accuracy", "quick")
    sizes = None if options.sizes is None else tuple(options.sizes)
    settings = measure.Settings.default(sizes=sizes, **{name: getattr(options, name) for name in names})
    measured = measure.measure(settings)
    files = report.write(measured, options.output or paths.tables() / "benchmarks")
    if options.json:
        print_json(measured | {"files": [str(path) for path in files]})
    else:
        print(report.as_text(measured), *files, sep="\n")
