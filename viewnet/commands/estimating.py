"""For people's own images: viewnet predict and viewnet turntable; viewnet save for other people's."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from viewnet.commands import shared

PREDICTING = """
viewnet predict car.jpg --model 0123456789ab                    all of the image is the object
viewnet predict car.jpg --model 0123456789ab --box 40 60 380 250
viewnet predict a.jpg b.jpg --masks a_mask.png b_mask.png --model runs/viewnet/0123456789ab
viewnet predict car.jpg --model car --all                       every hypothesis, the most probable first
viewnet predict *.png --json --model saved/car                  cut out: transparency is a mask
"""
TURNING = """
viewnet turntable car.png --model 0123456789ab -o car.gif
viewnet turntable car.jpg --box 40 60 380 250 --model saved/car -o car.mp4 --size 256
"""
SAVING = """
viewnet save 0123456789ab saved/car
viewnet save 0123456789ab saved/car --half --push somebody/viewnet-car
viewnet evaluate 0123456789ab --data-root /data/cars --json > scores.json
viewnet save 0123456789ab saved/car --scores scores.json        the card tells these, too
"""


def add(commands: Any) -> None:
    """Their parsers."""
    predict = shared.add(
        commands,
        "predict",
        "tell from where images were taken",
        "The viewpoint of each image: azimuth (0 shows the object's front, 90 its left side), elevation, "
        "and how sure\nthe network is. The object's mask or box decides what of an image is seen; its transparency is "
        "a mask.",
        PREDICTING,
    )
    predict.add_argument("pictures", nargs="+", type=Path, metavar="IMAGE")
    predict.add_argument("--masks", nargs="+", type=Path, metavar="FILE", help="one an image, in their order")
    predict.add_argument("--box", nargs=4, type=float, action="append", dest="boxes", metavar=("X0", "Y0", "X1", "Y1"),
                         help="the object's edges in pixels; once for all images, or once for each")  # fmt: skip
    predict.add_argument("--all", action="store_true", help="every hypothesis, and not only the most probable")
    shared.add_json(predict, "every hypothesis, as JSON")
    predict.set_defaults(run=_predict)
    turntable = shared.add(
        commands,
        "turntable",
        "show an image's object from all around",
        "An image and what the network makes of its object, turning once from the predicted viewpoint.",
        TURNING,
    )
    turntable.add_argument("picture", type=Path, metavar="IMAGE")
    turntable.add_argument("--mask", type=Path, metavar="FILE")
    turntable.add_argument("--box", nargs=4, type=float, metavar=("X0", "Y0", "X1", "Y1"))
    turntable.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="ends in .gif or .mp4")
    turntable.add_argument("--size", type=int, default=192, help="pixels along a side of an image (default: 192)")
    turntable.add_argument("--steps", type=int, default=48, help="images of the turn (default: 48)")
    turntable.set_defaults(run=_turntable)
    for command in (predict, turntable):
        shared.add_model(command)
    save = shared.add(
        commands,
        "save",
        "write a trained network as a folder, for others",
        "Weights (safetensors), configuration (JSON) and a model card, for viewnet predict, "
        "ViewpointEstimator.from_pretrained\nand the Hugging Face hub. Prints the folder, or the address on the hub.",
        SAVING,
    )
    save.add_argument("model", metavar="WHERE", help="a finished run's key or folder, or another saved model's")
    save.add_argument("folder", type=Path, metavar="FOLDER", help="where to write it")
    save.add_argument("--half", action="store_true", help="weights in 16 bits, at half the size")
    save.add_argument(
        "--license", help="of the weights, in the hub's words (default: mit of built-in models, else other)"
    )
    save.add_argument("--scores", nargs="+", type=Path, default=[], metavar="FILE",
                      help="what viewnet evaluate --json said of it, for the card")  # fmt: skip
    save.add_argument("--push", metavar="NAME/MODEL", help="send the folder to the Hugging Face hub")
    save.set_defaults(run=_save)


def _predict(options: argparse.Namespace) -> None:
    """A line an image, or JSON: {"frame": "annotated" or "own", "pictures": [...]}."""
    from viewnet.estimator.viewpoint_estimator import ViewpointEstimator

    boxes = options.boxes
    if boxes is not None and len(boxes) == 1:
        boxes = boxes * len(options.pictures)
    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    found = estimator.predict(options.pictures, options.masks, boxes)
    if options.json:
        rows = found.to_frame().to_dict("records")
        named = [{"file": str(path), **row} for path, row in zip(options.pictures, rows, strict=True)]
        shared.print_json({"frame": "annotated" if found.aligned else "own", "pictures": named})
        return
    width = max(len(str(path)) for path in options.pictures)
    print(f"{'':{width}}  azimuth  elevation  confidence")
    for path, one in zip(options.pictures, found, strict=True):
        for told in one.ranked() if options.all else one.ranked()[:1]:
            name = str(path) if told.chosen else ""
            print(f"{name:{width}}  {told.azimuth:7.1f}  {told.elevation:9.1f}  {100 * told.probability:8.0f} %")
    if not found.aligned:
        print("in the network's own frame, to which no azimuth 0 and no up belong: it is aligned to none")


def _turntable(options: argparse.Namespace) -> None:
    """Writes the animation and prints where it is."""
    from viewnet.estimator.viewpoint_estimator import ViewpointEstimator

    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    estimator.turntable(
        options.picture, options.output, options.mask, options.box, size=options.size, steps=options.steps
    )
    print(options.output)


def _save(options: argparse.Namespace) -> None:
    """Writes the folder and prints where it is."""
    from viewnet.estimator.viewpoint_estimator import ViewpointEstimator
    from viewnet.runtime.files import read_json

    estimator = ViewpointEstimator.from_pretrained(options.model, device="cpu")
    scores = []
    for path in options.scores:
        found = read_json(path)
        scores += found if isinstance(found, list) else [found]
    address = estimator.save_pretrained(
        options.folder,
        license=options.license,
        half=options.half,
        scores=scores,
        push_to_hub=options.push is not None,
        repo_id=options.push,
    )
    print(address or options.folder)
