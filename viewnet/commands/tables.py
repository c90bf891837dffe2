"""Make every table and figure, and one page that shows them.

Run every notebook, one after the other, and write paper_tables/index.html with all tables and figures. What is
there is reused, so a command that was stopped goes on. If a notebook fails, the others still run; the exit code is 1.

Examples:

    viewnet tables                                                  everything, each at its notebook's default profile
    viewnet tables --profile smoke                                  does it all work? in minutes
    viewnet tables --only table1_shapenet table2_ablation --seeds 3
    viewnet tables --page                                           the page alone, from what is in paper_tables/
    viewnet tables --claims                                         the verdict on each claim of the paper
    viewnet tables --from-predictions                               is every number that of the predictions beside it?
    viewnet tables --cluster tcp://HOST:8786                        rendered and trained on a Dask cluster
"""

from pathlib import Path

from viewnet.commands.options import CLUSTER, DRY_RUN, Options, argument, choose_resources, print_results
from viewnet.errors import ViewnetError
from viewnet.recipes import PROFILES

PROFILE = f"{', '.join(PROFILES)}, for every notebook that trains (default: each notebook's own)"
AGAIN = "run nothing: compute every table again from the predictions beside it, and compare"
ARGUMENTS = (
    argument("--profile", PROFILE),
    argument("--seeds", "how many (3), or which (0,2), for every notebook that takes them", metavar="N"),
    argument("--only", "these and no others", nargs="+", metavar="NOTEBOOK"),
    argument("--page", "run nothing: write the page from what is there", action="store_true"),
    argument("--claims", "run nothing: the verdict on each claim of the paper", action="store_true"),
    argument("--from-predictions", AGAIN, action="store_true"),
    CLUSTER,
    DRY_RUN,
    argument("--json", "what was made, and what failed, as JSON", action="store_true"),
)


def run(options: Options) -> int:
    """Run the notebooks and write the page; 1 where some failed. ViewnetError for options that exclude each other."""
    from viewnet import paths
    from viewnet.experiments import notebooks
    from viewnet.experiments.page import page

    alone = [name for name in ("page", "claims", "from_predictions") if getattr(options, name)]
    if alone and (len(alone) > 1 or options.only or options.profile or options.seeds or options.dry_run):
        raise ViewnetError(f"--{alone[0].replace('_', '-')} cannot be combined with other options")
    if options.claims:
        return _judge(options, paths.tables())
    if options.from_predictions:
        return _compare(options, paths.tables())
    choose_resources(options)
    done = []
    if not options.page:
        planned = notebooks.plan(options.only, options.profile, options.seeds)
        if options.dry_run:
            found = notebooks.needs(planned)
            print_results(options, found.as_dict(), *found.lines())
            return 0
        for outcome in notebooks.run_all(planned):
            done.append(outcome)
            if not options.json:
                ending = f"failed: {outcome['error']}" if outcome["error"] else outcome["copy"]
                print(f"{outcome['name']}: {outcome['seconds']:.0f} s: {ending}", flush=True)
    written = page.write(paths.tables())
    failed = [outcome["name"] for outcome in done if outcome["error"]]
    failures = [f"{len(failed)} of {len(done)} notebooks failed: {', '.join(failed)}"] if failed else []
    values = {"notebooks": done, "page": str(written)}
    print_results(options, values, written, *failures)
    return 1 if failed else 0


def _judge(options: Options, folder: Path) -> int:
    """Print the verdicts on the claims. ViewnetError where the folder has none, and as viewnet.tables.claims.judge."""
    from viewnet.tables import claims

    if not (judged := claims.judge(folder, progress=True)):
        raise ViewnetError(f"{folder / claims.NAME}: no such file: give VIEWNET_TABLES a folder that has it")
    names = ("id", "says", "place", "criterion", "scope")
    values = [
        {name: getattr(each.claim, name) for name in names}
        | {"verdict": each.verdict, "recipes": each.by_recipe, "evidence": each.evidence}
        for each in judged
    ]
    print_results(options, values, claims.counts(judged), *judged)
    return 0


def _compare(options: Options, folder: Path) -> int:
    """Compute tables again from their predictions; 1 where a number is another. ViewnetError where there are none."""
    from viewnet.runtime.progress import bar
    from viewnet.tables import kept_predictions, novel_view_scores

    files = [path for path in sorted(folder.rglob("*.json")) if path.with_suffix(".parquet").is_file()]
    files += sorted(folder.rglob(novel_view_scores.KEPT))
    if not files:
        raise ViewnetError(f"{folder}: no table with its predictions: make one with viewnet tables")
    found = {}
    for path in bar(True, iterable=files, desc="tables", unit="table"):
        kept = novel_view_scores if path.name == novel_view_scores.KEPT else kept_predictions
        found[str(path.relative_to(folder))] = kept.differences(path)
    lines = []
    for name, cells in found.items():
        lines.append(f"{name}: {f'{len(cells)} numbers differ' if len(cells) else 'as its predictions'}")
        lines += [f"    {' '.join(map(str, cell))}" for cell in cells.itertuples(index=False)]
    print_results(options, {name: cells.to_dict("records") for name, cells in found.items()}, *lines)
    return int(any(map(len, found.values())))
