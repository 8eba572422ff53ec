"""What quantity a unit is of: a scale turns one unit of a quantity into another, but no mass into a length."""

from __future__ import annotations

from typing import Any

from models.units import base_exponents

# What each quantity may be in, but for a factor. Pure numbers and radians pass for any: an arm of 1 m is often left out.
QUANTITIES = {"position": ("m",), "velocity": ("m/s", "1/s"), "force": ("N", "N m"), "gap": ("m",)}
# What forces and gaps of a contact are in without a scale, by what they are called where they belong to an angle too.
CONTACT_UNITS = {"force": ("N", "N m", "N.m", "Nm"), "gap": ("m", "rad")}
# What is of mechanics, and what is not: the scale of a sensor only its maker knows.
_MECHANICAL, _OTHERS = ("kg", "m", "s"), ("A", "K", "mol", "cd")


class Dimensions:
    """Of the units of an FMU, by its own definitions, and of a plan, by ours."""

    def __init__(self, description: Any) -> None:
        """description: FMPy's."""
        self._defined = {unit.name: unit.baseUnit for unit in description.unitDefinitions if unit.baseUnit is not None}

    def contradicts(self, unit: str | None, what: str, of_fmu: bool = False) -> bool:
        """Whether nothing in this unit is such a quantity."""
        found = None if not unit else self._of_fmu(unit) if of_fmu else _ours(unit)
        return bool(found) and found not in [_ours(name) for name in QUANTITIES[what]]

    def _of_fmu(self, unit: str) -> dict[str, int] | None:
        defined = self._defined.get(unit)
        if defined is None:
            return _ours(unit)
        if any(getattr(defined, base) for base in _OTHERS):
            return None
        return {base: power for base in _MECHANICAL if (power := int(getattr(defined, base)))}


def may_be_rate(position: str, velocity: str) -> bool:
    """Whether a velocity is in its position's unit per second, as far as both units are known; "1" is a unit that nobody told."""
    try:
        expected, found = dict(base_exponents(position)), base_exponents(velocity)
    except ValueError:  # a unit that we do not know
        return True
    if not expected or not found:
        return True
    expected["s"] = expected.get("s", 0) - 1
    return found == {base: power for base, power in expected.items() if power}


def _ours(unit: str) -> dict[str, int] | None:
    """Exponents of kg, m and s; None of a unit that we do not know."""
    try:
        return {base: power for base, power in base_exponents(unit).items() if base in _MECHANICAL}
    except ValueError:
        return None
