"""One interface over the calls of FMI 2.0 and FMI 3.0, bound to the library directly: a call of the right-hand side costs a microsecond, not five.

FMPy loads the library and instantiates; every call here checks its status. Values go through buffers of doubles that C and numpy share.

Doubles that C and numpy share: what FMI's functions read and write.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np

from validate.fmi.package import FmuError, Package


def buffer(size: int) -> tuple[Any, np.ndarray]:
    """Doubles for C, and the same memory as an array."""
    memory: Any = (ctypes.c_double * size)()
    return memory, np.frombuffer(memory) if size else np.empty(0)


class References:
    """Some variables, read or written at once. values: (n,) the memory that C reads and writes."""

    def __init__(self, references: Sequence[int]) -> None:
        self.count = len(references)
        self.array = (ctypes.c_uint * self.count)(*references)
        self.memory, self.values = buffer(self.count)


_OK, _WARNING, _FATAL = 0, 1, 4
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_D, _S, _I, _B = ctypes.c_double, ctypes.c_size_t, ctypes.c_int, ctypes.c_bool
_P = ctypes.c_void_p
# Rounds of event iteration before an FMU is given up as never settling.
EVENT_ROUNDS = 100


class CallError(Exception):
    """An FMI call was refused. status as FMI counts; after a fatal one nothing of the FMU may be called any more."""

    def __init__(self, function: str, status: int) -> None:
        word = _STATUS[status] if 0 <= status < len(_STATUS) else "no status of FMI"
        super().__init__(f"{function} failed with status {status} ({word})")
        self.fatal = status == _FATAL


class _EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = (
        ("needs_update", _I),
        ("ends", _I),
        ("nominals_changed", _I),
        ("states_changed", _I),
        ("has_next", _I),
        ("next", _D),
    )


class Instance:
    """An instance of an FMU; `exchange` says which of its interfaces. Made by `load_instance`."""

    def __init__(self, fmu: Any, is_three: bool, exchange: bool) -> None:
        self._fmu, self._three, self.exchange = fmu, is_three, exchange
        self._component = ctypes.c_void_p(fmu.component) if not isinstance(fmu.component, ctypes.c_void_p) else fmu.component
        self._prefix = "fmi3" if is_three else "fmi2"
        self._dead = False
        self._bound: dict[str, Callable[..., None]] = {}
        extra = (_S,) if is_three else ()
        real = "Float64" if is_three else "Real"
        self._get = self._bind(f"Get{real}", _P, _S, _P, *extra)
        self._set = self._bind(f"Set{real}", _P, _S, _P, *extra)
        self._extra = is_three
        if exchange:
            self._set_time = self._bind("SetTime", _D)
            self._set_states = self._bind("SetContinuousStates", _P, _S)
            self._derivatives = self._bind("GetContinuousStateDerivatives" if is_three else "GetDerivatives", _P, _S)
            self._indicators = self._bind("GetEventIndicators", _P, _S)
        elif is_three:
            self._do_step = self._bind("DoStep", _D, _D, _B, _P, _P, _P, _P)
            self._flags = [_B() for _ in range(3)]
            self._reached = _D()
        else:
            self._do_step = self._bind("DoStep", _D, _D, _I)

    @property
    def component(self) -> int:
        """The address that every function is given first."""
        return int(self._component.value or 0)

    @property
    def is_three(self) -> bool:
        return self._three

    def address(self, name: str) -> int | None:
        """Of a function, named without its prefix; None if the binary does not have it."""
        try:
            return ctypes.cast(self._fmu.dll[self._prefix + name], ctypes.c_void_p).value
        except AttributeError:
            return None

    def refuse(self, name: str, status: int) -> NoReturn:
        """Raise CallError for a function, named without its prefix; after a fatal status nothing is called any more."""
        self._dead = self._dead or status == _FATAL
        raise CallError(self._prefix + name, status)

    def _bind(self, name: str, *types: Any) -> Callable[..., None]:
        full = self._prefix + name
        if full in self._bound:
            return self._bound[full]
        try:
            function = self._fmu.dll[full]
        except AttributeError as error:
            raise FmuError(f"FMU {self._fmu.modelIdentifier}: its binary has no function {full}.") from error
        function.argtypes, function.restype = (ctypes.c_void_p, *types), ctypes.c_int
        component = self._component

        def call(*arguments: Any) -> None:
            status = function(component, *arguments)
            if status > _WARNING or status < _OK:
                self.refuse(name, status)

        self._bound[full] = call
        return call

    def read(self, references: References) -> np.ndarray:
        """(n,) values; the same memory at each call."""
        if references.count:
            size = (references.count,) if self._extra else ()
            self._get(references.array, references.count, references.memory, *size)
        return references.values

    def write(self, references: References, values: Sequence[float] | np.ndarray) -> None:
        if references.count:
            references.values[:] = values
            size = (references.count,) if self._extra else ()
            self._set(references.array, references.count, references.memory, *size)

    def choose(self, choices: Sequence[tuple[int, int]]) -> None:
        """Set whole numbers (enumerations), before `initialise`."""
        if choices:
            references = (ctypes.c_uint * len(choices))(*(reference for reference, _ in choices))
            kind, name = (ctypes.c_int64, "SetInt64") if self._three else (ctypes.c_int, "SetInteger")
            values = (kind * len(choices))(*(value for _, value in choices))
            size = (len(choices),) if self._extra else ()
            self._bind(name, _P, _S, _P, *((_S,) if self._extra else ()))(references, len(choices), values, *size)

    def initialise(self, time: float, settings: Sequence[tuple[int, float]], inputs: References, u: np.ndarray) -> None:
        """Start at `time` [s] with some variables set, (reference, value), and the first inputs."""
        start = References([reference for reference, _ in settings])
        values = [value for _, value in settings]
        if not self._three:
            self._bind("SetupExperiment", _I, _D, _D, _I, _D)(0, 0.0, time, 0, 0.0)
        self.write(start, values)
        if self._three:
            self._bind("EnterInitializationMode", _B, _D, _D, _B, _D)(False, 0.0, time, False, 0.0)
        else:
            self._bind("EnterInitializationMode")()
        self.write(inputs, u)
        self._bind("ExitInitializationMode")()

    @property
    def alive(self) -> bool:
        """Whether it may still be called: it has not reported a fatal status."""
        return not self._dead

    def close(self) -> None:
        """Terminate and free - unless it reported a fatal status: then nothing of it may be called any more."""
        if self._dead:
            return
        with contextlib.suppress(CallError, FmuError):  # it failed before, and that is what the outcome says
            self._bind("Terminate")()
        if not self._dead:
            self._fmu.freeInstance()

    # Model Exchange

    def move(self, time: float, x: Any, states: int) -> None:
        self._set_time(time)
        self._set_states(x, states)

    def derivatives(self, into: Any, states: int) -> None:
        self._derivatives(into, states)

    def indicators(self, into: Any, count: int) -> None:
        self._indicators(into, count)

    def states(self, into: Any, count: int) -> None:
        self._bind("GetContinuousStates", _P, _S)(into, count)

    def nominals(self, into: Any, count: int) -> None:
        self._bind("GetNominalsOfContinuousStates", _P, _S)(into, count)

    def jacobian(self, unknowns: Sequence[int], knowns: Sequence[int]) -> np.ndarray:
        """(unknowns, knowns), a column a call: the derivative in the direction of each known."""
        rows, found = References(unknowns), np.empty((len(unknowns), len(knowns)))
        extra = (_P, _S, _P, _S) if self._three else (_P, _P)
        call = self._bind("GetDirectionalDerivative", _P, _S, _P, _S, *extra)
        for column, known in enumerate(knowns):
            given = References([known])
            given.values[:] = 1.0
            memory = (given.memory, 1, rows.memory, rows.count) if self._three else (given.memory, rows.memory)
            call(rows.array, rows.count, given.array, 1, *memory)
            found[:, column] = rows.values
        return found

    def enter_event_mode(self) -> None:
        self._bind("EnterEventMode")()

    def settle(self) -> tuple[bool, float]:
        """Iterate events until the FMU is content, then go back to continuous time: (whether states changed, time of its next event)."""
        changed = False
        for _ in range(EVENT_ROUNDS):
            again, ends, states_changed, has_next, following = self._update()
            changed = changed or states_changed
            if ends:
                raise FmuError(self.ends_sentence)
            if not again:
                self._bind("EnterContinuousTimeMode")()
                return changed, following if has_next else math.inf
        raise FmuError(self.unsettled_sentence)

    def _update(self) -> tuple[bool, bool, bool, bool, float]:
        """One round of event iteration: again, ends, states changed, has a next event, its time."""
        if self._three:
            flags, following = (_B * 5)(), _D()
            places = [ctypes.byref(flags, place) for place in range(5)]
            self._bind("UpdateDiscreteStates", *[_P] * 6)(*places, ctypes.byref(following))
            again, ends, _, states_changed, has_next = map(bool, flags)
            return again, ends, states_changed, has_next, following.value
        info = _EventInfo()
        self._bind("NewDiscreteStates", _P)(ctypes.byref(info))
        return bool(info.needs_update), bool(info.ends), bool(info.states_changed), bool(info.has_next), info.next

    @property
    def ends_sentence(self) -> str:
        return f"FMU {self._fmu.modelIdentifier}: it asked for the end of the simulation."

    @property
    def unsettled_sentence(self) -> str:
        return f"FMU {self._fmu.modelIdentifier}: its event iteration did not end after {EVENT_ROUNDS} rounds."

    def early_sentence(self, reached: float) -> str:
        return f"FMU {self._fmu.modelIdentifier}: it returned early at {reached:g} s, which was not allowed."

    def step_completed(self) -> bool:
        """Whether it wants an event now."""
        kind = _B if self._three else _I
        wants, ends = kind(), kind()
        self._bind("CompletedIntegratorStep", kind, _P, _P)(1, ctypes.byref(wants), ctypes.byref(ends))
        return bool(wants.value)

    # Co-Simulation

    def save(self, place: Any) -> None:
        """Keep the whole state in `place`, a ctypes.c_void_p; used again, it takes no new memory. Free it by `forget`."""
        self._bind("GetFMUState" if self._three else "GetFMUstate", _P)(ctypes.byref(place))

    def restore(self, place: Any) -> None:
        self._bind("SetFMUState" if self._three else "SetFMUstate", _P)(place)

    def forget(self, place: Any) -> None:
        self._bind("FreeFMUState" if self._three else "FreeFMUstate", _P)(ctypes.byref(place))

    def input_slopes(self, references: References, slopes: np.ndarray) -> None:
        """Per second (FMI 2.0 only)."""
        orders = (ctypes.c_int * references.count)(*([1] * references.count))
        self._bind("SetRealInputDerivatives", _P, _S, _P, _P)(references.array, references.count, orders, (_D * references.count)(*slopes))

    def do_step(self, time: float, step: float) -> None:
        """One communication step [s]. Raises CallError if it does not reach its end."""
        if not self._three:
            self._do_step(time, step, 1)
            return
        needs_event, ends, early = self._flags
        byref = ctypes.byref
        self._do_step(time, step, True, byref(needs_event), byref(ends), byref(early), byref(self._reached))
        if early.value:
            raise FmuError(self.early_sentence(self._reached.value))


def load_instance(package: Package, exchange: bool) -> Instance:
    """An instance of an unpacked FMU. Raises FmuError."""
    from fmpy.fmi2 import FMU2Model, FMU2Slave
    from fmpy.fmi3 import FMU3Model, FMU3Slave

    description = package.description
    is_three = package.is_three
    kind = (FMU3Model if exchange else FMU3Slave) if is_three else (FMU2Model if exchange else FMU2Slave)
    interface = description.modelExchange if exchange else description.coSimulation
    identifier = interface.modelIdentifier
    try:
        # FMPy goes to the library's folder to load it, and stays there if that fails - in a folder that is about to be removed.
        with contextlib.chdir(os.getcwd()):
            fmu: Any = kind(
                guid=description.guid,
                modelIdentifier=identifier,
                unzipDirectory=str(package.folder),
                instanceName=f"replay_{identifier}",
            )
        fmu.instantiate()
    except Exception as error:  # FMPy raises a bare Exception where a binary is missing or does not load
        raise FmuError(f"FMU {package.path}: it cannot be loaded on this machine ({error}).") from error
    return Instance(fmu, is_three, exchange)
