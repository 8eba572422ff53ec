"""The map of an external FMU: MAP.toml assigns columns of a plan to variables.

    [positions]
    x = "cart.s"  # column of the plan = variable of the FMU
    y = { variable = "cart2.s_mm", scale = 0.001 }           # plan's value = scale * FMU's + offset

Without a map equal names are used. Mistakes are reported in one sentence, with their paths. All
sections: docs/replay.md.
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
    """The map cannot be read, or contradicts the plan or the FMU."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Signal(_Strict):
    """A variable of the FMU; unit: of the plan's column.

    Outputs: plan = scale * FMU + offset. Inputs: FMU = scale * plan + offset.
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
    """A velocity; column: of the plan, default v_<position>."""

    column: str | None = None


class InputSignal(Signal):
    """An input with bounds in the unit of the plan's column, default the FMU's min and max."""

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
    """A contact: force (positive if pushing) and gap (negative in contact).

    - column: of the planned force, default lam_<name>.
    - depth: largest penetration that the FMU's contact model allows, in the gap's unit.
    - nominal_force: a typical force [N].
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
    """The largest value with which a plan holds, or `waived` with a reason."""

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
    """Half-width of a parameter's range, in the FMU's unit."""

    value: float = Field(ge=0.0)
    reason: str = "stated in the map"


class PlanEntry(_Strict):
    """Name of the time column; hold of the inputs, default the plan's, else zero."""

    time: str = "t"
    hold: Literal["zero", "linear"] | None = None


def _start(value: Any) -> Any:
    if not isinstance(value, str) and not is_number(value):
        raise ValueError("a number, or the name of a column")
    return value


class TaskEntry(_Strict):
    """Duration of a plan of this task [s]."""

    duration: float | None = Field(default=None, gt=0.0)


class AccuracyEntry(_Strict):
    """Errors of Co-Simulation results as the FMU's author states them, in the plan's units."""

    position: float | None = Field(default=None, gt=0.0)
    velocity: float | None = Field(default=None, gt=0.0)
    gap: float | None = Field(default=None, gt=0.0)


class MapFile(_Strict):
    """The whole file. Without positions only contacts are judged."""

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
        """Return which of q, v, lam and gap are missing, and why."""
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
        mistakes = "; ".join(map(_sentence, error.errors(include_url=False)))
        raise MapError(f"map {path}: {mistakes}{'' if mistakes.endswith('?') else '.'}") from error


def composed(text: str) -> str:
    """Return a name in Unicode's composed form (NFC), so that equal-looking names are equal."""
    return text if text.isascii() else unicodedata.normalize("NFC", text)


def _composed(path: Path, value: Any) -> Any:
    if not isinstance(value, dict):
        return composed(value) if isinstance(value, str) else value
    result: dict[str, Any] = {}
    for name, item in value.items():
        if composed(name) in result:
            raise MapError(
                f"map {path}: two keys {composed(name)!r} look the same, but are written with other signs of Unicode."
            )
        result[composed(name)] = _composed(path, item)
    return result


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
    if len(place) == 1:
        return MapFile
    section: Any = MapFile.model_fields[str(place[0])].annotation
    return Signal if len(place) == 4 else (get_args(section) or (section,))[-1]


# Units of each quantity, up to a factor. Numbers and radians match any, as an arm of 1 m is often
# left out.
QUANTITIES = {"position": ("m",), "velocity": ("m/s", "1/s"), "force": ("N", "N m"), "gap": ("m",)}
# Units of contact forces and gaps without a scale, also those of angles.
CONTACT_UNITS = {"force": ("N", "N m", "N.m", "Nm"), "gap": ("m", "rad")}
# Prefix of friction columns, as in a scene's plan. An external FMU has no friction to compare.
FRICTION = "friction_"
# Base units of mechanics; sensors use other ones at an arbitrary scale.
_MECHANICAL = {"kg", "m", "s"}


class Dimensions:
    """Units of an FMU by its own definitions, of a plan by ours."""

    def __init__(self, description: Any) -> None:
        self._defined = defined_units(description)

    def contradicts(self, unit: str | None, what: str, of_fmu: bool = False) -> bool:
        """Return whether this unit cannot be one of the quantity."""
        known = self._unit(unit, of_fmu)
        if known is None or not known.powers or not known.powers.keys() <= _MECHANICAL:
            return False
        return all(known.powers != _ours(name) for name in QUANTITIES[what])

    def is_rate(self, unit: str | None) -> bool:
        """Return whether an FMU's variable in this unit is a velocity, by definition or name."""
        defined = self._defined.get(unit or "")
        if defined is None:
            return unit in _RATES
        return defined.powers == {"m": 1, "s": -1} or (
            defined.powers == {"s": -1} and defined.rad == 1
        )

    def is_force(self, unit: str | None) -> bool:
        """Return whether an FMU's variable in this unit is a force, by definition or name."""
        if (defined := self._defined.get(unit or "")) is None:
            return unit in CONTACT_UNITS["force"]
        return defined.powers in [_ours(name) for name in QUANTITIES["force"]]

    def is_in(self, unit: str, known: Iterable[str]) -> bool:
        """Return whether a unit of the FMU is one of ours, by definition or name."""
        if unit not in self._defined:
            return unit in known
        return any(self.is_same(name, unit) for name in known)

    def is_same(self, unit: str, of_fmu: str) -> bool:
        """Return whether a unit of the plan equals a unit of the FMU, factor included."""
        one, other = self._unit(unit, False), self._unit(of_fmu, True)
        if one is None or other is None:
            return unit == of_fmu
        return one.is_same(other)

    def may_be_rate(self, position: str, velocity: str) -> bool:
        """Return whether a velocity may be in its position's unit per second.

        An unknown unit may be any; "1" counts as unknown.
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
    try:
        return {base: power for base, power in base_exponents(unit).items() if base in _MECHANICAL}
    except ValueError:
        return None


# Units of velocities in an FMU without unit definitions.
_RATES = ("m/s", "rad/s")


def _check_numbers(package: Package, variable: Any) -> None:
    """Raise FmuError if a start, bound or nominal is no number, or list of numbers."""
    for what in ("start", "min", "max", "nominal"):
        if (text := getattr(variable, what, None)) is None:
            continue
        try:
            list(map(float, str(text).split() or [""]))
        except ValueError:
            why = f"its variable {variable.name!r} has {what}={text!r}, which is no number; correct it in {DESCRIPTION}"
            raise FmuError(f"FMU {package.path}: {why}.") from None


# Supported variables, and advice for others.
_TAKEN = (
    f"a map takes variables of one floating-point number ({', '.join(REAL)}); leave it out (inputs and parameters keep their start values), "
    "or wrap the FMU in one that has such a variable for it"
)
# Largest number of names to compare with an unknown one; comparing takes up to 40 us a name.
_MANY = 2000


def is_input(variable: Any) -> bool:
    """Return whether the variable is an input."""
    return variable.causality == "input"


def is_parameter(variable: Any) -> bool:
    """Return whether the variable is a scalar parameter."""
    return variable.causality == "parameter" and not getattr(variable, "dimensions", None)


def is_started(variable: Any) -> bool:
    """Return whether a state's start can be set and has a default."""
    return variable.initial in ("exact", "approx") and variable.start is not None


def is_startable(variable: Any) -> bool:
    """Return whether a map may set the start value."""
    return variable.causality in ("parameter", "input") or variable.initial in ("exact", "approx")


class Named:
    """The variables of an FMU by their NFC names.

    twice: duplicate names, which FMI forbids; aliases: supported names by reference.
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
        """Return the variable or its first alias that satisfies `wanted`, else the variable."""
        names = self.aliases.get(int(variable.valueReference), ())
        matches = (self.by_name[name] for name in names if wanted(self.by_name[name]))
        return variable if wanted(variable) else next(matches, variable)

    def numbers(self) -> list[str]:
        """Return the names of floating-point variables."""
        return [name for name, variable in self.by_name.items() if variable.type in REAL]

    def refusal(self, name: str) -> str:
        """Return why a map cannot use this variable, as a clause, or ""."""
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
    """Return the map of equal names: inputs; lam_X with gap_X as contacts; rates as velocities.

    Other columns are positions; friction_X forces are left out.
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
        for position, rate in paired(list(sections["positions"]), rates, by_name).items()
    }
    if not sections["inputs"] and not sections["positions"]:
        raise MapError(
            f"{table.where}: the plan and the FMU share no names; say what belongs together in a map (--map MAP.toml)."
        )
    return MapFile.model_validate({**sections, "velocities": velocities})


def paired(positions: list[str], rates: list[str], by_name: Mapping[str, Any]) -> dict[str, str]:
    """Return the velocity of each position: by derivative, then name, then order in the plan."""
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
    """Return similar names in parentheses, or ""."""
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
    """Return the FMU's nominal, 1 if absent or not positive."""
    return float(nominal) if nominal is not None and float(nominal) > 0 else 1.0
