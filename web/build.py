"""The page that needs no server: the built-in models in the browser itself, as files for any static host.

    python web/build.py [FOLDER] [--offline]        (default: build/web)

Beside the page itself FOLDER gets the viewpoint networks as ONNX files, what estimators know of them (models.json), and
ONNX Runtime for browsers, which npm fetches as package-lock.json pins it and keeps in FOLDER-npm. The page is for
networks like the built-in ones: aligned, without in-plane rotation, that see what is in a box enlarged to the input.
"""

from __future__ import annotations

import argparse
import gzip
import json
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F

from viewnet.data.crop import AROUND
from viewnet.estimator import ViewpointEstimator, pretrained
from viewnet.estimator.camera_axes import COLUMNS, MEANINGS, SIGNS
from viewnet.estimator.demo.compass_svg import LEVELS, SECTORS, words
from viewnet.estimator.model_card import own
from viewnet.estimator.preprocess import OPAQUE
from viewnet.estimator.viewpoints import DOUBT
from viewnet.evaluation.confidence import RIGHT
from viewnet.evaluation.symmetry import symmetry
from viewnet.runtime.image_files import MOST_PIXELS

WEB = Path(__file__).resolve().parent
ROOT = WEB.parent
MODELS = (
    *("car", "chair", "aeroplane", "motorbike", "bicycle", "sofa", "boat", "bus", "train", "tvmonitor"),
    *("bottle", "diningtable"),
)
EXAMPLE = {"file": "car.jpg", "model": "car", "box": [129, 108, 341, 200]}
"""Of docs/: an image to try, the model for it, and its box in pixels."""
SCRIPTS = ("page.js", "stage.js", "image.js", "crop.js", "network.js", "viewpoint.js", "compass.js")
PAGE = ("index.html", "style.css", "icon.svg", *SCRIPTS)
RUNTIME = "ort.wasm.bundle.min.mjs"
WASM = "ort-wasm-simd-threaded.wasm"
ABOUT = "models.json"
"""What estimators know of the models. A folder that holds it was built before and may be emptied."""


def build(folder: Path, offline: bool = False) -> None:
    """Write the page to a folder, which is emptied first.

    `offline`: npm takes packages from its cache alone. SystemExit with one sentence for a folder with other files, and
    where npm is missing or fails; ViewnetError without the extra onnx.
    """
    if folder.exists() and any(folder.iterdir()) and not (folder / ABOUT).is_file():
        raise SystemExit(f"{folder} holds something else than the page: empty it, or name another folder")
    runtime = installed(folder.with_name(f"{folder.name}-npm"), offline)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / ABOUT).touch()  # so that what a failure leaves may be emptied
    for name in PAGE:
        shutil.copy(WEB / name, folder)
    shutil.copy(ROOT / "docs" / str(EXAMPLE["file"]), folder)
    shutil.copy(runtime / RUNTIME, folder)
    # Compressed here, since not every server compresses, and a fourth of its size.
    compressed = gzip.compress((runtime / WASM).read_bytes(), mtime=0)
    (folder / "ort.wasm.gz").write_bytes(compressed)
    models = {name: exported(name, folder) for name in MODELS}
    (folder / ABOUT).write_text(json.dumps(about(models), indent=1), encoding="utf-8")


def installed(folder: Path, offline: bool = False) -> Path:
    """Install the packages of package-lock.json in a folder and return that of ONNX Runtime's files.

    SystemExit with one sentence where npm is missing or fails.
    """
    npm = shutil.which("npm")
    if npm is None:
        raise SystemExit("web: there is no npm here: install Node.js 18 or newer, with npm (nodejs.org)")
    lock = "package-lock.json"
    dist = folder / "node_modules" / "onnxruntime-web" / "dist"
    if (folder / lock).is_file() and (folder / lock).read_bytes() == (WEB / lock).read_bytes() and dist.is_dir():
        return dist
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(WEB / "package.json", folder)
    # Nothing that packages bring is run: only their files are wanted.
    command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--offline" if offline else "--prefer-offline"]
    (folder / lock).write_bytes((WEB / lock).read_bytes())
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if result.returncode != 0 or not dist.is_dir():
        (folder / lock).unlink()  # so that the next time installs anew
        lines = [line for line in result.stderr.splitlines() if line.strip()]
        raise SystemExit(f"web: npm cannot install what package-lock.json lists: {lines[0] if lines else 'no reason'}")
    return dist


def exported(name: str, folder: Path) -> dict[str, Any]:
    """Write a model's viewpoint network to a folder; what the page has to know of it, as plain JSON types.

    SystemExit with one sentence for a network that the page does not show its input as its estimator does.
    """
    estimator = ViewpointEstimator.from_pretrained(name, device="cpu")
    framing = estimator.framing
    halvings = framing.whole.size / framing.size
    alike = framing.crop == "stretched" and not framing.cutout and not framing.rendered and halvings in (1, 2)
    if not alike or estimator.network.config.in_plane or estimator.annotated_from_model is None:
        raise SystemExit(f"web: {name}: the page is for aligned networks of the recipe photos that see stretched boxes")
    path = estimator.export_onnx(folder / f"{name}.onnx")
    whole = asdict(framing.whole)
    seen = {"crop": whole.pop("size"), **whole, "size": framing.size, "around": AROUND, "opaque": OPAQUE}
    seen["between"] = between(framing.whole.size) if halvings == 2 else []
    rotation = estimator.annotated_from_model.tolist()
    return {
        "file": path.name,
        "framing": seen,
        "rotation": rotation,
        # Contained in the weights already; None where confidences were not made true on photographs.
        "temperature": estimator.about.get("calibrated", {}).get("temperature"),
        "accuracy": accuracy(estimator),
        "turns": symmetry(estimator.config.category).turns,
        "note": symmetry(estimator.config.category).note,
    }


def between(side: int) -> list[tuple[int, float]]:
    """Columns (and rows) of an image that PyTorch's grid samples beside their pixel by a rounding error, and where.

    A fourth of all averages lie half way between two numbers, and such an error decides to which they are rounded.
    """
    grid = F.affine_grid(torch.eye(2, 3)[None], [1, 1, side, side], align_corners=False)  # (1, H, H, 2)
    places = ((grid[0, 0, :, 0] + 1) * side - 1) / 2  # (H,), in pixels
    return [(i, place) for i, place in enumerate(places.tolist()) if place != i]


def accuracy(estimator: pretrained.Pretrained) -> list[dict[str, Any]]:
    """What the model was scored on: `on` in words, `acc30` in %, and `median`, an error in degrees; up to symmetry."""
    rendered = ("rendered test views", own(estimator.about["metrics"]))
    others = [(each["on"], each["alignments"]["own"]) for each in estimator.about["scores"]]
    found = []
    for on, scores in (rendered, *others):
        alike = scores.get("alike", scores)
        up_to = "" if alike is scores else ", up to symmetry"
        found.append({"on": on + up_to, "acc30": alike["acc30"], "median": alike["median"]})
    return found


def about(models: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The content of models.json."""
    return {
        "models": models,
        "example": EXAMPLE,
        "largest": MOST_PIXELS,
        "answers": {"doubt": DOUBT, "right": RIGHT},
        "words": {"sectors": SECTORS, "levels": LEVELS, "above": words(0, 90).split(", ")[1]},
        "frames": {
            frame: {"signs": SIGNS[frame], "columns": frame in COLUMNS, "meaning": meaning}
            for frame, meaning in MEANINGS.items()
        },
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Build the page and say how large it is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "web")
    parser.add_argument("--offline", action="store_true", help="npm takes packages from its cache alone")
    options = parser.parse_args(arguments)
    build(options.folder, options.offline)
    size = sum(path.stat().st_size for path in options.folder.iterdir())
    print(f"{options.folder}: {size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
