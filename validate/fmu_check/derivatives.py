"""Declared derivatives and dependencies against finite differences at points along a run.

The differences know their own error: central ones with steps h, h/4, .. (Ridders, Accurate
computation of F'(x), Adv. Eng. Software 4, 1982), two neighbours extrapolated, and of these the
pair that changes least. If the two one-sided differences do not approach each other, however small
the step, there is a kink and no derivative.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple, TypeAlias

import numpy as np

from validate.fmi.instance import RefusedCall
from validate.fmi.surroundings import listed
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed, unless
from validate.fmu_check.motion import SAFETY, Record, fresh_run, run
from validate.fmu_check.subject import HOLD, MOVED, Block, CheckedInstance, FmuVariable, Subject

_EPS = float(np.finfo(float).eps)
# Rounding of one evaluation, in units of the last place of its value.
_ULPS = 16.0
# Finite differences: number of steps, each a quarter of the one before. From MOVED of the variable's
# size they pass the cube root of rounding, the best step of a central difference.
_COUNT = 9
# Largest first step of a second measurement, before a derivative is called wrong: no power of two
# from the first one.
_OTHER_STEPS = 3.7e-3
# A difference exceeds the estimated error of finite differences by at most this factor.
_WITHIN = 10.0
# Relative error of derivatives that an FMU computes by differences itself; wrong ones are farther off.
_SHARE = 5e-5
# Relative error of adjoints and of factors declared constant: those are computed, not approximated.
_EXACT = 1e-6
# Error of such differences for an entry that is zero, in typical sizes: forward differences are best
# with steps of the root of rounding.
_FLOOR = math.sqrt(_EPS)
# A value changes if it moves by more than this share of its size: far above rounding.
_CHANGED = 1e-9
# Shares of a run at which points are taken ...
SHARES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
# ... and the number of first events after which points are taken, where other equations may hold.
AFTER_EVENTS = 4
# Columns of a large FMU that are drawn: two evaluations of all unknowns per step and column.
MOST_KNOWNS = 60


class _Column(NamedTuple):
    """d(unknowns)/d(one known): value, error estimate and whether a kink, each (unknowns,)."""

    value: np.ndarray
    error: np.ndarray
    kink: np.ndarray


def _rounding(claimed: np.ndarray) -> float:
    """Return the rounding of zero entries that are sums of large terms, from claimed (entries,)."""
    return _ULPS * _EPS * float(np.abs(claimed[np.isfinite(claimed)]).max(initial=0.0))


def _agrees(claimed: np.ndarray, found: _Column, floor: np.ndarray) -> np.ndarray:
    """Return whether claimed entries (unknowns,) are within error or floor, or unmeasurable.

    The result has the shape (unknowns,).
    """
    allowed = (
        _WITHIN * found.error
        + _SHARE * np.maximum(np.abs(claimed), np.abs(found.value))
        + _rounding(claimed)
        + floor
    )
    return (np.abs(claimed - found.value) <= allowed) | found.kink | ~np.isfinite(found.error)


@dataclass
class _CheckedPoint:
    """An instance at a point, and the map from knowns to unknowns there.

    fresh: makes another instance at the point, in place of one that refused a call.
    x: (entries of the knowns,) the point; states, of `state_entries`, come first [unit of each].
    """

    where: str
    instance: CheckedInstance
    fresh: Callable[[], CheckedInstance]
    knowns: Block
    unknowns: Block
    x: np.ndarray
    time: float
    state_entries: int = 0
    is_initial: bool = False

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """Return the unknowns (entries,) at knowns (entries,) [unit of each].

        Raises FMICallException.
        """
        if self.state_entries:
            self.instance.move(self.time, x[: self.state_entries])
        self.instance.set(self._settable, x[self.state_entries :])
        return self.instance.get(self.unknowns)

    def back(self) -> None:
        """Set the knowns of the point again."""
        self.evaluate(self.x)

    def renew(self, refusal: RefusedCall) -> None:
        """Replace the instance after a refusal. Raises the refusal if it was fatal."""
        if self.instance.fmu.fatal:
            raise refusal
        self.instance.free()
        self.instance = self.fresh()
        self.back()

    @cached_property
    def _settable(self) -> Block:
        """Knowns that are no states."""
        return Block(self.knowns[int(np.searchsorted(self.knowns.ends, self.state_entries)) :])

    def column(self, place: int, largest: float = MOVED) -> _Column:
        """Return the derivatives by entry `place` of x, by finite differences.

        The error is infinite at the edge of the range, and where a value is refused.
        """
        count = self.unknowns.entries
        unknown = _Column(np.zeros(count), np.full(count, np.inf), np.zeros(count, dtype=bool))
        x, (lower, upper) = self.x, self.knowns.limits
        most = largest * max(self.knowns.scales[place], abs(x[place]))
        most = min(most, x[place] - lower[place], upper[place] - x[place])
        if not most > 4.0**_COUNT * _EPS * abs(x[place]):  # the last step would be rounded away
            return unknown
        try:
            return self._column(place, most)
        except RefusedCall as refusal:
            self.renew(refusal)
            return unknown

    def _column(self, place: int, most: float) -> _Column:
        x, middle, (lower, upper) = self.x, self.evaluate(self.x), self.knowns.limits
        central, gap, noise = [], [], []
        for number in range(_COUNT):
            above, below = x.copy(), x.copy()
            above[place] = min(x[place] + most / 4.0**number, upper[place])
            below[place] = max(x[place] - most / 4.0**number, lower[place])
            up, down = self.evaluate(above), self.evaluate(below)
            right, left = above[place] - x[place], x[place] - below[place]
            central.append((up - down) / (right + left))
            gap.append(np.abs((up - middle) / right - (middle - down) / left))
            noise.append(_ULPS * _EPS * np.abs([up, down, middle]).max(axis=0) / right)
        d, gaps, rounding = np.array(central), np.array(gap), np.array(noise)
        extrapolated = (16.0 * d[1:] - d[:-1]) / 15.0
        error = np.abs(extrapolated[1:] - extrapolated[:-1]) + 2.0 * rounding[2:]
        error = np.where(np.isfinite(error), error, np.inf)
        best, columns = np.argmin(error, axis=0), np.arange(d.shape[1])
        # One-sided differences of a smooth function approach each other as the step: by a factor of
        # four.
        here, before = gaps[best + 2, columns], gaps[best + 1, columns]
        kink = (here > 0.5 * before) & (here > _WITHIN * rounding[best + 2, columns])
        return _Column(extrapolated[best + 1, columns], error[best, columns], kink)

    def entries(self) -> list[tuple[int, FmuVariable]]:
        """Return (place in x, known) of all entries, or of some of a large FMU."""
        every = [*enumerate(item for item in self.knowns for _ in range(item.size))]
        if len(every) <= MOST_KNOWNS:
            return every
        chosen = np.random.default_rng(3).choice(len(every), MOST_KNOWNS, replace=False)
        return [every[place] for place in sorted(chosen)]


def _points(subject: Subject, kind: str) -> Iterator[_CheckedPoint]:
    """Yield points along a run: unknowns are derivatives and outputs, knowns states and inputs.

    Co-Simulation has outputs and inputs alone.
    """
    states, derivatives = Block(), Block()
    if kind == "ME":
        derivatives = subject.derivatives
        if subject.states.entries == int(subject.description.numberOfContinuousStates):
            states = subject.states
    knowns = Block([*states, *subject.continuous_inputs])
    unknowns = Block([*derivatives, *(item for item in subject.outputs if item.is_float)])
    if not knowns or not unknowns:
        return
    instance, before = CheckedInstance(subject, kind).begin(), 0
    for place in _places(subject, kind):
        run(instance, before, place, observe="end")
        inputs = instance.get(subject.continuous_inputs)
        point = _CheckedPoint(
            f"at t = {subject.time(place):.6g} s",
            instance,
            partial(_brought, subject, kind, place),
            knowns,
            unknowns,
            np.concatenate([instance.states(), inputs]) if states else inputs,
            subject.time(place),
            states.entries,
        )
        yield point
        point.back()
        instance, before = point.instance, place
    instance.close()


def _brought(subject: Subject, kind: str, place: int) -> CheckedInstance:
    """Return a new instance after `place` steps."""
    instance = CheckedInstance(subject, kind).begin()
    run(instance, 0, place, observe="end")
    return instance


def _places(subject: Subject, kind: str) -> list[int]:
    """Return the steps at whose ends points are taken: spread over the run, and after events."""
    steps = subject.long_steps(kind)
    places = {int(share * steps) for share in SHARES}
    if kind != "ME":
        return sorted(places)
    record = Record()
    fresh_run(subject, kind, steps, "events", observe="end", record=record)
    grid = [
        (time - subject.start_time) / subject.step for time, crossed, _ in record.events if crossed
    ]
    after = list(dict.fromkeys(map(math.ceil, grid)))[:AFTER_EVENTS]
    # A run that starts again at each point cannot follow crowded events.
    end = min(record.crowded, subject.time(steps))
    last = max(0, math.floor((end - subject.start_time) / subject.step) - 1)
    return sorted(place for place in places | set(after) if place <= last)


def _initial_point(subject: Subject, kind: str) -> Iterator[_CheckedPoint]:
    """Yield the point in Initialization Mode, if the FMU has one and lets its knowns be set.

    Unknowns are those of the ModelStructure, knowns all variables with an exact start.
    """
    unknowns = subject.of(subject.description.initialUnknowns)
    unknowns = Block(item for item in unknowns if item.is_float)
    knowns = Block(
        item for item in subject.exact if item.is_float and item.variability != "constant"
    )
    if not knowns or not unknowns:
        return
    fresh = partial(_initialising, subject, kind)
    instance = fresh()
    x, where = instance.get(knowns), "in Initialization Mode"
    point = _CheckedPoint(
        where, instance, fresh, knowns, unknowns, x, subject.start_time, is_initial=True
    )
    try:
        point.back()
    except RefusedCall:
        return
    yield point


def _initialising(subject: Subject, kind: str) -> CheckedInstance:
    """Return a new instance in Initialization Mode, off the starts, where kinks and zeros are."""
    return CheckedInstance(subject, kind, "initial").initialising(subject.varied)


@check(
    "directional derivatives",
    Scope.EACH,
    clauses=("2.1.9", "2.2.12.1"),
    needs=("providesDirectionalDerivative", "providesDirectionalDerivatives"),
)
def directional(subject: Subject, kind: str) -> Finding:
    """They equal finite differences within the error of those."""
    looked = kinks = places = 0
    wrong: list[str] = []
    for point in itertools.chain(_points(subject, kind), _initial_point(subject, kind)):
        unknowns, ends = point.unknowns, point.knowns.ends
        try:
            for place, known in point.entries():
                point.back()
                seed = [0.0] * known.size
                seed[place - ends[np.searchsorted(ends, place, side="right") - 1]] = 1.0
                claimed = np.array(
                    point.instance.fmu.directional(
                        unknowns.references, [known.reference], seed, unknowns.entries
                    )
                )
                found = point.column(place)
                looked += claimed.size
                kinks += int(np.sum(found.kink))
                floor = _FLOOR * unknowns.scales / point.knowns.scales[place]
                bad = ~_agrees(claimed, found, floor)
                if bad.any():
                    bad &= ~_agrees(claimed, point.column(place, _OTHER_STEPS), floor)
                wrong += [
                    f"d {unknowns.names[row]} / d {known.name} {point.where} is {claimed[row]:.6g}, finite differences give {found.value[row]:.6g} +- {found.error[row]:.1g}"
                    for row in np.flatnonzero(bad)
                ]
            places += 1
        except RefusedCall:
            # In Initialization Mode, by parameters or beyond a range: not every FMU has derivatives.
            if not point.is_initial:
                raise
    if not looked and not wrong:
        return not_offered(
            "there is nothing to derive: no states or inputs, or no derivatives or outputs."
        )
    at_kinks = f", {kinks} lie at kinks" if kinks else ""
    return unless(wrong, f"{looked} entries at {places} points agree{at_kinks}.")


@check(
    "adjoint derivatives",
    Scope.EACH,
    clauses=("", "2.2.12.2"),
    needs=("", "providesAdjointDerivatives"),
)
def adjoint(subject: Subject, kind: str) -> Finding:
    """They are the transpose of what finite differences give."""
    looked, dice = 0, np.random.default_rng(11)
    for point in _points(subject, kind):
        entries, unknowns, knowns = point.entries(), point.unknowns, point.knowns
        if len(entries) < point.x.size:
            return not_offered("the model is too large for all columns.")
        columns = [point.column(place) for place, _ in entries]
        value, error, kink = (np.array(part) for part in zip(*columns, strict=True))
        point.back()
        rows = unknowns.entries
        for seed in [*np.eye(rows), dice.uniform(-1.0, 1.0, rows)]:
            claimed = np.array(
                point.instance.fmu.adjoint(
                    unknowns.references, knowns.references, list(seed), knowns.entries
                )
            )
            used, weight = seed != 0.0, np.abs(seed)
            expected = value[:, used] @ seed[used]
            bar = error[:, used] @ weight[used]
            size = np.maximum(np.abs(value[:, used]) @ weight[used], np.abs(claimed))
            known = ~kink[:, used].any(axis=1)
            looked += int(known.sum())
            allowed = _WITHIN * bar + _EXACT * size + _rounding(claimed)
            bad = np.flatnonzero(known & ~(np.abs(claimed - expected) <= allowed))
            for place in bad:
                names = list(itertools.compress(unknowns.names, used))
                return failed(
                    f"the adjoint of {listed(names, 1)} by {knowns.names[place]} {point.where} is "
                    f"{claimed[place]:.6g}, finite differences give {expected[place]:.6g} +- {bar[place]:.1g}."
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
    return unless(list(dict.fromkeys(wrong)), fine)


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
    """Add clauses about undeclared changes to `wrong`; return the number of pairs looked at."""
    looked, names, drawn = 0, point.unknowns.names, point.entries()
    keys = [item.key for item in point.unknowns for _ in range(item.size)]
    point.back()
    base = point.evaluate(point.x)
    declares = np.array([name in declared for name in names], dtype=bool)
    # For each known the rows that must stay: unknowns that declare none of its names, and are none.
    independent = {known.key: declares.copy() for _, known in drawn}
    for row, (name, key) in enumerate(zip(names, keys, strict=True)):
        for other in independent.keys() & {key, *declared.get(name, ())}:
            independent[other][row] = False
    lower, upper = point.knowns.limits
    for place, known in drawn:
        moved = point.x.copy()
        step = MOVED * max(point.knowns.scales[place], abs(moved[place]))
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
        wrong += [
            f"{names[row]} changes with {known.name} {point.where}, but does not declare that it depends on it"
            for row in np.flatnonzero(independent[known.key] & changed)
        ]
        point.back()
    return looked


def _factors(
    point: _CheckedPoint,
    declared: _Declared,
    slopes: dict[tuple[str, str], tuple[float, float, str]],
    wrong: list[str],
) -> None:
    """Compare slopes declared `constant` or `fixed` with those at earlier points."""
    names = point.unknowns.names
    for place, known in point.entries():
        kinds = [declared.get(name, {}).get(known.key) for name in names]
        rows = [row for row, kind in enumerate(kinds) if kind in ("constant", "fixed")]
        if not rows:
            continue
        found = point.column(place)
        point.back()
        for row in rows:
            value, error = float(found.value[row]), float(found.error[row])
            if found.kink[row] or not math.isfinite(error):
                continue
            here = (value, error, point.where)
            first, first_error, where = slopes.setdefault((names[row], known.name), here)
            allowed = _WITHIN * (error + first_error) + _EXACT * max(abs(value), abs(first))
            if abs(value - first) > allowed:
                wrong.append(
                    f"{names[row]} is declared to depend on {known.name} by a {kinds[row]} factor, "
                    f"which is {first:.6g} {where} and {value:.6g} {point.where}"
                )


# Times at which derivatives are compared with the motion of their states.
_PLACES = 6
# Length of the steps there, as a share of the FMU's: short against the motion. Rounding is 4e-10 of a
# state per communication step.
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
    # While a state moves by its size, the solver inside may be wrong by the tolerance of that size:
    # by as large a share of its speed.
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
            try:
                instance.do_step(time, short)
            except RefusedCall as refusal:
                refusal.setting = f"a step of {short:g} s"
                return not_offered(f"{refusal.sentence}.")
            middle, claimed = instance.get(moving), instance.get(derivatives)
            instance.do_step(time + short, short)
            last = instance.get(moving)
            before, after = (middle - first) / short, (last - middle) / short
            low, high = np.minimum(before, after), np.maximum(before, after)
            rounding = _ULPS * _EPS * np.maximum(np.abs(middle), abs(time)) / short
            size = np.abs([claimed, before, after]).max(axis=0)
            # A value that does not move at all has an internal step; one that bends within so short
            # a step jumps.
            allowed = 0.1 * _SHARE * size
            is_even = (middle != first) & (last != middle)
            is_even &= (high - low <= allowed + rounding) & (rounding <= allowed)
            places, resolved = places + 1, resolved or bool(is_even.any())
            fastest = np.maximum(fastest, size)
            away = np.maximum(low - claimed, claimed - high)
            wrong = is_even & (away > np.maximum(_SHARE * size, share * fastest))
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
