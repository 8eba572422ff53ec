"""A Model Exchange FMU through a plan by CVODE and the loop of integration.c: one call a step of the plan, and one an event."""

from __future__ import annotations

import ctypes
import importlib.util
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from validate.judge.replay.compiled import library
from validate.judge.replay.compiled.library import Fmu, Reason
from validate.judge.replay.reference import STEP_LIMIT, ContinuousModel, ExchangeModel, Integration, Run, Stop
from validate.judge.replay.result import ReplayOutcome
from validate.judge.replay.wiring import HeldInputs

_SIZE, _ADDRESS, _DOUBLE = ctypes.c_int64, ctypes.c_void_p, ctypes.c_double
# The functions of SUNDIALS in the order of integration.c, and the only major version whose arguments are known to be these.
SOLVER = (
    "SUNContext_Create", "SUNContext_ClearErrHandlers", "SUNContext_Free", "N_VNew_Serial", "N_VGetArrayPointer", "N_VDestroy",
    "SUNDenseMatrix", "SUNMatDestroy", "SUNLinSol_Dense", "SUNLinSolFree", "CVodeCreate", "CVodeFree", "CVodeInit", "CVodeReInit",
    "CVodeSVtolerances", "CVodeSetUserData", "CVodeSetLinearSolver", "CVodeSetMaxNonlinIters", "CVodeSetMaxConvFails", "CVodeRootInit",
    "CVodeSetRootDirection", "CVodeSetInitStep", "CVodeSetMinStep", "CVodeSetMaxStep", "CVodeSetMaxOrd", "CVodeSetMaxNumSteps",
    "CVodeSetStopTime", "CVodeClearStopTime", "CVode", "CVodeGetRootInfo",
)  # fmt: skip
_VERSION = 7
_ROOT_RETURN = 2
_NEEDED = (
    "GetReal", "SetReal", "SetTime", "SetContinuousStates", "GetContinuousStates", "GetDerivatives", "GetEventIndicators",
    "CompletedIntegratorStep", "EnterEventMode", "NewDiscreteStates", "EnterContinuousTimeMode",
)  # fmt: skip


class _Loop(ctypes.Structure):
    """struct integration of integration.c."""

    _fields_ = (
        ("fmu", Fmu),
        ("solver", _ADDRESS * len(SOLVER)),
        ("rtol", _DOUBLE),
        ("min_step", _DOUBLE),
        ("max_step", _DOUBLE),
        ("max_steps", _SIZE),
        ("wants_steps", _SIZE),
        ("linear", _SIZE),
        ("absolute", _ADDRESS),
        ("bound", _ADDRESS),
        ("roots", _ADDRESS),
        ("begin", _DOUBLE),
        ("values", _ADDRESS),
        ("slopes", _ADDRESS),
        ("applied", _ADDRESS),
        ("time", _DOUBLE),
        ("next_event", _DOUBLE),
        ("y", _ADDRESS),
        ("flag", _SIZE),
        ("reached", _SIZE),
        ("fault_time", _DOUBLE),
        ("fault", _SIZE),
        ("own", _ADDRESS * 6),
    )


@lru_cache(maxsize=1)
def solver_addresses() -> tuple[int, ...] | None:
    """Of the functions of CVODE in the libraries that scikit-sundae brings, without importing it; None where they cannot be reached."""
    found = importlib.util.find_spec("sksundae")
    for folder in (found.submodule_search_locations or []) if found is not None else []:
        for path in sorted(Path(folder).glob("_cy_cvode*")):
            if path.suffix in (".so", ".pyd", ".dylib"):
                return _addresses(path)
    return None


def _addresses(path: Path) -> tuple[int, ...] | None:
    version = [ctypes.c_int() for _ in range(3)]
    label = ctypes.create_string_buffer(32)
    try:
        # A lookup by this handle goes on to the libraries that the module needs (not so on Windows).
        module = ctypes.CDLL(str(path))
        module.SUNDIALSGetVersionNumber(*map(ctypes.byref, version), label, len(label))
        addresses = [ctypes.cast(module[name], ctypes.c_void_p).value for name in SOLVER]
    except (OSError, AttributeError):
        return None
    return None if version[0].value != _VERSION or None in addresses else tuple(address or 0 for address in addresses)


def compiled_integration(
    model: ContinuousModel, inputs: HeldInputs, rtol: float, event_budget: int, run: Run, parts: int, max_step: float
) -> Integration | None:
    """The integration in C; None where it cannot be: no FMU, no compiler, no addresses of CVODE, or the FMU lacks a function."""
    loops = library.load()
    if loops is None or not isinstance(model, ExchangeModel):
        return None
    addresses = solver_addresses()
    rates, outputs, given = model.references
    fmu = library.describe(
        model.instance, _NEEDED, inputs=given, outputs=outputs, rates=rates, states=model.states, indicators=model.indicators
    )
    if addresses is None or fmu is None:
        return None
    return _CompiledIntegration(model, inputs, rtol, event_budget, run, parts, max_step, (loops, addresses, fmu))


class _CompiledIntegration(Integration):
    def __init__(
        self,
        model: ExchangeModel,
        inputs: HeldInputs,
        rtol: float,
        event_budget: int,
        run: Run,
        parts: int,
        max_step: float,
        made: tuple[Any, tuple[int, ...], Fmu],
    ) -> None:
        super().__init__(model, inputs, rtol, event_budget, run, parts, max_step)
        self._exchange = model
        self._loops, addresses, fmu = made
        size, (_, points) = model.states + model.accumulated, self.targets.shape
        self._y, self._roots = np.empty(size), np.zeros(max(1, model.indicators), dtype=np.int32)
        self._values, self._slopes, self._applied = (np.zeros(fmu.inputs) for _ in range(3))
        self._outputs, self._sums = (
            np.empty((len(self.targets), points, model.outputs)),
            np.empty((len(self.targets), points, model.accumulated)),
        )
        self._targets_at, self._outputs_at, self._sums_at = _at(self.targets), _at(self._outputs), _at(self._sums)
        self._absolute, self._bound = np.empty(size), np.empty(model.states)
        self._loop = _Loop(
            fmu=fmu, solver=(_ADDRESS * len(SOLVER))(*addresses), rtol=rtol, min_step=self.min_step, max_step=self.max_step, max_steps=STEP_LIMIT,
            wants_steps=model.wants_steps, linear=inputs.linear, absolute=_at(self._absolute), bound=_at(self._bound), roots=_at(self._roots),
            values=_at(self._values), slopes=_at(self._slopes), applied=_at(self._applied), y=_at(self._y),
        )  # fmt: skip
        self._at = ctypes.addressof(self._loop)

    def renew(self, time: float, y: np.ndarray) -> None:
        self._absolute[:], self._bound[:] = self.absolute_tolerances(), self.bound
        self._loop.time, self._loop.next_event, self._y[:] = time, self.model.next_event, y
        self._set_inputs()
        self._check(self._loops.integration_renew(self._at))

    def jump(self, time: float, values: np.ndarray, is_event: bool) -> None:
        self._loop.time, self._y[:] = time, self.y
        self._set_inputs()
        self._check(self._loops.integration_jump(self._at) if is_event else self._loops.integration_restart(self._at))
        self.model.next_event, self.y = self._loop.next_event, self._y

    def over_points(self, stop: float) -> None:
        if self.inputs.linear:
            self._set_inputs()
        done, count = 0, self.targets.shape[1]
        while done < count:
            place = self.step * count + done
            reason = self._loops.integration_advance(
                self._at,
                self._targets_at + 8 * place,
                count - done,
                stop,
                self._outputs_at + 8 * place * self._outputs.shape[2],
                self._sums_at + 8 * place * self._sums.shape[2],
            )
            first, done = done, done + self._loop.reached
            self._take(first, done)
            if reason == Reason.EVENT:
                if self._loop.flag == _ROOT_RETURN:
                    self.note(self._loop.time, self._roots)
                done += self.after_event(self._loop.time, self._y.copy(), float(self.targets[self.step, done]), knot=done == count - 1)
            elif reason != Reason.DONE:
                self._check(reason)

    def close(self) -> None:
        self._loops.integration_close(self._at)

    def _set_inputs(self) -> None:
        self._loop.begin = self.inputs.times[self.step]
        self._values[:], self._slopes[:] = self.inputs.values[self.step], self.inputs.slopes[self.step]

    def _take(self, first: int, last: int) -> None:
        run, step = self.run, self.step
        run.t.extend(self.targets[step, first:last].tolist())
        run.outputs.extend(self._outputs[step, first:last])
        run.accumulated.extend(self._sums[step, first:last])
        if last == self.targets.shape[1] and first < last:
            run.knots.append(len(run.t) - 1)
        self.y = self._y

    def _check(self, number: int) -> None:
        """Raise what the loop in Python would have raised."""
        reason = Reason(number)
        if reason is Reason.DONE:
            return
        time, fmu = float(self._loop.time), self._exchange.instance
        if reason is Reason.CALL_REFUSED:
            library.refuse(fmu, self._loop.fmu)
        if reason in (Reason.WANTS_END, Reason.NEVER_SETTLES):
            library.unsettled(fmu, reason)
        if reason is Reason.RATE_NOT_FINITE:
            raise Stop(ReplayOutcome.NOT_A_NUMBER, f"A rate of change was not a finite number at t = {self._loop.fault_time:.6g} s.")
        if reason is Reason.OUTPUT_NOT_FINITE:
            raise Stop(ReplayOutcome.NOT_A_NUMBER, f"An output was not a finite number at t = {time:.6g} s.")
        if reason in (Reason.OUT_OF_BOUNDS, Reason.SUM_NOT_FINITE, Reason.SOLVER_FAILED):
            self.within_bounds(time, self._y)
            self._stopped(time)
        raise RuntimeError(f"CVODE refused {'its stop time' if reason is Reason.STOP_TIME_REFUSED else 'to be set up'} at t = {time:.6g} s")

    def _stopped(self, time: float) -> NoReturn:
        from sksundae._cy_cvode import CVMESSAGES  # 0.9 s to import

        flag = int(self._loop.flag)
        raise Stop(ReplayOutcome.INTEGRATION_FAILED, f"CVODE stopped at t = {time:.6g} s: {CVMESSAGES.get(flag, flag)}")


def _at(array: np.ndarray) -> int:
    return array.ctypes.data
