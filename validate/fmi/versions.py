"""FMPy's classes of FMI 2.0 and FMI 3.0 with one name for what the two versions name, or pass, differently.

    fmu = CLASSES[2, "ME"](guid=.., modelIdentifier=.., unzipDirectory=..)    # FMPy loads the library
    fmu.make(log, {})                                                         # and instantiates

What is the same in both - terminate, reset, enterEventMode, getContinuousStates, .. - is FMPy's own. A class must be called FMU2.. or FMU3..: FMPy
takes the prefix of the functions from that.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

from fmpy.fmi1 import _FMU, FMICallException
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Discard,
    fmi2Fatal,
    fmi2LastSuccessfulTime,
    fmi2OK,
    fmi2Terminated,
    fmi2Warning,
)
from fmpy.fmi3 import FMU3Model, FMU3Slave

_WHOLE = {"Enumeration": "Integer"}
_WHOLE_3 = {"Enumeration": "Int64"}


class StepAnswer(NamedTuple):
    """What a communication step answered.

    event: one is to be handled; ends: the FMU asks for the end of the simulation; early: it returned early; reached: the time it says it reached [s]
    (FMI 2.0 says nothing: the end of the step).
    """

    event: bool
    ends: bool
    early: bool
    reached: float


class _Calls(_FMU):
    """FMPy's one way to call, stricter: a status that FMI does not know is refused as well, and a fatal one is remembered (`fatal`)."""

    prefix: str
    fatal = False

    def _call(self, fname: str, *args: Any) -> Any:
        function = self._functions[fname]
        answer = function(*args)
        if function.restype is ctypes.c_int and answer != fmi2OK and answer != fmi2Warning:
            self.refuse(fname, answer)
        return answer

    def refuse(self, function: str, status: int) -> NoReturn:
        """Raise FMICallException for a call of `function` that was answered with this status."""
        self.fatal = self.fatal or status == fmi2Fatal
        raise FMICallException(function=function, status=status)

    def address(self, function: str) -> int:
        """Of one of FMI's functions, named without its prefix."""
        return ctypes.cast(self._functions[self.prefix + function], ctypes.c_void_p).value or 0


class _Fmi2(_Calls):
    prefix = "fmi2"

    def make(self, log: Callable[..., None], options: Mapping[str, Any]) -> None:
        if self.callbacks is None:
            own = fmi2CallbackFunctions()
            own.logger = fmi2CallbackLoggerTYPE(log)
            own.allocateMemory, own.freeMemory = defaultCallbacks.allocateMemory, defaultCallbacks.freeMemory
            self.callbacks = own
        self.instantiate(callbacks=self.callbacks, **options)

    def setup(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """Before values are set."""
        self.setupExperiment(tolerance=tolerance, startTime=start, stopTime=stop)

    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """Into Initialization Mode."""
        self.enterInitializationMode()

    def update(self) -> tuple[bool, bool, bool, bool, bool, float]:
        """One round of event iteration: again, ends, nominals changed, states changed, has a next event, its time."""
        return self.newDiscreteStates()

    def read(self, kind: str, references: Sequence[int], size: int) -> Sequence[float]:
        return getattr(self, f"get{_WHOLE.get(kind, kind)}")(references)

    def write(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        numbers = values if kind == "Real" else [int(value) for value in values]
        getattr(self, f"set{_WHOLE.get(kind, kind)}")(references, numbers)

    def read_doubles(self, references: Any, memory: Any, count: int) -> None:
        """Into memory of C's, without a list."""
        self.fmi2GetReal(self.component, references, count, memory)

    def write_doubles(self, references: Any, memory: Any, count: int) -> None:
        self.fmi2SetReal(self.component, references, count, memory)

    def rates(self, into: Any, count: int) -> None:
        self.getDerivatives(into, count)

    def step(self, time: float, length: float) -> StepAnswer:
        """One communication step [s]."""
        try:
            self.doStep(time, length)
        except FMICallException as error:
            if error.status == fmi2Discard and self._status(self.getBooleanStatus, fmi2Terminated):
                return StepAnswer(False, True, False, time + length)
            raise
        return StepAnswer(False, False, False, time + length)

    def last_successful_time(self) -> float | None:
        """May be asked after a step that was discarded; None if the FMU does not tell it."""
        return self._status(self.getRealStatus, fmi2LastSuccessfulTime)

    def _status(self, ask: Callable[[int], Any], what: int) -> Any:
        try:
            return ask(what)
        except FMICallException:
            return None

    def save_to(self, place: Any) -> None:
        self.fmi2GetFMUstate(self.component, ctypes.byref(place))

    def directional(self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], size: int) -> Sequence[float]:
        return self.getDirectionalDerivative(unknowns, knowns, seed)


class _Fmi3(_Calls):
    """Co-Simulation without event mode and without early return, unless the options ask for them."""

    prefix = "fmi3"

    def make(self, log: Callable[..., None], options: Mapping[str, Any]) -> None:
        self.instantiate(logMessage=log, **options)

    def setup(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """FMI 3.0 is given the times on entering initialisation."""

    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        self.enterInitializationMode(tolerance=tolerance, startTime=start, stopTime=stop)

    def update(self) -> tuple[bool, bool, bool, bool, bool, float]:
        return self.updateDiscreteStates()

    def read(self, kind: str, references: Sequence[int], size: int) -> Sequence[float]:
        return getattr(self, f"get{_WHOLE_3.get(kind, kind)}")(references, nValues=size)

    def write(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        name = _WHOLE_3.get(kind, kind)
        numbers: Sequence[Any] = values
        if not name.startswith("Float"):
            numbers = [bool(value) if name == "Boolean" else int(value) for value in values]
        getattr(self, f"set{name}")(references, numbers)

    def read_doubles(self, references: Any, memory: Any, count: int) -> None:
        self.fmi3GetFloat64(self.component, references, count, memory, count)

    def write_doubles(self, references: Any, memory: Any, count: int) -> None:
        self.fmi3SetFloat64(self.component, references, count, memory, count)

    def rates(self, into: Any, count: int) -> None:
        self.getContinuousStateDerivatives(into, count)

    def step(self, time: float, length: float) -> StepAnswer:
        return StepAnswer(*self.doStep(time, length))

    def last_successful_time(self) -> float | None:
        """FMI 3.0 tells it with the step."""
        return None

    def save_to(self, place: Any) -> None:
        self.fmi3GetFMUState(self.component, ctypes.byref(place))

    def directional(self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], size: int) -> Sequence[float]:
        return self.getDirectionalDerivative(unknowns, knowns, seed, nSensitivity=size)

    def adjoint(self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], size: int) -> Sequence[float]:
        return self.getAdjointDerivative(unknowns, knowns, seed, nSensitivity=size)


class FMU2Exchange(_Fmi2, FMU2Model):
    """FMI 2.0, Model Exchange."""


class FMU2Stepping(_Fmi2, FMU2Slave):
    """FMI 2.0, Co-Simulation."""


class FMU3Exchange(_Fmi3, FMU3Model):
    """FMI 3.0, Model Exchange."""


class FMU3Stepping(_Fmi3, FMU3Slave):
    """FMI 3.0, Co-Simulation."""


CLASSES = {(2, "ME"): FMU2Exchange, (2, "CS"): FMU2Stepping, (3, "ME"): FMU3Exchange, (3, "CS"): FMU3Stepping}
