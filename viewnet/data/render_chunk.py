"""What a rendering process does: draw the models of one chunk into one file. Many start it, so imports are light."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from viewnet.data.readers.shapenet import ModelFile, load_model
from viewnet.errors import ViewnetError
from viewnet.render import Backend, render_frames
from viewnet.render.mesh import UnusableModel
from viewnet.runtime.files import replacing


@dataclass(frozen=True)
class Chunk:
    """Models to draw and how: camera frames (M, V, 3, 3), directions to the light (M, V, 3), and the file to write."""

    models: tuple[ModelFile, ...]
    frames: np.ndarray
    lights: np.ndarray
    size: int
    supersample: int
    backend: Backend
    file: Path


def draw_chunk(chunk: Chunk) -> int:
    """Write the chunk's images (usable models * V, S, S, 4) and the reasons of its unusable models; their number."""
    views = chunk.frames.shape[1]
    images = np.zeros((len(chunk.models), views, chunk.size, chunk.size, 4), np.uint8)
    rejected: dict[str, str] = {}
    used = 0
    for number, model in enumerate(chunk.models):
        try:
            mesh = load_model(model)
        except UnusableModel as error:
            rejected[model.id] = error.reason
            continue
        images[used] = render_frames(
            mesh, chunk.frames[number], chunk.lights[number], chunk.size, chunk.supersample, chunk.backend
        )
        used += 1
    with replacing(chunk.file) as temporary:
        drawn = images[:used].reshape(-1, *images.shape[2:])
        np.savez(temporary, images=drawn, rejected=np.array(json.dumps(rejected)))
    return len(chunk.models)


def read_chunk(file: Path) -> tuple[np.ndarray, dict[str, str]]:
    """Images and rejected models (id -> reason) of a chunk's file. ViewnetError where it is damaged."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            images, rejected = stored["images"], json.loads(str(stored["rejected"]))
        if images.dtype != np.uint8 or images.ndim != 4 or not isinstance(rejected, dict):
            raise ValueError(f"{images.dtype} {images.shape} images")
        return images, {str(name): str(reason) for name, reason in rejected.items()}
    except Exception as error:  # a damaged archive raises whatever is stumbled over
        problem = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ViewnetError(f"{file}: damaged ({problem}): remove it, and it is drawn again") from None
