"""Render an image's object from all around.

Write an animation: the image, and what the network reconstructs of it, turning once from the predicted viewpoint.

Examples:

    viewnet turntable car.png --model 0123456789ab -o car.gif
    viewnet turntable car.jpg --box 40 60 380 250 --model saved/car -o car.mp4 --size 256
"""

from pathlib import Path

from viewnet.commands.options import BOX, MODEL, Options, argument

ARGUMENTS = (
    argument("image", type=Path, metavar="IMAGE"),
    argument("--mask", type=Path, metavar="FILE"),
    argument("--box", nargs=4, type=float, metavar=BOX),
    argument("-o --output", "ends in .gif or .mp4", type=Path, required=True, metavar="FILE"),
    argument("--size", "pixels along a side of an image (default: 192)", type=int, default=192),
    argument("--steps", "number of viewpoints of the turn (default: 48)", type=int, default=48),
    *MODEL,
)


def run(options: Options) -> None:
    """Write the animation and print its path."""
    from viewnet.estimator import ViewpointEstimator

    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    size = {"size": options.size, "steps": options.steps}
    estimator.turntable(options.image, options.output, options.mask, options.box, **size)
    print(options.output)
