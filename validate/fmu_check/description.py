"""The model description: valid by schema and rules, and free of contradictions that no schema sees."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from validate.fmu_check.result import Finding, Scope, check, failed, listed, passed
from validate.fmu_check.subject import Subject, Variable


@check("description is valid", "modelDescription.xml obeys its schema and the rules of FMI (FMPy's validation)", Scope.FILE)
def valid(path: Path) -> Finding:
    """Looks at the unpacked folder; comes before the description is read without validation."""
    from fmpy.validation import validate_fmu

    problems = [" ".join(str(problem).split()).rstrip(".") for problem in validate_fmu(str(path))]
    if problems:
        return failed(f"{listed(problems)}.")
    return passed("0 problems.")


@check(
    "variables are consistent",
    "starts lie within ranges, ranges are not empty, nominals positive, units of derivatives those of states per second",
    Scope.FILE,
)
def consistent(subject: Subject) -> Finding:
    wrong = [problem for item in subject.variables for problem in _of_variable(item)]
    wrong += _of_aliases(subject)
    wrong += _of_derivatives(subject)
    if not subject.description.guid:
        wrong.append("the GUID or instantiation token is empty")
    if wrong:
        return failed(f"{listed(wrong)}.")
    return passed(f"{len(subject.variables)} variables.")


def _of_variable(item: Variable) -> list[str]:
    wrong = []
    if item.lower > item.upper:
        wrong.append(f"{item.name} has the empty range {item.lower:g} .. {item.upper:g}")
    elif item.start is not None and ((item.start < item.lower) | (item.start > item.upper)).any():
        wrong.append(f"{item.name} starts at {item.start[0]:g}, outside its range {item.lower:g} .. {item.upper:g}")
    if item.start is not None and not all(map(math.isfinite, item.start)):
        wrong.append(f"{item.name} starts at {item.start[0]:g}")
    if item.nominal is not None and not (item.nominal > 0.0 and math.isfinite(item.nominal)):
        wrong.append(f"{item.name} has the nominal {item.nominal:g}; it must be positive")
    return wrong


def _of_aliases(subject: Subject) -> list[str]:
    """Variables that share a value must share its start."""
    first: dict[tuple[int, str], Variable] = {}
    wrong = []
    for item in subject.variables:
        other = first.setdefault((item.reference, item.type), item)
        if other.start is not None and item.start is not None and not (other.start == item.start).all():
            wrong.append(f"{other.name} and {item.name} have one value reference, {item.reference}, but different starts")
    return wrong


def _of_derivatives(subject: Subject) -> list[str]:
    """A derivative's unit must be that of its state per second, where both are defined by base units."""
    units = {unit.name: unit.baseUnit for unit in subject.description.unitDefinitions if unit.baseUnit is not None}
    wrong = []
    for item in subject.description.modelVariables:
        if item.derivative is None or not hasattr(item.derivative, "name"):
            continue
        rate, state = subject.by_name.get(item.name), subject.by_name.get(item.derivative.name)
        if rate is None or state is None or rate.unit not in units or state.unit not in units:
            continue
        if _exponents(units[rate.unit]) != _exponents(units[state.unit], seconds=-1):
            wrong.append(f"{rate.name} has the unit {rate.unit}, but is the derivative of {state.name} in {state.unit}")
    return wrong


def _exponents(base: Any, seconds: int = 0) -> tuple[int, ...]:
    """Exponents of the base units; an angle counts as a number, as many models mix the two."""
    return tuple(int(getattr(base, name)) + (seconds if name == "s" else 0) for name in ("kg", "m", "s", "A", "K", "mol", "cd"))
