"""Office, moulded, cantilever, folding and stacking chairs. Units: metres."""

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair.frames import LegLine, cross_bar, four_legs, leg, pedestal_base, seat_grid, star_base
from viewnet.cad.finishes import Finish, Finishes
from viewnet.cad.parts import BackSurface, bar, block, choose, patch, pillow, rail, shell, sweep


def _pad(
    builder: Builder,
    surface: BackSurface,
    low: float,
    high: float,
    thick: float,
    finish: Finish,
    roundness: float,
    back: Finish | None = None,
    waist: float = 0.0,
    segments: int = 0,
) -> None:
    """A stuffed back between the heights low and high (shares of the surface's height), rounded, narrower below."""
    rows = 5 + 2 * segments
    flat = patch(rows, 7, roundness)
    t = (flat[..., 0] + 1) / 2
    u = flat[..., 1] * (1 - waist * (1 - t))
    full = pillow(rows, 7, thick, 0.45)
    if segments:
        full = full * np.where(np.arange(rows) % 2 == 0, 0.7, 1.15)[:, None]
    shell(builder, surface.at(u, low + (high - low) * t)[::-1], full, finish, back)


def office(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A swivel chair on a five-star base with castors; task, executive, mesh or operator's back; arms or none."""
    dark = fin.dark()
    metal = fin.metal() if rng.random() < 0.45 else dark
    style = choose(rng, {"task": 0.45, "executive": 0.25, "mesh": 0.2, "operator": 0.1})
    cover = fin.leather() if style == "executive" and rng.random() < 0.75 else fin.fabric(0.08)
    if rng.random() < 0.35:
        cover = fin.solid((0.1, 0.1, 0.11))
    width, depth = float(rng.uniform(0.44, 0.54)), float(rng.uniform(0.42, 0.5))
    top = float(rng.uniform(0.42, 0.54))
    thick = float(rng.uniform(0.055, 0.09)) * (1.3 if style == "executive" else 1)
    star_base(
        builder, rng, top - thick / 2, float(rng.uniform(0.27, 0.34)), metal, dark, 5 if rng.random() < 0.93 else 4
    )
    rounded = float(rng.uniform(0.1, 0.55))
    grid = seat_grid(width, depth, top, 0.05, rounded, front_drop=0.025)
    shell(builder, grid, pillow(5, 7, thick, 0.6), cover, dark if rng.random() < 0.6 else None)
    block(builder, (-0.02, 0, top - thick / 2 - 0.015), (0.2, 0.16, 0.04), dark)
    tall = {"task": rng.uniform(0.42, 0.6), "executive": rng.uniform(0.6, 0.78), "mesh": rng.uniform(0.5, 0.65)}.get(
        style, rng.uniform(0.32, 0.42)
    )
    half = width / 2 * float(rng.uniform(0.8, 1.02))
    surface = BackSurface(
        -depth / 2 - 0.01,
        top,
        float(tall),
        half,
        half,
        float(tall) * float(rng.uniform(0.05, 0.2)),
        dish=float(rng.uniform(0.02, 0.06)),
    )
    low = {"executive": 0.0, "operator": 0.35}.get(style, float(rng.uniform(0.12, 0.3)))
    back_thick = float(rng.uniform(0.035, 0.06)) * (1.5 if style == "executive" else 1)
    shape = float(rng.choice([rng.uniform(0.1, 0.4), rng.uniform(0.5, 1.0)]))
    if style == "mesh":
        _pad(builder, surface, low, 1.0, 0.012, cover, shape * 0.5)
        outline = patch(9, 9, shape * 0.5)
        rim = np.concatenate([outline[0], outline[1:, -1], outline[-1, -2::-1], outline[-2::-1, 0]])[::2]
        points = surface.at(rim[:, 1], low + (1 - low) * (rim[:, 0] + 1) / 2)
        sweep(builder, points, 0.013, dark, "coarse", side=(1, 0, 0))
    else:
        segments = int(rng.integers(1, 4)) if style == "executive" and rng.random() < 0.7 else 0
        hard = dark if style != "executive" and rng.random() < 0.55 else None
        _pad(builder, surface, low, 1.0, back_thick, cover, shape, hard, float(rng.uniform(0, 0.2)), segments)
    if style in ("mesh", "executive") and rng.random() < 0.35:
        head = BackSurface(
            float(surface.at(0, 1)[0]), top + tall + 0.02, 0.16, half * 0.6, half * 0.6, -0.01, dish=0.02
        )
        _pad(builder, head, 0.0, 1.0, 0.05, cover, 0.3)
        bar(builder, surface.at(0, 0.9), head.at(0, 0.3), 0.015, dark)
    # The stem that carries the back is visible from behind and from the side.
    behind = surface.at(0, 0.55) - np.array([back_thick * 0.7, 0, 0])
    stem = np.stack([[-0.08, 0, top - thick / 2 - 0.02], [-depth / 2 - 0.07, 0, top - thick / 2], behind])
    if style != "executive":
        sweep(builder, stem, (float(rng.uniform(0.02, 0.045)), 0.012), dark)
    arms = choose(rng, {"none": 0.25, "tee": 0.4, "loop": 0.35})
    reach, high = width / 2 + float(rng.uniform(0.02, 0.05)), top + float(rng.uniform(0.18, 0.25))
    pad = cover if style == "executive" and rng.random() < 0.4 else dark
    if arms == "tee":
        path = [[-0.02, width / 2 - 0.08, top - thick / 2], [-0.02, reach, top - thick / 3], [-0.03, reach, high]]
        sweep(builder, path, (0.022, 0.012), metal if rng.random() < 0.4 else dark, side=(1, 0, 0), mirror=True)
        length = float(rng.uniform(0.1, 0.14))
        ends = [[-length - 0.03, reach, high + 0.01], [length, reach, high + 0.015]]
        sweep(builder, ends, (0.038, 0.014), pad, "soft", mirror=True)
    elif arms == "loop":
        angle = np.linspace(-0.15 * np.pi, 1.1 * np.pi, 9)
        loop = np.stack([0.16 * np.cos(angle) * 1.1 - 0.04, np.full(9, reach), high - 0.14 + 0.14 * np.sin(angle)], 1)
        loop = np.concatenate([[[0.06, width / 2 - 0.05, top - thick / 2]], loop])
        loop[-1] = [-depth / 2, half * 0.9, top + 0.12]
        sweep(builder, loop, (0.024, 0.014), dark if pad is dark else pad, "soft", mirror=True)


def _bucket(
    rng: np.random.Generator, width: float, depth: float, top: float, tall: float, arms: float, lean: float
) -> np.ndarray:
    """The surface (9, 9, 3) of a one-piece seat and back, from the back's top (first row) to the front lip."""
    s = np.linspace(0, 1, 9)
    bend = float(rng.uniform(0.015, 0.04))
    # (x, z) of the middle line: back, bend, seat, lip.
    line = np.array(
        [
            (-depth / 2 - lean, top + tall),
            (-depth / 2 - lean * 0.75, top + tall * 0.72),
            (-depth / 2 - lean * 0.45, top + tall * 0.42),
            (-depth / 2 - lean * 0.1, top + tall * 0.16),
            (-depth / 2 + 0.06, top - bend * 0.5),
            (-depth / 2 + 0.17, top - bend),
            (0.02, top - bend),
            (depth / 2 - 0.07, top - 0.005),
            (depth / 2, top - 0.03),
        ]
    )
    normal_x = np.array([1, 1, 1, 0.9, 0.6, 0.2, 0, 0, 0.1])
    normal_z = np.array([0.1, 0.1, 0.15, 0.4, 0.8, 1, 1, 1, 1])
    crown = float(rng.uniform(0.55, 1.0))
    half = width / 2 * np.interp(s, [0, 0.15, 0.45, 0.85, 1], [crown, 0.98, 0.95, 1.0, float(rng.uniform(0.8, 1.0))])
    lift = np.array([0.04, 0.05, 0.06, 0.07, 0.06, 0.04, 0.03, 0.02, 0.0]) * float(rng.uniform(0.5, 1.3))
    if arms:
        lift = lift + arms * np.array([0, 0.1, 0.45, 0.8, 1, 1, 0.85, 0.3, 0.0])
    v = np.linspace(-1, 1, 9)
    power = 4 if arms else 2
    raised = lift[:, None] * np.abs(v)[None, :] ** power
    rounded = float(rng.uniform(0, 0.05)) * np.abs(v) ** 3
    x = line[:, :1] + normal_x[:, None] * raised * (1.0 if not arms else 0.45)
    z = line[:, 1:] + normal_z[:, None] * raised
    z[0] -= rounded * 2
    x[-1] -= rounded
    y = half[:, None] * np.sign(v) * np.abs(v) ** (0.75 if arms else 1.0)
    return np.stack([x, np.broadcast_to(y, x.shape), z], axis=-1)


def moulded(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A one-piece plastic, plywood or upholstered shell on dowel, tube, wire, tulip, star, sled or square legs."""
    material = choose(rng, {"plastic": 0.6, "wood": 0.18, "fabric": 0.22})
    body = fin.plastic() if material == "plastic" else fin.wood(0)[1] if material == "wood" else fin.upholstery()
    bar_height = rng.random() < 0.12
    top = float(rng.uniform(0.62, 0.78)) if bar_height else float(rng.uniform(0.41, 0.47))
    width, depth = float(rng.uniform(0.42, 0.52)), float(rng.uniform(0.4, 0.46))
    tall = float(rng.uniform(0.3, 0.46)) * (0.6 if bar_height and rng.random() < 0.6 else 1)
    arms = float(rng.uniform(0.14, 0.24)) if rng.random() < 0.38 and material != "wood" else 0.0
    if arms:
        width *= 1.2
    grid = _bucket(rng, width, depth, top, tall, arms, float(rng.uniform(0.05, 0.16)))
    thick = 0.035 if material == "fabric" else 0.012
    shell(builder, grid, thick, body, fin.plastic() if rng.random() < 0.08 else None)
    if rng.random() < 0.25 and material != "wood":
        pad = seat_grid(width * 0.72, depth * 0.8, top - 0.005, 0.05, 0.35)
        shell(builder, pad + np.array([0.01, 0, 0]), pillow(5, 7, 0.035, 0.5), fin.upholstery())
    base = choose(
        rng,
        {"dowel": 0.3, "tubes": 0.2, "wire": 0.1, "tulip": 0.1, "star": 0.12, "sled": 0.08, "square": 0.1}
        if not bar_height
        else {"dowel": 0.4, "tubes": 0.3, "tulip": 0.3},
    )
    under = top - 0.03
    if base in ("dowel", "tubes", "square"):
        finish = fin.wood(0.1)[0] if base == "dowel" else fin.metal() if base == "tubes" or rng.random() < 0.4 else body
        style = {"dowel": "dowel", "tubes": "metal", "square": "tapered"}[base]
        half = 0.018 if base != "tubes" else 0.017
        splay = float(rng.uniform(0.02, 0.1)) if base != "square" else 0.0
        lines = four_legs(builder, rng, style, width * 0.72, depth * 0.8, under + 0.02, half, finish, splay)
        if bar_height or (base == "dowel" and rng.random() < 0.4):
            z = top * 0.35
            bar(builder, lines[0].at(z), lines[1].at(z), 0.008, finish, "coarse", mirror=True)
            for line in lines:
                cross_bar(builder, float(line.at(z)[0]), z, float(line.at(z)[1]), (0.008, 0.008), finish, "coarse")
    elif base == "wire":
        feet = fin.metal()
        front, rear = four_legs(builder, rng, "metal", width * 0.5, depth * 0.6, under, 0.014, feet, 0.12)
        for high, low in ((front, rear), (rear, front)):
            bar(builder, high.at(top * 0.9), low.at(top * 0.35) * (1, 0.8, 1), 0.006, feet, "coarse", mirror=True)
    elif base == "tulip":
        pedestal_base(builder, under, float(rng.uniform(0.2, 0.28)), fin.metal() if rng.random() < 0.5 else body)
    elif base == "star":
        rolling = rng.random() < 0.5
        star_base(builder, rng, under, 0.28, fin.metal(), fin.dark(), 5 if rolling else 4, rolling)
    else:
        feet = fin.metal()
        x, y = depth / 2 - 0.03, width * 0.42
        loop = [[x * 0.6, y * 0.8, under], [x, y, 0.012], [-x * 1.15, y, 0.012], [-x * 0.7, y * 0.8, under]]
        sweep(builder, loop, 0.01, feet, "coarse", mirror=True)


def cantilever(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A bent tube without rear legs: runners on the floor, uprights in front; seat and back hang in it."""
    tube = fin.metal()
    cover = fin.cane() if rng.random() < 0.2 else fin.upholstery()
    trim = fin.wood(0)[0]
    width, depth, top = float(rng.uniform(0.44, 0.56)), float(rng.uniform(0.42, 0.5)), float(rng.uniform(0.41, 0.47))
    tall, lean = float(rng.uniform(0.36, 0.55)), float(rng.uniform(0.04, 0.14))
    radius = float(rng.uniform(0.011, 0.016))
    section = "coarse" if rng.random() < 0.75 else "square"
    y = width / 2
    x = depth / 2
    armed = rng.random() < 0.5
    if armed:
        high = top + float(rng.uniform(0.17, 0.24))
        path = [
            [-x * 0.9, y, radius],
            [x - 0.04, y, radius],
            [x, y, 0.05],
            [x - 0.02, y, high - 0.05],
            [x - 0.07, y, high],
            [-x - lean * 0.5, y, high],
        ]
        sweep(builder, path, radius, tube, section, mirror=True)
        if rng.random() < 0.6:
            ends = [[x - 0.09, y, high + 0.015], [-x * 0.3, y, high + 0.015]]
            sweep(builder, ends, (0.022, 0.013), trim if rng.random() < 0.4 else fin.dark(), "soft", mirror=True)
        bar(builder, (x - 0.03, y, top - 0.02), (-x, y, top - 0.02), radius, tube, section, mirror=True)
        cross_bar(builder, x - 0.02, top - 0.03, y, (radius, radius), tube, section)
    else:
        path = [
            [-x * 0.9, y, radius],
            [x - 0.03, y, radius],
            [x + 0.02, y, 0.06],
            [x, y, top - 0.08],
            [x - 0.05, y, top - 0.02],
            [-x + 0.03, y, top - 0.02],
            [-x - 0.02, y, top + 0.06],
        ]
        sweep(builder, path, radius, tube, section, mirror=True)
    bar(builder, (-x, y, top + 0.03), (-x - lean, y, top + tall * 0.9), radius, tube, section, mirror=True)
    cross_bar(builder, -x * 0.9, radius, y, (radius, radius), tube, section)
    thick = float(rng.uniform(0.03, 0.08))
    inner = width - 2 * radius
    shell(
        builder,
        seat_grid(inner, depth * 0.98, top + thick * 0.2, 0, 0.1, front_drop=0.015),
        pillow(5, 7, thick, 0.6),
        cover,
    )
    surface = BackSurface(-x - 0.005, top, tall, inner / 2, inner / 2, lean, dish=float(rng.uniform(0, 0.04)))
    low = float(rng.choice([0.08, rng.uniform(0.25, 0.5)]))
    _pad(builder, surface, low, 1.0, float(rng.uniform(0.02, 0.06)), cover, float(rng.uniform(0, 0.25)))


def folding(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A folding chair: crossed legs at the sides; metal with pads, or wooden or bistro with slats."""
    style = choose(rng, {"steel": 0.4, "wood": 0.35, "bistro": 0.25})
    frame = fin.wood(0.15)[0] if style == "wood" else fin.metal()
    surface_finish = frame if style == "wood" else fin.plastic() if rng.random() < 0.5 else fin.wood(0.3)[0]
    if style == "steel":
        surface_finish = _steel_cover(rng, fin, frame)
    width, depth, top = float(rng.uniform(0.4, 0.48)), float(rng.uniform(0.34, 0.42)), float(rng.uniform(0.42, 0.47))
    tall, x = float(rng.uniform(0.33, 0.44)), depth / 2
    half = (0.011, 0.016) if style == "wood" else (0.01, 0.01)
    section = "square" if style == "wood" else "coarse"
    y = width / 2
    lean = float(rng.uniform(0.04, 0.12))
    # The long leg runs from the front foot up to the back's top; the short one from the rear foot to the seat's front.
    foot_front, foot_rear = x + float(rng.uniform(0.03, 0.1)), -x - float(rng.uniform(0.06, 0.12))
    path = [[foot_front, y, 0], [-x + 0.02, y, top + 0.04], [-x - lean, y, top + tall]]
    sweep(builder, path, half, frame, section, mirror=True)
    bar(builder, (foot_rear, y - 0.03, 0), (x - 0.04, y - 0.03, top - 0.015), half, frame, section, mirror=True)
    for share, offset in ((0.18, 0.0), (0.2, 0.03)):
        start = np.array(path[0]) if not offset else np.array([foot_rear, 0, 0])
        end = np.array(path[1]) if not offset else np.array([x - 0.04, 0, top])
        spot = start + share * (end - start)
        cross_bar(builder, float(spot[0]), float(spot[2]), y - offset, (half[0], half[0]), frame, section)
    surface = BackSurface(-x + 0.02, top + 0.04, tall - 0.04, y, y, lean + 0.02, dish=float(rng.choice([0.0, 0.03])))
    if style == "steel":
        grid = seat_grid(width - 0.07, depth, top, 0.08, 0.3, front_drop=0.015)
        shell(builder, grid, pillow(5, 7, float(rng.choice([0.018, 0.045])), 0.6), surface_finish)
        _pad(builder, surface, float(rng.uniform(0.35, 0.55)), 0.97, 0.018, surface_finish, 0.1)
        if rng.random() < 0.5:
            rail(builder, surface, 1.0, (0.01, 0.01), frame, arch=0.08, section="coarse")
    else:
        count = int(rng.integers(4, 8))
        spots = np.linspace(-x, x + 0.02, count)
        for spot in spots:
            block(builder, (spot, 0, top), ((depth / count) * 0.68, width - 0.05, 0.016), surface_finish)
        rails = int(rng.integers(1, 4))
        high = float(rng.uniform(0.028, 0.05)) * (1.6 if rails == 1 else 1)
        for t in np.linspace(0.93, 0.45 if rails > 1 else 0.93, rails):
            rail(builder, surface, float(t), (high, 0.009), surface_finish)


def _steel_cover(rng: np.random.Generator, fin: Finishes, frame: Finish) -> Finish:
    """What covers a steel chair: its own paint, plastic or upholstery."""
    pick = choose(rng, {"frame": 0.35, "plastic": 0.3, "cloth": 0.35})
    return frame if pick == "frame" else fin.plastic() if pick == "plastic" else fin.upholstery()


def stacking(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A school, office or café chair: tube frame, separate seat and back of plywood, plastic or cloth."""
    tube = fin.metal()
    material = choose(rng, {"wood": 0.35, "plastic": 0.35, "cloth": 0.3})
    cover = fin.wood(0)[1] if material == "wood" else fin.plastic() if material == "plastic" else fin.upholstery()
    stuffed = material == "cloth"
    width, depth, top = float(rng.uniform(0.4, 0.5)), float(rng.uniform(0.38, 0.46)), float(rng.uniform(0.42, 0.47))
    tall, lean = float(rng.uniform(0.33, 0.45)), float(rng.uniform(0.04, 0.14))
    half = float(rng.uniform(0.009, 0.014))
    section = "coarse" if rng.random() < 0.7 else "square"
    x, y = depth / 2, width / 2 - 0.02
    splay = float(rng.uniform(0, 0.06))
    if rng.random() < 0.75:
        rear = [[-x - splay, y, 0], [-x + 0.01, y, top], [-x - lean, y, top + tall * 0.95]]
        sweep(builder, rear, half, tube, section, mirror=True)
        front = LegLine(np.array([x - 0.03, y, top]), np.array([x - 0.02 + splay * 0.5, y, 0]))
        leg(
            builder,
            front,
            "square" if section == "square" else "metal",
            half if section == "square" else half * 1.6,
            tube,
        )
        bar(builder, (x - 0.03, y, top - 0.02), (-x, y, top - 0.02), half, tube, section, mirror=True)
    else:
        loop = [
            [-x - lean, y, top + tall * 0.95],
            [-x, y, top],
            [x - 0.06, y, top - 0.02],
            [x, y, top - 0.06],
            [x + 0.02, y, half],
            [-x - splay, y, half],
            [-x + 0.06, y, top - 0.02],
        ]
        sweep(builder, loop, half, tube, section, mirror=True)
    cross_bar(builder, x - 0.04, top - 0.025, y, (half, half), tube, section)
    thick = float(rng.uniform(0.04, 0.06)) if stuffed else 0.014
    shape = pillow(5, 7, thick, 0.5) if stuffed else np.full((5, 7), thick)
    grid = seat_grid(width, depth, top + thick / 4, 0.05, float(rng.uniform(0.1, 0.4)), 0.01, front_drop=0.03)
    shell(builder, grid, shape, cover)
    surface = BackSurface(-x + 0.02, top, tall, y + 0.01, y + 0.01, lean + 0.02, dish=float(rng.uniform(0.01, 0.06)))
    low = float(rng.uniform(0.3, 0.6)) if rng.random() < 0.75 else 0.1
    _pad(builder, surface, low, 1.0, thick if stuffed else 0.016, cover, float(rng.uniform(0, 0.4)))
    if rng.random() < 0.25:
        high = top + float(rng.uniform(0.18, 0.24))
        path = [
            [-x - lean * 0.5, y, high],
            [x * 0.6, y + 0.02, high],
            [x * 0.75, y + 0.02, high - 0.03],
            [x * 0.8, y, top],
        ]
        sweep(builder, path, half, tube, section, mirror=True)
        sweep(
            builder, np.array(path[:2]) + np.array([0, 0, half + 0.006]), (0.02, 0.01), fin.dark(), "soft", mirror=True
        )


__all__ = ["cantilever", "folding", "moulded", "office", "stacking"]
