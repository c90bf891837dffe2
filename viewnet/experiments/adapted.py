"""A saved model whose viewpoint network is adapted to photographs (viewnet.training.adapt), with scores and a card."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch

from viewnet.data import build
from viewnet.data.crop import Box, clipped
from viewnet.errors import ViewnetError
from viewnet.estimator import preprocess
from viewnet.experiments import distilled
from viewnet.runtime import image_files
from viewnet.training.adapt import LEAST, Adaptation, adapt


def make(
    where: str,
    images: Sequence[str],
    boxes: Sequence[Box] | None,
    folder: Path,
    failures: dict[int, str],
    seed: int = 0,
    half: bool = False,
    cad_root: str | None = None,
    progress: bool = True,
) -> Adaptation:
    """Adapt the model `where`, what pretrained.load takes, to photographs, and save it if that helps.

    Images that cannot be read, and those whose object has fewer pixels along its longer side than the network's input
    has, are left out: their positions and errors join `failures`. Scores are of the views that the model was trained
    on; `cad_root` is where that collection lies, if it has moved. Raises ViewnetError for fewer than LEAST images that
    can be used, before anything is trained, and as viewnet.training.adapt.adapt and pretrained.save do.
    """
    distilled.check_place(folder, seed)
    model = distilled.loaded(where, f"adapt {where}")
    framing = preprocess.Framing.of(model.config)
    failures |= {
        row: problem
        for row, name in enumerate(images)
        if (problem := _too_small(Path(name), boxes[row] if boxes else None, framing.size))
    }
    rows = [row for row in range(len(images)) if row not in failures]
    unread: dict[int, str] = {}
    chosen = [images[row] for row in rows]
    edges = [boxes[row] for row in rows] if boxes else None
    batches = preprocess.computed(lambda each: each.viewpoint, chosen, None, edges, framing, 256, unread, progress)
    parts = [part.mul(255).round().to(torch.uint8) for batch in batches for part in batch]  # (n, 4, S, S) each
    failures |= {rows[row]: problem for row, problem in unread.items()}
    if sum(map(len, parts)) < LEAST:
        row = min(failures, default=None)
        first = "" if row is None else f" (the first that was left out: {images[row]}: {failures[row]})"
        raise ViewnetError(f"adapt: {sum(map(len, parts))} usable photographs: needs {LEAST} or more{first}")
    config = distilled.moved(model.config, cad_root)
    store = build.view_store(config.data, progress=progress)
    result = adapt(model.network, config, store, torch.cat(parts), seed, progress)
    if result.kept:
        how = {"distilled": model.about.get("distilled"), "adapted": asdict(result)}
        distilled.save_scored(model, config, store, how, seed, folder, half)
    return result


def _too_small(path: Path, box: Box | None, least: int) -> str | None:
    try:
        width, height = image_files.size(path)
        x0, y0, x1, y1 = clipped(box, (width, height)) if box else (0, 0, width, height)
    except ViewnetError as error:
        return str(error)
    if max(x1 - x0, y1 - y0) >= least:
        return None
    return f"the object is {x1 - x0:.0f} x {y1 - y0:.0f} pixels: too small to learn from, needs {least} along one side"
