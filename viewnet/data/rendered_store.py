"""View stores rendered from CAD models: in parallel, resumable, and the same on every attempt.

Models are rendered in chunks. A chunk's file holds what one process has rendered; a killed call goes on from them.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import logging
import shutil
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from viewnet.data.readers.shapenet import ModelFile, load_model
from viewnet.data.store import ViewStore, identity_of, write_store
from viewnet.errors import ViewnetError
from viewnet.render import VERSION, Backend, choose_backend, render_cameras
from viewnet.render.camera import DISTANCE, FOCAL, look_from
from viewnet.render.mesh import UnusableModel
from viewnet.runtime.files import locked, replacing, write_text
from viewnet.runtime.parallel import cores, pool
from viewnet.runtime.progress import bar as progress_bar

CHUNK = 16
"""Models in a chunk."""
# Below this many views starting processes takes longer than rendering.
_WORTH_PROCESSES = 4000

log = logging.getLogger(__name__)


def render_views(
    models: Sequence[ModelFile],
    folder: Path | str,
    *,
    views: int = 5,
    image_size: int = 64,
    supersample: int = 2,
    azimuth_range: tuple[float, float] = (0.0, 360.0),
    elevation_range: tuple[float, float] = (-20.0, 40.0),
    seed: int = 0,
    backend: Backend = "auto",
    workers: int | None = None,
    progress: bool = True,
    executor: Executor | None = None,
) -> ViewStore:
    """Draw `views` views of every model into the view store `folder` (section 4.2) and open it.

    Azimuth and elevation (degrees) are uniform in their ranges, the light's direction uniform on the camera's side.
    They depend on (seed, model id, view) only, so neither order nor number of processes nor other models matter. The
    store appears when it is whole; a killed call started again goes on from what is done and ends with the same
    bytes; of two calls at once one draws and the other waits. A store that is there already is opened if it was made
    from the same. Models that cannot be used are named with the reason in `rejected.csv`. `workers`: processes, None
    for one a processor; 1 draws in this process. With an `executor` they are its workers', which must see `folder` and
    the models under the same names.

    Raises ViewnetError for values out of range, a folder that holds something else, no model that can be used, and too
    little room on the disk.
    """
    folder = Path(folder)
    models = sorted(models, key=lambda model: (model.category, model.id))
    _check(models, views, image_size, supersample, azimuth_range, elevation_range, workers)
    backend = choose_backend(backend)
    made_by = describe(views, image_size, supersample, azimuth_range, elevation_range, seed, backend)
    made_by["models"] = digest(models)
    if folder.exists():  # before any lock, for which the folder about it may not be writable
        return _reopen(folder, made_by)
    with locked(folder):
        if folder.exists():
            return _reopen(folder, made_by)
        partial = partial_folder(folder)
        chunks = _plan(models, partial, made_by)
        todo = [chunk for chunk in chunks if not chunk[1].exists()]
        _check_room(folder, len(models) * views * image_size**2 * 4, sum(len(c[0]) for c in todo) / max(len(models), 1))
        azimuth, elevation, light = sample_viewpoints(models, views, azimuth_range, elevation_range, seed)
        jobs = [
            Chunk(
                tuple(models[i] for i in rows),
                cameras := look_from(azimuth[rows].ravel(), elevation[rows].ravel()).reshape(len(rows), views, 3, 3),
                np.einsum("mvij,mvj->mvi", cameras, light[rows]),  # in world coordinates
                image_size,
                supersample,
                backend,
                file,
            )
            for rows, file in todo
        ]
        _render(jobs, len(models), workers, progress, views, executor)
        store = _assemble(folder, models, [file for _, file in chunks], azimuth, elevation, made_by)
        shutil.rmtree(partial, ignore_errors=True)
        return store


def partial_folder(folder: Path) -> Path:
    """The folder of what is drawn of a store that is not whole yet. A killed call may leave it beside one that is."""
    return folder.with_name(f".{folder.name}.partial")


def describe(
    views: int,
    image_size: int,
    supersample: int,
    azimuth_range: tuple[float, float],
    elevation_range: tuple[float, float],
    seed: int,
    backend: Backend,
) -> dict[str, Any]:
    """All but the models that decides the images, as JSON values; `backend` is one that `choose_backend` gave."""
    return {
        "renderer": {"name": backend, "version": VERSION, "supersample": supersample},
        "camera": {"distance": DISTANCE, "focal": FOCAL, "image_size": image_size},
        "viewpoints": {
            "views": views,
            "azimuth_range": [float(x) for x in azimuth_range],
            "elevation_range": [float(x) for x in elevation_range],
            "seed": seed,
        },
    }


def digest(models: Sequence[ModelFile]) -> dict[str, Any]:
    """What the images depend on of the models: names, splits and, as a cheap sign of a changed file, sizes."""
    hashed = hashlib.sha256()
    for model in sorted(models, key=lambda model: (model.category, model.id)):
        size = model.path.stat().st_size if model.path.is_file() else -1
        hashed.update(json.dumps([model.category, model.id, model.layout, model.split, size]).encode())
    categories = sorted({model.category for model in models})
    return {"count": len(models), "categories": categories, "sha256": hashed.hexdigest()}


def sample_viewpoints(
    models: Sequence[ModelFile],
    views: int,
    azimuth_range: tuple[float, float],
    elevation_range: tuple[float, float],
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Azimuth (M, V) in [0, 360), elevation (M, V) and unit light direction (M, V, 3) in camera coordinates."""
    # A hash rather than a generator: every view has its own numbers, and they stay the same with any NumPy.
    digests = b"".join(
        hashlib.sha256(f"{seed} {view} {model.id}".encode()).digest() for model in models for view in range(views)
    )
    uniform = (np.frombuffer(digests, "<u8") >> np.uint64(11)).astype(np.float64) * 2.0**-53
    a, e, z, turn = np.moveaxis(uniform.reshape(len(models), views, 4), -1, 0)
    azimuth = (azimuth_range[0] + a * (azimuth_range[1] - azimuth_range[0])) % 360.0
    azimuth[azimuth >= 360.0] = 0.0
    elevation = elevation_range[0] + e * (elevation_range[1] - elevation_range[0])
    ring, turn = np.sqrt(1.0 - z**2), 2 * np.pi * turn
    return azimuth, elevation, np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=-1)


@dataclass(frozen=True)
class Chunk:
    """Models to draw and how: world_from_camera (M, V, 3, 3), directions to the light (M, V, 3), and the file to write."""

    models: tuple[ModelFile, ...]
    world_from_camera: np.ndarray
    lights: np.ndarray
    size: int
    supersample: int
    backend: Backend
    file: Path


def render_chunk(chunk: Chunk) -> int:
    """Write the chunk's images (usable models * V, S, S, 4) and the reasons of its unusable models; their number."""
    views = chunk.world_from_camera.shape[1]
    images = np.zeros((len(chunk.models), views, chunk.size, chunk.size, 4), np.uint8)
    rejected: dict[str, str] = {}
    used = 0
    for number, model in enumerate(chunk.models):
        try:
            mesh = load_model(model)
        except UnusableModel as error:
            rejected[model.id] = error.reason
            continue
        cameras, lights = chunk.world_from_camera[number], chunk.lights[number]
        images[used] = render_cameras(mesh, cameras, lights, chunk.size, chunk.supersample, chunk.backend)
        used += 1
    with replacing(chunk.file) as temporary:
        views_of_usable = images[:used].reshape(-1, *images.shape[2:])  # (usable models * V, S, S, 4)
        np.savez(temporary, images=views_of_usable, rejected=np.array(json.dumps(rejected)))
    return len(chunk.models)


def read_chunk(file: Path) -> tuple[np.ndarray, dict[str, str]]:
    """Images and rejected models (id -> reason) of a chunk's file. ViewnetError where it is damaged."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            images, rejected = stored["images"], json.loads(str(stored["rejected"]))
        if images.dtype != np.uint8 or images.ndim != 4 or not isinstance(rejected, dict):
            raise ValueError(f"{images.dtype} {images.shape} images")
        return images, {str(name): str(reason) for name, reason in rejected.items()}
    except Exception as error:  # a damaged archive raises whatever NumPy makes of it
        problem = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ViewnetError(f"{file}: damaged ({problem}): remove it, and it is rendered again") from None


def _check(
    models: Sequence[ModelFile],
    views: int,
    image_size: int,
    supersample: int,
    azimuth_range: tuple[float, float],
    elevation_range: tuple[float, float],
    workers: int | None,
) -> None:
    if not models:
        raise ViewnetError("no models to render: give at least one")
    names = [(model.category, model.id) for model in models]
    if twice := [name for name, other in itertools.pairwise(names) if name == other]:
        raise ViewnetError(f"model {twice[0][1]} of {twice[0][0]} is given twice")
    for name, value, most in (
        ("views", views, 10_000),
        ("image_size", image_size, 4096),
        ("supersample", supersample, 16),
    ):
        if not 1 <= value <= most:
            raise ViewnetError(f"{name} {value}: expected 1 to {most}")
    if workers is not None and workers < 1:
        raise ViewnetError(f"workers {workers}: expected 1 or more, or None for one a processor")
    low, high = azimuth_range
    if not (-360 <= low <= high <= 720 and high - low <= 360):
        raise ViewnetError(f"azimuth_range {azimuth_range}: expected (low, high) in degrees, at most 360 apart")
    low, high = elevation_range
    if not -90 <= low <= high <= 90:
        raise ViewnetError(f"elevation_range {elevation_range}: expected (low, high) in degrees within -90 and 90")


def _source(model: ModelFile) -> str:
    """The model's file relative to its collection, the same wherever that lies."""
    return model.path.relative_to(model.folder.parent.parent).as_posix()


def _reopen(folder: Path, made_by: dict[str, Any]) -> ViewStore:
    shutil.rmtree(partial_folder(folder), ignore_errors=True)
    store = ViewStore.open(folder)
    if store.identity != identity_of(made_by):
        raise ViewnetError(
            f"{folder}: holds views made from other models or settings: remove it or name another folder"
        )
    return store


def _plan(models: Sequence[ModelFile], partial: Path, made_by: dict[str, Any]) -> list[tuple[np.ndarray, Path]]:
    """Model numbers and file of each chunk. What `partial` holds of another request is thrown away."""
    plan = json.dumps({"identity": identity_of(made_by), "chunk": CHUNK})
    note = partial / "plan.json"
    if partial.exists() and not (note.is_file() and note.read_bytes() == plan.encode()):
        shutil.rmtree(partial)
    if not partial.exists():
        write_text(note, plan)
    rows = np.arange(len(models))
    return [(rows[i : i + CHUNK], partial / f"{i:08d}.npz") for i in range(0, len(models), CHUNK)]


def _check_room(folder: Path, size: int, open_share: float) -> None:
    """The chunks still to draw and the store itself must fit beside each other, with a little to spare."""
    needed = int(size * (1 + open_share) * 1.02) + 2**20
    free = shutil.disk_usage(folder.parent).free
    if free < needed:
        raise ViewnetError(
            f"{folder}: {needed} bytes needed and {free} free on that disk: make room or use fewer views"
        )


def _render(
    jobs: list[Chunk], total: int, workers: int | None, progress: bool, views: int, executor: Executor | None
) -> None:
    left = sum(len(job.models) for job in jobs)
    if workers is None:
        workers = 1 if left * views < _WORTH_PROCESSES else cores()
    workers = min(workers, len(jobs))
    with progress_bar(progress, total=total, initial=total - left, desc="render", unit="model") as bar:
        try:
            if executor is None and workers <= 1:
                for job in jobs:
                    bar.update(render_chunk(job))
                return
            with pool(workers) if executor is None else nullcontext(executor) as crew:
                rendering = [crew.submit(render_chunk, job) for job in jobs]
                try:
                    for done in as_completed(rendering):
                        bar.update(done.result())
                finally:
                    for waiting in rendering:
                        waiting.cancel()
        except BrokenExecutor:
            raise ViewnetError(
                "a rendering process died: call again with fewer workers if memory ran out (what is rendered is kept);"
                " a script must start its work under `if __name__ == '__main__':`"
            ) from None


def _assemble(
    folder: Path,
    models: Sequence[ModelFile],
    files: list[Path],
    azimuth: np.ndarray,
    elevation: np.ndarray,
    made_by: dict[str, Any],
) -> ViewStore:
    """Put the chunks together, leaving out the models that could not be used."""
    import pandas as pd  # slow to import, and every rendering process imports this module

    reasons: dict[str, str] = {}
    for file in files:
        reasons.update(read_chunk(file)[1])
    rejected = [(model.id, _source(model), reasons[model.id]) for model in models if model.id in reasons]
    used = [i for i, model in enumerate(models) if model.id not in reasons]
    if not used:
        name, _, reason = rejected[0]
        raise ViewnetError(f"{folder}: none of the {len(models)} models can be used (the first, {name}: {reason})")
    if rejected:
        log.warning("%s: %d of %d models cannot be used, see rejected.csv", folder, len(rejected), len(models))
    views = azimuth.shape[1]
    index = pd.DataFrame(
        {
            "model_id": np.repeat([models[i].id for i in used], views),
            "category": np.repeat([models[i].category for i in used], views),
            "split": np.repeat([models[i].split for i in used], views),
            "view": np.tile(np.arange(views), len(used)),
            "azimuth": azimuth[used].ravel(),
            "elevation": elevation[used].ravel(),
            "source": np.repeat([_source(models[i]) for i in used], views),
        }
    )
    return write_store(folder, (read_chunk(file)[0] for file in files), index, made_by, rejected)
