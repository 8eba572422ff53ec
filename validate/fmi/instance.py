"""One instance of an FMU: FMI 2.0 or 3.0, Model Exchange or Co-Simulation.

    fmu = load_instance(package, "CS")
    fmu.initialise(0.0, [(12, 0.5)], References([3]), np.array([1.0]))
    fmu.do_step(0.0, 0.01)
    fmu.read(outputs)
    fmu.unload()

A refused call raises FMPy's FMICallException, any other obstacle of a run a Fault. `Instance.fmu` is
FMPy's object.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import platform
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import _FMU, FMICallException

from validate.fmi import logger
from validate.fmi.archive import FmuError
from validate.fmi.description import Package, interface_of

# Rounds of one event iteration before it counts as endless.
EVENT_ROUNDS = 100
# Characters of a message that are quoted: about three lines of a terminal.
_QUOTED = 200
_NUMBER = re.compile(r"[-+]?[0-9][0-9.]*([eE][-+]?[0-9]+)?")


class Fault(FmuError):  # noqa: N818 - a finding about the FMU, not an error of ours
    """An obstacle of a run; its text is a clause without full stop, `it asked to end ..`."""


class Misbehaviour(Fault):
    """The FMU broke a rule of the standard."""


class Lacking(Fault):
    """The FMU's code needs something that this machine lacks."""


class TerminationRequested(Fault):
    """The FMU asked for the end of the simulation: a run cannot reach `time` [s]."""

    def __init__(self, time: float) -> None:
        super().__init__(f"it asked to end the simulation at t = {time:.6g} s")
        self.time = time


class RefusedCall(FMICallException):
    """A call that the FMU refused.

    - message: the FMU's message during that call, empty without one.
    - setting: the variables that the call set, with their values; empty for other calls.
    - time: end of the run so far [s], NaN without a run.
    """

    setting = ""
    time = math.nan

    def __init__(self, function: str, status: int, message: str) -> None:
        super().__init__(function=function, status=status)
        self.message = message

    @property
    def sentence(self) -> str:
        """The refusal as a clause without full stop."""
        what = self.setting or "a call that must be possible"
        quoted = f"; it said: {self.message}" if self.message else ""
        return f"{what} is refused ({str(self).rstrip('.')}){quoted}"

    @property
    def reason(self) -> str:
        """The message without numbers, else the call: equal for refusals with one reason."""
        return _NUMBER.sub("#", self.message or f"{self.function} {self.setting}")


@contextlib.contextmanager
def faults_of(path: Path) -> Iterator[None]:
    """A Fault in here becomes an FmuError that names the file."""
    try:
        yield
    except Fault as fault:
        raise FmuError(f"FMU {path}: {fault}.") from fault


class References:
    """Value references of one type that are read or written at once.

    values: (size,) the memory that C reads and writes.
    """

    def __init__(
        self,
        references: Sequence[int],
        kind: str = "",
        size: int | None = None,
        number: Any = ctypes.c_double,
    ) -> None:
        """Allocate the memory.

        kind: the name in the functions of FMI, empty for doubles.
        size: number of entries; None: one per reference.
        number: the type in C.
        """
        self.count, self.kind = len(references), kind
        self.size = self.count if size is None else size
        self.array = (ctypes.c_uint * self.count)(*references)
        self.memory: Any = (number * self.size)()
        self.values = np.frombuffer(self.memory, dtype=number) if self.size else np.empty(0)

    def forget(self) -> None:
        """Overwrite earlier values, in case the FMU returns OK and writes nothing."""
        self.values.fill(math.nan if self.values.dtype.kind == "f" else 0)


# FMPy's classes of FMI 2.0 and FMI 3.0, with one name for each call whose name or arguments differ.
# A class must be called FMU2.. or FMU3..: FMPy takes the prefix of the functions from that.


class StepAnswer(NamedTuple):
    """The answer of a communication step.

    - event: whether an event must be handled.
    - ends: whether the FMU asks for the end of the simulation.
    - early: whether it returned early.
    - reached: the time that it reports [s]; the end of the step in FMI 2.0.
    """

    event: bool
    ends: bool
    early: bool
    reached: float


class _Calls(_FMU):
    """FMPy's way to call; a status unknown to FMI is refused as well, and a fatal one is kept."""

    prefix: str
    doubles: str
    whole: str  # what enumerations are read and written as
    state: str
    fatal = False
    messages = 0  # logged by the instance
    last_message = ""

    def _call(self, fname: str, *args: Any) -> Any:
        function, before = self._functions[fname], self.messages
        answer = function(*args)
        if (
            function.restype is ctypes.c_int
            and answer != fmi2.fmi2OK
            and answer != fmi2.fmi2Warning
        ):
            self.refuse(fname, answer, self.last_message if self.messages > before else "")
        return answer

    def refuse(self, function: str, status: int, message: str = "") -> NoReturn:
        """Raise RefusedCall for a call of `function` that was answered with this status."""
        self.fatal = self.fatal or status == fmi2.fmi2Fatal
        raise RefusedCall(function, status, message)

    def address(self, function: str) -> int:
        """Return the address of a function, named without its prefix."""
        return ctypes.cast(self._functions[self.prefix + function], ctypes.c_void_p).value or 0

    @classmethod
    def references(
        cls, kind: str, references: Sequence[int], size: int | None = None
    ) -> References:
        """Return References of a type, with memory as in C; size: number of entries."""
        name = cls.whole if kind == "Enumeration" else kind
        return References(
            references, name, size, getattr(sys.modules[f"fmpy.{cls.prefix}"], cls.prefix + name)
        )

    def transfer(self, verb: str, what: References) -> None:
        """Get or set values. Raises FMICallException."""
        size = (what.size,) if self.prefix == "fmi3" else ()
        getattr(self, f"{self.prefix}{verb}{what.kind or self.doubles}")(
            self.component, what.array, what.count, what.memory, *size
        )

    def save_to(self, place: Any) -> None:
        self._call(f"{self.prefix}Get{self.state}", self.component, ctypes.byref(place))


class _Fmi2(_Calls):
    prefix = "fmi2"
    doubles = "Real"
    whole = "Integer"
    state = "FMUstate"

    def make(self, log: Callable[..., None], options: Mapping[str, Any]) -> None:
        if self.callbacks is None:
            own = fmi2.fmi2CallbackFunctions()
            own.logger, own.componentEnvironment, self.sink = logger.made(log)
            own.allocateMemory, own.freeMemory = (
                fmi2.defaultCallbacks.allocateMemory,
                fmi2.defaultCallbacks.freeMemory,
            )
            self.callbacks = own
        self.instantiate(callbacks=self.callbacks, **options)

    def setup(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """Before values are set."""
        self.setupExperiment(tolerance=tolerance, startTime=start, stopTime=stop)

    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """Into Initialization Mode."""
        self.enterInitializationMode()

    def step(self, time: float, length: float) -> StepAnswer:
        """One communication step [s]."""
        try:
            self.doStep(time, length)
        except FMICallException as error:
            if error.status == fmi2.fmi2Discard and self._status(
                self.getBooleanStatus, fmi2.fmi2Terminated
            ):
                return StepAnswer(False, True, False, time + length)
            raise
        return StepAnswer(False, False, False, time + length)

    def last_successful_time(self) -> float | None:
        """Return the time that a discarded step reached [s]; None if the FMU does not report it."""
        return self._status(self.getRealStatus, fmi2.fmi2LastSuccessfulTime)

    def _status(self, ask: Callable[[int], Any], what: int) -> Any:
        with contextlib.suppress(FMICallException):
            return ask(what)

    def directional(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], size: int
    ) -> Sequence[float]:
        return self.getDirectionalDerivative(unknowns, knowns, seed)


class _Fmi3(_Calls):
    """Co-Simulation without event mode and early return, unless the options request them."""

    prefix = "fmi3"
    doubles = "Float64"
    whole = "Int64"
    state = "FMUState"

    def make(self, log: Callable[..., None], options: Mapping[str, Any]) -> None:
        self.instantiate(logMessage=log, **options)

    def setup(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """FMI 3.0 is given the times on entering initialisation."""

    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        self.enterInitializationMode(tolerance=tolerance, startTime=start, stopTime=stop)

    def step(self, time: float, length: float) -> StepAnswer:
        return StepAnswer(*self.doStep(time, length))

    def last_successful_time(self) -> float | None:
        """Return None: FMI 3.0 reports it with the step."""
        return None

    def directional(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], size: int
    ) -> Sequence[float]:
        return self.getDirectionalDerivative(unknowns, knowns, seed, nSensitivity=size)

    def adjoint(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], size: int
    ) -> Sequence[float]:
        return self.getAdjointDerivative(unknowns, knowns, seed, nSensitivity=size)


class FMU2Exchange(_Fmi2, fmi2.FMU2Model):
    """FMI 2.0, Model Exchange."""

    rates = fmi2.FMU2Model.getDerivatives
    update = fmi2.FMU2Model.newDiscreteStates
    leave = fmi2.FMU2Model.enterContinuousTimeMode


class FMU2Stepping(_Fmi2, fmi2.FMU2Slave):
    """FMI 2.0, Co-Simulation."""


class FMU3Exchange(_Fmi3, fmi3.FMU3Model):
    """FMI 3.0, Model Exchange."""

    rates = fmi3.FMU3Model.getContinuousStateDerivatives
    update = fmi3.FMU3Model.updateDiscreteStates
    leave = fmi3.FMU3Model.enterContinuousTimeMode


class FMU3Stepping(_Fmi3, fmi3.FMU3Slave):
    """FMI 3.0, Co-Simulation."""

    update = fmi3.FMU3Slave.updateDiscreteStates
    leave = fmi3.FMU3Slave.enterStepMode


CLASSES: dict[tuple[int, str], Any] = {
    (2, "ME"): FMU2Exchange,
    (2, "CS"): FMU2Stepping,
    (3, "ME"): FMU3Exchange,
    (3, "CS"): FMU3Stepping,
}


class Instance:
    """One instance of an unpacked FMU.

    kind: "ME" or "CS".
    time: of the instance [s].
    next_event: time of the next time event [s], infinite without one.
    """

    def __init__(
        self,
        description: Any,
        folder: Path,
        kind: str,
        name: str,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Load the binary and instantiate.

        description: FMPy's.
        options: more arguments of FMPy's instantiate().
        Raises Fault if the binary cannot be loaded or gives no instance.
        """
        self.description, self.kind, self.options = description, kind, dict(options or {})
        self.time, self.next_event = math.nan, math.inf
        interface = interface_of(description, kind)
        self._needs_tool = bool(interface.needsExecutionTool)
        try:
            # FMPy changes to the library's folder, and stays there if loading fails.
            with contextlib.chdir(os.getcwd()):
                self.fmu: Any = CLASSES[self.major, kind](
                    guid=description.guid,
                    modelIdentifier=interface.modelIdentifier,
                    unzipDirectory=str(folder),
                    instanceName=name,
                )
        except AttributeError as error:
            raise Misbehaviour(
                f"a function of FMI is missing in the binary ({_inside(folder, error)})"
            ) from error
        except Exception as error:  # FMPy's bare Exception for a binary that does not load
            absent = re.search(r"(\S+): cannot open shared object file", str(error))
            if absent and Path(absent[1]).is_file():  # so glibc answers for another processor
                raise Misbehaviour(
                    f"the binary is for another processor than this one ({platform.machine()})"
                ) from error
            if absent and not list(folder.rglob(Path(absent[1]).name)):
                raise Lacking(
                    f"its binary needs {absent[1]}, which neither the FMU carries nor this machine has; install it"
                ) from error
            raise Misbehaviour(f"the binary cannot be loaded ({_inside(folder, error)})") from error
        self.instantiate()

    @property
    def major(self) -> int:
        """Major version of FMI."""
        return int(self.description.fmiVersion.split(".")[0])

    # Life

    def instantiate(self) -> None:
        """Make an instance, also after free()."""
        try:
            self.fmu.make(self._log, self.options)
        except FMICallException:
            raise
        except Exception as error:  # FMPy's bare Exception for a null pointer
            what = "the FMU returned no instance"
            if self._needs_tool:
                raise Lacking(
                    f"{what}; it needs the tool that made it (needsExecutionTool is true), and what that needs{self.quote()}"
                ) from error
            raise Misbehaviour(f"{what}{self.quote()}") from error

    def _log(self, *arguments: Any) -> None:
        """Store a message; in both versions it is the last argument."""
        text = (arguments[-1] or b"").decode("utf-8", errors="replace")
        self.fmu.messages += 1
        self.fmu.last_message = " ".join(text.split())[:_QUOTED]

    def quote(self) -> str:
        """Return the FMU's last message, for the end of a sentence."""
        text = self.fmu.last_message
        return f"; it said: {text}" if text else ""

    def initialise(
        self, time: float, settings: Sequence[tuple[int, float]], inputs: References, u: np.ndarray
    ) -> None:
        """Through initialisation, with some variables set before and the first inputs in it.

        Parameters
        ----------
        time : start of the run [s].
        settings : value reference and value [unit of the variable] of what is set before
            initialisation.
        inputs : value references of the inputs.
        u : (nu,) first inputs [unit of each input], set in initialisation.

        Raises
        ------
        FMICallException : if the FMU refuses a call.
        """
        start = References([reference for reference, _ in settings])
        self.time = time
        self.fmu.setup(time, None, None)
        self.write(start, [value for _, value in settings])
        self.fmu.enter(time, None, None)
        self.write(inputs, u)
        self.fmu.exitInitializationMode()

    def choose(self, choices: Sequence[tuple[int, int]]) -> None:
        """Set whole numbers (enumerations), (reference, value), before `initialise`."""
        if choices:
            self.write(
                self.fmu.references("Enumeration", [reference for reference, _ in choices]),
                [value for _, value in choices],
            )

    def free(self) -> None:
        """Free the instance, unless it reported a fatal status."""
        if self.fmu.component and not self.fmu.fatal:
            getattr(self.fmu, f"{self.fmu.prefix}FreeInstance")(self.fmu.component)
            self.fmu.component = None

    def close(self) -> None:
        """Terminate and free; after a fatal status no function of the FMU may be called."""
        if self.fmu.component and not self.fmu.fatal:
            with contextlib.suppress(FMICallException):
                self.fmu.terminate()
        self.free()

    def unload(self) -> None:
        """Close, and unload the library, so that the next instance loads it again."""
        self.close()
        if not self.fmu.fatal:
            self.fmu.freeLibrary()

    def refuse(self, function: str, status: int) -> NoReturn:
        """Raise FMICallException for a call by address.

        function: name without its prefix.
        """
        self.fmu.refuse(self.fmu.prefix + function, status)
        raise AssertionError(f"status {status} refuses nothing")

    # Values

    def read(self, references: References) -> np.ndarray:
        """Values of some variables, in the same memory at each call.

        Returns
        -------
        (n,) values [unit of each variable], in the order of the references.

        Raises
        ------
        FMICallException : if the FMU refuses the call.
        """
        if references.count:
            self.fmu.transfer("Get", references)
        return references.values

    def write(self, references: References, values: Sequence[float] | np.ndarray) -> None:
        """Set some variables.

        Parameters
        ----------
        references : value references of the variables.
        values : (n,) values [unit of each variable], in their order.

        Raises
        ------
        FMICallException : if the FMU refuses the call.
        """
        if references.count:
            references.values[:] = values
            self.fmu.transfer("Set", references)

    # Saved states

    def save(self, place: Any = None) -> Any:
        """A saved state, a ctypes.c_void_p.

        Kept in `place` if given, which used again takes no new memory. Freed by `forget`.
        """
        place = ctypes.c_void_p() if place is None else place
        self.fmu.save_to(place)
        return place

    def restore(self, saved: Any) -> None:
        """Set a saved state. Raises FMICallException."""
        self.fmu.setFMUState(saved)

    def forget(self, saved: Any) -> None:
        """Free the memory of a saved state. Raises FMICallException."""
        self.fmu.freeFMUState(saved)

    # Model Exchange

    def event(self) -> bool:
        """Enter Event Mode and `settle`."""
        self.fmu.enterEventMode()
        return self.settle()

    def content(self) -> None:
        """Act after the last update, before Event Mode is left; for subclasses."""

    def settle(self) -> bool:
        """Update until the FMU needs no more updates, then leave Event Mode.

        Returns whether states changed. Raises Misbehaviour if the updates do not end,
        TerminationRequested.
        """
        changed = False
        for _ in range(EVENT_ROUNDS):
            again, ends, _, states_changed, defined, following = self.fmu.update()
            changed = changed or states_changed
            if ends:
                raise TerminationRequested(self.time)
            if not again:
                self.content()
                self.fmu.leave()
                self.next_event = float(following) if defined else math.inf
                return changed
        raise endless()

    def _array(self, call: Callable[..., Any], size: int) -> np.ndarray:
        if not size:
            return np.empty(0)
        # A pointer into a numpy array costs more than everything else here.
        array = (ctypes.c_double * size)(*[math.nan] * size)
        call(array, size)
        return np.frombuffer(memoryview(array))

    @property
    def state_count(self) -> int:
        """Number of continuous states, by the description."""
        return int(self.description.numberOfContinuousStates)

    @property
    def indicator_count(self) -> int:
        """Number of event indicators, by the description."""
        return int(self.description.numberOfEventIndicators)

    def states(self) -> np.ndarray:
        """Continuous states, (nx,) [unit of each state].

        Raises FMICallException if the FMU refuses the call.
        """
        return self._array(self.fmu.getContinuousStates, self.state_count)

    def nominals(self) -> np.ndarray:
        """Nominal values of the continuous states, (nx,) [unit of each state].

        Raises FMICallException if the FMU refuses the call.
        """
        return self._array(self.fmu.getNominalsOfContinuousStates, self.state_count)

    def rates(self) -> np.ndarray:
        """Derivatives of the continuous states, (nx,) [unit of each state per s].

        Raises FMICallException if the FMU refuses the call.
        """
        return self._array(self.fmu.rates, self.state_count)

    def indicators(self) -> np.ndarray:
        """Event indicators, (ni,) [unit of each indicator].

        Raises FMICallException if the FMU refuses the call.
        """
        return self._array(self.fmu.getEventIndicators, self.indicator_count)

    def move(self, time: float, states: np.ndarray) -> None:
        """Set time [s] and continuous states (nx,) [unit of each state].

        Raises FMICallException if the FMU refuses.
        """
        self.set_time(time)
        if self.state_count:
            self.fmu.setContinuousStates(
                (ctypes.c_double * self.state_count)(*states.tolist()), self.state_count
            )

    def set_time(self, time: float) -> None:
        """Set the time [s] of a Model Exchange FMU. Raises FMICallException."""
        self.time = time
        self.fmu.setTime(time)

    def completed(self) -> bool:
        """Report an accepted integrator step; return whether the FMU wants an event.

        Raises TerminationRequested if it asks for the end.
        """
        event, ends = self.fmu.completedIntegratorStep()
        if ends:
            raise TerminationRequested(self.time)
        return bool(event)

    @property
    def wants_steps(self) -> bool:
        """Return whether `completed` must be called: FMI 3.0 inverts the flag."""
        interface = self.description.modelExchange
        return (
            bool(interface.needsCompletedIntegratorStep)
            if self.major >= 3
            else not interface.completedIntegratorStepNotNeeded
        )

    # Co-Simulation

    def do_step(self, time: float, step: float) -> StepAnswer:
        """Make one communication step [s].

        Raises TerminationRequested if the FMU asks for the end.
        """
        answer = self.fmu.step(time, step)
        if answer.ends:
            raise TerminationRequested(time + step)
        return answer


def _inside(folder: Path, error: Exception) -> str:
    """Return the text of an error, with paths relative to the unpacked FMU.

    The FMU's folder is temporary.
    """
    return str(error).replace(f"{folder}{os.sep}", "")


def endless() -> Misbehaviour:
    """Return the fault of an event iteration that does not end."""
    return Misbehaviour(f"the event iteration did not end after {EVENT_ROUNDS} rounds")


def load_instance(package: Package, kind: str) -> Instance:
    """An instance of an unpacked FMU, kind "ME" or "CS". Raises FmuError."""
    assert package.folder is not None
    try:
        return Instance(package.description, package.folder, kind, "replay")
    except Fault as fault:
        raise FmuError(
            f"FMU {package.path}: it cannot be loaded on this machine ({fault})."
        ) from fault
