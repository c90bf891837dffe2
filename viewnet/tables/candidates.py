"""Figure 3 (d): what each head renders of an image, by rising reconstruction error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure

from viewnet.data import augment
from viewnet.data.pairs import resize
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import align
from viewnet.evaluation.run import Run
from viewnet.model.reconstruction import reconstruct
from viewnet.model.rendering import to_uint8
from viewnet.tables.plots import STYLE
from viewnet.tables.run_renderer import RunRenderer, Stores, own_views

Ranked = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Views (N, H, W, 3), reconstructions (N, M, H, W, 3) uint8, their errors and the heads, (N, M)."""


@torch.no_grad()
def ranked_reconstructions(folder: Path, store: ViewStore, rows: list[int]) -> Ranked:
    """Some test views of a run, each reconstructed by every head, by rising reconstruction error; see Ranked.

    The appearance comes from the next view of the same object, the background is white. Raises ViewnetError as
    RunRenderer.of does.
    """
    renderer = RunRenderer.of(folder, store)
    network, train, views = renderer.network, renderer.config.train, renderer.views
    size, small, index = network.config.render_size, network.config.input_size, torch.tensor(rows)
    images, background = views.viewpoint_input(index, small, renderer.device), None
    if renderer.backgrounds is not None:
        generator = torch.Generator().manual_seed(0)
        images = augment.photograph(images, renderer.backgrounds, train.photo, generator)
        background = augment.windows(renderer.backgrounds, len(rows), small, generator, renderer.device)
    target = renderer.images(rows, small)
    target = target if size == small else resize(target, size)
    appearance = renderer.images(renderer.next_views(rows), small)
    result = reconstruct(network, appearance, target, images, train, background=background)
    cameras = result.hypotheses.world_from_camera.flatten(0, 1)  # (N M, 3, 3)
    rendered = to_uint8(network.render(result.objects.volume, result.objects.code, cameras))
    errors, heads = (x.cpu().numpy() for x in result.choice.errors.sort(1))
    by_head = rendered.reshape(len(rows), -1, *rendered.shape[1:])  # (N, M, H, W, 3)
    return to_uint8(renderer.images(rows, size)), by_head[np.arange(len(rows))[:, None], heads], errors, heads


def candidate_figure(
    runs: Sequence[Run],
    stores: Stores = own_views,
    ranked: Callable[[Path, ViewStore, list[int]], Ranked] = ranked_reconstructions,
    count: int = 1,
) -> Figure:
    """Figure 3 (d) of trained runs of the same number of heads, `count` test images of each, evenly spaced.

    Raises ViewnetError without runs, for untrained ones and for images of different sizes.
    """
    parts, labels = [], []
    for run in runs:
        if not run.trained:
            raise ViewnetError(f"figure 3: {run.config.variant} renders nothing: choose a trained variant")
        aligned = align(run.predictions, run.alignment)
        rows = np.linspace(0, len(aligned.predictions) - 1, count + 2).round().astype(int)[1:-1]
        inputs, rendered, errors, heads = ranked(run.folder, stores(run), rows.tolist())
        parts.append((inputs, rendered, errors, np.take_along_axis(aligned.errors[rows], heads, axis=1)))
        labels += [run.config.category] * len(rows)
    if not parts:
        raise ViewnetError("figure 3: no runs to show: train some first")
    if len(sizes := {part[1].shape[1:] for part in parts}) > 1:
        raise ViewnetError(f"figure 3: images of {len(sizes)} sizes cannot share a grid: show runs of one profile")
    inputs, rendered, errors, angles = (np.concatenate(column) for column in zip(*parts, strict=True))
    n, m = rendered.shape[:2]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(0.9 * (m + 1), 1.05 * n + 0.2), layout="constrained")
        grid = figure.subplots(n, m + 1, squeeze=False)
        for i in range(n):
            for j, axes in enumerate(grid[i]):
                axes.imshow(inputs[i] if j == 0 else rendered[i, j - 1], interpolation="nearest")
                axes.set(xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
                if j:
                    axes.set_xlabel(f"{errors[i, j - 1]:.3f} / {angles[i, j - 1]:.0f}°", labelpad=2, fontsize=7)
            grid[i, 0].set_ylabel(labels[i])
        grid[0, 0].set_title("input", fontsize=8)
        grid[0, 1].set_title("error / angle", fontsize=8, loc="left")
    return figure
