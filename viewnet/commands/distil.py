"""Train a model's viewpoint network anew, on its own answers or those of others.

Ours, not the paper's: answers for training views that an image and its mirror image, and several networks, agree on are
labels for a network that sees many more images (viewnet.training.distil). No viewpoint label is used. Writes a folder
as viewnet save does. Teachers answer best if they see views over black: train two or more of that variant.

Examples:

    viewnet distil car better-car                                   the model that comes with viewnet, by itself
    viewnet train car --recipe photos --variant over_black --seed 1
    viewnet distil car better-car --teachers 0123456789ab ba9876543210
"""

from pathlib import Path

from viewnet.commands.options import RETRAINED, Options, argument, choose_resources

TEACHERS = "runs or saved models of the category whose answers are learned first (default: the model itself)"
ARGUMENTS = (
    argument("model", "a finished run's key or folder, or a saved model's folder", metavar="WHERE"),
    argument("folder", "where to write it", type=Path, metavar="FOLDER"),
    argument("--teachers", TEACHERS, nargs="+", default=[], metavar="WHERE"),
    argument("--seed", "of the initial weights and of augmentation (default: 0)", type=int, default=0),
    *RETRAINED,
)


def run(options: Options) -> None:
    """Write the folder; print its path, and its accuracy on its own test views."""
    choose_resources(options)
    from viewnet.estimator.model_card import own
    from viewnet.experiments import distilled

    places = options.model, options.folder, options.teachers
    model = distilled.make(*places, options.seed, options.half, options.cad_root)
    print(options.folder)
    if scores := own(model.about["metrics"] or {}):
        scores = scores.get("alike", scores)
        print(f"  test: within 30 degrees {scores['acc30']:.1f} %, median {scores['median']:.1f} degrees")
