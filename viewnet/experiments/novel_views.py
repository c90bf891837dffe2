"""Novel views of the ablated models: what each run's views scored is kept, so that its network is needed no more."""

import pandas as pd

from viewnet.config import RunConfig
from viewnet.evaluation.run import Run
from viewnet.experiments.cad import Experiment
from viewnet.runs.needs import needs
from viewnet.runs.run_store import ensure
from viewnet.tables import novel_view_scores


class NovelViews(Experiment):
    """Runs of Tables 1 and 2 as viewnet.tables.novel_view_scores scores them, drawn where networks are at hand."""

    @property
    def kept(self) -> pd.DataFrame:
        """The scores that are kept, of every category and seed."""
        return novel_view_scores.read(self.folder)

    @property
    def missing(self) -> list[RunConfig]:
        """The runs whose scores are not kept."""
        kept = set(self.kept["settings"])
        return [config for config in self.configs if config.settings_key() not in kept]

    @property
    def judges(self) -> list[RunConfig]:
        """ViewNet's first seed, which looks at the views of all, in the categories with runs to score."""
        wanted = {config.category for config in self.missing}
        return [c for c in self._first_seed() if c.variant == "viewnet" and c.category in wanted]

    @property
    def kept_seeds(self) -> set[int]:
        """The seeds of the runs that are kept."""
        return set(self.kept["seed"])

    @property
    def to_run(self) -> list[RunConfig]:
        """The judges, and the runs that are missing."""
        return list(dict.fromkeys([*self.judges, *self.missing]))

    def run(self, progress: bool = True) -> list[Run]:
        """Train and score what is missing, one run after another; those to draw: see the class."""
        judges = {run.config.category: run for run in ensure(self.judges, self.workers, progress)}
        for run in judges.values():
            novel_view_scores.keep(novel_view_scores.copied(run), self.folder)

        def keep(run: Run) -> None:
            novel_view_scores.keep(novel_view_scores.scores(run, judges[run.config.category]), self.folder)

        ensure(self.missing, self.workers, progress, finished=keep)
        absent = {config.category for config, about in needs(self._first_seed()).runs.items() if not about["kept"]}
        return ensure([c for c in self._first_seed() if c.category not in absent], self.workers, progress)

    def _first_seed(self) -> list[RunConfig]:
        return [config for config in self.configs if config.seed == self.seeds[0]]
