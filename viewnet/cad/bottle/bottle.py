"""Bottles: wine, spirits, beer, soft drinks, water, sauces, household sprays and cleaners, lotions, jugs, flasks.

Units: metres. A bottle is nearly a body of revolution: its front (+x) is where the label is, and where a spout, a
trigger or a pump points; a handle, if there is one, is behind.
"""

from collections.abc import Callable

import numpy as np

from viewnet.cad.bottle.parts import (
    BRIGHT,
    BROWN_GLASS,
    CAPS,
    CLEAR,
    DRINKS,
    GREEN_GLASS,
    PAPERS,
    SPIRITS,
    Vessel,
    add_label,
    add_vessel,
    labels,
    shade_of,
)
from viewnet.cad.builder import Builder
from viewnet.cad.finishes import Finishes
from viewnet.cad.parts import bar, block, choose, sweep
from viewnet.cad.tvmonitor.screens import label_image

Kind = Callable[[Builder, np.random.Generator, Finishes], None]


def wine(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Bordeaux, burgundy, hock or sparkling: glass, foil on the neck, label in front and behind."""
    form = choose(rng, {"bordeaux": 0.4, "burgundy": 0.3, "hock": 0.12, "sparkling": 0.18})
    tall = float(rng.uniform(0.28, 0.33)) * (1.1 if form == "hock" else 1)
    radius = tall * float(rng.uniform(0.115, 0.14)) * {"hock": 0.85, "sparkling": 1.12, "burgundy": 1.1}.get(form, 1.0)
    neck = radius * float(rng.uniform(0.36, 0.42))
    shoulder = {"bordeaux": 0.62, "burgundy": 0.48, "hock": 0.42, "sparkling": 0.46}[form]
    if form == "bordeaux":
        curve = [(shoulder, 1.0), (0.67, 0.93), (0.7, 0.75), (0.73, 0.5)]
        curve = [(s, neck / radius if i == 3 else r) for i, (s, r) in enumerate(curve)]
    else:
        curve = [(shoulder, 1.0), (shoulder + 0.1, 0.88), (shoulder + 0.2, 0.65), (0.8, neck / radius)]
    lip = 1.25 if form == "sparkling" else 1.12
    shape = [
        (0, 0.93),
        (0.02, 1.0),
        *curve,
        (0.95, neck / radius * 0.95),
        (0.955, lip * neck / radius),
        (1.0, lip * neck / radius),
    ]
    profile = np.array([(s * tall, r * radius) for s, r in shape])
    vessel = Vessel(profile)
    white = rng.random() < 0.2
    glass = fin.solid(
        shade_of(rng, CLEAR if white and rng.random() < 0.5 else GREEN_GLASS if rng.random() < 0.8 else BROWN_GLASS)
    )
    foil = fin.solid(
        shade_of(
            rng,
            (
                (0.35, 0.05, 0.08),
                (0.75, 0.6, 0.25),
                (0.1, 0.1, 0.1),
                (0.7, 0.7, 0.72),
                (0.15, 0.3, 0.2),
                (0.85, 0.8, 0.7),
            ),
        )
    )
    foil_low = tall * float(
        rng.uniform(0.6, 0.72) if form == "sparkling" and rng.random() < 0.5 else rng.uniform(0.77, 0.88)
    )
    bands = [(foil_low, glass), (tall, foil)] if rng.random() < 0.88 else [(tall, glass)]
    if white and rng.random() < 0.8:
        bands = [
            (tall * 0.7, fin.solid(shade_of(rng, ((0.85, 0.8, 0.5), (0.85, 0.5, 0.5), (0.75, 0.75, 0.4))))),
            (foil_low if foil_low > tall * 0.72 else tall * 0.8, glass),
            (tall, foil),
        ]
    add_vessel(builder, vessel, bands)
    top = min(shoulder, 0.55)
    high = tall * float(rng.uniform(top - 0.12, top - 0.02))
    labels(builder, rng, fin, vessel, max(tall * float(rng.uniform(0.08, 0.2)), 0.02 * tall), high, (55, 115), 0.75)
    if rng.random() < 0.25:
        band = fin.solid(shade_of(rng, PAPERS))
        add_label(builder, vessel, tall * 0.745, tall * 0.765, 120, band)


def beer(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Long-necked, stubby or swing-top: brown or green glass, crown cap, body and neck labels."""
    stubby = rng.random() < 0.3
    tall = float(rng.uniform(0.16, 0.19)) if stubby else float(rng.uniform(0.21, 0.27))
    radius = float(rng.uniform(0.029, 0.035))
    neck = float(rng.uniform(0.0115, 0.014))
    start = float(rng.uniform(0.56, 0.62)) if stubby else float(rng.uniform(0.45, 0.56))
    end = start + float(rng.uniform(0.12, 0.22))
    shape = [
        (0, 0.92 * radius),
        (0.03, radius),
        (start, radius),
        ((start + end) / 2, (radius * 0.62 + neck * 0.38)),
        (end, neck * 1.2),
        (0.93, neck),
        (0.94, neck * 1.15),
        (1.0, neck * 1.15),
    ]
    vessel = Vessel(np.array([(s * tall, r) for s, r in shape]))
    palette = BROWN_GLASS if rng.random() < 0.6 else GREEN_GLASS if rng.random() < 0.7 else CLEAR
    glass = fin.solid(shade_of(rng, palette))
    cap = fin.solid(shade_of(rng, CAPS))
    bands = [(tall * 0.945, glass), (tall, cap)]
    if rng.random() < 0.12:
        bands = [(tall * end, glass), (tall, fin.solid((0.8, 0.7, 0.35)))]
    add_vessel(builder, vessel, bands)
    labels(
        builder,
        rng,
        fin,
        vessel,
        tall * float(rng.uniform(0.08, 0.18)),
        tall * (start - float(rng.uniform(0.02, 0.1))),
        (60, 125),
        0.5,
    )
    if rng.random() < 0.55:
        neck_label = fin.texture(label_image(rng, shade_of(rng, PAPERS), (0.1, 0.1, 0.1), 16, 24))
        add_label(builder, vessel, tall * (end + 0.02), tall * min(end + 0.14, 0.9), 85, neck_label)


def soft_drink(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A plastic bottle of water or lemonade: screw cap, liquid, wrap-around label, ribs or a waist."""
    tall = float(rng.uniform(0.2, 0.34))
    radius = tall * float(rng.uniform(0.12, 0.17))
    neck = float(rng.uniform(0.011, 0.014)) * tall / 0.24
    water = rng.random() < 0.5
    waist = float(rng.choice([1.0, rng.uniform(0.8, 0.95)]))
    start = float(rng.uniform(0.6, 0.72))
    ribs = water and rng.random() < 0.5
    body = [(0, 0.75), (0.03, 1.0), (0.15, 0.97), (0.3, waist), (0.45, waist), (start - 0.08, 1.0), (start, 0.98)]
    if ribs:
        body = (
            [(0, 0.8), (0.03, 1.0)]
            + [(0.06 + 0.05 * k, 0.93 if k % 2 else 1.0) for k in range(5)]
            + [(0.34, 1), (start, 1)]
        )
    shape = [(s, r * radius) for s, r in body] + [
        ((start + 0.9) / 2 - 0.02, radius * 0.72),
        (0.88, neck * 1.1),
        (0.915, neck),
        (0.92, neck * 1.3),
        (0.93, neck * 1.15),
        (1.0, neck * 1.15),
    ]
    vessel = Vessel(np.array([(s * tall, r) for s, r in shape]), power=float(rng.choice([1.0, 1.0, 0.8])))
    plastic = fin.solid(shade_of(rng, CLEAR))
    cap = fin.solid(shade_of(rng, CAPS))
    if water:
        bands = [(tall * 0.932, plastic), (tall, cap)]
    else:
        bands = [
            (tall * float(rng.uniform(0.74, 0.85)), fin.solid(shade_of(rng, DRINKS))),
            (tall * 0.932, plastic),
            (tall, cap),
        ]
    add_vessel(builder, vessel, bands)
    low = float(rng.uniform(0.3, 0.42))
    labels(builder, rng, fin, vessel, tall * low, tall * (low + float(rng.uniform(0.15, 0.27))), (70, 178), 0.3)


def spirits(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A bottle of spirits: round, oval or square body, sometimes flat like a flask, big stopper, large label."""
    tall = float(rng.uniform(0.2, 0.31))
    radius = tall * float(rng.uniform(0.14, 0.19))
    neck = float(rng.uniform(0.013, 0.018))
    form = choose(rng, {"round": 0.35, "square": 0.35, "flat": 0.3})
    start = float(rng.uniform(0.55, 0.7))
    shape = [
        (0, radius * 0.95),
        (0.02, radius),
        (start, radius),
        (start + 0.06, radius * 0.85),
        (start + 0.12, neck * 1.3),
        (0.87, neck),
        (0.88, neck * 1.3),
        (0.99, neck * 1.3),
        (1.0, neck * 1.1),
    ]
    flat = float(rng.uniform(0.45, 0.7)) if form == "flat" else 1.0
    vessel = Vessel(
        np.array([(s * tall, r) for s, r in shape]), depth=flat, power={"round": 1.0, "square": 0.45, "flat": 0.7}[form]
    )
    liquid, glass = (
        fin.solid(shade_of(rng, SPIRITS)),
        fin.solid(shade_of(rng, CLEAR if rng.random() < 0.8 else GREEN_GLASS)),
    )
    cap = fin.solid(shade_of(rng, CAPS))
    level = tall * (start + float(rng.uniform(-0.1, 0.1)))
    sections = 20 if form == "square" else 16
    add_vessel(builder, vessel, [(level, liquid), (tall * 0.88, glass), (tall, cap)], sections)
    low = float(rng.uniform(0.08, 0.2))
    labels(
        builder, rng, fin, vessel, tall * low, tall * (start - float(rng.uniform(0.05, 0.2))), (42, 70), 0.6, sections
    )


def household(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A cleaner: flat plastic body with a trigger spray pointing forwards, or a screw cap and a handle behind."""
    tall = float(rng.uniform(0.18, 0.24))
    radius = tall * float(rng.uniform(0.2, 0.26))
    neck = radius * float(rng.uniform(0.26, 0.36))
    bend = float(rng.uniform(0.75, 1.0))
    shape = [
        (0, radius * 0.94),
        (0.03, radius),
        (0.35, radius * bend),
        (0.6, radius),
        (0.78, radius * 0.8),
        (0.92, neck * 1.2),
        (1.0, neck),
    ]
    vessel = Vessel(
        np.array([(s * tall, r) for s, r in shape]),
        depth=float(rng.uniform(0.5, 0.85)),
        width=float(rng.uniform(0.8, 1.0)),
        power=float(rng.uniform(0.5, 0.9)),
    )
    body = fin.solid(shade_of(rng, BRIGHT if rng.random() < 0.7 else CLEAR))
    add_vessel(builder, vessel, [(tall, body)])
    labels(builder, rng, fin, vessel, tall * 0.12, tall * float(rng.uniform(0.5, 0.62)), (40, 75), 0.7)
    top = fin.solid(shade_of(rng, CAPS))
    if rng.random() < 0.65:
        other = top if rng.random() < 0.5 else fin.solid(shade_of(rng, BRIGHT))
        bar(builder, (0, 0, tall * 0.98), (0, 0, tall + 0.022), neck * 1.25, top, "round", end_half=neck)
        head = tall + 0.035
        profile = [[-0.035, 0, head + 0.002], [0.01, 0, head + 0.006], [0.05, 0, head + 0.008]]
        sweep(builder, profile, np.array([[0.01, 0.009], [0.013, 0.016], [0.009, 0.009]]), other, "soft")
        bar(builder, (0.05, 0, head + 0.008), (0.063, 0, head + 0.008), 0.007, top, "round")
        path = [[0.022, 0, head - 0.004], [0.036, 0, head - 0.022], [0.034, 0, head - 0.05]]
        sweep(builder, path, (0.007, 0.004), top if other != top else body)
    else:
        bar(builder, (0, 0, tall * 0.99), (0, 0, tall + float(rng.uniform(0.015, 0.035))), neck * 1.2, top, "fine")
        if rng.random() < 0.5:
            rear = -radius * vessel.depth
            path = [
                [rear * 0.85, 0, tall * 0.75],
                [rear * 1.7, 0, tall * 0.72],
                [rear * 1.75, 0, tall * 0.45],
                [rear * 0.9, 0, tall * 0.36],
            ]
            sweep(builder, path, (0.009, 0.007), body, "soft")


def lotion(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Shampoo, soap, medicine: flat or round body, flip cap, or a pump whose spout points forwards."""
    tall = float(rng.uniform(0.1, 0.2))
    radius = tall * float(rng.uniform(0.17, 0.27))
    neck = radius * float(rng.uniform(0.35, 0.8))
    start = float(rng.uniform(0.75, 0.92))
    shape = [
        (0, radius * 0.94),
        (0.03, radius),
        (start * 0.5, radius * float(rng.uniform(0.9, 1.05))),
        (start, radius * 0.97),
        ((1 + start) / 2, radius * 0.75 + neck * 0.25),
        (1.0, neck),
    ]
    vessel = Vessel(
        np.array([(s * tall, r) for s, r in shape]),
        depth=float(rng.choice([1.0, rng.uniform(0.45, 0.7)])),
        power=float(rng.choice([1.0, rng.uniform(0.5, 0.9)])),
    )
    body = fin.solid(shade_of(rng, BRIGHT if rng.random() < 0.75 else BROWN_GLASS))
    add_vessel(builder, vessel, [(tall, body)])
    labels(builder, rng, fin, vessel, tall * 0.12, tall * start * float(rng.uniform(0.75, 0.95)), (40, 90), 0.7)
    cap = fin.solid(shade_of(rng, CAPS))
    if rng.random() < 0.4:
        bar(builder, (0, 0, tall * 0.98), (0, 0, tall + 0.012), neck * 0.9, cap, "fine")
        high = tall + float(rng.uniform(0.03, 0.05))
        bar(builder, (0, 0, tall), (0, 0, high), 0.004, cap, "coarse")
        sweep(
            builder, [[-0.01, 0, high], [0.01, 0, high + 0.002], [0.038, 0, high - 0.004]], (0.008, 0.005), cap, "soft"
        )
        bar(builder, (0.036, 0, high - 0.003), (0.037, 0, high - 0.014), 0.004, cap, "coarse")
    else:
        high = tall + float(rng.uniform(0.015, 0.04))
        bar(
            builder,
            (0, 0, tall * 0.99),
            (0, 0, high),
            neck * 1.05,
            cap,
            "fine",
            end_half=neck * float(rng.uniform(0.85, 1.05)),
        )
        if rng.random() < 0.4:
            block(builder, (neck * 0.95, 0, high - 0.006), (neck * 0.5, neck * 0.9, 0.004), cap)


def sauce(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """Ketchup, oil, vinegar, a sports bottle: slim coloured body with a nozzle or a wide screw cap."""
    tall = float(rng.uniform(0.16, 0.26))
    radius = tall * float(rng.uniform(0.13, 0.19))
    neck = radius * float(rng.uniform(0.35, 0.5))
    start = float(rng.uniform(0.5, 0.68))
    shape = [
        (0, radius * 0.92),
        (0.03, radius),
        (start * 0.5, radius * float(rng.uniform(0.85, 1.0))),
        (start, radius),
        (start + 0.12, radius * 0.75),
        (0.84, neck * 1.1),
        (0.86, neck),
        (0.87, neck * 1.35),
        (0.94, neck * 1.3),
        (1.0, neck * 0.6),
    ]
    vessel = Vessel(
        np.array([(s * tall, r) for s, r in shape]),
        depth=float(rng.choice([1.0, rng.uniform(0.6, 0.9)])),
        power=float(rng.choice([1.0, rng.uniform(0.6, 0.9)])),
    )
    body = fin.solid(
        shade_of(
            rng,
            (
                (0.65, 0.08, 0.05),
                (0.85, 0.7, 0.1),
                (0.25, 0.14, 0.07),
                (0.6, 0.55, 0.15),
                (0.9, 0.88, 0.8),
                (0.2, 0.3, 0.12),
            ),
        )
    )
    upper = body if rng.random() < 0.6 else fin.solid(shade_of(rng, CLEAR))
    cap = fin.solid(shade_of(rng, CAPS))
    add_vessel(builder, vessel, [(tall * (start + 0.05), body), (tall * 0.865, upper), (tall, cap)])
    labels(builder, rng, fin, vessel, tall * 0.1, tall * (start - float(rng.uniform(0.02, 0.12))), (45, 110), 0.7)


def jug(builder: Builder, rng: np.random.Generator, fin: Finishes) -> None:
    """A large container for milk, oil or detergent with a handle behind and a cap."""
    tall = float(rng.uniform(0.22, 0.3))
    radius = tall * float(rng.uniform(0.24, 0.3))
    neck = radius * float(rng.uniform(0.24, 0.34))
    start = float(rng.uniform(0.5, 0.64))
    shape = [
        (0, radius * 0.96),
        (0.02, radius),
        (start, radius),
        (start + 0.14, radius * 0.82),
        (0.88, neck * 1.4),
        (0.93, neck),
        (1.0, neck),
    ]
    vessel = Vessel(
        np.array([(s * tall, r) for s, r in shape]),
        depth=float(rng.uniform(0.7, 1.0)),
        width=float(rng.uniform(0.65, 1.0)),
        power=float(rng.uniform(0.4, 0.8)),
    )
    body = fin.solid(shade_of(rng, BRIGHT))
    add_vessel(builder, vessel, [(tall, body)], 20)
    cap = fin.solid(shade_of(rng, CAPS))
    bar(builder, (0, 0, tall * 0.95), (0, 0, tall + 0.012), neck * 1.25, cap, "fine")
    rear = -radius * vessel.depth
    path = [
        [rear * 0.35, 0, tall * 0.9],
        [rear * 0.95, 0, tall * 0.86],
        [rear * 1.15, 0, tall * 0.7],
        [rear * 1.0, 0, tall * 0.45],
    ]
    sweep(builder, path, (0.012, 0.009), body, "soft")
    labels(builder, rng, fin, vessel, tall * 0.1, tall * (start - 0.04), (38, 60), 0.5, 20)


KINDS: dict[str, tuple[float, Kind]] = {
    "wine": (0.27, wine),
    "beer": (0.17, beer),
    "soft_drink": (0.18, soft_drink),
    "spirits": (0.1, spirits),
    "household": (0.09, household),
    "lotion": (0.09, lotion),
    "sauce": (0.06, sauce),
    "jug": (0.04, jug),
}


def bottle(rng: np.random.Generator, kind: str | None = None) -> Builder:
    """A bottle of a random kind, or of the given one (a key of KINDS). Raises KeyError for another."""
    builder = Builder()
    chosen = choose(rng, {name: weight for name, (weight, _) in KINDS.items()})
    KINDS[kind or chosen][1](builder, rng, Finishes(builder, rng, plain=0.05))
    return builder
