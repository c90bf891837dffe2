"""What readers see: viewnet notebook and viewnet tables."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from viewnet.commands import shared
from viewnet.errors import ViewnetError
from viewnet.recipes import PROFILES

NOTEBOOK = """
viewnet notebook table2_ablation                                the copy goes to runs/notebooks/
viewnet notebook table2_ablation -p profile smoke -p categories car -p seeds 3
viewnet notebook table3_pascal3d -p data_root /data/PASCAL3D+_release1.1 -p cad_root /data/ShapeNetCore.v1
viewnet notebook table2_ablation --parameters                   what can be set
"""
TABLES = """
viewnet tables                                                  everything, each at its notebook's default profile
viewnet tables --profile smoke                                  does it all work? in minutes
viewnet tables --only table1_shapenet table2_ablation --seeds 3
viewnet tables --page                                           the page alone, from what is in paper_tables/
viewnet tables --cluster tcp://HOST:8786                        drawn and trained on a Dask cluster
"""


def add(commands: Any) -> None:
    """Their parsers."""
    notebook = shared.add(
        commands,
        "notebook",
        "make a table or figure: run its notebook",
        "Run a notebook with papermill. Whatever it needs and is not there is rendered and trained first.",
        NOTEBOOK,
    )
    notebook.add_argument("name", metavar="NOTEBOOK", help="for example table2_ablation")
    notebook.add_argument(
        "-p", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"), dest="values", help="a parameter"
    )
    notebook.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="the executed copy (default: runs/notebooks/NOTEBOOK.ipynb)"
    )
    notebook.add_argument("--parameters", action="store_true", help="list the parameters and stop")
    notebook.add_argument("--refresh", action="store_true", help="run with the defaults and keep the outputs in place")
    shared.add_cluster(notebook)
    notebook.set_defaults(run=_notebook)
    tables = shared.add(
        commands,
        "tables",
        "make every table and figure, and one page that shows them",
        "Run every notebook, one after the other, and write paper_tables/index.html with all tables and figures. What "
        "is\nthere is reused, so a command that was stopped goes on. A notebook that fails is told and the others go "
        "on;\nthe exit code is 1 then.",
        TABLES,
    )
    tables.add_argument(
        "--profile", help=f"{', '.join(PROFILES)}, for every notebook that trains (default: each notebook's own)"
    )
    tables.add_argument("--seeds", metavar="N", help="how many (3), or which (0,2), for every notebook that takes them")
    tables.add_argument("--only", nargs="+", metavar="NOTEBOOK", help="these and no others")
    tables.add_argument("--page", action="store_true", help="run nothing: write the page from what is there")
    shared.add_cluster(tables)
    shared.add_json(tables, "what was made, and what failed, as JSON")
    tables.set_defaults(run=_tables)


def _notebook(options: argparse.Namespace) -> None:
    from viewnet.experiments import notebook

    if options.parameters:
        for name, found in notebook.parameters(notebook.find(options.name)).items():
            print(f"{name} = {found['default']}  ({found['inferred_type_name']}) {found['help']}")
        return
    if options.refresh:
        if options.values or options.output:
            raise ViewnetError("--refresh takes neither -p nor --output: set VIEWNET_PROFILE for another profile")
        print(notebook.refresh(options.name))
        return
    shared.choose_cluster(options)
    print(notebook.run(options.name, [(name, value) for name, value in options.values], options.output))


def _tables(options: argparse.Namespace) -> int:
    from viewnet import paths
    from viewnet.experiments import all_notebooks
    from viewnet.experiments.page import page

    if options.page and (options.only or options.profile or options.seeds):
        raise ViewnetError("--page runs nothing: give it alone, or leave it out")
    shared.choose_cluster(options)
    done = []
    if not options.page:
        planned = all_notebooks.planned(options.only, options.profile, options.seeds)
        for one in all_notebooks.run(planned):
            done.append(one)
            if not options.json:
                print(one, flush=True)
    written = page.write(paths.tables())
    failed = [one.name for one in done if one.error]
    if options.json:
        shared.print_json({"notebooks": [one.as_dict() for one in done], "page": str(written)})
    else:
        print(written)
        if failed:
            print(f"{len(failed)} of {len(done)} notebooks failed: {', '.join(failed)}")
    return 1 if failed else 0
