"""Predict the viewpoints of images.

Print the viewpoint of each image: azimuth (0 shows the object's front, 90 its left side), elevation, and how probable
the network takes it to be within 30 degrees; with the azimuth of the other side where that is probable too. The
object's mask or box decides which part of an image the network sees; transparency is a mask. An IMAGE is a file, a
folder of them, a quoted pattern such as 'photos/*.jpg', or - for the standard input. Images that cannot be used are
named on the standard error, and the exit code is then 3; the others are answered.

Examples:

    viewnet predict car.jpg --model 0123456789ab                    the object fills the image
    viewnet predict car.jpg --model 0123456789ab --box 40 60 380 250
    viewnet predict a.jpg b.jpg --masks a_mask.png b_mask.png --model runs/viewnet/0123456789ab
    viewnet predict car.jpg --model car --all                       every hypothesis, the most probable first
    viewnet predict *.png --json --model saved/car                  cut-outs: transparency is a mask
    viewnet predict car.jpg --model car --as quaternion --frame blender
    viewnet predict photos --boxes boxes.csv --model car -o viewpoints.csv
    viewnet predict --model car - < car.jpg
"""

import io
import sys
from pathlib import Path
from typing import Any

from viewnet.commands.options import BOX, BOXES, MODEL, THREADS, Options, argument, choose_resources, print_results
from viewnet.errors import ViewnetError

EDGES = "the object's edges in pixels; once for all images, or once for each"
OUTPUT = "write every hypothesis there instead of printing: .csv, .parquet or .json"
KINDS = (".csv", ".parquet", ".json")
OWN = "in the network's own frame, whose azimuth 0 and up are arbitrary: the model has no alignment"
FORMS, FRAMES = ("matrix", "quaternion", "euler"), ("opencv", "opengl", "pytorch3d", "blender")
ROTATION = "the rotation between object and camera too: r00 to r22, row by row; w, x, y, z; Blender's XYZ in degrees"
ARGUMENTS = (
    argument("images", nargs="*", metavar="IMAGE"),
    argument("--masks", "one for each image, in their order", nargs="+", type=Path, metavar="FILE"),
    [argument("--box", EDGES, nargs=4, type=float, action="append", metavar=BOX), BOXES],
    argument("--all", "every hypothesis, not only the most probable", action="store_true"),
    [
        argument("--json", "every hypothesis, as JSON", action="store_true"),
        argument("-o --output", OUTPUT, type=Path, metavar="FILE"),
    ],
    argument("--as", ROTATION, choices=FORMS, dest="form"),
    argument("--frame", "whose axes and direction it has (default: opencv)", choices=FRAMES),
    THREADS,
    *MODEL,
)


def run(options: Options) -> int:
    """Print a line for each image, or JSON: {"frame": "annotated" or "own", "notes", "images", "failures": [...]}.

    With --as the JSON has "camera_frame" as well, and its images the numbers that Viewpoints.to_frame names. 3 where
    some images failed, 2 where all did. Raises ViewnetError for --frame without --as, no images, and an output that
    cannot be written.
    """
    choose_resources(options)
    output = options.output
    if options.frame and not options.form:
        raise ViewnetError(f"--frame {options.frame}: add --as with one of {', '.join(FORMS)}")
    if not options.images and not options.boxes:
        raise ViewnetError("predict: no images: name some, a folder of them, or --boxes with a list")
    if output and output.suffix not in KINDS:
        raise ViewnetError(f"{output}: unknown kind of table: name it {' or '.join(KINDS)}")
    if output and output.is_dir():
        raise ViewnetError(f"{output}: is a folder: name a file")
    from viewnet.estimator import ViewpointEstimator, image_names
    from viewnet.evaluation.symmetry import symmetry
    from viewnet.runtime.files import scratch

    if options.images.count("-") > 1:
        raise ViewnetError("-: standard input holds one image: name it once")
    names, boxes, errors = image_names.expanded(options.images), options.box, list[tuple[str, str]]()
    if options.boxes:
        names, boxes, without = image_names.boxed(names, options.boxes)
        errors = [(name, f"no box in {options.boxes}") for name in without]
    elif boxes and len(boxes) == 1:
        boxes = boxes * len(names)
    if output:
        with scratch(output):  # refused before the work, not after it
            pass
    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    failures: dict[int, str] = {}
    images = [io.BytesIO(sys.stdin.buffer.read()) if name == "-" else name for name in names]
    shown = sys.stderr.isatty() and len(images) > 1
    viewpoints = estimator.predict(images, options.masks, boxes, failures=failures, progress=shown)
    errors += [(names[row], failures[row]) for row in sorted(failures)]
    for name, problem in errors:
        print(f"viewnet: {name}: {problem}", file=sys.stderr)
    if not len(viewpoints):
        return 2
    names = [name for row, name in enumerate(names) if row not in failures]
    notes = [note for note in ("" if viewpoints.aligned else OWN, symmetry(estimator.config.category).note) if note]
    if options.json or output:
        failed = [{"file": name, "error": problem} for name, problem in errors]
        about = {"frame": "annotated" if viewpoints.aligned else "own", "notes": notes, "failures": failed}
        _give_all(options, viewpoints, names, about)
    else:
        _print(options, viewpoints, names)
        print(*notes, sep="\n", end="\n" * bool(notes))
    return 3 if errors else 0


def _give_all(options: Options, viewpoints: Any, names: list[str], about: dict[str, Any]) -> None:
    """Every hypothesis of each image, as JSON beside what is said `about` them, or in the output's file."""
    from viewnet.runtime.files import replacing, write_csv, write_json

    frame, output = options.frame or FRAMES[0], options.output
    table = viewpoints.to_frame(frame, options.form) if options.form else viewpoints.to_frame()
    table.insert(0, "file", names)
    values = about | ({"camera_frame": frame} if options.form else {}) | {"images": table.to_dict("records")}
    if options.json:
        print_results(options, values)
        return
    if output.suffix == ".csv":
        write_csv(output, table)
    elif output.suffix == ".json":
        write_json(output, values)
    else:
        with replacing(output) as temporary:
            table.to_parquet(temporary, index=False)
    print(output, *about["notes"], sep="\n")


def _print(options: Options, viewpoints: Any, names: list[str]) -> None:
    """A line for each image or, with --all, each hypothesis."""
    from viewnet.estimator import camera_axes

    every, form, frame = options.all, options.form, options.frame or FRAMES[0]
    width, digits = max(map(len, names)), 1 if form == "euler" else 4
    headings = "".join(f"{name:>9}" for name in camera_axes.FORMS[form]) if form else ""
    print(f"{'':{width}}  azimuth  elevation  confidence{headings}")
    for name, viewpoint in zip(names, viewpoints, strict=True):
        for each in viewpoint.ranked() if every else viewpoint.ranked()[:1]:
            numbers = each.rotation(frame, form).ravel() if form else ()
            rotation = "".join(f"{number:z9.{digits}f}" for number in numbers)
            sure = each.probability if every else viewpoint.confidence
            angles = f"{each.azimuth:7.1f}  {each.elevation:9.1f}  {100 * sure:8.0f} %"
            doubt = f"  or azimuth {viewpoint.rival.azimuth:.1f}" if viewpoint.rival and not every else ""
            print(f"{name if each.chosen else '':{width}}  {angles}{rotation}{doubt}")
    if form:
        print(f"rotation: {camera_axes.MEANINGS[frame]}")
