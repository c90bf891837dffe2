from __future__ import annotations

import pytest
from helpers import fake_steps
from helpers.fake_steps import STEPS, config

from viewnet.errors import ViewnetError
from viewnet.recipes import make_config
from viewnet.training import other_views, run_store
from viewnet.training.run_store import ensure

pytestmark = pytest.mark.usefixtures("folders")


def test_scoring_on_other_views_keeps_the_run_s_own_alignment(tmp_path):
    trained, constant = ensure([config(), run_store.untrained("constant", config())], workers=1, steps=STEPS)
    other = fake_steps.views(make_config(profile="smoke", data_root=str(tmp_path)).data)
    found = other_views.score_on(trained, other, steps=STEPS)
    assert found["images"] == len(other.index)
    own = trained.result["metrics"]["procrustes"]["alignment"]
    assert found["alignment"] == own
    assert other_views.score_on(constant, other, steps=STEPS)["images"] == len(other.index)
    with pytest.raises(ViewnetError, match="views it was trained on"):
        other_views.score_on(trained, fake_steps.views(config().data), steps=STEPS)
    seen = fake_steps.FakeStore(other.folder, other.index.assign(model_id=other.index["model_id"].str[5:]), "x")
    with pytest.raises(ViewnetError, match="model 00000 was seen in training"):
        other_views.score_on(trained, seen, steps=STEPS)
