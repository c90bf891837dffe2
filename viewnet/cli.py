"""The command `viewnet`."""

from __future__ import annotations

import argparse
import json
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from viewnet.cluster import VARIABLE
from viewnet.config import CATEGORIES, PROFILES, RECIPES, VARIANTS, make_config
from viewnet.demo_command import add_demo
from viewnet.errors import ViewnetError

TRAINING = """examples:
  viewnet train car chair                                         on this machine: GPUs, or cores without any
  viewnet train car --profile paper --data-root /data/ShapeNetCore.v1 --seed 1
  viewnet train car -s epochs=3 -s muon=0.01                      any setting of viewnet.config
  torchrun --nproc-per-node 4 -m viewnet train car --profile paper          one run over four GPUs
  torchrun --nnodes 2 --nproc-per-node 4 --rdzv-backend c10d --rdzv-endpoint HOST:29500 -m viewnet train car
  viewnet train car chair boat --cluster tcp://HOST:8786          many runs on a Dask cluster
"""

PREDICTING = """examples:
  viewnet predict car.jpg --model 0123456789ab                    all of the picture is the object
  viewnet predict car.jpg --model 0123456789ab --box 40 60 380 250
  viewnet predict a.jpg b.jpg --masks a_mask.png b_mask.png --model runs/viewnet/0123456789ab
  viewnet predict *.png --json --model saved/car                  cut out: transparency is a mask
"""
TURNING = """examples:
  viewnet turntable car.png --model 0123456789ab -o car.gif
  viewnet turntable car.jpg --box 40 60 380 250 --model saved/car -o car.mp4 --size 256
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code: 0, 2 for what the user can mend (told in one line), 130 when interrupted."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except ViewnetError as error:
        if os.environ.get("WORLD_SIZE", "1") != "1":
            _fail_together(f"viewnet: {error}")
        print(f"viewnet: {error}", file=sys.stderr)
        return 2
    except Exception:
        if os.environ.get("WORLD_SIZE", "1") != "1":
            _fail_together(traceback.format_exc())
        raise
    except KeyboardInterrupt:
        print("viewnet: interrupted: the same command goes on where it was", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="viewnet", description="ViewNet, replicated: tables and figures of the paper."
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    notebook = commands.add_parser(
        "notebook",
        help="make a table or figure: run its notebook",
        description="Run a notebook with papermill. Whatever it needs and is not there is rendered and trained first.",
    )
    notebook.add_argument("name", help="for example table2_ablation")
    notebook.add_argument(
        "-p", nargs=2, action="append", default=[], metavar=("NAME", "VALUE"), dest="values", help="a parameter"
    )
    notebook.add_argument("-o", "--output", type=Path, help="the executed copy (default: runs/notebooks/NAME.ipynb)")
    notebook.add_argument("--parameters", action="store_true", help="list the parameters and stop")
    notebook.add_argument("--refresh", action="store_true", help="run with the defaults and keep the outputs in place")
    _add_cluster(notebook)
    notebook.set_defaults(run=_notebook)
    train = commands.add_parser(
        "train",
        help="train categories, one run each",
        description="Train what is missing, and print where each run lies and how it scores on its test views.",
        epilog=TRAINING,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    train.add_argument("categories", nargs="+", metavar="CATEGORY", help=f"of {', '.join(CATEGORIES)}")
    train.add_argument("--variant", default="viewnet", help=f"{', '.join(VARIANTS)} (default: viewnet)")
    train.add_argument("--profile", default="tiny", help=f"{', '.join(PROFILES)} (default: tiny)")
    train.add_argument("--recipe", help=f"{', '.join(RECIPES)} (default: the profile's)")
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("-s", "--set", action="append", default=[], metavar="NAME=VALUE", help="another value, as JSON")
    train.add_argument("--workers", type=int, help="runs side by side (default: what the machine has room for)")
    train.add_argument("--data-root", metavar="FOLDER", help="ShapeNetCore, v1 or v2 (default: the built-in models)")
    train.add_argument("--splits", metavar="FOLDER", help="lists <synset>_train.txt, _val.txt and _test.txt for it")
    _add_cluster(train)
    train.set_defaults(run=_train)
    data = commands.add_parser(
        "data",
        help="what data the project reads, where it is had, and what a copy of it holds",
        description="Say which data sets and weights are read, how a copy is named, its terms and where it is had; "
        "with `check`, what a folder holds. Nothing is downloaded.",
    )
    data.add_argument("what", nargs="?", choices=["check"], help="check: read a folder instead")
    data.add_argument("folder", nargs="?", type=Path, metavar="FOLDER", help="the folder to check")
    data.add_argument("--json", action="store_true", help="as JSON")
    data.set_defaults(run=_data)
    audit = commands.add_parser(
        "audit",
        help="hold the printed numbers of constants against a list of viewpoints",
        description="What the printed scores of constants, and the confidence index, can and cannot be by each "
        "definition of the error in print.",
    )
    audit.add_argument(
        "--viewpoints",
        type=Path,
        required=True,
        metavar="FILE",
        help="a CSV with category, azimuth_deg, elevation_deg, and if there are: subset, split, easy, annotated",
    )
    audit.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="where every number goes, as CSV files")
    audit.set_defaults(run=_audit)
    _add_estimating(commands)
    add_demo(commands)
    bench = commands.add_parser(
        "bench",
        help="measure renderer and training step against a textbook version",
        description="Time and memory of the volume renderer and of the training step, beside those of a plain "
        "textbook version, measured in turn; on the GPU where there is one. See benchmarks/README.md.",
    )
    bench.add_argument("--sizes", type=int, nargs="+", metavar="N", help="voxels along a side (default: 32 64 128)")
    bench.add_argument("--batch", type=int, metavar="N", help="targets of a training step (default: 16; 64 on a GPU)")
    bench.add_argument("--repeat", type=int, metavar="N", help="measurements of each (default: 5)")
    bench.add_argument("--threads", type=int, metavar="N", help="of the processor (default: its cores)")
    bench.add_argument(
        "--accuracy",
        type=int,
        default=0,
        metavar="SEEDS",
        help="train on built-in models too: minutes a seed (default: 0)",
    )
    bench.add_argument("--quick", action="store_true", help="all small, in seconds: whether it works, no measurement")
    bench.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="where the files go (default: paper_tables/benchmarks)"
    )
    bench.set_defaults(run=_bench)
    return parser


def _add_estimating(commands: Any) -> None:
    """The commands for people's own pictures; viewnet.commands has their bodies."""
    from viewnet import commands as bodies

    where = "a finished run's key or folder (viewnet train prints it), a saved model's folder, or NAME/MODEL of the hub"
    predict = commands.add_parser(
        "predict",
        help="tell from where pictures were taken",
        description="The viewpoint of each picture: azimuth (0 shows the object's front, 90 its left side), elevation, "
        "and how sure\nthe network is. The object's mask or box decides what of a picture is seen; its transparency is "
        "a mask.",
        epilog=PREDICTING,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    predict.add_argument("pictures", nargs="+", type=Path, metavar="PICTURE")
    predict.add_argument("--masks", nargs="+", type=Path, metavar="FILE", help="one a picture, in their order")
    predict.add_argument("--box", nargs=4, type=float, action="append", dest="boxes", metavar=("X0", "Y0", "X1", "Y1"),
                         help="the object's edges in pixels; once for all pictures, or once for each")  # fmt: skip
    predict.add_argument("--json", action="store_true", help="every hypothesis, as JSON")
    predict.set_defaults(run=bodies.predict)
    turntable = commands.add_parser(
        "turntable",
        help="show a picture's object from all around",
        description="A picture and what the network makes of its object, turning once from the predicted viewpoint.",
        epilog=TURNING,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    turntable.add_argument("picture", type=Path, metavar="PICTURE")
    turntable.add_argument("--mask", type=Path, metavar="FILE")
    turntable.add_argument("--box", nargs=4, type=float, metavar=("X0", "Y0", "X1", "Y1"))
    turntable.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="ends in .gif or .mp4")
    turntable.add_argument("--size", type=int, default=192, help="pixels along a side of a picture (default: 192)")
    turntable.add_argument("--steps", type=int, default=48, help="pictures of the turn (default: 48)")
    turntable.set_defaults(run=bodies.turntable)
    for command in (predict, turntable):
        command.add_argument("--model", required=True, metavar="WHERE", help=where)
        command.add_argument("--device", help="cpu, cuda, cuda:1 ... (default: a GPU if there is one)")


def _add_cluster(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help=f"a Dask scheduler that renders and trains: tcp://HOST:PORT or scheduler-file:PATH (default: ${VARIABLE})",
    )


def _train(options: argparse.Namespace) -> None:
    from viewnet import distributed, experiment, runs

    distributed.start()
    given = dict(_setting(text) for text in options.set)
    root, splits = (experiment.folder_named(getattr(options, name) or "", name) for name in ("data_root", "splits"))
    configs = [
        make_config(options.variant, name, options.profile, options.recipe, options.seed, root, splits, **given)
        for name in options.categories
    ]
    _choose_cluster(options)
    found = runs.ensure(configs, options.workers)
    if distributed.rank() == 0:
        for run in found:
            print(f"{runs.name(run.config)}: {run.folder}")
            if not run.scored:
                print(f"  not scored: {runs.NOT_SCORED}")
                continue
            score = run.result["metrics"][run.alignment]
            print(f"  test: within 30 degrees {score['acc30']:.1f} %, median {score['median']:.1f} degrees")
    distributed.stop()


def _setting(text: str) -> tuple[str, Any]:
    """NAME=VALUE; what is no JSON is text."""
    name, found, value = text.partition("=")
    if not found:
        raise ViewnetError(f"-s {text}: expected NAME=VALUE, such as epochs=3")
    try:
        return name, json.loads(value)
    except (ValueError, RecursionError):
        return name, value


def _choose_cluster(options: argparse.Namespace) -> None:
    """For this process and the kernels that it starts."""
    if options.cluster:
        os.environ[VARIABLE] = options.cluster


def _fail_together(message: str) -> None:
    from viewnet import distributed

    if distributed.size() > 1:
        distributed.fail(message)


def _bench(options: argparse.Namespace) -> None:
    from viewnet import bench, bench_report, paths

    settings = bench.Settings.default(
        sizes=None if options.sizes is None else tuple(options.sizes),
        batch=options.batch,
        repeat=options.repeat,
        threads=options.threads,
        accuracy=options.accuracy,
        quick=options.quick,
    )
    found = bench.measure(settings)
    print(bench_report.as_text(found))
    print(*bench_report.write(found, options.output or paths.tables() / "benchmarks"), sep="\n")


def _data(options: argparse.Namespace) -> None:
    from viewnet import data_sets

    if options.what and options.folder is None:
        raise ViewnetError("data check: name the folder to check")
    found = data_sets.check(options.folder) if options.what else None
    print(json.dumps(data_sets.as_dict(found), indent=2) if options.json else data_sets.as_text(found))
    if found is not None and found.problems and not any(found.counts.values()):
        raise ViewnetError(f"{found.folder}: nothing in it can be used")


def _audit(options: argparse.Namespace) -> None:
    from viewnet.audit import audit_list

    found = audit_list(options.viewpoints)
    print(found.note)
    print("\nRows Constant: verdict by each definition of the error, and the test sets where it holds")
    print(found.summary().to_string())
    print("\nConfidence index")
    print(found.confidence.to_string(index=False))
    if options.output:
        print(*found.write(options.output), sep="\n")


def _notebook(options: argparse.Namespace) -> None:
    from viewnet import notebook

    if options.parameters:
        for name, found in notebook.parameters(notebook.find(options.name)).items():
            print(f"{name} = {found['default']}  ({found['inferred_type_name']}) {found['help']}")
        return
    if options.refresh:
        if options.values or options.output:
            raise ViewnetError("--refresh takes neither -p nor --output: set VIEWNET_PROFILE for another profile")
        print(notebook.refresh(options.name))
        return
    _choose_cluster(options)
    print(notebook.run(options.name, [(name, value) for name, value in options.values], options.output))


if __name__ == "__main__":
    sys.exit(main())
