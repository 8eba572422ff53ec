"""Base class and field types of results; light to import: no pydantic, no NumPy.

Columns of numbers are base64 of little-endian float64 in JSON: read ten times as fast as digits, and
a third as long. Lists are accepted too.
"""

from __future__ import annotations

import base64
import math
import sys
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar


class Result:
    """A stored result: unknown fields, NaN and infinities are refused when it is read."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "allow_inf_nan": False}


@dataclass(frozen=True)
class Encoded:
    """Metadata of a field that is one text in JSON; `read` passes other values on."""

    write: Callable[[Any], str]
    read: Callable[[Any], Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return pydantic's schema of the field."""
        from pydantic_core import core_schema as schemas

        text = schemas.plain_serializer_function_ser_schema(
            self.write, return_schema=schemas.str_schema(), when_used="json"
        )
        return schemas.no_info_before_validator_function(
            self.read, handler(source), serialization=text
        )


def _in_order(numbers: array[float]) -> array[float]:
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def _text(values: Sequence[float]) -> str:
    return base64.b64encode(_in_order(array("d", values)).tobytes()).decode("ascii")


def _floats(value: Any) -> Any:
    """Return the numbers of a text, or the value; raise ValueError for an invalid text."""
    return (
        tuple(_in_order(array("d", base64.b64decode(value, validate=True))))
        if isinstance(value, str)
        else value
    )


Floats = Annotated[tuple[float, ...], Encoded(_text, _floats)]


class _OrInfinite:
    """Metadata of a number whose null in JSON is infinite: unknown, or unbounded."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return pydantic's schema of the field."""
        from pydantic_core import core_schema as schemas

        return schemas.no_info_after_validator_function(
            lambda value: math.inf if value is None else value,
            schemas.nullable_schema(handler(source)),
        )


OrInfinite = Annotated[float, _OrInfinite()]
