"""View stores rendered from CAD models: in parallel, resumable, and the same on every attempt.

Models are rendered in chunks. A chunk's file holds what one process has rendered; a killed call resumes from them.
"""

import hashlib
import itertools
import json
import logging
import shutil
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from viewnet.config import LIMITS
from viewnet.data import contents
from viewnet.data.readers.shapenet import READER_VERSION, ModelFile, load_model, read_files
from viewnet.data.store import COLUMNS, ViewStore, identity_of, made_once, write_store
from viewnet.errors import ViewnetError
from viewnet.render import VERSION, Backend, choose_backend, render_cameras
from viewnet.render.camera import DISTANCE, FOCAL, look_from
from viewnet.render.mesh import UnusableModel
from viewnet.runtime.files import replacing, write_text
from viewnet.runtime.parallel import MOST_THREADS, as_done, cores
from viewnet.runtime.progress import bar as progress_bar

CHUNK = 16  # models in a chunk
WORTH_PROCESSES = 4000  # views below which starting processes takes longer than rendering

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Rendering:
    """How models are rendered. Raises ViewnetError for values out of range."""

    views: int = 5  # of every model
    image_size: int = 64
    supersample: int = 2
    azimuth_range: tuple[float, float] = (0.0, 360.0)  # degrees
    elevation_range: tuple[float, float] = (-20.0, 40.0)  # degrees
    seed: int = 0
    backend: Backend = "auto"

    def __post_init__(self) -> None:
        for name in ("views", "image_size", "supersample"):
            least, most = LIMITS[name]
            if not least <= (value := getattr(self, name)) <= most:
                raise ViewnetError(f"{name} {value}: expected {least} to {most}")
        for name, least, most, limit in (
            ("azimuth_range", -360, 720, "at most 360 apart"),
            ("elevation_range", -90, 90, "within -90 and 90"),
        ):
            low, high = getattr(self, name)
            if not (least <= low <= high <= most and high - low <= 360):
                raise ViewnetError(f"{name} {(low, high)}: expected (low, high) in degrees, {limit}")

    def describe(self) -> dict[str, Any]:
        """Everything but the models that decides the images, as JSON values."""
        return {
            "renderer": {"name": choose_backend(self.backend), "version": VERSION, "supersample": self.supersample},
            "camera": {"distance": DISTANCE, "focal": FOCAL, "image_size": self.image_size},
            "viewpoints": {
                "views": self.views,
                "azimuth_range": [float(x) for x in self.azimuth_range],
                "elevation_range": [float(x) for x in self.elevation_range],
                "seed": self.seed,
            },
        }


def render_views(
    models: Sequence[ModelFile],
    folder: Path | str,
    *,
    workers: int | None = None,
    progress: bool = True,
    executor: Executor | None = None,
    described: dict[str, Any] | None = None,
    **settings: Any,
) -> ViewStore:
    """Render views of every model into the view store `folder` (section 4.2) and open it; `settings`: see Rendering.

    Azimuth and elevation are uniform in their ranges, the light's direction uniform on the camera's side. They depend
    on (seed, model id, view) only, so neither order nor number of processes nor other models matter. A killed call that
    is repeated resumes and ends with the same bytes; of two calls at once one renders and the other waits. An existing
    store is opened if it was made from the same: models that are `described` so (see `digest`, by contents where it is
    None). `workers`: processes, None for one a core; 1 renders in this process.
    The workers of an `executor` must see `folder` and the models under the same names. Raises ViewnetError for values
    out of range, a folder that holds something else, no model that can be used, and too little room on the disk.
    """
    folder, how = Path(folder), Rendering(**settings)
    how = replace(how, backend=choose_backend(how.backend))
    models = sorted(models, key=lambda model: (model.category, model.id))
    _check(models, workers)
    made_by = how.describe() | (described or {"models": digest(models)})

    def make() -> None:
        chunks = _plan(models, partial_folder(folder), made_by)
        todo = [(rows, file) for rows, file in chunks if not file.exists()]
        open_share = sum(len(models[rows]) for rows, _ in todo) / len(models)
        _check_room(folder, len(models) * how.views * how.image_size**2 * 4, open_share)
        azimuth, elevation, light = sample_viewpoints(models, how)
        jobs = []
        for rows, file in todo:
            cameras = look_from(azimuth[rows], elevation[rows])  # (M, V, 3, 3)
            lights = np.einsum("mvij,mvj->mvi", cameras, light[rows])  # (M, V, 3), in world coordinates
            jobs.append(Chunk(tuple(models[rows]), cameras, lights, how, file))
        _render(jobs, len(models), workers, progress, executor)
        assemble(folder, models, [file for _, file in chunks], azimuth, elevation, made_by)

    made_once(folder, make)
    shutil.rmtree(partial_folder(folder), ignore_errors=True)
    store = ViewStore.open(folder)
    if store.identity != identity_of(made_by):
        raise ViewnetError(f"{folder}: holds views of other models or settings: remove it or name another folder")
    return store


def partial_folder(folder: Path) -> Path:
    """The chunks of a store that is not whole yet. A killed call may leave the folder beside a whole store."""
    return folder.with_name(f".{folder.name}.partial")


def digest(models: Sequence[ModelFile], built_in: bool = False) -> dict[str, Any]:
    """What the images depend on of the models: names, splits and the contents of every file that is read.

    Of built-in models, which their version decides, a file's size stands for its content.
    """
    models = sorted(models, key=lambda model: (model.category, model.id))
    categories = sorted({model.category for model in models})
    if built_in:
        marks: dict[Path, Any] = {m.path: m.path.stat().st_size if m.path.is_file() else -1 for m in models}
        version = {}
    else:
        files = {model.path: model for model in models}
        groups = {str(path.absolute()): partial(read_files, model) for path, model in files.items()}
        marks = dict(zip(files, contents.digests(models[0].folder.parent, groups), strict=True))
        version = {"reader": READER_VERSION}
    hashed = hashlib.sha256()
    for model in models:
        values = [model.category, model.id, model.layout, model.split, marks[model.path]]
        hashed.update(json.dumps(values).encode())
    return {"count": len(models), "categories": categories, "sha256": hashed.hexdigest()} | version


def sample_viewpoints(models: Sequence[ModelFile], how: Rendering) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Azimuth (M, V) in [0, 360), elevation (M, V) and unit light direction (M, V, 3) in camera coordinates."""
    # A hash rather than a generator: every view has its own numbers, and they stay the same with any NumPy.
    digests = b"".join(
        hashlib.sha256(f"{how.seed} {view} {model.id}".encode()).digest()
        for model in models
        for view in range(how.views)
    )
    uniform = (np.frombuffer(digests, "<u8") >> np.uint64(11)).astype(np.float64) * 2.0**-53
    a, e, z, turn = np.moveaxis(uniform.reshape(len(models), how.views, 4), -1, 0)  # (M, V) each
    (low, high), (lowest, highest) = how.azimuth_range, how.elevation_range
    azimuth = (low + a * (high - low)) % 360.0
    azimuth[azimuth >= 360.0] = 0.0
    elevation = lowest + e * (highest - lowest)
    ring, turn = np.sqrt(1.0 - z**2), 2 * np.pi * turn
    return azimuth, elevation, np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=-1)


@dataclass(frozen=True)
class Chunk:
    """Models to render: world_from_camera (M, V, 3, 3), directions to the light (M, V, 3), and the file to write."""

    models: tuple[ModelFile, ...]
    world_from_camera: np.ndarray
    lights: np.ndarray
    how: Rendering
    file: Path


def render_chunk(chunk: Chunk) -> int:
    """Write the chunk's images (usable models * V, S, S, 4) and the reasons of its unusable models; their number."""
    views, how = chunk.world_from_camera.shape[1], chunk.how
    images = np.zeros((len(chunk.models), views, how.image_size, how.image_size, 4), np.uint8)
    rejected: dict[str, str] = {}
    used = 0
    for model, cameras, lights in zip(chunk.models, chunk.world_from_camera, chunk.lights, strict=True):
        try:
            mesh = load_model(model)
        except UnusableModel as error:
            rejected[model.id] = error.reason
            continue
        images[used] = render_cameras(mesh, cameras, lights, how.image_size, how.supersample, how.backend)
        used += 1
    with replacing(chunk.file) as temporary:
        usable = images[:used].reshape(-1, *images.shape[2:])  # (usable models * V, S, S, 4)
        np.savez(temporary, images=usable, rejected=np.array(json.dumps(rejected)))
    return len(chunk.models)


def read_chunk(file: Path) -> tuple[np.ndarray, dict[str, str]]:
    """Images and rejected models (id -> reason) of a chunk's file. ViewnetError where it is damaged."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            images, rejected = stored["images"], json.loads(str(stored["rejected"]))
        if images.dtype != np.uint8 or images.ndim != 4 or not isinstance(rejected, dict):
            raise ValueError(f"{images.dtype} {images.shape} images")
        return images, {str(name): str(reason) for name, reason in rejected.items()}
    except Exception as error:  # NumPy raises many types on a damaged archive.
        problem = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ViewnetError(f"{file}: damaged ({problem}): remove it, and it is rendered again") from None


def _check(models: Sequence[ModelFile], workers: int | None) -> None:
    if not models:
        raise ViewnetError("no models to render: give at least one")
    names = [(model.category, model.id) for model in models]
    if twice := [name for name, other in itertools.pairwise(names) if name == other]:
        raise ViewnetError(f"model {twice[0][1]} of {twice[0][0]} is given twice")
    if workers is not None and not 1 <= workers <= MOST_THREADS:
        raise ViewnetError(f"workers {workers}: expected 1 to {MOST_THREADS}, or None for one a core")


def _source(model: ModelFile) -> str:
    """The model's file relative to its collection, the same wherever that lies."""
    return model.path.relative_to(model.folder.parent.parent).as_posix()


def _plan(models: Sequence[ModelFile], partial: Path, made_by: dict[str, Any]) -> list[tuple[slice, Path]]:
    """Model numbers and file of each chunk. What `partial` holds of another request is removed."""
    plan = json.dumps({"identity": identity_of(made_by), "chunk": CHUNK})
    note = partial / "plan.json"
    if partial.exists() and not (note.is_file() and note.read_bytes() == plan.encode()):
        shutil.rmtree(partial)
    if not partial.exists():
        write_text(note, plan)
    return [(slice(i, i + CHUNK), partial / f"{i:08d}.npz") for i in range(0, len(models), CHUNK)]


def _check_room(folder: Path, size: int, open_share: float) -> None:
    """The chunks still to render and the store itself must fit beside each other, with a little to spare."""
    needed = int(size * (1 + open_share) * 1.02) + 2**20
    free = shutil.disk_usage(folder.parent).free
    if free < needed:
        raise ViewnetError(f"{folder}: {needed} bytes needed and {free} free on its disk: make room or use fewer views")


def _render(jobs: list[Chunk], total: int, workers: int | None, progress: bool, executor: Executor | None) -> None:
    left = sum(len(job.models) for job in jobs)
    if workers is None:
        workers = 1 if not jobs or left * jobs[0].how.views < WORTH_PROCESSES else cores()
    with progress_bar(progress, total=total, initial=total - left, desc="render", unit="model") as bar:
        for models in as_done(render_chunk, jobs, workers, "views (finished chunks are kept)", executor):
            bar.update(models)


def assemble(
    folder: Path,
    models: Sequence[ModelFile],
    files: list[Path],
    azimuth: np.ndarray,
    elevation: np.ndarray,
    made_by: dict[str, Any],
) -> None:
    """Write the store from its chunks' files, without unusable models. Raises ViewnetError where none is usable."""
    import pandas as pd  # slow to import, and every rendering process imports this module

    reasons: dict[str, str] = {}
    for file in files:
        reasons.update(read_chunk(file)[1])
    rejected = [(model.id, _source(model), reasons[model.id]) for model in models if model.id in reasons]
    if len(rejected) == len(models):
        name, _, reason = rejected[0]
        raise ViewnetError(f"{folder}: none of the {len(models)} models can be used (the first, {name}: {reason})")
    if rejected:
        log.warning("%s: %d of %d models cannot be used, see rejected.csv", folder, len(rejected), len(models))
    rows = [
        (model.id, model.category, model.split, view, azimuth[number, view], elevation[number, view], _source(model))
        for number, model in enumerate(models)
        if model.id not in reasons
        for view in range(azimuth.shape[1])
    ]
    index = pd.DataFrame(rows, columns=list(COLUMNS))
    write_store(folder, (read_chunk(file)[0] for file in files), index, made_by, rejected)
