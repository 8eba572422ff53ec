"""Model Exchange: states, derivatives and nominals are those of the description, and event indicators announce events."""

from __future__ import annotations

import numpy as np

from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed, unless
from validate.fmu_check.motion import Crowded, Exchange, Record, fresh_run, run
from validate.fmu_check.subject import HOLD, Block, CheckedInstance, Subject

# Values read in two ways are the same number.
_SAME = 1e-12
# At an event that CVODE located its indicator is this small, as a share of what it was over the
# run.
_ZERO = 1e-6
# The run that looks at events: relative tolerance, and looks at the FMU between events in each
# communication step.
_RTOL = 1e-8
_LOOKS = 3


@check("states and derivatives are the listed ones", Scope.EXCHANGE, clauses=("2.2.8", "2.4.8"))
def arrays(subject: Subject, kind: str) -> Finding:
    """The variables of the ModelStructure equal the arrays of states and derivatives, in order."""
    steps = subject.steps(kind)
    if not (count := int(subject.description.numberOfContinuousStates)):
        return not_offered("there are no continuous states.")
    worst: list[str] = []
    with CheckedInstance(subject, kind).begin() as instance:
        if subject.major >= 3 and (reported := instance.fmu.getNumberOfContinuousStates()) != count:
            return failed(
                f"the binary says {reported} continuous states, the description lists {count}."
            )

        def look(step: int) -> None:
            for what, variables, values in (
                ("state", subject.states, instance.states()),
                ("derivative", subject.derivatives, instance.rates()),
            ):
                if variables.entries != count:
                    worst.append(
                        f"the description lists {len(variables)} {what} variables for {count} states"
                    )
                    return
                worst.extend(_unequal(instance, what, variables, values, subject.time(step)))

        look(0)
        run(instance, 0, steps, after=lambda step: look(step + 1), observe="end")
    return unless(
        worst[:1],
        f"{count} states and {count} derivatives, by array and by variable, at {steps + 1} times: equal.",
    )


def _unequal(
    instance: CheckedInstance, what: str, variables: Block, values: np.ndarray, time: float
) -> list[str]:
    read = instance.get(variables)
    return [
        f"{what} {place} is {values[place]:.10g} in the array, but the variable {variables.names[place]} is {read[place]:.10g} at t = {time:.6g} s"
        for place in np.flatnonzero(~np.isclose(read, values, rtol=_SAME, atol=0.0, equal_nan=True))
    ]


@check("nominals are the XML's", Scope.EXCHANGE, clauses=("3.2.2", "2.3.3"))
def nominals(subject: Subject, kind: str) -> Finding:
    """The nominals of the states are positive and those of the description."""
    if not (count := int(subject.description.numberOfContinuousStates)):
        return not_offered("there are no continuous states.")
    with CheckedInstance(subject, kind) as instance:
        values = instance.begin().nominals()
    wrong = values[~(np.isfinite(values) & (values > 0.0))]
    if wrong.size:
        return failed(f"a nominal is {wrong[0]:g}; it must be positive.")
    declared = [item.nominal for item in subject.states for _ in range(item.size)]
    for place, (value, nominal) in enumerate(zip(values, declared, strict=False)):
        if nominal is not None and not np.isclose(value, nominal, rtol=1e-6):
            return failed(
                f"state {place} has the nominal {value:g} in the binary and {nominal:g} in the description."
            )
    return passed(
        f"{count} nominals; {sum(nominal is not None for nominal in declared)} are given in the description and agree."
    )


@check("event indicators announce events", Scope.EXCHANGE, clauses=("3.1", "3.1.1"))
def indicators(subject: Subject, kind: str) -> Finding:
    """They pass through zero continuously, and nothing changes at an event update that no indicator or time announced."""
    with CheckedInstance(subject, kind).begin() as instance:
        count = instance.indicator_count
        if subject.major >= 3:
            if (reported := instance.fmu.getNumberOfEventIndicators()) != count:
                return failed(
                    f"the binary says {reported} event indicators, the description lists {count}."
                )
            listed = subject.of(subject.description.eventIndicators)
            all_listed = count and len(listed) == len(subject.description.eventIndicators)
            if all_listed and (
                wrong := _unequal(
                    instance, "event indicator", listed, instance.indicators(), subject.start_time
                )
            ):
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
                now = np.abs(instance.indicators()) if count else size
                size = np.maximum(size, now)
                # The look falls on an event, which its indicator announces by being zero, or its
                # time.
                if ((now <= _ZERO * size) & (size > 0)).any() or mover.is_at_time_event:
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
    others = len(mover.record.events) - state_events
    return passed(
        f"{count} indicators; {state_events} state events and {others} others by t = {mover.time:.4g} s."
    )


@check("events tell that they change states", Scope.EXCHANGE, clauses=("3.2.2", "2.3.5"))
def told(subject: Subject, kind: str) -> Finding:
    """A state that an event update changes is told by valuesOfContinuousStatesChanged: an importer keeps its own states otherwise."""
    if not subject.description.numberOfContinuousStates:
        return not_offered("there are no continuous states.")
    record = Record()
    fresh_run(subject, kind, subject.long_steps(kind), observe="end", record=record)
    if record.untold:
        return failed(
            f"an event update changes {record.untold[0]}, but valuesOfContinuousStatesChanged is false: an importer goes on with its own states."
        )
    return passed(
        f"no state changes untold, in {len(record.events)} events of its own and where inputs jump."
    )
