"""Derivatives and dependencies that the FMU declares, against finite differences at points along a run.

The differences know their own error: central ones with steps h, h/4, ... (Ridders, Accurate
computation of F'(x), Adv. Eng. Software 4, 1982), two neighbours extrapolated, and of these the
pair that changes least. Where the two one-sided differences do not approach each other, however
small the step, there is a kink and no derivative.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np

from validate.fmi.instance import RefusedCall
from validate.fmi.surroundings import listed
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed, unless
from validate.fmu_check.motion import SAFETY, Record, fresh_run, run
from validate.fmu_check.subject import HOLD, Block, CheckedInstance, FmuVariable, Subject

# Steps: from this share of the variable's size, each a quarter of the one before.
_LARGEST = 1e-2
_COUNT = 9
# Rounding of one evaluation, in units of the last place of its value.
_ULPS = 16.0
# Derivatives that an FMU computes by differences itself are less than this off, and are none the
# worse for their users; wrong ones are farther.
_SHARE = 5e-5
_EPS = float(np.finfo(float).eps)
# What rounding leaves of such an entry where it is zero, in typical sizes: forward differences do
# best with steps of the root of rounding.
_FLOOR = math.sqrt(_EPS)


@dataclass(frozen=True)
class _DerivativeColumn:
    """d(unknowns)/d(one known): value, error estimate and where there is no derivative, each (unknowns,)."""

    value: np.ndarray
    error: np.ndarray
    kink: np.ndarray

    @classmethod
    def unknown(cls, count: int) -> _DerivativeColumn:
        """Of which nothing can be said."""
        return cls(np.zeros(count), np.full(count, np.inf), np.zeros(count, dtype=bool))


def _rounding(claimed: np.ndarray) -> float:
    """What large terms that cancel leave of an entry that is zero: some units in the last place of the largest entry."""
    return _ULPS * _EPS * float(np.abs(claimed[np.isfinite(claimed)]).max(initial=0.0))


def _agrees(claimed: np.ndarray, found: _DerivativeColumn, floor: np.ndarray) -> np.ndarray:
    """(unknowns,) whether a claimed column is within the error of the one found, or below `floor` as it is; True where nothing can be said."""
    allowed = (
        10.0 * found.error
        + _SHARE * np.maximum(np.abs(claimed), np.abs(found.value))
        + _rounding(claimed)
        + floor
    )
    return (np.abs(claimed - found.value) <= allowed) | found.kink | ~np.isfinite(found.error)


def _resolved(claimed: np.ndarray, found: _DerivativeColumn) -> np.ndarray:
    """(unknowns,) whether an error of a thousandth of the entry would show."""
    size = np.maximum(np.abs(claimed), np.abs(found.value))
    return ~found.kink & (
        (found.error <= 1e-3 * size) | (np.abs(claimed - found.value) <= found.error)
    )


# Where in a run points are taken, and after how many of its first events.
AFTER_EVENTS = 4
SHARES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
# Of a large FMU, columns are drawn.
MOST_KNOWNS = 60


@dataclass
class _CheckedPoint:
    """An instance at a point: `evaluate` maps the knowns (their entries in order) to the unknowns, and leaves the instance at the point after back().

    fresh: makes another instance that was brought there in the same way, for one that refused a call.
    """

    where: str
    instance: CheckedInstance
    fresh: Callable[[], CheckedInstance]
    knowns: Block
    unknowns: Block
    x: np.ndarray
    time: float
    state_entries: int
    is_initial: bool = False

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """Unknowns (entries,) [unit of each] for knowns x (entries,) [unit of each].

        Raises FMICallException.
        """
        if self.state_entries:
            self.instance.move(self.time, x[: self.state_entries])
        self.instance.set(self._given, x[self.state_entries :])
        return self.instance.get(self.unknowns)

    def back(self) -> None:
        """Set the knowns of the point again."""
        self.evaluate(self.x)

    def renew(self, refusal: RefusedCall) -> None:
        """Go on with another instance after a refusal. Raises that if it was fatal: then there is no other."""
        if self.instance.fmu.fatal:
            raise refusal
        self.instance.free()
        self.instance = self.fresh()
        self.back()

    @cached_property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest values (entries,) of the knowns that are declared, and not refused [unit of each]. Raises nothing."""
        knowns = self.knowns
        starts = np.nan_to_num(knowns.starts)
        return (
            np.where(knowns.refuses("below"), starts, knowns.each(lambda item: item.lower)),
            np.where(knowns.refuses("above"), starts, knowns.each(lambda item: item.upper)),
        )

    @cached_property
    def _given(self) -> Block:
        """Knowns that are no states: those come first."""
        return Block(self.knowns[int(np.searchsorted(self.knowns.ends, self.state_entries)) :])

    def column(self, place: int, largest: float = _LARGEST) -> _DerivativeColumn:
        """The derivatives by entry `place` of x, by finite differences.

        Without any where the point is at the edge of what is allowed, or a value is refused.
        """
        try:
            return self._column(place, largest)
        except RefusedCall as refusal:
            self.renew(refusal)
            return _DerivativeColumn.unknown(self.unknowns.entries)

    def _column(self, place: int, largest: float) -> _DerivativeColumn:
        x, (lower, upper) = self.x, self.limits
        most = largest * max(self.knowns.scales[place], abs(x[place]))
        most = min(most, x[place] - lower[place], upper[place] - x[place])
        if not most > 4.0**_COUNT * _EPS * abs(x[place]):  # the last step would be rounded away
            return _DerivativeColumn.unknown(self.unknowns.entries)
        middle = self.evaluate(x)
        central, forward, backward, noise = [], [], [], []
        for number in range(_COUNT):
            step = most / 4.0**number
            above, below = x.copy(), x.copy()
            above[place] = min(x[place] + step, upper[place])
            below[place] = max(x[place] - step, lower[place])
            up, down = self.evaluate(above), self.evaluate(below)
            right, left = above[place] - x[place], x[place] - below[place]
            central.append((up - down) / (right + left))
            forward.append((up - middle) / right)
            backward.append((middle - down) / left)
            noise.append(
                _ULPS
                * _EPS
                * np.maximum(np.maximum(np.abs(up), np.abs(down)), np.abs(middle))
                / step
            )
        d, rounding = np.array(central), np.array(noise)
        extrapolated = (16.0 * d[1:] - d[:-1]) / 15.0
        error = np.abs(extrapolated[1:] - extrapolated[:-1]) + 2.0 * rounding[2:]
        error = np.where(np.isfinite(error), error, np.inf)
        best = np.argmin(error, axis=0)
        columns = np.arange(d.shape[1])
        gap = np.abs(np.array(forward) - np.array(backward))
        # A smooth function's one-sided differences approach each other as the step; four times
        # smaller, four times nearer.
        here, before = gap[best + 2, columns], gap[best + 1, columns]
        kink = (here > 0.5 * before) & (here > 10.0 * rounding[best + 2, columns])
        return _DerivativeColumn(extrapolated[best + 1, columns], error[best, columns], kink)

    def entries(self) -> list[tuple[int, FmuVariable]]:
        """(place in x, known) of the entries to look at: all, or some of a large FMU."""
        every = [*enumerate(item for item in self.knowns for _ in range(item.size))]
        if len(every) <= MOST_KNOWNS:
            return every
        return [
            every[place]
            for place in sorted(
                np.random.default_rng(3).choice(len(every), MOST_KNOWNS, replace=False)
            )
        ]


def _points(subject: Subject, kind: str) -> Iterator[_CheckedPoint]:
    """Points along a run: unknowns are derivatives and outputs, knowns are states and continuous inputs (Co-Simulation: inputs, outputs)."""
    steps = subject.long_steps(kind)
    exchange = kind == "ME"
    outputs = [item for item in subject.outputs if item.is_float]
    states = (
        subject.states
        if exchange and subject.states.entries == int(subject.description.numberOfContinuousStates)
        else Block()
    )
    knowns = Block([*states, *subject.continuous_inputs])
    unknowns = Block([*(subject.derivatives if exchange else []), *outputs])
    if not knowns or not unknowns:
        return
    count = states.entries
    instance, before = CheckedInstance(subject, kind).begin(), 0
    for place in _places(subject, kind, steps):
        if place > before:
            run(instance, before, place, observe="end")
        x = np.concatenate(
            [
                instance.states() if count else np.empty(0),
                instance.get(subject.continuous_inputs),
            ]
        )
        point = _CheckedPoint(
            f"at t = {subject.time(place):.6g} s",
            instance,
            partial(_brought, subject, kind, place),
            knowns,
            unknowns,
            x,
            subject.time(place),
            count,
        )
        yield point
        point.back()
        instance, before = point.instance, place
    instance.close()


def _brought(subject: Subject, kind: str, place: int) -> CheckedInstance:
    """A new instance at the end of so many steps."""
    instance = CheckedInstance(subject, kind).begin()
    if place:
        run(instance, 0, place, observe="end")
    return instance


def _places(subject: Subject, kind: str, steps: int) -> list[int]:
    """Steps at whose ends to look: spread over the run, and just after the first events, where other equations hold."""
    places = {int(share * steps) for share in SHARES}
    if kind == "ME":
        record = Record()
        fresh_run(subject, kind, steps, "events", observe="end", record=record)
        ends = [
            math.ceil((time - subject.start_time) / subject.step)
            for time, crossed, _ in record.events
            if crossed
        ]
        # Where events crowd, a run that starts afresh at each point could not follow.
        last = (
            math.floor(
                (min(record.crowded, subject.time(steps)) - subject.start_time) / subject.step
            )
            - 1
        )
        places = {
            place
            for place in places | set(list(dict.fromkeys(ends))[:AFTER_EVENTS])
            if place <= max(last, 0)
        }
    return sorted(places)


def _initial_point(subject: Subject, kind: str) -> Iterator[_CheckedPoint]:
    """In Initialization Mode: unknowns are those of the ModelStructure, knowns all that has an exact start; none if there are none or it is refused."""
    unknowns = Block(
        item for item in subject.of(subject.description.initialUnknowns) if item.is_float
    )
    knowns = Block(
        item for item in subject.exact if item.is_float and item.variability != "constant"
    )
    if not knowns or not unknowns:
        return
    instance = _initialising(subject, kind)
    x = instance.get(knowns)
    point = _CheckedPoint(
        "in Initialization Mode",
        instance,
        partial(_initialising, subject, kind),
        knowns,
        unknowns,
        x,
        subject.start_time,
        0,
        is_initial=True,
    )
    try:
        point.back()
    except RefusedCall:
        return
    yield point


def _initialising(subject: Subject, kind: str) -> CheckedInstance:
    """A new instance in Initialization Mode: a little off the starts, where symmetric models have kinks and zeros."""
    instance = CheckedInstance(subject, kind, "initial")
    instance.setup()
    instance.set(*subject.varied)
    instance.enter_initialisation()
    return instance


# A second opinion, with other steps, before a derivative is called wrong.
_OTHER_STEPS = 3.7e-3
# A value that changes by less than this share of its size did not change.
_CHANGED = 1e-9


@check(
    "directional derivatives",
    Scope.EACH,
    clauses=("2.1.9", "2.2.12.1"),
    needs=("providesDirectionalDerivative", "providesDirectionalDerivatives"),
)
def directional(subject: Subject, kind: str) -> Finding:
    """They equal finite differences within the error of those."""
    looked = sharp = kinks = places = 0
    wrong: list[str] = []
    for point in itertools.chain(_points(subject, kind), _initial_point(subject, kind)):
        try:
            for place, known in point.entries():
                point.back()
                seed, ends = np.zeros(known.size), point.knowns.ends
                seed[place - ends[np.searchsorted(ends, place, side="right") - 1]] = 1.0
                claimed = point.instance.fmu.directional(
                    point.unknowns.references, [known.reference], list(seed), point.unknowns.entries
                )
                claimed = np.array(claimed)
                found = point.column(place)
                looked += claimed.size
                sharp += int(np.sum(_resolved(claimed, found)))
                kinks += int(np.sum(found.kink))
                wrong.extend(_wrong(point, place, known, claimed, found))
            places += 1
        except RefusedCall:
            if (
                not point.is_initial
            ):  # there by parameters, or of a value outside its range: not every FMU has those
                raise
    if not looked and not wrong:
        return not_offered(
            "there is nothing to derive: no states or inputs, or no derivatives or outputs."
        )
    at_kinks = f", {kinks} lie at kinks" if kinks else ""
    return unless(
        wrong,
        f"{looked} entries at {places} points agree; for {sharp} an error of a thousandth would show{at_kinks}.",
        end="",
    )


def _wrong(
    point: _CheckedPoint,
    place: int,
    known: FmuVariable,
    claimed: np.ndarray,
    found: _DerivativeColumn,
) -> list[str]:
    floor = _FLOOR * point.unknowns.scales / point.knowns.scales[place]
    bad = ~_agrees(claimed, found, floor)
    if not bad.any():
        return []
    again = point.column(place, _OTHER_STEPS)
    bad &= ~_agrees(claimed, again, floor)
    names = point.unknowns.names
    return [
        f"d {names[row]} / d {known.name} {point.where} is {claimed[row]:.6g}, finite differences give {found.value[row]:.6g} +- {found.error[row]:.1g}"
        for row in np.flatnonzero(bad)
    ]


@check(
    "adjoint derivatives",
    Scope.EACH,
    clauses=("", "2.2.12.2"),
    needs=("", "providesAdjointDerivatives"),
)
def adjoint(subject: Subject, kind: str) -> Finding:
    """They are the transpose of what finite differences give."""
    looked = 0
    dice = np.random.default_rng(11)
    for point in _points(subject, kind):
        if len(point.entries()) < point.x.size:
            return not_offered("the model is too large for all columns.")
        columns = [point.column(place) for place, _ in point.entries()]
        point.back()
        rows = point.unknowns.entries
        for seed in [*np.eye(rows), dice.uniform(-1.0, 1.0, rows)]:
            claimed = point.instance.fmu.adjoint(
                point.unknowns.references, point.knowns.references, list(seed), point.knowns.entries
            )
            claimed = np.array(claimed)
            used = seed != 0.0
            for (place, known), found in zip(point.entries(), columns, strict=True):
                if bool((found.kink & used).any()):
                    continue
                value = float(seed[used] @ found.value[used])
                error = float(np.abs(seed[used]) @ found.error[used])
                size = float(np.abs(seed[used]) @ np.abs(found.value[used]))
                looked += 1
                if not abs(claimed[place] - value) <= 10.0 * error + 1e-6 * max(
                    size, abs(claimed[place])
                ) + _rounding(claimed):
                    names = [
                        name for name, one in zip(point.unknowns.names, used, strict=True) if one
                    ]
                    return failed(
                        f"the adjoint of {listed(names, 1)} by {known.name} {point.where} is {claimed[place]:.6g}, "
                        f"finite differences give {value:.6g} +- {error:.1g}."
                    )
    if not looked:
        return not_offered("there is nothing to derive.")
    return passed(f"{looked} entries agree, one seed at a time and all at once.")


@check("dependencies are complete", Scope.EACH, clauses=("2.2.8", "2.4.8"))
def dependencies(subject: Subject, kind: str) -> Finding:
    """Nothing changes that is not declared to depend on what was changed, and constant factors are constant."""
    structure = subject.description
    running = _declared(subject, [*structure.derivatives, *structure.outputs])
    starting = _declared(subject, structure.initialUnknowns)
    if not running and not starting:
        return not_offered("no unknown of the ModelStructure declares its dependencies.")
    wrong: list[str] = []
    looked = 0
    slopes: dict[tuple[str, str], tuple[float, float, str]] = {}
    for point in _points(subject, kind):
        looked += _missing(point, running, wrong)
        _factors(point, running, slopes, wrong)
    for point in _initial_point(subject, kind) if starting else ():
        looked += _missing(point, starting, wrong)
    if not looked and not wrong:
        return not_offered("there is nothing that can be changed and compared.")
    fine = f"{looked} pairs that are declared independent are so; {len(slopes)} declared factors are constant."
    return unless(list(dict.fromkeys(wrong)), fine, end="")


# Name of an unknown -> its declared knowns, by `FmuVariable.key`, as aliases are one -> kind.
_Declared: TypeAlias = dict[str, dict[tuple[int, str], str]]


def _declared(subject: Subject, unknowns: list) -> _Declared:
    """Return the declarations of some unknowns. Those that declare nothing depend on everything."""
    found: _Declared = {}
    for item in unknowns:
        if item.dependencies is not None and item.variable.name in subject.by_name:
            kinds = item.dependenciesKind or ["dependent"] * len(item.dependencies)
            found[item.variable.name] = {
                subject.by_name[known.name].key: kind
                for known, kind in zip(item.dependencies, kinds, strict=False)
                if known.name in subject.by_name
            }
    return found


def _missing(point: _CheckedPoint, declared: _Declared, wrong: list[str]) -> int:
    """Add to `wrong` what changes undeclared; the number of pairs looked at."""
    looked, names, drawn = 0, point.unknowns.names, point.entries()
    keys = [item.key for item in point.unknowns for _ in range(item.size)]
    point.back()
    base = point.evaluate(point.x)
    asked = np.array([name in declared for name in names], dtype=bool)
    # For each value that is moved, the rows that must stay: of what declares none of its names, and
    # is none of them.
    independent = {known.key: asked.copy() for _, known in drawn}
    for row, (name, key) in enumerate(zip(names, keys, strict=True)):
        for other in independent.keys() & {key, *declared.get(name, ())}:
            independent[other][row] = False
    lower, upper = point.limits
    for place, known in drawn:
        moved = point.x.copy()
        step = 1e-2 * max(point.knowns.scales[place], abs(moved[place]))
        moved[place] += step if moved[place] + step <= upper[place] else -step
        if moved[place] < lower[place]:
            continue
        try:
            values = point.evaluate(moved)
        except RefusedCall as refusal:
            point.renew(refusal)
            continue
        looked += int(independent[known.key].sum())
        changed = np.abs(values - base) > _CHANGED * np.maximum(np.abs(base), np.abs(values))
        wrong.extend(
            f"{names[row]} changes with {known.name} {point.where}, but does not declare that it depends on it"
            for row in np.flatnonzero(independent[known.key] & changed)
        )
        point.back()
    return looked


def _factors(
    point: _CheckedPoint,
    declared: _Declared,
    slopes: dict[tuple[str, str], tuple[float, float, str]],
    wrong: list[str],
) -> None:
    """Compare the slopes of dependencies declared `constant` or `fixed` with those at the points before."""
    names = point.unknowns.names
    for place, known in point.entries():
        rows = [
            row
            for row, name in enumerate(names)
            if declared.get(name, {}).get(known.key) in ("constant", "fixed")
        ]
        if not rows:
            continue
        found = point.column(place)
        point.back()
        for row in rows:
            value, error = float(found.value[row]), float(found.error[row])
            if found.kink[row] or not math.isfinite(error):
                continue
            first, first_error, where = slopes.setdefault(
                (names[row], known.name), (value, error, point.where)
            )
            if abs(value - first) > 10.0 * (error + first_error) + 1e-6 * max(
                abs(value), abs(first)
            ):
                wrong.append(
                    f"{names[row]} is declared to depend on {known.name} by a {declared[names[row]][known.key]} factor, "
                    f"which is {first:.6g} {where} and {value:.6g} {point.where}"
                )


# Points at which derivatives are compared with what their states do, and how short a step is made
# there, as a share of the FMU's.
_PLACES = 6
_SHORT = 1e-5


@check("derivatives are those of the states", Scope.COSIMULATION, clauses=("2.2.7", "2.4.7.4"))
def rates(subject: Subject, kind: str) -> Finding:
    """A variable that is the derivative of another is how fast that moves in a very short step."""
    if not subject.rates or not subject.can(kind, "canHandleVariableCommunicationStepSize"):
        return not_offered(
            "that needs variables that are derivatives, and communication steps of any length."
        )
    derivatives, moving = (Block(pair[place] for pair in subject.rates) for place in (0, 1))
    steps, short = subject.steps(kind), _SHORT * subject.step
    names, places, resolved = derivatives.names, 0, False
    # In the time in which a state moves by its size, the solver inside may be wrong by the tolerance
    # of that size: as large a share of its speed.
    fastest, share = np.zeros(moving.entries), SAFETY * subject.tolerance
    with CheckedInstance(subject, kind).begin() as instance:
        for step in range(steps):
            if step % HOLD == 0:
                instance.set(subject.continuous_inputs, subject.inputs_at(step))
            time = subject.time(step)
            if (step + 1) % max(steps // _PLACES, 1):
                instance.do_step(time, subject.step)
                continue
            first = instance.get(moving)
            instance.do_step(time, short)
            middle, claimed = instance.get(moving), instance.get(derivatives)
            instance.do_step(time + short, short)
            last = instance.get(moving)
            before, after = (middle - first) / short, (last - middle) / short
            rounding = _ULPS * _EPS * np.maximum(np.abs(middle), abs(time)) / short
            size = np.maximum(np.abs(claimed), np.maximum(np.abs(before), np.abs(after)))
            away = np.maximum(
                np.minimum(before, after) - claimed, claimed - np.maximum(before, after)
            )
            # What does not move at all has a step of its own inside; where it bends within so short
            # a step, something jumps.
            allowed = 0.1 * _SHARE * size
            told = (
                (middle != first)
                & (last != middle)
                & (np.abs(after - before) <= allowed + rounding)
                & (rounding <= allowed)
            )
            places, resolved = places + 1, resolved or bool(told.any())
            fastest = np.maximum(fastest, size)
            wrong = told & (away > np.maximum(_SHARE * size, share * fastest))
            if wrong.any():
                at = int(np.argmax(wrong))
                return failed(
                    f"{names[at]} is {claimed[at]:.9g} at t = {time:.6g} s, where its state moves by {before[at]:.9g} a second before and {after[at]:.9g} after it."
                )
            instance.do_step(time + 2.0 * short, subject.step - 2.0 * short)
    if not resolved:
        return not_offered(
            f"in steps of {short:g} s nothing moves evenly: it has a step of its own inside."
        )
    return passed(
        f"{len(names)} derivatives at {places} times are what steps of {short:.1g} s make of their states."
    )
