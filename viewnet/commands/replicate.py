"""Train all that the tables need, and keep each run as it ends.

A queue of trainings at the profile tiny, in the order of what each tells: some twenty hours on two cores. As a run
ends, its predictions, its log and where it comes from are added to paper_tables/. It can be stopped at any time; the
same command goes on, on another machine too.

Examples:

    viewnet replicate --plan                                        what is kept, what is missing, and how long it takes
    viewnet replicate --workers 2
"""

import math

from viewnet.commands.options import CLUSTER, THREADS, Options, argument, choose_resources, print_results

ARGUMENTS = (
    argument("--plan", "train nothing", action="store_true"),
    argument("--profile", "tiny, small ... (default: tiny)", default="tiny"),
    argument("--workers", "runs side by side (default: what there is room for)", type=int, metavar="N"),
    THREADS,
    CLUSTER,
    argument("--json", "what is kept and missing, as JSON", action="store_true"),
)


def run(options: Options) -> None:
    """Say what is kept and what is missing, and train that. ViewnetError as Replication.train raises it."""
    choose_resources(options)
    from viewnet.experiments.replication import Replication

    queue = Replication.of(profile=options.profile)
    parts = queue.plan()
    total = sum(part["core_hours"] for part in parts)
    lines = [
        f"{part['table']}: {part['kept']} of {part['runs']} runs kept" + _left(part["core_hours"]) for part in parts
    ]
    print_results(options, {"parts": parts, "core_hours": total}, *lines, f"all{_left(total) or ', nothing left'}")
    if not options.plan:
        queue.train(options.workers)


def _left(hours: float) -> str:
    """How long it takes, in words."""
    if math.isnan(hours):
        return ", how long the others take is not known yet"
    return f", about {hours:.1f} core-hours left" if hours else ""
