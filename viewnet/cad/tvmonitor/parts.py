"""Housings, screens, stands and rear details of televisions and monitors. Units: metres."""

import numpy as np

from viewnet.cad.builder import Builder
from viewnet.cad.chair.frames import pedestal_base
from viewnet.cad.finishes import Finish, Finishes, Rgb, jitter
from viewnet.cad.parts import bar, block, circle, put, ring_faces, sweep
from viewnet.cad.tvmonitor.screens import screen_image, text_block

HOUSINGS: tuple[Rgb, ...] = (
    (0.07, 0.07, 0.08),
    (0.10, 0.10, 0.11),
    (0.16, 0.16, 0.17),
    (0.72, 0.73, 0.75),
    (0.88, 0.88, 0.88),
    (0.45, 0.46, 0.48),
)


BEIGES: tuple[Rgb, ...] = (
    (0.82, 0.79, 0.70),
    (0.75, 0.73, 0.67),
    (0.62, 0.60, 0.56),
    (0.12, 0.12, 0.13),
    (0.3, 0.3, 0.32),
)


def slab(
    builder: Builder, stations: list[tuple[float, float, float, float]], finish: Finish, corner: float = 0.08
) -> None:
    """A housing along x: stations (x, half width, half height, height of its centre), with rounded corners."""
    rings = []
    for x, half_width, half_height, middle in stations:
        cut = corner * min(half_width, half_height)
        y, z = half_width, half_height
        ring = [
            (y, cut - z),
            (y, z - cut),
            (y - cut, z),
            (cut - y, z),
            (-y, z - cut),
            (-y, cut - z),
            (cut - y, -z),
            (y - cut, -z),
        ]
        rings.append([(x, a, middle + b) for a, b in ring])
    grid = np.array(rings)
    put(builder, grid.reshape(-1, 3), ring_faces(len(rings), 8, True), finish)


def plate(
    builder: Builder,
    x: float,
    half_width: float,
    half_height: float,
    middle: float,
    finish: Finish,
    bow: float = 0.0,
    behind: bool = False,
) -> None:
    """A thin sheet facing front (or `behind`) that shows the whole texture; `bow`: its middle stands out by that."""
    side = -1.0 if behind else 1.0
    s, t = np.meshgrid(np.linspace(-1, 1, 7 if bow else 2), np.linspace(-1, 1, 5 if bow else 2), indexing="ij")
    grid = np.stack([x + bow * (1 - s**2) * (1 - t**2) + 0 * s, s * half_width, middle + t * half_height], axis=-1)
    rows, columns = s.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    uv = np.stack([(side * s + 1) / 2, (t + 1) / 2], axis=-1).reshape(-1, 2) * 0.998 + 0.001
    put(builder, grid.reshape(-1, 3), faces[:, ::-1] if behind else faces, finish, uv=uv)


def screen_finish(rng: np.random.Generator, fin: Finishes) -> Finish:
    """Dark or grey glass, or an image."""
    if rng.random() < 0.45:
        shade = float(rng.choice([0.04, 0.1, 0.2, 0.32]))
        return fin.solid(jitter(rng, (shade, shade * 1.02, shade * 1.05)))
    return fin.texture(screen_image(rng))


def rear_details(
    builder: Builder,
    rng: np.random.Generator,
    fin: Finishes,
    x: float,
    half_width: float,
    half_height: float,
    middle: float,
) -> None:
    """Vents, ports, a sticker and a mount on the rear face at depth x."""
    dark = fin.dark()
    pale = fin.solid((0.75, 0.76, 0.78))
    if rng.random() < 0.8:
        rows = int(rng.integers(2, 6))
        reach = half_width * float(rng.uniform(0.3, 0.8))
        for k in range(rows):
            z = middle + half_height * (0.8 - 0.12 * k)
            block(builder, (x - 0.001, 0, z), (0.004, 2 * reach, half_height * 0.05), dark)
    if rng.random() < 0.7:
        spot = half_width * float(rng.uniform(-0.4, 0.4))
        block(
            builder, (x - 0.001, spot, middle - half_height * 0.72), (0.005, half_width * 0.6, half_height * 0.14), dark
        )
    if rng.random() < 0.6:
        sticker = fin.texture(text_block(rng, (0.9, 0.9, 0.88), (0.2, 0.2, 0.2), 24, 24))
        plate(
            builder,
            x - 0.0045,
            half_width * 0.18,
            half_height * 0.16,
            middle - half_height * 0.25,
            sticker,
            behind=True,
        )
    elif rng.random() < 0.6:
        block(builder, (x - 0.001, 0, middle + half_height * 0.1), (0.005, half_width * 0.16, half_width * 0.16), pale)
    if rng.random() < 0.35:
        for y in (-1, 1):
            for z in (-1, 1):
                block(
                    builder, (x - 0.002, y * half_width * 0.2, middle + z * half_width * 0.2), (0.006, 0.02, 0.02), pale
                )


def flat_stand(
    builder: Builder, rng: np.random.Generator, style: str, x: float, half_width: float, low: float, finish: Finish
) -> None:
    """The stand of a flat screen whose lower edge is at height `low`: plate, disc, feet, vee, arc, sled, tulip."""
    reach = float(rng.uniform(0.09, 0.15))
    thick = float(rng.uniform(0.006, 0.014))
    if style == "feet":
        spot = half_width * float(rng.uniform(0.55, 0.9))
        for toe in (reach, -reach * 0.85):
            bar(builder, (x, spot, low + 0.01), (x + toe, spot, thick), (thick * 1.4, thick), finish, mirror=True)
        return
    neck = half_width * float(rng.uniform(0.06, 0.28))
    if style == "tulip":
        pedestal_base(builder, low + 0.02, reach * 1.2, finish, neck * 0.5)
        return
    # The neck stands behind the middle and meets the housing's rear.
    bar(builder, (x - 0.03, 0, thick), (x - 0.015, 0, low + 0.1), (neck, 0.012), finish)
    if style == "vee":
        for toe in (reach * 1.2, -reach * 0.5):
            bar(builder, (x - 0.03, 0, thick), (x + toe, half_width * 0.42, thick), (0.014, thick), finish, mirror=True)
    elif style == "arc":
        angle = np.linspace(-0.42, 0.42, 7) * np.pi
        path = np.stack([x + 0.15 * np.cos(angle) - 0.08, half_width * 0.5 * np.sin(angle), np.full(7, thick)], 1)
        sweep(builder, path, (thick, 0.018), finish, side=(0, 0, 1))
        block(builder, (x, 0, thick), (0.14, 2 * neck, thick), finish)
    elif style == "sled":
        block(builder, (x + 0.02, 0, thick / 2), (2 * reach, half_width * float(rng.uniform(0.8, 1.3)), thick), finish)
    else:
        rim = circle(16) if style == "disc" else np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], float)
        rim = rim * (reach, half_width * float(rng.uniform(0.28, 0.5))) + (x + 0.01, 0)
        bottom = np.column_stack([rim, np.zeros(len(rim))])
        top = np.column_stack([(rim - (x, 0)) * 0.92 + (x, 0), np.full(len(rim), thick * 1.4)])
        put(builder, np.concatenate([bottom, top]), ring_faces(2, len(rim), True), finish)
