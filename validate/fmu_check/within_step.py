"""What Co-Simulation tells and takes within a communication step: intermediate update of FMI 3.0, input derivatives of FMI 2.0."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmu_check.communication import elsewhere
from validate.fmu_check.faults import Misbehaviour
from validate.fmu_check.instance import Instance, new_instance
from validate.fmu_check.result import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.subject import HOLD, Subject, Variable

# Two times are the same if they differ by less than this share of a step.
_SAME = 1e-6
# Stairs in place of a line: how many, and how much nearer to the line they must be than the constant is. What a slope changes must be this share of a value.
_STAIRS, _NEARER, _VISIBLE = 64, 0.1, 1e-7
_UPDATE = "providesIntermediateUpdate"


@check(
    "intermediate update",
    "it is called within each step, at times that do not go back, offers no early return that is not allowed, and changes nothing",
    Scope.COSIMULATION,
)
def intermediate_update(subject: Subject, kind: str) -> Finding:
    if subject.major < 3 or not subject.can(kind, _UPDATE):
        return not_offered("FMI 2.0 has none." if subject.major < 3 else f"{_UPDATE} is false.")
    steps = min(subject.steps(kind), 2 * HOLD)
    wrong: list[str] = []
    calls = [0, 0]  # all, those in which values may be got
    reading: list[Instance] = []
    last = [-math.inf]

    def update(_environment: Any, time: float, _set: bool, may_get: bool, _finished: bool, may: bool, _early: Any, _when: Any) -> None:
        # An exception in a callback would be lost.
        calls[0] += 1
        calls[1] += may_get
        instance = reading[0]
        begin, near = instance.time, _SAME * subject.step
        if not begin - near <= time <= begin + subject.step + near:
            wrong.append(f"in the step from t = {begin:.6g} s to {begin + subject.step:.6g} s it is called for t = {time:.9g} s")
        elif time < last[0] - near and may_get:
            wrong.append(f"it is called for t = {time:.9g} s after {last[0]:.9g} s")
        if may:
            wrong.append(f"at t = {time:.6g} s it offers an early return, which was not allowed")
        if may_get:
            last[0] = time
            try:
                finite = bool(np.isfinite(instance.get(watched)).all())
            except FMICallException as error:
                wrong.append(f"at t = {time:.6g} s values may be got, but that is refused ({str(error).rstrip('.')})")
            else:
                if not finite:
                    wrong.append(f"at t = {time:.6g} s a value is no finite number")

    watched: list[Variable] = [item for item in subject.outputs if item.is_float]
    with new_instance(subject, kind) as instance:
        plain = _stepped(instance.begin(), steps, lambda: None)
    options = {"intermediateUpdate": update, "requiredIntermediateVariables": [item.reference for item in watched]}
    with new_instance(subject, kind, options=options) as instance:
        reading.append(instance)
        rows = _stepped(instance.begin(), steps, lambda: wrong and _stop(wrong[0]))
    if not calls[0]:
        return failed(f"it was never called in {steps} steps, though {_UPDATE} is true.")
    different = elsewhere(subject, plain, rows)
    if different:
        return failed(f"with a callback that only reads, {different} than without.")
    return passed(
        f"{calls[0]} calls in {steps} steps, {calls[1]} of them to read {len(watched)} values; times within the step and never back."
    )


def _stop(sentence: str) -> None:
    raise Misbehaviour(sentence)


def _stepped(instance: Instance, steps: int, after: Callable[[], object]) -> np.ndarray:
    subject = instance.subject
    rows = [instance.observe()]
    for step in range(steps):
        if step % HOLD == 0 and subject.continuous_inputs:
            instance.set(subject.continuous_inputs, subject.inputs_at(step))
        instance.time = subject.time(step)
        instance.do_step(instance.time, subject.time(step + 1) - instance.time)
        after()
        rows.append(instance.observe())
    return np.array(rows)


@check("input derivatives", "a step with sloping inputs is what many small steps with stairs come to", Scope.COSIMULATION)
def input_derivatives(subject: Subject, kind: str) -> Finding:
    if subject.major >= 3 or not subject.can(kind, "canInterpolateInputs"):
        return not_offered("FMI 3.0 has none." if subject.major >= 3 else "canInterpolateInputs is false.")
    inputs = subject.continuous_inputs
    if not inputs or not subject.states or not subject.can(kind, "canHandleVariableCommunicationStepSize"):
        return not_offered("that needs continuous inputs, states that are named, and communication steps of any length.")
    length = subject.step * HOLD
    first, last = subject.inputs_at(0), subject.inputs_at(HOLD, seed=1)
    slope = (last - first) / length

    def end(stairs: int, slopes: np.ndarray | None, climb: np.ndarray = slope) -> np.ndarray:
        with new_instance(subject, kind) as instance:
            instance.begin()
            for stair in range(stairs):
                at = first if slopes is not None else first + climb * length * (stair + 0.5) / stairs
                instance.set(inputs, at)
                if slopes is not None:
                    instance.fmu.setRealInputDerivatives(
                        [item.reference for item in inputs], [1] * len(inputs), [float(value) for value in slopes]
                    )
                begin = subject.start_time + length * stair / stairs
                instance.do_step(begin, subject.start_time + length * (stair + 1) / stairs - begin)
            return instance.get(subject.states)

    held, sloping = end(1, np.zeros_like(slope)), end(1, slope)
    line = end(_STAIRS, None)
    scale = np.maximum(np.abs(line), [item.scale for item in subject.states for _ in range(item.size)])
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
        names = [item.name for item in subject.states for _ in range(item.size)]
        return failed(
            f"after {length:g} s with sloping inputs {names[worst]} is {sloping[worst]:.9g}; {_STAIRS} stairs along the slope give {line[worst]:.9g}, no slope {held[worst]:.9g}."
        )
    return passed(
        f"one step of {length:g} s with slopes is {_STAIRS} stairs within {away.max():.1g} of the values; no slope is off by {effect.max():.1g}."
    )
