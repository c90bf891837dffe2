"""Lists that people bring, as spreadsheets write them."""

import codecs
import csv
import io
import re
import unicodedata
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from viewnet.errors import ViewnetError

SEPARATORS = ",;\t"
DECIMAL = re.compile(r"[-+]?\d*,(\d+)(?:[eE][-+]?\d+)?")


def read_list(path: Path, columns: Sequence[str], numeric: Callable[[str], bool] = lambda name: False) -> Any:
    """The rows of a CSV file as a DataFrame of text, indexed by their lines in the file; empty cells are "".

    Separated by commas, semicolons or tabs, with or without a byte order mark, UTF-16 with one. Numbers of the columns
    that are `numeric` get a decimal point for their comma. Rows without any text are not there. Raises ViewnetError for
    a file that cannot be read or lacks one of `columns` and, naming the line, for what is ambiguous.
    """
    # pandas is slow to import and rendering processes import this module too.
    import pandas as pd

    if path.is_char_device():  # such as /dev/zero, without an end
        raise ViewnetError(f"{path}: is a device: name a file")
    try:
        content = path.read_bytes()
        marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        lines = io.StringIO(content.decode("utf-16" if marked else "utf-8-sig"), newline="")
    except FileNotFoundError:
        raise ViewnetError(f"{path}: no such file") from None
    except (OSError, UnicodeError) as error:
        raise ViewnetError(f"{path}: not a readable CSV file ({error}): save it as CSV UTF-8") from None
    titles, above = lines.readline(), 1
    if titles.lower().startswith("sep="):  # a line for Excel
        titles, above = lines.readline(), 2
    if not titles.strip():
        raise ViewnetError(f"{path}: not a readable CSV file (it has no header)")
    rows: dict[int, dict[str, str]] = {}
    number = above
    try:
        headers = {mark: [name.strip() for name in next(csv.reader([titles], delimiter=mark))] for mark in SEPARATORS}
        mark = max(SEPARATORS, key=lambda mark: sum(name in headers[mark] for name in columns))
        header = headers[mark]
        if missing := [name for name in columns if name not in header]:
            expected = f"expected {', '.join(columns)}, separated by commas, semicolons or tabs"
            raise ViewnetError(f"{path}: column {missing[0]!r} is missing: {expected}")
        if twice := [name for name in header if name and header.count(name) > 1]:
            raise ViewnetError(f"{path}: column {twice[0]!r} is there twice")
        reader = csv.reader(lines, delimiter=mark, strict=True)
        for cells in reader:
            number = above + reader.line_num
            if any(cell.strip() for cell in cells[len(header) :]):
                widths = f"{len(cells)} values in {len(header)} columns"
                raise ViewnetError(f"{path}: line {number}: {widths}: put values with {mark!r} in them into quotes")
            cells += [""] * (len(header) - len(cells))
            row = {name: cell.strip() for name, cell in zip(header, cells, strict=False) if name}
            for name in filter(numeric, row):
                row[name] = _pointed(row[name], mark, f"{path}: line {number}: {name}")
            if any(row.values()):
                rows[number] = row
    except csv.Error as error:
        raise ViewnetError(f"{path}: line {number + 1}: not a readable CSV file ({error})") from None
    return pd.DataFrame.from_dict(rows, orient="index", columns=[name for name in header if name], dtype=str)


def _pointed(cell: str, mark: str, where: str) -> str:
    """A number with a decimal comma, with a point instead; all else as it is."""
    if (found := DECIMAL.fullmatch(cell)) is None:
        return cell
    if mark == "," and len(found[1]) == 3:  # where commas separate values, numbers have points
        raise ViewnetError(f"{where} {cell!r}: may mean thousands or thousandths: write a decimal point, or none")
    return cell.replace(",", ".")


def one_form(name: str) -> str:
    """A name in the one form of Unicode, which has several for letters with accents: files of macOS have another."""
    return unicodedata.normalize("NFC", name)
