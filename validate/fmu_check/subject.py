"""The FMU under check: its description, what follows from it for all checks - variables, times, inputs, what may be varied -, and an instance of it.

A Subject loads nothing of the FMU's code, a CheckedInstance does.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from validate.fmi.archive import DESCRIPTION, interfaces
from validate.fmi.description import REAL, interface_of
from validate.fmi.instance import Instance, References

_FLOATS = ("Real", "Float64", "Float32")
_WHOLE = ("Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Enumeration")
# Communication steps of a run that is repeated often; of one that is to meet the model's events, at most.
STEPS = {"CS": 100, "ME": 40}
LONG_STEPS = 500
# A run of a slow FMU is shortened to about this [s], but not below FEWEST_STEPS.
RUN_SECONDS, FEWEST_STEPS = 2.0, 8
# Values of one run that are compared, at most, but for those FEWEST_STEPS.
_MOST_VALUES = 4_000_000
# Steps for which the inputs stay as they are.
HOLD = 10
# Inputs move about their starts by this share of their range, or of their size if they have no range.
RANGE_SHARE, SIZE_SHARE = 0.3, 0.1
# Tolerance of an FMU that proposes none (the value FMI's own examples use).
DEFAULT_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class FmuVariable:
    """A variable of the FMU that has a number: `size` entries, start as numbers (or None)."""

    name: str
    reference: int
    type: str
    causality: str
    variability: str
    initial: str | None
    size: int
    start: np.ndarray | None
    lower: float
    upper: float
    nominal: float | None
    unit: str | None

    @property
    def is_float(self) -> bool:
        """Whether it is a floating-point number."""
        return self.type in _FLOATS

    @property
    def scale(self) -> float:
        """Typical magnitude: the nominal, else that of the start, else 1."""
        if self.nominal:
            return abs(self.nominal)
        size = float(np.max(np.abs(self.start))) if self.start is not None and self.start.size else 0.0
        return size if size > 0.0 and math.isfinite(size) else 1.0

    def near(self, value: np.ndarray, share: float) -> np.ndarray:
        """Another value: `share` of the size away, on the side that the range allows; the same where it allows none.

        Parameters
        ----------
        value : (size,) [unit of the variable].
        share : of its size [-].

        Returns
        -------
        (size,) [unit of the variable]. Raises nothing.
        """
        away = share * np.where(value == 0.0, self.scale, np.abs(value))
        above, below = value + away, value - away
        return np.where(above <= self.upper, above, np.where(below >= self.lower, below, value))


@dataclass(eq=False)
class Subject:
    """An unpacked FMU.

    `description` is FMPy's; `pace`: the seconds of one step of each type, once known; `ends`: the time [s] that a run of each type cannot reach, as
    the FMU ended it before.
    """

    path: Path
    folder: Path
    description: Any
    pace: dict[str, float] = field(default_factory=dict)
    ends: dict[str, float] = field(default_factory=dict)

    @property
    def major(self) -> int:
        """Major version of FMI."""
        return int(self.description.fmiVersion.split(".")[0])

    @property
    def types(self) -> tuple[str, ...]:
        """Types of FMI that the description offers, of "ME" and "CS"."""
        offered = {"ME": self.description.modelExchange, "CS": self.description.coSimulation}
        return tuple(name for name, interface in offered.items() if interface is not None)

    def interface(self, kind: str) -> Any:
        """FMPy's description of a type."""
        return interface_of(self.description, kind)

    def can(self, kind: str, ability: str) -> bool:
        """Whether the description claims an ability, by its name in this version of FMI (FMPy does not read all of them)."""
        return self._interfaces.get({"ME": "ModelExchange", "CS": "CoSimulation", "SE": "ScheduledExecution"}[kind], {}).get(ability) in (
            "true",
            "1",
        )

    @cached_property
    def _interfaces(self) -> dict[str, dict[str, str]]:
        return interfaces((self.folder / DESCRIPTION).read_bytes())

    @cached_property
    def variables(self) -> tuple[FmuVariable, ...]:
        """All variables that have numbers, in the order of the description (aliases included)."""
        made = (_variable(item) for item in self.description.modelVariables)
        return tuple(item for item in made if item is not None)

    @cached_property
    def by_name(self) -> dict[str, FmuVariable]:
        """Variables by their names."""
        return {variable.name: variable for variable in self.variables}

    def prepare(self) -> None:
        """Find out, once for all forks, what follows from the description. Raises ValueError, KeyError for one that contradicts itself."""
        gc.disable()
        try:
            for name in ("_interfaces", "by_name", "states", "derivatives", "outputs", "observed", "continuous_inputs", "parameters"):
                getattr(self, name)
        finally:
            gc.enable()
        gc.freeze()

    def of(self, unknowns: list[Any]) -> list[FmuVariable]:
        """The variables of a section of the ModelStructure, those without numbers left out."""
        return [self.by_name[item.variable.name] for item in unknowns if item.variable.name in self.by_name]

    @cached_property
    def states(self) -> list[FmuVariable]:
        """Of which the derivatives are listed, in that order."""
        names = [item.variable.derivative.name for item in self.description.derivatives if item.variable.derivative is not None]
        return [self.by_name[name] for name in names if name in self.by_name]

    @cached_property
    def derivatives(self) -> list[FmuVariable]:
        """Derivatives of the states, as the ModelStructure lists them."""
        return self.of(self.description.derivatives)

    @cached_property
    def outputs(self) -> list[FmuVariable]:
        """Outputs, as the ModelStructure lists them."""
        return self.of(self.description.outputs)

    @cached_property
    def observed(self) -> list[FmuVariable]:
        """One variable a value reference and type: what runs are compared by."""
        return list({(item.reference, item.type): item for item in reversed(self.variables)}.values())[::-1]

    @cached_property
    def continuous_inputs(self) -> list[FmuVariable]:
        """Continuous floating-point inputs."""
        return [item for item in self.variables if item.causality == "input" and item.is_float and item.variability == "continuous"]

    @cached_property
    def parameters(self) -> list[FmuVariable]:
        """Floating-point parameters that may be set before a run."""
        return [item for item in self.variables if item.causality == "parameter" and item.is_float and item.variability != "constant"]

    @cached_property
    def start_time(self) -> float:
        """Start of the FMU's experiment [s]; 0 without one."""
        return self._experiment("startTime", 0.0)

    @cached_property
    def step(self) -> float:
        """The communication step [s]: the FMU's own, else a 500th of its experiment, else 10 ms."""
        stop = self._experiment("stopTime", math.nan)
        length = stop - self.start_time
        fallback = length / 500.0 if length > 0.0 else 1e-2
        return self._experiment("stepSize", self.internal_step or fallback)

    @property
    def internal_step(self) -> float:
        """The step [s] that Co-Simulation makes inside, as FMI 3.0 declares it; 0 where it does not."""
        fixed = getattr(self.description.coSimulation, "fixedInternalStepSize", None)
        return float(fixed) if fixed else 0.0

    @cached_property
    def tolerance(self) -> float:
        """Relative tolerance of the FMU's experiment [-]."""
        return self._experiment("tolerance", DEFAULT_TOLERANCE)

    def _experiment(self, name: str, fallback: float) -> float:
        """A number of the default experiment, or what stands for it."""
        text = getattr(self.description.defaultExperiment, name, None)
        try:
            value = float(text) if text is not None else fallback
        except ValueError:
            return fallback
        return value if math.isfinite(value) and (value > 0.0 or name == "startTime") else fallback

    def steps(self, kind: str) -> int:
        """Communication steps of a run of this type."""
        return self._affordable(kind, STEPS[kind])

    def long_steps(self, kind: str) -> int:
        """Communication steps of a run through the FMU's experiment."""
        length = self._experiment("stopTime", math.nan) - self.start_time
        return self._affordable(kind, min(LONG_STEPS, max(STEPS["CS"], round(length / self.step))) if length > 0.0 else STEPS["CS"])

    def _affordable(self, kind: str, steps: int) -> int:
        pace = self.pace.get(kind, 0.0)
        steps = min(steps, max(FEWEST_STEPS, _MOST_VALUES // max(len(self.observed), 1)))
        return self.before_end(kind, steps if pace <= 0.0 else int(np.clip(RUN_SECONDS / pace, min(FEWEST_STEPS, steps), steps)))

    def before_end(self, kind: str, steps: int) -> int:
        """So many steps, or as many as the FMU makes before it ends the simulation itself."""
        left = math.ceil((self.ends.get(kind, math.inf) - self.start_time) / self.step - 1e-9) - 1 if kind in self.ends else steps
        return max(0, min(steps, left))

    def time(self, step: int) -> float:
        """Time of a communication point [s]."""
        return self.start_time + step * self.step

    def inputs_at(self, step: int, seed: int = 0) -> np.ndarray:
        """Values of the continuous inputs from this step on; they change every HOLD steps. Another seed, another signal.

        Returns
        -------
        (nu,) [unit of each input]. Raises nothing.
        """
        values = []
        for place, item in enumerate(self.continuous_inputs):
            start = item.start if item.start is not None else np.zeros(item.size)
            bounded = math.isfinite(item.lower) and math.isfinite(item.upper)
            size = RANGE_SHARE * (item.upper - item.lower) if bounded else SIZE_SHARE * item.scale
            dice = np.random.default_rng([seed, place, step // HOLD])
            values.append(np.clip(start + size * dice.uniform(-1.0, 1.0, start.shape), item.lower, item.upper))
        return np.concatenate(values) if values else np.empty(0)

    def varied_parameters(self, share: float = 0.01) -> dict[FmuVariable, np.ndarray]:
        """Other values of the parameters, (size,) each [unit of the parameter], `share` [-] of their size off their starts. Raises nothing."""
        return {item: item.near(item.start, share) for item in self.parameters if item.start is not None}


def _variable(item: Any) -> FmuVariable | None:
    """Ours for FMPy's; None if it has no number."""
    if item.type not in (*_FLOATS, *_WHOLE, "Boolean"):
        return None
    sources = (item,) if item.declaredType is None else (item, item.declaredType)

    def number(name: str) -> float | None:
        for source in sources:
            text = getattr(source, name, None)
            if text is not None:
                return _number(text)
        return None

    start = None
    if item.start is not None:
        try:
            start = np.array([_number(word) for word in str(item.start).split()])
        except ValueError:
            start = None
    size = int(np.prod(item.shape)) if item.shape else 1
    if start is not None and start.size == 1:
        start = np.full(size, start[0])
    lower, upper = number("min"), number("max")
    return FmuVariable(
        name=item.name,
        reference=int(item.valueReference),
        type=item.type,
        causality=item.causality,
        variability=item.variability,
        initial=item.initial,
        size=size,
        start=start if start is not None and start.size == size else None,
        lower=-math.inf if lower is None else lower,
        upper=math.inf if upper is None else upper,
        nominal=number("nominal"),
        unit=item.unit or getattr(item.declaredType, "unit", None),
    )


def _number(text: Any) -> float:
    words = {"true": 1.0, "false": 0.0}
    return words[str(text)] if str(text) in words else float(text)


class CheckedInstance(Instance):
    """One instance of `subject` of type "ME" or "CS", which knows the FMU's variables. After a failure it is left as it is: the process ends soon."""

    def __init__(self, subject: Subject, kind: str, name: str = "check", options: Mapping[str, Any] | None = None) -> None:
        """options: more arguments of FMPy's instantiate(). Raises Fault if the binary cannot be loaded or refuses."""
        self.subject = subject
        self._doubles: Any = None  # how all values are read at once
        self._entries = 0
        self.tolerance: float | None = None  # for the FMU's own integrator; None: what it likes
        super().__init__(subject.description, subject.folder, kind, name, options)
        self.time = subject.start_time

    def __enter__(self) -> CheckedInstance:
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        if kind is None:
            self.close()

    def setup(self, stop: float | None = None) -> None:
        """Before values are set."""
        self.fmu.setup(self.subject.start_time, stop, self.tolerance)

    def enter_initialisation(self, stop: float | None = None) -> None:
        """Into Initialization Mode; stop: the stop time [s]."""
        self.fmu.enter(self.subject.start_time, stop, self.tolerance)

    def begin(
        self,
        before: Mapping[FmuVariable, np.ndarray] | None = None,
        during: Mapping[FmuVariable, np.ndarray] | None = None,
        stop: float | None = None,
    ) -> CheckedInstance:
        """Through initialisation, and to Continuous-Time Mode or the first step.

        Parameters
        ----------
        before, during : values (size,) [unit of the variable] of variables set before and in initialisation.
        stop : stop time [s].

        Raises
        ------
        FMICallException, Fault : if the FMU refuses a call, does not settle, or ends.
        """
        self.time = self.subject.start_time
        self.setup(stop)
        self.set_all(before or {})
        self.enter_initialisation(stop)
        self.set_all(during or {})
        return self.finish_initialisation()

    def finish_initialisation(self) -> CheckedInstance:
        """Out of Initialization Mode, and with Model Exchange to Continuous-Time Mode."""
        self.fmu.exitInitializationMode()
        self.next_event = math.inf
        if self.kind == "ME":
            self.settle()
        return self

    def get(self, variables: Sequence[FmuVariable]) -> np.ndarray:
        """Values of variables in the order given; one call a type.

        Returns
        -------
        (entries,) [unit of each variable], all entries of the first variable, then of the second.

        Raises
        ------
        FMICallException : if the FMU refuses a call.
        """
        if not variables:
            return np.empty(0)
        kinds = dict.fromkeys([item.type for item in variables])
        if len(kinds) == 1:
            references, size = [item.reference for item in variables], sum([item.size for item in variables])
            return np.array(self.fmu.read(variables[0].type, references, size), dtype=float)
        places = np.cumsum([0, *(item.size for item in variables)])
        values = np.empty(places[-1])
        for kind in kinds:
            chosen = [index for index, item in enumerate(variables) if item.type == kind]
            sizes = [variables[index].size for index in chosen]
            read = self.fmu.read(kind, [variables[index].reference for index in chosen], sum(sizes))
            at = 0
            for index, size in zip(chosen, sizes, strict=True):
                values[places[index] : places[index] + size] = read[at : at + size]
                at += size
        return values

    def set(self, variables: Sequence[FmuVariable], values: np.ndarray) -> None:
        """Set variables; one call a type.

        Parameters
        ----------
        variables : in any order.
        values : (entries,) [unit of each variable], all entries of the first variable, then of the second.

        Raises
        ------
        FMICallException : if the FMU refuses a call.
        """
        at = 0
        groups: dict[str, tuple[list[int], list[float]]] = {}
        for item in variables:
            references, numbers = groups.setdefault(item.type, ([], []))
            references.append(item.reference)
            numbers.extend(float(value) for value in values[at : at + item.size])
            at += item.size
        for kind, (references, numbers) in groups.items():
            self.fmu.write(kind, references, numbers)

    def set_all(self, values: Mapping[FmuVariable, np.ndarray]) -> None:
        """Set variables to values (size,) each [unit of the variable]. Raises FMICallException."""
        if values:
            self.set(list(values), np.concatenate(list(values.values())))

    def observe(self) -> np.ndarray:
        """Values (entries,) [unit of each variable] of all that runs are compared by. Raises FMICallException."""
        if self._doubles is None:
            observed, sizes = self.subject.observed, [item.size for item in self.subject.observed]
            first = np.cumsum([0, *sizes])
            chosen = [place for place, item in enumerate(observed) if item.type in REAL and item.size == 1]
            rest = [place for place, item in enumerate(observed) if item.type not in REAL or item.size != 1]
            places = np.concatenate([np.arange(first[place], first[place + 1]) for place in rest]) if rest else np.empty(0, dtype=int)
            self._doubles = (
                References([observed[place].reference for place in chosen]),
                first[chosen],
                [observed[place] for place in rest],
                places,
            )
            self._entries = int(first[-1])
        doubles, where, others, places = self._doubles
        values = np.empty(self._entries)
        values[where] = self.read(doubles)
        values[places] = self.get(others)
        return values

    def directional(self, unknowns: Sequence[FmuVariable], known: FmuVariable, seed: Sequence[float]) -> np.ndarray:
        """Directional derivatives of unknowns by one known.

        Parameters
        ----------
        seed : (entries of the known,) the direction [unit of the known].

        Returns
        -------
        (entries,) of the unknowns [unit of each unknown].

        Raises
        ------
        FMICallException : if the FMU refuses the call.
        """
        return np.array(self.fmu.directional(_references(unknowns), [known.reference], seed, sum(item.size for item in unknowns)))

    def adjoint(self, unknowns: Sequence[FmuVariable], knowns: Sequence[FmuVariable], seed: Sequence[float]) -> np.ndarray:
        """Adjoint derivatives of FMI 3.0 by all knowns.

        Parameters
        ----------
        seed : (entries of the unknowns,) the weights [-].

        Returns
        -------
        (entries,) of the knowns [unit of the unknown per unit of the known].

        Raises
        ------
        FMICallException : if the FMU refuses the call.
        """
        return np.array(self.fmu.adjoint(_references(unknowns), _references(knowns), seed, sum(item.size for item in knowns)))


def entry_names(variables: Sequence[FmuVariable]) -> list[str]:
    """The name of each entry of some variables, as `CheckedInstance.get` orders them."""
    return [item.name for item in variables for _ in range(item.size)]


def entry_scales(variables: Sequence[FmuVariable]) -> np.ndarray:
    """Typical magnitude of each entry of some variables, (entries,) [unit of each]. Raises ValueError for no variables."""
    return np.concatenate([np.full(item.size, item.scale) for item in variables])


def _references(variables: Sequence[FmuVariable]) -> list[int]:
    return [item.reference for item in variables]
