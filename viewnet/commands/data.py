"""List the data that the project reads, and check what a copy of it holds.

List the data sets and weights that can be used, how a copy is named, its terms and where to get it; with `check`,
report what a folder holds. Nothing is downloaded.

Examples:

    viewnet data                                                    what can be used, and where to get it
    viewnet data check /data/PASCAL3D+_release1.1                   what a copy holds
    viewnet data check /data/ShapeNetCore.v1 --deep --json          with everything opened, not a sample
"""

from pathlib import Path

from viewnet.commands.options import JSON, Options, argument, print_results
from viewnet.errors import ViewnetError

ARGUMENTS = (
    argument("what", "check: read a folder instead", nargs="?", choices=["check"]),
    argument("folder", "the folder to check", nargs="?", type=Path, metavar="FOLDER"),
    argument("--deep", "open everything, not a sample", action="store_true"),
    JSON,
)


def run(options: Options) -> None:
    """List data sets or check a folder. ViewnetError without a folder to check, and where nothing in it can be used."""
    from viewnet.data import catalogue

    if options.what and options.folder is None:
        raise ViewnetError("data check: name the folder to check")
    report = catalogue.check(options.folder, options.deep) if options.what else None
    print_results(options, catalogue.as_dict(report), catalogue.as_text(report))
    if report is not None and report.problems and not any(report.counts.values()):
        raise ViewnetError(f"{report.folder}: nothing in it can be used")
