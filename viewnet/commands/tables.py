"""Make every table and figure, and one page that shows them.

Run every notebook, one after the other, and write paper_tables/index.html with all tables and figures. What is
there is reused, so a command that was stopped goes on. If a notebook fails it is reported, the others still run,
and the exit code is 1.

Examples:

    viewnet tables                                                  everything, each at its notebook's default profile
    viewnet tables --profile smoke                                  does it all work? in minutes
    viewnet tables --only table1_shapenet table2_ablation --seeds 3
    viewnet tables --page                                           the page alone, from what is in paper_tables/
    viewnet tables --cluster tcp://HOST:8786                        rendered and trained on a Dask cluster
"""

from viewnet.commands.options import CLUSTER, Options, argument, choose_cluster, print_results
from viewnet.errors import ViewnetError
from viewnet.recipes import PROFILES

PROFILE = f"{', '.join(PROFILES)}, for every notebook that trains (default: each notebook's own)"
ARGUMENTS = (
    argument("--profile", PROFILE),
    argument("--seeds", "how many (3), or which (0,2), for every notebook that takes them", metavar="N"),
    argument("--only", "these and no others", nargs="+", metavar="NOTEBOOK"),
    argument("--page", "run nothing: write the page from what is there", action="store_true"),
    CLUSTER,
    argument("--json", "what was made, and what failed, as JSON", action="store_true"),
)


def run(options: Options) -> int:
    """Run the notebooks and write the page; 1 where some failed. ViewnetError for --page with other options."""
    from viewnet import paths
    from viewnet.experiments import notebooks
    from viewnet.experiments.page import page

    if options.page and (options.only or options.profile or options.seeds):
        raise ViewnetError("--page cannot be combined with other options")
    choose_cluster(options)
    done = []
    if not options.page:
        planned = notebooks.plan(options.only, options.profile, options.seeds)
        for outcome in notebooks.run_all(planned):
            done.append(outcome)
            if not options.json:
                print(outcome, flush=True)
    written = page.write(paths.tables())
    failed = [outcome.name for outcome in done if outcome.error]
    failures = [f"{len(failed)} of {len(done)} notebooks failed: {', '.join(failed)}"] if failed else []
    values = {"notebooks": [outcome.as_dict() for outcome in done], "page": str(written)}
    print_results(options, values, written, *failures)
    return 1 if failed else 0
