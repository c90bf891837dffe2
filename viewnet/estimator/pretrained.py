"""Trained networks as folders: saved for others, and loaded from a folder, a finished run or the Hugging Face hub.

    model.safetensors    the weights, in single or half precision; its metadata holds a digest of config.json
    config.json          format, version of the package, RunConfig, alignment, and where the weights come from
    README.md            a model card (viewnet.estimator.model_card)

Files and methods are named as in huggingface_hub's ModelHubMixin, which folders do not need. No pickled file is read.
"""

import contextlib
import importlib.metadata
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from safetensors.torch import save_file

from viewnet import paths
from viewnet.config import RunConfig, nearest
from viewnet.data.store import identity_of
from viewnet.errors import ViewnetError
from viewnet.estimator import hub, model_card
from viewnet.model import checkpoint
from viewnet.model.viewnet import ViewNet
from viewnet.peers import registry
from viewnet.recipes import ABSOLUTE, PEERS
from viewnet.runtime.files import read_json, replacing, write_json, write_text

FORMAT = 1
FILES = WEIGHTS, CONFIG, CARD = ("model.safetensors", "config.json", "README.md")
FIELDS = ("format", "viewnet", "config", "alignment", "about")
# The fields of a run's result that a saved model keeps.
RESULT = ("key", "variant", "category", "profile", "recipe", "seed", "views", "metrics", "git")
SHIPPED = Path(__file__).parent / "models"  # folders that come with the package, named by their category
HUB_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[\w.-]+")


@dataclass(frozen=True, repr=False, eq=False)
class Pretrained:
    """A trained network and what is known of it."""

    network: ViewNet  # ready to predict
    config: RunConfig  # of its run
    annotated_from_model: np.ndarray | None = None  # (3, 3), from the network's own frame; None: not aligned
    about: dict[str, Any] = field(default_factory=dict)  # its run's key, metrics and so on, as plain JSON types

    @property
    def aligned(self) -> bool:
        """Whether predicted viewpoints are in the annotated frame, not in the network's own."""
        return self.annotated_from_model is not None

    def require_viewnet(self, what: str) -> None:
        """Raise ViewnetError for a method of another paper, which predicts viewpoints and has nothing else of ViewNet.

        `what` is what was asked for.
        """
        if self.config.variant in PEERS:
            raise ViewnetError(f"{what}: {self.config.variant} only predicts viewpoints: take a run of ViewNet")


def load(where: str | os.PathLike[str], **hub_options: Any) -> Pretrained:
    """Load a saved folder, a finished run by folder or key, a shipped model by category, or a hub id.

    `hub_options` are those of viewnet.estimator.hub.download. ViewnetError where there is no model of any kind.
    """
    place, name = paths.named(where, "model"), os.fspath(where)
    if (place / WEIGHTS).is_file() or ((place / CONFIG).is_file() and not (place / checkpoint.CHECKPOINT).is_file()):
        return _from_folder(place)
    if name in shipped():
        return _from_folder(SHIPPED / name)
    try:
        file = checkpoint.locate(name)
    except ViewnetError:
        if place.exists() or not HUB_ID.fullmatch(name):
            kinds = f"a model that comes with viewnet ({', '.join(shipped())}), a folder of save_pretrained, the folder"
            kinds += " or key of a finished run (viewnet train prints it), or NAME/MODEL of the Hugging Face hub"
            raise ViewnetError(f"{name}: no model there: expected {kinds}{nearest(name, shipped())}") from None
        return _from_folder(hub.download(name, [WEIGHTS, CONFIG], **hub_options))
    return _from_run(file)


def shipped() -> list[str]:
    """The categories whose models come with the package."""
    return sorted(path.parent.name for path in SHIPPED.glob(f"*/{WEIGHTS}"))


def device(name: str | torch.device | None) -> torch.device:
    """The device of this name; None: a GPU if there is one. ViewnetError for a device that is not available."""
    if name is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        named = torch.device(name)
        torch.empty(0, device=named)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise ViewnetError(f"device {name}: not available here ({checkpoint.first_line(error)})") from None
    return named


def _from_run(file: Path) -> Pretrained:
    path = file.parent / "result.json"
    config, result = checkpoint.config_of(file), read_json(path) if path.is_file() else {}
    if "metrics" not in result:
        raise ViewnetError(f"{file.parent}: the run is not finished: run viewnet train again to resume it")
    metrics = result["metrics"]
    alignment = None if metrics is None else model_card.own(metrics)["alignment"]
    if config.variant in ABSOLUTE:
        alignment = {"rotation": np.eye(3).tolist()}
    network = cast(ViewNet, registry.build(config, checkpoint.read(file)[0], file))  # a peer has its `viewpoint`
    about = {name: result[name] for name in RESULT if name in result}
    return Pretrained(network, config, _rotation(alignment, path), about)


def _from_folder(folder: Path) -> Pretrained:
    path, file = folder / CONFIG, folder / WEIGHTS
    if not path.is_file():
        raise ViewnetError(f"{folder}: no {CONFIG} in it: save the model again (save_pretrained)")
    values = read_json(path)
    if not isinstance(values, dict) or not isinstance(values.get("format"), int):
        raise ViewnetError(f"{folder}: neither a model of save_pretrained nor a finished run: train it to the end")
    if not file.is_file():
        raise ViewnetError(f"{folder}: no {WEIGHTS} in it: save the model again (save_pretrained)")
    if values["format"] != FORMAT:
        written = f"format {values['format']}, written by viewnet {values.get('viewnet', '?')}"
        raise ViewnetError(f"{path}: {written}: this version reads format {FORMAT}: install that one")
    if missing := [name for name in FIELDS if name not in values]:
        raise ViewnetError(f"{path}: {missing[0]!r} is missing: save the model again")
    try:
        config = RunConfig.from_dict(values["config"])
    except ViewnetError as error:
        raise ViewnetError(f"{path} is of another version of viewnet ({error}): install that one") from error
    weights, metadata = checkpoint.read(file, "save the model again")
    network = cast(ViewNet, registry.build(config, weights, file))  # as in _from_run
    if metadata.get("config") != identity_of(values):
        raise ViewnetError(f"{folder}: {WEIGHTS} was not saved with this {CONFIG}: save the model again")
    return Pretrained(network, config, _rotation(values["alignment"], path), values["about"])


def _rotation(alignment: dict[str, Any] | None, path: Path) -> np.ndarray | None:
    if alignment is None:
        return None
    with contextlib.suppress(KeyError, TypeError, ValueError):
        rotation = np.array(alignment["rotation"], dtype=np.float64).reshape(3, 3)
        if np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0:
            return rotation
    raise ViewnetError(f"{path}: its alignment is not a rotation: save the model again")


def save(model: Pretrained, folder: Path, license: str | None, half: bool, scores: Sequence[dict[str, Any]]) -> None:
    """Write the three files of a model, see ViewpointEstimator.save_pretrained.

    ViewnetError as `check_place`, for scores of another run, and for weights that half precision cannot hold.
    """
    check_place(folder)
    model.require_viewnet(f"saving to {folder}")
    config, about, rotation = _without_places(model.config), dict(model.about), model.annotated_from_model
    if scores:
        about["scores"] = [model_card.selected(values, about.get("key")) for values in scores]
    fitted = model_card.own(about.get("metrics") or {}).get("alignment") or {"kind": "procrustes"}
    values = {
        "format": FORMAT,
        "viewnet": importlib.metadata.version("viewnet"),
        "config": config.to_dict(),
        "alignment": None if rotation is None else {"kind": fitted["kind"], "rotation": rotation.tolist()},
        "about": about,
    }
    weights = {name: value.cpu().contiguous() for name, value in model.network.state_dict().items()}
    for name, value in weights.items() if half else ():
        if value.is_floating_point():
            weights[name] = value.half()
            if not weights[name].isfinite().all():
                raise ViewnetError(f"{name} holds values that half precision cannot: save the model without half")
    with replacing(folder / WEIGHTS) as temporary:
        save_file(weights, temporary, metadata={"config": identity_of(values)})
    write_json(folder / CONFIG, values)
    write_text(folder / CARD, model_card.card(config, model.aligned, about, license))


def check_place(folder: Path) -> None:
    """ViewnetError for a file, and for a folder of other files, some of which a model's might replace."""
    if folder.is_file():
        raise ViewnetError(f"{folder}: is a file: name a folder")
    if not (folder / WEIGHTS).is_file() and folder.is_dir() and any(p.name[0] != "." for p in folder.iterdir()):
        raise ViewnetError(f"{folder}: holds files and no saved model: name a new or an empty folder")


def _without_places(config: RunConfig) -> RunConfig:
    """A configuration that keeps only the last part of each path: folders of this machine are nobody else's."""

    def last(place: Any) -> Any:
        return place and (Path(place).name or place)

    data, train = config.data, config.train
    if (video := data.video) is not None:
        video = replace(video, root=last(video.root), mask_folder=last(video.mask_folder))
    places: dict[str, Any] = {name: last(getattr(data, name)) for name in ("root", "splits", "extra", "backgrounds")}
    return replace(config, data=replace(data, **places, video=video), train=replace(train, start=last(train.start)))
