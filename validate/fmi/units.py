"""Units of an FMU by their definitions, whatever their names.

units = defined_units(description)
units["m/s"].is_same(units["m"].per_second())
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

# Exponents that are compared; an angle counts as a number, because many models mix the two.
_BASES = ("kg", "m", "s", "A", "K", "mol", "cd")
# Relative difference of factors of one unit: the digits with which they are written.
_SAME_FACTOR = 1e-6


class Unit(NamedTuple):
    """A unit in base units: value in base units = factor * value + offset.

    powers: exponents of base units, without zeros.
    rad: exponent of the angle.
    """

    powers: Mapping[str, int]
    factor: float = 1.0
    offset: float = 0.0
    rad: int = 0

    def is_same(self, other: Unit) -> bool:
        """Return whether numbers in both units are the same."""
        return (
            self.powers == other.powers
            and math.isclose(self.factor, other.factor, rel_tol=_SAME_FACTOR)
            and math.isclose(self.offset, other.offset, rel_tol=_SAME_FACTOR)
        )

    def per_second(self) -> Unit:
        """Return the unit of a derivative: offsets vanish."""
        powers = {**self.powers, "s": self.powers.get("s", 0) - 1}
        return Unit({base: power for base, power in powers.items() if power}, self.factor)


def defined_units(description: Any) -> dict[str, Unit]:
    """Return the units that an FMU defines by base units; description: FMPy's."""
    found = {}
    for unit in description.unitDefinitions:
        if (base := unit.baseUnit) is not None:
            powers = {name: int(getattr(base, name)) for name in _BASES}
            found[unit.name] = Unit(
                {name: power for name, power in powers.items() if power},
                float(base.factor),
                float(base.offset),
                int(base.rad),
            )
    return found
