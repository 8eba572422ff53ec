"""Step halving by rollback: each step made coarsely, taken back, and made again finely, from which the run goes on.

What the two differ by is that step's local error, wherever earlier steps have brought the motion. The FMU must save and restore its state. The run
itself is the plain one at the finer step, bit for bit.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from types import TracebackType

import numpy as np

from validate.replay.buffers import References
from validate.replay.fmi import Instance
from validate.replay.package import Package
from validate.replay.wiring import Variables

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
