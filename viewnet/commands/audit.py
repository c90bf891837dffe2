"""Compare the reported scores of constants with a list of viewpoints.

Check whether the reported scores of constant predictors, and the confidence index, are possible under each published
definition of the error.

Examples:

    viewnet audit --viewpoints annotations.csv
    viewnet audit --viewpoints annotations.csv -o numbers/ --json
"""

from pathlib import Path

from viewnet.commands.options import Options, Parser, add_json, print_json, records


def add_arguments(parser: Parser) -> None:
    """The arguments of viewnet audit."""
    columns = "category, azimuth_deg, elevation_deg, and optionally subset, split, easy, annotated"
    parser.add_argument("--viewpoints", type=Path, required=True, metavar="FILE", help=f"a CSV with {columns}")
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="write every number there, as CSV files")
    add_json(parser)


def run(options: Options) -> None:
    """Print the verdicts, and write the numbers where --output says."""
    from viewnet.experiments.reported_constants import audit_file

    audit = audit_file(options.viewpoints)
    files = audit.write(options.output) if options.output else []
    if options.json:
        tables = {"constants": records(audit.constants), "confidence": records(audit.confidence)}
        names = [str(path) for path in files]
        print_json({"note": audit.note, "left out": audit.left_out, **tables, "files": names})
        return
    print(audit.note)
    print("\nRows Constant: verdict by each definition of the error, and the test sets where it holds")
    print(audit.summary().to_string())
    print("\nConfidence index")
    print(audit.confidence.to_string(index=False))
    if files:
        print(*files, sep="\n")
