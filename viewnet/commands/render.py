"""Render the views that training uses.

Make the CAD models, views and backgrounds that viewnet train uses with the same arguments; existing ones are reused.
Prints where each view store lies, how many views it has, and which models could not be used.

Examples:

    viewnet render car chair                                        what viewnet train car chair uses
    viewnet render car --recipe photos --json                       over backgrounds, as for photographs
    viewnet render car --profile paper --data-root /data/ShapeNetCore.v1 --cluster tcp://HOST:8786
"""

from pathlib import Path
from typing import Any

from viewnet.commands import options as shared
from viewnet.config import RunConfig

ARGUMENTS = (
    *shared.CONFIGURATION,
    shared.argument("--workers", "processes that render (default: the machine's cores)", type=int, metavar="N"),
    shared.CLUSTER,
    shared.DRY_RUN,
    shared.JSON,
)


def run(options: shared.Options) -> None:
    """Render what is missing and print what is there."""
    shared.choose_resources(options)
    from viewnet.runs import dask_cluster, make_run, needs, run_store

    configs = shared.configurations(options)
    run_store.check(configs, train=False)
    if options.dry_run:
        found = needs.views(configs)
        return shared.print_results(options, found.as_dict(), *found.lines())
    views = make_run.default_steps().views
    with dask_cluster.executor() as executor:
        stores = [
            _described(config, views(config.data, workers=options.workers, progress=True, executor=executor))
            for config in configs
        ]
    lines = []
    for store in stores:
        splits = [f"{part['views']} {split} ({part['models']} models)" for split, part in store["splits"].items()]
        lines += [f"{store['category']}: {store['folder']}", f"  {store['views']} views: {', '.join(splits)}"]
        if store["backgrounds"]:
            lines.append(f"  {store['backgrounds']} backgrounds")
        if store["rejected"]:
            kind = "models" if configs[0].data.video is None else "frames and clips"
            lines.append(f"  {len(store['rejected'])} {kind} left out: {Path(store['folder']) / 'rejected.csv'}")
    shared.print_results(options, stores, *lines)


def _described(config: RunConfig, store: Any) -> dict[str, Any]:
    """A view store as JSON values, with the number of backgrounds that its configuration asks for."""
    from viewnet.data import augment

    backgrounds = augment.made(config.data, config.model.input_size)
    splits = store.index.groupby("split", sort=False)
    return {
        "category": config.category,
        "folder": str(store.folder),
        "identity": store.identity,
        "views": len(store.index),
        "splits": {str(name): {"models": int(rows["model_id"].nunique()), "views": len(rows)} for name, rows in splits},
        "backgrounds": 0 if backgrounds is None else len(backgrounds.images),
        "rejected": shared.records(store.rejected),
    }
