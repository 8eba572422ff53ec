"""Communication steps: times, stop time, and optional features of Co-Simulation.

The features are event mode, early return and intermediate update of FMI 3.0, and input derivatives
of 2.0. The times are start and end of a step, and the reported time.
"""

from __future__ import annotations

import time
from itertools import pairwise
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.archive import is_version
from validate.fmi.instance import Misbehaviour, RefusedCall
from validate.fmu_check.check import (
    Failed,
    Finding,
    Scope,
    advice,
    check,
    failed,
    not_offered,
    passed,
    unless,
)
from validate.fmu_check.motion import compare, fresh_run, require_equal, run
from validate.fmu_check.subject import HOLD, Block, CheckedInstance, Subject

# Largest difference of two equal times, as a share of a step: FMUs sum up their steps.
_SAME = 1e-6
# Status of a step that was not made whole.
_DISCARD = 2
# Steps of the first run, which measures the pace.
_FIRST_STEPS = 5
# Evaluations of CVODE in a communication step, about.
_EVALUATIONS = 30


@check("starts and ends", Scope.EACH, clauses=("2.1.6", "2.3"))
def lives(subject: Subject, kind: str) -> Finding:
    """It loads, is instantiated, initialised, makes some steps, is terminated and freed."""
    steps = subject.before_end(kind, _FIRST_STEPS)
    with CheckedInstance(subject, kind) as instance:
        answer = instance.fmu.getVersion()
        if not is_version(answer, subject.major):
            described = subject.description.fmiVersion
            return failed(
                f"the binary says that it is FMI {answer}, the description says {described}."
            )
        instance.begin()
        paces = []
        for step in range(steps):
            began = time.perf_counter()
            if kind == "CS":
                instance.make_step(step)
            elif instance.state_count:
                moved = instance.states() + 1e-3 * subject.step * instance.rates()
                instance.move(subject.time(step), moved)
            paces.append(time.perf_counter() - began)
        # The first steps are slower: they load code.
        pace = min(paces) * (_EVALUATIONS if kind == "ME" else 1)
        instance.fmu.terminate()
        instance.free()
    made = f"{steps} {'evaluations' if kind == 'ME' else f'steps of {subject.step:g} s'}"
    return passed(f"{made}; a step takes about {pace:.1g} s.", pace)


@check("time after a step", Scope.EACH, clauses=("2.2.7", "2.4.7.4"))
def keeps_time(subject: Subject, kind: str) -> Finding:
    """The FMU's own time is the time to which it was brought."""
    sources: set[str] = set()
    wrong: list[str] = []
    steps = subject.before_end(kind, _FIRST_STEPS)
    with CheckedInstance(subject, kind).begin() as instance:
        for step in range(steps):
            end = subject.time(step + 1)
            times: dict[str, float] = {}
            if kind == "ME":
                instance.set_time(end)
            else:
                reached = instance.do_step(subject.time(step), subject.step).reached
                if subject.major >= 3:
                    times["fmi3DoStep's lastSuccessfulTime"] = reached
            read = instance.get(subject.clocks).tolist()
            names = (f"the variable {name}" for name in subject.clocks.names)
            times |= dict(zip(names, read, strict=True))
            sources |= times.keys()
            wrong += [
                f"{source} says {value:.10g} s at t = {end:.10g} s"
                for source, value in times.items()
                if not abs(value - end) <= _SAME * subject.step
            ]
    if wrong and kind == "CS" and subject.step < subject.internal_step * (1.0 - _SAME):
        return advice(
            f"{wrong[0]}: the step of {subject.step:g} s, which the FMU proposes, is below the one "
            f"it makes inside, {subject.internal_step:g} s; propose a multiple of that."
        )
    if not sources:
        return not_offered("there is no independent variable, and no step returns a time.")
    return unless(wrong[:1], f"{' and '.join(sorted(sources))}: right at {steps} times.")


@check("stop time is respected", Scope.COSIMULATION, clauses=("2.1.6", "2.3.2"))
def stop_time(subject: Subject, kind: str) -> Finding:
    """A step up to the stop time is made, a step beyond it is refused."""
    steps = subject.before_end(kind, 4)
    stop = subject.time(steps)
    with CheckedInstance(subject, kind).begin(stop=stop) as instance:
        for step in range(steps):
            try:
                instance.make_step(step)
            except FMICallException:
                return failed(
                    f"the step to t = {subject.time(step + 1):.6g} s is refused, though the stop "
                    f"time is {stop:.6g} s{instance.quote()}."
                )
        try:
            instance.make_step(steps)
        except FMICallException as error:
            reached = instance.fmu.last_successful_time() if error.status == _DISCARD else None
            if reached is not None and not abs(reached - stop) <= _SAME * subject.step:
                return failed(
                    "the step beyond the stop time is discarded, and the last successful time is "
                    f"told as {reached:.6g} s; it is {stop:.6g} s."
                )
            made = f"{steps} steps up to the stop time {stop:.6g} s are made"
            return passed(f"{made}, the next one is refused.")
    return failed(
        f"a step to t = {subject.time(steps + 1):.6g} s is answered with OK, though the stop time "
        f"given was {stop:.6g} s."
    )


# Steps without progress before they are called endless.
_STILL = 100
# Two runs differ at a time if a value is off by this share of its range ...
_OFF = 0.05
# ... and their motion differs if they do so at this share of the times: events in another step move
# a value for some steps only.
_OFTEN = 0.25
_UPDATE = "providesIntermediateUpdate"
_MIGHT_RETURN = "mightReturnEarlyFromDoStep"


class _Eventful(CheckedInstance):
    """A Co-Simulation instance with event mode, which updates once more at the end of each event.

    events, early: number of events and of early returns.
    """

    events = early = 0

    def __init__(self, subject: Subject, kind: str, *, early: bool) -> None:
        """early: whether it may return early."""
        options = {"eventModeUsed": True, "earlyReturnAllowed": early}
        super().__init__(subject, kind, options=options)

    def run(self, steps: int) -> np.ndarray:
        """Run from the beginning; return (steps + 1, observed) [unit of each].

        Raises as `motion.run`.
        """
        self.begin().settle()
        return run(self, 0, steps)

    def make_step(self, step: int) -> None:
        """Make one communication step, through all events in it.

        Raises Misbehaviour if an answer of fmi3DoStep cannot be right.
        """
        subject, t, still = self.subject, self.time, 0
        goal, near = subject.time(step + 1), _SAME * subject.step
        while goal - t > near:
            target = min(goal, max(self.next_event, t + near))
            asked, _, early, reached = self.do_step(t, target - t)
            self.early += early
            still = still + 1 if reached - t <= near else 0
            wrong = self._wrong_answer(t, target, early, reached)
            if not wrong and still > _STILL:
                wrong = f"stands still: {_STILL} times it comes back without getting on, whatever events are handled"
            if wrong:
                raise Misbehaviour(f"the step from t = {t:.6g} s to {target:.6g} s {wrong}")
            t = self.time = reached
            if asked or t >= self.next_event - near:
                self.events += 1
                self.event()

    def _wrong_answer(self, t: float, target: float, early: bool, reached: float) -> str:
        """Return what is wrong with the answer of a step from t to target [s]."""
        near, said = _SAME * self.subject.step, f"it reached {reached:.9g} s"
        if early and not self.options["earlyReturnAllowed"]:
            return "returned early, which was not allowed"
        if not early and abs(reached - target) > near:
            return f"says that it did not return early, and that {said}"
        if not t - near <= reached <= target + near:
            return f"says that {said}"
        clocks = self.subject.clocks
        for name, value in zip(clocks.names, self.get(clocks), strict=True):
            if abs(value - reached) > near:
                return f"says that {said}, the variable {name} says {value:.9g} s"
        return ""

    def content(self) -> None:
        """Update once more, which must have no effect."""
        before = self.observe()
        again, *_ = self.fmu.update()
        _, where = compare(self.subject, before[None], self.observe()[None])
        if again or where:
            what = "asks for another one" if again else f"changes values ({where})"
            raise Misbehaviour(
                f"at t = {self.time:.6g} s fmi3UpdateDiscreteStates was content, but called once more it {what}"
            )


def _require_same_way(
    subject: Subject, plain: np.ndarray, other: np.ndarray, how: str, than: str
) -> None:
    """Raise Failed if a state of two runs, each (rows, observed) [unit of each], moves differently.

    how: a clause about the other run; than: the end of the sentence.
    """
    observed = subject.observed
    columns = {
        item.key: slice(begin, begin + item.size)
        for item, begin in zip(observed, observed.ends, strict=False)
    }
    for item in subject.states or [item for item in subject.outputs if item.is_float]:
        if item.key not in columns:
            continue
        one, two = plain[:, columns[item.key]], other[:, columns[item.key]]
        apart = np.abs(one - two)
        off = apart > _OFF * np.ptp(one, axis=0) + 1e-6 * np.abs(one).max(axis=0)
        share = float(off.any(axis=1).mean())
        if share > _OFTEN:
            raise Failed(
                f"{how}, {item.name} is another one at {share:.0%} of the times (by up to {apart.max():.3g}) than {than}."
            )


@check(
    "event mode of Co-Simulation",
    Scope.COSIMULATION,
    clauses=("", "2.3.5"),
    needs=("", "hasEventMode"),
)
def event_mode(subject: Subject, kind: str) -> Finding:
    """Events are announced; a second update changes nothing; the motion is that without event mode; reset forgets."""
    steps = subject.long_steps(kind)
    plain = fresh_run(subject, kind, steps)
    with _Eventful(subject, kind, early=subject.can(kind, _MIGHT_RETURN)) as instance:
        rows = instance.run(steps)
        events = instance.events
        unhandled = "without: not every event is announced and handled"
        _require_same_way(subject, plain, rows, "with event mode", unhandled)
        instance.fmu.reset()
        require_equal(subject, rows, instance.run(steps), "after reset in a run with event mode")
    return passed(f"{events} events handled in {steps} steps; the same after reset, bit for bit.")


@check("early return", Scope.COSIMULATION, clauses=("", "4.1.3"))
def early_return(subject: Subject, kind: str) -> Finding:
    """It returns early only if that is allowed, at the reported time, and on request."""
    on_demand = "canReturnEarlyAfterIntermediateUpdate"
    might, asked = (subject.can(kind, name) for name in (_MIGHT_RETURN, on_demand))
    if subject.major < 3:
        return not_offered("FMI 2.0 has none.")
    if not (might or asked):
        return not_offered(f"neither {_MIGHT_RETURN} nor {on_demand} is true.")
    returns = []
    if subject.can(kind, "hasEventMode"):
        for may in (False, True):
            with _Eventful(subject, kind, early=may) as instance:
                instance.run(subject.long_steps(kind))
        if instance.early and not might:
            return failed(f"it returned early, though {_MIGHT_RETURN} is false.")
        returns.append(f"{instance.early} times at events")
    if asked and subject.can(kind, _UPDATE):
        offered = _returns_where_asked(subject, kind)
        never = "nowhere on demand, as its intermediate update never offered that"
        returns.append("where it was asked to" if offered else never)
    if not returns:
        return not_offered(
            "it has neither event mode nor intermediate update, by which it could be asked."
        )
    return passed(f"it returned early {' and '.join(returns)}; the times told are right.")


def _returns_where_asked(subject: Subject, kind: str) -> bool:
    """Ask for an early return at the first chance; return whether there was one.

    Raises Failed if the FMU does something else.
    """
    chances: list[float] = []

    def ask(*call: Any) -> None:
        _, time, _, _, is_finished, may, early, when = call
        if may and is_finished and not chances:
            chances.append(time)
            early[0], when[0] = True, time

    is_free = subject.can(kind, "canHandleVariableCommunicationStepSize")
    step = HOLD * subject.step if is_free else subject.step
    options = {"earlyReturnAllowed": True, "intermediateUpdate": ask}
    with CheckedInstance(subject, kind, options=options).begin() as instance:
        begin, near = subject.start_time, _SAME * subject.step
        _, _, early, reached = instance.do_step(begin, step)
        if not chances:
            return False
        if not early and begin + step - chances[0] > near:
            raise Failed(
                f"it was asked at {chances[0]:.9g} s to return early, and went on to {reached:.9g} s."
            )
        if early and not chances[0] - near <= reached < begin + step + near:
            raise Failed(
                f"it was asked to return at {chances[0]:.9g} s, and says that it reached {reached:.9g} s."
            )
        left = begin + step - reached
        instance.do_step(reached, left if left > near else subject.step)
    return True


@check("intermediate update", Scope.COSIMULATION, clauses=("", "4.2.2"), needs=("", _UPDATE))
def intermediate_update(subject: Subject, kind: str) -> Finding:
    """It is called within each step, at times that do not go back, offers no early return that is not allowed, and changes nothing."""
    steps = min(subject.steps(kind), 2 * HOLD)
    wrong: list[str] = []  # an exception in a callback would be lost
    times: list[float] = []
    reads: list[float] = []
    near = _SAME * subject.step

    def update(*call: Any) -> None:
        _, time, _, may_get, _, may_return, *_ = call
        times.append(time)
        begin, end = instance.time, instance.time + subject.step
        if not begin - near <= time <= end + near:
            wrong.append(
                f"in the step from t = {begin:.6g} s to {end:.6g} s it is called for t = {time:.9g} s"
            )
        elif may_get and reads and time < reads[-1] - near:
            wrong.append(f"it is called for t = {time:.9g} s after {reads[-1]:.9g} s")
        if may_return:
            wrong.append(f"at t = {time:.6g} s it offers an early return, which was not allowed")
        if may_get:
            reads.append(time)
            try:
                if not np.isfinite(instance.get(watched)).all():
                    wrong.append(f"at t = {time:.6g} s a value is no finite number")
            except FMICallException as error:
                why = str(error).rstrip(".")
                wrong.append(f"at t = {time:.6g} s values may be got, but that is refused ({why})")

    def stepped(step: int) -> None:
        instance.time = subject.time(step + 1)
        if wrong:
            raise Misbehaviour(wrong[0])

    watched = Block(item for item in subject.outputs if item.is_float)
    plain = fresh_run(subject, kind, steps)
    options = {"intermediateUpdate": update, "requiredIntermediateVariables": watched.references}
    with CheckedInstance(subject, kind, options=options) as instance:
        rows = run(instance.begin(), 0, steps, after=stepped)
    if not times:
        return failed(f"it was never called in {steps} steps, though {_UPDATE} is true.")
    _require_same_way(subject, plain, rows, "with a callback that only reads", "without")
    return passed(
        f"{len(times)} calls in {steps} steps, {len(reads)} of them to read {len(watched)} values; "
        "times within the step and never back."
    )


# Steps in place of a slope.
_STAIRS = 64
# The stairs must be nearer to the slope than a constant is, by this factor; they are expected 64 times
# nearer.
_NEARER = 0.1
# Least effect of a slope, as a share of a value: errors of solvers hide smaller ones.
_VISIBLE = 1e-7


@check(
    "input derivatives",
    Scope.COSIMULATION,
    clauses=("4.2.1", ""),
    needs=("canInterpolateInputs", ""),
)
def input_derivatives(subject: Subject, kind: str) -> Finding:
    """A step with sloping inputs is what many small steps with stairs come to."""
    inputs, states = subject.continuous_inputs, subject.states
    is_free = subject.can(kind, "canHandleVariableCommunicationStepSize")
    if not inputs or not states or not is_free:
        return not_offered(
            "that needs continuous inputs, states that are named, and communication steps of any length."
        )
    length = subject.step * HOLD
    first, last = subject.inputs_at(0), subject.inputs_at(HOLD, seed=1)
    slope = (last - first) / length
    flat = np.zeros_like(slope)

    def end(stairs: int, climb: np.ndarray, slopes: np.ndarray | None = None) -> np.ndarray:
        """Return the states (entries,) [unit of each] after the span. Raises FMICallException.

        climb: (nu,) slope of the stairs; slopes: (nu,) input derivatives [unit of each input per s].
        """
        with CheckedInstance(subject, kind).begin() as instance:
            times = subject.start_time + length * np.linspace(0.0, 1.0, stairs + 1)
            for stair, (begin, until) in enumerate(pairwise(times)):
                instance.set(inputs, first + climb * length * (stair + 0.5) / stairs)
                if slopes is not None:
                    orders = [1] * len(inputs)
                    instance.fmu.setRealInputDerivatives(inputs.references, orders, slopes.tolist())
                instance.do_step(float(begin), float(until - begin))
            return instance.get(states)

    held, sloping = end(1, flat, flat), end(1, flat, slope)
    try:
        line, straight = end(_STAIRS, slope), end(_STAIRS, flat)
    except RefusedCall as refusal:
        refusal.setting = f"a step of {length / _STAIRS:g} s"
        return not_offered(f"{refusal.sentence}.")
    scale = np.maximum(np.abs(line), states.scales)
    effect = np.abs(line - held) / scale
    if effect.max(initial=0.0) < _VISIBLE:
        return not_offered(f"what a slope changes within {length:g} s is too small to be seen.")
    own_error = np.abs(straight - held) / scale
    if own_error.max() > _NEARER * effect.max():
        return not_offered(
            f"its own steps are too coarse to tell: without slopes, one step of {length:g} s and {_STAIRS} small ones differ as well."
        )
    away = np.abs(sloping - line) / scale
    worst = int(np.argmax(away - _NEARER * effect))
    if away[worst] > _NEARER * effect[worst] + _VISIBLE:
        return failed(
            f"after {length:g} s with sloping inputs {states.names[worst]} is {sloping[worst]:.9g}; {_STAIRS} stairs along the slope give {line[worst]:.9g}, no slope {held[worst]:.9g}."
        )
    return passed(
        f"one step of {length:g} s with slopes is {_STAIRS} stairs within {away.max():.1g} of the values; no slope is off by {effect.max():.1g}."
    )
