"""Columns of numbers as records hold them: in memory one array, in JSON the base64 of its bytes (float64, little-endian), row by row.

    class Record(BaseModel):
        t: Floats
        poses: dict[str, Poses]

A list of numbers is read as well, in JSON and from Python. Bytes are read a hundred times as fast as digits, and are a third of their length.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import GetPydanticSchema, PlainSerializer
from pydantic_core import core_schema

Pose = tuple[float, float, float]
_Item = TypeVar("_Item", float, Pose)
_TYPE = "<f8"
_AXES = 3  # of a pose: x, y, angle


class Column(Sequence[_Item]):
    """Numbers, or triples of numbers, that cannot be changed: a sequence of Python's own floats, and an array without a copy (`numpy.asarray`)."""

    __slots__ = ("_array",)

    def __init__(self, array: NDArray[np.float64]) -> None:
        self._array = array
        array.flags.writeable = False

    def __len__(self) -> int:
        return len(self._array)

    @overload
    def __getitem__(self, place: int) -> _Item: ...
    @overload
    def __getitem__(self, place: slice) -> Column[_Item]: ...
    def __getitem__(self, place: int | slice) -> Any:
        if isinstance(place, slice):
            return Column(self._array[place])
        found = self._array[place].tolist()
        return tuple(found) if isinstance(found, list) else found

    def __iter__(self) -> Iterator[_Item]:
        values: Any = self._array.tolist()
        rows: Any = values if self._array.ndim == 1 else [tuple(row) for row in values]
        return iter(rows)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self._array, dtype, copy=True) if copy else np.asarray(self._array, dtype)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence) or isinstance(other, str):
            return NotImplemented
        return len(self) == len(other) and list(self) == list(other)

    def __hash__(self) -> int:
        return hash(self._array.tobytes())

    def __repr__(self) -> str:
        return repr(tuple(self))


def array_of(values: Sequence[float] | Sequence[Pose] | NDArray[np.float64]) -> NDArray[np.float64]:
    """The numbers as an array, of a column without a copy."""
    return np.asarray(values, np.float64)


def joined(*columns: Sequence[float]) -> NDArray[np.float64]:
    """The numbers of several columns one after another."""
    return np.concatenate([array_of(values) for values in columns]) if columns else np.zeros(0)


def _text(values: ArrayLike) -> str:
    return base64.b64encode(np.asarray(values, _TYPE).tobytes()).decode("ascii")


def _decoded(text: str) -> NDArray[np.float64]:
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), _TYPE)
    except (binascii.Error, ValueError) as problem:
        raise ValueError("this is no base64 of numbers of 8 bytes") from problem


def _checked(array: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(array).all():
        raise ValueError("every number must be finite")
    return array


def _floats(value: Any) -> Column[float]:
    if isinstance(value, Column):
        return value
    return Column(_checked(_decoded(value) if isinstance(value, str) else np.array(value, np.float64).reshape(-1)))


def _poses(value: Any) -> Column[Pose]:
    if isinstance(value, Column):
        return value
    array = _decoded(value) if isinstance(value, str) else np.array(value, np.float64)
    if array.size % _AXES:
        raise ValueError("these are no poses: each has x, y and an angle")
    return Column(_checked(array.reshape(-1, _AXES)))


def _schema(read: Any, inner: Any) -> GetPydanticSchema:
    """Columns, arrays and texts go to `read` as they are; anything else must be a list of `inner` first."""
    own = core_schema.no_info_plain_validator_function(read)
    listed = core_schema.no_info_after_validator_function(read, core_schema.list_schema(inner))
    which = core_schema.tagged_union_schema({"own": own, "listed": listed}, lambda value: _kind(value))
    return GetPydanticSchema(lambda _source, _handler: which)


def _kind(value: Any) -> str:
    return "own" if isinstance(value, (str, Column, np.ndarray)) else "listed"


_number = core_schema.float_schema(allow_inf_nan=False)
_pose = core_schema.tuple_schema([_number, _number, _number])
_written = PlainSerializer(_text, return_type=str, when_used="json")
Floats = Annotated[Sequence[float], _schema(_floats, _number), _written]
Poses = Annotated[Sequence[Pose], _schema(_poses, _pose), _written]
