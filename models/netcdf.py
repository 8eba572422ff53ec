"""Write and read named columns with units in NetCDF-4 files, for plans and replays.

    columns = [Column(name="q1", dimension="node", values=q1, unit="m")]
    write_columns(path, columns, {"scene": "three_cart"})
    columns, attributes = read_columns(path)

A file is written under a temporary name, flushed and renamed. Variables refer to dimensions by
number only, which netCDF and xarray accept; lists of references would take 8 kB per file.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import MachineError, TrajectoryError

# netCDF's attribute names of a dimension, and of the dimensions of a variable.
_DIMENSION = b"_Netcdf4Dimid"
_DIMENSIONS = b"_Netcdf4Coordinates"
# Prefix of the name of a dataset that is a dimension without a variable.
_ONLY_DIMENSION = "This is a netCDF dimension but not a netCDF variable."
# Columns up to this size [byte] are not compressed: the overhead is as large.
_SMALL = 256
# Level of deflate; higher ones are slower and save less than 1 %.
_LEVEL = 4
# Bits rounded by `drawn`, of the 23 fraction bits in single precision.
_LOST_BITS = 5
# Memory increment of a file [byte].
_INCREMENT = 1 << 16


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
    """Return one column (n,) for each (name, unit, description) [SI].

    values are (n, columns). Raises ValueError for another number of columns than names.
    """
    return [
        Column(name=name, dimension=dimension, values=column, unit=unit, description=text)
        for (name, unit, text), column in zip(named, values.T, strict=True)
    ]


def drawn(values: np.ndarray) -> np.ndarray:
    """Return values (any,) in single precision, rounded to 6 digits for plots [-].

    The zeroed last bits compress well. Raises nothing.
    """
    bits = np.array(values, np.float32).view(np.uint32)
    return ((bits + (1 << _LOST_BITS - 1)) >> _LOST_BITS << _LOST_BITS).view(np.float32)


def write_columns(
    path: Path, columns: Iterable[Column], attributes: Mapping[str, str | int | float]
) -> None:
    """Write a file atomically. Raises MachineError if it cannot be written."""
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
        part.chmod(0o644)  # temporary files are private, a store is shared
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
    """Return the bytes of the file.

    The file is made in memory, because HDF5 reports a full disk in many ways. The low-level HDF5
    calls take a fifth of the time of h5py's classes for short columns.
    """
    from h5py import h5d, h5ds, h5f, h5p, h5s, h5t  # 0.1 s to import

    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(_INCREMENT, False)
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)  # one chunk needs no index
    plain = h5p.create(h5p.DATASET_CREATE)
    plain.set_fill_time(h5d.FILL_TIME_NEVER)
    ordered = h5p.create(h5p.FILE_CREATE)
    ordered.set_link_creation_order(h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED)
    file = h5f.create(b"columns", h5f.ACC_TRUNC, ordered, access)
    for place, (name, size) in enumerate(sizes.items()):
        scale = h5d.create(file, name.encode(), h5t.IEEE_F32BE, h5s.create_simple((size,)), plain)
        h5ds.set_scale(scale, f"{_ONLY_DIMENSION}{size:10d}".encode())
        _set_attribute(scale, _DIMENSION, np.array(place, np.int32))
    for name, value in attributes.items():
        _set_attribute(file, name.encode(), value)
    dimensions = list(sizes)
    for column in columns:
        values = np.ascontiguousarray(column.values)
        layout = plain
        if values.nbytes > _SMALL:
            layout = h5p.create(h5p.DATASET_CREATE)
            layout.set_fill_time(h5d.FILL_TIME_NEVER)
            layout.set_chunk(values.shape)
            layout.set_shuffle()
            layout.set_deflate(_LEVEL)
        stored = h5d.create(
            file,
            column.name.encode(),
            h5t.py_create(values.dtype, logical=True),
            h5s.create_simple(values.shape),
            layout,
        )
        stored.write(h5s.ALL, h5s.ALL, values)
        place = dimensions.index(column.dimension)
        _set_attribute(stored, _DIMENSIONS, np.array([place], np.int32))
        _set_attribute(stored, b"units", column.unit)
        if column.description:
            _set_attribute(stored, b"long_name", column.description)
    h5f.flush(file)
    content = file.get_file_image()
    file.close()
    return content


def _set_attribute(owner: Any, name: bytes, value: str | float | np.ndarray) -> None:
    from h5py import h5a, h5s, h5t

    if isinstance(value, str):
        text = value.encode() or b"\0"
        kind = h5t.C_S1.copy()
        kind.set_size(len(text))
        kind.set_cset(h5t.CSET_UTF8)
        array = np.array(text, f"S{len(text)}")
    else:
        array = np.asarray(value)
        kind = h5t.py_create(array.dtype, logical=True)
    space = h5s.create_simple(array.shape) if array.shape else h5s.create(h5s.SCALAR)
    h5a.create(owner, name, kind, space).write(array, kind)


def read_columns(path: Path) -> tuple[dict[str, Column], dict[str, str | int | float]]:
    """Return all columns and attributes.

    Raises TrajectoryError if the file is missing, truncated or no NetCDF-4.
    """
    import h5py

    if not path.is_file():
        raise TrajectoryError(f"file {path}: there is no such file.")
    try:
        with h5py.File(path, "r", track_order=True) as file:
            datasets = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
            dimensions = {
                int(item.attrs[_DIMENSION.decode()]): name
                for name, item in datasets.items()
                if _DIMENSION.decode() in item.attrs
            }
            columns = {
                name: _read_column(path, name, item, dimensions)
                for name, item in datasets.items()
                if not str(_plain(item.attrs.get("NAME", ""))).startswith(_ONLY_DIMENSION)
            }
            attributes = {key: _plain(value) for key, value in file.attrs.items()}
    except TrajectoryError:
        raise
    except Exception as error:  # damaged files raise errors of any type
        raise TrajectoryError(
            f"file {path}: it cannot be read as NetCDF-4 ({type(error).__name__}: {error})."
        ) from error
    return columns, attributes


def _read_column(path: Path, name: str, stored: Any, dimensions: Mapping[int, str]) -> Column:
    if len(stored.shape) != 1:
        raise TrajectoryError(
            f"file {path}: {name} has {len(stored.shape)} dimensions; plans and replays hold columns only."
        )
    place = stored.attrs.get(_DIMENSIONS.decode(), [-1])
    return Column(
        name=name,
        dimension=dimensions.get(int(place[0]), ""),
        values=stored[...],
        unit=str(_plain(stored.attrs.get("units", ""))),
        description=str(_plain(stored.attrs.get("long_name", ""))),
    )


def numbers(
    path: Path, columns: Mapping[str, Column], name: str, unit: str, size: int | None = None
) -> np.ndarray:
    """Return the values (n,) of one column in `unit`, such as [m], with `size` values if given.

    Raises TrajectoryError if the column is missing, in another unit, not numeric or of another
    length.
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
