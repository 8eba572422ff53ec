"""MAP.toml: how somebody's FMU and somebody's plan belong together. Every mistake is reported with its path, all in one sentence.

    [positions]
    x = "cart.s"                                             # column of the plan = variable of the FMU
    y = { variable = "cart2.s_mm", scale = 0.001 }           # plan's value = scale * FMU's + offset

See docs/replay.md for all sections.
"""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from models.errors import TouchstoneError
from validate.toml_text import TomlError, read_toml


class MapError(TouchstoneError):
    """A map file cannot be read, or names what the plan or the FMU does not have."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Signal(_Strict):
    """A variable of the FMU. For outputs: plan = scale * FMU + offset; for inputs: FMU = scale * plan + offset. unit: of the plan's column."""

    variable: str = Field(min_length=1)
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None


class VelocitySignal(Signal):
    """column: of the plan; without one, v_<position>."""

    column: str | None = None


class ContactEntry(_Strict):
    """force, gap: variables of the FMU, force positive when it pushes, gap negative in contact; column: of the planned force, lam_<name> without one."""

    force: Annotated[Signal | None, BeforeValidator(lambda value: _short(value))] = None
    gap: Annotated[Signal | None, BeforeValidator(lambda value: _short(value))] = None
    column: str | None = None


class LimitEntry(_Strict):
    value: float = Field(ge=0.0)
    reason: str = "set in the map"


class PlanEntry(_Strict):
    """time: name of the time column; hold: of the inputs within a step."""

    time: str = "t"
    hold: Literal["zero", "linear"] = "zero"


def _short(value: Any) -> Any:
    return {"variable": value} if isinstance(value, str) else value


def _short_limit(value: Any) -> Any:
    return {"value": value} if isinstance(value, (int, float)) and not isinstance(value, bool) else value


OfSignal = Annotated[Signal, BeforeValidator(_short)]
OfVelocity = Annotated[VelocitySignal, BeforeValidator(_short)]
OfLimit = Annotated[LimitEntry, BeforeValidator(_short_limit)]


class MapFile(_Strict):
    """The whole file. positions may be empty: then only contacts and the run itself can be shown."""

    plan: PlanEntry = PlanEntry()
    inputs: dict[str, OfSignal] = {}
    positions: dict[str, OfSignal] = {}
    velocities: dict[str, OfVelocity] = {}
    contacts: dict[str, ContactEntry] = {}
    start: dict[str, float | str] = {}
    parameters: dict[str, float] = {}
    goal: dict[str, float] = {}
    limits: dict[str, OfLimit] = {}
    internal_step: str | None = None


def read_map(path: Path) -> MapFile:
    """Read a map. Raises MapError with the path of every mistake."""
    try:
        _, data = read_toml(path)
    except TomlError as error:
        raise MapError(f"map {path}: {error}.") from error
    try:
        return MapFile.model_validate(data)
    except ValidationError as error:
        found = "; ".join(_sentence(item["loc"], item["type"], item["msg"]) for item in error.errors(include_url=False))
        raise MapError(f"map {path}: {found}{'' if found.endswith('?') else '.'}") from error


def _sentence(place: tuple[str | int, ...], kind: str, words: str) -> str:
    where = ".".join(map(str, place))
    if kind == "extra_forbidden":
        known = list(_model_at(place).model_fields)
        close = difflib.get_close_matches(str(place[-1])[:100], known, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(known)}"
        return f"{where}: there is no such key; {hint}"
    return f"{where}: {words[:1].lower()}{words[1:]}"


def _model_at(place: tuple[str | int, ...]) -> type[BaseModel]:
    """The model of which the last part of this place would be a key."""
    if len(place) == 1:
        return MapFile
    inside: dict[str, type[BaseModel]] = {"plan": PlanEntry, "velocities": VelocitySignal, "limits": LimitEntry, "contacts": ContactEntry}
    return Signal if len(place) == 4 else inside.get(str(place[0]), Signal)
