"""List, show, compare and remove runs.

What the run store holds: trainings that are finished, stopped or going on. A key may be cut to where it is unique.

Examples:

    viewnet runs                                                    all of them
    viewnet runs --category car --recipe paper --json
    viewnet runs show 0123                                          settings, curves, scores, and who shows them
    viewnet runs compare 0123 89ab                                  settings that differ, and scores
    viewnet runs remove 0123 89ab
"""

import json
from pathlib import Path
from typing import Any

from viewnet.commands.options import JSON, Options, argument, print_results, records
from viewnet.errors import ViewnetError

DIGITS = {"epochs": 0, "reconstruction": 4, "acc30": 1, "median": 1, "hours": 2}
SHOWN = ("key", "variant", "category", "profile", "recipe", "seed", "state", *DIGITS, "MB")
ARGUMENTS = (
    argument("what", "show, compare or remove", nargs="?", choices=["show", "compare", "remove"]),
    argument("keys", "keys of runs, or how they begin", nargs="*", metavar="KEY"),
    *(argument(f"--{name}", f"list those of this {name}") for name in ("variant", "category", "profile", "recipe")),
    JSON,
)


def run(options: Options) -> None:
    """Do what is asked. ViewnetError for keys that name no run or several, and a run to remove that is being made."""
    from viewnet.runs import kept_runs

    if options.what is None:
        wanted = {name: getattr(options, name) for name in ("variant", "category", "profile", "recipe")}
        table = kept_runs.listed(**{name: value for name, value in wanted.items() if value})
        print_results(options, records(table), _text(table))
        return
    least, keys = 2 if options.what == "compare" else 1, set(options.keys)
    folders = list(dict.fromkeys(map(kept_runs.find, options.keys))) if len(keys) >= least else []
    if len(folders) < least:  # two keys may be beginnings of one
        raise ViewnetError(f"runs {options.what}: name {'two keys or more' if least > 1 else 'a key'}")
    if options.what == "show":
        shown = [_about(folder) for folder in folders]
        print_results(options, shown, *(line for about in shown for line in _lines(about)))
    elif options.what == "compare":
        table = kept_runs.differences([kept_runs.read(folder) for folder in folders])
        rows = kept_runs.listed().set_index("key").loc[[folder.name for folder in folders]]
        scores = rows[["state", *DIGITS]].T.astype(object)
        values = {"settings": table.T.to_dict("index"), "scores": records(rows.reset_index())}
        print_results(options, values, table.to_string() if len(table) else "the same settings", "", scores.to_string())
    else:
        removed = []
        for folder in folders:
            shown_in = kept_runs.shown_in(folder.name)
            removed.append({"folder": str(folder), "bytes": kept_runs.remove(folder), "shown_in": shown_in})
        print_results(options, removed, *map(_removed, removed))


def _text(table: Any) -> str:
    """The list of runs as text."""
    if table.empty:
        return "no runs"
    rows = table.assign(MB=(table["bytes"] / 1e6).map("{:.1f}".format))[list(SHOWN)]
    for name, digits in DIGITS.items():
        rows[name] = rows[name].map(f"{{:.{digits}f}}".format).replace("nan", "")
    return rows.to_string(index=False)


def _about(folder: Path) -> dict[str, Any]:
    """All that there is of a run, as JSON values."""
    from viewnet.runs import kept_runs

    run, table = kept_runs.read(folder), kept_runs.listed()
    (row,) = records(table[table["folder"] == str(folder)])
    log = records(run.log) if (folder / "log.csv").is_file() else []
    return row | {"settings": run.config.to_dict(), "log": log, "shown_in": kept_runs.shown_in(run.key)}


def _lines(about: dict[str, Any]) -> list[str]:
    """A run as text: its row, its log, where it is shown and its settings."""
    import pandas as pd

    lines = [f"{name:9} {about[name]}" for name in about if name not in ("settings", "log", "shown_in", "key")]
    if about["log"]:
        log = pd.DataFrame(about["log"])
        lines += ["", log[[name for name in log if log[name].notna().any()]].round(4).to_string(index=False)]
    places = [f"paper_tables/{name}" for name in about["shown_in"]] or ["no file of paper_tables/"]
    return [about["key"], *lines, "", f"shown in {', '.join(places)}", "", json.dumps(about["settings"], indent=2), ""]


def _removed(one: dict[str, Any]) -> str:
    """What was removed, in a line."""
    kept = f"; its numbers stay in paper_tables/{', '.join(one['shown_in'])}" if one["shown_in"] else ""
    return f"removed {one['folder']} ({one['bytes'] / 1e6:.1f} MB){kept}"
