from __future__ import annotations

import sys

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from helpers.estimators import untrained
from helpers.untrained_models import turned

from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator

load = ViewpointEstimator.from_pretrained


@pytest.mark.parametrize("overrides", [{"recipe": "paper"}, {"in_plane": True}], ids=["replicate", "in plane"])
@pytest.mark.slow
def test_onnx_gives_the_outputs_of_the_network(tmp_path, overrides):
    estimator = untrained(rotation=turned(30), **overrides)
    path = estimator.export_onnx(tmp_path / "models" / "car.onnx")
    onnx.checker.check_model(onnx.load(path), full_check=True)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    assert [given.name for given in session.get_inputs()] == ["images"]
    for count in (1, 5):
        seen = torch.rand(count, 3, 32, 32, generator=torch.Generator().manual_seed(count))
        with torch.no_grad():
            expected = estimator.network.viewpoint(seen)
        found = dict(
            zip([o.name for o in session.get_outputs()], session.run(None, {"images": seen.numpy()}), strict=True)
        )
        assert found["vectors"].shape == (count, 3, 3)
        assert np.allclose(found["vectors"], expected.vectors, atol=1e-5)
        assert np.allclose(found["logits"], expected.logits, atol=1e-4)
        assert ("ups" in found) == (expected.ups is not None)
        if expected.ups is not None:
            assert np.allclose(found["ups"], expected.ups, atol=1e-5)
    kept = session.get_modelmeta().custom_metadata_map
    assert np.allclose(np.array(kept["rotation"].split(), float).reshape(3, 3), turned(30))
    assert kept["category"] == "car"


def test_errors_of_the_export(tmp_path, monkeypatch):
    with pytest.raises(ViewnetError, match=r"car\.pt: .* name it \.onnx"):
        untrained().export_onnx(tmp_path / "car.pt")
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(ViewnetError, match=r'onnxscript .*"viewnet\[onnx\]"'):
        untrained().export_onnx(tmp_path / "car.onnx")
    assert not list(tmp_path.iterdir())
