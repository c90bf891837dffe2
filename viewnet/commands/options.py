"""Options and output that several commands share."""

import argparse
import json
import os
from typing import Any

from viewnet.config import CATEGORIES, RunConfig
from viewnet.errors import ViewnetError
from viewnet.recipes import PROFILES, RECIPES, VARIANTS, make_config
from viewnet.training.dask_cluster import VARIABLE

Parser = argparse.ArgumentParser
"""What a command adds its arguments to."""
Options = argparse.Namespace
"""The parsed arguments that a command is run with."""
MODEL = (
    "the category of a model that comes with viewnet, a finished run's key or folder (viewnet train prints it), "
    "a saved model's folder, or NAME/MODEL of the hub"
)


def add_json(parser: Parser, help: str = "print the results as JSON") -> None:
    """The option --json."""
    parser.add_argument("--json", action="store_true", help=help)


def print_json(value: Any) -> None:
    """Print JSON values, indented."""
    print(json.dumps(value, indent=2, allow_nan=False))


def records(frame: Any) -> list[dict[str, Any]]:
    """The rows of a data frame as JSON values; NaN becomes null."""
    return json.loads(frame.to_json(orient="records"))


def add_model(parser: Parser) -> None:
    """The options --model and --device."""
    parser.add_argument("--model", required=True, metavar="WHERE", help=MODEL)
    parser.add_argument("--device", help="cpu, cuda, cuda:1 ... (default: a GPU if there is one)")


def add_configuration(parser: Parser) -> None:
    """The arguments that `configurations` reads."""
    parser.add_argument("categories", nargs="+", metavar="CATEGORY", help=f"of {', '.join(CATEGORIES)}")
    parser.add_argument("--variant", default="viewnet", help=f"{', '.join(VARIANTS)} (default: viewnet)")
    parser.add_argument("--profile", default="tiny", help=f"{', '.join(PROFILES)} (default: tiny)")
    parser.add_argument("--recipe", help=f"{', '.join(RECIPES)} (default: the profile's)")
    parser.add_argument(
        "-s",
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="override a setting of viewnet.config: epochs=3 (JSON)",
    )
    parser.add_argument("--data-root", metavar="FOLDER", help="ShapeNetCore, v1 or v2 (default: the built-in models)")
    parser.add_argument("--splits", metavar="FOLDER", help="lists <synset>_train.txt, _val.txt and _test.txt for it")


def configurations(options: Options, seed: int = 0) -> list[RunConfig]:
    """One configuration for each category. Raises ViewnetError as make_config does."""
    from viewnet.experiments.parameters import folder_named

    settings = dict(_setting(text) for text in options.set)
    root, splits = (folder_named(getattr(options, name) or "", name) for name in ("data_root", "splits"))
    return [
        make_config(options.variant, name, options.profile, options.recipe, seed, root, splits, **settings)
        for name in options.categories
    ]


def _setting(text: str) -> tuple[str, Any]:
    """Name and value of NAME=VALUE; a value that is not JSON is text."""
    name, separator, value = text.partition("=")
    if not separator:
        raise ViewnetError(f"-s {text}: expected NAME=VALUE, such as epochs=3")
    try:
        return name, json.loads(value)
    except (ValueError, RecursionError):
        return name, value


def add_cluster(parser: Parser) -> None:
    """The option --cluster."""
    address = "tcp://HOST:PORT or scheduler-file:PATH"
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help=f"a Dask scheduler that renders and trains: {address} (default: ${VARIABLE})",
    )


def choose_cluster(options: Options) -> None:
    """Set the cluster for this process and the kernels that it starts."""
    if options.cluster:
        os.environ[VARIABLE] = options.cluster
