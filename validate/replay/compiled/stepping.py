"""A Co-Simulation through a plan by the loop of stepping.c."""

from __future__ import annotations

import ctypes

import numpy as np

from validate.replay.buffers import References
from validate.replay.compiled import library
from validate.replay.compiled.library import Fmu, Reason
from validate.replay.fmi import Instance
from validate.replay.inputs import HeldInputs
from validate.replay.package import FmuError
from validate.replay.reference import DIVERGENCE, Run
from validate.replay.rollback import SAME, Rollback, RollbackError

_SIZE, _ADDRESS, _DOUBLE = ctypes.c_int64, ctypes.c_void_p, ctypes.c_double


class _Stepping(ctypes.Structure):
    """struct stepping of stepping.c."""

    _fields_ = (
        ("fmu", Fmu),
        ("times", _ADDRESS),
        ("values", _ADDRESS),
        ("slopes", _ADDRESS),
        ("linear", _SIZE),
        ("gives_slopes", _SIZE),
        ("orders", _ADDRESS),
        ("parts", _SIZE),
        ("bounded", _SIZE),
        ("bound", _DOUBLE),
        ("outputs", _ADDRESS),
        ("applied", _ADDRESS),
        ("rolls_back", _SIZE),
        ("own_step_count", _SIZE),
        ("own_step_reference", _ADDRESS),
        ("own_step", _DOUBLE),
        ("same", _DOUBLE),
        ("place", _ADDRESS),
        ("coarse", _ADDRESS),
        ("local", _ADDRESS),
        ("done", _SIZE),
        ("reached", _DOUBLE),
    )


def step_through(
    fmu: Instance,
    references: tuple[References, References],
    inputs: HeldInputs,
    parts: int,
    slopes: bool,
    states: int,
    run: Run,
    rollback: Rollback | None = None,
) -> bool:
    """What validate.replay.everyday's loop does after the first record, of which `run` holds the outputs; False, and nothing done, where C cannot."""
    loops = library.load()
    inputs_of, outputs_of = references
    needed = ["GetReal", "SetReal", "DoStep"]
    needed += ["SetRealInputDerivatives"] if slopes else []
    needed += [] if rollback is None else ["GetFMUstate", "SetFMUstate"]
    described = None if loops is None else library.describe(fmu, needed, inputs=inputs_of, outputs=outputs_of)
    if loops is None or described is None:
        return False
    steps = len(inputs.values)
    times, values, rates = (np.array(array, dtype=float, order="C") for array in (inputs.times, inputs.values, inputs.slopes))
    outputs, local = np.empty((steps + 1, outputs_of.count)), np.empty((steps, outputs_of.count))
    outputs[0] = run.outputs[0]
    orders, applied, coarse = np.ones(inputs_of.count, dtype=np.int32), np.empty(inputs_of.count), np.empty(outputs_of.count)
    own = References([]) if rollback is None else rollback.own_step_of
    loop = _Stepping(
        fmu=described, times=_at(times), values=_at(values), slopes=_at(rates), linear=inputs.linear, gives_slopes=slopes, orders=_at(orders),
        parts=parts, bounded=states, bound=DIVERGENCE, outputs=_at(outputs), applied=_at(applied), rolls_back=rollback is not None,
        own_step_count=own.count, own_step_reference=ctypes.addressof(own.array), own_step=0.0 if rollback is None else rollback.fine,
        same=SAME, coarse=_at(coarse), local=_at(local),
    )  # fmt: skip
    reason, place = Reason.DONE, ctypes.byref(loop)
    try:
        if inputs.feedback is None:
            reason = Reason(loops.step_through(place, 0, steps))
        else:
            for step in range(steps):
                values[step] = inputs.begin(step, outputs[step, :states])
                run.applied.append(values[step].copy())
                reason = Reason(loops.step_through(place, step, step + 1))
                if reason is not Reason.DONE:
                    break
    finally:
        if rollback is not None:
            rollback.place.value = loop.place
    done = int(loop.done)
    run.knots.extend(range(1, done + 1))
    run.t.extend(times[1 : done + 1].tolist())
    run.outputs.extend(outputs[1 : done + 1])
    if rollback is not None:
        told = done + (reason in (Reason.OUTPUT_NOT_FINITE, Reason.OUT_OF_BOUNDS))
        rollback.differences.extend(local[:told])
    if reason is Reason.CALL_REFUSED:
        library.refuse(fmu, loop.fmu)
    if reason is Reason.EARLY_RETURN:
        raise FmuError(fmu.early_sentence(loop.reached))
    if reason is Reason.NOT_RESTORED:
        raise RollbackError
    if reason is Reason.OUTPUT_NOT_FINITE:
        run.end_without_number(times[done + 1])
    elif reason is Reason.OUT_OF_BOUNDS:
        run.end_out_of_bounds(times[done + 1])
    return True


def _at(array: np.ndarray) -> int:
    return array.ctypes.data
