"""What training measures on validation views: their reconstruction error, and the accuracy of their viewpoints."""

import math

import torch
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.data.pairs import Views
from viewnet.evaluation.alignment import Identity, Procrustes, Robust
from viewnet.evaluation.metrics import accuracy, folded, geodesic_error
from viewnet.geometry import view_vector
from viewnet.model.reconstruction import reconstruct
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.images import resize

VALIDATION_VIEWS, VIEWS_EACH = 320, 10
"""At most so many target views, enough to rank epochs, and so many of an object: its video has a hundred and more."""


def validation_rows(views: Views) -> Tensor:
    """Rows (O, V) of views to validate on: of the first objects, as many of each, evenly spread over all it has."""
    each = min(VIEWS_EACH, int(views.count.min()))
    objects = slice(VALIDATION_VIEWS // each)
    places = torch.arange(each) * views.count[objects, None] // each  # (O, V)
    return views.first[objects, None] + places


@torch.no_grad()
def validate(
    model: ViewNet, views: Views, config: TrainConfig, device: torch.device, backgrounds: Tensor | None = None
) -> dict[str, float]:
    """Scores of `validation_rows`, each view reconstructed from the appearance of the next view of its object.

    reconstruction   error of the best head: no labels
    accuracy         Acc@30 in per cent of the selected head after Procrustes; NaN without an annotated viewpoint
    folded           the same with opposite sides taken for one (viewnet.evaluation.metrics.folded)
    robust           accuracy after the robust alignment instead, which two modes do not upset
    least_used       per cent of views that the head which is best least often reconstructs best
    focal            the camera's focal length, learned or not

    With `backgrounds`, images (K, 3, 2S, 2S) uint8, views are before them as in training, the same each time.
    """
    model.eval()  # running statistics: a view's result depends on no other view
    rows = validation_rows(views).flatten()  # (N,)
    error, vectors, used = 0.0, [], torch.zeros(model.config.heads)
    generator = torch.Generator().manual_seed(0)  # the same backgrounds each epoch: scores compare
    size, small = model.config.input_size, model.config.render_size
    for part in rows.split(64):  # in parts: less memory
        # Equation 1 needs another view's appearance.
        appearance, target = (views.images(each, size, device) for each in (views.next_views(part), part))
        viewpoint_input = views.viewpoint_input(part, size, device)
        if backgrounds is not None:
            viewpoint_input = augment.photograph(viewpoint_input, backgrounds, config.photo, generator)
            appearance = augment.appearance(appearance, backgrounds, config.photo, generator)
        target = resize(target, small)
        result = reconstruct(model, appearance, target, viewpoint_input, config)
        least, best = result.choice.errors.min(1)  # the best of M, as training chooses
        error += least.sum().item()
        used += torch.bincount(best.cpu(), minlength=len(used))  # (M,)
        # Accuracy is the selected head's, as at test time.
        vectors.append(result.hypotheses.of_heads(result.hypotheses.logits.argmax(1)))
    model.train()
    scores = {"reconstruction": error / len(rows)} | accuracies(torch.cat(vectors), views.truth[rows])
    return scores | {"least_used": 100 * used.min().item() / len(rows), "focal": float(model.focal)}


def accuracies(vectors: Tensor, truth: Tensor, absolute: bool = False) -> dict[str, float]:
    """`validate`'s accuracy, folded and robust of view vectors (N, 3), aligned to annotations (N, 2) or `absolute`."""
    annotated = ~truth.isnan().any(1)  # (N,); NaN where a view has no label
    if not annotated.any():
        return dict.fromkeys(("accuracy", "folded", "robust"), math.nan)
    true = view_vector(*truth[annotated].double().unbind(1)).numpy()  # (N, 3)
    predicted = vectors.cpu().double()[annotated].numpy()  # (N, 3)
    kinds = (Identity, Identity) if absolute else (Procrustes, Robust)  # a learned frame is turned in any way
    errors, others = (geodesic_error(kind.fit(predicted, true).apply(predicted), true) for kind in kinds)  # (N,) each
    return {"accuracy": accuracy(errors, 30), "folded": accuracy(folded(errors), 30), "robust": accuracy(others, 30)}
