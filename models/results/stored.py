"""Write results as JSON text, and read them, with pydantic.

    text = to_json(record)
    record = from_json(RunRecord, text)
    record = record_of(path.read_bytes())  # a RunRecord or a CheckRecord

Numbers that are not finite are written as null. Readers raise pydantic's ValidationError. The
vocabulary itself does not import this module, so that a plan is replayed without pydantic (0.4 s).
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, TypeVar

from pydantic import Discriminator, Tag, TypeAdapter

from models.results.check import CheckRecord
from models.results.run import LegRecord, RunRecord

_Result = TypeVar("_Result")
_ANY_RECORD: TypeAdapter[RunRecord | CheckRecord] = TypeAdapter(
    Annotated[
        Annotated[RunRecord, Tag("run")] | Annotated[CheckRecord, Tag("check")],
        Discriminator(
            lambda data: "run" if isinstance(data, dict) and "pipeline" in data else "check"
        ),
    ]
)


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


for _kind in (RunRecord, LegRecord):  # here, so that the children of a campaign share them
    _adapter(_kind)


def to_json(result: object, indent: int | None = None, kind: type | None = None) -> str:
    """Return a result as JSON text; kind: of a result with more fields than are written."""
    return _adapter(kind or type(result)).dump_json(result, indent=indent).decode()


def to_data(result: object) -> dict[str, Any]:
    """Return a result as JSON data."""
    return _adapter(type(result)).dump_python(result, mode="json")


def from_json(kind: type[_Result], text: str | bytes) -> _Result:
    """Return the result in a JSON text."""
    return _adapter(kind).validate_json(text)


def from_data(kind: type[_Result], data: Any) -> _Result:
    """Return the result in JSON data."""
    return _adapter(kind).validate_python(data)


def record_of(text: str | bytes) -> RunRecord | CheckRecord:
    """Return the record of a run or a check in a JSON text."""
    return _ANY_RECORD.validate_json(text)
