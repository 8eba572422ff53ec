"""The FMU under check: its description, what follows from it for all checks - variables, times, inputs, what may be varied -, and an instance of it.

A Subject loads nothing of the FMU's code, a CheckedInstance does.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from validate.fmi.archive import DESCRIPTION, INTERFACES, interfaces
from validate.fmi.description import interface_of, without_garbage
from validate.fmi.instance import CLASSES, Instance, References, RefusedCall

_FLOATS = ("Real", "Float64", "Float32")
_WHOLE = (
    "Integer",
    "Int8",
    "UInt8",
    "Int16",
    "UInt16",
    "Int32",
    "UInt32",
    "Int64",
    "UInt64",
    "Enumeration",
)
# Communication steps of a run that is repeated often; of one that is to meet the model's events, at
# most.
STEPS = {"CS": 100, "ME": 40}
LONG_STEPS = 500
# A run of a slow FMU is shortened to about this [s], but not below FEWEST_STEPS.
RUN_SECONDS = 2.0
FEWEST_STEPS = 8
# Values of one run that are compared, at most, but for those FEWEST_STEPS.
_MOST_VALUES = 4_000_000
# Steps for which the inputs stay as they are.
HOLD = 10
# Inputs move about their starts by this share of their range, or of their size if they have no
# range.
RANGE_SHARE = 0.3
SIZE_SHARE = 0.1
# Parameters are varied by this share of their size.
_VARIED = 0.01
# Variables that are named where several are set at once.
_NAMED = 3
# Tolerance of an FMU that proposes none (the value FMI's own examples use).
DEFAULT_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class FmuVariable:
    """A variable of the FMU that has a number: `size` entries, start as numbers (or None).

    clocked: FMI 3.0 lets it be read and set only while a clock ticks, so the checks leave it out;
        refused: the sides of its start, "below" and "above", to which the FMU lets nobody move it.
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
        """The value that it names: aliases share it. Enumerations of FMI 2.0 are read as integers."""
        return self.reference, "Integer" if self.type == "Enumeration" else self.type

    @property
    def is_float(self) -> bool:
        """Whether it is a floating-point number."""
        return self.type in _FLOATS

    @property
    def is_continuous(self) -> bool:
        """Whether it is a floating-point number that moves between events."""
        return self.is_float and self.variability == "continuous"

    @property
    def scale(self) -> float:
        """Typical magnitude: the nominal, else that of the start, else 1."""
        if self.nominal:
            return abs(self.nominal)
        size = (
            float(np.max(np.abs(self.start))) if self.start is not None and self.start.size else 0.0
        )
        return size if size > 0.0 and math.isfinite(size) else 1.0


class Block(tuple[FmuVariable, ...]):
    """Variables that are read or written together, by one call a type.

    What that takes is found out once. Entries: all of the first variable, then of the second.
    """

    @cached_property
    def sizes(self) -> np.ndarray:
        """(variables,) entries of each [-]. Raises nothing."""
        return np.array([item.size for item in self], dtype=int)

    @cached_property
    def ends(self) -> np.ndarray:
        """(variables + 1,) where each variable's entries begin, and all end [-]. Raises nothing."""
        return np.concatenate([[0], np.cumsum(self.sizes, dtype=int)])

    @property
    def entries(self) -> int:
        """Of all variables together."""
        return int(self.ends[-1])

    @cached_property
    def names(self) -> list[str]:
        """Of the variable of each entry."""
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
        return np.concatenate(
            [
                np.empty(0),
                *(
                    np.full(item.size, math.nan) if item.start is None else item.start
                    for item in self
                ),
            ]
        )

    def near(self, share: float) -> np.ndarray:
        """Other values than the starts: `share` of the size away, on the side that the range allows; the same where it allows none.

        Parameters
        ----------
        share : of its size [-].

        Returns
        -------
        (entries,) [unit of each]. Raises nothing.
        """
        value, upper, lower = (
            self.starts,
            self.each(lambda item: item.upper),
            self.each(lambda item: item.lower),
        )
        away = share * np.where(value == 0.0, self.scales, np.abs(value))
        above, below = value + away, value - away
        rises = (above <= upper) & ~self.refuses("above")
        falls = (below >= lower) & ~self.refuses("below")
        return np.where(rises, above, np.where(falls, below, value))

    def refuses(self, side: str) -> np.ndarray:
        """(entries,) whether the FMU refuses values on this side of the start. Raises nothing."""
        return self.each(lambda item: side in item.refused) > 0.0

    def parts(self, fmu: Any) -> list[tuple[References, Any]]:
        """Of each type its references, with memory, and the places of its entries.

        fmu: an object or class of `validate.fmi.instance`.
        """
        if self._parts is None:
            self._parts = []
            kinds = [item.type for item in self]
            for kind in dict.fromkeys(kinds):
                chosen = np.fromiter((other == kind for other in kinds), bool, len(kinds))
                references = fmu.references(
                    kind,
                    [item.reference for item in self if item.type == kind],
                    int(self.sizes[chosen].sum()),
                )
                self._parts.append(
                    (references, slice(None) if chosen.all() else np.repeat(chosen, self.sizes))
                )
        return self._parts

    _parts: list[tuple[References, Any]] | None = None


def one_each(variables: Iterable[FmuVariable]) -> Block:
    """The first of the names of each value."""
    found: dict[tuple[int, str], FmuVariable] = {}
    for item in variables:
        found.setdefault(item.key, item)
    return Block(found.values())


# Variables, and (entries,) a value for each [unit of each].
Settings = tuple[Block, np.ndarray]
NOTHING: Settings = (Block(), np.empty(0))


@dataclass(frozen=True)
class Avoided:
    """Values that the FMU refuses, and no check sets.

    below, above, unset: names of variables that stay on the other side of their starts, and that are
        never set; held, unvaried: inputs, and parameters, stay at their starts.
    """

    below: frozenset[str] = frozenset()
    above: frozenset[str] = frozenset()
    unset: frozenset[str] = frozenset()
    held: bool = False
    unvaried: bool = False

    def sides(self, name: str) -> frozenset[str]:
        """The sides to which a variable is not moved."""
        return frozenset(side for side in ("below", "above") if name in getattr(self, side))

    def lists(self) -> dict[str, Any]:
        """The same as JSON holds it."""
        return {
            name: sorted(value) if isinstance(value, frozenset) else value
            for name, value in vars(self).items()
        }

    @classmethod
    def of(cls, lists: Mapping[str, Any]) -> Self:
        """From `lists`."""
        named = {name: frozenset(lists[name]) for name in ("below", "above", "unset")}
        return cls(**named, held=lists["held"], unvaried=lists["unvaried"])


@dataclass(eq=False)
class Subject:
    """An unpacked FMU.

    `description` is FMPy's; `pace`: the seconds of one step of each type, once known; `ends`: the
    time [s] that a run of each type cannot reach, as the FMU ended it before.
    """

    path: Path
    folder: Path
    description: Any
    pace: dict[str, float] = field(default_factory=dict)
    ends: dict[str, float] = field(default_factory=dict)
    avoided: Avoided = Avoided()

    @property
    def major(self) -> int:
        """Major version of FMI."""
        return int(self.description.fmiVersion.split(".")[0])

    @property
    def types(self) -> tuple[str, ...]:
        """Types of FMI that the description offers, of "ME" and "CS"."""
        return tuple(kind for kind in ("ME", "CS") if self.interface(kind) is not None)

    def interface(self, kind: str) -> Any:
        """FMPy's description of a type."""
        return interface_of(self.description, kind)

    def can(self, kind: str, ability: str) -> bool:
        """Whether the description claims an ability, by its name in this version of FMI (FMPy does not read all of them)."""
        return self._interfaces.get(INTERFACES[kind], {}).get(ability) in ("true", "1")

    @cached_property
    def _interfaces(self) -> dict[str, dict[str, str]]:
        return interfaces((self.folder / DESCRIPTION).read_bytes())

    @cached_property
    def variables(self) -> tuple[FmuVariable, ...]:
        """All variables that have numbers, in the order of the description (aliases included)."""
        found = filter(None, map(_variable, self.description.modelVariables))
        if not (self.avoided.below or self.avoided.above):
            return tuple(found)
        return tuple(replace(item, refused=self.avoided.sides(item.name)) for item in found)

    @cached_property
    def values(self) -> Block:
        """One variable a value, in the order of the description."""
        return one_each(self.variables)

    @cached_property
    def by_name(self) -> dict[str, FmuVariable]:
        """Variables by their names."""
        return {variable.name: variable for variable in self.variables}

    def prepare(self) -> None:
        """Find out, once for all forks, what follows from the description.

        Raises ValueError, KeyError for one that contradicts itself.
        """
        with without_garbage():
            for name in (
                "_interfaces",
                "by_name",
                "states",
                "derivatives",
                "outputs",
                "observed",
                "continuous_inputs",
                "exact",
                "varied",
            ):
                getattr(self, name)
            for block in (self.observed, self.exact, self.varied[0]):
                block.parts(CLASSES[self.major, "CS"])
        gc.freeze()

    def of(self, unknowns: list[Any]) -> Block:
        """The variables of a section of the ModelStructure, those without numbers left out."""
        return Block(
            self.by_name[item.variable.name]
            for item in unknowns
            if item.variable.name in self.by_name
        )

    @cached_property
    def states(self) -> Block:
        """Of which the derivatives are listed, in that order."""
        names = [
            item.variable.derivative.name
            for item in self.description.derivatives
            if item.variable.derivative is not None
        ]
        return Block(self.by_name[name] for name in names if name in self.by_name)

    @cached_property
    def derivatives(self) -> Block:
        """Derivatives of the states, as the ModelStructure lists them."""
        return self.of(self.description.derivatives)

    @cached_property
    def rates(self) -> list[tuple[FmuVariable, FmuVariable]]:
        """Variables that are derivatives, each with what it is the derivative of."""
        named = [
            (item.name, getattr(item.derivative, "name", None))
            for item in self.description.modelVariables
        ]
        pairs = [
            (self.by_name[rate], self.by_name[state])
            for rate, state in named
            if rate in self.by_name and state in self.by_name
        ]
        return list({rate.key: (rate, state) for rate, state in reversed(pairs)}.values())[::-1]

    @cached_property
    def outputs(self) -> Block:
        """Outputs, as the ModelStructure lists them, but for clocked ones."""
        return one_each(item for item in self.of(self.description.outputs) if not item.clocked)

    @cached_property
    def observed(self) -> Block:
        """The values that runs are compared by: all but for clocked ones."""
        return Block(item for item in self.values if not item.clocked)

    @cached_property
    def continuous_inputs(self) -> Block:
        """Continuous floating-point inputs."""
        return self._settable(
            lambda item: item.causality == "input" and item.is_continuous,
        )

    @cached_property
    def clocks(self) -> Block:
        """Variables that tell the time."""
        return one_each(
            item for item in self.variables if item.causality == "independent" and item.is_float
        )

    @cached_property
    def exact(self) -> Block:
        """Variables whose start is their value in initialisation."""
        return self._settable(
            lambda item: (
                item.start is not None and (item.initial == "exact" or item.causality == "input")
            )
        )

    @cached_property
    def varied(self) -> Settings:
        """Other values of the floating-point parameters that may be set before a run: a hundredth of their size off their starts."""
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
        return parameters, parameters.near(_VARIED)

    def _settable(self, wanted: Callable[[FmuVariable], bool]) -> Block:
        """One variable a value of those that are wanted, and that the FMU lets be set."""
        return one_each(
            item for item in self.variables if wanted(item) and item.name not in self.avoided.unset
        )

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
        """The step [s] that Co-Simulation makes inside, as FMI 3.0 declares it.

        0 where it does not.
        """
        return float(getattr(self.description.coSimulation, "fixedInternalStepSize", None) or 0.0)

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
        return self._affordable(
            kind,
            min(LONG_STEPS, max(STEPS["CS"], round(length / self.step)))
            if length > 0.0
            else STEPS["CS"],
        )

    def _affordable(self, kind: str, steps: int) -> int:
        pace = self.pace.get(kind, 0.0)
        steps = min(steps, max(FEWEST_STEPS, _MOST_VALUES // max(len(self.observed), 1)))
        return self.before_end(
            kind,
            steps
            if pace <= 0.0
            else int(np.clip(RUN_SECONDS / pace, min(FEWEST_STEPS, steps), steps)),
        )

    def before_end(self, kind: str, steps: int) -> int:
        """So many steps, or as many as the FMU makes before it ends the simulation itself."""
        left = (
            math.ceil((self.ends.get(kind, math.inf) - self.start_time) / self.step - 1e-9) - 1
            if kind in self.ends
            else steps
        )
        return max(0, min(steps, left))

    def time(self, step: int) -> float:
        """Time of a communication point [s]."""
        return self.start_time + step * self.step

    def inputs_at(self, step: int, seed: int = 0) -> np.ndarray:
        """Values of the continuous inputs from this step on; they change every HOLD steps.

        Another seed, another signal.

        Returns
        -------
        (nu,) [unit of each input]. Raises nothing.
        """
        lower, upper = self.input_range
        middle, half = self._input_motion
        moves = np.random.default_rng([seed, step // HOLD]).uniform(-1.0, 1.0, middle.shape)
        return np.clip(middle + half * moves, lower, upper)

    @cached_property
    def input_range(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest values (nu,) that `inputs_at` gives [unit of each input]. Raises nothing."""
        inputs, (start, size) = self.continuous_inputs, self._input_motion
        lower = np.maximum(start - size, inputs.each(lambda item: item.lower))
        upper = np.minimum(start + size, inputs.each(lambda item: item.upper))
        return (
            np.where(inputs.refuses("below"), np.maximum(lower, start), lower),
            np.where(inputs.refuses("above"), np.minimum(upper, start), upper),
        )

    @cached_property
    def _input_motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the continuous inputs starts, and how far they move, (nu,) [unit of each input] each. Raises nothing."""
        inputs = self.continuous_inputs
        width = inputs.each(lambda item: item.upper - item.lower)
        size = np.where(np.isfinite(width), RANGE_SHARE * width, SIZE_SHARE * inputs.scales)
        return np.nan_to_num(inputs.starts), 0.0 * size if self.avoided.held else size


def _variable(item: Any) -> FmuVariable | None:
    """Ours for FMPy's; None if it has no number."""
    if item.type not in (*_FLOATS, *_WHOLE, "Boolean"):
        return None

    def number(name: str, otherwise: float | None = None) -> Any:
        texts = (getattr(source, name, None) for source in (item, item.declaredType))
        return next((_number(text) for text in texts if text is not None), otherwise)

    size, start = int(np.prod(item.shape)) if item.shape else 1, None
    with contextlib.suppress(ValueError):
        start = (
            None
            if item.start is None
            else np.array([_number(word) for word in str(item.start).split()])
        )
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
    """Variables and the values (entries,) [unit of each] that they are set to: `p = -0.1, m = 10`.

    Raises nothing.
    """
    pairs = zip(variables.names, values.tolist(), strict=True)
    said = [f"{name} = {value:.6g}" for name, value in itertools.islice(pairs, _NAMED)]
    more = variables.entries - len(said)
    return ", ".join(said) + (f" and {more} more" if more else "")


class CheckedInstance(Instance):
    """One instance of `subject` of type "ME" or "CS", which knows the FMU's variables.

    After a failure it is left as it is: the process ends soon.
    """

    def __init__(
        self,
        subject: Subject,
        kind: str,
        name: str = "check",
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """options: more arguments of FMPy's instantiate().

        Raises Fault if the binary cannot be loaded or refuses.
        """
        self.subject = subject
        self.tolerance: float | None = None  # for the FMU's own integrator; None: what it likes
        super().__init__(subject.description, subject.folder, kind, name, options)
        self.time = subject.start_time

    def __enter__(self) -> Self:
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
        self, before: Settings = NOTHING, during: Settings = NOTHING, stop: float | None = None
    ) -> Self:
        """Through initialisation, and to Continuous-Time Mode or the first step.

        Parameters
        ----------
        before, during : variables and their values (entries,) [unit of the variable] that are set
            before and in initialisation.
        stop : stop time [s].

        Raises
        ------
        FMICallException, Fault : if the FMU refuses a call, does not settle, or ends.
        """
        self.time = self.subject.start_time
        self.setup(stop)
        self.set(*before)
        self.enter_initialisation(stop)
        self.set(*during)
        return self.finish_initialisation()

    def begin_varied(self) -> Self:
        """As `begin`, with other parameters than a fresh instance has, so that a forgotten one shows. Raises as `begin`."""
        return self.begin(before=self.subject.varied)

    def finish_initialisation(self) -> Self:
        """Out of Initialization Mode, and with Model Exchange to Continuous-Time Mode."""
        self.fmu.exitInitializationMode()
        self.next_event = math.inf
        if self.kind == "ME":
            self.settle()
        return self

    def make_step(self, step: int) -> None:
        """One communication step of the subject's grid. Raises FMICallException, Fault."""
        self.time = self.subject.time(step)
        self.do_step(self.time, self.subject.step)

    def live(self, steps: int, *, completed: bool = False) -> None:
        """So many communication steps; of Model Exchange as many evaluations, if it has states.

        Raises as `do_step`.

        completed: whether each is told to be an accepted step.
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
        """Values of variables in the order given; one call a type.

        Returns
        -------
        (entries,) [unit of each variable], all entries of the first variable, then of the second.

        Raises
        ------
        FMICallException : if the FMU refuses a call.
        """
        values = np.empty(variables.entries)
        for references, places in variables.parts(self.fmu):
            references.forget()
            values[places] = self.read(references)
        return values

    def set(self, variables: Block, values: np.ndarray) -> None:
        """Set variables; one call a type.

        Parameters
        ----------
        variables : in any order.
        values : (entries,) [unit of each variable], all entries of the first variable, then of the
            second.

        Raises
        ------
        FMICallException : if the FMU refuses a call.
        """
        for references, places in variables.parts(self.fmu):
            try:
                self.write(references, values[places])
            except RefusedCall as refusal:
                refusal.setting = in_words(variables, values)
                raise

    def observe(self) -> np.ndarray:
        """Values (entries,) [unit of each variable] of all that runs are compared by.

        Raises FMICallException.
        """
        return self.get(self.subject.observed)
