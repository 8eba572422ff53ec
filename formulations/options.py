"""Options of methods: a frozen dataclass each, whose fields say what they mean and which values they take.

    @dataclass(frozen=True, kw_only=True)
    class GlobalOptions(Options):
        seconds: float = option(200.0, "time after which the best bound is reported", unit="s", lower=1e-3, upper=1e7)

A value is kept as it was given, a whole number also where any number will do: keys of stored results are made from it.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from typing import Any, TypeVar

from models.errors import TouchstoneError


class OptionError(TouchstoneError):
    """An option or eps that the method does not know or that is out of range; one sentence says which and what was expected."""


def option(
    default: Any, description: str, *, lower: float = -math.inf, upper: float = math.inf, unit: str = "1", choices: tuple[object, ...] = ()
) -> Any:
    """A field of `Options`. lower, upper: bounds of a number, inclusive."""
    choices = choices or ((True, False) if isinstance(default, bool) else ())
    return field(default=default, metadata={"description": description, "lower": lower, "upper": upper, "unit": unit, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a method; the base is for one that has none. Raises OptionError for an impossible value."""

    def __post_init__(self) -> None:
        for item in fields(self):
            _check(item, getattr(self, item.name))


AnyOptions = TypeVar("AnyOptions", bound=Options)


def read_options(kind: type[AnyOptions], given: AnyOptions | Mapping[str, object], method: str) -> AnyOptions:
    """The options of a method, defaults filled in. given: such options, or values by name. Raises OptionError."""
    if isinstance(given, Options):
        if type(given) is not kind:
            raise OptionError(f"method {method}: its options are {kind.__name__}, but {type(given).__name__} were given.")
        return given
    names = [item.name for item in fields(kind)]
    for name in given:
        if name not in names:
            close = difflib.get_close_matches(str(name), names, n=1)
            hint = f"did you mean {close[0]}?" if close else f"it has {', '.join(names) or 'none'}."
            raise OptionError(f"method {method}: there is no option {name!r}; {hint}")
    try:
        return kind(**given)
    except OptionError as error:
        raise OptionError(f"method {method}: {error}") from None


def _check(item: Field[Any], value: object) -> None:
    if not item.metadata or (value is None and item.default is None):
        return
    lower, upper, unit, choices = (item.metadata[key] for key in ("lower", "upper", "unit", "choices"))
    said = f"option {item.name} is {value!r}, but must be"
    if choices and value not in choices:
        raise OptionError(f"{said} one of {', '.join(map(repr, choices))}.")
    if lower > -math.inf or upper < math.inf:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not lower <= value <= upper:
            raise OptionError(f"{said} a number in [{lower:g}, {upper:g}]{'' if unit == '1' else f' {unit}'}.")
        if isinstance(item.default, int) and not isinstance(value, int):
            raise OptionError(f"{said} a whole number.")
