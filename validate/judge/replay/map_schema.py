"""The map of somebody's FMU: MAP.toml, how it and somebody's plan belong together.

or, where none is given, by equal names.

    [positions]
    x = "cart.s"  # column of the plan = variable of the FMU
    y = { variable = "cart2.s_mm", scale = 0.001 }           # plan's value = scale * FMU's + offset

Every mistake is reported with its path, all in one sentence. See docs/replay.md for all sections.

And whether a unit can be that of a quantity: a scale turns one unit of a quantity into another, but
no mass into a length.
"""

from __future__ import annotations

import difflib
import heapq
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from models.errors import TouchstoneError, did_you_mean
from models.plan_table import Table
from models.scene.values import base_exponents
from validate.fmi.archive import DESCRIPTION, FmuError
from validate.fmi.description import REAL, Package
from validate.fmi.units import Unit, defined_units
from validate.processes.toml_text import TomlError, is_number, mistake, read_toml


class MapError(TouchstoneError):
    """A map file cannot be read, or names what the plan or the FMU does not have."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Signal(_Strict):
    """A variable of the FMU.

    For outputs: plan = scale * FMU + offset; for inputs: FMU = scale * plan + offset. unit: of the
    plan's column.
    """

    variable: str = Field(min_length=1)
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        return {"variable": value} if isinstance(value, str) else value


class VelocitySignal(Signal):
    """column: of the plan; without one, v_<position>."""

    column: str | None = None


class InputSignal(Signal):
    """lower, upper: bounds in the unit of the plan's column.

    Without one, the FMU's own min and max.
    """

    lower: float | None = None
    upper: float | None = None

    @model_validator(mode="after")
    def _in_order(self) -> InputSignal:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise PydanticCustomError(
                "bounds",
                "lower is {lower}, but must be below upper, {upper}",
                {"lower": f"{self.lower:g}", "upper": f"{self.upper:g}"},
            )
        return self


class ContactEntry(_Strict):
    """A contact: its force, positive when it pushes, and its gap, negative in contact, as variables of the FMU.

    column: of the planned force, lam_<name> without one; depth: penetration at which the FMU's
        model of the contact ends, in the unit of the gap [m]; nominal_force: a typical force [N].
    """

    force: Signal | None = None
    gap: Signal | None = None
    column: str | None = None
    depth: float | None = Field(default=None, gt=0.0)
    depth_reason: str = ""
    nominal_force: float | None = Field(default=None, gt=0.0)

    @model_validator(mode="after")
    def _of_a_depth(self) -> ContactEntry:
        if self.depth_reason and self.depth is None:
            raise PydanticCustomError("depth", "it gives a depth_reason, but no depth")
        return self


class _Valued(_Strict):
    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        return (
            {"value": value}
            if isinstance(value, (int, float)) and not isinstance(value, bool)
            else value
        )


class MapLimit(_Valued):
    """value: the largest with which a plan still holds.

    waived: the metric's default limit does not count, for a reason that must be given.
    """

    value: float | None = Field(default=None, ge=0.0)
    waived: bool = False
    reason: str = ""

    @model_validator(mode="after")
    def _one_of_two(self) -> MapLimit:
        if self.waived == (self.value is not None):
            raise PydanticCustomError(
                "limit", "it needs one of the two: a value, or waived = true with a reason"
            )
        if self.waived and not self.reason.strip():
            raise PydanticCustomError("reason", "a limit is waived for a reason; add reason = '..'")
        return self


class UncertaintyEntry(_Valued):
    """value: how far a parameter may be from what it is, both ways, in the FMU's unit; and why."""

    value: float = Field(ge=0.0)
    reason: str = "stated in the map"


class PlanEntry(_Strict):
    """time: name of the time column.

    hold: of the inputs within a step, None: as the plan declares, else zero.
    """

    time: str = "t"
    hold: Literal["zero", "linear"] | None = None


def _start(value: Any) -> Any:
    if not isinstance(value, str) and not is_number(value):
        raise ValueError("a number, or the name of a column")
    return value


class TaskEntry(_Strict):
    """duration: how long a plan of this task lasts [s]."""

    duration: float | None = Field(default=None, gt=0.0)


class AccuracyEntry(_Strict):
    """How far the results of a Co-Simulation may be from the truth, as its author states it: of any position, velocity and gap, in the plan's units."""

    position: float | None = Field(default=None, gt=0.0)
    velocity: float | None = Field(default=None, gt=0.0)
    gap: float | None = Field(default=None, gt=0.0)


class MapFile(_Strict):
    """The whole file. positions may be empty: then only contacts and the run itself can be shown."""

    plan: PlanEntry = PlanEntry()
    task: TaskEntry = TaskEntry()
    inputs: dict[str, InputSignal] = {}
    positions: dict[str, Signal] = {}
    velocities: dict[str, VelocitySignal] = {}
    contacts: dict[str, ContactEntry] = {}
    start: dict[str, Annotated[float | str, BeforeValidator(_start)]] = {}
    parameters: dict[str, float] = {}
    uncertainty: dict[str, UncertaintyEntry] = {}
    goal: dict[str, float] = {}
    limits: dict[str, MapLimit] = {}
    accuracy: AccuracyEntry = AccuracyEntry()
    internal_step: str | None = None

    def lacks(self) -> dict[str, str]:
        """Return what of q, v, lam and gap cannot be shown, and why."""
        lacks = {}
        if not self.positions:
            lacks["q"] = "no positions are named"
        if not self.velocities.keys() >= self.positions.keys():
            lacks["v"] = "not every position has a velocity named"
        if any(entry.gap is None for entry in self.contacts.values()):
            lacks["gap"] = "not every contact has a gap named"
        if any(entry.force is None for entry in self.contacts.values()):
            lacks["lam"] = "not every contact has a force named"
        return lacks


def read_map(path: Path) -> MapFile:
    """Read a map. Raises MapError with the path of every mistake."""
    try:
        _, data = read_toml(path)
    except TomlError as error:
        raise MapError(f"map {path}: {error}.") from error
    try:
        return MapFile.model_validate(_composed(path, data))
    except ValidationError as error:
        found = "; ".join(map(_sentence, error.errors(include_url=False)))
        raise MapError(f"map {path}: {found}{'' if found.endswith('?') else '.'}") from error


def composed(text: str) -> str:
    """A name in Unicode's composed form (NFC), in which names are compared: an umlaut may be written as one sign or as two that look the same."""
    return text if text.isascii() else unicodedata.normalize("NFC", text)


def _composed(path: Path, value: Any) -> Any:
    if not isinstance(value, dict):
        return composed(value) if isinstance(value, str) else value
    found: dict[str, Any] = {}
    for name, item in value.items():
        if composed(name) in found:
            raise MapError(
                f"map {path}: two keys {composed(name)!r} look the same, but are written with other signs of Unicode."
            )
        found[composed(name)] = _composed(path, item)
    return found


def _sentence(problem: Any) -> str:
    place = problem["loc"]
    where = ".".join(map(str, place))
    if place == ("plan", "scheme"):
        return f"{where}: a scheme is of a scene's equations, and an FMU keeps its own; take the line out"
    if place == ("task", "step"):
        return f"{where}: there is no such key; the steps are the plan's own, and a task of an FMU has a duration alone"
    if problem["type"] == "extra_forbidden":
        known = list(_model_at(place).model_fields)
        what = f"there {'is' if len(known) == 1 else 'are'} {', '.join(known)}"
        return f"{where}: there is no such key; {did_you_mean(place[-1], known, what)}"
    return f"{where}: {mistake(problem)}"


def _model_at(place: tuple[str | int, ...]) -> type[BaseModel]:
    """The model of which the last part of this place would be a key."""
    if len(place) == 1:
        return MapFile
    section: Any = MapFile.model_fields[str(place[0])].annotation
    return Signal if len(place) == 4 else (get_args(section) or (section,))[-1]


# What each quantity may be in, but for a factor. Pure numbers and radians pass for any: an arm of 1
# m is often left out.
QUANTITIES = {"position": ("m",), "velocity": ("m/s", "1/s"), "force": ("N", "N m"), "gap": ("m",)}
# What forces and gaps of a contact are in without a scale, by what they are called where they
# belong to an angle too.
CONTACT_UNITS = {"force": ("N", "N m", "N.m", "Nm"), "gap": ("m", "rad")}
# What columns of a plan's friction forces begin with, as a scene's plan has them. A map has no
# place for them: nothing of an FMU is held against them.
FRICTION = "friction_"
# Base units of mechanics; only the maker of a sensor knows the scale of other ones.
_MECHANICAL = {"kg", "m", "s"}


class Dimensions:
    """Units of an FMU, by its own definitions, and of a plan, by ours."""

    def __init__(self, description: Any) -> None:
        """description: FMPy's."""
        self._defined = defined_units(description)

    def contradicts(self, unit: str | None, what: str, of_fmu: bool = False) -> bool:
        """Whether no quantity of this kind has such a unit."""
        found = self._unit(unit, of_fmu)
        if found is None or not found.powers or not found.powers.keys() <= _MECHANICAL:
            return False
        return all(found.powers != _ours(name) for name in QUANTITIES[what])

    def is_rate(self, unit: str | None) -> bool:
        """Whether a variable in this unit of the FMU is a velocity, by the unit's definition or name."""
        defined = self._defined.get(unit or "")
        if defined is None:
            return unit in _RATES
        return defined.powers == {"m": 1, "s": -1} or (
            defined.powers == {"s": -1} and defined.rad == 1
        )

    def is_force(self, unit: str | None) -> bool:
        """Whether a variable in this unit of the FMU is a force, by the unit's definition or name."""
        if (defined := self._defined.get(unit or "")) is None:
            return unit in CONTACT_UNITS["force"]
        return defined.powers in [_ours(name) for name in QUANTITIES["force"]]

    def is_in(self, unit: str, known: Iterable[str]) -> bool:
        """Whether numbers in a unit of the FMU are those in one of ours, by definition or name."""
        if unit not in self._defined:
            return unit in known
        return any(self.is_same(name, unit) for name in known)

    def is_same(self, unit: str, of_fmu: str) -> bool:
        """Whether numbers in a unit of the plan are those in a unit of the FMU."""
        one, other = self._unit(unit, False), self._unit(of_fmu, True)
        if one is None or other is None:
            return unit == of_fmu
        return one.is_same(other)

    def may_be_rate(self, position: str, velocity: str) -> bool:
        """Whether a velocity is in its position's unit per second, as far as both units are known.

        "1" counts as unknown.
        """
        one, other = self._unit(position, True), self._unit(velocity, True)
        if one is None or other is None or "1" in (position, velocity):
            return True
        return one.per_second().is_same(other._replace(offset=0.0))

    def _unit(self, unit: str | None, of_fmu: bool) -> Unit | None:
        """Return a unit by the FMU's definition or ours; None if neither defines it."""
        if of_fmu and unit in self._defined:
            return self._defined[unit]
        powers = _ours(unit) if unit else None
        return None if powers is None else Unit(powers)


def _ours(unit: str) -> dict[str, int] | None:
    """Exponents of kg, m and s; None of a unit that we do not know."""
    try:
        return {base: power for base, power in base_exponents(unit).items() if base in _MECHANICAL}
    except ValueError:
        return None


# Velocities by their names, in an FMU that defines no units.
_RATES = ("m/s", "rad/s")


def _check_numbers(package: Package, variable: Any) -> None:
    """Raises FmuError for a start, bound or nominal of a variable that is no number.

    Those of an array are separated by blanks.
    """
    for what in ("start", "min", "max", "nominal"):
        if (text := getattr(variable, what, None)) is None:
            continue
        try:
            list(map(float, str(text).split() or [""]))
        except ValueError:
            why = f"its variable {variable.name!r} has {what}={text!r}, which is no number; correct it in {DESCRIPTION}"
            raise FmuError(f"FMU {package.path}: {why}.") from None


# What a map takes, and what to do with anything else.
_TAKEN = (
    f"a map takes variables of one floating-point number ({', '.join(REAL)}); leave it out (inputs and parameters keep their start values), "
    "or wrap the FMU in one that has such a variable for it"
)
# Names from which on only some are compared with one that is not there, and how many: comparing
# takes up to 40 us a name.
_MANY = 2000


def is_input(variable: Any) -> bool:
    """Whether it is an input."""
    return variable.causality == "input"


def is_parameter(variable: Any) -> bool:
    """Whether it is a parameter of one number."""
    return variable.causality == "parameter" and not getattr(variable, "dimensions", None)


def is_started(variable: Any) -> bool:
    """Whether an FMU lets a state's start be set, and says what it is otherwise."""
    return variable.initial in ("exact", "approx") and variable.start is not None


def is_startable(variable: Any) -> bool:
    """Whether a map may give its start value."""
    return variable.causality in ("parameter", "input") or variable.initial in ("exact", "approx")


class Named:
    """The variables of an FMU by their names, in Unicode's composed form.

    `twice`: names that are there more than once, which FMI forbids; `aliases`: names of each value
    that a map takes, by its reference.
    """

    def __init__(self, package: Package) -> None:
        self.by_name: dict[str, Any] = {}
        self.twice: set[str] = set()
        self.aliases: dict[int, list[str]] = {}
        for variable in package.description.modelVariables:
            name = composed(variable.name)
            if self.by_name.setdefault(name, variable) is not variable:
                self.twice.add(name)
            if variable.type in REAL:
                _check_numbers(package, variable)
                names = self.aliases.setdefault(int(variable.valueReference), [])
                if name not in names:
                    names.append(name)

    def alias(self, variable: Any, wanted: Callable[[Any], bool]) -> Any:
        """The first variable of the same value that is wanted, else the variable itself."""
        names = self.aliases.get(int(variable.valueReference), ())
        found = (self.by_name[name] for name in names if wanted(self.by_name[name]))
        return variable if wanted(variable) else next(found, variable)

    def numbers(self) -> list[str]:
        """Names of the variables that are numbers."""
        return [name for name, variable in self.by_name.items() if variable.type in REAL]

    def refusal(self, name: str) -> str:
        """Why a map cannot take a variable of this name, a clause without full stop.

        Empty where it can.
        """
        variable, array = self.by_name.get(name), name.rpartition("[")[0]
        if name in self.twice:
            return f"the FMU has two variables {name!r}, so it is not clear which is meant"
        if variable is None and not getattr(self.by_name.get(array), "dimensions", None):
            return f"the FMU has no variable {name!r}{hint(name, self.numbers())}"
        if variable is None:
            return f"{name!r} is an entry of the array {array!r}, but {_TAKEN}"
        if getattr(variable, "dimensions", None):
            return f"{name!r} is an array of {variable.type}, but {_TAKEN}"
        return "" if variable.type in REAL else f"{name!r} is of type {variable.type}, but {_TAKEN}"


def by_equal_names(named: Named, table: Table, dimensions: Dimensions) -> MapFile:
    """Columns are what the FMU's variables of their names are: inputs; lam_X (with gap_X) contacts.

    friction_X left out where it is a force; in a unit of velocity velocities; else positions.
    """
    by_name = named.by_name
    sections: dict[str, dict[str, Any]] = {"inputs": {}, "positions": {}, "contacts": {}}
    rates = []
    for name in table.names:
        variable = by_name.get(name)
        if name == "t":
            continue
        if name.startswith(FRICTION) and (
            variable is None
            or (variable.causality != "input" and dimensions.is_force(variable.unit))
        ):
            continue
        if variable is None:
            raise MapError(
                f"{table.where}: the FMU has no variable {name!r}{hint(name, named.numbers())}; name the right one in a map (--map MAP.toml)."
            )
        if named.alias(variable, lambda item: item.causality == "input").causality == "input":
            sections["inputs"][name] = name
        elif name.startswith("lam_"):
            contact = name.removeprefix("lam_")
            gap = f"gap_{contact}"
            sections["contacts"][contact] = (
                {"force": name, "gap": gap} if gap in by_name else {"force": name}
            )
        elif dimensions.is_rate(variable.unit):
            rates.append(name)
        else:
            sections["positions"][name] = name
    if rates and len(rates) != len(sections["positions"]):
        sections["positions"] |= {name: name for name in rates}
        rates = []
    velocities = {
        position: {"variable": rate, "column": rate}
        for position, rate in _paired(list(sections["positions"]), rates, by_name).items()
    }
    if not sections["inputs"] and not sections["positions"]:
        raise MapError(
            f"{table.where}: the plan and the FMU share no names; say what belongs together in a map (--map MAP.toml)."
        )
    return MapFile.model_validate({**sections, "velocities": velocities})


def _paired(positions: list[str], rates: list[str], by_name: Mapping[str, Any]) -> dict[str, str]:
    """Velocity of each position: the FMU says that it is its derivative, or its name does.

    The others by their order in the plan.
    """
    pairs = {}
    for rate in rates:
        of = getattr(by_name[rate], "derivative", None)
        owner = (
            composed(of.name)
            if of is not None
            else rate.removeprefix("v_").removeprefix("der(").removesuffix(")")
        )
        if owner in positions and owner not in pairs:
            pairs[owner] = rate
    left = [rate for rate in rates if rate not in pairs.values()]
    pairs |= dict(zip([name for name in positions if name not in pairs], left, strict=False))
    return {name: pairs[name] for name in positions if name in pairs}


def hint(name: str, known: Iterable[str]) -> str:
    """Names that are near it, for the end of a sentence."""
    known = list(known)
    if len(known) > _MANY:
        parts = {name[at : at + 3].lower() for at in range(max(1, min(len(name), 200) - 2))}
        known = heapq.nlargest(
            _MANY,
            known,
            key=lambda item: sum(part in item.lower() for part in parts) / (len(item) + len(name)),
        )
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    return f" (near it: {', '.join(close)})" if close else ""


def positive(nominal: Any) -> float:
    """A nominal that an FMU states, 1 where it states none, or one that is not positive."""
    return float(nominal) if nominal is not None and float(nominal) > 0 else 1.0
