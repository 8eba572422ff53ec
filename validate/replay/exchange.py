"""A Model Exchange FMU as a continuous model: states, their rates, gaps and events, as the reference integrator needs them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from validate.replay.buffers import References, buffer
from validate.replay.fmi import Instance, load_instance
from validate.replay.package import Package
from validate.replay.wiring import Variables


class ContinuousModel(Protocol):
    """What the reference integrator drives. x (nx,): the model's states; rates: dx/dt and then the rates of `accumulated` quantities.

    outputs: number of values `read` gives; indicators: number of event functions; nominal (nx,): typical size of each state.
    """

    nominal: np.ndarray
    accumulated: int
    indicators: int
    outputs: int
    wants_steps: bool  # whether `step_completed` must be called after every internal step
    next_event: float  # time of the next event the model knows of [s]; infinite without

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray: ...

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None: ...

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None: ...

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None: ...

    def read(self, time: float, y: np.ndarray) -> np.ndarray: ...

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray: ...

    def step_completed(self, time: float, y: np.ndarray) -> bool: ...


class ExchangeModel:
    """ContinuousModel over an instance for Model Exchange. Every FMI call that fails raises CallError."""

    def __init__(self, package: Package, variables: Variables) -> None:
        description = package.description
        self._variables = variables
        self._fmu = load_instance(package, exchange=True)
        self.states = int(description.numberOfContinuousStates)
        self.indicators = int(description.numberOfEventIndicators)
        self.accumulated = len(variables.rates)
        self.outputs = len(variables.outputs)
        # FMI 3 turned the flag round: steps are told only where the FMU asks for it.
        exchange = description.modelExchange
        self.wants_steps = bool(
            exchange.needsCompletedIntegratorStep if package.is_three else not exchange.completedIntegratorStepNotNeeded
        )
        self.nominal = np.ones(self.states)
        self.next_event = math.inf
        # One buffer a purpose, seen by both C and numpy: the right-hand side allocates nothing.
        self._x, self._x_view = buffer(self.states)
        self._dx, self._dx_view = buffer(self.states)
        self._gaps, self._gaps_view = buffer(self.indicators)
        self._rates = References(variables.rates)
        self._out = References(variables.outputs)
        self._inputs = References(variables.u)

    @property
    def instance(self) -> Instance:
        """What its functions are called of."""
        return self._fmu

    @property
    def references(self) -> tuple[References, References, References]:
        """Of what is accumulated, of outputs, of inputs."""
        return self._rates, self._out, self._inputs

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Initialise at `time` [s] with the plan's start, in the order of Variables.start; the states (nx,)."""
        fmu, variables = self._fmu, self._variables
        settings = [*variables.parameters, *zip(variables.start, state.tolist(), strict=True)]
        fmu.choose(variables.choices)
        fmu.initialise(time, settings, self._inputs, u)
        _, self.next_event = fmu.settle()
        x, x_view = buffer(self.states)
        fmu.states(x, self.states)
        nominal, view = buffer(self.states)
        fmu.nominals(nominal, self.states)
        self.nominal = np.where(np.isfinite(view) & (view > 0), view, 1.0)
        return x_view.copy()

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None:
        self._fmu.write(self._inputs, u)

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None:
        self._move(time, y)
        self._fmu.derivatives(self._dx, self.states)
        rates[: self.states] = self._dx_view
        if self.accumulated:
            rates[self.states :] = self._fmu.read(self._rates)

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None:
        self._move(time, y)
        self._fmu.indicators(self._gaps, self.indicators)
        values[:] = self._gaps_view

    def read(self, time: float, y: np.ndarray) -> np.ndarray:
        """(outputs,) q, v, lam, gap, energies - those that the FMU has."""
        self._move(time, y)
        return self._fmu.read(self._out).copy()

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Event mode at (time, y), with new inputs if u is given; y afterwards (other states, if the FMU changed them)."""
        fmu = self._fmu
        self._move(time, y)
        fmu.enter_event_mode()
        if u is not None:
            self.set_inputs(u)
        changed, self.next_event = fmu.settle()
        if not changed:
            return y
        fmu.states(self._x, self.states)
        return np.concatenate([self._x_view, y[self.states :]])

    def jacobian(self, time: float, x: np.ndarray, unknowns: Sequence[int], knowns: Sequence[int]) -> np.ndarray:
        """(unknowns, knowns) directional derivatives at (time, x), by value references."""
        self._move(time, x)
        return self._fmu.jacobian(unknowns, knowns)

    def step_completed(self, time: float, y: np.ndarray) -> bool:
        """Tell the FMU that the integrator accepted a step; whether it wants an event now."""
        self._move(time, y)
        return self._fmu.step_completed()

    def close(self) -> None:
        self._fmu.close()

    def _move(self, time: float, y: np.ndarray) -> None:
        self._x_view[:] = y[: self.states]
        self._fmu.move(time, self._x, self.states)
