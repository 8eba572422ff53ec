"""The FMU under check: its variables, times, inputs and settings, and an instance of it.

    subject = Subject(folder, read_description(folder))
    with CheckedInstance(subject, "CS").begin() as instance:
        instance.make_step(0)
        instance.observe()

A Subject loads no code of the FMU; a CheckedInstance does.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from validate.fmi.archive import DESCRIPTION, INTERFACES, interfaces
from validate.fmi.description import experiment, interface_of, without_garbage
from validate.fmi.instance import CLASSES, Instance, References, RefusedCall

_FLOATS = ("Real", "Float64", "Float32")
_INTEGERS = (
    *("Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
    "Enumeration",
)
# Communication steps of a run that checks repeat: 10 and 4 changes of the inputs.
STEPS = {"CS": 100, "ME": 40}
# Most communication steps of a run through the FMU's experiment.
LONG_STEPS = 500
# A run of a slow FMU is shortened to about this time [s].
RUN_SECONDS = 2.0
# Fewest steps of a shortened run: the check of variability needs three in a row, several times.
FEWEST_STEPS = 8
# Values of one run that are stored and compared: 32 MB.
_MOST_VALUES = 4_000_000
# Steps between changes of the inputs.
HOLD = 10
# Inputs move around their starts by this share of their range ...
RANGE_SHARE = 0.3
# ... or by this share of their size if they have no range.
SIZE_SHARE = 0.1
# Start values and parameters are moved by this share of their size: far above rounding, and small
# enough for a model to remain itself.
MOVED = 0.01
# Variables named in a sentence about several.
_NAMED = 3
# Tolerance of an FMU that declares none: the value in the examples of the FMI standard.
DEFAULT_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class FmuVariable:
    """A variable with a number: `size` entries, and its start as an array or None.

    clocked: FMI 3.0 allows access only while a clock ticks, so the checks leave it out.
    refused: sides of its start, "below" and "above", on which the FMU refuses values.
    """

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
    clocked: bool = False
    refused: frozenset[str] = frozenset()

    @property
    def key(self) -> tuple[int, str]:
        """The value behind the name; aliases share it. FMI 2.0 reads enumerations as integers."""
        return self.reference, "Integer" if self.type == "Enumeration" else self.type

    @property
    def is_float(self) -> bool:
        """Return whether the variable is a floating-point number."""
        return self.type in _FLOATS

    @property
    def is_continuous(self) -> bool:
        """Return whether the variable is a floating-point number that moves between events."""
        return self.is_float and self.variability == "continuous"

    @property
    def scale(self) -> float:
        """Typical magnitude: the nominal, else that of the start, else 1."""
        if self.nominal:
            return abs(self.nominal)
        size = 0.0 if self.start is None else float(np.abs(self.start).max(initial=0.0))
        return size if size > 0.0 and math.isfinite(size) else 1.0


class Block(tuple[FmuVariable, ...]):
    """Variables that are read or written together, with one call per type.

    Their entries: all of the first variable, then all of the second.
    """

    @cached_property
    def sizes(self) -> np.ndarray:
        """(variables,) number of entries of each [-]. Raises nothing."""
        return np.array([item.size for item in self], dtype=int)

    @cached_property
    def ends(self) -> np.ndarray:
        """(variables + 1,) first entry of each variable, then the end [-]. Raises nothing."""
        return np.concatenate([[0], np.cumsum(self.sizes, dtype=int)])

    @property
    def entries(self) -> int:
        """Number of entries of all variables."""
        return int(self.ends[-1])

    @cached_property
    def names(self) -> list[str]:
        """The variable's name of each entry."""
        return [item.name for item in self for _ in range(item.size)]

    @property
    def references(self) -> list[int]:
        """Value references of the variables."""
        return [item.reference for item in self]

    def each(self, of: Callable[[FmuVariable], float]) -> np.ndarray:
        """(entries,) a number of each entry's variable [unit of that]. Raises nothing."""
        return np.repeat(np.array([of(item) for item in self], dtype=float), self.sizes)

    @cached_property
    def scales(self) -> np.ndarray:
        """(entries,) typical magnitudes [unit of each]. Raises nothing."""
        return self.each(lambda item: item.scale)

    @cached_property
    def starts(self) -> np.ndarray:
        """(entries,) starts, NaN without one [unit of each]. Raises nothing."""
        parts = [
            np.full(item.size, math.nan if item.start is None else item.start) for item in self
        ]
        return np.concatenate([np.empty(0), *parts])

    def split(self, values: np.ndarray) -> list[tuple[FmuVariable, np.ndarray]]:
        """Pair each variable with its values of (entries,) [unit of each]. Raises nothing."""
        ends = itertools.pairwise(self.ends)
        return [(item, values[begin:end]) for item, (begin, end) in zip(self, ends, strict=True)]

    def near(self, share: float) -> np.ndarray:
        """Return other values than the starts, on the side that range and FMU allow.

        Parameters
        ----------
        share
            Distance from the start, as a share of its size [-].

        Returns
        -------
        np.ndarray
            (entries,) [unit of each]; the start where neither side is allowed.

        Raises
        ------
        Nothing.
        """
        value, lower, upper = self.starts, *self.limits
        away = share * np.where(value == 0.0, self.scales, np.abs(value))
        above, below = value + away, value - away
        return np.where(above <= upper, above, np.where(below >= lower, below, value))

    @cached_property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return least and largest values (entries,) that range and FMU allow [unit of each].

        Raises nothing.
        """
        starts = np.nan_to_num(self.starts)
        return (
            np.where(self.refuses("below"), starts, self.each(lambda item: item.lower)),
            np.where(self.refuses("above"), starts, self.each(lambda item: item.upper)),
        )

    def refuses(self, side: str) -> np.ndarray:
        """(entries,) whether the FMU refuses values on this side of the start. Raises nothing."""
        return self.each(lambda item: side in item.refused) > 0.0

    def parts(self, fmu: Any) -> list[tuple[References, Any]]:
        """Return the references of each type, with memory, and the places of their entries.

        fmu: an object or class of `validate.fmi.instance`.
        """
        if self._parts is None:
            self._parts = []
            kinds = np.array([item.type for item in self], dtype=object)
            for kind in dict.fromkeys(kinds):
                chosen = kinds == kind
                numbers = [item.reference for item in self if item.type == kind]
                references = fmu.references(kind, numbers, int(self.sizes[chosen].sum()))
                places = slice(None) if chosen.all() else np.repeat(chosen, self.sizes)
                self._parts.append((references, places))
        return self._parts

    _parts: list[tuple[References, Any]] | None = None


def one_each(variables: Iterable[FmuVariable]) -> Block:
    """Keep the first name of each value."""
    first: dict[tuple[int, str], FmuVariable] = {}
    for item in variables:
        first.setdefault(item.key, item)
    return Block(first.values())


# Variables, and (entries,) a value for each [unit of each].
Settings = tuple[Block, np.ndarray]
NOTHING: Settings = (Block(), np.empty(0))


@dataclass(frozen=True)
class Avoided:
    """Values that the FMU refuses, so that no check sets them.

    - below, above: names of variables that stay on the other side of their starts.
    - unset: names of variables that are never set.
    - held, unvaried: inputs, and parameters, stay at their starts.
    """

    below: list[str] = field(default_factory=list)
    above: list[str] = field(default_factory=list)
    unset: list[str] = field(default_factory=list)
    held: bool = False
    unvaried: bool = False


@dataclass(eq=False)
class Subject:
    """An unpacked FMU.

    description: FMPy's.
    pace: seconds of one step of each type, once measured.
    ends: time [s] of each type at which the FMU ended a run.
    """

    folder: Path
    description: Any
    pace: dict[str, float] = field(default_factory=dict)
    ends: dict[str, float] = field(default_factory=dict)
    avoided: Avoided = field(default_factory=Avoided)

    @property
    def major(self) -> int:
        """Major version of FMI."""
        return int(self.description.fmiVersion.split(".")[0])

    @property
    def types(self) -> tuple[str, ...]:
        """The types of FMI that the description offers, of "ME" and "CS"."""
        return tuple(kind for kind in ("ME", "CS") if self.interface(kind) is not None)

    def interface(self, kind: str) -> Any:
        """Return FMPy's description of a type."""
        return interface_of(self.description, kind)

    def can(self, kind: str, ability: str) -> bool:
        """Return whether a type claims an ability, by its name in this version of FMI."""
        return self._interfaces.get(INTERFACES[kind], {}).get(ability) in ("true", "1")

    @cached_property
    def _interfaces(self) -> dict[str, dict[str, str]]:
        return interfaces((self.folder / DESCRIPTION).read_bytes())

    @cached_property
    def variables(self) -> tuple[FmuVariable, ...]:
        """All variables with numbers, aliases included, in the order of the description."""
        found = filter(None, map(_variable, self.description.modelVariables))
        sides = {side: set(getattr(self.avoided, side)) for side in ("below", "above")}
        if not any(sides.values()):
            return tuple(found)
        return tuple(
            replace(item, refused=frozenset(side for side in sides if item.name in sides[side]))
            for item in found
        )

    @cached_property
    def values(self) -> Block:
        """One variable per value, in the order of the description."""
        return one_each(self.variables)

    @cached_property
    def by_name(self) -> dict[str, FmuVariable]:
        """Variables by their names."""
        return {variable.name: variable for variable in self.variables}

    def prepare(self) -> None:
        """Compute once, for all forks, what follows from the description.

        Raises ValueError, KeyError for a description that contradicts itself.
        """
        with without_garbage():
            for block in (self.observed, self.exact, self.varied[0]):
                block.parts(CLASSES[self.major, "CS"])
            for name in ("_interfaces", "states", "derivatives", "outputs", "continuous_inputs"):
                getattr(self, name)
        gc.freeze()

    def avoiding(self, **changes: Any) -> Subject:
        """Return the same FMU with other values avoided: fields of `Avoided`."""
        return replace(self, avoided=Avoided(**{**asdict(self.avoided), **changes}))

    def observing(self, block: Block) -> Subject:
        """Return the same FMU with fewer observed values."""
        other = copy(self)
        other.observed = block
        return other

    def of(self, unknowns: list[Any]) -> Block:
        """Return the variables with numbers of a section of the ModelStructure."""
        names = (item.variable.name for item in unknowns)
        return Block(self.by_name[name] for name in names if name in self.by_name)

    @cached_property
    def states(self) -> Block:
        """Continuous states, in the order in which their derivatives are listed."""
        derivatives = (item.variable.derivative for item in self.description.derivatives)
        names = (item.name for item in derivatives if item is not None)
        return Block(self.by_name[name] for name in names if name in self.by_name)

    @cached_property
    def derivatives(self) -> Block:
        """Derivatives of the states, as the ModelStructure lists them."""
        return self.of(self.description.derivatives)

    @cached_property
    def rates(self) -> list[tuple[FmuVariable, FmuVariable]]:
        """Variables that are derivatives, each with its state; one name per derivative."""
        pairs: dict[tuple[int, str], tuple[FmuVariable, FmuVariable]] = {}
        for item in self.description.modelVariables:
            rate = self.by_name.get(item.name)
            state = self.by_name.get(getattr(item.derivative, "name", ""))
            if rate is not None and state is not None:
                pairs.setdefault(rate.key, (rate, state))
        return list(pairs.values())

    @cached_property
    def outputs(self) -> Block:
        """Outputs, as the ModelStructure lists them, without clocked ones."""
        return one_each(item for item in self.of(self.description.outputs) if not item.clocked)

    @cached_property
    def observed(self) -> Block:
        """The values by which runs are compared: all but clocked ones."""
        return Block(item for item in self.values if not item.clocked)

    @cached_property
    def continuous_inputs(self) -> Block:
        """Continuous floating-point inputs."""
        return self._settable(lambda item: item.causality == "input" and item.is_continuous)

    @cached_property
    def clocks(self) -> Block:
        """Variables that contain the time."""
        return one_each(
            item for item in self.variables if item.causality == "independent" and item.is_float
        )

    @cached_property
    def exact(self) -> Block:
        """Variables whose start is their value in Initialization Mode."""
        return self._settable(
            lambda item: (
                item.start is not None and (item.initial == "exact" or item.causality == "input")
            )
        )

    @cached_property
    def varied(self) -> Settings:
        """Return changed values of floating-point parameters that may be set before a run."""
        if self.avoided.unvaried:
            return NOTHING
        parameters = self._settable(
            lambda item: (
                item.causality == "parameter"
                and item.is_float
                and item.variability != "constant"
                and item.start is not None
            )
        )
        return parameters, parameters.near(MOVED)

    def _settable(self, is_wanted: Callable[[FmuVariable], bool]) -> Block:
        """Return one variable per value of those that are wanted and that the FMU lets be set."""
        unset = set(self.avoided.unset)
        return one_each(
            item for item in self.variables if is_wanted(item) and item.name not in unset
        )

    @cached_property
    def start_time(self) -> float:
        """Start of the FMU's experiment [s]; 0 without one."""
        return experiment(self.description, "startTime") or 0.0

    @property
    def length(self) -> float:
        """Length of the FMU's experiment [s]; 0 without one."""
        stop = experiment(self.description, "stopTime")
        return 0.0 if stop is None else max(0.0, stop - self.start_time)

    @cached_property
    def step(self) -> float:
        """Communication step [s]: the FMU's own, else a 500th of its experiment, else 10 ms."""
        declared = experiment(self.description, "stepSize") or self.internal_step
        return declared or self.length / LONG_STEPS or 1e-2

    @property
    def internal_step(self) -> float:
        """Internal step [s] of Co-Simulation, as FMI 3.0 declares it; 0 without one."""
        return float(getattr(self.description.coSimulation, "fixedInternalStepSize", None) or 0.0)

    @cached_property
    def tolerance(self) -> float:
        """Relative tolerance of the FMU's experiment [-]."""
        return experiment(self.description, "tolerance") or DEFAULT_TOLERANCE

    def steps(self, kind: str) -> int:
        """Return the number of communication steps of a run of this type."""
        return self._affordable(kind, STEPS[kind])

    def long_steps(self, kind: str) -> int:
        """Return the number of communication steps of a run through the FMU's experiment."""
        through = min(LONG_STEPS, round(self.length / self.step))
        return self._affordable(kind, max(STEPS["CS"], through))

    def _affordable(self, kind: str, steps: int) -> int:
        """Limit a number of steps by memory, by the pace, and by where the FMU ends a run."""
        steps = min(steps, max(FEWEST_STEPS, _MOST_VALUES // max(len(self.observed), 1)))
        if pace := self.pace.get(kind, 0.0):
            steps = min(steps, max(FEWEST_STEPS, int(RUN_SECONDS / pace)))
        return self.before_end(kind, steps)

    def before_end(self, kind: str, steps: int) -> int:
        """Limit a number of steps to those that the FMU makes before it ends a run."""
        if kind not in self.ends:
            return steps
        left = math.ceil((self.ends[kind] - self.start_time) / self.step - 1e-9) - 1
        return max(0, min(steps, left))

    def time(self, step: int) -> float:
        """Return the time of a communication point [s]."""
        return self.start_time + step * self.step

    def inputs_at(self, step: int, seed: int = 0) -> np.ndarray:
        """Return values of the continuous inputs from this step on; they change every HOLD steps.

        Parameters
        ----------
        step
            Number of the communication step.
        seed
            Number of the signal.

        Returns
        -------
        np.ndarray
            (nu,) [unit of each input].

        Raises
        ------
        Nothing.
        """
        middle, half = self._input_motion
        moves = np.random.default_rng([seed, step // HOLD]).uniform(-1.0, 1.0, middle.shape)
        return np.clip(middle + half * moves, *self.input_range)

    @cached_property
    def input_range(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest values (nu,) of `inputs_at` [unit of each input]. Raises nothing."""
        (start, size), (lower, upper) = self._input_motion, self.continuous_inputs.limits
        return np.maximum(start - size, lower), np.minimum(start + size, upper)

    @cached_property
    def _input_motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Starts and amplitudes (nu,) of the continuous inputs [unit of each]. Raises nothing."""
        inputs = self.continuous_inputs
        width = inputs.each(lambda item: item.upper - item.lower)
        size = np.where(np.isfinite(width), RANGE_SHARE * width, SIZE_SHARE * inputs.scales)
        return np.nan_to_num(inputs.starts), 0.0 * size if self.avoided.held else size


def _variable(item: Any) -> FmuVariable | None:
    """Convert a variable of FMPy; None if it has no number."""
    if item.type not in (*_FLOATS, *_INTEGERS, "Boolean"):
        return None

    def number(name: str, default: float | None = None) -> Any:
        texts = (getattr(source, name, None) for source in (item, item.declaredType))
        return next((_number(text) for text in texts if text is not None), default)

    size, start = int(np.prod(item.shape)) if item.shape else 1, None
    with contextlib.suppress(ValueError):
        if item.start is not None:
            start = np.array([_number(word) for word in str(item.start).split()])
    if start is not None and start.size != size:
        start = np.full(size, start[0]) if start.size == 1 else None
    return FmuVariable(
        name=item.name, reference=int(item.valueReference), type=item.type,
        causality=item.causality, variability=item.variability, initial=item.initial,
        size=size, start=start, lower=number("min", -math.inf), upper=number("max", math.inf),
        nominal=number("nominal"),
        unit=item.unit or getattr(item.declaredType, "unit", None),
        clocked=bool(item.clocks),
    )  # fmt: skip


def _number(text: Any) -> float:
    words = {"true": 1.0, "false": 0.0}
    return words[str(text)] if str(text) in words else float(text)


def in_words(variables: Block, values: np.ndarray) -> str:
    """Return names and values (entries,) [unit of each]: `p = -0.1, m = 10`. Raises nothing."""
    pairs = zip(variables.names, values.tolist(), strict=True)
    shown = [f"{name} = {value:.6g}" for name, value in itertools.islice(pairs, _NAMED)]
    more = variables.entries - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")


class CheckedInstance(Instance):
    """One instance of a subject, of type "ME" or "CS", with access by variables.

    After an exception the instance is not freed: its process ends soon.
    """

    # For the FMU's own integrator; None: its default.
    tolerance: float | None = None

    def __init__(
        self,
        subject: Subject,
        kind: str,
        name: str = "check",
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Load and instantiate; options: more arguments of FMPy's instantiate(). Raises Fault."""
        self.subject = subject
        super().__init__(subject.description, subject.folder, kind, name, options)
        self.time = subject.start_time

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        if kind is None:
            self.close()

    def initialising(self, before: Settings = NOTHING, stop: float | None = None) -> Self:
        """Set some variables and enter Initialization Mode.

        Parameters
        ----------
        before
            Variables and their values (entries,) [unit of each].
        stop
            Stop time [s].

        Raises
        ------
        FMICallException, Fault
            If the FMU refuses a call, or ends.
        """
        self.time = self.subject.start_time
        self.fmu.setup(self.time, stop, self.tolerance)
        self.set(*before)
        self.fmu.enter(self.time, stop, self.tolerance)
        return self

    def begin(self, before: Settings = NOTHING, stop: float | None = None) -> Self:
        """Initialise, up to Continuous-Time Mode or the first step.

        Parameters
        ----------
        before
            Variables and their values (entries,) [unit of each] that are set before.
        stop
            Stop time [s].

        Raises
        ------
        FMICallException, Fault
            If the FMU refuses a call, does not settle, or ends.
        """
        return self.initialising(before, stop).finish_initialisation()

    def begin_varied(self) -> Self:
        """Initialise with other parameters than the starts. Raises as `begin`."""
        return self.begin(before=self.subject.varied)

    def finish_initialisation(self) -> Self:
        """Leave Initialization Mode; enter Continuous-Time Mode of Model Exchange."""
        self.fmu.exitInitializationMode()
        self.next_event = math.inf
        if self.kind == "ME":
            self.settle()
        return self

    def make_step(self, step: int) -> None:
        """Make one communication step of the subject's grid. Raises FMICallException, Fault."""
        self.time = self.subject.time(step)
        self.do_step(self.time, self.subject.step)

    def live(self, steps: int, *, completed: bool = False) -> None:
        """Make communication steps; with Model Exchange, evaluations at their times.

        completed: whether completedIntegratorStep follows each evaluation. Raises as `do_step`.
        """
        for step in range(steps):
            if self.kind == "CS":
                self.make_step(step)
            elif self.state_count:
                self.move(self.subject.time(step), self.states())
                self.rates()
                if completed:
                    self.completed()

    def get(self, variables: Block) -> np.ndarray:
        """Read variables, with one call per type.

        Parameters
        ----------
        variables
            In any order.

        Returns
        -------
        np.ndarray
            (entries,) [unit of each variable].

        Raises
        ------
        FMICallException
            If the FMU refuses a call.
        """
        values = np.empty(variables.entries)
        for references, places in variables.parts(self.fmu):
            references.forget()
            values[places] = self.read(references)
        return values

    def set(self, variables: Block, values: np.ndarray) -> None:
        """Set variables, with one call per type.

        Parameters
        ----------
        variables
            In any order.
        values
            (entries,) [unit of each variable].

        Raises
        ------
        RefusedCall
            If the FMU refuses a call.
        """
        for references, places in variables.parts(self.fmu):
            try:
                self.write(references, values[places])
            except RefusedCall as refusal:
                refusal.setting = in_words(variables, values)
                raise

    def observe(self) -> np.ndarray:
        """Read the values (entries,) by which runs are compared [unit of each].

        Raises FMICallException.
        """
        return self.get(self.subject.observed)
