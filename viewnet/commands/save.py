"""Save a trained network as a folder for others.

Write weights (safetensors), configuration (JSON) and a model card, for viewnet predict,
ViewpointEstimator.from_pretrained and the Hugging Face hub. Prints the folder, or the address on the hub.

Examples:

    viewnet save 0123456789ab saved/car
    viewnet save 0123456789ab saved/car --half --push somebody/viewnet-car
    viewnet evaluate 0123456789ab --data-root /data/cars --json > scores.json
    viewnet save 0123456789ab saved/car --scores scores.json        adds these scores to the card
    viewnet save car saved/car --calibrate /data/cars
    viewnet save 0123456789ab saved/car --calibrate stand-in        where there are no such photographs
"""

from pathlib import Path

from viewnet.commands.options import HALF, Options, argument

LICENCE = "of the weights, in the hub's words (default: mit if trained on built-in models, else other)"
SCORES = "output of viewnet evaluate --json on this model, for the card"
CALIBRATE = "make confidences true on photographs with a list of viewpoints, by those marked val; or on: stand-in"
ARGUMENTS = (
    argument("model", "a finished run's key or folder, or another saved model's", metavar="WHERE"),
    argument("folder", "where to write it", type=Path, metavar="FOLDER"),
    HALF,
    argument("--license", LICENCE),
    argument("--scores", SCORES, nargs="+", type=Path, default=[], metavar="FILE"),
    argument("--calibrate", CALIBRATE, metavar="FOLDER"),
    argument("--push", "send the folder to the Hugging Face hub", metavar="NAME/MODEL"),
)


def run(options: Options) -> None:
    """Write the folder and print its path, or its address on the hub."""
    from viewnet.estimator import ViewpointEstimator
    from viewnet.experiments import calibrated
    from viewnet.runtime.files import read_json

    estimator = ViewpointEstimator.from_pretrained(options.model, device="cpu")
    if options.calibrate:
        calibrated.calibrate(estimator, options.calibrate)
    scores = []
    for path in options.scores:
        values = read_json(path)
        scores += values if isinstance(values, list) else [values]
    how = {"license": options.license, "half": options.half, "scores": scores}
    push = {"push_to_hub": options.push is not None, "repo_id": options.push}
    print(estimator.save_pretrained(options.folder, **how, **push) or options.folder)
