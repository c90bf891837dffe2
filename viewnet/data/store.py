"""View stores: folders of RGBA views with their index, which training and evaluation read.

    views.npy       (N, H, W, 4) uint8, straight alpha, read as a memory map
    index.parquet   one row a view, in the same order (COLUMNS)
    meta.json       format, identity, what decided the views (`made_by`), versions
    rejected.csv    model_id, path, reason of what cannot be used

All views of a model are in consecutive rows, ordered by view. A view without an annotated viewpoint has NaN for both
azimuth and elevation: it can be trained on, but not scored.
"""

import contextlib
import hashlib
import json
import platform
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viewnet.errors import ViewnetError
from viewnet.runtime.files import filling, load_array, locked, read_csv, read_json

if TYPE_CHECKING:
    # Slow to import, and predicting a viewpoint imports this module but opens no store.
    import pandas as pd

FORMAT = 1
COLUMNS = {
    "model_id": "text",
    "category": "text",
    "split": "text",
    "view": "whole numbers",
    "azimuth": "degrees in [0, 360)",
    "elevation": "degrees in [-90, 90]",
    "source": "text",
}
REJECTED = ("model_id", "path", "reason")
Rejected = tuple[str, str, str]  # something that cannot be used: its id, its path within the data set, and the reason
_AGAIN = "remove the folder and build the store again"


@dataclass(frozen=True)
class ViewStore:
    """An open view store. `images` (N, H, W, 4) uint8 is a read-only memory map, `index` has a row for each of them."""

    folder: Path
    images: np.ndarray
    index: "pd.DataFrame"
    meta: dict[str, Any]

    @classmethod
    def open(cls, folder: Path | str) -> "ViewStore":
        """Open and check a store. Raises ViewnetError naming the file and what is wrong with it."""
        import pandas as pd

        folder = Path(folder)
        if not folder.is_dir():
            raise ViewnetError(f"{folder}: no such view store: make it first (viewnet.data.build.view_store)")
        for name in ("views.npy", "index.parquet", "meta.json", "rejected.csv"):
            if not (folder / name).is_file():
                raise ViewnetError(f"{folder / name}: missing from the view store: {_AGAIN}")
        meta = _read_meta(folder / "meta.json")
        images = load_array(folder / "views.npy", _AGAIN, mmap_mode="r")
        if images.dtype != np.uint8 or images.ndim != 4 or images.shape[3] != 4 or min(images.shape) < 1:
            wrong = f"{images.dtype} {images.shape}: expected uint8 (N, H, W, 4)"
            raise ViewnetError(f"{folder / 'views.npy'}: {wrong}: {_AGAIN}")
        try:
            index = pd.read_parquet(folder / "index.parquet")
        except Exception as error:  # The parquet reader raises its own types on damaged files.
            problem = f"cannot be read ({type(error).__name__})"
            raise ViewnetError(f"{folder / 'index.parquet'}: {problem}: {_AGAIN}") from None
        check_index(index, len(images), folder / "index.parquet")
        return cls(folder, images, index, meta)

    @property
    def identity(self) -> str:
        """16 hex digits of everything that decided the views."""
        return str(self.meta["identity"])

    @property
    def rejected(self) -> "pd.DataFrame":
        """What cannot be used: model_id, path, reason. ViewnetError for a damaged list."""
        return read_csv(self.folder / "rejected.csv", REJECTED, dtype=str, keep_default_na=False)

    def split(self, name: str) -> np.ndarray:
        """Row numbers (n,) of the views of a split. Raises ViewnetError where it has none."""
        rows = np.flatnonzero((self.index["split"] == name).to_numpy())
        if not len(rows):
            names = ", ".join(sorted(self.index["split"].unique()))
            raise ViewnetError(f"{self.folder}: no views in split {name!r} (only {names}): use another, or more models")
        return rows

    def require_viewpoints(self, splits: Iterable[str], otherwise: str) -> None:
        """Raise ViewnetError where views of these splits have no annotated viewpoint; `otherwise` ends its message."""
        rows = self.index["split"].isin(list(splits))
        if missing := int(self.index.loc[rows, "azimuth"].isna().sum()):
            names = " and ".join(splits)
            count = int(rows.sum())
            raise ViewnetError(f"{self.folder}: {missing} of {count} views of {names} have no viewpoint: {otherwise}")

    def __len__(self) -> int:
        return len(self.images)


def within(path: Path, root: Path) -> str:
    """A path within its data set, as lists of what cannot be used have it."""
    return path.relative_to(root).as_posix()


@contextlib.contextmanager
def rejecting(rejected: list[Rejected], name: str, path: str) -> Iterator[None]:
    """A ViewnetError in the block is the reason why `name`, in `path` within its data set, joins what is `rejected`."""
    try:
        yield
    except ViewnetError as error:
        rejected.append((name, path, str(error)))


def tally(reasons: Iterable[str]) -> dict[str, int]:
    """Reason, without its details in brackets -> how often it occurs."""
    return dict(Counter(reason.split(" (")[0] for reason in reasons))


def in_words(counts: Mapping[str, int]) -> str:
    """Counts for a message: "3 mask is missing, 1 frame annotated twice"."""
    return ", ".join(f"{count} {reason}" for reason, count in counts.items())


def identity_of(made_by: Any) -> str:
    """16 hex digits that name what `made_by` (JSON values) describes."""
    return hashlib.sha256(json.dumps(made_by, sort_keys=True).encode()).hexdigest()[:16]


def made_once(folder: Path, make: Callable[[], object]) -> Path:
    """`folder`, which `make` makes where it is missing; of several processes one makes it and the others wait."""
    if not folder.exists():  # before any lock, for which the folder about it may not be writable
        with locked(folder):
            if not folder.exists():
                make()
    return folder


def filled_once(folder: Path, fill: Callable[[Path], object]) -> Path:
    """`made_once` by a function that fills a temporary folder, so that `folder` appears whole."""

    def make() -> None:
        with filling(folder) as temporary:
            fill(temporary)

    return made_once(folder, make)


def write_store(
    folder: Path,
    batches: Iterable[np.ndarray],
    index: "pd.DataFrame",
    made_by: dict[str, Any],
    rejected: Iterable[Rejected] = (),
) -> "ViewStore":
    """Write a store to `folder` from batches (n, H, W, 4) uint8 in the order of `index`, and open it.

    `made_by` (JSON values) holds everything that decided the views. Raises ViewnetError where `folder` exists, the
    index is not valid, batches and index differ in length, and where the disk is full.
    """
    import pandas as pd

    if folder.exists():
        raise ViewnetError(f"{folder}: exists already: remove it or name another folder")
    check_index(index, len(index), folder / "index.parquet")
    with filling(folder) as temporary:
        _write_images(temporary / "views.npy", batches, len(index), folder)
        index.to_parquet(temporary / "index.parquet", index=False)
        table = pd.DataFrame(rejected, columns=list(REJECTED))
        table.to_csv(temporary / "rejected.csv", index=False, lineterminator="\n")
        versions = {"python": platform.python_version(), "numpy": np.__version__}
        meta = {"format": FORMAT, "identity": identity_of(made_by), "made_by": made_by, "versions": versions}
        (temporary / "meta.json").write_text(json.dumps(meta, indent=2) + "\n", encoding="utf-8")
    return ViewStore.open(folder)


def _write_images(file: Path, batches: Iterable[np.ndarray], count: int, folder: Path) -> None:
    # Not through a memory map: a full disk would kill the process without a message.
    shape: tuple[int, ...] | None = None
    done = 0
    with file.open("wb") as target:
        for batch in batches:
            if not len(batch):
                continue
            if shape is None:
                shape = batch.shape[1:]
                header = {"descr": "|u1", "fortran_order": False, "shape": (count, *shape)}
                np.lib.format.write_array_header_1_0(target, header)
            if batch.shape[1:] != shape or batch.dtype != np.uint8:
                raise ViewnetError(f"{folder}: views {batch.dtype} {batch.shape[1:]} among others of uint8 {shape}")
            done += len(batch)
            if done > count:
                raise ViewnetError(f"{folder}: more views than the {count} rows of the index")
            target.write(np.ascontiguousarray(batch).data)
    if done != count or not count:
        raise ViewnetError(f"{folder}: {done} views for the {count} rows of the index")


def check_index(index: "pd.DataFrame", count: int, file: Path) -> None:
    """Raise ViewnetError unless `index` is a valid index of `count` views; `file` is named in the message."""
    import pandas as pd

    if missing := [name for name in COLUMNS if name not in index.columns]:
        raise ViewnetError(f"{file}: no column {missing[0]}: {_AGAIN}")
    if unknown := [str(name) for name in index.columns if name not in COLUMNS]:
        raise ViewnetError(f"{file}: unknown column {unknown[0]}: expected {', '.join(COLUMNS)}")
    if len(index) != count:
        raise ViewnetError(f"{file}: {len(index)} rows for {count} views: {_AGAIN}")
    for name, expected in COLUMNS.items():
        column = index[name]
        if expected == "text":
            good = column.map(lambda value: isinstance(value, str))
        elif name == "view":
            good = pd.Series(pd.api.types.is_integer_dtype(column), index=index.index)
        elif not pd.api.types.is_float_dtype(column):
            good = pd.Series(False, index=index.index)
        else:
            good = (column >= 0) & (column < 360) if name == "azimuth" else column.abs() <= 90
            good |= index[["azimuth", "elevation"]].isna().all(axis=1)
        if not good.all():
            row = int(np.flatnonzero(~good.to_numpy())[0])
            raise ViewnetError(f"{file}: {name} {column.iloc[row]!r} in row {row}: expected {expected}: {_AGAIN}")
    model, view = index["model_id"].to_numpy(), index["view"].to_numpy()
    begins = np.append(True, model[1:] != model[:-1])[: len(index)]
    if begins.sum() != index["model_id"].nunique() or (np.diff(view)[~begins[1:]] <= 0).any():
        raise ViewnetError(f"{file}: the views of a model are not in consecutive rows in order: {_AGAIN}")


def _read_meta(file: Path) -> dict[str, Any]:
    try:
        meta = read_json(file)
        fields = meta["format"], meta["identity"], dict(meta["made_by"])
    except ViewnetError as error:
        raise ViewnetError(f"{error}: {_AGAIN}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ViewnetError(f"{file}: not a view store's description ({type(error).__name__}): {_AGAIN}") from None
    if fields[0] != FORMAT:
        raise ViewnetError(f"{file}: format {fields[0]}: this version reads format {FORMAT}: {_AGAIN}")
    if fields[1] != identity_of(fields[2]):
        raise ViewnetError(f"{file}: its identity does not match its made_by: {_AGAIN}")
    return meta
