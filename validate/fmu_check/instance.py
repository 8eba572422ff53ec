"""One instance of an FMU, the same for FMI 2.0 and 3.0, Model Exchange and Co-Simulation, on FMPy's low-level classes.

Every FMI call that returns more than a warning raises FMPy's FMICallException; `said` keeps what the FMU logged.

What keeps a check from going on: the FMU's fault, this machine's, or the FMU's right to end a simulation.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from validate.fmu_check.subject import Subject, Variable


class Misbehaviour(Exception):  # noqa: N818 - a finding about the FMU, not an error of ours
    """The FMU did something that leaves the check nothing to do but to fail, with this sentence."""


class Lacking(Exception):  # noqa: N818 - says what this machine does not have
    """The FMU's code needs something of the machine that is not there."""


class Ended(Exception):  # noqa: N818 - what a sound FMU may do
    """The FMU asked for the end of the simulation: a run cannot reach `time` [s]. It is run again, and shorter."""

    def __init__(self, time: float) -> None:
        super().__init__(f"it asked to end the simulation at t = {time:.6g} s")
        self.time = time


# Rounds of one event iteration before it is called endless.
_EVENT_ROUNDS = 100


@dataclass(frozen=True)
class EventInfo:
    """What an event update said: whether states changed, when the next time event is (inf: none)."""

    states_changed: bool
    next_time: float


class Instance:
    """One instance of `subject` of type "ME" or "CS"; made and, with close(), freed. Subclasses: FMI 2.0 and 3.0."""

    prefix: str

    def __init__(self, subject: Subject, kind: str, name: str = "check", options: Mapping[str, Any] | None = None) -> None:
        """options: more arguments of FMPy's instantiate()."""
        self.subject, self.kind, self.options = subject, kind, dict(options or {})
        self.said: deque[str] = deque(maxlen=4)
        self.stop: float | None = None
        self.tolerance: float | None = None  # for the FMU's own integrator; None: what it likes
        self.time = subject.start_time  # in Model Exchange where it was brought to
        identifier = subject.interface(kind).modelIdentifier
        try:
            with contextlib.chdir(os.getcwd()):  # FMPy goes to the library's folder, and stays there if that fails
                self.fmu: Any = self._class()(
                    guid=subject.description.guid, modelIdentifier=identifier, unzipDirectory=str(subject.folder), instanceName=name
                )
        except AttributeError as error:
            raise Misbehaviour(f"a function of FMI is missing in the binary ({error})") from error
        except Exception as error:  # FMPy raises a bare Exception where a binary is missing or does not load
            absent = re.search(r"(\S+): cannot open shared object file", str(error))
            if absent and not list(subject.folder.rglob(absent[1])):
                raise Lacking(f"its binary needs {absent[1]}, which neither the FMU carries nor this machine has; install it") from error
            raise Misbehaviour(f"the binary cannot be loaded ({error})") from error
        self.make()

    # What the versions do differently

    def _class(self) -> type:
        raise NotImplementedError

    def make(self) -> None:
        """Prepare callbacks and instantiate."""
        raise NotImplementedError

    def again(self) -> None:
        """Instantiate once more, after free()."""
        raise NotImplementedError

    def setup(self, start: float, stop: float | None) -> None:
        raise NotImplementedError

    def enter_initialisation(self, start: float, stop: float | None) -> None:
        raise NotImplementedError

    def _update(self) -> tuple[bool, bool, bool, bool, bool, float]:
        raise NotImplementedError

    def read_group(self, kind: str, references: Sequence[int], size: int) -> Sequence[float]:
        raise NotImplementedError

    def write_group(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        raise NotImplementedError

    def do_step(self, time: float, step: float) -> float | None:
        """One communication step; the time it says it reached, None if it does not say. Raises Ended if it wants to end."""
        raise NotImplementedError

    def last_successful_time(self) -> float | None:
        """What Co-Simulation tells after a step that was discarded; None if it does not tell."""
        return None

    def directional(self, unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float]) -> np.ndarray:
        raise NotImplementedError

    def adjoint(self, unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float]) -> np.ndarray:
        raise NotImplementedError

    def no_instance(self, what: str) -> Exception:
        """What to raise where `what` gave no instance."""
        if self.subject.can(self.kind, "needsExecutionTool"):
            return Lacking(f"{what}; it needs the tool that made it (needsExecutionTool is true), and what that needs{self.quote()}")
        return Misbehaviour(f"{what}{self.quote()}")

    # Life

    def free(self) -> None:
        if self.fmu.component:
            self._free_component()
            self.fmu.component = None

    def _free_component(self) -> None:
        getattr(self.fmu, f"{self.prefix}FreeInstance")(self.fmu.component)

    def close(self) -> None:
        """Terminate and free, whatever happened before."""
        from fmpy.fmi1 import FMICallException

        if self.fmu.component:
            with contextlib.suppress(FMICallException):
                self.fmu.terminate()
        self.free()

    def __enter__(self) -> Instance:
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        if kind is None:
            self.close()  # after a failure the instance may be in any state: the process ends soon anyway

    def begin(
        self,
        before: Mapping[Variable, np.ndarray] | None = None,
        during: Mapping[Variable, np.ndarray] | None = None,
        stop: float | None = None,
    ) -> Instance:
        """Through initialisation, and to Continuous-Time Mode or the first step. before, during: values set before and in it."""
        self.stop = stop
        start = self.time = self.subject.start_time
        self.setup(start, stop)
        self.set_all(before or {})
        self.enter_initialisation(start, stop)
        self.set_all(during or {})
        return self.finish_initialisation()

    def finish_initialisation(self) -> Instance:
        self.fmu.exitInitializationMode()
        self.next_event = math.inf
        if self.kind == "ME":
            self.next_event = self.settle().next_time
        return self

    def reset(self) -> None:
        self.fmu.reset()

    # Values

    def get(self, variables: Sequence[Variable]) -> np.ndarray:
        """(sum of sizes,) the values in the order given; one call a type."""
        if not variables:
            return np.empty(0)
        kinds = dict.fromkeys([item.type for item in variables])
        if len(kinds) == 1:
            references, size = [item.reference for item in variables], sum([item.size for item in variables])
            return np.array(self.read_group(variables[0].type, references, size), dtype=float)
        places = np.cumsum([0, *(item.size for item in variables)])
        values = np.empty(places[-1])
        for kind in kinds:
            chosen = [index for index, item in enumerate(variables) if item.type == kind]
            sizes = [variables[index].size for index in chosen]
            read = self.read_group(kind, [variables[index].reference for index in chosen], sum(sizes))
            at = 0
            for index, size in zip(chosen, sizes, strict=True):
                values[places[index] : places[index] + size] = read[at : at + size]
                at += size
        return values

    def set(self, variables: Sequence[Variable], values: np.ndarray) -> None:
        at = 0
        groups: dict[str, tuple[list[int], list[float]]] = {}
        for item in variables:
            references, numbers = groups.setdefault(item.type, ([], []))
            references.append(item.reference)
            numbers.extend(float(value) for value in values[at : at + item.size])
            at += item.size
        for kind, (references, numbers) in groups.items():
            self.write_group(kind, references, numbers)

    def set_all(self, values: Mapping[Variable, np.ndarray]) -> None:
        if values:
            self.set(list(values), np.concatenate(list(values.values())))

    def observe(self) -> np.ndarray:
        return self.get(self.subject.observed)

    # States of the FMU

    def save(self) -> Any:
        return self.fmu.getFMUState()

    def restore(self, saved: Any) -> None:
        self.fmu.setFMUState(saved)

    def forget(self, saved: Any) -> None:
        self.fmu.freeFMUState(saved)

    def serialise(self, saved: Any) -> bytes:
        return self.fmu.serializeFMUState(saved)

    def deserialise(self, data: bytes) -> Any:
        return self.fmu.deserializeFMUState(data)

    # Model Exchange

    def settle(self) -> EventInfo:
        """Event updates until the FMU is content, then Continuous-Time Mode. Raises Misbehaviour if that does not end, Ended if the FMU does."""
        changed = False
        for _ in range(_EVENT_ROUNDS):
            again, terminate, _, states_changed, defined, when = self._update()
            changed = changed or bool(states_changed)
            if terminate:
                raise Ended(self.time)
            if not again:
                self.fmu.enterContinuousTimeMode()
                self.next_event = float(when) if defined else math.inf
                return EventInfo(changed, self.next_event)
        raise Misbehaviour(f"the event iteration did not end after {_EVENT_ROUNDS} rounds")

    def event(self) -> EventInfo:
        self.fmu.enterEventMode()
        return self.settle()

    def _array(self, call: Callable[..., Any], size: int) -> np.ndarray:
        array = (ctypes.c_double * size)(*[math.nan] * size)  # a pointer into a numpy array costs more than all else here
        call(array, size)
        return np.frombuffer(memoryview(array)) if size else np.empty(0)

    @property
    def state_count(self) -> int:
        return int(self.subject.description.numberOfContinuousStates)

    @property
    def indicator_count(self) -> int:
        return int(self.subject.description.numberOfEventIndicators)

    def states(self) -> np.ndarray:
        return self._array(self.fmu.getContinuousStates, self.state_count)

    def nominals(self) -> np.ndarray:
        return self._array(self.fmu.getNominalsOfContinuousStates, self.state_count)

    def rates(self) -> np.ndarray:
        raise NotImplementedError

    def indicators(self) -> np.ndarray:
        return self._array(self.fmu.getEventIndicators, self.indicator_count)

    def move(self, time: float, states: np.ndarray) -> None:
        self.set_time(time)
        if self.state_count:
            self.fmu.setContinuousStates((ctypes.c_double * self.state_count)(*states.tolist()), self.state_count)

    def set_time(self, time: float) -> None:
        self.time = time
        self.fmu.setTime(time)

    def completed(self) -> bool:
        """Tell of an accepted integrator step; whether the FMU wants an event. Raises Ended if it wants to end."""
        event, ends = self.fmu.completedIntegratorStep()
        if ends:
            raise Ended(self.time)
        return bool(event)

    @property
    def wants_steps(self) -> bool:
        interface = self.subject.description.modelExchange
        return bool(interface.needsCompletedIntegratorStep) if self.subject.major >= 3 else not interface.completedIntegratorStepNotNeeded

    def quote(self) -> str:
        """What the FMU logged last, for the end of a sentence."""
        text = " ".join(self.said[-1].split()) if self.said else ""
        return f"; it said: {text[:200]}" if text else ""


def new_instance(subject: Subject, kind: str, name: str = "check", options: Mapping[str, Any] | None = None) -> Instance:
    """An instance of type "ME" or "CS"; options: more arguments of FMPy's instantiate(). Raises Misbehaviour if the binary cannot be loaded or refuses."""
    if subject.major == 2:
        from validate.fmu_check.instance_versions import Instance2

        return Instance2(subject, kind, name, options)
    from validate.fmu_check.instance_versions import Instance3

    return Instance3(subject, kind, name, options)
