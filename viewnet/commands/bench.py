"""Measure renderer and training step against a textbook version.

Time and memory of the volume renderer and of the training step, and of a plain textbook version of both, measured in
turn; on the GPU where there is one. See benchmarks/README.md.

Examples:

    viewnet bench                                                   into paper_tables/benchmarks/
    viewnet bench --batch 64 --sizes 64 -o bench64/
    viewnet bench --quick --json                                    checks that it works, in seconds
    viewnet bench --steps tiny small --recipe matting               where a training step's time goes, part by part
"""

from pathlib import Path

from viewnet.commands.options import JSON, RECIPE, VARIANT, Options, argument, print_results
from viewnet.errors import ViewnetError

TRAINED = "also train on built-in models with so many seeds: minutes each (default: 0)"
TARGETS = "targets of a training step (default: 16; 64 on a GPU; with --steps the profile's)"
STEPS = "instead, the parts of a training step at these profiles; --recipe and --variant are of this only"
ARGUMENTS = (
    argument("--steps", STEPS, nargs="+", metavar="PROFILE"),
    RECIPE,
    VARIANT,
    argument("--sizes", "voxels along a side (default: 32 64 128)", type=int, nargs="+", metavar="N"),
    argument("--batch", TARGETS, type=int, metavar="N"),
    argument("--repeat", "measurements of each (default: 5)", type=int, metavar="N"),
    argument("--threads", "CPU threads (default: the number of cores)", type=int, metavar="N"),
    argument("--accuracy", TRAINED, type=int, default=0, metavar="SEEDS"),
    argument("--quick", "small sizes, in seconds: checks that it works, measures nothing", action="store_true"),
    argument("-o --output", "where the files go (default: paper_tables/benchmarks)", type=Path, metavar="FOLDER"),
    JSON,
)


def run(options: Options) -> None:
    """Measure, write the reports and print them. ViewnetError for options that exclude each other."""
    from viewnet import paths
    from viewnet.bench import measure, report, steps
    from viewnet.recipes import PEERS

    folder = options.output or paths.tables() / "benchmarks"
    given = {name: getattr(options, name) for name in ("batch", "repeat", "threads", "quick")}
    if options.steps is not None:
        if options.variant in PEERS:
            raise ViewnetError(f"--variant {options.variant}: a method of another paper: --steps takes ViewNet apart")
        if options.sizes is not None or options.accuracy:
            raise ViewnetError("--steps goes with neither --sizes nor --accuracy: run it twice")
        settings = measure.Settings.default(**given)
        profiles = dict.fromkeys(options.steps)
        configs = [steps.configuration(name, options.recipe, options.variant, options.batch) for name in profiles]
        measured = steps.measure(configs, settings)
        files, text = report.write_steps(measured, folder), report.steps_as_text(measured)
    else:
        if options.recipe or options.variant != "viewnet":
            raise ViewnetError("--recipe and --variant are of --steps: name its profiles, such as --steps tiny")
        sizes = None if options.sizes is None else tuple(options.sizes)
        settings = measure.Settings.default(sizes=sizes, accuracy=options.accuracy, **given)
        measured = measure.measure(settings)
        files, text = report.write(measured, folder), report.as_text(measured)
    print_results(options, measured | {"files": [str(path) for path in files]}, text, *files)
