"""The table of `viewnet bench` as text: headings, the cells of a row of `bench.json`, and the notes below."""

from collections.abc import Mapping, Sequence
from typing import Any

CONTESTANTS = ("textbook", "viewnet")  # in the order of the columns
NOT_MEASURED = "not measured"
QUICK = "quick: a check that everything works, and no measurement"
# The two lines above `cells`.
HEADINGS = (
    ("", "", "", "", "time", "", "", "memory", "", "", "images/s", "", "growth", "", "", "x floor", ""),
    ("work", "volume", "size", "on", "textbook", "viewnet", "ratio", "textbook", "viewnet", "ratio", "textbook",
     "viewnet", "expected", "textbook", "viewnet", "textbook", "viewnet"),
)  # fmt: skip


def cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    """A row as text, one cell for each of HEADINGS."""
    times = [row[f"{name}_s"] for name in CONTESTANTS]
    ends = row["speedup_low"], row["speedup_high"]  # over the turns in which both were measured
    ratios = ("memory_ratio", "textbook_images_per_s", "viewnet_images_per_s", "growth_expected")
    return (
        *(row["work"], row["volume"], "" if row["size"] is None else str(row["size"]), row["device"]),
        *(("", NOT_MEASURED) if times == [None, None] else map(_seconds, times)),
        number(row["speedup"]) + (f" ({'-'.join(map(number, ends))})" if ends[0] != ends[1] else ""),
        *(_bytes(row[f"{name}_bytes"]) for name in CONTESTANTS),
        *(number(row[key]) for key in ratios),
        *(_both(row[f"{name}_growth"], row[f"{name}_memory_growth"]) for name in CONTESTANTS),
        *(number(row[f"{name}_over_floor"]) for name in CONTESTANTS),
    )


def notes(result: Mapping[str, Any]) -> list[str]:
    """The lines below the table: machine, settings, and what memory, growth and floor mean."""
    settings = result["settings"]
    lines = [
        machine(result),
        f"renderer: {settings['volumes']} volumes, {settings['views']} images of each; training step: "
        f"{settings['batch']} targets, pixel loss; medians of {settings['repeat']} measurements in turn",
        "memory: peak in addition to weights and data; growth: over the row of half the size, time / memory; "
        "expected of voxels and of points on rays, while pixels grow by 4",
        f"floor: the multiply-adds and bytes that are needed at least, at this machine's rates: {rates(result)}",
    ]
    return [*lines, QUICK] if settings["quick"] else lines


def steps_notes(result: Mapping[str, Any]) -> list[str]:
    """The lines below the table of `viewnet bench --steps`."""
    settings = result["settings"]
    perceptual = "; ".join(f"{profile}: {network}" for profile, network in settings["perceptual"].items())
    lines = [
        machine(result),
        f"medians of {settings['repeat']} windows, of steps without the profiler and with it in turn; built-in models, "
        "volumes as full as a trained car's",
        f"perceptual term: {perceptual}",
        "parts and what is between operations (Python) add up to the profiled step; floors add up to the whole step's",
        f"floor: multiply-adds or bytes, whichever takes longer, at this machine's rates: {rates(result)}",
    ]
    return [*lines, QUICK] if settings["quick"] else lines


def machine(result: Mapping[str, Any]) -> str:
    """Hardware, PyTorch and commit of a measurement."""
    hardware, git = result["hardware"], result["git"]
    commit = (git["commit"] or "unknown")[:12] + (" with changes" if git["dirty"] else "")  # which no commit has
    where = hardware["gpu"] or hardware["processor"]
    return f"{where}, CPU threads: {hardware['threads']}; PyTorch {result['versions']['torch']}; commit {commit}"


def rates(result: Mapping[str, Any]) -> str:
    """The rates of a measurement's machine."""
    names = ("float32_multiply_adds_per_s", "bfloat16_multiply_adds_per_s", "copy_bytes_per_s")
    full, half, copying = (f"{result['rates'][name] / 1e9:.3g}" for name in names)
    return f"{full} G/s in float32, {half} G/s in bfloat16, {copying} GB/s"


def aligned(lines: Sequence[Sequence[str]], left: int) -> list[str]:
    """Cells below each other, those of the first `left` columns by their left edges."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    form = "  ".join(f"{{:{'<' if place < left else '>'}{width}}}" for place, width in enumerate(widths))
    return [form.format(*line).rstrip() for line in lines]


def number(value: float | None) -> str:
    """With about two significant digits; "" for None."""
    if value is None:
        return ""
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2g}"


def _seconds(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f} s" if value >= 100 else f"{value:.3g} s" if value >= 1 else f"{1000 * value:.3g} ms"


def _bytes(value: float | None) -> str:
    return "" if value is None else f"{value / 2**20:.{1 if value < 100 * 2**20 else 0}f} MiB"


def _both(time: float | None, memory: float | None) -> str:
    return number(time) + (f" / {number(memory)}" if memory is not None else "")
