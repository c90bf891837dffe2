"""Televisions and computer monitors: flat ones on stands or feet, all-in-ones, tube sets. Units: metres.

The screen faces +x; ports, vents, labels and the housing's bulge are behind.
"""

from collections.abc import Callable

import numpy as np

from viewnet.cad.builder import Builder, rotation_about
from viewnet.cad.chair.frames import pedestal_base
from viewnet.cad.finishes import Finishes, jitter
from viewnet.cad.parts import bar, block, choose, sweep
from viewnet.cad.tvmonitor.parts import BEIGES, HOUSINGS, flat_stand, plate, rear_details, screen_finish, slab

Kind = Callable[[Builder, np.random.Generator, Finishes], None]


def _flat(
    builder: Builder,
    rng: np.random.Generator,
    fin: Finishes,
    half_width: float,
    ratio: float,
    bezel: float,
    chin: float,
    depth: float,
    stand: str,
    low: float,
) -> None:
    """A flat set: `ratio` width by height of the image, frame `bezel`, strip `chin` below, lower edge at `low`."""
    color = HOUSINGS[int(rng.choice(6, p=[0.3, 0.24, 0.14, 0.14, 0.09, 0.09]))]
    housing = fin.solid(jitter(rng, color))
    rear = housing if rng.random() < 0.65 else fin.solid(jitter(rng, HOUSINGS[int(rng.integers(6))]))
    half_height = (half_width - bezel) / ratio + bezel + chin / 2
    middle = low + half_height
    tilt = float(rng.choice([0.0, rng.uniform(-4, 10)])) if stand not in ("none", "feet") else 0.0
    with builder.placed((0, 0, middle), rotation_about("y", -tilt)), builder.placed((0, 0, -middle)):
        slab(
            builder,
            [(-depth, half_width * 0.985, half_height * 0.98, middle), (0, half_width, half_height, middle)],
            housing,
            float(rng.choice([0.02, 0.06, 0.12])),
        )
        bulge = float(rng.uniform(0.015, 0.06)) * (1.6 if depth > 0.04 else 1)
        share, taper = float(rng.uniform(0.45, 0.95)), float(rng.uniform(0.7, 0.95))
        drop = middle - half_height * (1 - share) * float(rng.uniform(0, 0.9))
        slab(
            builder,
            [
                (-depth - bulge, half_width * share * taper, half_height * share * taper, drop),
                (-depth + 0.001, half_width * share, half_height * share, drop),
            ],
            rear,
        )
        image_half = half_height - bezel - chin / 2
        plate(builder, 0.003, half_width - bezel, image_half, middle + chin / 2, screen_finish(rng, fin))
        rear_details(builder, rng, fin, -depth - bulge, half_width * share * taper, half_height * share * taper, drop)
        if chin > 0.01 and rng.random() < 0.7:
            logo = fin.solid((0.8, 0.8, 0.82) if max(color) < 0.4 else (0.2, 0.2, 0.22))
            block(
                builder,
                (0.001, 0, middle - half_height + (bezel + chin) / 2),
                (0.004, half_width * 0.14, chin * 0.3),
                logo,
            )
        if rng.random() < 0.15 and stand != "none":
            speaker = fin.dark() if rng.random() < 0.6 else housing
            wide = half_width * 0.12
            block(
                builder,
                (-depth * 0.4, half_width + wide, middle),
                (depth, wide * 1.9, half_height * 1.9),
                speaker,
                mirror=True,
            )
    if stand != "none":
        flat_stand(builder, rng, stand, -depth / 2, half_width, low, housing if rng.random() < 0.7 else fin.metal())


def television(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A wide flat television on a stand or feet, or to be hung on a wall."""
    half_width = float(rng.uniform(0.38, 0.75))
    old = rng.random() < 0.35
    bezel = float(rng.uniform(0.025, 0.06)) if old else float(rng.uniform(0.006, 0.02))
    chin = float(rng.choice([0.0, rng.uniform(0.02, 0.09)])) if old else float(rng.choice([0.0, 0.012]))
    depth = float(rng.uniform(0.05, 0.1)) if old else float(rng.uniform(0.015, 0.04))
    stand = choose(rng, {"plate": 0.25, "disc": 0.2, "feet": 0.25, "vee": 0.05, "arc": 0.08, "none": 0.17})
    low = 0.0 if stand == "none" else float(rng.uniform(0.04, 0.12))
    _flat(builder, rng, fin, half_width, float(rng.choice([16 / 9, 16 / 9, 1.5])), bezel, chin, depth, stand, low)


def monitor(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A flat computer monitor on a neck and a base."""
    half_width = float(rng.uniform(0.19, 0.33))
    ratio = float(rng.choice([4 / 3, 1.25, 1.6, 16 / 9, 21 / 9], p=[0.17, 0.13, 0.25, 0.37, 0.08]))
    bezel, chin = float(rng.uniform(0.005, 0.022)), float(rng.choice([0.0, rng.uniform(0.008, 0.03)]))
    stand = choose(rng, {"plate": 0.36, "disc": 0.3, "vee": 0.1, "arc": 0.06, "sled": 0.1, "tulip": 0.08})
    _flat(
        builder,
        rng,
        fin,
        half_width,
        ratio,
        bezel,
        chin,
        float(rng.uniform(0.015, 0.05)),
        stand,
        float(rng.uniform(0.06, 0.16)),
    )


def all_in_one(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A computer in the screen's housing: pale chin below the image, a bent sheet as a foot."""
    half_width = float(rng.uniform(0.22, 0.33))
    ratio = float(rng.choice([1.6, 16 / 9]))
    pale = fin.solid(
        jitter(rng, ((0.82, 0.83, 0.85), (0.93, 0.93, 0.93), (0.12, 0.12, 0.13))[int(rng.choice(3, p=[0.5, 0.3, 0.2]))])
    )
    dark = fin.solid((0.05, 0.05, 0.06))
    bezel, chin, low = float(rng.uniform(0.01, 0.025)), float(rng.uniform(0.035, 0.09)), float(rng.uniform(0.07, 0.13))
    half_height = (half_width - bezel) / ratio + bezel + chin / 2
    middle, depth = low + half_height, float(rng.uniform(0.012, 0.04))
    slab(
        builder,
        [
            (-depth * 2.2, half_width * 0.7, half_height * 0.7, middle),
            (-depth, half_width, half_height, middle),
            (0, half_width, half_height, middle),
        ],
        pale,
        0.06,
    )
    plate(builder, 0.002, half_width * 0.995, half_height - chin / 2, middle + chin / 2, dark)
    plate(
        builder, 0.004, half_width - bezel, half_height - bezel - chin / 2, middle + chin / 2, screen_finish(rng, fin)
    )
    block(builder, (0.001, 0, middle - half_height + chin / 2), (0.004, chin * 0.3, chin * 0.35), dark)
    block(builder, (-depth * 2.2 - 0.001, 0, middle + half_height * 0.15), (0.004, 0.05, 0.05), dark)
    neck = half_width * float(rng.uniform(0.25, 0.4))
    path = [[-depth * 2.2, 0, middle - half_height * 0.2], [-depth * 2 - 0.07, 0, 0.012], [0.08, 0, 0.005]]
    sweep(builder, path, (neck, 0.005), pale)


def tube_set(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A television with a cathode-ray tube: a deep tapering box, bulging glass, controls, sometimes aerial and legs."""
    wooden = rng.random() < 0.3
    housing = (
        fin.wood(0.05)[1] if wooden else fin.solid(jitter(rng, BEIGES[int(rng.choice(5, p=[0.1, 0.1, 0.2, 0.4, 0.2]))]))
    )
    dark = fin.dark()
    half_width = float(rng.uniform(0.2, 0.4))
    half_height = half_width * float(rng.uniform(0.72, 0.86))
    legs = rng.random() < 0.2
    low = float(rng.uniform(0.2, 0.45)) if legs else float(rng.choice([0.0, 0.02]))
    middle = low + half_height
    depth = half_width * float(rng.uniform(1.0, 1.6))
    box = depth * float(rng.uniform(0.3, 0.75))
    slab(
        builder, [(-box, half_width * 0.98, half_height * 0.98, middle), (0, half_width, half_height, middle)], housing
    )
    shrink = float(rng.uniform(0.4, 0.75))
    back_middle = low + half_height * (1 - shrink) * float(rng.uniform(0.3, 1.0)) + half_height * shrink
    rear = dark if rng.random() < 0.5 else housing
    slab(
        builder,
        [
            (-depth, half_width * shrink, half_height * shrink, back_middle),
            (0.001 - box, half_width * 0.93, half_height * 0.93, middle),
        ],
        rear,
    )
    panel = choose(rng, {"side": 0.35, "below": 0.4, "none": 0.25})
    glass_half = np.array([half_width, half_height]) * 0.86
    offset_z, shift = 0.0, 0.0
    if panel == "below":
        glass_half[1] *= 0.84
        offset_z = half_height * 0.12
    elif panel == "side":
        glass_half[0] *= 0.8
        shift = half_width * 0.14
    frame = dark if rng.random() < 0.6 else fin.solid((0.6, 0.6, 0.6))
    with builder.placed((0, -shift, 0)):
        plate(builder, 0.003, glass_half[0] * 1.06, glass_half[1] * 1.07, middle + offset_z, frame)
        plate(
            builder,
            0.006,
            glass_half[0],
            glass_half[1],
            middle + offset_z,
            screen_finish(rng, fin),
            float(rng.uniform(0.01, 0.03)),
        )
    knob = fin.metal()
    if panel == "side":
        for k in range(2):
            z = middle + half_height * (0.55 - 0.4 * k)
            bar(
                builder,
                (0, half_width * 0.8, z),
                (0.025, half_width * 0.8, z),
                half_width * 0.09,
                knob,
                "round",
                side=(0, 0, 1),
            )
        block(
            builder,
            (0.002, half_width * 0.8, middle - half_height * 0.45),
            (0.006, half_width * 0.2, half_height * 0.6),
            dark,
        )
    elif panel == "below":
        for k in range(int(rng.integers(2, 6))):
            block(
                builder,
                (0.003, half_width * (0.75 - 0.16 * k), middle - half_height * 0.8),
                (0.008, half_width * 0.09, half_height * 0.1),
                knob,
            )
        block(
            builder,
            (0.002, -half_width * 0.5, middle - half_height * 0.8),
            (0.005, half_width * 0.6, half_height * 0.16),
            dark,
        )
    rear_details(builder, rng, fin, -depth, half_width * shrink, half_height * shrink, back_middle)
    top = middle + half_height
    if rng.random() < 0.3:
        metal = fin.metal()
        foot = (-box * 0.6, 0, top)
        block(builder, foot, (0.06, 0.08, 0.03), dark)
        spread = float(rng.uniform(0.4, 1.0)) * half_width
        bar(builder, foot, (-box * 0.6, spread, top + half_height * 0.9), 0.004, metal, "coarse", mirror=True)
    if legs:
        wood = fin.wood(0)[0]
        for x in (-0.06, 0.04 - box):
            bar(
                builder,
                (x * 1.05, half_width * 0.95, 0),
                (x, half_width * 0.75, low),
                0.012,
                wood,
                "round",
                end_half=0.02,
                mirror=True,
            )


def tube_monitor(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A computer monitor with a tube, on a swivel foot."""
    housing = fin.solid(jitter(rng, BEIGES[int(rng.choice(5, p=[0.35, 0.25, 0.15, 0.15, 0.1]))]))
    dark = fin.dark()
    half_width = float(rng.uniform(0.17, 0.23))
    half_height = half_width * float(rng.uniform(0.82, 0.94))
    low = float(rng.uniform(0.03, 0.08))
    middle, depth = low + half_height, half_width * float(rng.uniform(1.7, 2.2))
    front = depth * float(rng.uniform(0.12, 0.3))
    slab(
        builder,
        [
            (-depth, half_width * 0.5, half_height * 0.5, middle - half_height * 0.1),
            (-depth * 0.8, half_width * 0.66, half_height * 0.68, middle - half_height * 0.05),
            (-front, half_width * 0.95, half_height * 0.95, middle),
            (0, half_width, half_height, middle),
        ],
        housing,
        0.14,
    )
    glass = half_width * 0.86, half_height * 0.76
    plate(builder, 0.002, glass[0] * 1.03, glass[1] * 1.04, middle + half_height * 0.1, dark)
    plate(
        builder,
        0.004,
        glass[0],
        glass[1],
        middle + half_height * 0.1,
        screen_finish(rng, fin),
        float(rng.uniform(0.005, 0.02)),
    )
    for k in range(int(rng.integers(1, 5))):
        block(
            builder,
            (0.002, half_width * (0.7 - 0.12 * k), middle - half_height * 0.84),
            (0.006, half_width * 0.07, half_height * 0.06),
            dark,
        )
    rear_details(builder, rng, fin, -depth, half_width * 0.5, half_height * 0.5, middle - half_height * 0.1)
    for k in range(4):
        block(
            builder,
            (-depth * 0.5 - 0.03 * k, 0, middle + half_height * 0.8),
            (0.012, half_width * 0.9, half_height * 0.14),
            dark,
        )
    with builder.placed((-depth * 0.4, 0, 0)):
        pedestal_base(
            builder, low + half_height * 0.2, half_width * float(rng.uniform(0.6, 0.85)), housing, half_width * 0.4
        )


KINDS: dict[str, tuple[float, Kind]] = {
    "television": (0.36, television),
    "monitor": (0.33, monitor),
    "all_in_one": (0.07, all_in_one),
    "tube_set": (0.16, tube_set),
    "tube_monitor": (0.08, tube_monitor),
}


def tvmonitor(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A television or monitor of a random kind, or of the given one (a key of KINDS). Raises KeyError for another."""
    builder = Builder()
    chosen = choose(rng, {name: weight for name, (weight, _) in KINDS.items()})
    KINDS[kind or chosen][1](builder, rng, Finishes(builder, rng, plain=0.07))
    return builder
