"""Arguments and output that several commands share."""

import argparse
import json
import math
import os
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

from viewnet.config import CATEGORIES, RunConfig, settings
from viewnet.errors import ViewnetError
from viewnet.recipes import PEERS, PROFILES, RECIPES, VARIANTS, make_config
from viewnet.runtime import parallel

Options = argparse.Namespace  # the parsed arguments that a command is run with
Argument = tuple[list[str], dict[str, Any]]
"""Names and settings of an argument of a command. A list of arguments excludes each other."""


def argument(names: str, help: str | None = None, **settings: Any) -> Argument:
    """An argument of one or several names, separated by spaces; `settings` are those of argparse's add_argument."""
    return names.split(), settings | {"help": help}


JSON = argument("--json", "print the results as JSON", action="store_true")
BOX = ("X0", "Y0", "X1", "Y1")
LIST = "a CSV of boxes: image, x0, y0, x1, y1; an object a row; without IMAGE those it names, from its folder on"
BOXES = argument("--boxes", LIST, type=Path, metavar="FILE")
WHERE = (
    "the category of a model that comes with viewnet, a finished run's key or folder (viewnet train prints it), "
    "a saved model's folder, or NAME/MODEL of the hub"
)
MODEL = (
    argument("--model", WHERE, required=True, metavar="WHERE"),
    argument("--device", "cpu, cuda, cuda:1 ... (default: a GPU if there is one)"),
)
SCHEDULER = "a Dask scheduler that renders and trains: tcp://HOST:PORT or scheduler-file:PATH"
CLUSTER = argument("--cluster", f"{SCHEDULER} (default: ${parallel.CLUSTER})", metavar="ADDRESS")
VARIANT = argument("--variant", f"{', '.join((*VARIANTS, *PEERS))} (default: viewnet)", default="viewnet")
RECIPE = argument("--recipe", f"{', '.join(RECIPES)} (default: the profile's)")
ONE = f"threads of one run, or of the prediction (default: ${parallel.THREADS}, or its share of the cores)"
THREADS = argument("--threads", ONE, type=int, metavar="N")
NAMED = ("variant", "category", "profile", "recipe", "seed", "data_root", "splits")  # by arguments of their own
_TINY = make_config().to_dict()
SETTINGS = "\n".join(
    f"{name}={json.dumps(reduce(getitem, at, _TINY))}" for name, at in sorted(settings()) if name not in NAMED
)
OWN = "ShapeNetCore, v1 or v2, or a folder of your own: .obj models, videos, or folders of frames, with masks"
HALF = argument("--half", "weights in 16 bits, at half the size", action="store_true")
MOVED = "where the collection that the model was trained on lies, if it has moved"
CAD_ROOT = argument("--cad-root", MOVED, metavar="FOLDER")
RETRAINED = (HALF, CAD_ROOT, THREADS)
DRY = "make nothing: what is kept, what would be made, how large, how long"
DRY_RUN = argument("--dry-run", DRY, action="store_true")
CONFIGURATION = (
    argument("categories", f"{', '.join(CATEGORIES)}; of own data any", nargs="+", metavar="CATEGORY"),
    VARIANT,
    argument("--profile", f"{', '.join(PROFILES)} (default: tiny)", default="tiny"),
    RECIPE,
    argument("-s --set", "another value, as JSON", action="append", default=[], metavar="NAME=VALUE"),
    argument("--settings", "list them with their values at the profile tiny", action="version", version=SETTINGS),
    argument("--data-root --data", f"{OWN} (default: the built-in models)", metavar="FOLDER"),
    argument("--splits", "lists <synset>_train.txt, _val.txt and _test.txt for it", metavar="FOLDER"),
)
"""The arguments that `configurations` reads."""


def print_results(options: Options, values: Any, *texts: object) -> None:
    """Print values as JSON where --json asks for it, or else texts, each on a line of its own."""
    print(*([json.dumps(values, indent=2, allow_nan=False)] if options.json else texts), sep="\n")


def records(frame: Any) -> list[dict[str, Any]]:
    """The rows of a data frame as JSON values; NaN becomes null."""
    return json.loads(frame.to_json(orient="records"))


def configurations(options: Options, seed: int = 0) -> list[RunConfig]:
    """One configuration for each category, of models or videos as the folder has them.

    Where these are few, there are more views of each model, or more epochs of videos, so that a training has as many
    targets as one of built-in models. Raises ViewnetError as make_config and view_store do.
    """
    from viewnet.data import build
    from viewnet.experiments.parameters import folder_named

    settings = dict(_setting(text) for text in options.set)
    root, splits = (folder_named(getattr(options, name) or "", name) for name in ("data_root", "splits"))

    def config(category: str) -> RunConfig:
        filmed = root and "video" not in settings and build.shows_videos(Path(root), category)
        given = settings | ({"video": {"category": category, "root": root}} if filmed else {})
        how = (options.variant, category, options.profile, options.recipe, seed, None if filmed else root, splits)
        found, usual = make_config(*how, **given), make_config(profile=options.profile, recipe=options.recipe).data
        setting, wanted = "epochs" if filmed else "views", usual.models * usual.views  # 0 models: all that there are
        if not root or not wanted or options.profile == "smoke" or {setting, "video"} & settings.keys():
            return found
        share = build.count_views(found.data) / wanted
        value = found.train.epochs if filmed else found.data.views
        return make_config(*how, **(given | {setting: math.ceil(value / share)})) if 0 < share < 1 else found

    return [config(category) for category in options.categories]


def _setting(text: str) -> tuple[str, Any]:
    """Name and value of NAME=VALUE; a value that is not JSON is text."""
    name, separator, value = text.partition("=")
    if not separator:
        raise ViewnetError(f"-s {text}: expected NAME=VALUE, such as epochs=3")
    if name in NAMED:
        raise ViewnetError(f"-s {text}: {name} is no setting here: it has an argument of its own (see --help)")
    try:
        return name, json.loads(value)
    except (ValueError, RecursionError):
        return name, value


def choose_resources(options: Options) -> None:
    """Set cluster and threads, where a command has them, for this process and those that it starts.

    Call it before PyTorch is imported. ViewnetError for a number of threads or workers out of range, and for threads of
    a cluster, whose workers have their own.
    """
    if getattr(options, "cluster", None):
        os.environ[parallel.CLUSTER] = options.cluster
    for name in ("threads", "workers"):
        if (count := getattr(options, name, None)) is not None and not 1 <= count <= parallel.MOST_THREADS:
            raise ViewnetError(f"--{name} {count}: expected 1 to {parallel.MOST_THREADS}")
    if (threads := getattr(options, "threads", None)) is None:
        return
    if os.environ.get(parallel.CLUSTER):
        raise ViewnetError(f"--threads: workers of a cluster have their own {parallel.THREADS}: leave one of them out")
    os.environ[parallel.THREADS] = str(threads)
