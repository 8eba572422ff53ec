"""Read a plan's CSV or arrays as a table of columns, before the columns are interpreted.

Cells are separated by comma, semicolon (then 0,5 is a number) or tab. Lines with # are comments,
except the declarations `# scheme: ..` and `# hold: ..`. A column may have a unit: `q1 [m]`.
"""

from __future__ import annotations

import csv
import math
import numbers
import re
import reprlib
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import TrajectoryError, nearest
from models.schemes import Scheme

# Characters around a comment: quotes, separators, blanks.
_AROUND = "\"',; \t"
# A number; float() would also accept 1_0 and digits of other alphabets.
_NUMBER = re.compile(
    r"\s*[+-]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|nan|inf|infinity)\s*",
    re.IGNORECASE | re.ASCII,
)
# Kinds of numpy's real types.
_REAL = "biuf"
# Kinds whose values must be checked one by one.
_MIXED = "OUS"
# First bytes of other file types. A folder has no bytes; this stands for them.
_FOLDER = b"\0folder"
_OTHERS = {
    _FOLDER: "a folder", b"<": "HTML or XML", b"{": "JSON", b"[": "JSON",
    b"PK\x03\x04": "a zip archive, as .npz and .xlsx are",
    b"\x93NUMPY": "an array of NumPy", b"\x89HDF": "HDF5, as NetCDF is",
    b"MATLAB": "a file of MATLAB", b"PAR1": "Parquet",
}  # fmt: skip
# Keys of declarations, and their values.
_DECLARED = {"scheme": tuple(scheme.value for scheme in Scheme), "hold": ("zero", "linear")}


class PlanTable:
    """A plan's table.

    names: of the columns, without units
    given: names of columns that are not empty
    units: by name, if stated
    rows: number of rows
    declared: declarations by key
    """

    def __init__(self, path: Path, ignore: Sequence[str] = ()) -> None:
        self.source, self.where = f"file {path}", f"plan {path}"
        rows, self.declared = _rows(path)
        if len(rows) < 3:
            below = max(len(rows) - 1, 0)
            raise TrajectoryError(
                f"plan {path}: it has {below} row{'' if below == 1 else 's'}; a header and at least two rows are needed."
            )
        number, below = rows[1]
        apart = [cell for cell in re.split(r"[\s|]+", below[0]) if cell]
        if len(rows[0][1]) == len(below) == 1 and len(apart) > 1 and all(map(_is_number, apart)):
            raise TrajectoryError(
                f"plan {path}: line {number} has its {len(apart)} cells apart by spaces or bars; separate cells by comma, semicolon or tab."
            )
        if all(map(_is_number, rows[0][1])):
            raise TrajectoryError(
                f"plan {path}: its first line holds numbers; a header with the columns' names is needed above them."
            )
        self._rows = rows[1:]
        self.rows = len(self._rows)
        head = rows[0][1]
        while head and not head[-1] and not any("".join(row[len(head) - 1 :]) for _, row in rows):
            head = head[:-1]  # trailing commas
        self.units: dict[str, str] = {}
        names = []
        clock = _clock(_name_and_unit(cell)[0] for cell in head)
        for cell in head:
            name, unit = _name_and_unit(cell)
            name = "t" if name == clock else name
            names.append(name)
            if unit is not None:
                self.units[name] = unit
        self._head = tuple(names)
        self._check_form()
        for name in ignore:
            if name not in names:
                raise TrajectoryError(
                    f"{self.where}: there is no column {name!r} to ignore; it has {', '.join(names)}."
                )
        self.names = tuple(name for name in names if name not in ignore)
        self.given = tuple(
            name
            for name in self.names
            if any("".join(row[names.index(name) :][:1]) for _, row in self._rows)
        )

    def has_last(self, name: str) -> bool:
        """Return whether the last row has a cell in this column."""
        index, row = self._head.index(name), self._rows[-1][1]
        return index < len(row) and bool(row[index])

    def _check_form(self) -> None:
        for name in self._head:
            if not name:
                place = self._head.index(name) + 1
                advice = (
                    "an index, as pandas writes it, is left out by index=False"
                    if place == 1
                    else "name it in the first line, or delete it"
                )
                raise TrajectoryError(f"{self.where}: column {place} has no name; {advice}.")
            if self._head.count(name) > 1:
                raise TrajectoryError(f"{self.where}: the column {name!r} appears twice.")
        for number, row in self._rows:
            if any(row[len(self._head) :]):
                raise TrajectoryError(
                    f"{self.where}: line {number} has {len(row)} cells, but there are {len(self._head)} columns."
                )

    def check_unit(self, name: str, *units: str) -> None:
        """Raise TrajectoryError if the column's stated unit is not one of these."""
        given = self.units.get(name, units[0])
        if given not in units:
            raise TrajectoryError(
                f"{self.where}: the column {name!r} is in {given!r}, but {units[0]!r} is expected; convert it."
            )

    def column(self, name: str, last_is_open: bool) -> np.ndarray:
        """Return the numbers (rows,) or (rows - 1,) of a column, in its unit [SI].

        last_is_open: the last row begins no step, and is left out. Raises TrajectoryError for a
            cell that
        is no finite number.
        """
        index = self._head.index(name)
        values = []
        for place, (number, row) in enumerate(self._rows, start=1):
            cell = row[index] if index < len(row) else ""
            if last_is_open and place == self.rows:
                break
            if not _is_number(cell):
                found = f"{cell!r} is not a number" if cell.strip() else "the cell is empty"
                raise TrajectoryError(f"{self.where}: line {number}, column {name!r}: {found}.")
            values.append(float(cell))
            if not math.isfinite(values[-1]):
                raise TrajectoryError(
                    f"{self.where}: line {number}, column {name!r}: {cell!r} is not a finite number."
                )
        return np.array(values)


def _name_and_unit(cell: str) -> tuple[str, str | None]:
    """Return name and unit of a header cell: `q1 [m]` or `q1 (m)`; q[1] and der(q) are FMU names.

    Names are in Unicode's composed form, because umlauts have two encodings.
    """
    cell = re.sub(r"(?<=\S)\s+\(([^()]*)\)$", r" [\1]", cell)
    split = re.fullmatch(r"(.*?)(\s*)\[([^\[\]]*)\]", cell)
    if split is None or (not split.group(2) and re.fullmatch(r"\d+(\s*,\s*\d+)*", split.group(3))):
        return unicodedata.normalize("NFC", cell), None
    return unicodedata.normalize("NFC", split.group(1)), split.group(3).strip()


def _rows(path: Path) -> tuple[list[tuple[int, list[str]]], dict[str, str]]:
    """Return (line number, cells) of the non-empty lines, and the declarations."""
    try:
        data = _FOLDER if path.is_dir() else path.read_bytes()
        for start, what in _OTHERS.items():
            if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(start):
                known = "a plan is a CSV file; of a scene, but not of an FMU, also a NetCDF file called .nc (docs/replay.md)"
                raise TrajectoryError(f"plan {path}: it is {what}; {known}.")
        text = data.decode("utf-8-sig")  # Excel's byte order mark
    except OSError as error:
        raise TrajectoryError(
            f"plan {path}: it cannot be read ({error.strerror or error})."
        ) from error
    except UnicodeDecodeError as error:
        raise TrajectoryError(
            f"plan {path}: it is not text in UTF-8 (byte {error.start} is none of it); save it as CSV in UTF-8."
        ) from error
    numbered = [
        (number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()
    ]
    # Spreadsheets save a comment as a quoted cell, followed by empty cells.
    bare = [(number, line.strip(_AROUND)) for number, line in numbered]
    comments = [(number, line) for number, line in bare if line.startswith("#")]
    lines = [numbered[place] for place, (_, line) in enumerate(bare) if not line.startswith("#")]
    header_line = lines[0][0] if lines else 0
    declared = _declarations(path, [item for item in comments if item[0] < header_line])
    for number, line in comments:
        if number > header_line and _declarations(path, [(number, line)]):
            raise TrajectoryError(
                f"plan {path}: line {number}: {line!r} stands below the header; move it above, where it declares."
            )
    header = re.sub(r'"[^"]*"', "", lines[0][1]) if lines else ""
    mark = next((mark for mark in ";\t" if mark in header), ",")
    rows = [(number, _cells(path, number, line, mark)) for number, line in lines]
    if mark == ";":
        rows[1:] = [(number, [cell.replace(",", ".") for cell in row]) for number, row in rows[1:]]
    return rows, declared


def _declarations(path: Path, comments: list[tuple[int, str]]) -> dict[str, str]:
    """Return the declarations among comments `# key: value`.

    Raises TrajectoryError for a known value with a misspelt key, or without a separator.
    """
    declared: dict[str, str] = {}
    for number, line in comments:
        match = re.fullmatch(r"#+\s*([A-Za-z_]+)(\s*[:=]\s*|\s+)(.*?)", line)
        if match is None:
            continue
        key, mark, value = match.group(1).lower(), match.group(2).strip(), match.group(3)
        if not mark:
            if value.lower() in _DECLARED.get(key, ()):
                raise TrajectoryError(
                    f"plan {path}: line {number}: {line!r} declares nothing; write '# {key}: {value}'."
                )
            continue
        if key not in _DECLARED:
            near = nearest(key, _DECLARED, 0.7)
            if near is not None and value.lower() in _DECLARED[near]:
                raise TrajectoryError(
                    f"plan {path}: line {number}: there is no {match.group(1)!r} to declare; did you mean {near!r}?"
                )
            continue
        if declared.get(key, value) != value:
            raise TrajectoryError(
                f"plan {path}: line {number}: it declares the {key} {value!r}, but {declared[key]!r} before."
            )
        declared[key] = value
    return declared


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _cells(path: Path, number: int, line: str, mark: str) -> list[str]:
    try:
        return [
            cell.strip() for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True))
        ]
    except csv.Error as error:
        raise TrajectoryError(
            f"plan {path}: line {number} cannot be read ({error}); separate its cells by {mark!r}."
        ) from error


def real_numbers(what: str, values: Any) -> np.ndarray:
    """Return a copy as floats (any,) [SI] that changes no number.

    values may be booleans, integers, reals, or objects and text of these; None and pandas' NA
    become NaN. Raises TrajectoryError for complex numbers, masked values, dates and durations.
    """
    if callable(detach := getattr(values, "detach", None)):  # a PyTorch tensor
        tensor: Any = detach()
        values = tensor.cpu()
    try:
        array = np.asanyarray(values)
    except (TypeError, ValueError) as error:
        raise TrajectoryError(
            f"plan: {what} must be numbers, in rows of equal length ({error})."
        ) from error
    # Masked arrays need numpy.ma, whose import takes 10 ms.
    if "numpy.ma" in sys.modules and np.ma.is_masked(array):
        raise TrajectoryError(
            f"plan: {what} has masked values, which are no numbers; fill them, or leave the column out."
        )
    if array.dtype.kind in _MIXED:
        return np.array([_real(what, cell) for cell in array.flat], dtype=float).reshape(
            array.shape
        )
    if array.dtype.kind not in _REAL:
        raise TrajectoryError(
            f"plan: {what} is of type {array.dtype}, but must be real numbers; convert it."
        )
    return np.array(array, dtype=float)


def _real(what: str, cell: Any) -> float:
    text = (
        cell.decode("ascii", "replace")
        if isinstance(cell, bytes)
        else str(cell)
        if isinstance(cell, str)
        else cell
    )
    if text is None or type(text).__name__ == "NAType":  # pandas' NA
        return math.nan
    if isinstance(text, (numbers.Real, np.bool_, Decimal)) or (
        isinstance(text, str) and _is_number(text)
    ):
        return float(text)
    raise TrajectoryError(f"plan: {what} must be real numbers, but holds {reprlib.repr(text)}.")


def _one_row(values: np.ndarray) -> np.ndarray:
    """Return (n, 1) and (1, n) as (n,), other shapes unchanged."""
    return values.ravel() if values.ndim == 2 and 1 in values.shape else values


def _clock(names: Iterable[Any]) -> str | None:
    """Return the column that is read as t: the only one called time, in any case, without a t."""
    each = [name for name in names if isinstance(name, str)]
    times = [name for name in each if name.lower() == "time"]
    return times[0] if len(times) == 1 and "t" not in map(str.lower, each) else None


class ArrayTable:
    """A table of arrays by column names: a mapping, a pandas DataFrame or a structured array.

    Inputs and forces may be one shorter than `t`, or end in NaN. declared: scheme and hold.
    """

    def __init__(self, columns: Any, **declared: Any) -> None:
        self.where, self.source = "plan", "arrays"
        self.declared = {key: value for key, value in declared.items() if value is not None}
        self.units: dict[str, str] = {}
        if isinstance(columns, np.ndarray):
            if columns.dtype.names is None:
                raise TrajectoryError(
                    f"plan: an array of shape {columns.shape} has no column names; give {{'t': array[:, 0], ..}}."
                )
            columns = {name: columns[name] for name in columns.dtype.names}
        if hasattr(columns, "reset_index") and _clock(columns) is None and "t" not in columns:
            if str(columns.index.name).lower() in ("t", "time"):
                columns = columns.reset_index()
            elif type(columns.index).__name__ != "RangeIndex":
                raise TrajectoryError(
                    "plan: the column 't' is missing; if the index is the time in s, give plan.reset_index(names='t')."
                )
        names = list(columns.columns if hasattr(columns, "columns") else columns)
        for name in names:
            if not isinstance(name, str):
                raise TrajectoryError(
                    f"plan: a column is called {name!r}, but its name must be text."
                )
            if names.count(name) > 1:
                raise TrajectoryError(f"plan: the column {name!r} appears twice.")
        clock = _clock(names)
        self._columns = {
            "t" if name == clock else name: _one_row(
                real_numbers(f"the column {name!r}", columns[name])
            )
            for name in names
        }
        self.names = tuple(self._columns)
        self.given = tuple(
            name for name, values in self._columns.items() if not np.isnan(values).all()
        )
        for name, values in self._columns.items():
            if values.ndim != 1:
                raise TrajectoryError(
                    f"plan: the column {name!r} has shape {values.shape}, but must be one row of numbers."
                )
        self.rows = (
            len(self._columns["t"])
            if "t" in self._columns
            else max(map(len, self._columns.values()), default=0)
        )
        if self.rows < 2:
            raise TrajectoryError(
                f"plan: it has {self.rows} row{'' if self.rows == 1 else 's'}; at least two are needed."
            )

    def has_last(self, name: str) -> bool:
        """Return whether the column has a number at the last time."""
        values = self._columns[name]
        return len(values) == self.rows and bool(np.isfinite(values[-1]))

    def check_unit(self, name: str, *units: str) -> None:
        """Do nothing: arrays have no units."""

    def column(self, name: str, last_is_open: bool) -> np.ndarray:
        """Return the numbers (rows,) or (rows - 1,) [SI] of a column.

        last_is_open: the last number may be missing, and is left out. Raises TrajectoryError for
            another
        length, or values that are not finite.
        """
        values = self._columns[name]
        expected = self.rows - 1 if last_is_open else self.rows
        if len(values) not in (expected, self.rows):
            raise TrajectoryError(
                f"plan: the column {name!r} has {len(values)} numbers, but t has {self.rows}."
            )
        values = values[:expected]
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise TrajectoryError(
                f"plan: column {name!r}, row {int(bad[0])}: {values[bad[0]]} is not a finite number."
            )
        return values


# A plan by columns.
Table = PlanTable | ArrayTable


def lack_of(table: Table, name: str) -> str:
    """Return a clause on a missing or empty column."""
    return f"the column {name!r} is {'empty' if name in table.names else 'missing'}"
