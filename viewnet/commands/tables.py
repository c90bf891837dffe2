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

from viewnet.commands.options import Options, Parser, add_cluster, add_json, choose_cluster, print_json
from viewnet.errors import ViewnetError
from viewnet.recipes import PROFILES


def add_arguments(parser: Parser) -> None:
    """The arguments of viewnet tables."""
    add = parser.add_argument
    add("--profile", help=f"{', '.join(PROFILES)}, for every notebook that trains (default: each notebook's own)")
    add("--seeds", metavar="N", help="how many (3), or which (0,2), for every notebook that takes them")
    add("--only", nargs="+", metavar="NOTEBOOK", help="these and no others")
    add("--page", action="store_true", help="only write the page, from existing files")
    add_cluster(parser)
    add_json(parser, "what was made, and what failed, as JSON")


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
    if options.json:
        print_json({"notebooks": [outcome.as_dict() for outcome in done], "page": str(written)})
    else:
        print(written)
        if failed:
            print(f"{len(failed)} of {len(done)} notebooks failed: {', '.join(failed)}")
    return 1 if failed else 0
