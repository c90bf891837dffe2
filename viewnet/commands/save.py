"""Save a trained network as a folder for others.

Write weights (safetensors), configuration (JSON) and a model card, for viewnet predict,
ViewpointEstimator.from_pretrained and the Hugging Face hub. Prints the folder, or the address on the hub.

Examples:

    viewnet save 0123456789ab saved/car
    viewnet save 0123456789ab saved/car --half --push somebody/viewnet-car
    viewnet evaluate 0123456789ab --data-root /data/cars --json > scores.json
    viewnet save 0123456789ab saved/car --scores scores.json        adds these scores to the card
"""

from pathlib import Path

from viewnet.commands.options import Options, Parser


def add_arguments(parser: Parser) -> None:
    """The arguments of viewnet save."""
    parser.add_argument("model", metavar="WHERE", help="a finished run's key or folder, or another saved model's")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where to write it")
    parser.add_argument("--half", action="store_true", help="weights in 16 bits, at half the size")
    licence = "of the weights, in the hub's words (default: mit if trained on built-in models, else other)"
    parser.add_argument("--license", help=licence)
    scores = "output of viewnet evaluate --json on this model, for the card"
    parser.add_argument("--scores", nargs="+", type=Path, default=[], metavar="FILE", help=scores)
    parser.add_argument("--push", metavar="NAME/MODEL", help="send the folder to the Hugging Face hub")


def run(options: Options) -> None:
    """Write the folder and print its path, or its address on the hub."""
    from viewnet.estimator import ViewpointEstimator
    from viewnet.runtime.files import read_json

    estimator = ViewpointEstimator.from_pretrained(options.model, device="cpu")
    scores = []
    for path in options.scores:
        values = read_json(path)
        scores += values if isinstance(values, list) else [values]
    push = {"push_to_hub": options.push is not None, "repo_id": options.push}
    address = estimator.save_pretrained(
        options.folder, license=options.license, half=options.half, scores=scores, **push
    )
    print(address or options.folder)
