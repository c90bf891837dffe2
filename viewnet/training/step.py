"""One training step: the paper's terms of the loss and those that our recipe adds, summed up."""

from torch import Tensor

from viewnet.config import TrainConfig
from viewnet.data import augment
from viewnet.model.losses import PerceptualLoss
from viewnet.model.reconstruction import reconstruct
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.images import resize
from viewnet.runtime.random import RandomSource, repeated
from viewnet.training import matting, paper


def step_loss(
    model: ViewNet,
    batch: tuple[Tensor, Tensor, Tensor],
    config: TrainConfig,
    perceptual: PerceptualLoss | None,
    progress: float,
    generator: RandomSource,
    backgrounds: Tensor | None = None,
) -> dict[str, Tensor]:
    """The weighted terms of one step's loss, whose sum is minimised. `progress` is the share of training done.

    `batch` is appearance images (B, 4, S, S), targets (N, 4, S, S) and these as the viewpoint network sees them
    (N, 4, S, S), N a multiple of B. `backgrounds`, images (K, 3, 2S, 2S) uint8, are put behind both networks' inputs,
    or the viewpoint network's alone (`cut_out`), never behind the target.
    """
    appearance, target, viewpoint_input = batch
    target = resize(target, model.config.render_size)  # (N, 4, S, S), S = render_size
    if config.augment:
        viewpoint_input = augment.crop_and_rotate(viewpoint_input, generator)  # as in the released code
    if backgrounds is not None:
        times = config.photo.views_per_target
        viewpoint_input = viewpoint_input.repeat(times, 1, 1, 1)  # (K N, 4, S, S)
        viewpoint_input = augment.photograph(viewpoint_input, backgrounds, config.photo, repeated(generator, times))
        appearance = augment.appearance(appearance, backgrounds, config.photo, generator)  # (B, 4, S, S)
    choose = matting.pose_search(config, progress, generator)  # without a search: the best head, as in the paper
    result = reconstruct(model, appearance, target, viewpoint_input, config, choose)
    return paper.terms(model, result, config, perceptual, generator, backgrounds) | matting.terms(result, config)
