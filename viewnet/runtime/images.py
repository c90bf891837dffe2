"""Images as tensors: RGB times alpha, and alpha, (N, 4, H, W) in [0, 1]: over backgrounds, resized, cropped."""

import torch
import torch.nn.functional as F
from torch import Tensor

CROP_MARGIN = 0.05  # where views are cropped to their object: the margin all around, as a share of its side


def composite(images: Tensor, background: Tensor | float) -> Tensor:
    """Images (N, 4, H, W) over backgrounds (N, 3, H, W), colours (N, 3, 1, 1) or a grey level: (N, 3, H, W)."""
    return images[:, :3] + background * (1 - images[:, 3:])  # (N, 3, H, W)


def resize(images: Tensor, size: int) -> Tensor:
    """Images (N, C, H, H) at another size, by averaging areas; themselves where they have it."""
    while images.shape[-1] >= 2 * size and images.shape[-1] % (2 * size) == 0:  # pairs: several times as fast
        rows = images[..., ::2, :] + images[..., 1::2, :]  # (N, C, H / 2, H)
        images = (rows[..., ::2] + rows[..., 1::2]) / 4  # (N, C, H / 2, H / 2)
    return images if images.shape[-1] == size else F.interpolate(images, (size, size), mode="area")


def tight_crop(images: Tensor, size: int, stretch: bool = False, margin: float = CROP_MARGIN) -> Tensor:
    """Images (N, 4, H, H), RGB times alpha and alpha in [0, 1], cropped to their alpha's box: (N, 4, size, size).

    The box is a square around the longer side, centred, so that things keep their shape; with `stretch` it is their
    own, and what is in it is stretched. It has a `margin` of its sides all around; what it needs beyond the image is
    empty. An image without an object, or without anything else, is left whole.
    """
    full = images.shape[-1]
    covered = images[:, 3] > 0.5
    edges = torch.arange(full, device=images.device)  # (H,)
    low, high = [], []
    for axis in (2, 1):  # columns, then rows
        occupied = covered.any(3 - axis)  # (N, H)
        low.append(torch.where(occupied, edges, full).amin(1))  # (N,)
        high.append(torch.where(occupied, edges + 1, 0).amax(1))  # (N,), one past the last
    start, end = torch.stack(low, 1).float(), torch.stack(high, 1).float()  # (N, 2): x, y
    empty = ~covered.flatten(1).any(1)  # (N,)
    start, end = start.masked_fill(empty[:, None], 0), end.masked_fill(empty[:, None], full)  # (N, 2)
    margins = torch.where(empty | covered.flatten(1).all(1), 0.0, margin)  # (N,)
    sides = end - start if stretch else (end - start).amax(1, keepdim=True).expand(-1, 2)  # (N, 2)
    half = sides / 2 * (1 + 2 * margins[:, None])  # (N, 2), pixels
    centre = (start + end) / 2
    matrix = torch.diag_embed(half / (full / 2))  # (N, 2, 2); grids run over [-1, 1]
    shift = (centre / (full / 2) - 1)[:, :, None]  # (N, 2, 1)
    # More samples than pixels, averaged: an enlarged crop stays smooth and a whole image is not aliased.
    fine = size * max(1, -(-full // size))  # `full` / `size` rounded up, times `size`
    grid = F.affine_grid(torch.cat([matrix, shift], 2), [len(images), 4, fine, fine], align_corners=False)  # (N, 2, 3)
    return resize(F.grid_sample(images, grid, align_corners=False), size)
