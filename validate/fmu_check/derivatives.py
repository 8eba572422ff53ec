"""Derivatives that the FMU offers against finite differences, and what it says depends on what."""

from __future__ import annotations

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmu_check.differences import Column, agrees, column, resolved, rounding_of
from validate.fmu_check.linearisation import Point, initial_point, points
from validate.fmu_check.result import Finding, Scope, check, failed, listed, not_offered, passed
from validate.fmu_check.subject import Subject, Variable

# A second opinion, with other steps, before a derivative is called wrong.
_OTHER_STEPS = 3.7e-3
# A value that changes by less than this share of its size did not change.
_CHANGED = 1e-9


@check("directional derivatives", "they equal finite differences within the error of those", Scope.EACH)
def directional(subject: Subject, kind: str) -> Finding:
    ability = "providesDirectionalDerivative" if subject.major == 2 else "providesDirectionalDerivatives"
    if not subject.can(kind, ability):
        return not_offered(f"{ability} is false.")
    looked = sharp = kinks = 0
    wrong: list[str] = []
    places = 0
    for point in points(subject, kind):
        places += 1
        for place, known in point.entries():
            claimed = _claimed(point, place)
            found = column(point.evaluate, point.x, place, point.sizes()[place])
            looked += claimed.size
            sharp += int(np.sum(resolved(claimed, found)))
            kinks += int(np.sum(found.kink))
            wrong += _wrong(point, place, known, claimed, found)
    initial = initial_point(subject, kind)
    if initial is not None:
        try:
            for place, known in initial.entries():
                claimed = _claimed(initial, place)
                found = column(initial.evaluate, initial.x, place, initial.sizes()[place])
                looked += claimed.size
                sharp += int(np.sum(resolved(claimed, found)))
                kinks += int(np.sum(found.kink))
                wrong += _wrong(initial, place, known, claimed, found)
            places += 1
        except FMICallException:
            pass  # derivatives by parameters, or of a value outside its range: not every FMU has them
    if wrong:
        return failed(listed(wrong))
    if not looked:
        return not_offered("there is nothing to derive: no states or inputs, or no derivatives or outputs.")
    at_kinks = f", {kinks} lie at kinks" if kinks else ""
    return passed(f"{looked} entries at {places} points agree; for {sharp} an error of a thousandth would show{at_kinks}.")


def _claimed(point: Point, place: int) -> np.ndarray:
    """The column that the FMU gives for an entry of the knowns."""
    point.back()
    known, within = _locate(point.knowns, place)
    seed = np.zeros(known.size)
    seed[within] = 1.0
    return point.instance.directional(point.unknowns, [known], list(seed))


def _locate(knowns: list[Variable], place: int) -> tuple[Variable, int]:
    for known in knowns:
        if place < known.size:
            return known, place
        place -= known.size
    raise IndexError(place)


def _wrong(point: Point, place: int, known: Variable, claimed: np.ndarray, found: Column) -> list[str]:
    bad = ~agrees(claimed, found)
    if not bad.any():
        return []
    again = column(point.evaluate, point.x, place, point.sizes()[place], _OTHER_STEPS)
    bad &= ~agrees(claimed, again)
    names = point.names()
    return [
        f"d {names[row]} / d {known.name} {point.where} is {claimed[row]:.6g}, finite differences give {found.value[row]:.6g} +- {found.error[row]:.1g}"
        for row in np.flatnonzero(bad)
    ]


@check("adjoint derivatives", "they are the transpose of what finite differences give", Scope.EACH)
def adjoint(subject: Subject, kind: str) -> Finding:
    if not subject.can(kind, "providesAdjointDerivatives"):
        return not_offered("providesAdjointDerivatives is false." if subject.major >= 3 else "FMI 2.0 has none.")
    looked = 0
    dice = np.random.default_rng(11)
    for point in points(subject, kind):
        if len(point.entries()) < point.x.size:
            return not_offered("the model is too large for all columns.")
        columns = [column(point.evaluate, point.x, place, point.sizes()[place]) for place, _ in point.entries()]
        point.back()
        rows = sum(item.size for item in point.unknowns)
        for seed in [*np.eye(rows), dice.uniform(-1.0, 1.0, rows)]:
            claimed = point.instance.adjoint(point.unknowns, point.knowns, list(seed))
            for place, (known, found) in enumerate(zip([item for _, item in point.entries()], columns, strict=True)):
                used = seed != 0.0
                if bool((found.kink & used).any()):
                    continue
                value = float(seed[used] @ found.value[used])
                error = float(np.abs(seed[used]) @ found.error[used])
                size = float(np.abs(seed[used]) @ np.abs(found.value[used]))
                looked += 1
                if not abs(claimed[place] - value) <= 10.0 * error + 1e-6 * max(size, abs(claimed[place])) + rounding_of(claimed):
                    names = [name for name, one in zip(point.names(), used, strict=True) if one]
                    return failed(
                        f"the adjoint of {listed(names, 1)} by {known.name} {point.where} is {claimed[place]:.6g}, "
                        f"finite differences give {value:.6g} +- {error:.1g}."
                    )
    if not looked:
        return not_offered("there is nothing to derive.")
    return passed(f"{looked} entries agree, one seed at a time and all at once.")


@check(
    "dependencies are complete",
    "nothing changes that is not declared to depend on what was changed, and constant factors are constant",
    Scope.EACH,
)
def dependencies(subject: Subject, kind: str) -> Finding:
    structure = subject.description
    running = _declared(subject, [*structure.derivatives, *structure.outputs])
    starting = _declared(subject, structure.initialUnknowns)
    if not running and not starting:
        return not_offered("no unknown of the ModelStructure declares its dependencies.")
    wrong: list[str] = []
    looked = 0
    slopes: dict[tuple[str, str], tuple[float, float, str]] = {}
    for point in points(subject, kind):
        looked += _missing(point, running, wrong)
        _factors(point, running, slopes, wrong)
    if starting:
        initial = initial_point(subject, kind)
        if initial is not None:
            looked += _missing(initial, starting, wrong)
    if wrong:
        return failed(listed(list(dict.fromkeys(wrong))))
    if not looked:
        return not_offered("there is nothing that can be changed and compared.")
    return passed(f"{looked} pairs that are declared independent are so; {len(slopes)} declared factors are constant.")


def _declared(subject: Subject, unknowns: list) -> dict[str, dict[str, str]]:
    """Unknown -> its declared knowns -> kind; unknowns that declare nothing depend on everything."""
    found = {}
    for item in unknowns:
        if item.dependencies is not None and item.variable.name in subject.by_name:
            kinds = item.dependenciesKind or ["dependent"] * len(item.dependencies)
            found[item.variable.name] = {known.name: kind for known, kind in zip(item.dependencies, kinds, strict=False)}
    return found


def _missing(point: Point, declared: dict[str, dict[str, str]], wrong: list[str]) -> int:
    """Add to `wrong` what changes undeclared; the number of pairs looked at."""
    looked = 0
    names = point.names()
    point.back()
    base = point.evaluate(point.x)
    same = {item.name: {other.name for other in point.knowns if other.reference == item.reference} for item in point.knowns}
    for place, known in point.entries():
        moved = point.x.copy()
        moved[place] += 1e-2 * max(point.sizes()[place], abs(moved[place])) * (-1.0 if moved[place] >= known.upper else 1.0)
        try:
            values = point.evaluate(moved)
        except FMICallException:
            point.back()
            continue  # outside what the model accepts
        for row, name in enumerate(names):
            if name not in declared or declared[name].keys() & (same[known.name] | {known.name}) or name == known.name:
                continue
            looked += 1
            if abs(values[row] - base[row]) > _CHANGED * max(abs(base[row]), abs(values[row])):
                wrong.append(f"{name} changes with {known.name} {point.where}, but does not declare that it depends on it")
        point.back()
    return looked


def _factors(
    point: Point, declared: dict[str, dict[str, str]], slopes: dict[tuple[str, str], tuple[float, float, str]], wrong: list[str]
) -> None:
    """Compare the slopes of dependencies declared `constant` or `fixed` with those at the points before."""
    names = point.names()
    for place, known in point.entries():
        rows = [row for row, name in enumerate(names) if declared.get(name, {}).get(known.name) in ("constant", "fixed")]
        if not rows:
            continue
        found = column(point.evaluate, point.x, place, point.sizes()[place])
        point.back()
        for row in rows:
            value, error = float(found.value[row]), float(found.error[row])
            if found.kink[row]:
                continue
            first, first_error, where = slopes.setdefault((names[row], known.name), (value, error, point.where))
            if abs(value - first) > 10.0 * (error + first_error) + 1e-6 * max(abs(value), abs(first)):
                wrong.append(
                    f"{names[row]} is declared to depend on {known.name} by a {declared[names[row]][known.name]} factor, "
                    f"which is {first:.6g} {where} and {value:.6g} {point.where}"
                )
