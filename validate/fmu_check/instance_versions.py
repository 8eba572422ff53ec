"""An instance of an FMI 3.0 FMU.

An instance of an FMI 2.0 FMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Discard,
    fmi2LastSuccessfulTime,
    fmi2Terminated,
)
from fmpy.fmi3 import FMU3Model, FMU3Slave

from validate.fmu_check.instance import Ended, Instance
from validate.fmu_check.subject import Variable

_GROUPS = {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer", "Boolean": "Boolean"}


class Instance2(Instance):
    """See validate.fmu_check.instance."""

    prefix = "fmi2"

    def _class(self) -> type:
        return FMU2Model if self.kind == "ME" else FMU2Slave

    def make(self) -> None:
        def keep(_environment: Any, _name: Any, _status: int, _category: Any, message: Any) -> None:
            self.said.append((message or b"").decode("utf-8", errors="replace"))

        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = fmi2CallbackLoggerTYPE(keep)
        self._callbacks.allocateMemory = defaultCallbacks.allocateMemory
        self._callbacks.freeMemory = defaultCallbacks.freeMemory
        self.again()

    def again(self) -> None:
        """Instantiate with the callbacks there are."""
        try:
            self.fmu.instantiate(callbacks=self._callbacks)
        except FMICallException:
            raise
        except Exception as error:  # FMPy's bare Exception for a null pointer
            raise self.no_instance("fmi2Instantiate returned no instance") from error

    def setup(self, start: float, stop: float | None) -> None:
        self.fmu.setupExperiment(tolerance=self.tolerance, startTime=start, stopTime=stop)

    def enter_initialisation(self, start: float, stop: float | None) -> None:
        self.fmu.enterInitializationMode()

    def _update(self) -> tuple[bool, bool, bool, bool, bool, float]:
        return self.fmu.newDiscreteStates()

    def read_group(self, kind: str, references: Sequence[int], size: int) -> Sequence[float]:
        return getattr(self.fmu, f"get{_GROUPS[kind]}")(list(references))

    def write_group(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        numbers = list(values) if kind == "Real" else [int(value) for value in values]
        getattr(self.fmu, f"set{_GROUPS[kind]}")(list(references), numbers)

    def rates(self) -> np.ndarray:
        return self._array(self.fmu.getDerivatives, self.state_count)

    def do_step(self, time: float, step: float) -> float | None:
        try:
            self.fmu.doStep(time, step)
        except FMICallException as error:
            if error.status == fmi2Discard and self._wants_to_end():
                raise Ended(time + step) from error
            raise
        return None

    def _wants_to_end(self) -> bool:
        """fmi2Terminated, which may be asked after a step was discarded."""
        try:
            return bool(self.fmu.getBooleanStatus(fmi2Terminated))
        except FMICallException:
            return False

    def last_successful_time(self) -> float | None:
        """fmi2LastSuccessfulTime, which may be asked after a step was discarded; None if the FMU does not tell it."""
        try:
            return float(self.fmu.getRealStatus(fmi2LastSuccessfulTime))
        except FMICallException:
            return None

    def directional(self, unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float]) -> np.ndarray:
        result = self.fmu.getDirectionalDerivative(
            [item.reference for item in unknowns], [item.reference for item in knowns], [float(value) for value in seed]
        )
        return np.array(result)


class Instance3(Instance):
    """See validate.fmu_check.instance. Co-Simulation without event mode and without early return, unless `options` ask for them."""

    prefix = "fmi3"

    def _class(self) -> type:
        return FMU3Model if self.kind == "ME" else FMU3Slave

    def make(self) -> None:
        self.again()

    def again(self) -> None:
        def keep(_environment: Any, _status: int, _category: Any, message: Any) -> None:
            self.said.append((message or b"").decode("utf-8", errors="replace"))

        try:
            self.fmu.instantiate(logMessage=keep, **self.options)
        except FMICallException:
            raise
        except Exception as error:  # FMPy's bare Exception for a null pointer
            raise self.no_instance("the FMU returned no instance") from error

    def setup(self, start: float, stop: float | None) -> None:
        """FMI 3.0 is given the times on entering initialisation."""

    def enter_initialisation(self, start: float, stop: float | None) -> None:
        self.fmu.enterInitializationMode(tolerance=self.tolerance, startTime=start, stopTime=stop)

    def _update(self) -> tuple[bool, bool, bool, bool, bool, float]:
        return self.fmu.updateDiscreteStates()

    def read_group(self, kind: str, references: Sequence[int], size: int) -> Sequence[float]:
        name = "Int64" if kind == "Enumeration" else kind
        return getattr(self.fmu, f"get{name}")(list(references), nValues=size)

    def write_group(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        name = "Int64" if kind == "Enumeration" else kind
        numbers: list[Any] = list(values)
        if name == "Boolean":
            numbers = [bool(value) for value in values]
        elif not name.startswith("Float"):
            numbers = [int(value) for value in values]
        getattr(self.fmu, f"set{name}")(list(references), numbers)

    def rates(self) -> np.ndarray:
        return self._array(self.fmu.getContinuousStateDerivatives, self.state_count)

    def do_step(self, time: float, step: float) -> float | None:
        _, terminate, _, reached = self.fmu.doStep(time, step)
        if terminate:
            raise Ended(time + step)
        return float(reached)

    def answered_step(self, time: float, step: float) -> tuple[bool, bool, float]:
        """One communication step: whether an event is to be handled, whether it returned early, the time it says it reached. Raises Ended."""
        event, terminate, early, reached = self.fmu.doStep(time, step)
        if terminate:
            raise Ended(time + step)
        return bool(event), bool(early), float(reached)

    def directional(self, unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float]) -> np.ndarray:
        result = self.fmu.getDirectionalDerivative(
            [item.reference for item in unknowns],
            [item.reference for item in knowns],
            [float(value) for value in seed],
            nSensitivity=sum(item.size for item in unknowns),
        )
        return np.array(result)

    def adjoint(self, unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float]) -> np.ndarray:
        result = self.fmu.getAdjointDerivative(
            [item.reference for item in unknowns],
            [item.reference for item in knowns],
            [float(value) for value in seed],
            nSensitivity=sum(item.size for item in knowns),
        )
        return np.array(result)
