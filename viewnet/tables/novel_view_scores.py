"""Scores of rendered novel views: fidelity to the object, and consistency with the viewpoint.

Fidelity: every test view is rendered with the appearance of its object's next view from its true viewpoint, taken into
the network's own frame by the inverse of the rotation that was fitted on validation views. Rendered and test view are
compared on black: PSNR and SSIM (Wang et al. 2004) of colours, and the intersection over union of masks, cut at one
half. Empty space counts as right, so the scores are to be compared with the row COPY, the appearance view itself.

Consistency: the error of a viewpoint network on objects rendered from random viewpoints. The model's own network may
share a private code with its decoder, so the category's ViewNet judges too, aligned on the other half of the objects.

The HoloGAN decoder has no mask: no IoU. A network trained on masks alone learns no colours: neither PSNR nor SSIM.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
import torch.nn.functional as F
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torch import Tensor

from viewnet.errors import ViewnetError
from viewnet.evaluation import alignment, metrics
from viewnet.evaluation.predictions import Floats, true_vectors
from viewnet.evaluation.run import Run
from viewnet.geometry import look_at, view_vector
from viewnet.runtime.files import write_csv, write_text
from viewnet.runtime.images import tight_crop
from viewnet.tables import columns, latex
from viewnet.tables.layouts import LABELS
from viewnet.tables.run_renderer import BATCH, RunRenderer, Stores, own_views, renderers

COPY = "Appearance view"  # the row of the appearance view itself, in the place of a rendered view
HIGHEST = 100.0  # dB: the PSNR of equal images
DRAWS = 1000  # of the bootstrap, as for the other tables


def fidelity(renderer: RunRenderer, copy: bool = False) -> pd.DataFrame:
    """A row for each test view: model_id, view, psnr (dB), ssim, iou; NaN for what the network does not render.

    With `copy`, of the appearance view in its place. ViewnetError for photographs and for objects of a single view.
    """
    views, ids = renderer.views, renderer.aligned.predictions.ids
    if views.opaque:
        raise ViewnetError(f"{renderer.store.folder}: photographs have no mask: score novel views on rendered ones")
    if int(views.count.min()) < 2:
        raise ViewnetError(f"{renderer.store.folder}: an object has a single view: render two or more a model")
    frames = renderer.in_own_frame(look_at(torch.from_numpy(true_vectors(ids))))
    parts = []
    for rows in map(Tensor.tolist, torch.arange(len(renderer)).split(BATCH)):
        other = renderer.next_views(rows)  # its own view would give the answer away
        rendered = renderer.images(other) if copy else renderer.render(renderer.encode(other), frames[rows])
        parts.append(compare(rendered, renderer.images(rows)))
    scores = pd.concat([ids[["model_id", "view"]], pd.concat(parts, ignore_index=True)], axis=1)
    if not copy and renderer.config.train.target == "mask":
        scores[["psnr", "ssim"]] = np.nan  # its colours were never compared with any
    return scores


def compare(rendered: Tensor, target: Tensor) -> pd.DataFrame:
    """psnr, ssim and iou of images (N, 4, S, S), RGB times mask and mask in [0, 1], against as many targets."""
    pairs = zip(*(x.clamp(0, 1).double().cpu().movedim(1, -1).numpy() for x in (rendered, target)), strict=True)
    lines = []
    for one, true in pairs:
        colours, true_colours = one[..., :3], true[..., :3]
        with np.errstate(divide="ignore"):  # equal images have an infinite one
            psnr = min(HIGHEST, float(peak_signal_noise_ratio(true_colours, colours, data_range=1.0)))
        ssim = structural_similarity(
            true_colours, colours, data_range=1.0, channel_axis=-1,
            gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        )  # fmt: skip
        mask, true_mask = one[..., 3] > 0.5, true[..., 3] > 0.5  # masks are soft at edges
        union = (mask | true_mask).sum()
        # Two empty masks are equal.
        lines.append({"psnr": psnr, "ssim": float(ssim), "iou": (mask & true_mask).sum() / union if union else 1.0})
    return pd.DataFrame(lines, columns=list(columns.FIDELITY))


@torch.no_grad()
def consistency(renderer: RunRenderer, judge: RunRenderer | None = None) -> Floats:
    """Errors (N,), degrees, of the viewpoints predicted for views rendered from random viewpoints, one per test view.

    Predicted by the network's own viewpoint network or, if given, the judge's; see above. Each test view gives an
    appearance. Azimuths are uniform, elevations uniform in the range of the run's views. All decoders render at the
    size they were trained at, enlarged to the input size, so that none has an advantage in sharpness.
    """
    reader = judge or renderer
    model = reader.network.config
    low, high = renderer.config.data.elevation_range
    # One seed for all: every network is shown its objects from the same viewpoints.
    angles = torch.from_numpy(np.random.default_rng(0).uniform((0, low), (360, high), (len(renderer), 2)))
    truth = view_vector(angles[:, 0], angles[:, 1])
    vectors, up_vectors = [], []
    for rows in map(Tensor.tolist, torch.arange(len(renderer)).split(BATCH)):
        rendered = renderer.render(renderer.encode(rows), look_at(truth[rows]))  # level, as the views are
        images = F.interpolate(rendered, (model.input_size, model.input_size), mode="bilinear")
        if model.crop != "none":
            images = tight_crop(images, model.input_size, model.crop == "stretched")
        hypotheses = reader.network.viewpoint(reader.network.composite(images))
        heads = hypotheses.logits.argmax(1)
        vectors.append(hypotheses.of_heads(heads).double().cpu().numpy())
        if hypotheses.ups is not None:
            up_vectors.append(hypotheses.ups[torch.arange(len(rows)), heads].double().cpu().numpy())
    predicted, true = np.concatenate(vectors), truth.numpy()
    ups = np.concatenate(up_vectors) if up_vectors else None
    if judge is None:  # its own network knows the frame
        return metrics.geodesic_error(predicted, true, ups)
    errors, even = np.empty(len(predicted)), renderer.views.objects.numpy() % 2 == 0  # halves of objects, not of views
    # Each half is aligned by a fit on the other, so that no object decides on its own score.
    for half in (even, ~even):
        rotation = alignment.fit_rotation(predicted[~half], true[~half])
        half_ups = None if ups is None else ups[half] @ rotation.T
        errors[half] = metrics.geodesic_error(predicted[half] @ rotation.T, true[half], half_ups)
    return errors


def cells(runs: Sequence[Run], stores: Stores = own_views, draws: int = DRAWS) -> pd.DataFrame:
    """A line for each row, category and metric: the columns of viewnet.tables.table.Table.cells but printed and bold.

    Intervals have `draws` resamplings. The first row of a category is COPY, of its first run's views and size. The
    judge is the category's run of ViewNet, of its first seed; without one nothing is judged. Raises ViewnetError for
    two runs of one variant, category and seed, and as `fidelity` does.
    """
    if len({(run.config.variant, run.config.category, run.config.seed) for run in runs}) < len(runs):
        raise ViewnetError("novel views: two runs of one variant and category have the same seed: choose one")
    for run in runs:
        if run.config.variant not in LABELS:
            raise ViewnetError(f"novel views: {run.name} is no row: choose one of {', '.join(LABELS)}")
    lines: list[dict[str, object]] = []
    for category in dict.fromkeys(run.config.category for run in runs):
        here = [run for run in runs if run.config.category == category]
        groups = {variant: [run for run in here if run.config.variant == variant] for variant in LABELS}
        mine = {variant: renderers(group, stores) for variant, group in groups.items() if group}
        judge = mine["viewnet"][0] if "viewnet" in mine else None  # one judge, so that rows compare
        copied = fidelity(next(iter(mine.values()))[0], copy=True)
        lines += _lines({"row": COPY, "variant": "", "category": category}, "", [copied], {}, draws)
        for variant, seeds in mine.items():
            errors = {"consistency": [consistency(renderer) for renderer in seeds]}
            if judge is not None:
                errors["judged"] = [consistency(renderer, judge) for renderer in seeds]
            keys = " ".join(run.key for run in groups[variant])
            about = {"row": LABELS[variant], "variant": variant, "category": category}
            lines += _lines(about, keys, [fidelity(renderer) for renderer in seeds], errors, draws)
    return pd.DataFrame(lines)


def write(cells: pd.DataFrame, folder: Path, note: str = "") -> list[Path]:
    """`novel_views.tex`, a booktabs tabular, and `novel_views.csv`: every number, with its interval and runs."""
    tex = folder / "novel_views.tex"
    write_text(tex, latex.measured(cells, columns.NOVEL_VIEWS, note))
    return [tex, write_csv(folder / "novel_views.csv", cells.round(4))]


def _lines(
    about: dict[str, str], keys: str, scored: Sequence[pd.DataFrame], errors: dict[str, list[Floats]], draws: int
) -> list[dict[str, object]]:
    """Every metric of a row: `scored` is `fidelity` of each seed, `errors` its `consistency` by kind of network."""
    objects = [scores["model_id"].to_numpy() for scores in scored]
    values: dict[str, tuple[list[float], tuple[float, float] | None]] = {}
    for metric in columns.FIDELITY:
        each = [scores[metric].to_numpy() for scores in scored]
        values[metric] = [float(e.mean()) for e in each], metrics.mean_interval(each, objects, draws)
    for kind, seeds in errors.items():
        bounds = metrics.bootstrap_intervals(seeds, objects, np.random.default_rng(0), draws)
        for statistic in columns.HEADLINE:
            values[f"{kind}_{statistic}"] = [metrics.STATISTICS[statistic](e) for e in seeds], bounds[statistic]
    parts = {m: columns.measured(*values.get(m, ([np.nan], None)), objects) for m in columns.NOVEL_VIEWS}
    return [{**about, "metric": metric, **part, "runs": keys} for metric, part in parts.items()]
