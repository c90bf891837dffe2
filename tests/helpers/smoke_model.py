"""An untrained network of the profile smoke, and images and targets for it."""

from __future__ import annotations

import torch

from viewnet.config import TrainConfig
from viewnet.geometry import look_at, view_vector
from viewnet.model.reconstruction import Encoded
from viewnet.recipes import make_config

PLAIN = {"neighbours": 0.0, "search": 0.0, "amp": "off"}
SMOKE = make_config(profile="smoke", recipe="matting", **PLAIN)


def settings(**changes) -> TrainConfig:
    """Those of `SMOKE` with some changed, by name."""
    return make_config(profile="smoke", recipe="matting", **{**PLAIN, **changes}).train


def images(count: int, size: int = 32, seed: int = 0) -> torch.Tensor:
    """(count, 4, size, size): RGB times mask, and mask."""
    values = torch.rand(count, 4, size, size, generator=torch.Generator().manual_seed(seed))
    return torch.cat([values[:, :3] * values[:, 3:], values[:, 3:]], dim=1)


def known_targets(model):
    """Objects, azimuths and elevations (6,), and the objects' images from there (6, 4, S, S)."""
    torch.manual_seed(1)
    code = torch.randn(6, SMOKE.model.appearance_size)
    objects = Encoded(code, model.generate(code))
    azimuth, elevation = 60 * torch.arange(6.0), torch.full((6,), 10.0)
    return objects, azimuth, elevation, model.render(objects.volume, code, look_at(view_vector(azimuth, elevation)))
