"""MAP.toml: how somebody's FMU and somebody's plan belong together. Every mistake is reported with its path, all in one sentence.

    [positions]
    x = "cart.s"                                             # column of the plan = variable of the FMU
    y = { variable = "cart2.s_mm", scale = 0.001 }           # plan's value = scale * FMU's + offset

See docs/replay.md for all sections.
"""

from __future__ import annotations

import difflib
import unicodedata
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from models.errors import TouchstoneError
from validate.plan.toml_text import TomlError, read_toml


class MapError(TouchstoneError):
    """A map file cannot be read, or names what the plan or the FMU does not have."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Signal(_Strict):
    """A variable of the FMU. For outputs: plan = scale * FMU + offset; for inputs: FMU = scale * plan + offset. unit: of the plan's column."""

    variable: str = Field(min_length=1)
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None


class VelocitySignal(Signal):
    """column: of the plan; without one, v_<position>."""

    column: str | None = None


class InputSignal(Signal):
    """lower, upper: bounds in the unit of the plan's column; without one, the FMU's own min and max."""

    lower: float | None = None
    upper: float | None = None

    @model_validator(mode="after")
    def _in_order(self) -> InputSignal:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise PydanticCustomError(
                "bounds", "lower is {lower}, but must be below upper, {upper}", {"lower": f"{self.lower:g}", "upper": f"{self.upper:g}"}
            )
        return self


class ContactEntry(_Strict):
    """A contact: its force, positive when it pushes, and its gap, negative in contact, as variables of the FMU.

    column: of the planned force, lam_<name> without one; depth: penetration at which the FMU's model of the contact ends, in the unit of the gap [m].
    """

    force: Annotated[Signal | None, BeforeValidator(lambda value: _short(value))] = None
    gap: Annotated[Signal | None, BeforeValidator(lambda value: _short(value))] = None
    column: str | None = None
    depth: float | None = Field(default=None, gt=0.0)
    depth_reason: str = ""

    @model_validator(mode="after")
    def _of_a_depth(self) -> ContactEntry:
        if self.depth_reason and self.depth is None:
            raise PydanticCustomError("depth", "it gives a depth_reason, but no depth")
        return self


class MapLimit(_Strict):
    """value: the largest with which a plan still holds; waived: the metric's default limit does not count, for a reason that must be given."""

    value: float | None = Field(default=None, ge=0.0)
    waived: bool = False
    reason: str = ""

    @model_validator(mode="after")
    def _one_of_two(self) -> MapLimit:
        if self.waived == (self.value is not None):
            raise PydanticCustomError("limit", "it needs one of the two: a value, or waived = true with a reason")
        if self.waived and not self.reason.strip():
            raise PydanticCustomError("reason", "a limit is waived for a reason; add reason = '..'")
        return self


class PlanEntry(_Strict):
    """time: name of the time column; hold: of the inputs within a step, None: as the plan declares, else zero."""

    time: str = "t"
    hold: Literal["zero", "linear"] | None = None


class TaskEntry(_Strict):
    """duration: how long a plan of this task lasts [s]."""

    duration: float | None = Field(default=None, gt=0.0)


class AccuracyEntry(_Strict):
    """How far the results of a Co-Simulation may be from the truth, as its author states it: of any position, velocity and gap, in the plan's units."""

    position: float | None = Field(default=None, gt=0.0)
    velocity: float | None = Field(default=None, gt=0.0)
    gap: float | None = Field(default=None, gt=0.0)


def _short(value: Any) -> Any:
    return {"variable": value} if isinstance(value, str) else value


def _short_limit(value: Any) -> Any:
    return {"value": value} if isinstance(value, (int, float)) and not isinstance(value, bool) else value


OfSignal = Annotated[Signal, BeforeValidator(_short)]
OfInput = Annotated[InputSignal, BeforeValidator(_short)]
OfVelocity = Annotated[VelocitySignal, BeforeValidator(_short)]
OfLimit = Annotated[MapLimit, BeforeValidator(_short_limit)]


class MapFile(_Strict):
    """The whole file. positions may be empty: then only contacts and the run itself can be shown."""

    plan: PlanEntry = PlanEntry()
    task: TaskEntry = TaskEntry()
    inputs: dict[str, OfInput] = {}
    positions: dict[str, OfSignal] = {}
    velocities: dict[str, OfVelocity] = {}
    contacts: dict[str, ContactEntry] = {}
    start: dict[str, float | str] = {}
    parameters: dict[str, float] = {}
    goal: dict[str, float] = {}
    limits: dict[str, OfLimit] = {}
    accuracy: AccuracyEntry = AccuracyEntry()
    internal_step: str | None = None


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
            raise MapError(f"map {path}: two keys {composed(name)!r} look the same, but are written with other signs of Unicode.")
        found[composed(name)] = _composed(path, item)
    return found


def _sentence(mistake: Any) -> str:
    place, kind, words = mistake["loc"], mistake["type"], mistake["msg"]
    where = ".".join(map(str, place))
    if kind == "greater_than":
        return f"{where}: it is {float(mistake['input']):g}, but must be above {mistake['ctx']['gt']:g}"
    if place == ("plan", "scheme"):
        return f"{where}: a scheme is of a scene's equations, and an FMU keeps its own; take the line out"
    if place == ("task", "step"):
        return f"{where}: there is no such key; the steps are the plan's own, and a task of an FMU has a duration alone"
    if kind == "extra_forbidden":
        known = list(_model_at(place).model_fields)
        close = difflib.get_close_matches(str(place[-1])[:100], known, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there {'is' if len(known) == 1 else 'are'} {', '.join(known)}"
        return f"{where}: there is no such key; {hint}"
    return f"{where}: {words[:1].lower()}{words[1:]}"


def _model_at(place: tuple[str | int, ...]) -> type[BaseModel]:
    """The model of which the last part of this place would be a key."""
    if len(place) == 1:
        return MapFile
    inside: dict[str, type[BaseModel]] = {
        "plan": PlanEntry, "task": TaskEntry, "accuracy": AccuracyEntry, "inputs": InputSignal,
        "velocities": VelocitySignal, "limits": MapLimit, "contacts": ContactEntry,
    }  # fmt: skip
    return Signal if len(place) == 4 else inside.get(str(place[0]), Signal)
