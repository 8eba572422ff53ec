"""Communication steps: start and end, the time that is reported, the stop time, and what Co-Simulation offers besides.

That is events, early return, intermediate update of FMI 3.0 and input derivatives of FMI 2.0.
"""

from __future__ import annotations

import math
import time
from itertools import pairwise
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.instance import Misbehaviour
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

# Two times are the same if they differ by less than this share of a step.
_SAME = 1e-6
# The status of FMI for a step that was not made whole.
_DISCARD = 2
# Steps of the first run, from which the pace is known (in Model Exchange from evaluations, of which
# CVODE takes about so many a step).
_FIRST_STEPS = 5
_EVALUATIONS = 30


@check("starts and ends", Scope.EACH, clauses=("2.1.6", "2.3"))
def lives(subject: Subject, kind: str) -> Finding:
    """It loads, is instantiated, initialised, makes some steps, is terminated and freed."""
    version = {2: "2.0", 3: "3.0"}[subject.major]
    steps = subject.before_end(kind, _FIRST_STEPS)
    with CheckedInstance(subject, kind) as instance:
        answer = instance.fmu.getVersion()
        if not answer.startswith(version):
            return failed(
                f"the binary says that it is FMI {answer}, the description says {version}."
            )
        instance.begin()
        paces = []
        for step in range(steps):
            began = time.perf_counter()
            if kind == "CS":
                instance.make_step(step)
            elif instance.state_count:
                instance.move(
                    subject.time(step), instance.states() + 1e-3 * subject.step * instance.rates()
                )
            paces.append(time.perf_counter() - began)
        # The first ones also load what was not in memory yet.
        pace = min(paces) * (_EVALUATIONS if kind == "ME" else 1)
        instance.fmu.terminate()
        instance.free()
    return passed(
        f"{steps} {'evaluations' if kind == 'ME' else f'steps of {subject.step:g} s'}; a step takes about {pace:.1g} s.",
        pace,
    )


@check("time after a step", Scope.EACH, clauses=("2.2.7", "2.4.7.4"))
def keeps_time(subject: Subject, kind: str) -> Finding:
    """The time the FMU tells is the time it was brought to."""
    sources: set[str] = set()
    wrong: list[str] = []
    with CheckedInstance(subject, kind).begin() as instance:

        def look(source: str, value: float, right: float) -> None:
            sources.add(source)
            if not abs(value - right) <= _SAME * subject.step:
                wrong.append(f"{source} says {value:.10g} s at t = {right:.10g} s")

        steps = subject.before_end(kind, _FIRST_STEPS)
        for step in range(steps):
            begin, end = subject.time(step), subject.time(step + 1)
            if kind == "ME":
                instance.set_time(end)
            else:
                reached = instance.do_step(begin, subject.step).reached
                if subject.major >= 3:
                    look("fmi3DoStep's lastSuccessfulTime", reached, end)
            for name, told in zip(
                subject.clocks.names, instance.get(subject.clocks).tolist(), strict=True
            ):
                look(f"the variable {name}", told, end)
    if wrong and kind == "CS" and subject.step < subject.internal_step * (1.0 - _SAME):
        return advice(
            f"{wrong[0]}: the step of {subject.step:g} s, which the FMU proposes, is below the one it makes inside, {subject.internal_step:g} s; propose a multiple of that."
        )
    if not sources:
        return not_offered("there is no independent variable, and no time is told with a step.")
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
                end = subject.time(step + 1)
                return failed(
                    f"the step to t = {end:.6g} s is refused, though the stop time is {stop:.6g} s{instance.quote()}."
                )
        before = instance.observe()
        try:
            instance.make_step(steps)
        except FMICallException as error:
            reached = instance.fmu.last_successful_time() if error.status == _DISCARD else None
            if reached is not None and not abs(reached - stop) <= _SAME * subject.step:
                told = f"the last successful time is told as {reached:.6g} s; it is {stop:.6g} s"
                return failed(f"the step beyond the stop time is discarded, and {told}.")
            return passed(
                f"{steps} steps up to the stop time {stop:.6g} s are made, the next one is refused."
            )
        still = (
            " (though no output changes)"
            if np.array_equal(before, instance.observe(), equal_nan=True)
            else ""
        )
    answer = f"a step to t = {subject.time(steps + 1):.6g} s is answered with OK{still}"
    return failed(f"{answer}, though the stop time given was {stop:.6g} s.")


# Steps that go nowhere before they are called endless.
_STILL = 100
# Two ways through the same motion: a value is elsewhere if it is off by this share of its range,
# the motion if it is so at this share of the times.
_OFF = 0.05
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
        super().__init__(
            subject, kind, options={"eventModeUsed": True, "earlyReturnAllowed": early}
        )

    def run(self, steps: int) -> np.ndarray:
        """From its beginning, (steps + 1, observed) [unit of each variable].

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
            where = f"the step from t = {t:.6g} s to {target:.6g} s"
            if early and not self.options["earlyReturnAllowed"]:
                raise Misbehaviour(f"{where} returned early, which was not allowed")
            if not early and abs(reached - target) > near:
                raise Misbehaviour(
                    f"{where} says that it did not return early, and that it reached {reached:.9g} s"
                )
            if not t - near <= reached <= target + near:
                raise Misbehaviour(f"{where} says that it reached {reached:.9g} s")
            for name, told in zip(subject.clocks.names, self.get(subject.clocks), strict=True):
                if abs(told - reached) > near:
                    raise Misbehaviour(
                        f"{where} says that it reached {reached:.9g} s, the variable {name} says {told:.9g} s"
                    )
            self.early += early
            still = still + 1 if reached - t <= near else 0
            if still > _STILL:
                raise Misbehaviour(
                    f"{where} stands still: {_STILL} times it comes back without getting on, whatever events are handled"
                )
            t = self.time = reached
            if asked or t >= self.next_event - near:
                self.events += 1
                self.event()

    def content(self) -> None:
        """Once more without effect."""
        before = self.observe()
        again, *_ = self.fmu.update()
        _, where = compare(self.subject, before[np.newaxis], self.observe()[np.newaxis])
        if again or where:
            what = "asks for another one" if again else f"changes values ({where})"
            raise Misbehaviour(
                f"at t = {self.time:.6g} s fmi3UpdateDiscreteStates was content, but called once more it {what}"
            )


def _require_same_way(
    subject: Subject, plain: np.ndarray, other: np.ndarray, how: str, than: str
) -> None:
    """Raise Failed if a state goes another way.

    how: what was done in the other run, than: what is said behind it.
    """
    places = zip(subject.observed, pairwise(subject.observed.ends), strict=True)
    columns = {item.key: slice(begin, end) for item, (begin, end) in places}
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
    """Events are announced; a second update changes nothing; the motion is that without event mode.

    Reset forgets.
    """
    steps = subject.long_steps(kind)
    plain = fresh_run(subject, kind, steps)
    with _Eventful(subject, kind, early=subject.can(kind, _MIGHT_RETURN)) as instance:
        rows = instance.run(steps)
        events = instance.events
        _require_same_way(
            subject,
            plain,
            rows,
            "with event mode",
            "without: not every event is announced and handled",
        )
        instance.fmu.reset()
        require_equal(subject, rows, instance.run(steps), "after reset in a run with event mode")
    return passed(f"{events} events handled in {steps} steps; the same after reset, bit for bit.")


@check("early return", Scope.COSIMULATION, clauses=("", "4.1.3"))
def early_return(subject: Subject, kind: str) -> Finding:
    """Only where it is allowed, at the time that is told, and where it is asked for."""
    might, asked = (
        subject.can(kind, name) for name in (_MIGHT_RETURN, "canReturnEarlyAfterIntermediateUpdate")
    )
    if subject.major < 3:
        return not_offered("FMI 2.0 has none.")
    if not (might or asked):
        return not_offered(
            f"neither {_MIGHT_RETURN} nor canReturnEarlyAfterIntermediateUpdate is true."
        )
    said = []
    if subject.can(kind, "hasEventMode"):
        for may in (False, True):
            with _Eventful(subject, kind, early=may) as instance:
                instance.run(subject.long_steps(kind))
        if instance.early and not might:  # where it may not, that is no answer
            return failed(f"it returned early, though {_MIGHT_RETURN} is false.")
        said.append(f"{instance.early} times at events")
    if asked and subject.can(kind, _UPDATE):
        offered = _returns_where_asked(subject, kind)
        said.append(
            "where it was asked to"
            if offered
            else "nowhere on demand, as its intermediate update never offered that"
        )
    if not said:
        return not_offered(
            "it has neither event mode nor intermediate update, by which it could be asked."
        )
    return passed(f"it returned early {' and '.join(said)}; the times told are right.")


def _returns_where_asked(subject: Subject, kind: str) -> bool:
    """Ask for an early return at the first chance; whether there was one.

    Raises Failed where it does something else.
    """
    chances: list[float] = []

    def ask(
        _environment: Any,
        time: float,
        _set: bool,
        _get: bool,
        finished: bool,
        may: bool,
        early: Any,
        when: Any,
    ) -> None:
        if may and finished and not chances:
            chances.append(time)
            early[0], when[0] = True, time

    step = (
        10.0 * subject.step
        if subject.can(kind, "canHandleVariableCommunicationStepSize")
        else subject.step
    )
    options = {"earlyReturnAllowed": True, "intermediateUpdate": ask}
    with CheckedInstance(subject, kind, options=options).begin() as instance:
        begin = subject.start_time
        _, _, early, reached = instance.do_step(begin, step)
        near = _SAME * subject.step
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
        instance.do_step(
            reached, begin + step - reached if begin + step - reached > near else subject.step
        )
    return True


# Stairs in place of a line: how many, and how much nearer to the line they must be than the
# constant is. What a slope changes must be this share of a value.
_STAIRS = 64
_NEARER = 0.1
_VISIBLE = 1e-7


@check("intermediate update", Scope.COSIMULATION, clauses=("", "4.2.2"), needs=("", _UPDATE))
def intermediate_update(subject: Subject, kind: str) -> Finding:
    """It is called within each step, at times that do not go back, offers no early return that is not allowed, and changes nothing."""
    steps = min(subject.steps(kind), 2 * HOLD)
    wrong: list[str] = []
    calls = [0, 0]  # all, those in which values may be got
    last = [-math.inf]

    def update(
        _environment: Any,
        time: float,
        _set: bool,
        may_get: bool,
        _finished: bool,
        may: bool,
        _early: Any,
        _when: Any,
    ) -> None:
        # An exception in a callback would be lost.
        calls[0] += 1
        calls[1] += may_get
        begin, near = instance.time, _SAME * subject.step
        if not begin - near <= time <= begin + subject.step + near:
            wrong.append(
                f"in the step from t = {begin:.6g} s to {begin + subject.step:.6g} s it is called for t = {time:.9g} s"
            )
        elif time < last[0] - near and may_get:
            wrong.append(f"it is called for t = {time:.9g} s after {last[0]:.9g} s")
        if may:
            wrong.append(f"at t = {time:.6g} s it offers an early return, which was not allowed")
        if may_get:
            last[0] = time
            try:
                if not np.isfinite(instance.get(watched)).all():
                    wrong.append(f"at t = {time:.6g} s a value is no finite number")
            except FMICallException as error:
                wrong.append(
                    f"at t = {time:.6g} s values may be got, but that is refused ({str(error).rstrip('.')})"
                )

    def stepped(instance: CheckedInstance, step: int) -> None:
        instance.time = subject.time(step + 1)
        if wrong:
            raise Misbehaviour(wrong[0])

    watched = Block(item for item in subject.outputs if item.is_float)
    plain = fresh_run(subject, kind, steps)
    options = {"intermediateUpdate": update, "requiredIntermediateVariables": watched.references}
    with CheckedInstance(subject, kind, options=options) as instance:
        rows = run(instance.begin(), 0, steps, after=lambda step: stepped(instance, step))
    if not calls[0]:
        return failed(f"it was never called in {steps} steps, though {_UPDATE} is true.")
    _require_same_way(subject, plain, rows, "with a callback that only reads", "without")
    return passed(
        f"{calls[0]} calls in {steps} steps, {calls[1]} of them to read {len(watched)} values; times within the step and never back."
    )


@check(
    "input derivatives",
    Scope.COSIMULATION,
    clauses=("4.2.1", ""),
    needs=("canInterpolateInputs", ""),
)
def input_derivatives(subject: Subject, kind: str) -> Finding:
    """A step with sloping inputs is what many small steps with stairs come to."""
    inputs = subject.continuous_inputs
    if (
        not inputs
        or not subject.states
        or not subject.can(kind, "canHandleVariableCommunicationStepSize")
    ):
        return not_offered(
            "that needs continuous inputs, states that are named, and communication steps of any length."
        )
    length = subject.step * HOLD
    first, last = subject.inputs_at(0), subject.inputs_at(HOLD, seed=1)
    slope = (last - first) / length

    def end(stairs: int, slopes: np.ndarray | None, climb: np.ndarray = slope) -> np.ndarray:
        """States (entries,) [unit of each] after the span, in so many stairs, with slopes (nu,) or without. Raises FMICallException."""
        with CheckedInstance(subject, kind).begin() as instance:
            for stair in range(stairs):
                at = (
                    first if slopes is not None else first + climb * length * (stair + 0.5) / stairs
                )
                instance.set(inputs, at)
                if slopes is not None:
                    instance.fmu.setRealInputDerivatives(
                        inputs.references, [1] * len(inputs), [float(value) for value in slopes]
                    )
                begin = subject.start_time + length * stair / stairs
                instance.do_step(begin, subject.start_time + length * (stair + 1) / stairs - begin)
            return instance.get(subject.states)

    held, sloping = end(1, np.zeros_like(slope)), end(1, slope)
    line = end(_STAIRS, None)
    scale = np.maximum(np.abs(line), subject.states.scales)
    effect = np.abs(line - held) / scale
    if effect.max(initial=0.0) < _VISIBLE:
        return not_offered(f"what a slope changes within {length:g} s is too small to be seen.")
    own_error = np.abs(end(_STAIRS, None, 0.0 * slope) - held) / scale
    if own_error.max() > _NEARER * effect.max():
        return not_offered(
            f"its own steps are too coarse to tell: without slopes, one step of {length:g} s and {_STAIRS} small ones differ as well."
        )
    away = np.abs(sloping - line) / scale
    worst = int(np.argmax(away - _NEARER * effect))
    if away[worst] > _NEARER * effect[worst] + _VISIBLE:
        return failed(
            f"after {length:g} s with sloping inputs {subject.states.names[worst]} is {sloping[worst]:.9g}; {_STAIRS} stairs along the slope give {line[worst]:.9g}, no slope {held[worst]:.9g}."
        )
    return passed(
        f"one step of {length:g} s with slopes is {_STAIRS} stairs within {away.max():.1g} of the values; no slope is off by {effect.max():.1g}."
    )
