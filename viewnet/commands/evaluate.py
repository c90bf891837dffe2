"""Score finished runs and saved models.

Scores with 95 % intervals, by each alignment, on the test views of a run or on other data. Alignments are fitted on
validation views, or calibration photographs, and never on what is scored.

Examples:

    viewnet evaluate 0123456789ab                                   on the run's own test views
    viewnet evaluate 0123456789ab ba9876543210 --json
    viewnet evaluate saved/car --data-root /data/PASCAL3D+_release1.1 --calibration 128
    viewnet evaluate 0123456789ab --data-root /data/MoreCAD         on all models of another CAD collection
"""

from viewnet.commands.options import CAD_ROOT, JSON, Options, argument, print_results

DATA = "other data: PASCAL3D+, ImageNet3D, photographs or crops with a list of viewpoints, or a ShapeNetCore folder"
CALIBRATION = "views or photographs that alignments are fitted on (default: all)"
ARGUMENTS = (
    argument("models", "a finished run's key or folder, or a saved model's folder", nargs="+", metavar="WHERE"),
    [
        argument("--data-root", DATA, metavar="FOLDER"),
        argument("--stand-in", "the project's stand-in for photographs", action="store_true"),
    ],
    argument("--subset", "of PASCAL3D+: imagenet, pascal, both (default: %(default)s)", default="imagenet"),
    argument("--calibration", CALIBRATION, type=int, metavar="N"),
    CAD_ROOT,
    JSON,
)


def run(options: Options) -> None:
    """Print the scores of each model."""
    from viewnet.experiments import score_model

    data = score_model.ScoredData(options.data_root, options.stand_in, options.subset, options.cad_root)
    scores = [score_model.scores(where, data, options.calibration) for where in options.models]
    print_results(options, scores, "\n\n".join(score_model.as_text(each) for each in scores))
