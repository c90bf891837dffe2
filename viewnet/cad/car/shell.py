"""The body of a car as one lofted skin: windows, lights and grille are its cells, so no surfaces coincide."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from viewnet.cad.builder import Array, Builder

# Points of half a cross-section, from the floor up. Cell r lies between rows r and r + 1.
FLOOR, WELL, SILL, LOW, MID, HIGH, BELT, RAIL, EDGE, TOP = range(10)
HALF = 10
# Where rows SILL to BELT lie between the lower edge of the body and the belt line.
_LEVELS = np.array([0.0, 0.30, 0.60, 0.88, 1.0])


@dataclass(frozen=True)
class Shape:
    """A car body. Lengths in metres; positions along the car are distances behind the foremost point."""

    length: float
    width: float
    height: float
    clearance: float
    wheel: float  # radius
    tread: float  # tyre width
    axles: tuple[float, float]
    nose_z: float
    cowl: float
    cowl_z: float
    screen: float  # where the windscreen meets the roof
    roof_end: float
    roof_end_z: float
    back: float  # where the rear window ends
    deck_z: float
    tail_z: float
    belt: tuple[float, float]  # height of the belt line at the cowl and at the rear window
    roof_width: float  # share of the body's width
    nose_depth: float  # length over which the front rounds off in plan
    tail_depth: float
    nose_rake: float
    tail_rake: float
    crown: float  # how much the roof and the bonnet bulge
    flare: float
    windows: tuple[tuple[float, float], ...]  # side windows: start and end
    trough: tuple[float, float, float] | None = None  # open bed or cockpit: start, end, height of its floor
    coarse: bool = False
    stripe: float = 0.45  # half-width of the middle band of bonnet and roof, share of the width
    bumper: float = 0.0  # how far the bumper stands out
    bonnet: tuple[float, float] = (0.3, 0.75)  # its rise at an eighth and at half of its length, shares of the whole
    taper: float = 0.05  # how much narrower the ends are than the middle, share of the width
    plan: tuple[float, ...] = field(default=(0.0, 0.42, 0.74, 0.91, 1.0))


Painter = Callable[[int, float, float, str], str]


def body(builder: Builder, shape: Shape, painter: Painter) -> None:
    """Add the body.

    `painter(row, x, across, end)` names the material of a cell: its row, the distance of its middle behind the front,
    the share of the width reached there (below 1 where the ends round off) and its end ("front", "rear" or "").
    """
    along, across, weight = _stations(shape)
    grid = _sections(shape, along, across, weight)
    middle, spread = (along[1:] + along[:-1]) / 2, (across[1:] + across[:-1]) / 2
    blunt = len(shape.plan)
    strips = []
    for i in range(len(along) - 1):
        end = "front" if i < blunt - 1 else "rear" if i >= len(along) - blunt else ""
        half = [painter(row, float(middle[i]), float(spread[i]), end) for row in range(HALF)]
        strips.append([*half, *half[:-1][::-1], painter(-1, float(middle[i]), float(spread[i]), end)])
    builder.loft(list(grid), strips, caps=False)


def _stations(shape: Shape) -> tuple[Array, Array, Array]:
    """Positions behind the front, shares of the width, and how much of each end's rake applies."""
    plan = np.array(shape.plan)
    # A quarter of a rounded rectangle: the corner turns late, as on real bumpers.
    depth = 1 - np.sqrt(np.clip(1 - np.clip((plan - 0.42) / 0.58, 0, 1) ** 2, 0, 1))
    front, rear = depth * shape.nose_depth, shape.length - depth[::-1] * shape.tail_depth
    inner = {shape.cowl, shape.screen, (shape.screen + shape.roof_end) / 2, shape.roof_end, shape.back}
    inner |= {0.55 * shape.cowl, (shape.back + shape.length) / 2}
    inner |= {edge for window in shape.windows for edge in window}
    if shape.trough:
        inner |= {shape.trough[0], shape.trough[0] + 0.04, shape.trough[1] - 0.04, shape.trough[1]}
    reach = _arch_radius(shape)
    angles = np.deg2rad([0, 45, 90, 135, 180] if shape.coarse else [0, 26, 64, 116, 154, 180])
    for axle in shape.axles:
        inner |= set((axle - reach * np.cos(angles)).tolist())
    low, high = front[-1] + 0.02, rear[0] - 0.02
    kept: list[float] = []
    for x in sorted(inner):
        if low < x < high and (not kept or x - kept[-1] > 0.015):
            kept.append(x)
    along = np.concatenate([front, kept, rear])
    across = np.concatenate([plan, np.ones(len(kept)), plan[::-1]])
    weight = np.concatenate([1 - depth, np.zeros(len(kept)), -(1 - depth)[::-1]])
    return along, across, weight


def _arch_radius(shape: Shape) -> float:
    return shape.wheel * 1.16 + 0.015


def _sections(shape: Shape, along: Array, across: Array, weight: Array) -> Array:
    """Closed rings (stations, 2 HALF, 3)."""
    s = shape
    top_x = [
        0,
        0.12 * s.cowl,
        0.55 * s.cowl,
        s.cowl,
        s.screen,
        (s.screen + s.roof_end) / 2,
        s.roof_end,
        s.back,
        s.length,
    ]
    hood = s.cowl_z - s.nose_z
    top_z = [
        s.nose_z,
        s.nose_z + s.bonnet[0] * hood,
        s.nose_z + s.bonnet[1] * hood + 0.4 * s.crown,
        s.cowl_z,
        s.height - s.crown,
        s.height,
        s.roof_end_z,
        s.deck_z,
        s.tail_z,
    ]
    top = np.interp(along, top_x, top_z)
    belt = np.interp(along, [0, s.cowl, s.back, s.length], [s.nose_z, s.belt[0], s.belt[1], s.tail_z])
    edge = np.minimum(belt, top - 0.03)
    cabin = np.clip((top - belt) / max(s.height - s.belt[0], 1e-3), 0, 1)
    sill = np.interp(along, [0, s.axles[0], s.axles[1], s.length], s.clearance + np.array([0.05, 0, 0, 0.08]))
    arch = sill.copy()
    bulge = np.zeros_like(along)
    reach = _arch_radius(s)
    for axle in s.axles:
        distance = np.clip(np.abs(along - axle) / reach, 0, 1)
        arch = np.maximum(arch, np.where(distance < 1, s.wheel + reach * np.sqrt(1 - distance**2), 0))
        bulge = np.maximum(bulge, np.clip(1.35 - np.abs(along - axle) / reach, 0, 0.35) / 0.35)
    arch = np.minimum(arch, edge - 0.06)

    half = s.width / 2 * across * (1 - s.taper * np.abs(2 * along / s.length - 1) ** 4)
    y = np.zeros((len(along), HALF))
    z = np.zeros((len(along), HALF))
    inner = half - s.tread - 0.06 * across
    y[:, FLOOR], z[:, FLOOR] = inner, sill
    y[:, WELL], z[:, WELL] = inner, arch
    y[:, SILL : BELT + 1] = half[:, None] * np.array([0.97, 1.0, 0.995, 0.975, 0.93])
    y[:, SILL : MID + 1] += (s.flare * bulge)[:, None] * np.array([1.0, 0.9, 0.5])
    z[:, SILL : BELT + 1] = arch[:, None] + (edge - arch)[:, None] * _LEVELS
    y[:, EDGE] = half * (0.84 + (s.roof_width - 0.84) * cabin)
    z[:, EDGE] = top - np.minimum(0.45 * (top - edge), 0.02 + s.crown * 0.8)
    share = 0.30 + 0.55 * cabin
    y[:, RAIL] = y[:, BELT] + (y[:, EDGE] - y[:, BELT]) * share
    z[:, RAIL] = z[:, BELT] + (z[:, EDGE] - z[:, BELT]) * share
    y[:, TOP] = half * s.stripe * (1 + (s.roof_width - 1) * cabin)
    z[:, TOP] = top
    if s.trough:
        inside = (along > s.trough[0] + 0.02) & (along < s.trough[1] - 0.02)
        y[inside, EDGE] = half[inside] * 0.90
        y[inside, RAIL] = half[inside] * 0.92
        z[inside, EDGE] = z[inside, RAIL]
        y[inside, TOP] = half[inside] * 0.86
        z[inside, TOP] = s.trough[2]

    x = np.repeat(s.length / 2 - along[:, None], HALF, axis=1)
    height = np.clip((z - s.clearance) / max(s.nose_z - s.clearance, 1e-3), 0, 1)
    x -= np.clip(weight, 0, 1)[:, None] * (s.nose_rake * height**2 + s.bumper * (height > 0.45))
    height = np.clip((z - s.clearance) / max(s.tail_z - s.clearance, 1e-3), 0, 1)
    x += np.clip(-weight, 0, 1)[:, None] * (s.tail_rake * height**2 + s.bumper * (height > 0.45))
    left = np.stack([x, y, z], -1)
    right = left[:, ::-1] * np.array([1.0, -1.0, 1.0])
    return np.concatenate([left, right], axis=1)
