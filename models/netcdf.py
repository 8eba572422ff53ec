"""Named columns with units in a NetCDF-4 file: what plans and replays are stored as.

    write_columns(path, [Column(name="q1", dimension="node", values=q1, unit="m")], {"scene": "three_cart"})
    columns, attributes = read_columns(path)

A file is written beside its place, flushed to disk and renamed, so that a reader never sees half of
it.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.errors import MachineError, TrajectoryError


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """One variable (n,) along `dimension`, with its unit and meaning."""

    name: str
    dimension: str
    values: np.ndarray
    unit: str
    description: str = ""


def as_columns(
    named: Iterable[tuple[str, str, str]], values: np.ndarray, dimension: str
) -> list[Column]:
    """The columns of an array.

    Parameters
    ----------
    named
        Name, unit and description of each.
    values
        (n, columns), each in its own unit [SI].
    dimension
        Along which they lie.

    Returns
    -------
    list[Column]
        One (n,) for each name.

    Raises
    ------
    ValueError
        For another number of columns than names.
    """
    return [
        Column(name=name, dimension=dimension, values=column, unit=unit, description=text)
        for (name, unit, text), column in zip(named, values.T, strict=True)
    ]


def write_columns(
    path: Path, columns: Iterable[Column], attributes: Mapping[str, str | int | float]
) -> None:
    """Write atomically. Raises MachineError where the folder cannot be written."""
    columns = tuple(columns)
    sizes: dict[str, int] = {}
    for column in columns:
        if sizes.setdefault(column.dimension, len(column.values)) != len(column.values):
            raise ValueError(
                f"column {column.name}: {len(column.values)} values along {column.dimension}, which has {sizes[column.dimension]}."
            )
    content = _content(columns, sizes, attributes)
    part = None
    try:
        with tempfile.NamedTemporaryFile(
            prefix=f".{path.name}.", suffix=".tmp", dir=path.parent, delete=False
        ) as file:
            part = Path(file.name)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.chmod(0o644)  # it is made private; a store is shared
        part.replace(path)
    except OSError as error:
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink()
        advice = (
            "choose a folder that exists and may be written"
            if part is None
            else "make room or permit it, or write elsewhere"
        )
        raise MachineError(
            f"file {path}: it cannot be written ({error.strerror}); {advice}."
        ) from error


def _content(
    columns: Sequence[Column], sizes: Mapping[str, int], attributes: Mapping[str, str | int | float]
) -> bytes:
    """The file's bytes, made in memory: HDF5 itself tells of a full disk in many ways, some of them when the file is long closed."""
    import h5netcdf  # 0.1 s to import; most commands need no file

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        file.dimensions = sizes
        for key, value in attributes.items():
            file.attrs[key] = value
        for column in columns:
            variable = file.create_variable(
                column.name, (column.dimension,), data=np.asarray(column.values)
            )
            variable.attrs["units"] = column.unit
            if column.description:
                variable.attrs["long_name"] = column.description
    return content.getvalue()


def read_columns(path: Path) -> tuple[dict[str, Column], dict[str, str | int | float]]:
    """All columns and attributes.

    Raises TrajectoryError if the file is missing, cut short or no NetCDF-4.
    """
    import h5netcdf

    class Reading(h5netcdf.File):
        # asked of a damaged file when it is closed, before it was set: a traceback on stderr
        _writable = False

    if not path.is_file():
        raise TrajectoryError(f"file {path}: there is no such file.")
    try:
        with Reading(path, "r") as file:
            columns = {}
            for name, variable in file.variables.items():
                if len(variable.dimensions) != 1:
                    raise TrajectoryError(
                        f"file {path}: {name} has {len(variable.dimensions)} dimensions; plans and replays hold columns only."
                    )
                unit = str(variable.attrs.get("units", ""))
                text = str(variable.attrs.get("long_name", ""))
                columns[name] = Column(
                    name=name,
                    dimension=variable.dimensions[0],
                    values=variable[...],
                    unit=unit,
                    description=text,
                )
            attributes = {key: _plain(value) for key, value in file.attrs.items()}
    except TrajectoryError:
        raise
    except (
        Exception
    ) as error:  # h5netcdf and what lies below it raise errors of any type on a damaged file
        raise TrajectoryError(
            f"file {path}: it cannot be read as NetCDF-4 ({type(error).__name__}: {error})."
        ) from error
    return columns, attributes


def numbers(
    path: Path, columns: Mapping[str, Column], name: str, unit: str, size: int | None = None
) -> np.ndarray:
    """The values of one column, checked.

    Parameters
    ----------
    columns
        Of the file `path`.
    unit
        The unit that the column must have, such as [m].
    size
        How many values it must have; None: any number.

    Returns
    -------
    np.ndarray
        Values (n,).

    Raises
    ------
    TrajectoryError
        If it is missing, in another unit, no numbers or of another length.
    """
    if name not in columns:
        raise TrajectoryError(
            f"file {path}: the column {name!r} is missing; it has {', '.join(columns) or 'none'}."
        )
    column = columns[name]
    if column.unit != unit:
        raise TrajectoryError(
            f"file {path}: {name} is in {column.unit!r}, but {unit!r} is expected; was it written for another scene?"
        )
    if not np.issubdtype(column.values.dtype, np.number):
        raise TrajectoryError(f"file {path}: {name} does not hold numbers ({column.values.dtype}).")
    if size is not None and len(column.values) != size:
        raise TrajectoryError(
            f"file {path}: {name} has {len(column.values)} values, but {size} are expected."
        )
    return np.asarray(column.values, dtype=float)


def _plain(value: object) -> str | int | float:
    if isinstance(value, np.generic | np.ndarray) and value.size == 1:
        value = value.item()
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    return value if isinstance(value, (str, int, float)) else str(value)
