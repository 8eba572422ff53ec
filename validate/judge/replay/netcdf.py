"""Replays in NetCDF-4 files, with units, and back.

write_replay(path, replay, scene)
replay = read_replay(path, scene)            # bit for bit what was written

Of a scene of ours the poses of its shapes stand there too (models.kinematics), for those who draw it without the scene.
A tracked replay is a file of its own, with the inputs it applied; the law that made them, its gains, is stored with the plan (models.trajectory_netcdf).
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import TrajectoryError
from models.kinematics import pose_columns
from models.netcdf import Column, numbers, read_columns, write_columns
from models.scene import Scene
from validate.judge.replay.result import Difference, Event, Growth, Replay, ReplayError, ReplayOutcome
from validate.judge.replay.subject import Subject
from validate.judge.replay.wiring import Effort

_CONTENT = "touchstone replay"
_SERIES = {
    "kinetic_energy": "kinetic energy",
    "potential_energy": "potential energy without contacts",
    "contact_energy": "energy stored in contacts",
}
_WORK = {"input_work": "work of the inputs since the start", "dissipated_work": "work dissipated since the start"}


def _groups(scene: Subject) -> dict[str, list[tuple[str, str, str]]]:
    """(name, unit, description) of the columns of every array with more than one column."""
    return {
        "q": [(item.name, item.unit, item.description) for item in scene.coordinates],
        "v": [(item.velocity_name, item.velocity_unit, f"velocity of {item.name}") for item in scene.coordinates],
        "lam": [(item.force_name, "N", f"contact force, {item.description or item.name}") for item in scene.contacts],
        "gap": [(item.gap_name, "m", f"gap, negative in contact, {item.description or item.name}") for item in scene.contacts],
        "friction": [(item.force_name, "N", f"friction force, {item.description or item.name}") for item in scene.frictions],
        "contact_impulse": [
            (f"impulse_{item.name}", "N s", f"impulse since the start, {item.description or item.name}") for item in scene.contacts
        ],
    }


def write_replay(path: Path, replay: Replay, scene: Subject) -> None:
    """Write a replay of this scene. Raises MachineError if the file cannot be written."""
    if replay.scene != scene.name:
        raise TrajectoryError(f"file {path}: the replay is of scene {replay.scene}, not of {scene.name}.")
    columns = [Column(name="t", dimension="time", values=replay.t, unit="s", description="time")]
    for field, group in _groups(scene).items():
        array = getattr(replay, field)
        if array is not None:
            columns += [
                Column(name=name, dimension="time", values=array[:, index], unit=unit, description=text)
                for index, (name, unit, text) in enumerate(group)
            ]
    for field, text in {**_SERIES, **_WORK}.items():
        if getattr(replay, field) is not None:
            columns.append(Column(name=field, dimension="time", values=getattr(replay, field), unit="J", description=text))
    columns.append(Column(name="knots", dimension="node", values=replay.knots, unit="1", description="rows that are nodes of the plan"))
    if replay.applied is not None and len(replay.applied):
        columns += [
            Column(
                name=f"applied_{item.name}",
                dimension="step",
                values=replay.applied[:, index],
                unit=item.unit,
                description=f"{item.name} as applied",
            )
            for index, item in enumerate(scene.inputs)
        ]
    facts = {
        "outcome": replay.outcome.name,
        "message": replay.message,
        "method": replay.method,
        "events": [[event.time, event.contact, event.closes] for event in replay.events],
        "event_budget": replay.event_budget,
        "error": replay.error.as_json(),
        "seconds_reference": replay.seconds_reference,
        "seconds_everyday": replay.seconds_everyday,
        "has_impulse": replay.contact_impulse is not None,
        "growth": None if replay.growth is None else asdict(replay.growth),
        "effort": None if replay.effort is None else asdict(replay.effort),
    }
    columns = [*columns, *pose_columns(scene, replay.q, "time")] if isinstance(scene, Scene) else _storable(columns)
    attributes = {"content": _CONTENT, "scene": scene.name, "fmu_sha256": replay.fmu, "facts": json.dumps(facts, allow_nan=False)}
    write_columns(path, columns, attributes)


def _storable(columns: list[Column]) -> list[Column]:
    """Columns of somebody's FMU under names that NetCDF allows and that are there once; a name that had to be changed stands in the description."""
    taken: set[str] = {"time", "node", "step"}  # dimensions
    found = []
    for column in columns:
        name = base = re.sub(r"[/\x00-\x1f\x7f]", "_", column.name).strip() or "_"
        count = 1
        while name in taken:
            count += 1
            name = f"{base}_{count}"
        taken.add(name)
        text = column.description if name == column.name else f"{column.name}: {column.description}".rstrip(": ")
        found.append(replace(column, name=name, description=text))
    return found


def read_replay(path: Path, scene: Scene) -> Replay:
    """Read a replay of this scene. Raises TrajectoryError naming the file and what is wrong in it."""
    columns, attributes = read_columns(path)
    if attributes.get("content") != _CONTENT:
        raise TrajectoryError(f"file {path}: it holds {attributes.get('content', 'something else')!r}, not a replay.")
    if attributes.get("scene") != scene.name:
        raise TrajectoryError(f"file {path}: it holds a replay of scene {attributes.get('scene')!r}, not of {scene.name!r}.")
    t = numbers(path, columns, "t", "s")
    facts = _facts(path, attributes)
    arrays: dict[str, Any] = {}
    for field, group in _groups(scene).items():
        if field == "contact_impulse" and not facts["has_impulse"]:
            arrays[field] = None
            continue
        stacked = [numbers(path, columns, name, unit, len(t)) for name, unit, _ in group]
        arrays[field] = np.column_stack(stacked) if stacked else np.zeros((len(t), 0))
    for field in _SERIES:
        arrays[field] = numbers(path, columns, field, "J", len(t))
    for field in _WORK:
        arrays[field] = numbers(path, columns, field, "J", len(t)) if field in columns else None
    knots = numbers(path, columns, "knots", "1").astype(np.int64)
    if knots.size and not (knots.min() >= 0 and knots.max() < len(t)):
        raise TrajectoryError(f"file {path}: knots points outside the {len(t)} times of the replay.")
    for name, array in {"t": t, **arrays}.items():
        if array is not None and not np.isfinite(array).all():
            raise TrajectoryError(f"file {path}: {name} holds values that are not finite numbers.")
    try:
        return Replay(
            scene=scene.name,
            outcome=ReplayOutcome[facts["outcome"]],
            message=facts["message"],
            method=facts["method"],
            t=t,
            knots=knots,
            **arrays,
            events=tuple(Event(time=float(time), contact=str(contact), closes=bool(closes)) for time, contact, closes in facts["events"]),
            event_budget=int(facts["event_budget"]),
            error=_error(facts["error"]),
            seconds_reference=float(facts["seconds_reference"]),
            seconds_everyday=float(facts["seconds_everyday"]),
            fmu=str(attributes.get("fmu_sha256", "")),
            growth=None if facts.get("growth") is None else _growth(facts["growth"]),
            effort=None if facts.get("effort") is None else _effort(facts["effort"]),
            applied=None if facts.get("effort") is None else _applied(path, columns, scene),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise TrajectoryError(
            f"file {path}: its facts are not those of a replay ({type(error).__name__}: {error}); replay the plan again."
        ) from error


def _growth(stored: dict[str, Any]) -> Growth:
    growth = Growth(**{name: float(value) for name, value in stored.items()})
    if not growth.duration > 0:
        raise ValueError(f"the plan lasts {growth.duration:g} s")
    return growth


def _effort(stored: dict[str, Any]) -> Effort:
    return Effort(
        rms=tuple(map(float, stored["rms"])),
        peak=tuple(map(float, stored["peak"])),
        rms_share=float(stored["rms_share"]),
        peak_share=float(stored["peak_share"]),
        plan_share=None if stored["plan_share"] is None else float(stored["plan_share"]),
        saturated=float(stored["saturated"]),
    )


def _applied(path: Path, columns: dict[str, Column], scene: Scene) -> np.ndarray:
    names = [f"applied_{item.name}" for item in scene.inputs]
    if not any(name in columns for name in names):
        return np.zeros((0, scene.nu))  # it ended before the first step
    return np.column_stack([numbers(path, columns, name, item.unit) for name, item in zip(names, scene.inputs, strict=True)])


def _error(stored: dict[str, Any]) -> ReplayError:
    ratio, source = stored.pop("step_ratio", None), stored.pop("step_source", "none")
    differences = {
        name: None if item is None else Difference(**{part: math.inf if value is None else value for part, value in item.items()})
        for name, item in stored.items()
    }
    return ReplayError(**differences, step_ratio=None if ratio is None else float(ratio), step_source=source)


def _facts(path: Path, attributes: dict[str, str | int | float]) -> dict[str, Any]:
    try:
        facts = json.loads(str(attributes.get("facts", "")))
    except (ValueError, RecursionError) as error:  # no JSON, or a number of thousands of digits, or nested without end
        raise TrajectoryError(f"file {path}: its facts cannot be read ({error}); replay the plan again.") from error
    if not isinstance(facts, dict) or "has_impulse" not in facts:
        raise TrajectoryError(f"file {path}: its facts are not those of a replay; replay the plan again.")
    return facts
