"""Is a training step faster than in an older version? Both versions' steps in turn, on one core.

    python benchmarks/against.py OLD_CHECKOUT [--profile tiny] [--recipe matting] [--variant viewnet] [--rounds 15]
        [--set NAME=VALUE ...] [--steps 4] [--train 200] [--core 0] [-o FOLDER]

A process for each version imports its own checkout; both are pinned to one core with one thread each, and one waits
while the other works: windows of `--steps` steps, A B B A ... Each version has its own networks, those of the profile
and what is `--set`, trained by itself for `--train` steps, so that volumes are objects, and begins every window with
these weights; both have the same batches of built-in cars.
For both phases of training prints milliseconds a step of either version (medians), and how many times as fast the
present one is: the median of the rounds, least and most, and the median in processor time, which other work on the
core disturbs less. `choice of viewpoints` is all that is done without gradient, `rendering without gradient` the part
of it in the renderer (errors included, where it sums them itself); `the rest` is what remains of the step.
The first step's losses are printed too: those of two checkouts of one version are the same.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[1]
BATCHES = 16
"""As many different batches, over and over."""
MODELS = 96
"""Built-in models that the batches show."""
CLOCKS = (time.perf_counter, time.process_time)
"""Wall clock and processor time."""
PARTS = ("whole step", "choice of viewpoints", "rendering without gradient", "the rest")
PHASES = {"search": 0.5, "after": 2.0}
"""Progress of training, in units of the share in which viewpoints are searched."""


class Steps:
    """Training steps of whichever version is imported. `batches` as step_loss takes them."""

    def __init__(self, settings: dict[str, Any], batches: list[Any]) -> None:
        import torch

        torch.set_num_threads(1)
        from viewnet.data.augment import load
        from viewnet.model.kernels import volume_cpu
        from viewnet.model.viewnet import ViewNet
        from viewnet.recipes import make_config
        from viewnet.training.optimisers import make_optimisers
        from viewnet.training.step import step_loss

        try:
            from viewnet.training import matting as choosing
        except ImportError:  # its name in earlier versions
            from viewnet.training import pose_search as choosing
        volume_cpu.warm_up()
        config = make_config(**settings)
        self.config, self.batches, self.step_loss = config.train, batches, step_loss
        self.backgrounds = load(config.data, config.model.input_size, torch.device("cpu"))
        torch.manual_seed(0)
        self.model = ViewNet(config.model)
        self.optimisers = make_optimisers(self.model, config.train)
        self.model.train()
        self.seconds = {part: [0.0, 0.0] for part in PARTS}
        self.measure(choosing.PoseSearch, "__call__", PARTS[1])
        for name in {"render", "compare"} & set(vars(volume_cpu)):
            self.measure(volume_cpu, name, PARTS[2])

    def measure(self, owner: Any, name: str, part: str) -> None:
        """Adds what `owner.name` takes without gradient to this part's seconds."""
        import torch

        original = getattr(owner, name)

        def measured(*given: Any, **named: Any) -> Any:
            if part == PARTS[2] and torch.is_grad_enabled():
                return original(*given, **named)
            begun = [clock() for clock in CLOCKS]
            result = original(*given, **named)
            self.seconds[part] = [sum(each) for each in zip(self.seconds[part], elapsed(begun), strict=True)]
            return result

        setattr(owner, name, measured)

    def step(self, index: int, progress: float) -> float:
        """One step; its loss."""
        import torch

        generator = torch.Generator().manual_seed(index)
        batch = self.batches[index % len(self.batches)]
        terms = self.step_loss(self.model, batch, self.config, None, progress, generator, self.backgrounds)
        loss = torch.stack(list(terms.values())).sum()
        self.model.zero_grad(set_to_none=True)
        loss.backward()
        for optimiser in self.optimisers:
            optimiser.step()
        return loss.item()

    def train(self, steps: int, end: float) -> dict[str, Any]:
        """`steps` steps from the beginning of training to progress `end`; every window begins with their weights."""
        for index in range(steps):
            self.step(index, end * index / steps)
        self.weights = copy.deepcopy(self.model.state_dict())
        return {}

    def window(self, steps: int, progress: float) -> dict[str, Any]:
        """Seconds a step of each of PARTS by both CLOCKS, and the first step's loss."""
        self.model.load_state_dict(self.weights)
        self.seconds, begun = {part: [0.0, 0.0] for part in PARTS}, [clock() for clock in CLOCKS]
        losses = [self.step(index, progress) for index in range(steps)]
        whole, choice, *_ = self.seconds.values()
        whole[:] = elapsed(begun)
        self.seconds[PARTS[3]] = [a - b for a, b in zip(whole, choice, strict=True)]
        return {"loss": losses[0]} | {part: [s / steps for s in both] for part, both in self.seconds.items()}


def elapsed(begun: list[float]) -> list[float]:
    """Seconds of CLOCKS since `begun`."""
    return [clock() - start for clock, start in zip(CLOCKS, begun, strict=True)]


def work(batches: str) -> None:
    """A version's process: settings, then calls of Steps, come as lines of JSON, and the results go out."""
    import torch

    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no result

    def send(value: Any) -> None:
        print(json.dumps(value), file=out, flush=True)

    import viewnet

    steps = Steps(json.loads(input()), torch.load(batches, weights_only=True))
    send(str(Path(viewnet.__file__).resolve().parents[1]))
    for line in sys.stdin:
        name, *values = json.loads(line)
        send(getattr(steps, name)(*values))


class Version:
    """The process of one version, pinned to a core."""

    def __init__(self, checkout: Path, settings: dict[str, Any], batches: Path, core: int | None) -> None:
        self.checkout = checkout.resolve()
        one = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        environment = {**os.environ, **one, "PYTHONPATH": str(self.checkout), "CUDA_VISIBLE_DEVICES": ""}
        command = [sys.executable, str(Path(__file__).resolve()), "--worker", str(batches)]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)
        if core is not None and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(self.process.pid, {core})
        if (imported := self.ask(settings)) != str(self.checkout):
            raise SystemExit(f"{checkout}: the package was imported from {imported}")

    def ask(self, *message: Any) -> Any:
        """The answer to settings, or to a call of Steps."""
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write(json.dumps(message[0] if isinstance(message[0], dict) else message) + "\n")
        self.process.stdin.flush()
        if not (answer := self.process.stdout.readline()):
            raise SystemExit(f"{self.checkout}: its process ended, see above")
        return json.loads(answer)

    def commit(self) -> str:
        """The checkout's commit, "" where it has none."""
        command = ["git", "-C", str(self.checkout), "describe", "--always", "--dirty", "--exclude", "*"]
        return subprocess.run(command, capture_output=True, text=True).stdout.strip()


def make_batches(settings: dict[str, Any], file: Path) -> tuple[float, Any]:
    """Writes batches of built-in models; the share of training in which viewpoints are searched, and the config."""
    import torch

    from viewnet.data.build import view_store
    from viewnet.data.pairs import model_views, sample_pairs
    from viewnet.recipes import make_config

    torch.set_num_threads(1)
    config = make_config(**settings)
    size, cpu, train = config.model.input_size, torch.device("cpu"), config.train
    views = model_views(view_store(config.data), "train", max(size, config.model.render_size), config.model)
    batches = []
    for index in range(BATCHES):
        appearance, target = sample_pairs(views, train.objects, train.targets_per_object, 0, index)
        images = views.images(appearance, size, cpu), views.images(target, size, cpu)
        batches.append((*images, views.viewpoint_input(target, size, cpu)))
    torch.save(batches, file)
    return train.search.share, config


def compare(versions: dict[str, Version], phase: str, progress: float, given: Any) -> list[dict[str, Any]]:
    """A row for each of PARTS of a step at this progress, in milliseconds."""
    found: dict[str, list[Any]] = {name: [] for name in versions}
    losses = {name: version.ask("window", given.steps, progress)["loss"] for name, version in versions.items()}
    for turn in range(given.rounds):
        for name in list(versions)[:: -1 if turn % 2 else 1]:
            found[name].append(versions[name].ask("window", given.steps, progress))
    rows = []
    for part in PARTS:
        # The windows of a round are neighbours in time: what slows one down is likely to slow the other.
        wall, processor = ([old[part][clock] / new[part][clock] for old, new in zip(*found.values(), strict=True)]
                           for clock in (0, 1))  # fmt: skip
        row: dict[str, Any] = {"phase": phase, "part": part}
        row |= {f"{name}_ms": 1000 * statistics.median(w[part][0] for w in found[name]) for name in versions}
        row |= {"ratio": statistics.median(wall), "ratio_low": min(wall), "ratio_high": max(wall)}
        row |= {"processor_ratio": statistics.median(processor)}
        rows.append(row | {f"{name}_loss": loss for name, loss in losses.items()})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, metavar="OLD_CHECKOUT")
    parser.add_argument("--profile", default="tiny")
    parser.add_argument("--recipe", help="default: the profile's")
    parser.add_argument("--variant", default="viewnet")
    parser.add_argument("--rounds", type=int, default=15, help="windows of each version in each phase")
    parser.add_argument("--steps", type=int, default=4, help="in a window")
    parser.add_argument("--train", type=int, default=200, help="steps before measuring")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="other values in both, as JSON")
    parser.add_argument("--core", type=int, help="default: the last one allowed")
    parser.add_argument("-o", "--output", type=Path, help="folder for against.csv and against.json")
    given = parser.parse_args()
    if not (given.old / "viewnet" / "__init__.py").is_file():
        raise SystemExit(f"{given.old}: no package viewnet in it: name a checkout's folder")
    sys.path.insert(0, str(HERE))

    settings: dict[str, Any] = {"variant": given.variant, "profile": given.profile, "recipe": given.recipe}
    changed = {name: json.loads(value) for name, value in (change.split("=", 1) for change in given.set)}
    settings |= {"models": MODELS, **changed}
    core = given.core
    if core is None and hasattr(os, "sched_getaffinity"):
        core = max(os.sched_getaffinity(0))
    versions: dict[str, Version] = {}
    with tempfile.TemporaryDirectory() as folder:
        batches = Path(folder) / "batches.pt"
        share, config = make_batches(settings, batches)
        if config.train.perceptual != "none":  # its weights are not everywhere, and it is the same in both
            settings |= {"perceptual": "none", "pixel_weight": 1.0}
        try:
            for name, checkout in (("old", given.old), ("new", HERE)):
                versions[name] = Version(checkout, settings, batches, core)
            print(f"training {given.train} steps by each ...", flush=True)
            for version in versions.values():
                version.ask("train", given.train, PHASES["after"] * share or 0.5)
            rows = []
            print(f"{'':32}{'old ms':>9}{'new ms':>9}{'times as fast':>24}{'by processor time':>19}")
            for phase, units in PHASES.items() if share else [("after", 0.0)]:
                rows += compare(versions, phase, units * share or 0.5, given)
                for row in rows[-len(PARTS) :]:
                    ratio = f"{row['ratio']:.2f} ({row['ratio_low']:.2f}-{row['ratio_high']:.2f})"
                    print(f"{row['phase'] + ', ' + row['part']:32}{row['old_ms']:9.1f}{row['new_ms']:9.1f}{ratio:>24}"
                          f"{row['processor_ratio']:19.2f}")  # fmt: skip
                losses = f"{row['old_loss']:.5f}, {row['new_loss']:.5f}"
                print(f"{'':4}loss of the first step: {losses}", flush=True)
        finally:
            for version in versions.values():
                version.process.kill()
    if given.output:
        import pandas as pd

        from viewnet.runtime import provenance
        from viewnet.runtime.files import replacing, write_json

        with replacing(given.output / "against.csv") as path:
            pd.DataFrame(rows).to_csv(path, index=False, lineterminator="\n")
        about = {"rounds": given.rounds, "steps": given.steps, "train": given.train, "models": MODELS, **changed}
        about |= {name: getattr(config, name) for name in ("variant", "profile", "recipe")}
        about |= {"commits": {name: version.commit() for name, version in versions.items()}}
        machine = {"hardware": provenance.hardware(1), "versions": provenance.versions(provenance.LIBRARIES)}
        write_json(given.output / "against.json", {"settings": about, **machine, "git": provenance.commit()})


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        work(sys.argv[2])
    else:
        main()
