"""The map of whom nobody gave one: columns of the plan and variables of the FMU that have the same name belong together."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

from models.plan_table import PlanTable
from validate.replay.map_schema import MapError, MapFile
from validate.replay.package import REAL, Package

_RATES = ("m/s", "rad/s")


def by_equal_names(package: Package, table: PlanTable) -> MapFile:
    """Columns are what the FMU's variables of their names are: inputs; lam_X (with gap_X) contacts; in m/s or rad/s velocities; else positions."""
    by_name = {variable.name: variable for variable in package.description.modelVariables}
    sections: dict[str, dict[str, Any]] = {"inputs": {}, "positions": {}, "contacts": {}}
    rates = []
    for name in table.names:
        variable = by_name.get(name)
        if name == "t":
            continue
        if variable is None:
            known = [item for item, value in by_name.items() if value.type in REAL]
            raise MapError(
                f"plan {table.path}: the FMU has no variable {name!r}{hint(name, known)}; name the right one in a map (--map MAP.toml)."
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
    velocities = {position: {"variable": rate, "column": rate} for position, rate in zip(sections["positions"], rates, strict=False)}
    if not sections["inputs"] and not sections["positions"]:
        raise MapError(f"plan {table.path}: the plan and the FMU share no names; say what belongs together in a map (--map MAP.toml).")
    return MapFile.model_validate({**sections, "velocities": velocities})


def hint(name: str, known: Iterable[str]) -> str:
    """Names that are near it, for the end of a sentence."""
    close = difflib.get_close_matches(name, list(known), n=3, cutoff=0.5)
    return f" (near it: {', '.join(close)})" if close else ""
