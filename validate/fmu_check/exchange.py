"""Model Exchange: states, derivatives and nominals are those of the description, and event indicators announce events."""

from __future__ import annotations

import numpy as np

from validate.fmu_check.instance import Instance, new_instance
from validate.fmu_check.motion import Crowded, Exchange, run
from validate.fmu_check.result import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.subject import HOLD, Subject, Variable

# Values read in two ways are the same number.
_SAME = 1e-12
# At an event that CVODE located its indicator is this small, as a share of what it was over the run.
_ZERO = 1e-6
# The run that looks at events: relative tolerance, and looks at the FMU between events in each communication step.
_RTOL, _LOOKS = 1e-8, 3


@check(
    "states and derivatives are the listed ones",
    "the variables of the ModelStructure equal the arrays of states and derivatives, in order",
    Scope.EXCHANGE,
)
def arrays(subject: Subject, kind: str) -> Finding:
    steps = subject.steps(kind)
    count = int(subject.description.numberOfContinuousStates)
    if not count:
        return not_offered("there are no continuous states.")
    worst: list[str] = []
    with new_instance(subject, kind) as instance:
        instance.begin()
        if subject.major >= 3 and (told := instance.fmu.getNumberOfContinuousStates()) != count:
            return failed(f"the binary says {told} continuous states, the description lists {count}.")

        def look(step: int) -> None:
            for what, variables, values in (
                ("state", subject.states, instance.states()),
                ("derivative", subject.derivatives, instance.rates()),
            ):
                if sum(item.size for item in variables) != count:
                    worst.append(f"the description lists {len(variables)} {what} variables for {count} states")
                    return
                worst.extend(_unequal(instance, what, variables, values, subject.time(step)))

        look(0)
        run(instance, 0, steps, after=lambda step: look(step + 1), observe="end")
        if worst:
            return failed(f"{worst[0]}.")
    return passed(f"{count} states and {count} derivatives, by array and by variable, at {steps + 1} times: equal.")


def _unequal(instance: Instance, what: str, variables: list[Variable], values: np.ndarray, time: float) -> list[str]:
    read = instance.get(variables)
    for place in np.flatnonzero(~np.isclose(read, values, rtol=_SAME, atol=0.0, equal_nan=True)):
        name = [item.name for item in variables for _ in range(item.size)][place]
        return [f"{what} {place} is {values[place]:.10g} in the array, but the variable {name} is {read[place]:.10g} at t = {time:.6g} s"]
    return []


@check("nominals are the XML's", "the nominals of the states are positive and those of the description", Scope.EXCHANGE)
def nominals(subject: Subject, kind: str) -> Finding:
    count = int(subject.description.numberOfContinuousStates)
    if not count:
        return not_offered("there are no continuous states.")
    with new_instance(subject, kind) as instance:
        values = instance.begin().nominals()
    if not (np.isfinite(values) & (values > 0.0)).all():
        return failed(f"a nominal is {values[~(np.isfinite(values) & (values > 0.0))][0]:g}; it must be positive.")
    declared = [item.nominal for item in subject.states for _ in range(item.size)]
    for place, (value, nominal) in enumerate(zip(values, declared, strict=False)):
        if nominal is not None and not np.isclose(value, nominal, rtol=1e-6):
            return failed(f"state {place} has the nominal {value:g} in the binary and {nominal:g} in the description.")
    given = sum(nominal is not None for nominal in declared)
    return passed(f"{count} nominals; {given} are given in the description and agree.")


@check(
    "event indicators announce events",
    "they pass through zero continuously, and nothing changes at an event update that no indicator or time announced",
    Scope.EXCHANGE,
)
def indicators(subject: Subject, kind: str) -> Finding:
    with new_instance(subject, kind) as instance:
        instance.begin()
        count = instance.indicator_count
        if subject.major >= 3:
            if (told := instance.fmu.getNumberOfEventIndicators()) != count:
                return failed(f"the binary says {told} event indicators, the description lists {count}.")
            listed = subject.of(subject.description.eventIndicators)
            if len(listed) == len(subject.description.eventIndicators) and count:
                wrong = _unequal(instance, "event indicator", listed, instance.indicators(), subject.start_time)
                if wrong:
                    return failed(f"{wrong[0]}.")
        steps = subject.long_steps(kind)
        size = np.abs(instance.indicators()) if count else np.empty(0)
        mover = Exchange(instance, _RTOL)
        for step in range(steps):
            if step % HOLD == 0:
                mover.jump(subject.time(step), subject.inputs_at(step))
            for look in range(1, _LOOKS + 1):
                try:
                    mover.advance(subject.time(step) + subject.step * look / _LOOKS)
                except Crowded:
                    break
                if count:
                    now = np.abs(instance.indicators())
                    size = np.maximum(size, now)
                    if (
                        (now <= _ZERO * size) & (size > 0)
                    ).any():  # the look falls on an event, which its indicator announces by being zero
                        continue
                mover.update_unannounced()
                if mover.record.surprises:
                    return failed(
                        f"an event update that no event indicator and no time event announced changes {mover.record.surprises[0]}: "
                        "an event indicator is missing or wrong."
                    )
            if mover.time >= mover.record.crowded:
                break
    if not count and not mover.record.events:
        return not_offered("there are no event indicators, and nothing jumps.")
    for time, crossed, values in mover.record.events:
        for place in crossed:
            if abs(values[place]) > _ZERO * size[place]:
                return failed(
                    f"event indicator {place} jumps over zero at t = {time:.10g} s: it is {values[place]:.4g} there, but it should be continuous."
                )
    state_events = sum(bool(event[1]) for event in mover.record.events)
    return passed(
        f"{count} indicators; {state_events} state events and {len(mover.record.events) - state_events} others by t = {mover.time:.4g} s."
    )
