"""Views, trainings and their scores: viewnet render, train and evaluate."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import Any

from viewnet.commands import shared

RENDERING = """
viewnet render car chair                                        what viewnet train car chair learns from
viewnet render car --recipe photos --json                       over backgrounds, as for photographs
viewnet render car --profile paper --data-root /data/ShapeNetCore.v1 --cluster tcp://HOST:8786
"""
TRAINING = """
viewnet train car chair                                         on this machine: GPUs, or cores without any
viewnet train car --profile paper --data-root /data/ShapeNetCore.v1 --seed 1
viewnet train car -s epochs=3 -s muon=0.01                      any setting of viewnet.config
torchrun --nproc-per-node 4 -m viewnet train car --profile paper          one run over four GPUs
torchrun --nnodes 2 --nproc-per-node 4 --rdzv-backend c10d --rdzv-endpoint HOST:29500 -m viewnet train car
viewnet train car chair boat --cluster tcp://HOST:8786          many runs on a Dask cluster
"""
EVALUATING = """
viewnet evaluate 0123456789ab                                   on the run's own test views
viewnet evaluate 0123456789ab ba9876543210 --json
viewnet evaluate saved/car --data-root /data/PASCAL3D+_release1.1 --calibration 128
viewnet evaluate 0123456789ab --data-root /data/MoreCAD         on all models of another CAD collection
"""


def add(commands: Any) -> None:
    """Their parsers."""
    render = shared.add(
        commands,
        "render",
        "draw the views that training asks for",
        "Make what viewnet train would learn from with the same arguments: models, views and backgrounds. What is "
        "there\nis reused. Prints where each view store lies, how many views it has, and what could not be used.",
        RENDERING,
    )
    shared.add_configuration(render)
    render.add_argument("--workers", type=int, metavar="N", help="processes that draw (default: the machine's cores)")
    shared.add_cluster(render)
    shared.add_json(render)
    render.set_defaults(run=_render)
    train = shared.add(
        commands,
        "train",
        "train categories, one run each",
        "Train what is missing, and print where each run lies and how it scores on its test views.",
        TRAINING,
    )
    shared.add_configuration(train)
    train.add_argument("--seed", type=int, default=0, metavar="N")
    train.add_argument("--workers", type=int, metavar="N", help="runs side by side (default: what there is room for)")
    shared.add_cluster(train)
    shared.add_json(train)
    train.set_defaults(run=_train)
    evaluate = shared.add(
        commands,
        "evaluate",
        "score finished runs and saved models",
        "Scores with 95 % intervals, by each alignment, on the test views of a run or on other data. Alignments are "
        "fitted\non validation views, or calibration photographs, and never on what is scored.",
        EVALUATING,
    )
    evaluate.add_argument(
        "models", nargs="+", metavar="WHERE", help="a finished run's key or folder, or a saved model's folder"
    )
    elsewhere = evaluate.add_mutually_exclusive_group()
    elsewhere.add_argument(
        "--data-root",
        metavar="FOLDER",
        help="other data: PASCAL3D+, a folder with images/ and viewpoints.csv, or a ShapeNetCore folder",
    )
    elsewhere.add_argument("--stand-in", action="store_true", help="the project's stand-in for photographs")
    evaluate.add_argument(
        "--subset", default="imagenet", help="of PASCAL3D+: imagenet, pascal, both (default: %(default)s)"
    )
    evaluate.add_argument(
        "--calibration", type=int, metavar="N", help="views or photographs that alignments are fitted on (default: all)"
    )
    evaluate.add_argument(
        "--cad-root", metavar="FOLDER", help="where the collection that a model was trained on lies, if it has moved"
    )
    shared.add_json(evaluate)
    evaluate.set_defaults(run=_evaluate)


def _render(options: argparse.Namespace) -> None:
    from viewnet.data import augment
    from viewnet.training import dask_cluster, run_store

    configs = shared.configurations(options)
    shared.choose_cluster(options)
    views = run_store.default_steps().views
    found = []
    with dask_cluster.executor() if dask_cluster.named() else contextlib.nullcontext() as executor:
        for config in configs:
            store = views(config.data, workers=options.workers, progress=True, executor=executor)
            scenery = augment.wanted(config.data, config.model.input_size)
            index = store.index
            found.append(
                {
                    "category": config.category,
                    "folder": str(store.folder),
                    "identity": store.identity,
                    "views": len(index),
                    "splits": {
                        str(split): {"models": int(rows["model_id"].nunique()), "views": len(rows)}
                        for split, rows in index.groupby("split", sort=False)
                    },
                    "backgrounds": 0 if scenery is None else len(scenery.images),
                    "rejected": shared.records(store.rejected),
                }
            )
    if options.json:
        shared.print_json(found)
        return
    for one in found:
        splits = ", ".join(f"{of['views']} {split} ({of['models']} models)" for split, of in one["splits"].items())
        print(f"{one['category']}: {one['folder']}\n  {one['views']} views: {splits}")
        if one["backgrounds"]:
            print(f"  {one['backgrounds']} backgrounds")
        if one["rejected"]:
            print(f"  {len(one['rejected'])} models left out: {Path(one['folder']) / 'rejected.csv'}")


def _train(options: argparse.Namespace) -> None:
    from viewnet.runtime import distributed
    from viewnet.training import run_store

    distributed.start()
    configs = shared.configurations(options, options.seed)
    shared.choose_cluster(options)
    found = run_store.ensure(configs, options.workers)
    if distributed.rank() == 0:
        if options.json:
            shared.print_json([_told(run) for run in found])
        for run in found if not options.json else ():
            print(f"{run_store.name(run.config)}: {run.folder}")
            if not run.scored:
                print(f"  not scored: {run_store.NOT_SCORED}")
                continue
            score = run.result["metrics"][run.alignment]
            print(f"  test: within 30 degrees {score['acc30']:.1f} %, median {score['median']:.1f} degrees")
    distributed.stop()


def _told(run: Any) -> dict[str, Any]:
    """A finished run as JSON values: what its result.json says, and where it lies."""
    return {"folder": str(run.folder), **run.result}


def _evaluate(options: argparse.Namespace) -> None:
    from viewnet.experiments import score_model

    asked = score_model.Elsewhere(options.data_root, options.stand_in, options.subset, options.cad_root)
    found = [score_model.scores(where, asked, options.calibration) for where in options.models]
    if options.json:
        shared.print_json(found)
    else:
        print("\n\n".join(score_model.as_text(one) for one in found))
