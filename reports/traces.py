"""Motions of a stage from NetCDF files, thinned for plots.

    motion = read_motion(Path("runs/all/runs/<key>"), run, stage)
    motion.plan.columns["q1"], motion.replay.poses["left"]

A column may be shorter than the times. Missing columns, or ones that are not finite, are absent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from models.results.run import RunRecord, SceneRecord, StageRecord, stage_files, thin

Array = NDArray[np.float64]
# Smallest force that counts as contact: a thousandth of the smallest drawn [N].
_FORCE_OF_CONTACT = 1e-3
# Errors of reading damaged files.
_DAMAGED = (OSError, ValueError, KeyError, TypeError, RuntimeError)


@dataclass(frozen=True, eq=False)
class Trace:
    """One motion at times t (n,) [s].

    columns: coordinates and inputs, `lam_<contact>` [N], `gap_<contact>` [m], friction forces [N],
    and of a replay `position_error`. poses: (n, 3) x, y [m] and angle [rad] of each shape.
    """

    t: Array
    columns: Mapping[str, Array]
    poses: Mapping[str, Array] = field(default_factory=dict)

    def force(self, contact: str) -> Array | None:
        """Return a contact's or friction's force, (n - 1,) or (n,) [N], or None. Raises nothing."""
        return self.columns.get(f"lam_{contact}", self.columns.get(contact))

    def gap(self, contact: str) -> Array | None:
        """Return the gap of a contact (n,) [m], or None. Raises nothing."""
        return self.columns.get(f"gap_{contact}")


@dataclass(frozen=True)
class Motion:
    """Motions of a stage; tracked: with feedback; problems: unreadable files."""

    plan: Trace | None = None
    replay: Trace | None = None
    tracked: Trace | None = None
    problems: tuple[str, ...] = ()

    def judged(self, stage: StageRecord) -> Trace | None:
        """Return the motion of the judged replay."""
        return self.tracked if stage.is_tracked else self.replay


def read_motion(folder: Path, run: RunRecord, stage: StageRecord) -> Motion:
    """Return plan and replays of a stage; folder: of the record."""
    if not stage.has_plan:
        return Motion()
    files, problems = stage_files(stage.index, len(run.stages)), []
    wanted = {"trajectory": True, "replay": stage.replay is not None, "tracked": stage.is_followed}
    columns: dict[str, Mapping[str, Array]] = {what: {} for what in wanted}
    for what in (what for what, there in wanted.items() if there):
        try:
            columns[what] = _columns(folder / files[what], run.scene)
        except _DAMAGED as error:
            problems.append(f"{files[what]} cannot be read ({_reason(error)}).")
    replay, tracked = (_replay(run.scene, columns[what]) for what in ("replay", "tracked"))
    return Motion(_plan(run.scene, columns["trajectory"]), replay, tracked, tuple(problems))


def read_plan(folder: Path, run: RunRecord, stage: StageRecord) -> Trace | None:
    """Return the plan of a stage, None if unreadable."""
    return (
        read_trace(folder / stage_files(stage.index, len(run.stages))["trajectory"], run.scene)
        if stage.has_plan
        else None
    )


def read_trace(path: Path, scene: SceneRecord) -> Trace | None:
    """Return the motion of a file, None if unreadable."""
    try:
        return _plan(scene, _columns(path, scene))
    except _DAMAGED:
        return None


def _reason(error: Exception) -> str:
    return (
        "there is no such file"
        if isinstance(error, FileNotFoundError)
        else str(error).partition("\n")[0][:160] or type(error).__name__
    )


def _columns(path: Path, scene: SceneRecord) -> dict[str, Array]:
    """Return the drawn columns of a file, finite and one-dimensional. Raises one of _DAMAGED."""
    names = [
        "t",
        "knots",
        "position_error",
        *(item.name for item in (*scene.coordinates, *scene.inputs, *scene.frictions)),
    ]
    names += [f"{what}_{contact.name}" for contact in scene.contacts for what in ("lam", "gap")]
    names += [f"applied_{item.name}" for item in scene.inputs]
    names += [
        f"pose_{part}_{place}"
        for place in range(1, len(scene.shapes) + 1)
        for part in ("x", "y", "angle")
    ]
    columns = {}
    with h5py.File(path, "r") as file:
        there = set(file)
        for name in names:
            if name not in there:
                continue
            # HDF5's own calls: h5py's Dataset takes twice as long for short columns.
            stored = h5py.h5d.open(file.id, name.encode())
            if len(stored.shape) == 1 and stored.dtype.kind in "fiu":
                values = np.empty(stored.shape, float)
                stored.read(h5py.h5s.ALL, h5py.h5s.ALL, values)
                if np.isfinite(values).all():
                    columns[name] = values
    return columns


def _plan(scene: SceneRecord, columns: Mapping[str, Array]) -> Trace | None:
    if not len(columns.get("t", ())):
        return None
    return _thinned(
        scene, columns["t"], {name: values for name, values in columns.items() if name != "t"}
    )


def _replay(scene: SceneRecord, columns: Mapping[str, Array]) -> Trace | None:
    """Return a replay with applied inputs, and its distance from the plan, linear between nodes."""
    if not len(columns.get("t", ())):
        return None
    t, drawn = columns["t"], dict(columns)
    knots = drawn.pop("knots", np.zeros(0)).astype(int)
    away = drawn.pop("position_error", np.zeros(0))
    if len(knots) and knots.min() >= 0 and knots.max() < len(t):
        rows = np.arange(len(t))
        for item in scene.inputs:
            applied = drawn.pop(f"applied_{item.name}", None)
            if applied is not None and len(applied):
                drawn[item.name] = applied[
                    np.clip(np.searchsorted(knots, rows, side="right") - 1, 0, len(applied) - 1)
                ]
        if len(away) == len(knots):
            drawn["position_error"] = np.interp(t, t[knots], away)
    return _thinned(scene, t, drawn)


def _thinned(scene: SceneRecord, t: Array, columns: Mapping[str, Array]) -> Trace:
    keep = thin(len(t))
    thinned = {
        name: values[keep[keep < len(values)]]
        for name, values in columns.items()
        if 0 < len(values) <= len(t)
    }
    poses = {}
    for number, shape in enumerate(scene.shapes, 1):
        parts = [
            _part(thinned, f"pose_{part}_{number}" if place is None else place, len(keep))
            for part, place in zip(("x", "y", "angle"), shape.place, strict=True)
        ]
        whole = [part for part in parts if part is not None]
        if len(whole) == len(parts):
            poses[shape.name] = np.column_stack(whole)
    return Trace(
        t[keep],
        {name: values for name, values in thinned.items() if not name.startswith("pose_")},
        poses,
    )


def _part(columns: Mapping[str, Array], place: str | float, length: int) -> Array | None:
    if not isinstance(place, str):
        return np.full(length, place)
    values = columns.get(place)
    return values if values is not None and len(values) == length else None


def contact_phases(trace: Trace | None, contact: str) -> list[tuple[float, float]]:
    """Return intervals of contact, by a gap that is not positive, or without gaps by a force."""
    if trace is None:
        return []
    gaps, forces = trace.gap(contact), trace.force(contact)
    if gaps is not None:
        touching = gaps <= 0
    elif forces is not None:
        touching = np.abs(forces) > _FORCE_OF_CONTACT  # friction has two directions
    else:
        return []
    times = trace.t[: len(touching)]
    changes = np.flatnonzero(np.diff(touching, prepend=False, append=False))
    # A phase ends at the first time without contact, or at the last time.
    ends = times[np.minimum(changes, len(times) - 1)].tolist()
    return list(zip(ends[::2], ends[1::2], strict=True))


def at_all(times: Sequence[float] | Array, values: Sequence[float] | Array, wanted: Array) -> Array:
    """Return values at wanted times, linear, and constant outside.

    Parameters
    ----------
    times
        (n,) [s], increasing.
    values
        (n,) or (n - 1,) [any unit].
    wanted
        (k,) [s].

    Returns
    -------
    np.ndarray
        (k,) [unit of `values`].

    Raises
    ------
    ValueError
        Without values.
    """
    length = min(len(times), len(values))
    return np.interp(wanted, times[:length], values[:length])
