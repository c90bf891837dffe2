"""Scores of rendered novel views: fidelity to the object, and consistency with the viewpoint.

Fidelity: every test view is rendered with the appearance of its object's next view from its true viewpoint, taken into
the network's own frame by the inverse of the rotation that was fitted on validation views. Rendered and test view are
compared on black: PSNR and SSIM (Wang et al. 2004) of colours, and the intersection over union of masks, cut at one
half. Empty space counts as right, so the scores are to be compared with the row COPY, the appearance view itself.

Consistency: the error of a viewpoint network on objects rendered from random viewpoints. The model's own network may
share a private code with its decoder, so the category's ViewNet judges too, aligned on the other half of the objects.

Hypotheses: the one that reconstructs a view best, from the next view's appearance, and the one closest to the truth.

The HoloGAN decoder has no mask: no IoU. A network trained on masks alone learns no colours: neither PSNR nor SSIM.

The scores of every run are kept, so that seeds can be added where its network is gone:

novel_views.parquet    a row for each run and test view: RUN, model_id, view, SCORES
novel_views.csv        what they come to, a line for each row, category and metric; novel_views.tex as a table
"""

from pathlib import Path

import numpy as np
import pandas as pd
import torch
import torch.nn.functional as F
from torch import Tensor

from viewnet.errors import ViewnetError
from viewnet.evaluation import alignment, metrics
from viewnet.evaluation.predictions import Floats, read_parquet, true_vectors, write_compact
from viewnet.evaluation.run import Run
from viewnet.geometry import look_at, view_vector
from viewnet.runtime import provenance
from viewnet.runtime.files import read_csv, write_csv, write_text
from viewnet.runtime.images import tight_crop
from viewnet.tables import columns, latex
from viewnet.tables.kept_predictions import differing
from viewnet.tables.layouts import LABELS
from viewnet.tables.run_renderer import BATCH, RunRenderer, Stores, own_views, renderers

COPY = "Appearance view"  # the row of the appearance view itself, in the place of a rendered view
KEPT = "novel_views.parquet"
VIEW = ("model_id", "view")
RUN = ("variant", "category", "seed", "run", "settings", "commit")
"""What says whose scores they are: all but category and seed empty of COPY."""
SCORES = {**dict.fromkeys(columns.FIDELITY, 4), "consistency": 2, "judged": 2, "reconstructing": 2, "closest": 2}
"""The scores of a view, and the digits that are kept: PSNR, SSIM and IoU, and errors of viewpoints in degrees."""
ERRORS = ("consistency", "judged", "reconstructing")
"""The errors whose accuracy and median are metrics."""
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
    from skimage.metrics import peak_signal_noise_ratio, structural_similarity  # slow to import

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


def of_hypotheses(renderer: RunRenderer) -> dict[str, Floats]:
    """Errors (N,), degrees, of each test view's hypothesis that reconstructs it best, and of the one that is closest.

    Reconstructed from the object's next view, and compared as heads are in training (equation 2).
    """
    parts = map(Tensor.tolist, torch.arange(len(renderer)).split(BATCH))
    own = [renderer.reconstruction_errors(renderer.encode(renderer.next_views(rows)), rows) for rows in parts]
    best = torch.cat(own).argmin(1).cpu().numpy()  # (N,)
    errors = renderer.aligned.errors
    return {"reconstructing": errors[np.arange(len(errors)), best], "closest": errors.min(axis=1)}


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


def scores(run: Run, judge: Run | None = None, stores: Stores = own_views) -> pd.DataFrame:
    """Of each test view of a run RUN, model_id, view and SCORES, where "consistency" is by the run's own network.

    ViewnetError for a run that is no row, and as `fidelity` does.
    """
    config = run.config
    if config.variant not in LABELS:
        raise ViewnetError(f"novel views: {run.name} is no row: choose one of {', '.join(LABELS)}")
    (renderer,) = renderers([run], stores)
    judges = [] if judge is None else renderers([judge], stores)
    commit = provenance.in_words(run.result.get("git") or {})
    about = (config.variant, config.category, config.seed, run.key, config.settings_key(), commit)
    errors = {"consistency": consistency(renderer), "judged": consistency(renderer, judges[0]) if judges else np.nan}
    errors |= of_hypotheses(renderer)
    return fidelity(renderer).assign(**dict(zip(RUN, about, strict=True)), **errors)[[*RUN, *VIEW, *SCORES]]


def copied(run: Run, stores: Stores = own_views) -> pd.DataFrame:
    """The same of COPY, of a run's views and size."""
    about = dict.fromkeys(RUN, "") | {"category": run.config.category, "seed": 0}
    (renderer,) = renderers([run], stores)
    found = fidelity(renderer, copy=True).assign(**about)
    return found.reindex(columns=[*RUN, *VIEW, *SCORES])


def read(folder: Path) -> pd.DataFrame:
    """The scores that are kept in a folder, none where there is no file. ViewnetError naming one that is damaged."""
    if not (path := folder / KEPT).is_file():
        return pd.DataFrame(columns=[*RUN, *VIEW, *SCORES])
    if list((found := read_parquet(path)).columns) != [*RUN, *VIEW, *SCORES]:
        raise ViewnetError(f"{path}: not the scores of novel views: remove it and make them again")
    return found


def keep(found: pd.DataFrame, folder: Path) -> Path:
    """Add scores to those kept in a folder, in the place of those of the same variant, category and seed."""
    before, which = read(folder), ["variant", "category", "seed"]
    replaced = pd.MultiIndex.from_frame(before[which]).isin(pd.MultiIndex.from_frame(found[which]))
    whole = pd.concat([before[~replaced], found], ignore_index=True) if len(before) else found
    rank = {variant: place for place, variant in enumerate(("", *LABELS))}
    whole = whole.assign(rank=whole["variant"].map(rank)).sort_values(["category", "rank", "seed"], kind="stable")
    whole = whole.drop(columns="rank").round(SCORES).astype(dict.fromkeys(SCORES, "float32") | {"seed": "int64"})
    write_compact(whole, path := folder / KEPT)
    return path


def cells(kept: pd.DataFrame, draws: int = DRAWS) -> pd.DataFrame:
    """A line for each row, category and metric: the columns of viewnet.tables.table.Table.cells but printed and bold.

    `kept` is `scores` of runs and `copied`, one below the other. Intervals have `draws` resamplings.
    """
    lines: list[dict[str, object]] = []
    for (category, variant), rows in kept.groupby(["category", "variant"], sort=False):
        seeds = [seed for _, seed in rows.groupby("seed")]
        objects = [seed["model_id"].to_numpy() for seed in seeds]
        means = {metric: [seed[metric].to_numpy(np.float64) for seed in seeds] for metric in columns.FIDELITY}
        errors = {kind: [seed[kind].to_numpy(np.float64) for seed in seeds] for kind in ERRORS}
        errors = {kind: each for kind, each in errors.items() if not np.isnan(each[0]).any()}
        if "reconstructing" in errors:
            means["misled"] = [100.0 * (seed["reconstructing"] > seed["closest"]).to_numpy() for seed in seeds]
        values: dict[str, tuple[list[float], tuple[float, float] | None]] = {
            metric: ([float(e.mean()) for e in each], metrics.mean_interval(each, objects, draws))
            for metric, each in means.items()
        }
        for kind, each in errors.items():
            bounds = metrics.bootstrap_intervals(each, objects, draws)
            for statistic in columns.HEADLINE:
                values[f"{kind}_{statistic}"] = [metrics.STATISTICS[statistic](e) for e in each], bounds[statistic]
        about = {"row": LABELS.get(variant, COPY), "variant": variant, "category": category}
        keys = " ".join(filter(None, rows["run"].unique()))
        for metric in columns.NOVEL_VIEWS:
            part = columns.measured(*values.get(metric, ([np.nan], None)), objects)
            lines.append({**about, "metric": metric, **part, "runs": keys})
    return pd.DataFrame(lines)


def differences(path: Path) -> pd.DataFrame:
    """The cells beside the file `path` of scores that these do not reproduce: see kept_predictions.differing."""
    return differing(read_csv(path.with_suffix(".csv")), cells(read(path.parent)), 5e-4)


def write(cells: pd.DataFrame, folder: Path, note: str = "") -> list[Path]:
    """`novel_views.tex`, a booktabs tabular, and `novel_views.csv`: every number, with its interval and runs."""
    tex = folder / "novel_views.tex"
    write_text(tex, latex.measured(cells, columns.NOVEL_VIEWS, note))
    return [tex, write_csv(folder / "novel_views.csv", cells.round(4))]
