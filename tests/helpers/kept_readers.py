"""Readers of the package's own files: view stores, runs, checkpoints, weights, tables, notebooks."""

from __future__ import annotations

import io
import json
import os
import shutil
import struct
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from helpers.damage import hostile_values, other_array, other_json, other_table
from helpers.evaluation_data import make_index, noisy
from helpers.readers import Reader, check_store
from helpers.untrained_models import untrained_run
from hypothesis import strategies as st
from torch import nn

from viewnet import paths
from viewnet.data import annotated_viewpoints, masks, photo_store
from viewnet.data.rendered_store import read_chunk
from viewnet.data.store import ViewStore, write_store
from viewnet.evaluation import features
from viewnet.evaluation.predictions import Predictions
from viewnet.evaluation.run import Run
from viewnet.experiments import notebooks
from viewnet.model import checkpoint
from viewnet.model.checkpoint import load_model
from viewnet.recipes import make_config
from viewnet.runs import make_run, worker_pool
from viewnet.runtime import torchvision_weights
from viewnet.runtime.files import write_json
from viewnet.tables import reported
from viewnet.tables.run_renderer import RunRenderer

INDEX = make_index(8, 2).assign(source="model.obj")


def _store(folder: Path) -> None:
    images = np.random.default_rng(0).integers(0, 255, (len(INDEX), 8, 8, 4), dtype=np.uint8)
    shutil.rmtree(folder)
    write_store(folder, [images], INDEX, {"mended": {}, "masks": None}, [("lost", "lost.obj", "no such file")])


def _open(folder: Path) -> object:
    store = ViewStore.open(folder)
    return f"{photo_store.summary(store)}; {check_store(store)}; {store.identity}"


def _predictions(folder: Path) -> None:
    noisy(make_index(8, 2)).to_parquet(folder / "predictions.parquet")


def _read_predictions(folder: Path) -> object:
    found = Predictions.from_parquet(folder / "predictions.parquet")
    assert np.isfinite(found.selected).all() and found.selected.shape == (len(found), 3)
    return found.truth, found.objects


CONFIG = make_config(profile="smoke")


def _run(folder: Path) -> None:
    write_json(folder / "config.json", CONFIG.to_dict())
    (folder / "log.csv").write_text("epoch,step,seconds,loss,val_accuracy\n1,9,1.5,2.5,20\n2,18,3,1.5,60\n")
    noisy(make_index(8, 2)).to_parquet(folder / "predictions.parquet")
    metrics = {"procrustes": {"acc30": 50.0, "median": 10.0}}
    result = {
        "schema": make_run.SCHEMA,
        "views": "0",
        "metrics": metrics,
        "code": make_run.code_identities(),
        "training": {"seconds": 1},
    }
    write_json(folder / "result.json", result)


def _read_run(folder: Path) -> object:
    run = Run(CONFIG, folder)
    told = worker_pool.progress_line(make_run.Job(CONFIG, folder, folder))
    assert "\n" not in told and len(told) < 500
    complete = make_run.is_complete(folder)
    log = run.log
    assert log.empty or (log["seconds"].dtype.kind in "if" and log["val_accuracy"].dtype.kind in "if")
    return complete, run.scored, log, run.predictions if complete else None


SIZES: dict[str, Any] = {
    "volume_size": 8,
    "render_size": 8,
    "input_size": 8,
    "encoder_channels": (4, 4, 4),
    "code_size": 4,
    "generator_channels": (4,),
    "appearance_size": 4,
}
SMALL = make_config(profile="smoke", **SIZES)


def _checkpoint(folder: Path) -> None:
    shutil.rmtree(folder)
    untrained_run(folder, **SIZES)


def _load(folder: Path) -> object:
    model, config = load_model(folder)
    size = config.model.input_size
    with torch.no_grad():
        found = model.viewpoint(model.composite(torch.zeros(1, 4, size, size)))
    assert found.vectors.shape == (1, config.model.heads, 3)
    return found


def _begin(folder: Path) -> object:
    place = str(folder / "checkpoint.safetensors")
    return checkpoint.starting_weights(place, SMALL.model), checkpoint.identity(place)


def other_checkpoint(content: bytes) -> st.SearchStrategy[bytes]:
    """A .safetensors file with another header over the same data, its configuration among what changes."""
    size = struct.unpack("<Q", content[:8])[0]
    header, data = json.loads(content[8 : 8 + size]), content[8 + size :]
    told = json.loads(header["__metadata__"]["config"])

    def packed(head: bytes) -> bytes:
        return struct.pack("<Q", len(head)) + head + data

    def configured(config: bytes) -> bytes:
        told = {**header, "__metadata__": {**header["__metadata__"], "config": config.decode()}}
        return packed(json.dumps(told).encode())

    names = st.sampled_from(sorted(told["model"]))
    changed = st.builds(lambda name, value: {**told, "model": {**told["model"], name: value}}, names, hostile_values)
    return st.one_of(
        other_json(json.dumps(header).encode()).map(packed),
        other_json(json.dumps(told).encode()).map(configured),
        changed.map(lambda config: configured(json.dumps(config).encode())),
    )


LAYER = nn.Conv2d(3, 4, 3)


def _saved(value: Any) -> bytes:
    target = io.BytesIO()
    torch.save(value, target)
    return target.getvalue()


def _weights(folder: Path) -> None:
    (folder / "weights.pth").write_bytes(_saved(LAYER.state_dict()))


def _fill(folder: Path) -> object:
    network = nn.Conv2d(3, 4, 3)
    torchvision_weights.load(network, masks.NETWORKS["deeplabv3"], folder / "weights.pth", "")
    with torch.no_grad():
        return network(torch.zeros(1, 3, 8, 8)).mean()


def other_weights(content: bytes) -> st.SearchStrategy[bytes]:
    """A file of torch.save with other values, which weights-only loading accepts."""
    kinds = [torch.float64, torch.float16, torch.int8, torch.bool, torch.complex64]
    weight, bias = LAYER.weight.detach(), LAYER.bias.detach()
    values = st.one_of(
        hostile_values,
        st.sampled_from(kinds).map(weight.to),
        st.sampled_from([(), (0,), (4,), (4, 3, 3), (1, 1, 1, 1), (5, 3, 3, 3)]).map(torch.zeros),
        st.just(torch.zeros(1).expand(4, 3, 3, 3)),
        st.just(torch.zeros(4, 3, 3, 3, device="meta")),
        st.just(weight.to_sparse()),
        st.just(torch.zeros(1).expand(2**40)),
    )
    states = values.map(lambda value: {"weight": value, "bias": bias})
    return st.one_of(states, values, st.just({0: weight}), st.lists(values, max_size=2)).map(_saved)


def _published(folder: Path) -> None:
    shutil.copytree(reported.folder(), folder / "paper_tables/published")


def _read_published(folder: Path) -> object:
    with mock.patch.dict(os.environ, VIEWNET_ROOT=str(folder)):
        tables = [reported.load(table) for table in reported.TABLES]
        layers = [reported.architecture(part) for part in ("encoder", "generator")]
    return tables, layers


def _viewpoints(folder: Path) -> None:
    lines = ["category,azimuth_deg,elevation_deg,subset,split,easy,annotated,other"]
    lines += [f"car,{30.5 * i},{i},imagenet,val,{i % 2},1,x" for i in range(6)]
    (folder / "viewpoints.csv").write_text("\n".join(lines) + "\n")


def _read_viewpoints(folder: Path) -> object:
    found, _ = annotated_viewpoints.read(folder / "viewpoints.csv")
    assert found["azimuth"].between(0, 360, inclusive="left").all() and found["elevation"].between(-90, 90).all()
    assert found["subset"].map(lambda value: isinstance(value, str)).all() and found["easy"].dtype == bool
    return found


def _features(folder: Path) -> None:
    _store_in(folder)
    with mock.patch.dict(os.environ, VIEWNET_DATA=str(folder)):
        features.extract(ViewStore.open(folder / "store"), "pixels", 16)


def _extract(folder: Path) -> object:
    with mock.patch.dict(os.environ, VIEWNET_DATA=str(folder)):
        found = features.extract(ViewStore.open(folder / "store"), "pixels", 16)
    assert found.ndim == 2 and len(found) == len(INDEX) and found.dtype == np.float32
    assert np.isfinite(found).all()
    return found


def _chunk(folder: Path) -> None:
    images = np.zeros((2, 4, 4, 4), np.uint8)
    np.savez(folder / "00000000.npz", images=images, rejected=np.array(json.dumps({"lost": "no such file"})))


def _read_chunk(folder: Path) -> object:
    images, rejected = read_chunk(folder / "00000000.npz")
    assert images.dtype == np.uint8 and images.ndim == 4
    assert all(isinstance(text, str) for item in rejected.items() for text in item)
    return images, rejected


def other_chunk(content: bytes) -> st.SearchStrategy[bytes]:
    """A .npz file with other arrays."""
    with np.load(io.BytesIO(content)) as stored:
        images, rejected = stored["images"], stored["rejected"]

    def saved(**arrays: Any) -> bytes:
        target = io.BytesIO()
        np.savez(target, **arrays)
        return target.getvalue()

    shapes = st.lists(st.integers(0, 3), max_size=5)
    kinds = st.sampled_from(["u1", "f4", "U3"])
    texts = st.one_of(hostile_values.map(json.dumps), st.text(max_size=5))
    return st.one_of(
        st.builds(lambda shape, kind: saved(images=np.zeros(shape, kind), rejected=rejected), shapes, kinds),
        texts.map(lambda text: saved(images=images, rejected=np.array(text))),
        st.sampled_from([saved(images=images), saved(rejected=rejected), saved()]),
    )


def _notebook(folder: Path) -> None:
    (folder / "notebooks").mkdir()
    shutil.copy(paths.part("notebooks") / "table2_ablation.ipynb", folder / "notebooks")


def _parameters(folder: Path) -> object:
    with mock.patch.dict(os.environ, VIEWNET_ROOT=str(folder)):
        return notebooks.read(notebooks.find("table2_ablation"))


def _drawer(folder: Path) -> None:
    _store_in(folder)
    (folder / "run").mkdir()
    _checkpoint(folder / "run")
    write_json(folder / "run/result.json", {"views": ViewStore.open(folder / "store").identity})
    noisy(INDEX[INDEX["split"] != "train"]).to_parquet(folder / "run/predictions.parquet")


def _store_in(folder: Path) -> None:
    (folder / "store").mkdir()
    _store(folder / "store")


def _draw(folder: Path) -> object:
    return RunRenderer.of(folder / "run", ViewStore.open(folder / "store")).aligned


KEPT: tuple[Reader, ...] = (
    Reader(
        "view store",
        _store,
        _open,
        {"views.npy": other_array, "index.parquet": other_table, "meta.json": other_json, "rejected.csv": None},
    ),
    Reader("predictions", _predictions, _read_predictions, {"predictions.parquet": other_table}),
    Reader("run", _run, _read_run, {"result.json": other_json, "log.csv": None, "predictions.parquet": other_table}),
    Reader("checkpoint", _checkpoint, _load, {"checkpoint.safetensors": other_checkpoint}),
    Reader("checkpoint to start from", _checkpoint, _begin, {"checkpoint.safetensors": other_checkpoint}),
    Reader("weights of a network", _weights, _fill, {"weights.pth": other_weights}),
    Reader("printed tables", _published, _read_published, {"paper_tables/published/*.csv": None}),
    Reader("list of viewpoints", _viewpoints, _read_viewpoints, {"viewpoints.csv": None}),
    Reader("features kept", _features, _extract, {"features/*.npy": other_array}),
    Reader("drawings kept", _chunk, _read_chunk, {"*.npz": other_chunk}),
    Reader("notebook", _notebook, _parameters, {"notebooks/*.ipynb": other_json}, ("table2_ablation",)),
    Reader("run that is drawn", _drawer, _draw, {"run/result.json": other_json}),
)
