"""Train categories, one run each.

Train the runs that are missing, and print where each lies and how it scores on its test views.

Examples:

    viewnet train car chair                                         on this machine: GPUs, or cores without any
    viewnet train car --profile paper --data-root /data/ShapeNetCore.v1 --seed 1
    viewnet train car --seeds 3                                     and which of these to keep, by no label
    viewnet train car -s epochs=3 -s muon=0.01                      any setting of viewnet.config
    viewnet train car chair --dry-run                               what would be made, how large, how long
    torchrun --nproc-per-node 4 -m viewnet train car --profile paper          one run over four GPUs
    torchrun --nnodes 2 --nproc-per-node 4 --rdzv-backend c10d --rdzv-endpoint HOST:29500 -m viewnet train car
    viewnet train car chair boat --cluster tcp://HOST:8786          many runs on a Dask cluster
"""

from viewnet.commands import options as shared

ARGUMENTS = (
    *shared.CONFIGURATION,
    shared.argument("--seed", type=int, default=0, metavar="N"),
    shared.argument("--seeds", "how many (3), or which (0,2), instead of --seed", metavar="N"),
    shared.argument("--workers", "runs side by side (default: what there is room for)", type=int, metavar="N"),
    shared.THREADS,
    shared.CLUSTER,
    shared.DRY_RUN,
    shared.JSON,
)


def run(options: shared.Options) -> None:
    """Train what is missing and print the runs; of several processes the first one prints."""
    shared.choose_resources(options)
    from viewnet.evaluation.run import NOT_SCORED
    from viewnet.experiments.parameters import PARAMETERS
    from viewnet.recipes import PEERS
    from viewnet.runs import run_store
    from viewnet.runs.needs import needs
    from viewnet.runtime import distributed

    distributed.start()
    seeds = PARAMETERS["seeds"].check(options.seeds, "seeds") if options.seeds else (options.seed,)
    configs = [config for seed in seeds for config in shared.configurations(options, seed)]
    if options.dry_run:
        found = needs(configs)
        return shared.print_results(options, found.as_dict(), *found.lines())
    runs = run_store.ensure(configs, options.workers)
    if distributed.rank() == 0:
        lines = []
        for run in runs:
            lines += [f"{run.name}: {run.folder}", f"  not scored: {NOT_SCORED}"]
            if run.scored:
                score = run.result["metrics"][run.alignment]
                lines[-1] = f"  test: within 30 degrees {score['acc30']:.1f} %, median {score['median']:.1f} degrees"
        for category in options.categories if len(seeds) > 1 and options.variant not in PEERS else ():
            best = min((run for run in runs if run.config.category == category), key=lambda run: run.reconstruction)
            lines.append(f"{best.name} reconstructs validation views best, which needs no label: keep it")
        shared.print_results(options, [{"folder": str(run.folder), **run.result} for run in runs], *lines)
    distributed.stop()
