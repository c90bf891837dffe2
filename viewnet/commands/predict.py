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
"""

from pathlib import Path

from viewnet.commands.options import BOX, MODEL, THREADS, Options, argument, choose_resources, print_results

EDGES = "the object's edges in pixels; once for all images, or once for each"
ARGUMENTS = (
    argument("images", nargs="+", type=Path, metavar="IMAGE"),
    argument("--masks", "one for each image, in their order", nargs="+", type=Path, metavar="FILE"),
    argument("--box", EDGES, nargs=4, type=float, action="append", dest="boxes", metavar=BOX),
    argument("--all", "every hypothesis, not only the most probable", action="store_true"),
    argument("--json", "every hypothesis, as JSON", action="store_true"),
    THREADS,
    *MODEL,
)


def run(options: Options) -> None:
    """Print a line for each image, or JSON: {"frame": "annotated" or "own", "images": [...]}."""
    choose_resources(options)
    from viewnet.estimator import ViewpointEstimator

    images, boxes = options.images, options.boxes
    if boxes is not None and len(boxes) == 1:
        boxes = boxes * len(images)
    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    viewpoints = estimator.predict(images, options.masks, boxes)
    if options.json:
        rows = viewpoints.to_frame().to_dict("records")
        lines = [{"file": str(path), **row} for path, row in zip(images, rows, strict=True)]
        print_results(options, {"frame": "annotated" if viewpoints.aligned else "own", "images": lines})
        return
    width = max(len(str(path)) for path in images)
    print(f"{'':{width}}  azimuth  elevation  confidence")
    for path, viewpoint in zip(images, viewpoints, strict=True):
        for each in viewpoint.ranked() if options.all else viewpoint.ranked()[:1]:
            name = str(path) if each.chosen else ""
            print(f"{name:{width}}  {each.azimuth:7.1f}  {each.elevation:9.1f}  {100 * each.probability:8.0f} %")
    if not viewpoints.aligned:
        print("in the network's own frame, whose azimuth 0 and up are arbitrary: the model has no alignment")
