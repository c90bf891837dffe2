"""What notebooks run: requests checked, missing models trained, runs turned into tables and figures.

experiment("table2_ablation", profile="smoke", categories="car").run()
"""

from collections.abc import Mapping
from typing import Any

from viewnet.config import known
from viewnet.experiments.alignment_study import AlignmentStudy
from viewnet.experiments.cad import Experiment
from viewnet.experiments.novel_views import NovelViews
from viewnet.experiments.other_sets import OtherSetsExperiment
from viewnet.experiments.own_method import OwnMethodExperiment
from viewnet.experiments.photographs_study import PhotographsStudy
from viewnet.experiments.photos import PhotoExperiment
from viewnet.experiments.request import DESIGNS, accepted
from viewnet.experiments.videos import ObjectronExperiment, VideoExperiment

_KINDS: dict[str, type[Experiment]] = {"cad": Experiment, "photos": PhotoExperiment, "videos": VideoExperiment}
_KINDS |= {"objectron": ObjectronExperiment, "own_method": OwnMethodExperiment, "test_sets": OtherSetsExperiment}
_KINDS |= {"photographs_study": PhotographsStudy, "alignment_study": AlignmentStudy, "novel_views": NovelViews}


def experiment(name: str, cell: Mapping[str, Any] | None = None, /, **parameters: Any) -> Any:
    """The experiment of the notebook `name`, of the class for its kind (viewnet.experiments.request.DESIGNS).

    A notebook gives its `globals()` as `cell`, of which those it takes are read. Raises ViewnetError naming the
    parameter (viewnet.experiments.parameters.PARAMETERS) and its valid values.

    >>> request = experiment("table2_ablation", profile="smoke", categories="car", seeds="0,2")
    >>> request.label, request.seeds, len(request.configs)  # seven trained rows with two seeds, three others
    ('smoke-car', (0, 2), 17)
    """
    given = {key: cell[key] for key in accepted(name) if key in cell} if cell else {}
    return _KINDS[DESIGNS[known(name, DESIGNS, "notebook")].kind].check(name, **given, **parameters)
