"""What configurations need: which views and runs are kept, and which would be made, how long that takes and how large.

Nothing is made, but for the table of hashes of files that are read (viewnet.data.contents).
"""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from viewnet import paths
from viewnet.config import DataConfig, RunConfig
from viewnet.data import augment, backgrounds, build
from viewnet.data.store import ViewStore
from viewnet.errors import ViewnetError
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.evaluation.run import run_name
from viewnet.recipes import PEERS
from viewnet.runs import kept_runs, make_run, run_store
from viewnet.runtime.files import read_json

Row = dict[str, Any]


@dataclass(frozen=True)
class Needs:
    """View stores and runs as JSON values: what each is made from, its folder, None where that is not known before
    something else is made, whether it is kept, and about how many bytes and seconds it takes, None where unknown.
    """

    stores: dict[DataConfig, Row] = field(default_factory=dict)
    runs: dict[RunConfig, Row] = field(default_factory=dict)

    def __or__(self, other: "Needs") -> "Needs":
        return Needs(self.stores | other.stores, self.runs | other.runs)

    def as_dict(self) -> dict[str, list[Row]]:
        """JSON values."""
        return {"views": list(self.stores.values()), "runs": list(self.runs.values())}

    def lines(self) -> Iterator[str]:
        """The same for reading: a line for each kind, and below it what is missing."""
        for kind, rows in self.as_dict().items():
            missing = [row for row in rows if not row["kept"]]
            if rows:
                about = "at least" if any(row["bytes"] is None for row in missing) else "about"
                left = f"{about} {sum(row['bytes'] or 0 for row in missing) / 1e6:.1f} MB" if missing else "nothing"
                yield f"{kind}: {len(rows) - len(missing)} of {len(rows)} kept, {left} to make{_time(missing)}"
            yield from (f"  missing: {row['name']}, from {row['from']}" for row in missing)


def _time(missing: list[Row]) -> str:
    """How long it takes, in words; nothing where that is not known of any."""
    known = [row["seconds"] for row in missing if row["seconds"] is not None]
    others = f", and {len(missing) - len(known)} of unknown length" if len(known) < len(missing) else ""
    return f", about {sum(known) / 3600:.2g} core-hours{others}" if any(known) else ""


def needs(configs: Sequence[RunConfig], later: Sequence[RunConfig] = ()) -> Needs:
    """What the runs of `configs` need, and of `later`, which are not known before the others are made.

    Times are the means of runs that are kept, here or in paper_tables/, with the same settings but for category and
    seed. Raises ViewnetError for settings that nothing can be made of.
    """
    run_store.check(configs)
    found, known = views((*configs, *later)), list(_known())
    identities = {data: ViewStore.open(s["folder"]).identity if s["kept"] else None for data, s in found.stores.items()}
    for config in dict.fromkeys((*configs, *later)):
        place = None
        if (identity := identities[config.data]) and config not in later:
            behind, size = config.data.backgrounds, 2 * config.model.input_size
            drawn = backgrounds.identity(behind, size, augment.COUNT) if behind else ""
            place = run_store.locate(config, identity, drawn)
        trained = config.variant not in UNTRAINED
        # Those with the best validation accuracy after a robust alignment are kept beside them.
        copies = 1 + (config.train.select_by == "accuracy" and config.variant not in PEERS)
        found.runs[config] = {
            "name": run_name(config),
            "from": found.stores[config.data]["from"] + (f" and {config.train.start}" if config.train.start else ""),
            "folder": place and str(place),
            "kept": place is not None and make_run.is_complete(place),
            "bytes": 4 * copies * run_store.weights(config) if trained else 0,
            "seconds": _seconds(config, known) if trained else 0.0,
        }
    return found


def views(configs: Sequence[RunConfig]) -> Needs:
    """The view stores of configurations alone. Raises ViewnetError as viewnet.data.build.planned does."""
    found = Needs()
    for data in dict.fromkeys(config.data for config in configs):
        folder, size = build.planned(data)
        found.stores[data] = {
            "name": data.category,
            "from": _origin(data),
            "folder": folder and str(folder),
            "kept": folder is not None and folder.exists(),
            "bytes": size or None,
            "seconds": None,
        }
    return found


def _origin(data: DataConfig) -> str:
    """What views are made from, in words."""
    videos = data.video and (data.video.root or "a stand-in for videos")
    behind = f" over {'drawn backgrounds' if data.backgrounds == 'drawn' else data.backgrounds}"
    return (videos or data.root or "built-in models") + (behind if data.backgrounds else "")


def _known() -> Iterator[tuple[Row, str, float]]:
    """Of every run that is kept: its names, its settings' key, and how many seconds it was trained."""
    for _, runs in kept_runs.in_tables():
        for run in runs.values():
            if run.get("settings") and run.get("training"):
                yield run, run["settings"], run["training"]["seconds"]
    for file in sorted(paths.runs().glob("*/*/result.json")):
        result = read_json(file)
        if result.get("training") and "variant" in result:
            with contextlib.suppress(ViewnetError):  # of a version with other settings
                key = RunConfig.from_dict(read_json(file.with_name("config.json"))).settings_key()
                yield result, key, result["training"]["seconds"]


def _seconds(config: RunConfig, known: Iterable[tuple[Row, str, float]]) -> float | None:
    """The mean time of the kept runs with the settings of `config`, whatever their category and seed; None for none."""
    times = []
    for run, key, seconds in known:
        if all(run[name] == getattr(config, name) for name in ("variant", "profile", "recipe")):
            data = replace(config.data, category=run["category"])
            if replace(config, category=run["category"], seed=run["seed"], data=data).settings_key() == key:
                times.append(seconds)
    return float(np.mean(times)) if times else None
