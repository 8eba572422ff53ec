"""Time: the FMU starts and ends, keeps the time it is told, and does not pass its stop time."""

from __future__ import annotations

import time

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmu_check.instance import new_instance
from validate.fmu_check.result import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.subject import Subject

# Two times are the same if they differ by less than this share of a step.
_SAME = 1e-6
# The status of FMI for a step that was not made whole.
_DISCARD = 2
# Steps of the first run, from which the pace is known (in Model Exchange from evaluations, of which CVODE takes about so many a step).
_FIRST_STEPS, _EVALUATIONS = 5, 30


@check("starts and ends", "it loads, is instantiated, initialised, makes some steps, is terminated and freed", Scope.EACH)
def lives(subject: Subject, kind: str) -> Finding:
    version = {2: "2.0", 3: "3.0"}[subject.major]
    steps = subject.before_end(kind, _FIRST_STEPS)
    with new_instance(subject, kind) as instance:
        told = instance.fmu.getVersion()
        if not told.startswith(version):
            return failed(f"the binary says that it is FMI {told}, the description says {version}.")
        instance.begin()
        paces = []
        for step in range(steps):
            began = time.perf_counter()
            if kind == "CS":
                instance.do_step(subject.time(step), subject.step)
            elif instance.state_count:
                instance.move(subject.time(step), instance.states() + 1e-3 * subject.step * instance.rates())
            paces.append(time.perf_counter() - began)
        # The first ones also load what was not in memory yet.
        pace = min(paces) * (_EVALUATIONS if kind == "ME" else 1)
        instance.fmu.terminate()
        instance.free()
    return passed(f"{steps} {'evaluations' if kind == 'ME' else f'steps of {subject.step:g} s'}; a step takes about {pace:.1g} s.", pace)


@check("time after a step", "the time the FMU tells is the time it was brought to", Scope.EACH)
def keeps_time(subject: Subject, kind: str) -> Finding:
    clocks = [item for item in subject.variables if item.causality == "independent" and item.is_float]
    told: set[str] = set()
    wrong: list[str] = []
    with new_instance(subject, kind) as instance:
        instance.begin()

        def look(source: str, value: float | None, right: float) -> None:
            if value is None:
                return
            told.add(source)
            if not abs(value - right) <= _SAME * subject.step:
                wrong.append(f"{source} says {value:.10g} s at t = {right:.10g} s")

        steps = subject.before_end(kind, _FIRST_STEPS)
        for step in range(steps):
            begin, end = subject.time(step), subject.time(step + 1)
            if kind == "ME":
                instance.set_time(end)
            else:
                look("fmi3DoStep's lastSuccessfulTime", instance.do_step(begin, subject.step), end)
            for clock in clocks:
                look(f"the variable {clock.name}", float(instance.get([clock])[0]), end)
    if wrong:
        return failed(f"{wrong[0]}.")
    if not told:
        return not_offered("there is no independent variable, and no time is told with a step.")
    return passed(f"{' and '.join(sorted(told))}: right at {steps} times.")


@check("stop time is respected", "a step up to the stop time is made, a step beyond it is refused", Scope.COSIMULATION)
def stop_time(subject: Subject, kind: str) -> Finding:
    steps = subject.before_end(kind, 4)
    with new_instance(subject, kind) as instance:
        instance.begin(stop=subject.time(steps))
        for step in range(steps):
            try:
                instance.do_step(subject.time(step), subject.step)
            except FMICallException:
                return failed(
                    f"the step to t = {subject.time(step + 1):.6g} s is refused, though the stop time is {subject.time(steps):.6g} s{instance.quote()}."
                )
        before = instance.observe()
        try:
            instance.do_step(subject.time(steps), subject.step)
        except FMICallException as error:
            told = instance.last_successful_time() if error.status == _DISCARD else None
            if told is not None and not abs(told - subject.time(steps)) <= _SAME * subject.step:
                return failed(
                    f"the step beyond the stop time is discarded, and the last successful time is told as {told:.6g} s; it is {subject.time(steps):.6g} s."
                )
            return passed(f"{steps} steps up to the stop time {subject.time(steps):.6g} s are made, the next one is refused.")
        moved = not np.array_equal(before, instance.observe(), equal_nan=True)
    return failed(
        f"a step to t = {subject.time(steps + 1):.6g} s is answered with OK{'' if moved else ' (but nothing moves)'}, "
        f"though the stop time given was {subject.time(steps):.6g} s."
    )
