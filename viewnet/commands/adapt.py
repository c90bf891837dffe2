"""Train a model's viewpoint network on with photographs of your own, without labels.

Ours, not the paper's: what crops and mirror images of a photograph agree on is learned beside drawn views
(viewnet.training.adapt). The result is written, as viewnet save does, only if images held out agree more often than
before and sure answers stay, those for drawn views too; else nothing is, and the exit code is 1. An IMAGE is a file, a
folder of them or a quoted pattern. Images that cannot be used are named on the standard error and left out.

Examples:

    viewnet adapt photos --boxes boxes.csv --model car -o my-car
    viewnet predict street.jpg --box 40 60 380 250 --model my-car
"""

import sys
from pathlib import Path

from viewnet.commands.options import BOXES, MODEL, RETRAINED, Options, argument, choose_resources
from viewnet.errors import ViewnetError

ARGUMENTS = (
    argument("images", "photographs whose object fills them, or --boxes", nargs="*", metavar="IMAGE"),
    BOXES,
    MODEL[0],
    argument("-o --output", "where to write it", type=Path, required=True, metavar="FOLDER"),
    argument("--seed", "of augmentation and of which images are held out (default: 0)", type=int, default=0),
    *RETRAINED,
)


def run(options: Options) -> int:
    """Write the folder and print its path and what the photographs held out say; 1 where it is not written.

    Raises ViewnetError for no images, and as viewnet.experiments.adapted.make does.
    """
    choose_resources(options)
    if not options.images and not options.boxes:
        raise ViewnetError("adapt: no images: name some, a folder of them, or --boxes with a list")
    from viewnet.estimator import image_names
    from viewnet.experiments import adapted

    names, boxes = image_names.expanded(options.images), None
    if options.boxes:
        names, boxes, without = image_names.boxed(names, options.boxes)
        for name in without:
            print(f"viewnet: {name}: no box in {options.boxes}", file=sys.stderr)
    failures: dict[int, str] = {}
    try:
        places = options.model, names, boxes, options.output, failures
        found = adapted.make(*places, options.seed, options.half, options.cad_root)
    finally:
        for row in sorted(failures):
            print(f"viewnet: {names[row]}: {failures[row]}", file=sys.stderr)
    print(options.output if found.kept else "not written: it does not help")
    print(f"  learned from {found.photographs} photographs, {found.held_out} held out")
    agreeing = f"{100 * found.before:.1f} % before, {100 * found.after:.1f}"
    print(f"  crops and mirror images of one held out agree: {agreeing}")
    shares = f"{100 * found.stayed:.1f} % of those held out, {100 * found.remembered:.1f} % of drawn views"
    print(f"  sure answers that stay: {shares}")
    return 0 if found.kept else 1
