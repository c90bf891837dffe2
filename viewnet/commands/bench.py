"""Measure renderer and training step against a textbook version.

Time and memory of the volume renderer and of the training step, and of a plain textbook version of both, measured in
turn; on the GPU where there is one. See benchmarks/README.md.

Examples:

    viewnet bench                                                   into paper_tables/benchmarks/
    viewnet bench --batch 64 --sizes 64 -o bench64/
    viewnet bench --quick --json                                    checks that it works, in seconds
"""

from pathlib import Path

from viewnet.commands.options import JSON, Options, argument, print_results

TRAINED = "also train on built-in models with so many seeds: minutes each (default: 0)"
ARGUMENTS = (
    argument("--sizes", "voxels along a side (default: 32 64 128)", type=int, nargs="+", metavar="N"),
    argument("--batch", "targets of a training step (default: 16; 64 on a GPU)", type=int, metavar="N"),
    argument("--repeat", "measurements of each (default: 5)", type=int, metavar="N"),
    argument("--threads", "CPU threads (default: the number of cores)", type=int, metavar="N"),
    argument("--accuracy", TRAINED, type=int, default=0, metavar="SEEDS"),
    argument("--quick", "small sizes, in seconds: checks that it works, measures nothing", action="store_true"),
    argument("-o --output", "where the files go (default: paper_tables/benchmarks)", type=Path, metavar="FOLDER"),
    JSON,
)


def run(options: Options) -> None:
    """Measure, write the reports and print them."""
    from viewnet import paths
    from viewnet.bench import measure, report

    names = ("batch", "repeat", "threads", "accuracy", "quick")
    sizes = None if options.sizes is None else tuple(options.sizes)
    settings = measure.Settings.default(sizes=sizes, **{name: getattr(options, name) for name in names})
    measured = measure.measure(settings)
    files = report.write(measured, options.output or paths.tables() / "benchmarks")
    values = measured | {"files": [str(path) for path in files]}
    print_results(options, values, report.as_text(measured), *files)
