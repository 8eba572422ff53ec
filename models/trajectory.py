"""A plan: what a method found, or what a user brings.

    t    (nodes,)       time [s], increasing, nodes = steps + 1
    q, v (nodes, nq)    generalised positions [m, rad] and velocities
    u    (steps, nu)    inputs, held over each step as `hold` says
    lam  (steps, nl)    contact forces [N] at the *start* of each step: lam[i] belongs to phi(q[i]); behind them the friction
                        forces of the step, which belong to the slip at its end
    scheme              the time step it is made of (models.schemes): which equations q, v, u, lam solve, and so what its defect is
    missing             which of "v" and "lam" its author did not say; the arrays then hold stand-ins (see `read_csv`)

CSV: one row a node, columns `t`, then the scene's names (`q1 ... v1 ... u1 ... lam_left ...`); the last row has no u and lam.
NetCDF-4: the same arrays with units, for the store.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from models.errors import TrajectoryError
from models.plan_table import PlanTable
from models.scene import Scene
from models.schemes import Scheme


class Hold(Enum):
    """How an input behaves within a step."""

    ZERO_ORDER = "zero_order"  # constant
    LINEAR = "linear"  # towards the next step's value; the last step is constant


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """See the module docstring. Raises TrajectoryError for wrong shapes, NaN, or times that do not increase."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    hold: Hold = Hold.ZERO_ORDER
    scheme: Scheme = Scheme.SEMI_IMPLICIT_EULER
    missing: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        for field in ("t", "q", "v", "u", "lam"):
            array = np.array(getattr(self, field), dtype=float)
            if not np.isfinite(array).all():
                where = tuple(int(index) for index in np.argwhere(~np.isfinite(array))[0])
                raise TrajectoryError(f"plan: {field}{list(where)} is {array[where]}; every value must be a finite number.")
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        nodes = self.t.size
        if self.t.ndim != 1 or nodes < 2:
            raise TrajectoryError(f"plan: t has shape {self.t.shape}; at least two times in one column are needed.")
        if not (np.diff(self.t) > 0).all():
            index = int(np.argmin(np.diff(self.t) > 0))
            raise TrajectoryError(
                f"plan: time must increase, but t[{index + 1}] = {self.t[index + 1]:g} follows t[{index}] = {self.t[index]:g}."
            )
        for field, rows in (("q", nodes), ("v", nodes), ("u", nodes - 1), ("lam", nodes - 1)):
            shape = getattr(self, field).shape
            if len(shape) != 2 or shape[0] != rows:
                raise TrajectoryError(f"plan: {field} has shape {shape}; {rows} rows are needed ({nodes} nodes, {nodes - 1} steps).")
        if self.scheme is not Scheme.SEMI_IMPLICIT_EULER and self.hold is not Hold.ZERO_ORDER:
            raise TrajectoryError(
                f"plan: scheme {self.scheme.value} holds its inputs over each step, so hold must be {Hold.ZERO_ORDER.value}."
            )
        if self.q.shape != self.v.shape:
            raise TrajectoryError(f"plan: q has shape {self.q.shape} but v has {self.v.shape}; they must agree.")

    @property
    def steps(self) -> int:
        return self.t.size - 1

    @property
    def start(self) -> np.ndarray:
        """(2*nq,) state at the first node."""
        return np.concatenate([self.q[0], self.v[0]])

    @property
    def end(self) -> np.ndarray:
        """(2*nq,) state at the last node."""
        return np.concatenate([self.q[-1], self.v[-1]])

    def check_fits(self, scene: Scene) -> None:
        """Raise TrajectoryError if the numbers of positions, inputs or contacts are not those of the scene."""
        for field, found, expected, what in (
            ("q", self.q.shape[1], scene.nq, "positions"),
            ("u", self.u.shape[1], scene.nu, "inputs"),
            ("lam", self.lam.shape[1], scene.nl, "contacts and frictions" if scene.nf else "contacts"),
        ):
            if found != expected:
                raise TrajectoryError(f"plan: {field} has {found} columns, but scene {scene.name} has {expected} {what}.")

    def other_duration(self, scene: Scene) -> str:
        """A sentence if the plan does not last as long as the scene's task, else nothing: what is asked by then is not asked later."""
        lasts, asked = float(self.t[-1] - self.t[0]), scene.task.horizon
        if math.isclose(lasts, asked, rel_tol=1e-9):
            return ""
        return f"it lasts {lasts:.6g} s, but the task of scene {scene.name} {asked:.6g} s."

    def has_uniform_grid(self) -> bool:
        """Whether all steps are equal to rounding."""
        return bool(np.allclose(np.diff(self.t), (self.t[-1] - self.t[0]) / self.steps, rtol=1e-9, atol=0.0))


def uniform_grid(step: float, steps: int, start: float = 0.0) -> np.ndarray:
    """(steps + 1,) times start + n*step, never a running sum."""
    return start + step * np.arange(steps + 1)


def column_names(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Names of the columns of q, v, u, lam in files and FMUs."""
    return {
        "q": tuple(coordinate.name for coordinate in scene.coordinates),
        "v": tuple(coordinate.velocity_name for coordinate in scene.coordinates),
        "u": tuple(item.name for item in scene.inputs),
        "lam": scene.force_names,
    }


def write_csv(path: Path, trajectory: Trajectory, scene: Scene) -> None:
    """Write a plan as CSV (17 significant digits: it reads back bit for bit)."""
    trajectory.check_fits(scene)
    names = column_names(scene)
    lines = [",".join(["t", *names["q"], *names["v"], *names["u"], *names["lam"]])]
    for index in range(trajectory.steps + 1):
        values = [trajectory.t[index], *trajectory.q[index], *trajectory.v[index]]
        cells = [repr(float(value)) for value in values]
        if index < trajectory.steps:
            cells += [repr(float(value)) for value in (*trajectory.u[index], *trajectory.lam[index])]
        else:
            cells += [""] * (len(names["u"]) + len(names["lam"]))
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_csv(path: Path, scene: Scene, hold: Hold = Hold.ZERO_ORDER) -> Trajectory:
    """Read a plan written by anybody: cells apart by comma, semicolon (then 0,5 is a number too) or tab; lines with # are comments.

    A column may say its unit, `q1 [m]`, which must then be the scene's. Velocity and `lam_*` columns may be absent; the plan says so in
    `missing`. Forces are then 0, velocities backward differences (those of semi-implicit Euler) with the task's velocities at the start if
    the plan starts at the task's positions.
    Raises TrajectoryError naming the file, the line and the column.
    """
    table = PlanTable(path)
    header, names = table.names, column_names(scene)
    known = ["t", *(name for group in names.values() for name in group)]
    table.check_form()
    for column in header:
        if column not in known:
            hint = _meant(column, known)
            raise TrajectoryError(f"plan {path}: the column {column!r} is unknown; {hint}scene {scene.name} has {', '.join(known)}.")
    for column in ("t", *names["q"], *names["u"]):
        if column not in header:
            raise TrajectoryError(f"plan {path}: the column {column!r} is missing; it has {', '.join(header)}.")
    for column, unit in _units(scene).items():
        table.check_unit(column, unit)
    columns = {column: table.column(column, last_is_open=column in (*names["u"], *names["lam"])) for column in header}
    t = columns["t"]
    q = np.column_stack([columns[name] for name in names["q"]])
    if all(name in columns for name in names["v"]):
        v = np.column_stack([columns[name] for name in names["v"]])
    elif np.isfinite(t).all() and (np.diff(t) > 0).all():
        v = _velocities(t, q, scene)
    else:
        v = np.zeros_like(q)  # the times are refused below, in Trajectory's words
    missing = frozenset(group for group in ("v", "lam") if not all(name in columns for name in names[group]))
    steps = len(t) - 1
    u = np.column_stack([columns[name] for name in names["u"]]) if names["u"] else np.zeros((steps, 0))
    forces = [columns.get(name, np.zeros(steps)) for name in names["lam"]]
    lam = np.column_stack(forces) if forces else np.zeros((steps, 0))
    try:
        return Trajectory(t=t, q=q, v=v, u=u, lam=lam, hold=hold, missing=missing)
    except TrajectoryError as error:
        raise TrajectoryError(f"{error} (file {path})") from error


def _meant(column: str, known: list[str]) -> str:
    """What somebody who wrote this may have meant, as the beginning of a sentence; nothing if no name is near."""
    folded = {name.lower(): name for name in known}
    folded.setdefault("time", "t")
    close = difflib.get_close_matches(column.lower(), folded, n=1)
    return f"did you mean {folded[close[0]]!r}? " if close else ""


def _units(scene: Scene) -> dict[str, str]:
    """Column -> the unit it is in."""
    return {
        "t": "s",
        **{item.name: item.unit for item in (*scene.coordinates, *scene.inputs)},
        **{item.velocity_name: item.velocity_unit for item in scene.coordinates},
        **dict.fromkeys(scene.force_names, "N"),
    }


def _velocities(t: np.ndarray, q: np.ndarray, scene: Scene) -> np.ndarray:
    """(nodes, nq) backward differences; see `read_csv` for the first."""
    v = np.diff(q, axis=0) / np.diff(t)[:, None]
    at_start = np.allclose(q[0], scene.task.start[: scene.nq], rtol=1e-9, atol=1e-9)
    return np.vstack([scene.task.start[scene.nq :] if at_start else v[0], v])
