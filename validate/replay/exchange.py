"""A Model Exchange FMU as a continuous model: states, their rates, gaps and events, as the reference integrator needs them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from validate.replay.calls import buffer, close_instance, load_instance, reference_array, set_reals
from validate.replay.package import FmuError, Package, Variables

# Rounds of event iteration (newDiscreteStates) before an FMU is given up as never settling.
_EVENT_ROUNDS = 100


class ContinuousModel(Protocol):
    """What the reference integrator drives. x (nx,): the model's states; rates: dx/dt and then the rates of `accumulated` quantities.

    outputs: number of values `read` gives; indicators: number of event functions; nominal (nx,): typical size of each state.
    """

    nominal: np.ndarray
    accumulated: int
    indicators: int
    outputs: int
    wants_steps: bool  # whether `step_completed` must be called after every internal step

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray: ...

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None: ...

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None: ...

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None: ...

    def read(self, time: float, y: np.ndarray) -> np.ndarray: ...

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray: ...

    def step_completed(self, time: float, y: np.ndarray) -> bool: ...


class ExchangeModel:
    """ContinuousModel over FMPy's FMU2Model. Every FMI call that fails raises FMPy's FMICallException."""

    def __init__(self, package: Package, variables: Variables) -> None:
        from fmpy.fmi2 import FMU2Model

        description = package.description
        self._variables = variables
        self._fmu: Any = load_instance(FMU2Model, package, description.modelExchange.modelIdentifier)
        self._states = int(description.numberOfContinuousStates)
        self.indicators = int(description.numberOfEventIndicators)
        self.accumulated = len(variables.rates)
        self.outputs = len(variables.outputs)
        self.wants_steps = not description.modelExchange.completedIntegratorStepNotNeeded
        self.nominal = np.ones(self._states)
        # One buffer a purpose, seen by both C and numpy: the right-hand side allocates nothing.
        self._x, self._x_view = buffer(self._states)
        self._rates, self._rates_view = buffer(self._states + self.accumulated)
        self._gaps, self._gaps_view = buffer(self.indicators)
        self._out, self._out_view = buffer(self.outputs)
        self._tail = (ctypes.c_double * self.accumulated).from_buffer(self._rates, 8 * self._states) if self.accumulated else None
        self._rate_references = reference_array(variables.rates)
        self._out_references = reference_array(variables.outputs)
        self._input_references = reference_array(variables.u)

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Initialise at `time` [s] with (2*nq,) positions and velocities; the states (nx,)."""
        fmu, variables = self._fmu, self._variables
        fmu.setupExperiment(startTime=time)
        set_reals(fmu, [item for item, _ in variables.parameters], [value for _, value in variables.parameters])
        set_reals(fmu, variables.q + variables.v, state)
        fmu.enterInitializationMode()
        self.set_inputs(u)
        fmu.exitInitializationMode()
        self._settle()
        fmu.getContinuousStates(self._x, self._states)
        x = self._x_view.copy()
        nominal, view = buffer(self._states)
        fmu.getNominalsOfContinuousStates(nominal, self._states)
        self.nominal = view.copy()
        return x

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None:
        if self._variables.u:
            fmu = self._fmu
            fmu.fmi2SetReal(fmu.component, self._input_references, len(u), (ctypes.c_double * len(u))(*u))

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None:
        fmu = self._fmu
        self._move(time, y)
        fmu.fmi2GetDerivatives(fmu.component, self._rates, self._states)
        if self._tail is not None:
            fmu.fmi2GetReal(fmu.component, self._rate_references, self.accumulated, self._tail)
        rates[:] = self._rates_view

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None:
        fmu = self._fmu
        self._move(time, y)
        fmu.fmi2GetEventIndicators(fmu.component, self._gaps, self.indicators)
        values[:] = self._gaps_view

    def read(self, time: float, y: np.ndarray) -> np.ndarray:
        """(outputs,) q, v, lam, gap, energies - those that the FMU has."""
        fmu = self._fmu
        self._move(time, y)
        fmu.fmi2GetReal(fmu.component, self._out_references, self.outputs, self._out)
        return self._out_view.copy()

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Event mode at (time, y), with new inputs if u is given; y afterwards (other states, if the FMU changed them)."""
        fmu = self._fmu
        self._move(time, y)
        fmu.enterEventMode()
        if u is not None:
            self.set_inputs(u)
        if not self._settle():
            return y
        fmu.getContinuousStates(self._x, self._states)
        return np.concatenate([self._x_view, y[self._states :]])

    def step_completed(self, time: float, y: np.ndarray) -> bool:
        """Tell the FMU that the integrator accepted a step; whether it wants an event now."""
        self._move(time, y)
        wants_event, _ = self._fmu.completedIntegratorStep()
        return wants_event

    def close(self) -> None:
        close_instance(self._fmu)

    def _move(self, time: float, y: np.ndarray) -> None:
        fmu = self._fmu
        fmu.fmi2SetTime(fmu.component, time)
        self._x_view[:] = y[: self._states]
        fmu.fmi2SetContinuousStates(fmu.component, self._x, self._states)

    def _settle(self) -> bool:
        """Iterate events until the FMU is content, then go back to continuous time; whether the states changed."""
        changed = False
        for _ in range(_EVENT_ROUNDS):
            again, _, _, states_changed, _, _ = self._fmu.newDiscreteStates()
            changed = changed or states_changed
            if not again:
                self._fmu.enterContinuousTimeMode()
                return changed
        raise FmuError(f"FMU {self._fmu.modelIdentifier}: its event iteration did not end after {_EVENT_ROUNDS} rounds.")
