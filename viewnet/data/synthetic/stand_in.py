"""What the stand-ins share: built-in models as meshes, checks of a request, and what decides their bytes."""

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from viewnet import cad
from viewnet.cad.writer import write_model
from viewnet.data.readers.shapenet import ModelFile, load_model
from viewnet.data.synthetic import scenes
from viewnet.errors import ViewnetError
from viewnet.render import VERSION as RENDER_VERSION
from viewnet.render.mesh import Mesh


def versions(own: int, category: str) -> list[int]:
    """The versions of all code that decides the bytes of a stand-in of a category."""
    return [own, cad.VERSIONS[category], RENDER_VERSION, scenes.VERSION]


def check_request(root: Path, values: dict[str, int], least: int = 1) -> None:
    """Raise ViewnetError for a value below `least`, and where `root` is not empty."""
    for name, value in values.items():
        if value < least:
            raise ViewnetError(f"stand-in: {name} {value}: expected {least} or more")
    if root.exists() and any(root.iterdir()):
        raise ViewnetError(f"{root}: is not empty: name another folder")


def visible_box(alpha: np.ndarray) -> tuple[int, int, int, int]:
    """The bounding box of an object's alpha (H, W) uint8; ViewnetError where nothing of it is visible."""
    if box := Image.fromarray((alpha > 127).astype(np.uint8)).getbbox():
        return box
    raise ViewnetError("a model of the stand-in cannot be seen")


def as_image(pixels: np.ndarray) -> Image.Image:
    """Pixels (H, W, 3), cut to 0 and 1, as an image."""
    return Image.fromarray((pixels.clip(0, 1) * 255 + 0.5).astype(np.uint8))


def built_in_mesh(category: str, model: int, seed: int) -> Mesh:
    """Built-in model `model` of a category under a seed, normalised; no file is left behind."""
    name = cad.model_id(category, model, seed)
    with tempfile.TemporaryDirectory(prefix="viewnet-") as folder:
        write_model(cad.make_model(category, model, seed), Path(folder) / name)
        file = Path(folder) / name / "models" / "model_normalized.obj"
        return load_model(ModelFile(name, category, file, "v2", ""))
