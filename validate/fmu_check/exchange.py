"""Model Exchange: states, derivatives and nominals as described, and announced events."""

from __future__ import annotations

import numpy as np

from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed, unless
from validate.fmu_check.motion import Crowded, Exchange, Record, fresh_run, run
from validate.fmu_check.subject import Block, CheckedInstance, Subject

# Relative difference of one number that is read in two ways: some units in the last place.
_SAME = 1e-12
# Relative difference of a nominal and its text in the description.
_TEXT = 1e-6
# An indicator is zero at an event that CVODE located if it is below this share of its largest value.
_ZERO = 1e-6
# Relative tolerance of the run that looks at events: indicators are a hundred times more exact than
# _ZERO.
_RTOL = 1e-8
# Looks between events in each communication step.
_LOOKS = 3


@check("states and derivatives are the listed ones", Scope.EXCHANGE, clauses=("2.2.8", "2.4.8"))
def arrays(subject: Subject, kind: str) -> Finding:
    """The variables of the ModelStructure equal the arrays of states and derivatives, in order."""
    steps = subject.steps(kind)
    if not (count := int(subject.description.numberOfContinuousStates)):
        return not_offered("there are no continuous states.")
    for what, variables in (("state", subject.states), ("derivative", subject.derivatives)):
        if variables.entries != count:
            listed = f"{len(variables)} {what} variables for {count} states"
            return failed(f"the description lists {listed}.")
    wrong: list[str] = []
    with CheckedInstance(subject, kind).begin() as instance:
        if subject.major >= 3 and (reported := instance.fmu.getNumberOfContinuousStates()) != count:
            return failed(_other_count(reported, "continuous states", count))

        def look(step: int) -> None:
            time, states, rates = subject.time(step), instance.states(), instance.rates()
            wrong.extend(_unequal(instance, "state", subject.states, states, time))
            wrong.extend(_unequal(instance, "derivative", subject.derivatives, rates, time))

        look(0)
        run(instance, 0, steps, after=lambda step: look(step + 1), observe="end")
    counts = f"{count} states and {count} derivatives"
    return unless(wrong[:1], f"{counts}, by array and by variable, at {steps + 1} times: equal.")


def _other_count(reported: int, what: str, count: int) -> str:
    return f"the binary says {reported} {what}, the description lists {count}."


def _unequal(
    instance: CheckedInstance, what: str, variables: Block, values: np.ndarray, time: float
) -> list[str]:
    """Return clauses about variables that differ from their array (entries,) [unit of each]."""
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
        if nominal is not None and not np.isclose(value, nominal, rtol=_TEXT):
            both = f"{value:g} in the binary and {nominal:g} in the description"
            return failed(f"state {place} has the nominal {both}.")
    given = sum(nominal is not None for nominal in declared)
    return passed(f"{count} nominals; {given} are given in the description and agree.")


@check("event indicators announce events", Scope.EXCHANGE, clauses=("3.1", "3.1.1"))
def indicators(subject: Subject, kind: str) -> Finding:
    """They pass through zero continuously, and nothing changes at an event update that no indicator or time announced."""
    with CheckedInstance(subject, kind).begin() as instance:
        count = instance.indicator_count
        if subject.major >= 3:
            if (reported := instance.fmu.getNumberOfEventIndicators()) != count:
                return failed(_other_count(reported, "event indicators", count))
            listed = subject.of(subject.description.eventIndicators)
            if count and len(listed) == len(subject.description.eventIndicators):
                values, time = instance.indicators(), subject.start_time
                if wrong := _unequal(instance, "event indicator", listed, values, time):
                    return failed(f"{wrong[0]}.")
        mover = _Looking(instance, _RTOL)
        run(instance, 0, subject.long_steps(kind), observe="end", mover=mover)
    record = mover.record
    if record.surprises:
        return failed(
            f"an event update that no event indicator and no time event announced changes "
            f"{record.surprises[0]}: an event indicator is missing or wrong."
        )
    if not count and not record.events:
        return not_offered("there are no event indicators, and nothing jumps.")
    for time, crossed, values in record.events:
        for place in crossed:
            if abs(values[place]) > _ZERO * mover.size[place]:
                return failed(
                    f"event indicator {place} jumps over zero at t = {time:.10g} s: it is "
                    f"{values[place]:.4g} there, but it should be continuous."
                )
    state_events = sum(bool(event[1]) for event in record.events)
    others = len(record.events) - state_events
    return passed(
        f"{count} indicators; {state_events} state events and {others} others by t = {mover.time:.4g} s."
    )


class _Looking(Exchange):
    """CVODE that also updates between events, until an update surprises.

    size: (ni,) largest value of each indicator [unit of each].
    """

    def __init__(self, instance: CheckedInstance, rtol: float) -> None:
        super().__init__(instance, rtol)
        self.size = np.abs(instance.indicators())

    def advance(self, target: float) -> None:
        """Integrate to `target` [s]. Raises Crowded after a surprise, or if events do not end."""
        for stop in np.linspace(self.time, target, _LOOKS + 1)[1:].tolist():
            super().advance(stop)
            now = np.abs(self.instance.indicators())
            self.size = np.maximum(self.size, now)
            # An indicator that is zero, or the time, announces an event at the look itself.
            if ((now <= _ZERO * self.size) & (self.size > 0)).any() or self.is_at_time_event:
                continue
            self.update_unannounced()
            if self.record.surprises:
                raise Crowded


@check("events tell that they change states", Scope.EXCHANGE, clauses=("3.2.2", "2.3.5"))
def reported(subject: Subject, kind: str) -> Finding:
    """An event update that changes a state sets valuesOfContinuousStatesChanged."""
    if not subject.description.numberOfContinuousStates:
        return not_offered("there are no continuous states.")
    record = Record()
    fresh_run(subject, kind, subject.long_steps(kind), observe="end", record=record)
    if record.unreported:
        return failed(
            f"an event update changes {record.unreported[0]}, but "
            "valuesOfContinuousStatesChanged is false: an importer goes on with its own states."
        )
    events = f"{len(record.events)} events of its own and where inputs jump"
    return passed(f"each changed state is reported, in {events}.")
