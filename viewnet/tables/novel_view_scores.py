"""Novel views in numbers: how true they are to the object, and whether they tell where they were drawn from.

Fidelity: every test view is drawn from the appearance of its object's next view and from its true viewpoint, brought
into the network's own frame by the inverse of the rotation that was fitted on validation views. Drawing and target are
compared over black, whatever was behind them in training: PSNR and SSIM (Wang et al. 2004) of colours, and the
intersection over union of masks, cut at one half. Black is right wherever both agree that nothing is, so these are to
be compared with the row COPY, the appearance view itself in the drawing's place.

Consistency: every object is drawn from a random viewpoint and shown to a viewpoint network, whose answer is as far off
as drawing and viewpoint belong together. Asked is the network's own, in its own frame; that needs no alignment, but a
decoder and a viewpoint network may have agreed on signs that have nothing to do with viewpoints. So a judge is asked
too: the viewpoint network of ViewNet of the same category, up to a rotation fitted on the other half of the objects.

The HoloGAN decoder paints no mask: its drawings are whole images, on black, and it has no IoU. What is trained on
masks alone (segmentation_target) learns no colours: it has neither PSNR nor SSIM.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
import torch.nn.functional as F
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torch import Tensor

from viewnet.data.pairs import tight_crop
from viewnet.errors import ViewnetError
from viewnet.evaluation import metrics
from viewnet.evaluation.alignment import fit_rotation
from viewnet.evaluation.predictions import Floats, true_vectors
from viewnet.evaluation.run import Run
from viewnet.geometry import look_at, view_vector
from viewnet.runtime.files import write_text
from viewnet.tables import cells as table_cells
from viewnet.tables import latex
from viewnet.tables.columns import COLUMNS, DASH, FIDELITY, HEADLINE, NOVEL_VIEWS, names
from viewnet.tables.layouts import LABELS
from viewnet.tables.run_renderer import BATCH, RunRenderer, Stores, own_views, renderers

VARIANTS = (
    "viewnet",
    "viewnet_cycle",
    "segmentation_target",
    "no_shape_prior",
    "encoder_decoder",
    "hologan_decoder",
)
"""The rows of the table, under COPY."""
COPY = "Appearance view"
"""The row of what it is worth to draw nothing and show the appearance view as it is."""
HIGHEST = 100.0
"""dB: what equal images get, which have no error to compare with."""
BRIGHT = 0.1
"""What an image without a mask is brighter than where the object is, for networks that see objects cut out."""
DRAWS = 1000


def fidelity(drawer: RunRenderer, copy: bool = False) -> pd.DataFrame:
    """A row for each test view: model_id, view, psnr (dB), ssim, iou; NaN for what the network does not draw.

    With `copy`, of the appearance view in the drawing's place. Raises ViewnetError for photographs, which have no mask
    to compare with, and for objects of a single view.
    """
    views = drawer.views
    if views.opaque:
        raise ViewnetError(f"{drawer.store.folder}: photographs have no mask: score novel views on rendered ones")
    if int(views.count.min()) < 2:
        raise ViewnetError(f"{drawer.store.folder}: an object has a single view: render two or more a model")
    said = drawer.aligned.predictions
    frames = drawer.own(look_at(torch.from_numpy(true_vectors(said.ids))))
    parts = []
    for rows in _batches(len(drawer)):
        other = drawer.partners(rows)
        drawn = drawer.images(other) if copy else drawer.draw(drawer.imagine(other), frames[rows])
        parts.append(compare(drawn, drawer.images(rows)))
    found = pd.concat([said.ids[["model_id", "view"]], pd.concat(parts, ignore_index=True)], axis=1)
    if not copy and drawer.hologan:
        found["iou"] = np.nan
    if not copy and drawer.config.train.target == "mask":
        found[["psnr", "ssim"]] = np.nan
    return found


def compare(drawn: Tensor, target: Tensor) -> pd.DataFrame:
    """psnr, ssim and iou of images (N, 4, S, S), RGB times mask and mask in [0, 1], against as many others."""
    a, b = (p.clamp(0, 1).double().cpu().movedim(1, -1).numpy() for p in (drawn, target))
    lines = []
    for one, other in zip(a, b, strict=True):
        said, true = one[..., :3], other[..., :3]
        with np.errstate(divide="ignore"):
            psnr = min(HIGHEST, float(peak_signal_noise_ratio(true, said, data_range=1.0)))
        ssim = structural_similarity(
            true, said, data_range=1.0, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
        inside, truly = one[..., 3] > 0.5, other[..., 3] > 0.5
        union = (inside | truly).sum()
        lines.append({"psnr": psnr, "ssim": float(ssim), "iou": (inside & truly).sum() / union if union else 1.0})
    return pd.DataFrame(lines, columns=list(FIDELITY))


@torch.no_grad()
def consistency(drawer: RunRenderer, judge: RunRenderer | None = None, seed: int = 0) -> Floats:
    """Degrees (N,) between random viewpoints and what is said of drawings from them, one for each test view.

    The network's own viewpoint network is asked or, if given, the judge's; see above. Each test view gives an
    appearance. Azimuths are uniform, elevations uniform in the range of the run's views. All decoders' drawings are of
    the size they were learned at and enlarged to what is seen, so that none has the sharper ones.
    """
    reader, rng = judge or drawer, np.random.default_rng(seed)
    low, high = drawer.config.data.elevation_range
    angles = torch.from_numpy(rng.uniform((0, low), (360, high), (len(drawer), 2)))
    truth = view_vector(angles[:, 0], angles[:, 1])
    vectors, tilts = [], []
    for rows in _batches(len(drawer)):
        found = reader.network.viewpoint(_seen(drawer.draw(drawer.imagine(rows), look_at(truth[rows])), drawer, reader))
        chosen = found.logits.argmax(1)
        vectors.append(found.pick(chosen).double().cpu().numpy())
        if found.ups is not None:
            tilts.append(found.ups[torch.arange(len(rows)), chosen].double().cpu().numpy())
    said, true = np.concatenate(vectors), truth.numpy()
    ups = np.concatenate(tilts) if tilts else None
    if judge is None:
        return metrics.geodesic_error(said, true, ups)
    errors, even = np.empty(len(said)), drawer.views.objects.numpy() % 2 == 0
    # Each half is turned by what fits the other, so that no object has a say in how it is judged.
    for half in (even, ~even):
        rotation = fit_rotation(said[~half], true[~half])
        tilt = None if ups is None else ups[half] @ rotation.T
        errors[half] = metrics.geodesic_error(said[half] @ rotation.T, true[half], tilt)
    return errors


def _seen(drawn: Tensor, drawer: RunRenderer, reader: RunRenderer) -> Tensor:
    """Drawings (N, 4, S, S) as the reader's viewpoint network takes them (N, 3, s, s)."""
    model = reader.network.config
    if drawer.hologan:
        drawn = torch.cat([drawn[:, :3], (drawn[:, :3].amax(1, keepdim=True) > BRIGHT).float()], 1)
    seen = F.interpolate(drawn, (model.input_size, model.input_size), mode="bilinear")
    if model.crop != "none":
        seen = tight_crop(seen, model.input_size, model.crop == "stretched")
    return reader.network.see(seen)


def cells(runs: Sequence[Run], stores: Stores = own_views, draws: int = DRAWS) -> pd.DataFrame:
    """A line for each row, category and metric, as viewnet.tables.table.Table.cells has them: what a table is made of.

    row, variant, category, metric (of NAMES), measured (mean over seeds), sd (over seeds), low and high (95 % bootstrap
    interval over objects of that mean, `draws` resamplings), seeds, images, objects, runs (their keys). The first row
    of a category is COPY, of its first run's views and size. The judge is the category's run of ViewNet, of its first
    seed; without one nothing is judged. Raises ViewnetError for two runs of one variant, category and seed, and as
    `fidelity` does.
    """
    if len({(r.config.variant, r.config.category, r.config.seed) for r in runs}) < len(runs):
        raise ViewnetError("novel views: two runs of one variant and category have the same seed: choose one")
    order = {variant: i for i, variant in enumerate((*VARIANTS, *LABELS))}
    for run in runs:
        if run.config.variant not in LABELS:
            raise ViewnetError(f"novel views: {run.name} is no row: choose one of {', '.join(VARIANTS)}")
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in sorted(runs, key=lambda r: order[r.config.variant]):
        groups.setdefault((run.config.category, run.config.variant), []).append(run)
    lines: list[dict[str, object]] = []
    for category in dict.fromkeys(run.config.category for run in runs):
        mine = {variant: renderers(group, stores) for (c, variant), group in groups.items() if c == category}
        judge = mine["viewnet"][0] if "viewnet" in mine else None
        copied = fidelity(next(iter(mine.values()))[0], copy=True)
        lines += _lines({"row": COPY, "variant": "", "category": category, "runs": ""}, [copied], {}, draws)
        for variant, found in mine.items():
            answers = {"consistency": [consistency(drawer) for drawer in found]}
            if judge is not None:
                answers["judged"] = [consistency(drawer, judge) for drawer in found]
            keys = " ".join(run.key for run in groups[category, variant])
            about = {"row": LABELS[variant], "variant": variant, "category": category, "runs": keys}
            lines += _lines(about, [fidelity(drawer) for drawer in found], answers, draws)
    return pd.DataFrame(lines)


def frame(cells: pd.DataFrame) -> pd.DataFrame:
    """`cells` for reading: a line per row, columns (category, metric), numbers with intervals as text, -- for none."""
    texts = [
        DASH if np.isnan(m) else f"{m:.{d}f} [{low:.{d}f}, {high:.{d}f}]"
        for m, low, high, d in zip(
            cells["measured"],
            cells["low"],
            cells["high"],
            cells["metric"].map(lambda metric: COLUMNS[metric].digits),
            strict=True,
        )
    ]
    wide = cells.assign(text=texts).pivot(index="row", columns=["category", "metric"], values="text")
    columns = [(c, m) for c in dict.fromkeys(cells["category"]) for m in NOVEL_VIEWS]
    wide = wide.reindex(index=list(dict.fromkeys(cells["row"])), columns=pd.MultiIndex.from_tuples(columns))
    return wide.fillna(DASH).rename(columns=names(NOVEL_VIEWS), level=1).rename_axis(index=None)


def write(cells: pd.DataFrame, folder: Path, note: str = "") -> list[Path]:
    """`novel_views.tex`, a booktabs tabular, and `novel_views.csv`: every number, with its interval and runs."""
    files = [folder / "novel_views.tex", folder / "novel_views.csv"]
    write_text(files[0], latex.measured(cells, NOVEL_VIEWS, note))
    write_text(files[1], cells.round(4).to_csv(index=False, lineterminator="\n"))
    return files


def _lines(
    about: dict[str, str], scored: Sequence[pd.DataFrame], errors: dict[str, list[Floats]], draws: int
) -> list[dict[str, object]]:
    """Every metric of the seeds of one row, in the order of NOVEL_VIEWS; `about` is the row, variant, category, runs.

    `scored` are `fidelity` of each seed, `errors` the `consistency` of each by the kind of viewpoint network.
    """
    objects = [scores["model_id"].to_numpy() for scores in scored]
    values: dict[str, tuple[list[float], tuple[float, float] | None]] = {}
    for metric in FIDELITY:
        each = [scores[metric].to_numpy() for scores in scored]
        values[metric] = [float(e.mean()) for e in each], metrics.mean_interval(each, objects, draws)
    for kind, seeds in errors.items():
        bounds = metrics.bootstrap_intervals(seeds, objects, np.random.default_rng(0), draws)
        for statistic in HEADLINE:
            values[f"{kind}_{statistic}"] = [metrics.STATISTICS[statistic](e) for e in seeds], bounds[statistic]
    keys, nothing = about.pop("runs"), ([float("nan")], None)
    return [
        {**about, "metric": m, **table_cells.measured(*values.get(m, nothing), objects), "runs": keys}
        for m in NOVEL_VIEWS
    ]


def _batches(count: int) -> Iterator[list[int]]:
    for start in range(0, count, BATCH):
        yield list(range(start, min(start + BATCH, count)))
