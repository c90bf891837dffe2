"""A long body of one cross-section (bus, railway carriage) as one lofted skin with painted cells."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from viewnet.cad.builder import Array, Builder

# (row, x, share of the width reached, side, end): side is 1 for left and -1 for right, end "front", "rear" or "".
Painter = Callable[[int, float, float, int, str], str]


@dataclass(frozen=True)
class End:
    """How a body closes: shares of the width from the middle of its face to the full width, the distance behind the
    face at which each is reached, the share of the height there, and how far each row leans back."""

    width: Sequence[float]
    depth: Sequence[float]
    tall: Sequence[float]
    lean: Sequence[float]


def flat_end(rows: int, corner: float, lean: Sequence[float] | None = None) -> End:
    """A face with rounded corners of radius `corner`; `lean` (rows) is how far each row stands back."""
    width = (0.0, 0.35, 0.78, 0.93, 1.0)
    depth = (0.0, 0.02 * corner, 0.22 * corner, 0.5 * corner, corner)
    return End(width, depth, (1.0,) * 5, tuple(lean) if lean is not None else (0.0,) * rows)


def tube(
    builder: Builder,
    outline: Array,
    ends: tuple[float, float],
    faces: tuple[End, End],
    cuts: Sequence[float],
    painter: Painter,
    arches: Sequence[tuple[float, float]] = (),
    arch_top: float = 0.0,
) -> None:
    """Add a body whose half cross-section is `outline` (rows, 2): y and z from the floor up to the crown.

    `ends` are the x of the front and of the rear face; `cuts` the x of further sections, where colours change;
    `arches` the middle and half-width of wheel openings, which lift the first rows up to `arch_top`.
    """
    front, rear = ends
    head, tail = faces
    low, high = rear + tail.depth[-1] + 0.01, front - head.depth[-1] - 0.01
    steps = {
        x for middle, half in arches for x in (middle - half, middle - 0.7 * half, middle + 0.7 * half, middle + half)
    }
    inner: list[float] = []
    for cut in sorted({*cuts, *steps}, reverse=True):
        if low < cut < high and (not inner or inner[-1] - cut > 0.02):
            inner.append(cut)
    along = np.array([*(front - d for d in head.depth), *inner, *(rear + d for d in reversed(tail.depth))])
    width = np.array([*head.width, *[1.0] * len(inner), *reversed(tail.width)])
    tall = np.array([*head.tall, *[1.0] * len(inner), *reversed(tail.tall)])
    fade_head = 1 - np.array(head.depth) / max(head.depth[-1], 1e-9)
    fade_tail = 1 - np.array(tail.depth)[::-1] / max(tail.depth[-1], 1e-9)
    count, rows = len(along), len(outline)

    y = width[:, None] * outline[None, :, 0]
    base = outline[0, 1]
    z = base + tall[:, None] * (outline[None, :, 1] - base)
    for middle, half in arches:
        lift = np.where(np.abs(along - middle) < half - 1e-6, arch_top, base)
        # Corners of the opening are cut off, so that it looks round.
        lift = np.where(np.abs(along - middle) > 0.65 * half, np.minimum(lift, base + 0.72 * (arch_top - base)), lift)
        lift = np.where(np.abs(along - middle) > half - 1e-6, base, lift)
        z[:, 1:] = np.maximum(z[:, 1:], lift[:, None] + 0.01 * np.arange(rows - 1))
    x = np.repeat(along[:, None], rows, axis=1)
    x[: len(head.depth)] -= fade_head[:, None] * np.asarray(head.lean)[None, :]
    x[count - len(tail.depth) :] += fade_tail[:, None] * np.asarray(tail.lean)[None, :]
    left = np.stack([x, y, z], -1)
    grid = np.concatenate([left, left[:, ::-1] * np.array([1.0, -1.0, 1.0])], axis=1)

    strips = []
    for i in range(count - 1):
        end = "front" if i < len(head.depth) - 1 else "rear" if i >= count - len(tail.depth) else ""
        middle, share = float(along[i] + along[i + 1]) / 2, float(width[i] + width[i + 1]) / 2
        half_left = [painter(r, middle, share, 1, end) for r in range(rows - 1)]
        half_right = [painter(r, middle, share, -1, end) for r in range(rows - 1)]
        top = painter(rows - 1, middle, share, 1, end)
        strips.append([*half_left, top, *half_right[::-1], painter(0, middle, share, 1, "floor")])
    builder.loft(list(grid), strips, caps=False)


def window_row(start: float, end: float, count: int, gap: float) -> list[tuple[float, float]]:
    """`count` equal windows (low x, high x) between two places with `gap` between neighbours, front first."""
    pitch = (start - end + gap) / count
    return [(start - k * pitch - (pitch - gap), start - k * pitch) for k in range(count)]


def edges(windows: Sequence[tuple[float, float]]) -> list[float]:
    """All borders of windows."""
    return [x for window in windows for x in window]
