"""Thin copies of plans and replays for plots: at most 1500 points, with the poses of the shapes at the same times."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import sympy as sp

from models.dynamics import derive
from models.scene import Scene
from models.trajectory import Trajectory
from reports.trace_record import Pose, TraceRecord

if TYPE_CHECKING:
    from validate.replay.result import Replay

LONGEST = 1500


def thin(points: int, longest: int = LONGEST) -> np.ndarray:
    """Indices of at most `longest` of `points` points, evenly spread, with the first and the last."""
    return np.unique(np.linspace(0, points - 1, min(points, longest)).round().astype(int))


def plan_trace(scene: Scene, trajectory: Trajectory) -> TraceRecord:
    """q, v, u, lam, friction and gap of a plan; quantities of steps have one value less."""
    keep = thin(len(trajectory.t))
    steps = keep[keep < trajectory.steps]
    q = trajectory.q[keep]
    lam, friction = np.split(trajectory.lam[steps], [scene.nc], axis=1)
    columns = _columns(scene, q=q, v=trajectory.v[keep], u=trajectory.u[steps], lam=lam, friction=friction, gap=_gap(scene, q))
    return TraceRecord(t=_numbers(trajectory.t[keep]), columns=columns, poses=poses(scene, q))


def replay_trace(scene: Scene, trajectory: Trajectory, replay: Replay) -> TraceRecord:
    """q, v, lam, friction, gap of a replay, and `position_error`: the largest difference of a coordinate to the plan; of a tracked one also u as applied
    (at the start of the step that a point lies in)."""
    keep = thin(len(replay.t))
    q = np.asarray(replay.q)[keep]
    lam = np.asarray(replay.lam)[keep]
    friction = np.asarray(replay.friction)[keep] if scene.nf else np.zeros((len(keep), 0))
    columns = _columns(scene, q=q, v=np.asarray(replay.v)[keep], lam=lam, friction=friction, gap=_gap(scene, q))
    knots = np.asarray(replay.knots)
    if len(knots) == 0:
        return TraceRecord(t=_numbers(replay.t[keep]), columns=columns, poses=poses(scene, q))
    applied = getattr(replay, "applied", None)
    if applied is not None and len(applied):
        step = np.clip(np.searchsorted(knots, keep, side="right") - 1, 0, len(applied) - 1)
        columns |= _columns(scene, u=np.asarray(applied)[step])
    difference = np.abs(np.asarray(replay.q)[knots] - trajectory.q[: len(knots)]).max(axis=1)
    # The plan is known at its nodes only: between them its error is drawn as a line.
    columns["position_error"] = _numbers(np.interp(replay.t[keep], replay.t[knots], difference))
    return TraceRecord(t=_numbers(replay.t[keep]), columns=columns, poses=poses(scene, q))


def poses(scene: Scene, q: np.ndarray) -> dict[str, tuple[Pose, ...]]:
    """(x, y, angle) of every shape at positions q (n, nq) [m, m, rad]."""
    found: dict[str, tuple[Pose, ...]] = {}
    for shape in scene.shapes:
        values = _function(scene, [shape.x, shape.y, shape.angle])(q)
        found[shape.name] = tuple((x, y, angle) for x, y, angle in values.tolist())
    return found


def _gap(scene: Scene, q: np.ndarray) -> np.ndarray:
    """(n, nc) gaps -phi(q) [m]."""
    return -_function(scene, list(derive(scene).penetration))(q)


def _function(scene: Scene, expressions: list[sp.Expr]) -> Callable[[np.ndarray], np.ndarray]:
    """A function of q (n, nq) that gives (n, len(expressions)); constants are repeated."""
    symbols = [coordinate.symbol for coordinate in scene.coordinates]
    numbers = [sp.sympify(expression).subs(scene.parameter_values) for expression in expressions]
    compiled = sp.lambdify(symbols, numbers, modules="numpy", cse=True)

    def evaluate(q: np.ndarray) -> np.ndarray:
        values = compiled(*q.T)
        return np.column_stack([np.broadcast_to(value, len(q)) for value in values]) if values else np.zeros((len(q), 0))

    return evaluate


def _columns(scene: Scene, **groups: np.ndarray) -> dict[str, tuple[float, ...]]:
    names = {
        "q": [item.name for item in scene.coordinates],
        "v": [item.velocity_name for item in scene.coordinates],
        "u": [item.name for item in scene.inputs],
        "lam": [item.force_name for item in scene.contacts],
        "friction": [item.force_name for item in scene.frictions],
        "gap": [item.gap_name for item in scene.contacts],
    }
    return {name: _numbers(array[:, index]) for group, array in groups.items() for index, name in enumerate(names[group])}


def _numbers(array: np.ndarray) -> tuple[float, ...]:
    return tuple(array.tolist())
