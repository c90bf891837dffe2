"""Trained networks as folders: written for others, and read from a folder, a finished run or the Hugging Face hub.

    model.safetensors    the weights, in single or half precision; its metadata holds a digest of config.json
    config.json          format, version of the package, RunConfig, alignment, and where the weights come from
    README.md            a model card (viewnet.estimator.model_card)

The files, their names and what is called how are huggingface_hub's conventions (ModelHubMixin), but nothing of it is
needed for folders, and there is no way to a pickled file. Three such folders come with the package (`SHIPPED`), and
are known by their category.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from viewnet.config import RunConfig
from viewnet.errors import ViewnetError
from viewnet.model import checkpoint
from viewnet.model.viewnet import ViewNet
from viewnet.runtime.files import read_json, replacing, write_json, write_text

if TYPE_CHECKING:
    from viewnet.estimator.viewpoint_estimator import ViewpointEstimator

FORMAT = 1
WEIGHTS, CONFIG, CARD = "model.safetensors", "config.json", "README.md"
FIELDS = ("format", "viewnet", "config", "alignment", "about")
KEPT = ("key", "variant", "category", "profile", "recipe", "seed", "views", "metrics", "git")
"""What of a run's result goes along."""
SHIPPED = Path(__file__).parent / "models"
"""Folders that come with the package, called by their category."""
HUB_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[\w.-]+")


@dataclass(frozen=True)
class Hub:
    """How the hub is asked, as huggingface_hub.snapshot_download has it."""

    revision: str | None = None
    cache_dir: str | os.PathLike[str] | None = None
    token: str | bool | None = None
    force_download: bool = False
    local_files_only: bool = False


@dataclass(frozen=True)
class Pretrained:
    """A network, the rotation (3, 3) from its own frame to the annotated one, and what else is known of it."""

    network: ViewNet
    config: RunConfig
    rotation: np.ndarray | None
    about: dict[str, Any]


def load(where: str | os.PathLike[str], hub: Hub | None = None) -> Pretrained:
    """Of a saved folder, a finished run's folder or key, a category that comes with the package, or a hub id.

    ViewnetError for what is there in no such way.
    """
    place = Path(where).expanduser()
    if (place / WEIGHTS).is_file() or ((place / CONFIG).is_file() and not (place / checkpoint.CHECKPOINT).is_file()):
        return _of_folder(place)
    name = os.fspath(where)
    if name in shipped():
        return _of_folder(SHIPPED / name)
    try:
        found = checkpoint.locate(name)
    except ViewnetError:
        if place.exists() or not HUB_ID.fullmatch(name):
            raise ViewnetError(
                f"{name}: no model there: expected {'a model that comes with viewnet (' + ', '.join(shipped()) + '), '}"
                "a folder of save_pretrained, the folder or key of a finished run (viewnet train prints it), or "
                "NAME/MODEL of the Hugging Face hub"
            ) from None
        return _of_folder(_downloaded(name, hub or Hub()))
    return _of_run(found)


def shipped() -> list[str]:
    """The categories whose models come with the package."""
    return sorted(path.parent.name for path in SHIPPED.glob(f"*/{WEIGHTS}"))


def device(name: str | torch.device | None) -> torch.device:
    """The device of a name, a GPU if there is one for None. ViewnetError for one that cannot be had."""
    if name is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        found = torch.device(name)
        torch.empty(0, device=found)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise ViewnetError(f"device {name}: cannot be had here ({str(error).splitlines()[0]})") from None
    return found


def _of_run(file: Path) -> Pretrained:
    path = file.parent / "result.json"
    result = read_json(path) if path.is_file() else {}
    if "metrics" not in result:
        raise ViewnetError(f"{file.parent}: a run that is not finished: give the command that trains it again")
    config = checkpoint.config_of(file)
    metrics = result["metrics"]
    fitted = None if metrics is None else metrics["procrustes"]["alignment"]
    about = {name: result[name] for name in KEPT if name in result}
    network = checkpoint.build(config.model, checkpoint.read(file)[0], file)
    return Pretrained(network, config, _rotation(fitted, path), about)


def _of_folder(folder: Path) -> Pretrained:
    path = folder / CONFIG
    if not path.is_file():
        raise ViewnetError(f"{folder}: no {CONFIG} in it: save the model again (save_pretrained)")
    values = read_json(path)
    if not isinstance(values, dict) or not isinstance(values.get("format"), int):
        raise ViewnetError(f"{folder}: neither a model of save_pretrained nor a finished run: train it to the end")
    if not (folder / WEIGHTS).is_file():
        raise ViewnetError(f"{folder}: no {WEIGHTS} in it: save the model again (save_pretrained)")
    if values["format"] != FORMAT:
        raise ViewnetError(
            f"{path}: format {values['format']}, written by viewnet {values.get('viewnet', '?')}: this version reads "
            f"format {FORMAT}: install that one"
        )
    if missing_fields := [name for name in FIELDS if name not in values]:
        raise ViewnetError(f"{path}: {missing_fields[0]!r} is missing: save the model again")
    config = _config(values["config"], path)
    weights, metadata = checkpoint.read(folder / WEIGHTS, "save the model again")
    network = checkpoint.build(config.model, weights, folder / WEIGHTS)
    if metadata.get("config") != _digest(values):
        raise ViewnetError(f"{folder}: {WEIGHTS} was not saved with this {CONFIG}: save the model again")
    return Pretrained(network, config, _rotation(values["alignment"], path), values["about"])


def _config(values: Any, path: Path) -> RunConfig:
    try:
        return RunConfig.from_dict(values)
    except ViewnetError as error:
        raise ViewnetError(f"{path} is of another version of viewnet ({error}): install that one") from error


def _rotation(alignment: dict[str, Any] | None, path: Path) -> np.ndarray | None:
    if alignment is None:
        return None
    try:
        rotation = np.array(alignment["rotation"], dtype=np.float64).reshape(3, 3)
    except (KeyError, TypeError, ValueError):
        raise ViewnetError(f"{path}: its alignment is no rotation") from None
    if not (np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0):
        raise ViewnetError(f"{path}: its alignment is no rotation")
    return rotation


def save(
    estimator: ViewpointEstimator,
    folder: Path,
    license: str | None = None,
    half: bool = False,
    scores: Sequence[dict[str, Any]] = (),
) -> None:
    """See ViewpointEstimator.save_pretrained. Where data lay on this machine is left out but for the last name.

    ViewnetError where it cannot be written, and for scores of something else.
    """
    from viewnet.estimator import model_card

    if folder.is_file():
        raise ViewnetError(f"{folder}: is a file: name a folder")
    config, turned = placeless(estimator.config), estimator.turned
    about = dict(estimator.about)
    if scores:
        about["scores"] = [model_card.kept(found, about.get("key")) for found in scores]
    values = {
        "format": FORMAT,
        "viewnet": importlib.metadata.version("viewnet"),
        "config": config.to_dict(),
        "alignment": None if turned is None else {"kind": "procrustes", "rotation": turned.tolist()},
        "about": about,
    }
    weights = {name: value.cpu().contiguous() for name, value in estimator.network.state_dict().items()}
    if half:
        weights = {name: _halved(name, value) for name, value in weights.items()}
    with replacing(folder / WEIGHTS) as temporary:
        save_file(weights, temporary, metadata={"config": _digest(values)})
    write_json(folder / CONFIG, values)
    write_text(folder / CARD, model_card.card(config, estimator.aligned, about, license))


def _halved(name: str, value: Tensor) -> Tensor:
    if not value.is_floating_point():
        return value
    found = value.half()
    if not found.isfinite().all():
        raise ViewnetError(f"{name} holds values that half precision does not: save the model without half")
    return found


def placeless(config: RunConfig) -> RunConfig:
    """A configuration without the folders of a machine: of a path the last name is left."""
    data = config.data
    video = None if data.video is None else replace(data.video, root=_last(data.video.root))
    data = replace(
        data,
        root=_last(data.root),
        splits=_last(data.splits),
        extra=_last(data.extra),
        backgrounds=_last(data.backgrounds),
        video=video,
    )
    return replace(config, data=data, train=replace(config.train, start=_last(config.train.start)))


def _last(place: str | None) -> str | None:
    return None if place is None else Path(place).name or place


def push(
    folder: Path,
    repo_id: str,
    *,
    commit_message: str = "Upload a ViewNet model",
    private: bool | None = None,
    token: str | None = None,
    branch: str | None = None,
    create_pr: bool | None = None,
) -> str:
    """A saved folder to the hub; returns the address of the commit. ViewnetError where that does not work."""
    library = _library(repo_id)

    def upload() -> str:
        api = library.HfApi(token=token)
        name = api.create_repo(repo_id=repo_id, private=private, exist_ok=True).repo_id
        return str(
            api.upload_folder(
                repo_id=name,
                folder_path=folder,
                commit_message=commit_message,
                revision=branch,
                create_pr=create_pr,
                allow_patterns=[WEIGHTS, CONFIG, CARD],
            )
        )

    return _asked(repo_id, upload, "takes no model")


def _downloaded(name: str, hub: Hub) -> Path:
    library = _library(name)
    return Path(_asked(name, lambda: library.snapshot_download(name, allow_patterns=[WEIGHTS, CONFIG], **asdict(hub))))


def _library(name: str) -> Any:
    try:
        import huggingface_hub
    except ImportError:
        raise ViewnetError(
            f'{name}: no such folder, and for the Hugging Face hub: pip install "viewnet[hub]"'
        ) from None
    return huggingface_hub


def _asked(name: str, ask: Callable[[], str], refusal: str = "gives no such model") -> str:
    try:
        return ask()
    except Exception as error:  # its own errors, and those of whichever HTTP library it uses
        raise ViewnetError(
            f"{name}: the Hugging Face hub {refusal} ({type(error).__name__}: {checkpoint.first_line(error)})"
        ) from error


def _digest(values: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]
