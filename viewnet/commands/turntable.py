"""Render an image's object from all around.

Write an animation: the image, and what the network reconstructs of its object, turning once from the predicted
viewpoint.

Examples:

    viewnet turntable car.png --model 0123456789ab -o car.gif
    viewnet turntable car.jpg --box 40 60 380 250 --model saved/car -o car.mp4 --size 256
"""

from pathlib import Path

from viewnet.commands.options import Options, Parser, add_model


def add_arguments(parser: Parser) -> None:
    """The arguments of viewnet turntable."""
    parser.add_argument("image", type=Path, metavar="IMAGE")
    parser.add_argument("--mask", type=Path, metavar="FILE")
    parser.add_argument("--box", nargs=4, type=float, metavar=("X0", "Y0", "X1", "Y1"))
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="ends in .gif or .mp4")
    parser.add_argument("--size", type=int, default=192, help="pixels along a side of an image (default: 192)")
    parser.add_argument("--steps", type=int, default=48, help="number of viewpoints of the turn (default: 48)")
    add_model(parser)


def run(options: Options) -> None:
    """Write the animation and print its path."""
    from viewnet.estimator import ViewpointEstimator

    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    size = {"size": options.size, "steps": options.steps}
    estimator.turntable(options.image, options.output, options.mask, options.box, **size)
    print(options.output)
