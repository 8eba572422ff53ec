"""Co-Simulation of FMI 3.0 with event mode and early return."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from validate.fmu_check.comparison import compare
from validate.fmu_check.faults import Ended, Misbehaviour
from validate.fmu_check.instance import Instance, new_instance
from validate.fmu_check.instance_fmi3 import Instance3
from validate.fmu_check.motion import run
from validate.fmu_check.result import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.subject import HOLD, Subject

# Two times are the same if they differ by less than this share of a step.
_SAME = 1e-6
# Rounds of an event iteration, and steps that go nowhere, before it is called endless.
_ROUNDS, _STILL = 100, 100
# Two ways through the same motion: a value is elsewhere if it is off by this share of its range, the motion if it is so at this share of the times.
_OFF, _OFTEN = 0.05, 0.25
_UPDATE, _MIGHT = "providesIntermediateUpdate", "mightReturnEarlyFromDoStep"


@dataclass
class _Told:
    """What an instance said on its way: times of events, how often it returned early."""

    events: list[float] = field(default_factory=list)
    early: int = 0


def _settle(instance: Instance) -> float:
    """Event updates until it is content, once more without effect, then Step Mode; the time of the next event (inf: none)."""
    for _ in range(_ROUNDS):
        again, terminate, _, _, _, _ = instance.fmu.updateDiscreteStates()
        if terminate:
            raise Ended(instance.time)
        if not again:
            break
    else:
        raise Misbehaviour(f"the event iteration did not end after {_ROUNDS} rounds")
    before = instance.observe()
    again, _, _, _, defined, when = instance.fmu.updateDiscreteStates()
    apart = compare(instance.subject, before[np.newaxis], instance.observe()[np.newaxis])
    if again or not apart.equal:
        what = "asks for another one" if again else f"changes values ({apart.where(instance.subject)})"
        raise Misbehaviour(f"at t = {instance.time:.6g} s fmi3UpdateDiscreteStates was content, but called once more it {what}")
    instance.fmu.enterStepMode()
    return float(when) if defined else math.inf


def _through(instance: Instance, steps: int, told: _Told) -> np.ndarray:
    """The run with event mode, (steps + 1, observed). Raises Misbehaviour where an answer of fmi3DoStep cannot be right."""
    assert isinstance(instance, Instance3)
    subject, may_return = instance.subject, instance.options["earlyReturnAllowed"]
    near = _SAME * subject.step
    t, following = subject.start_time, _settle(instance)
    rows = [instance.observe()]
    clocks = [item for item in subject.variables if item.causality == "independent" and item.is_float]
    for step in range(steps):
        if step % HOLD == 0 and subject.continuous_inputs:
            instance.set(subject.continuous_inputs, subject.inputs_at(step))
        goal, still = subject.time(step + 1), 0
        while goal - t > near:
            target = min(goal, max(following, t + near))
            event, early, reached = instance.answered_step(t, target - t)
            where = f"the step from t = {t:.6g} s to {target:.6g} s"
            if early and not may_return:
                raise Misbehaviour(f"{where} returned early, which was not allowed")
            if not early and abs(reached - target) > near:
                raise Misbehaviour(f"{where} says that it did not return early, and that it reached {reached:.9g} s")
            if not t - near <= reached <= target + near:
                raise Misbehaviour(f"{where} says that it reached {reached:.9g} s")
            for clock in clocks:
                if abs(float(instance.get([clock])[0]) - reached) > near:
                    raise Misbehaviour(
                        f"{where} says that it reached {reached:.9g} s, the variable {clock.name} says {float(instance.get([clock])[0]):.9g} s"
                    )
            told.early += early
            still = still + 1 if reached - t <= near else 0
            if still > _STILL:
                raise Misbehaviour(f"{where} stands still: {_STILL} times it comes back without getting on, whatever events are handled")
            t = instance.time = reached
            if event or t >= following - near:
                told.events.append(t)
                instance.fmu.enterEventMode()
                following = _settle(instance)
        rows.append(instance.observe())
    return np.array(rows)


def elsewhere(subject: Subject, plain: np.ndarray, other: np.ndarray) -> str:
    """Which state goes another way, in words; empty if none does."""
    watched = subject.states or [item for item in subject.outputs if item.is_float]
    places = np.cumsum([0, *(item.size for item in subject.observed)])
    names = [item.reference for item in subject.observed]
    for item in watched:
        if item.reference not in names:
            continue
        at = names.index(item.reference)
        one, two = plain[:, places[at] : places[at + 1]], other[:, places[at] : places[at + 1]]
        off = np.abs(one - two) > _OFF * np.ptp(one, axis=0) + 1e-6 * np.abs(one).max(axis=0)
        share = float(off.any(axis=1).mean())
        if share > _OFTEN:
            return f"{item.name} is another one at {share:.0%} of the times (by up to {np.abs(one - two).max():.3g})"
    return ""


@check(
    "event mode of Co-Simulation",
    "events are announced; a second update changes nothing; the motion is that without event mode; reset forgets",
    Scope.COSIMULATION,
)
def event_mode(subject: Subject, kind: str) -> Finding:
    if subject.major < 3 or not subject.can(kind, "hasEventMode"):
        return not_offered("FMI 2.0 has none." if subject.major < 3 else "hasEventMode is false.")
    steps, told = subject.long_steps(kind), _Told()
    with new_instance(subject, kind) as instance:
        plain = run(instance.begin(), 0, steps)
    with new_instance(subject, kind, options=_options(subject.can(kind, _MIGHT))) as instance:
        rows = _through(instance.begin(), steps, told)
        wrong = elsewhere(subject, plain, rows)
        if wrong:
            return failed(f"with event mode, {wrong} than without: not every event is announced and handled.")
        instance.reset()
        apart = compare(subject, rows, _through(instance.begin(), steps, _Told()))
        if not apart.equal:
            return failed(f"after reset in a run with event mode, {apart.where(subject)}.")
    return passed(f"{len(told.events)} events handled in {steps} steps; the same after reset, bit for bit.")


def _options(early: bool) -> dict[str, bool]:
    return {"eventModeUsed": True, "earlyReturnAllowed": early}


@check("early return", "only where it is allowed, at the time that is told, and where it is asked for", Scope.COSIMULATION)
def early_return(subject: Subject, kind: str) -> Finding:
    might, asked = (subject.can(kind, name) for name in (_MIGHT, "canReturnEarlyAfterIntermediateUpdate"))
    if subject.major < 3 or not (might or asked):
        return not_offered(
            "FMI 2.0 has none." if subject.major < 3 else f"neither {_MIGHT} nor canReturnEarlyAfterIntermediateUpdate is true."
        )
    said = []
    if subject.can(kind, "hasEventMode"):
        told = _Told()
        for early in (False, True):
            with new_instance(subject, kind, options=_options(early)) as instance:
                _through(instance.begin(), subject.long_steps(kind), told)
        if told.early and not might:
            return failed(f"it returned early, though {_MIGHT} is false.")
        said.append(f"{told.early} times at events")
    if asked and subject.can(kind, _UPDATE):
        asked, wrong = _asked_to_return(subject, kind)
        if wrong:
            return failed(f"{wrong}.")
        said.append("where it was asked to" if asked else "nowhere on demand, as its intermediate update never offered that")
    if not said:
        return not_offered("it has neither event mode nor intermediate update, by which it could be asked.")
    return passed(f"it returned early {' and '.join(said)}; the times told are right.")


def _asked_to_return(subject: Subject, kind: str) -> tuple[bool, str]:
    """Ask for an early return at the first chance: (whether there was one, what is wrong, in words)."""
    chances: list[float] = []

    def ask(_environment: Any, time: float, _set: bool, _get: bool, finished: bool, may: bool, early: Any, when: Any) -> None:
        if may and finished and not chances:
            chances.append(time)
            early[0], when[0] = True, time

    step = 10.0 * subject.step if subject.can(kind, "canHandleVariableCommunicationStepSize") else subject.step
    options = {"earlyReturnAllowed": True, "intermediateUpdate": ask}
    with new_instance(subject, kind, options=options) as instance:
        assert isinstance(instance, Instance3)
        instance.begin()
        begin = subject.start_time
        _, early, reached = instance.answered_step(begin, step)
        near = _SAME * subject.step
        if not chances:
            return False, ""
        if not early and begin + step - chances[0] > near:
            return True, f"it was asked at {chances[0]:.9g} s to return early, and went on to {reached:.9g} s"
        if early and not chances[0] - near <= reached < begin + step + near:
            return True, f"it was asked to return at {chances[0]:.9g} s, and says that it reached {reached:.9g} s"
        instance.answered_step(reached, begin + step - reached if begin + step - reached > near else subject.step)
    return True, ""
