"""Score finished runs and saved models.

Scores with 95 % intervals, by each alignment, on the test views of a run or on other data. Alignments are fitted on
validation views, or calibration photographs, and never on what is scored.

Examples:

    viewnet evaluate 0123456789ab                                   on the run's own test views
    viewnet evaluate 0123456789ab ba9876543210 --json
    viewnet evaluate saved/car --data-root /data/PASCAL3D+_release1.1 --calibration 128
    viewnet evaluate 0123456789ab --data-root /data/MoreCAD         on all models of another CAD collection
"""

from viewnet.commands.options import Options, Parser, add_json, print_json


def add_arguments(parser: Parser) -> None:
    """The arguments of viewnet evaluate."""
    add = parser.add_argument
    models = "a finished run's key or folder, or a saved model's folder"
    add("models", nargs="+", metavar="WHERE", help=models)
    elsewhere = parser.add_mutually_exclusive_group()
    data = "other data: PASCAL3D+, a folder with images/ and viewpoints.csv, or a ShapeNetCore folder"
    elsewhere.add_argument("--data-root", metavar="FOLDER", help=data)
    elsewhere.add_argument("--stand-in", action="store_true", help="the project's stand-in for photographs")
    add("--subset", default="imagenet", help="of PASCAL3D+: imagenet, pascal, both (default: %(default)s)")
    count = "views or photographs that alignments are fitted on (default: all)"
    add("--calibration", type=int, metavar="N", help=count)
    moved = "where the collection that a model was trained on lies, if it has moved"
    add("--cad-root", metavar="FOLDER", help=moved)
    add_json(parser)


def run(options: Options) -> None:
    """Print the scores of each model."""
    from viewnet.experiments import score_model

    data = score_model.ScoredData(options.data_root, options.stand_in, options.subset, options.cad_root)
    scores = [score_model.scores(where, data, options.calibration) for where in options.models]
    if options.json:
        print_json(scores)
    else:
        print("\n\n".join(score_model.as_text(each) for each in scores))
