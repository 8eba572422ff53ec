"""The map where none is given: columns of the plan and variables of the FMU that have the same name belong together.

And whether a unit can be that of a quantity: a scale turns one unit of a quantity into another, but no mass into a length.
"""

from __future__ import annotations

import difflib
import heapq
from collections.abc import Iterable, Mapping
from typing import Any

from models.plan_table import Table
from models.scene.values import base_exponents
from validate.fmi.description import REAL, Package
from validate.judge.replay.map_schema import MapError, MapFile, composed

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


_RATES = ("m/s", "rad/s")


# Names from which on only some are compared with one that is not there, and how many: comparing takes up to 40 us a name.
_MANY = 2000


class Named:
    """The variables of an FMU by their names, in Unicode's composed form; `twice`: names that are there more than once, which FMI forbids."""

    def __init__(self, package: Package) -> None:
        self.by_name: dict[str, Any] = {}
        self.twice: set[str] = set()
        for variable in package.description.modelVariables:
            name = composed(variable.name)
            if self.by_name.setdefault(name, variable) is not variable:
                self.twice.add(name)

    def numbers(self) -> list[str]:
        """Names of the variables that are numbers."""
        return [name for name, variable in self.by_name.items() if variable.type in REAL]


def by_equal_names(named: Named, table: Table) -> MapFile:
    """Columns are what the FMU's variables of their names are: inputs; lam_X (with gap_X) contacts; in m/s or rad/s velocities; else positions."""
    by_name = named.by_name
    sections: dict[str, dict[str, Any]] = {"inputs": {}, "positions": {}, "contacts": {}}
    rates = []
    for name in table.names:
        variable = by_name.get(name)
        if name == "t":
            continue
        if variable is None:
            raise MapError(
                f"{table.where}: the FMU has no variable {name!r}{hint(name, named.numbers())}; name the right one in a map (--map MAP.toml)."
            )
        if variable.causality == "input":
            sections["inputs"][name] = name
        elif name.startswith("lam_"):
            contact = name.removeprefix("lam_")
            gap = f"gap_{contact}"
            sections["contacts"][contact] = {"force": name, "gap": gap} if gap in by_name else {"force": name}
        elif variable.unit in _RATES:
            rates.append(name)
        else:
            sections["positions"][name] = name
    if rates and len(rates) != len(sections["positions"]):
        sections["positions"] |= {name: name for name in rates}
        rates = []
    velocities = {
        position: {"variable": rate, "column": rate} for position, rate in _paired(list(sections["positions"]), rates, by_name).items()
    }
    if not sections["inputs"] and not sections["positions"]:
        raise MapError(f"{table.where}: the plan and the FMU share no names; say what belongs together in a map (--map MAP.toml).")
    return MapFile.model_validate({**sections, "velocities": velocities})


def _paired(positions: list[str], rates: list[str], by_name: Mapping[str, Any]) -> dict[str, str]:
    """Velocity of each position: the FMU says that it is its derivative, or its name does; the others by their order in the plan."""
    pairs = {}
    for rate in rates:
        of = getattr(by_name[rate], "derivative", None)
        owner = composed(of.name) if of is not None else rate.removeprefix("v_").removeprefix("der(").removesuffix(")")
        if owner in positions and owner not in pairs:
            pairs[owner] = rate
    left = [rate for rate in rates if rate not in pairs.values()]
    pairs |= dict(zip([name for name in positions if name not in pairs], left, strict=False))
    return {name: pairs[name] for name in positions if name in pairs}


def hint(name: str, known: Iterable[str]) -> str:
    """Names that are near it, for the end of a sentence."""
    known = list(known)
    if len(known) > _MANY:
        parts = {name[at : at + 3].lower() for at in range(max(1, min(len(name), 200) - 2))}
        known = heapq.nlargest(_MANY, known, key=lambda item: sum(part in item.lower() for part in parts) / (len(item) + len(name)))
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    return f" (near it: {', '.join(close)})" if close else ""
