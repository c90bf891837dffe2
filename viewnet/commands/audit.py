"""Compare the reported scores of constants with a list of viewpoints.

Check whether the reported scores of constant predictors, and the confidence index, are possible under each published
definition of the error.

Examples:

    viewnet audit --viewpoints annotations.csv
    viewnet audit --viewpoints annotations.csv -o numbers/ --json
"""

from pathlib import Path

from viewnet.commands.options import JSON, Options, argument, print_results, records

COLUMNS = "category, azimuth_deg, elevation_deg, and optionally subset, split, easy, annotated"
ARGUMENTS = (
    argument("--viewpoints", f"a CSV with {COLUMNS}", type=Path, required=True, metavar="FILE"),
    argument("-o --output", "write every number there, as CSV files", type=Path, metavar="FOLDER"),
    JSON,
)


def run(options: Options) -> None:
    """Print the verdicts, and write the numbers where --output says."""
    from viewnet.experiments.reported_constants import audit_file

    audit = audit_file(options.viewpoints, progress=True)
    files = audit.write(options.output) if options.output else []
    tables = {"constants": records(audit.constants), "confidence": records(audit.confidence)}
    values = {"note": audit.note, "left out": audit.left_out, **tables, "files": [str(path) for path in files]}
    verdicts = "\nRows Constant: verdict by each definition of the error, and the test sets where it holds"
    confidence = ("\nConfidence index", audit.confidence.to_string(index=False))
    print_results(options, values, audit.note, verdicts, audit.summary().to_string(), *confidence, *files)
