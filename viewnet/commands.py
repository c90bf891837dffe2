"""What the commands for people's own pictures do."""

from __future__ import annotations

import argparse
import json


def predict(options: argparse.Namespace) -> None:
    """A line a picture, or JSON: {"frame": "annotated" or "own", "pictures": [...]}."""
    from viewnet.estimator import ViewpointEstimator

    boxes = options.boxes
    if boxes is not None and len(boxes) == 1:
        boxes = boxes * len(options.pictures)
    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    found = estimator.predict(options.pictures, options.masks, boxes)
    if options.json:
        rows = found.to_frame().to_dict("records")
        named = [{"file": str(path), **row} for path, row in zip(options.pictures, rows, strict=True)]
        print(json.dumps({"frame": "annotated" if found.aligned else "own", "pictures": named}, indent=2))
        return
    width = max(len(str(path)) for path in options.pictures)
    print(f"{'':{width}}  azimuth  elevation  confidence")
    for path, one in zip(options.pictures, found, strict=True):
        print(f"{path!s:{width}}  {one.azimuth:7.1f}  {one.elevation:9.1f}  {100 * one.confidence:8.0f} %")
    if not found.aligned:
        print("in the network's own frame, to which no azimuth 0 and no up belong: it is aligned to none")


def turntable(options: argparse.Namespace) -> None:
    """Writes the animation and prints where it is."""
    from viewnet.estimator import ViewpointEstimator

    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    estimator.turntable(
        options.picture, options.output, options.mask, options.box, size=options.size, steps=options.steps
    )
    print(options.output)
