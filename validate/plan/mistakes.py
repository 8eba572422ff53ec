"""What is wrong with a campaign file, each mistake with its place; and how to find those behind the first.

file, mistakes = checked({"scens": ["three_cart"], "time_limit": "long"})
mistakes      # ["scens: there is no such key; did you mean scenes?", "scenes: it is missing", "time_limit: ..."]
"""

from __future__ import annotations

import copy
import difflib
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from validate.plan.schema import CampaignFile, CampaignLimit, LegEntry, PipelineEntry, SceneEntry

# A file of nothing but mistakes: the first say enough.
MOST_SHOWN = 50
_Place = tuple[str | int, ...]


def hint(name: str, known: Iterable[str]) -> str:
    """`did you mean k?`, or what there is."""
    known = list(known)
    close = difflib.get_close_matches(name[:100], known, n=1)
    return f"did you mean {close[0]}?" if close else f"there are {', '.join(known)}." if known else "there are none."


def place_text(place: Sequence[str | int]) -> str:
    """`scenes[0].parameters.k`."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part[:80]}" if text else part[:80]
    return text


def checked(data: Mapping[str, Any]) -> tuple[CampaignFile | None, list[str]]:
    """The file without what is wrong in it (None if nothing is left), so that the rest can be looked into too; and what is wrong."""
    try:
        return CampaignFile.model_validate(data), []
    except ValidationError as error:
        problems = error.errors(include_url=False)
    mistakes = [_sentence(problem) for problem in problems]
    rest = _plain_copy(data)
    for _ in range(10):  # what hides behind a mistake may be wrong as well
        for problem in problems:
            _remove(rest, problem["loc"])
        try:
            return CampaignFile.model_validate(rest), mistakes
        except ValidationError as error:
            problems = error.errors(include_url=False)
    return None, mistakes


def _sentence(problem: Any) -> str:
    place, kind = problem["loc"], problem["type"]
    where = place_text(place)
    if kind == "missing":
        return f"{where}: it is missing"
    if kind == "extra_forbidden":
        return f"{where}: there is no such key; {hint(str(place[-1]), _model_at(place).model_fields)}"
    words = problem["msg"].removeprefix("Value error, ")
    return f"{where}: {words[:1].lower()}{words[1:]}, not {reprlib.repr(problem['input'])}"


def _model_at(place: _Place) -> type[BaseModel]:
    """The model of which the last part of this place would be a key."""
    if len(place) == 1:
        return CampaignFile
    if place[0] == "scenes":
        return SceneEntry if len(place) == 3 else CampaignLimit
    return PipelineEntry if len(place) == 3 else LegEntry


def _plain_copy(data: Mapping[str, Any]) -> dict[str, Any]:
    try:
        return copy.deepcopy(dict(data))
    except RecursionError:
        return {}


def _remove(data: Any, place: _Place) -> None:
    """Take out what is at a place, or, where nothing is, what it is missing from; a list loses all, so that no place in it moves."""
    way = [data]
    for part in place:
        inside = _inside(way[-1], part)
        if inside is None:
            break
        way.append(inside)
    depth = max(min(len(way), len(place)) - (1 if len(way) > len(place) else 2), 0)
    holder = way[depth]
    if isinstance(holder, dict):
        holder.pop(place[depth], None)
    elif isinstance(holder, list):
        holder.clear()


def _inside(data: Any, part: str | int) -> Any:
    if isinstance(data, dict):
        return data.get(part)
    return data[part] if isinstance(data, list) and isinstance(part, int) and part < len(data) else None
