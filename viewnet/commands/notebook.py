"""Make a table or figure: run its notebook.

Run a notebook with papermill. Views and runs that it needs and that are missing are rendered and trained first.

Examples:

    viewnet notebook table2_ablation                                the copy goes to runs/notebooks/
    viewnet notebook table2_ablation -p profile smoke -p categories car -p seeds 3
    viewnet notebook table3_pascal3d -p data_root /data/PASCAL3D+_release1.1 -p cad_root /data/ShapeNetCore.v1
    viewnet notebook table2_ablation --dry-run                      what would be rendered and trained for it
    viewnet notebook table2_ablation --parameters                   what can be set
    viewnet notebook all --refresh                                  what is stored in the notebooks, from paper_tables/
"""

from pathlib import Path

from viewnet.commands.options import CLUSTER, DRY_RUN, THREADS, Options, argument, choose_resources
from viewnet.errors import ViewnetError

ARGUMENTS = (
    argument("name", "for example table2_ablation; all, with --refresh", metavar="NOTEBOOK"),
    argument("-p", "a parameter", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"), dest="values"),
    argument("-o --output", "the executed copy, or its folder (default: runs/notebooks)", type=Path, metavar="WHERE"),
    argument("--parameters", "list the parameters and stop", action="store_true"),
    argument("--refresh", "store what is committed anew in the notebook; trains nothing", action="store_true"),
    THREADS,
    CLUSTER,
    DRY_RUN,
)


def run(options: Options) -> None:
    """Run the notebook and print the path of its copy. ViewnetError for --refresh with values."""
    choose_resources(options)
    from viewnet.experiments import notebooks

    if options.refresh:
        if options.values or options.output or options.dry_run:
            raise ViewnetError("--refresh takes neither -p nor --output nor --dry-run")
        print(*notebooks.refresh(notebooks.ORDER if options.name == "all" else [options.name]), sep="\n")
    elif options.parameters:
        print(*notebooks.parameters(notebooks.find(options.name).stem), sep="\n")
    elif options.dry_run:
        name = notebooks.find(options.name).stem
        print(*notebooks.check(name, options.values).needs().lines(), sep="\n")
    else:
        print(notebooks.run(options.name, options.values, options.output))
