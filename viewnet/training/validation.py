"""What training measures on validation views: their reconstruction error, and the accuracy of their viewpoints."""

import math

import numpy as np
import torch
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.data.pairs import Views
from viewnet.evaluation.alignment import Procrustes, Robust
from viewnet.geometry import look_at, rotation_angle, view_vector
from viewnet.model.reconstruction import reconstruct
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.images import resize

VALIDATION_VIEWS = 320
"""At most so many target views, those of the first models: enough to rank epochs."""


@torch.no_grad()
def validate(
    model: ViewNet, views: Views, config: TrainConfig, device: torch.device, backgrounds: Tensor | None = None
) -> dict[str, float]:
    """Scores of up to VALIDATION_VIEWS views, each reconstructed from the appearance of the next view of its object.

    reconstruction   error of the best head: no labels
    accuracy         Acc@30 in per cent of the selected head after Procrustes; NaN without an annotated viewpoint
    folded           the same with opposite sides taken for one (viewnet.evaluation.metrics.folded)
    robust           accuracy after the robust alignment instead, which two modes do not upset
    least_used       per cent of views that the head which is best least often reconstructs best
    focal            the camera's focal length, learned or not

    With `backgrounds`, images (K, 3, 2S, 2S) uint8, views are before them as in training, the same each time.
    """
    model.eval()  # running statistics: a view's result depends on no other view
    rows = torch.arange(min(VALIDATION_VIEWS, len(views.objects)))
    appearance_rows = views.next_views(rows)  # equation 1 needs another view's appearance
    error, vectors, used = 0.0, [], torch.zeros(model.config.heads)
    generator = torch.Generator().manual_seed(0)  # the same backgrounds each epoch: scores compare
    size, small = model.config.input_size, model.config.render_size
    for part in rows.split(64):  # in parts: less memory
        appearance, target = (views.images(each, size, device) for each in (appearance_rows[part], rows[part]))
        viewpoint_input = views.viewpoint_input(rows[part], size, device)
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
    predicted = torch.cat(vectors).cpu().double()  # (N, 3)
    annotated = ~views.truth[rows].isnan().any(1)  # NaN where a view has no label
    accuracy = folded = robust = math.nan
    if annotated.any():
        predicted, truth = predicted[annotated], view_vector(*views.truth[rows][annotated].double().unbind(1))
        # The learned world frame is any rotation of the annotated one.
        fits = (kind.fit(predicted.numpy(), truth.numpy()) for kind in (Procrustes, Robust))
        aligned = (torch.as_tensor(fit.apply(predicted.numpy())) for fit in fits)  # (N, 3) each
        errors, others = (rotation_angle(look_at(each), look_at(truth)).numpy() for each in aligned)  # (N,) each
        folds = np.minimum(errors, 180 - errors)
        accuracy, folded, robust = (100 * float((each < 30).mean()) for each in (errors, folds, others))
    model.train()
    scores = {"reconstruction": error / len(rows), "accuracy": accuracy, "folded": folded, "robust": robust}
    return scores | {"least_used": 100 * used.min().item() / len(rows), "focal": float(model.focal)}
