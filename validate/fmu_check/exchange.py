"""Model Exchange: states, derivatives and nominals are those of the description, event indicators announce events, and Co-Simulation moves the same.

For the last, Model Exchange is integrated by CVODE with two tolerances, Co-Simulation with the
steps h, h/2 and h/4, all with the same piecewise constant inputs. The difference must be explained:
by the error of either, as the halved step and the other tolerance show it, or by the FMU's
tolerance. Co-Simulation that does not heed the communication step (it has an internal one) is
measured against explicit Euler with its smallest step on the same equations: the plainest
integrator of order one.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.instance import Misbehaviour
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed, unless
from validate.fmu_check.motion import Crowded, Exchange, Record, by_adams_or_bdf, fresh_run, run
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


_RTOLS = (1e-7, 1e-9)
_PARTS = (1, 2, 4)
# A difference is explained by errors up to this many times their estimates.
_SAFETY = 4.0
# Below this share of a value's size nothing is told apart, whatever tolerance the FMU proposes.
_FINEST = 1e-6
# With a larger difference than this share of the value's size nothing was compared [-]: "passed"
# would say too much.
_COMPARED = 0.1
# Of more values than twice that, every second, third, .. is compared.
_MOST_COMPARED = 10_000


@check("Model Exchange equals Co-Simulation", Scope.FILE)
def agree(subject: Subject) -> Finding:
    """As the step shrinks, or within the FMU's tolerance."""
    if subject.types != ("ME", "CS"):
        return not_offered(f"the FMU offers {' and '.join(subject.types) or 'neither'} only.")
    compared = [
        item
        for item in subject.observed
        if item.is_continuous and item.causality in ("output", "local")
    ]
    if not compared:
        return not_offered("there are no continuous outputs or locals to compare.")
    compared = Block(compared[:: max(1, len(compared) // _MOST_COMPARED)])
    steps = min(subject.long_steps(kind) for kind in subject.types)
    fine, events = by_adams_or_bdf(partial(_integrated, subject, compared, steps, _RTOLS[1]))
    coarse, _ = by_adams_or_bdf(partial(_integrated, subject, compared, len(fine) - 1, _RTOLS[0]))
    length = min(len(fine), len(coarse))
    truth, error, parts, awake = fine[:length], np.abs(fine[:length] - coarse[:length]), {}, 1
    for number in (
        _PARTS if subject.can("CS", "canHandleVariableCommunicationStepSize") else _PARTS[:1]
    ):
        parts[number], awake = _cosimulation(subject, compared, length - 1, number)
    size = np.maximum(np.abs(truth).max(axis=0), 1e-3 * compared.scales)
    finest = parts[max(parts)]
    apart = np.abs(finest - truth)
    shrink = np.abs(finest - parts[max(parts) // 2]) if len(parts) > 1 else np.zeros_like(apart)
    allowed = max(subject.tolerance, _FINEST) * size + _SAFETY * (
        _running(shrink) + _running(error)
    )
    shares = {number: float((np.abs(rows - truth) / size).max()) for number, rows in parts.items()}
    shown = ", ".join(
        f"{share:.2g} with h{f'/{number}' if number > 1 else ''}"
        for number, share in shares.items()
    )
    where = f"{len(compared.names)} values over {length - 1} steps of h = {subject.step:g} s, {events} events; largest difference {shown} of the value's size"
    unexplained = ~(apart <= allowed)
    told = passed if shares[max(shares)] <= _COMPARED else not_offered
    if not unexplained.any():
        return told(
            f"{where}{'' if told is passed else ': steps and tolerances may explain it, which tells nothing'}."
        )
    if (euler := _euler(subject, compared, length - 1, awake)) is not None:
        unexplained &= ~(apart <= allowed + _SAFETY * _running(np.abs(euler - truth)))
        if not unexplained.any():
            return told(
                f"{where}: no more than explicit Euler has with the smallest of these steps, but it does not shrink with the step, so less cannot be told."
            )
    row, column = np.argwhere(unexplained)[0]
    return failed(
        f"{compared.names[column]} differs at t = {subject.time(row):.6g} s: {finest[row, column]:.8g} by Co-Simulation, "
        f"{truth[row, column]:.8g} by Model Exchange, more than steps and tolerances explain ({allowed[row, column]:.1g}); {where}."
    )


def _running(rows: np.ndarray) -> np.ndarray:
    """The largest so far, and a step later: an error that was there may come back, and what happens at an event may come a step later."""
    largest = np.maximum.accumulate(np.where(np.isfinite(rows), rows, np.inf), axis=0)
    return np.vstack([largest[1:], largest[-1:]])


def _begun(subject: Subject, kind: str, name: str) -> CheckedInstance:
    """An instance that begins with the first inputs."""
    return CheckedInstance(subject, kind, name).begin(
        during=(subject.continuous_inputs, subject.inputs_at(0))
    )


def _integrated(
    subject: Subject, compared: Block, steps: int, rtol: float, method: tuple[int, int]
) -> tuple[np.ndarray, int]:
    """Values by CVODE, and how many state events there were; shorter if events crowd."""
    with _begun(subject, "ME", "reference") as instance:
        mover = Exchange(instance, rtol, method)
        mover.renew(subject.start_time)
        rows = [instance.get(compared)]
        for step in range(steps):
            if step and step % HOLD == 0 and subject.continuous_inputs:
                mover.jump(subject.time(step), subject.inputs_at(step))
            try:
                mover.advance(subject.time(step + 1))
            except Crowded:
                break
            rows.append(instance.get(compared))
        return np.array(rows), sum(bool(event[1]) for event in mover.record.events)


def _cosimulation(
    subject: Subject, compared: Block, steps: int, parts: int
) -> tuple[np.ndarray, int]:
    """Values after each step, and in how many of its parts (at most, over all steps) they moved."""
    with _begun(subject, "CS", f"parts {parts}") as instance:
        rows = [instance.get(compared)]
        length = subject.step / parts
        awake = 1
        for step in range(steps):
            if step and step % HOLD == 0:
                instance.set(subject.continuous_inputs, subject.inputs_at(step))
            moved, before = 0, rows[-1]
            for part in range(parts):
                instance.do_step(subject.time(step) + part * length, length)
                after = instance.get(compared)
                moved += not np.array_equal(before, after)
                before = after
            awake = max(awake, moved)
            rows.append(before)
        return np.array(rows), awake


def _euler(subject: Subject, compared: Block, steps: int, parts: int) -> np.ndarray | None:
    """Explicit Euler with a part of the communication step, events looked for at its ends.

    None if it diverges into errors.
    """
    length = subject.step / parts
    with _begun(subject, "ME", "euler") as instance:
        rows = [instance.get(compared)]
        for step in range(steps):
            if step and step % HOLD == 0 and subject.continuous_inputs:
                instance.fmu.enterEventMode()
                instance.set(subject.continuous_inputs, subject.inputs_at(step))
                instance.settle()
            try:
                for part in range(1, parts + 1):
                    x = (
                        instance.states() + length * instance.rates()
                        if instance.state_count
                        else np.empty(0)
                    )
                    instance.move(subject.time(step) + part * length, x)
                    instance.event()
                rows.append(instance.get(compared))
            except (FMICallException, Misbehaviour):
                return None
        return np.array(rows)
