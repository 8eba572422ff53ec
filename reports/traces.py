"""Motions of a stage, read from the NetCDF files beside its record and thinned for plots: columns by name, phases of contact, a value between two times.

    motion = read_motion(Path("runs/all/runs/<key>"), run, stage);
        motion.plan.columns["q1"], motion.replay.poses["left"]

A column is as long as the times or shorter (quantities of steps: one less). What a file lacks, or
holds as something else than finite numbers, is missing here, and is shown as missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from reports.records.record import RunRecord, SceneRecord, StageRecord, stage_files, thin

Array = NDArray[np.float64]
# A planned force below this is none: a thousandth of the smallest force worth drawing [N].
_FORCE_OF_CONTACT = 1e-3
# What a damaged file raises where it is read.
_DAMAGED = (OSError, ValueError, KeyError, TypeError, RuntimeError)


@dataclass(frozen=True, eq=False)
class Trace:
    """One motion at times t (n,) [s].

    columns: coordinates and inputs by their names, per contact `lam_<contact>` [N] and
        `gap_<contact>` [m], per friction its force [N] by its name; of a
    replay also `position_error`, the largest difference of a coordinate to the plan. poses: (n, 3)
        x, y [m] and angle [rad] of each shape.
    """

    t: Array
    columns: Mapping[str, Array]
    poses: Mapping[str, Array] = field(default_factory=dict)

    def force(self, contact: str) -> Array | None:
        """The force of a contact by its name, or of a friction by its force's.

        Returns
        -------
        values : (n - 1,) or (n,) [N], or None if the trace lacks it.
        """
        return self.columns.get(f"lam_{contact}", self.columns.get(contact))

    def gap(self, contact: str) -> Array | None:
        """The gap of a contact by its name.

        Returns
        -------
        values : (n,) [m], or None if the trace lacks it.
        """
        return self.columns.get(f"gap_{contact}")


@dataclass(frozen=True)
class Motion:
    """What is stored of a stage's motion; tracked: the replay with feedback.

    problems: sentences about files that cannot be read.
    """

    plan: Trace | None = None
    replay: Trace | None = None
    tracked: Trace | None = None
    problems: tuple[str, ...] = ()

    def judged(self, stage: StageRecord) -> Trace | None:
        """The motion of the replay that the verdict of the stage is of."""
        return self.tracked if stage.is_tracked else self.replay


def read_motion(folder: Path, run: RunRecord, stage: StageRecord) -> Motion:
    """Plan and replays of a stage of a run; folder: of its record."""
    if not stage.has_plan:
        return Motion()
    files, problems = stage_files(stage.index, len(run.stages)), []
    wanted = {"trajectory": True, "replay": stage.replay is not None, "tracked": stage.is_followed}
    found: dict[str, Mapping[str, Array]] = {what: {} for what in wanted}
    for what in (what for what, there in wanted.items() if there):
        try:
            found[what] = _columns(folder / files[what], run.scene)
        except _DAMAGED as error:
            problems.append(f"{files[what]} cannot be read ({_reason(error)}).")
    replay, tracked = (_replay(run.scene, found[what]) for what in ("replay", "tracked"))
    return Motion(_plan(run.scene, found["trajectory"]), replay, tracked, tuple(problems))


def read_plan(folder: Path, run: RunRecord, stage: StageRecord) -> Trace | None:
    """The plan of a stage alone; None where there is none that can be read."""
    return (
        read_trace(folder / stage_files(stage.index, len(run.stages))["trajectory"], run.scene)
        if stage.has_plan
        else None
    )


def read_trace(path: Path, scene: SceneRecord) -> Trace | None:
    """One motion from its file; None where there is none that can be read."""
    try:
        return _plan(scene, _columns(path, scene))
    except _DAMAGED:
        return None


def _reason(error: Exception) -> str:
    """The first line of what is said of a file; HDF5 says much more, with addresses."""
    return (
        "there is no such file"
        if isinstance(error, FileNotFoundError)
        else str(error).partition("\n")[0][:160] or type(error).__name__
    )


def _columns(path: Path, scene: SceneRecord) -> dict[str, Array]:
    """What is drawn of a file, of its columns of finite numbers along one dimension.

    Raises one of _DAMAGED.
    """
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
    found = {}
    with h5py.File(path, "r") as file:
        there = set(file)
        for name in names:
            if name not in there:
                continue
            # By HDF5's own calls: h5py's Dataset takes twice as long for columns as short as these.
            stored = h5py.h5d.open(file.id, name.encode())
            if len(stored.shape) == 1 and stored.dtype.kind in "fiu":
                values = np.empty(stored.shape, float)
                stored.read(h5py.h5s.ALL, h5py.h5s.ALL, values)
                if np.isfinite(values).all():
                    found[name] = values
    return found


def _plan(scene: SceneRecord, columns: Mapping[str, Array]) -> Trace | None:
    if not len(columns.get("t", ())):
        return None
    return _thinned(
        scene, columns["t"], {name: values for name, values in columns.items() if name != "t"}
    )


def _replay(scene: SceneRecord, columns: Mapping[str, Array]) -> Trace | None:
    """A replay with the inputs as applied, by their own names.

    Its distance from the plan is linear between the plan's nodes.
    """
    if not len(columns.get("t", ())):
        return None
    t, told = columns["t"], dict(columns)
    knots = told.pop("knots", np.zeros(0)).astype(int)
    away = told.pop("position_error", np.zeros(0))
    if len(knots) and knots.min() >= 0 and knots.max() < len(t):
        rows = np.arange(len(t))
        for item in scene.inputs:
            applied = told.pop(f"applied_{item.name}", None)
            if applied is not None and len(applied):
                told[item.name] = applied[
                    np.clip(np.searchsorted(knots, rows, side="right") - 1, 0, len(applied) - 1)
                ]
        if len(away) == len(knots):
            told["position_error"] = np.interp(t, t[knots], away)
    return _thinned(scene, t, told)


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
    """Return a part of a pose at every time: a constant, or a column that is as long."""
    if not isinstance(place, str):
        return np.full(length, place)
    values = columns.get(place)
    return values if values is not None and len(values) == length else None


def contact_phases(trace: Trace | None, contact: str) -> list[tuple[float, float]]:
    """Intervals of time in contact: where the gap is not positive, or where a force acts if no gap is stored."""
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
    # A phase ends at the first time without contact; one that lasts to the end, with the last time.
    ends = times[np.minimum(changes, len(times) - 1)].tolist()
    return list(zip(ends[::2], ends[1::2], strict=True))


def at_all(times: Sequence[float] | Array, values: Sequence[float] | Array, wanted: Array) -> Array:
    """The values at many times, linear between the stored times and constant beyond them.

    Parameters
    ----------
    times : (n,) [s], increasing
    values : (n,) or (n - 1,), in any unit; the shorter of the two decides
    wanted : (k,) [s]

    Returns
    -------
    values : (k,), in the unit of `values`
    """
    length = min(len(times), len(values))
    return np.interp(wanted, times[:length], values[:length])
