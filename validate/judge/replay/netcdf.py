"""Replays as NetCDF-4 files with units; other data is JSON in the attribute `facts`.

    write_replay(path, replay, scene, plan)         # every number, bit for bit
    write_drawn(path, replay, scene, plan, 1500)    # only the data that a report draws
    columns, attributes = read_columns(path)        # models.netcdf

The poses of a scene's shapes are included, so that a report needs no scene. A tracked replay is a
file of its own with the applied inputs; its gains are stored with the plan.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from models.errors import TrajectoryError
from models.kinematics import pose_columns
from models.netcdf import Column, as_columns, drawn, write_columns
from models.scene import Scene
from models.trajectory import Trajectory
from validate.judge.replay.result import Replay
from validate.judge.replay.subject import Subject

_CONTENT = "touchstone replay"
_SERIES = {
    "kinetic_energy": "kinetic energy",
    "potential_energy": "potential energy without contacts",
    "contact_energy": "energy stored in contacts",
    "input_work": "work of the inputs since the start",
    "dissipated_work": "work dissipated since the start",
}


def _groups(scene: Subject) -> dict[str, list[tuple[str, str, str]]]:
    return {
        "q": [(item.name, item.unit, item.description) for item in scene.coordinates],
        "v": [
            (item.velocity_name, item.velocity_unit, f"velocity of {item.name}")
            for item in scene.coordinates
        ],
        "lam": [
            (item.force_name, "N", f"contact force, {item.description or item.name}")
            for item in scene.contacts
        ],
        "gap": [
            (item.gap_name, "m", f"gap, negative in contact, {item.description or item.name}")
            for item in scene.contacts
        ],
        "friction": [
            (item.force_name, "N", f"friction force, {item.description or item.name}")
            for item in scene.frictions
        ],
        "contact_impulse": [
            (
                f"impulse_{item.name}",
                "N s",
                f"impulse since the start, {item.description or item.name}",
            )
            for item in scene.contacts
        ],
        **{field: [(field, "J", text)] for field, text in _SERIES.items()},
    }


_DRAWN = ("q", "lam", "gap", "friction")


def write_replay(path: Path, replay: Replay, scene: Subject, plan: Trajectory) -> None:
    """Write all columns of a replay. Raises MachineError if the file cannot be written."""
    groups = _groups(scene)
    rows = np.arange(len(replay.t))
    _write(path, replay, scene, plan, {name: getattr(replay, name) for name in groups}, rows)


def write_drawn(path: Path, replay: Replay, scene: Subject, plan: Trajectory, longest: int) -> None:
    """Write the data that a report draws, in single precision except for the times.

    At most `longest` evenly spaced rows, plus the plan's nodes, events and extremes. Raises
    MachineError if the file cannot be written.
    """
    arrays = {
        name: drawn(values) for name in _DRAWN if (values := getattr(replay, name)) is not None
    }
    rows = np.arange(len(replay.t))
    if len(rows) > longest:
        evenly = np.linspace(0, rows[-1], longest).round().astype(int)
        times = [event.time for event in replay.events]
        events = np.minimum(np.searchsorted(replay.t, times), rows[-1])
        extremes = [
            ends(values, axis=0)
            for values in arrays.values()
            if values.shape[1]
            for ends in (np.argmin, np.argmax)
        ]
        rows = np.unique(np.concatenate([evenly, replay.knots, events, *extremes]))
    _write(path, replay, scene, plan, arrays, rows)


def _write(
    path: Path,
    replay: Replay,
    scene: Subject,
    plan: Trajectory,
    arrays: Mapping[str, np.ndarray | None],
    rows: np.ndarray,
) -> None:
    """Write these arrays at these rows, which include all nodes."""
    if replay.scene != scene.name:
        raise TrajectoryError(
            f"file {path}: the replay is of scene {replay.scene}, not of {scene.name}."
        )
    columns = [
        Column(name="t", dimension="time", values=replay.t[rows], unit="s", description="time")
    ]
    for field, group in _groups(scene).items():
        if (values := arrays.get(field)) is not None:
            columns += as_columns(group, values[rows].reshape(len(rows), len(group)), "time")
    columns.append(
        Column(
            name="knots",
            dimension="node",
            values=np.searchsorted(rows, replay.knots),
            unit="1",
            description="rows that are nodes of the plan",
        )
    )
    if replay.applied is not None and len(replay.applied):
        columns += as_columns(
            [
                (f"applied_{item.name}", item.unit, f"{item.name} as applied")
                for item in scene.inputs
            ],
            replay.applied,
            "step",
        )
    if plan.has_states and len(plan.q) >= len(replay.knots):
        away = replay.q[replay.knots] - plan.q[: len(replay.knots)]
        columns.append(
            Column(
                name="position_error",
                dimension="node",
                values=drawn(np.abs(away).max(axis=1, initial=0.0)),
                unit="/".join(dict.fromkeys(item.unit for item in scene.coordinates)),
                description="largest difference of a coordinate to the plan",
            )
        )
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
    columns = (
        [*columns, *pose_columns(scene, replay.q[rows], "time")]
        if isinstance(scene, Scene)
        else storable(columns)
    )
    attributes = {
        "content": _CONTENT,
        "scene": scene.name,
        "fmu_sha256": replay.fmu,
        "facts": json.dumps(facts, allow_nan=False),
    }
    write_columns(path, columns, attributes)


def storable_name(name: str) -> str:
    """Return the name with characters that NetCDF allows."""
    return re.sub(r"[/\x00-\x1f\x7f]", "_", name).strip() or "_"


def storable(columns: list[Column]) -> list[Column]:
    """Return an FMU's columns under valid, unique names; descriptions keep the originals."""
    taken: set[str] = {"time", "node", "step"}  # dimensions
    renamed = []
    for column in columns:
        name = base = storable_name(column.name)
        count = 1
        while name in taken:
            count += 1
            name = f"{base}_{count}"
        taken.add(name)
        text = (
            column.description
            if name == column.name
            else f"{column.name}: {column.description}".rstrip(": ")
        )
        renamed.append(replace(column, name=name, description=text))
    return renamed
