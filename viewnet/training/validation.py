"""What training measures on validation views: their reconstruction error, and the accuracy of their viewpoints."""

import math

import torch
from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.data.pairs import Views, resize
from viewnet.evaluation.alignment import fit_rotation
from viewnet.geometry import look_at, rotation_angle, view_vector
from viewnet.model.reconstruction import reconstruct
from viewnet.model.viewnet import ViewNet

VALIDATION_VIEWS = 320
"""At most so many target views, those of the first models: enough to rank epochs."""


@torch.no_grad()
def validate(
    model: ViewNet, views: Views, config: TrainConfig, device: torch.device, backgrounds: Tensor | None = None
) -> dict[str, float]:
    """Reconstruction error of the best head (label-free), and Acc@30 in per cent after Procrustes (uses labels).

    Accuracy is that of the views with an annotated viewpoint, NaN where there are none. Each view is reconstructed from
    the appearance of the next view of its object. With `backgrounds`, images (K, 3, 2S, 2S) uint8, views are before
    them as in training, the same each time.
    """
    model.eval()  # running statistics: a view's result depends on no other view
    rows = torch.arange(min(VALIDATION_VIEWS, len(views.objects)))
    appearance_rows = views.next_views(rows)  # equation 1 needs another view's appearance
    error, vectors = 0.0, []
    generator = torch.Generator().manual_seed(0)  # the same backgrounds each epoch: scores compare
    size, small = model.config.input_size, model.config.render_size
    for part in rows.split(64):  # in parts: less memory
        appearance, target = (views.images(each, size, device) for each in (appearance_rows[part], rows[part]))
        viewpoint_input, background = views.viewpoint_input(rows[part], size, device), None
        if backgrounds is not None:
            viewpoint_input = augment.photograph(viewpoint_input, backgrounds, config.photo, generator)
            background = augment.windows(backgrounds, len(part), size, generator, device)
        target = resize(target, small)
        result = reconstruct(model, appearance, target, viewpoint_input, config, background=background)
        error += result.choice.errors.amin(1).sum().item()  # the best of M, as training chooses
        # Accuracy is the selected head's, as at test time.
        vectors.append(result.hypotheses.of_heads(result.hypotheses.logits.argmax(1)))
    predicted = torch.cat(vectors).cpu().double()  # (N, 3)
    annotated = ~views.truth[rows].isnan().any(1)  # NaN where a view has no label
    accuracy = math.nan
    if annotated.any():
        predicted, truth = predicted[annotated], view_vector(*views.truth[rows][annotated].double().unbind(1))
        # The learned world frame is any rotation of the annotated one.
        aligned = predicted @ torch.as_tensor(fit_rotation(predicted.numpy(), truth.numpy())).T  # (N, 3)
        accuracy = 100 * (rotation_angle(look_at(aligned), look_at(truth)) < 30).double().mean().item()
    model.train()
    return {"reconstruction": error / len(rows), "accuracy": accuracy}
