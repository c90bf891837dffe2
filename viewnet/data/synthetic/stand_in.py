"""What the stand-ins share: what decides their bytes, how they are written, built-in models as meshes."""

import abc
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from operator import call
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from PIL import Image, ImageDraw, ImageFilter

from viewnet import cad
from viewnet.cad.writer import write_model
from viewnet.data.readers.shapenet import ModelFile, load_model
from viewnet.data.synthetic import scenes
from viewnet.errors import ViewnetError
from viewnet.render import VERSION as RENDER_VERSION
from viewnet.render.mesh import Mesh
from viewnet.runtime.parallel import as_done, cores
from viewnet.runtime.progress import bar

WORTH_PROCESSES = 16  # objects below which starting processes takes longer than making their images


class StandIn(abc.ABC):
    """A stand-in for a data set, as a dataclass of what decides it: its numbers, and the seed."""

    FOLDER: ClassVar[str]
    VERSION: ClassVar[int]
    """Raise it when a change alters the files."""

    def describe(self) -> dict[str, Any]:
        """What decides its bytes, as JSON values: its fields, and the versions of all code that makes them."""
        values = asdict(self)  # type: ignore[call-overload]
        model = cad.VERSIONS[values.get("category", "car")]  # Freiburg's are all cars
        versions = [self.VERSION, model, RENDER_VERSION, scenes.VERSION]
        return {**values, "version": versions}

    def write(self, root: Path, workers: int | None = None, progress: bool = True) -> None:
        """Write it to `root` in the layout of the data set. `workers`: processes, None for one a core if it pays.

        Raises ViewnetError for values out of range, and where `root` is not empty.
        """
        counts = {name: value for name, value in vars(self).items() if isinstance(value, int) and name != "seed"}
        for name, value in (counts | {"workers": 1 if workers is None else workers}).items():
            if value < 1:
                raise ViewnetError(f"stand-in: {name} {value}: expected 1 or more")
        if root.exists() and any(root.iterdir()):
            raise ViewnetError(f"{root}: is not empty: name another folder")
        jobs = self.prepare(root)
        if workers is None:
            workers = 1 if len(jobs) < WORTH_PROCESSES else cores()
        with bar(progress, total=len(jobs), desc="stand-in", unit="object") as shown:
            for _ in as_done(call, jobs, workers, "the stand-in"):
                shown.update()

    @abc.abstractmethod
    def prepare(self, root: Path) -> Sequence[Callable[[], None]]:
        """Write what there is once, and return what writes each object's images. Checks the other values."""


def add_shadow(image: Image.Image, box: tuple[float, float, float, float], strength: int, blur: float) -> None:
    """A soft shadow on the ground, an ellipse in `box`, of a strength from 0 to 255."""
    mask = Image.new("L", image.size, 0)
    ImageDraw.Draw(mask).ellipse(box, strength)
    image.paste((15, 15, 18), mask=mask.filter(ImageFilter.GaussianBlur(blur)))


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
