"""Units as text: `m`, `kg`, `N s/m`, `rad/s^2`. Enough grammar to find a missing or misspelt unit and to write FMI base units.

base_exponents("N s/m")  ->  {"kg": 1, "s": -1}
"""

from __future__ import annotations

import re
from typing import Any

# Exponents of (kg, m, s, rad) of every unit a scene may use; rad is kept, as FMI 2.0's BaseUnit has it.
_UNITS: dict[str, dict[str, int]] = {
    "1": {},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Hz": {"s": -1},
}
_FACTOR = re.compile(r"([A-Za-z]+|1)(?:\^(-?\d+))?\Z")


def base_exponents(unit: str) -> dict[str, int]:
    """Exponents of the base units, e.g. {"kg": 1, "s": -2} for "N/m". Raises ValueError with a sentence for an unknown unit."""
    if not isinstance(unit, str) or not unit.strip():
        raise ValueError("the unit is missing; give it as text, for example 'm', 'N s/m' or '1' for a pure number.")
    total: dict[str, int] = {}
    for position, part in enumerate(unit.split("/")):
        sign = 1 if position == 0 else -1
        factors = part.split()
        if not factors:
            raise ValueError(f"the unit {unit!r} has nothing on one side of '/'; write for example 'N/m'.")
        for factor in factors:
            match = _FACTOR.match(factor)
            if match is None or match.group(1) not in _UNITS:
                raise ValueError(f"the unit {unit!r} contains {factor!r}, which is not one of {', '.join(_UNITS)} (with ^n, spaces and /).")
            power = sign * int(match.group(2) or 1)
            for base, exponent in _UNITS[match.group(1)].items():
                total[base] = total.get(base, 0) + power * exponent
    return {base: exponent for base, exponent in total.items() if exponent}


def unit_problem(unit: Any) -> str | None:
    """A sentence saying what is wrong with a unit, or None."""
    try:
        base_exponents(unit)
    except ValueError as error:
        return str(error)
    return None
