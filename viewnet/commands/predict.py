"""Predict the viewpoints of images.

Print the viewpoint of each image: azimuth (0 shows the object's front, 90 its left side), elevation, and the
probability that the network gives to it. The object's mask or box decides which part of an image the network sees;
transparency is a mask.

Examples:

    viewnet predict car.jpg --model 0123456789ab                    the object fills the image
    viewnet predict car.jpg --model 0123456789ab --box 40 60 380 250
    viewnet predict a.jpg b.jpg --masks a_mask.png b_mask.png --model runs/viewnet/0123456789ab
    viewnet predict car.jpg --model car --all                       every hypothesis, the most probable first
    viewnet predict *.png --json --model saved/car                  cut-outs: transparency is a mask
    viewnet predict car.jpg --model car --as quaternion --frame blender
"""

from pathlib import Path

from viewnet.commands.options import BOX, MODEL, THREADS, Options, argument, choose_resources, print_results
from viewnet.errors import ViewnetError

EDGES = "the object's edges in pixels; once for all images, or once for each"
FORMS, FRAMES = ("matrix", "quaternion", "euler"), ("opencv", "opengl", "pytorch3d", "blender")
ROTATION = "the rotation between object and camera too: r00 to r22, row by row; w, x, y, z; Blender's XYZ in degrees"
ARGUMENTS = (
    argument("images", nargs="+", type=Path, metavar="IMAGE"),
    argument("--masks", "one for each image, in their order", nargs="+", type=Path, metavar="FILE"),
    argument("--box", EDGES, nargs=4, type=float, action="append", dest="boxes", metavar=BOX),
    argument("--all", "every hypothesis, not only the most probable", action="store_true"),
    argument("--json", "every hypothesis, as JSON", action="store_true"),
    argument("--as", ROTATION, choices=FORMS, dest="form"),
    argument("--frame", "whose axes and direction it has (default: opencv)", choices=FRAMES),
    THREADS,
    *MODEL,
)


def run(options: Options) -> None:
    """Print a line for each image, or JSON: {"frame": "annotated" or "own", "images": [...]}.

    With --as the JSON has "camera_frame" as well, and its images the numbers that Viewpoints.to_frame names. Raises
    ViewnetError for --frame without --as.
    """
    choose_resources(options)
    images, boxes, form, frame = options.images, options.boxes, options.form, options.frame or "opencv"
    if options.frame and not form:
        raise ViewnetError(f"--frame {frame}: add --as with one of {', '.join(FORMS)}")
    from viewnet.estimator import ViewpointEstimator, camera_axes

    if boxes is not None and len(boxes) == 1:
        boxes = boxes * len(images)
    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    viewpoints = estimator.predict(images, options.masks, boxes)
    if options.json:
        rows = viewpoints.to_frame(*(frame, form) if form else ()).to_dict("records")
        lines = [{"file": str(path), **row} for path, row in zip(images, rows, strict=True)]
        kind = {"frame": "annotated" if viewpoints.aligned else "own"} | ({"camera_frame": frame} if form else {})
        print_results(options, kind | {"images": lines})
        return
    width, digits = max(len(str(path)) for path in images), 1 if form == "euler" else 4
    names = "".join(f"{name:>9}" for name in camera_axes.FORMS[form]) if form else ""
    print(f"{'':{width}}  azimuth  elevation  confidence{names}")
    for path, viewpoint in zip(images, viewpoints, strict=True):
        for each in viewpoint.ranked() if options.all else viewpoint.ranked()[:1]:
            name = str(path) if each.chosen else ""
            numbers = each.rotation(frame, form).ravel() if form else ()
            rotation = "".join(f"{number:z9.{digits}f}" for number in numbers)
            angles = f"{each.azimuth:7.1f}  {each.elevation:9.1f}  {100 * each.probability:8.0f} %"
            print(f"{name:{width}}  {angles}{rotation}")
    if form:
        print(f"rotation: {camera_axes.MEANINGS[frame]}")
    if not viewpoints.aligned:
        print("in the network's own frame, whose azimuth 0 and up are arbitrary: the model has no alignment")
