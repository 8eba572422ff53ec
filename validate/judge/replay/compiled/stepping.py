"""A Co-Simulation through a plan by the loop of stepping.c.

Step halving by rollback: each step made coarsely, taken back, and made again finely, from which the run goes on.

What the two differ by is that step's local error, wherever earlier steps have brought the motion. The FMU must save and restore its state. The run
itself is the plain one at the finer step, bit for bit.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from types import TracebackType

import numpy as np

from validate.fmi.instance import Instance, References
from validate.fmi.package import FmuError, Package
from validate.judge.replay.compiled import library
from validate.judge.replay.compiled.library import Fmu, Reason
from validate.judge.replay.reference import DIVERGENCE, Run
from validate.judge.replay.wiring import HeldInputs, Variables

# Outputs after the state is restored and those before it was left are the same within this share of their size.
SAME = 1e-9


class RollbackError(Exception):
    """The FMU says that it restores its state, and does not."""

    def __init__(self) -> None:
        super().__init__("the state it restores is not the one it saved")


def offers_rollback(package: Package, variables: Variables) -> bool:
    """Whether the Co-Simulation saves and restores its state - and takes half a step in the middle of a run."""
    interface = package.cosimulation
    if interface is None or not interface.canGetAndSetFMUstate:
        return False
    if variables.internal_step is None:
        return bool(interface.canHandleVariableCommunicationStepSize)
    owners = [item for item in package.description.modelVariables if int(item.valueReference) == variables.internal_step]
    return any(item.variability == "tunable" for item in owners)


class Rollback:
    """Makes steps twice. differences: one array (outputs,) a step, fine less coarse; fine: the FMU's own step [s], `own_step_of` its reference, if it has
    one; place: the saved state. A context, so that what is saved is freed."""

    def __init__(self, fmu: Instance, outputs: References, states: int, internal_step: int | None, fine: float) -> None:
        """states: how many of the outputs are positions and velocities, and come first; internal_step: the reference of the FMU's own step, which
        is `fine` [s], and twice that in the coarse step; None: the FMU has none to set, and its communication step is halved."""
        self.differences: list[np.ndarray] = []
        self._fmu, self._outputs, self._states, self.fine = fmu, outputs, states, fine
        self.own_step_of = References([] if internal_step is None else [internal_step])
        self.place = ctypes.c_void_p()

    def __enter__(self) -> Rollback:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self.place.value is not None and self._fmu.alive:
            self._fmu.forget(self.place)

    def step(self, advance: Callable[[int], None], parts: int, before: np.ndarray) -> None:
        """One step of the plan, by advance(calls of doStep): first in half as many calls and twice the FMU's own step, then in `parts`.

        before: the outputs as they are now. Raises RollbackError if they are others once the state is restored.
        """
        fmu, own, states = self._fmu, self.own_step_of, self._states
        fmu.save(self.place)
        fmu.write(own, [2.0 * self.fine] * own.count)
        advance(max(1, parts // 2))
        coarse = fmu.read(self._outputs).copy()
        fmu.restore(self.place)
        away = np.abs(fmu.read(self._outputs)[:states] - before[:states])
        if not (away <= SAME * np.abs(before[:states]).max(initial=0.0)).all():
            raise RollbackError
        fmu.write(own, [self.fine] * own.count)
        advance(parts)
        self.differences.append(fmu.read(self._outputs) - coarse)


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
    """What validate.judge.replay.everyday's loop does after the first record, of which `run` holds the outputs; False, and nothing done, where C cannot."""
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
