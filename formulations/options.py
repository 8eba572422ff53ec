"""Options of methods: defaults filled in, unknown names and impossible values refused in one sentence."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from models.errors import TouchstoneError


class OptionError(TouchstoneError):
    """An option or eps that the method does not know or that is out of range; one sentence says which and what was expected."""


@dataclass(frozen=True, kw_only=True)
class OptionSpec:
    """One option of a method: its default, unit and meaning. `lower`/`upper` bound numbers (inclusive)."""

    name: str
    default: object
    description: str
    unit: str = "1"
    lower: float | None = None
    upper: float | None = None
    choices: tuple[object, ...] = ()


def filled_options(method: str, specs: Iterable[OptionSpec], given: Mapping[str, object]) -> dict[str, object]:
    """All options of a method, defaults filled in. Raises OptionError."""
    specs = tuple(specs)
    by_name = {spec.name: spec for spec in specs}
    for name in given:
        if name not in by_name:
            close = difflib.get_close_matches(str(name), by_name, n=1)
            hint = f"did you mean {close[0]}?" if close else f"it has {', '.join(by_name) or 'none'}."
            raise OptionError(f"method {method}: there is no option {name!r}; {hint}")
    return {spec.name: _checked(method, spec, given.get(spec.name, spec.default)) for spec in specs}


def _checked(method: str, spec: OptionSpec, value: object) -> object:
    if value is None and spec.default is None:
        return None
    if spec.choices and value not in spec.choices:
        choices = ", ".join(repr(choice) for choice in spec.choices)
        raise OptionError(f"method {method}: option {spec.name} is {value!r}, but must be one of {choices}.")
    if spec.lower is not None or spec.upper is not None:
        lower = -math.inf if spec.lower is None else spec.lower
        upper = math.inf if spec.upper is None else spec.upper
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not lower <= value <= upper:
            unit = "" if spec.unit == "1" else f" {spec.unit}"
            raise OptionError(f"method {method}: option {spec.name} is {value!r}, but must be a number in [{lower:g}, {upper:g}]{unit}.")
        if isinstance(spec.default, int) and not isinstance(value, int):
            raise OptionError(f"method {method}: option {spec.name} is {value!r}, but must be a whole number.")
    return value
