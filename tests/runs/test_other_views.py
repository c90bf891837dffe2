from __future__ import annotations

import pytest
from helpers import fake_steps
from helpers.fake_steps import STEPS, config

from viewnet.errors import ViewnetError
from viewnet.evaluation.evaluate import evaluate
from viewnet.recipes import make_config
from viewnet.runs import run_store
from viewnet.runs.other_views import transferred
from viewnet.runs.run_store import ensure

pytestmark = pytest.mark.usefixtures("folders")


def test_scoring_on_other_views_keeps_the_run_s_own_alignment(tmp_path):
    trained, constant = ensure([config(), run_store.untrained("constant", config())], workers=1, steps=STEPS)
    other = fake_steps.views(make_config(profile="smoke", data_root=str(tmp_path)).data)
    found = evaluate(transferred(trained, other, STEPS))
    assert found["images"] == len(other.index)
    own = trained.result["metrics"]["procrustes"]["alignment"]
    assert found["alignment"] == own
    assert len(transferred(constant, other, STEPS).subset("test")) == len(other.index)
    with pytest.raises(ViewnetError, match="views it was trained on"):
        transferred(trained, fake_steps.views(config().data), STEPS)
    seen = fake_steps.FakeStore(other.folder, other.index.assign(model_id=other.index["model_id"].str[5:]), "x")
    with pytest.raises(ViewnetError, match="model 00000 was seen in training"):
        transferred(trained, seen, STEPS)
