"""The Hugging Face hub: downloads and uploads of saved models. Needs `pip install "viewnet[hub]"`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from viewnet.errors import ViewnetError
from viewnet.model.checkpoint import first_line


def download(name: str, files: Sequence[str], **options: Any) -> Path:
    """The local folder of the model NAME/MODEL; `options` are those of huggingface_hub.snapshot_download.

    ViewnetError without huggingface_hub, and where the hub has no such model or cannot be reached.
    """
    return Path(_request(name, lambda hub: hub.snapshot_download(name, allow_patterns=list(files), **options)))


def push(folder: Path, repo_id: str, files: Sequence[str], private: bool | None = None, **options: Any) -> str:
    """Upload these files of a folder and return the address of the commit. ViewnetError where that does not work.

    `options` are `token`, `branch`, and those of huggingface_hub's upload_folder, such as commit_message and create_pr.
    """
    token = options.pop("token", None)
    commit = {"commit_message": "Upload a ViewNet model", "revision": options.pop("branch", None), **options}

    def upload(hub: Any) -> str:
        api = hub.HfApi(token=token)
        name = api.create_repo(repo_id=repo_id, private=private, exist_ok=True).repo_id
        return str(api.upload_folder(repo_id=name, folder_path=folder, allow_patterns=list(files), **commit))

    return _request(repo_id, upload, "takes no model")


def _request(name: str, request: Callable[[Any], str], refusal: str = "gives no such model") -> str:
    """What a request to the library returns."""
    try:
        import huggingface_hub
    except ImportError:
        problem = 'no such folder, and for the Hugging Face hub: pip install "viewnet[hub]"'
        raise ViewnetError(f"{name}: {problem}") from None
    try:
        return request(huggingface_hub)
    except Exception as error:  # its own errors, and those of whichever HTTP library it uses
        problem = f"{type(error).__name__}: {first_line(error)}"
        raise ViewnetError(f"{name}: the Hugging Face hub {refusal} ({problem})") from error
