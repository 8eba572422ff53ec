"""Poses of a scene's shapes and gaps of its contacts at given positions, for files of plans.

shape_places(scene)  # constant parts of a pose, and coordinates
pose_columns(scene, q, "node")  # the other parts
gap_columns(scene, q, "node")  # the gap of every contact
goal_poses(scene)  # poses of the shapes at the goal
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import sympy as sp

from models.dynamics import derive
from models.netcdf import Column, as_columns, drawn
from models.scene import Scene

# Functions of expressions by scene; compiling one takes up to 0.3 s.
_COMPILED: WeakKeyDictionary[Scene, dict[tuple[sp.Expr, ...], Callable[..., list[Any]]]] = (
    WeakKeyDictionary()
)


def shape_places(
    scene: Scene,
) -> list[tuple[float | str | None, float | str | None, float | str | None]]:
    """Return x, y [m] and angle [rad] of each shape, as number, coordinate name or None.

    None is another function of the coordinates, which files store (`pose_columns`).
    """
    names = {coordinate.symbol: coordinate.name for coordinate in scene.coordinates}

    def place(expression: sp.Expr) -> float | str | None:
        if expression in names:
            return names[expression]
        value = expression.subs(scene.parameter_values)
        return None if value.free_symbols else float(value)

    return [(place(item.x), place(item.y), place(item.angle)) for item in scene.shapes]


def pose_columns(scene: Scene, q: np.ndarray, dimension: str) -> list[Column]:
    """Return the pose columns that `shape_places` leaves open, (n,) in single precision.

    Columns are `pose_x_<n>`, `pose_y_<n>` [m] and `pose_angle_<n>` [rad] of the n-th shape, from 1,
    because NetCDF does not allow all names of shapes. q is (n, nq) [m, rad]. Raises TypeError for
    another number of coordinates.
    """
    parts = [
        (f"pose_{part}_{number}", unit, f"{part} of {shape.name}", getattr(shape, part))
        for number, (shape, places) in enumerate(
            zip(scene.shapes, shape_places(scene), strict=True), 1
        )
        for part, unit, place in zip(("x", "y", "angle"), ("m", "m", "rad"), places, strict=True)
        if place is None
    ]
    values = evaluate(scene, [expression for *_, expression in parts], q)
    return as_columns([part[:3] for part in parts], drawn(values), dimension)


def gap_columns(scene: Scene, q: np.ndarray, dimension: str) -> list[Column]:
    """Return a column (n,) with the gap -phi(q) [m] of every contact, in single precision.

    q is (n, nq) [m, rad]. Raises TypeError for another number of coordinates.
    """
    named = [
        (item.gap_name, "m", f"gap, negative in contact, {item.description or item.name}")
        for item in scene.contacts
    ]
    gaps = -evaluate(scene, list(derive(scene).penetration), q)
    return as_columns(named, drawn(gaps), dimension)


def goal_poses(scene: Scene) -> list[tuple[float, float, float | None] | None]:
    """Return x, y [m] and angle [rad] of each shape at the task's goal.

    The angle is None if the goal leaves it open; the pose is None if the place is open or constant.
    """
    moving = {coordinate.symbol for coordinate in scene.coordinates}
    ends = {
        item.symbol: value
        for item, value in zip(scene.coordinates, scene.task.goal, strict=False)
        if value is not None
    }
    poses = []
    for shape in scene.shapes:
        parts = (shape.x, shape.y, shape.angle)
        numbers = [part.subs(scene.parameter_values).subs(ends) for part in parts]
        x, y, angle = (None if part.free_symbols else float(part) for part in numbers)
        moves = any(part.free_symbols & moving for part in parts)
        poses.append((x, y, angle) if moves and x is not None and y is not None else None)
    return poses


def evaluate(scene: Scene, expressions: list[sp.Expr], q: np.ndarray) -> np.ndarray:
    """Return values (n, len(expressions)) [SI] at positions q (n, nq) [m, rad].

    Raises TypeError for another number of coordinates.
    """
    if not expressions:
        return np.zeros((len(q), 0))
    compiled, key = _COMPILED.setdefault(scene, {}), tuple(expressions)
    if key not in compiled:
        symbols = [coordinate.symbol for coordinate in scene.coordinates]
        numbers = [expression.subs(scene.parameter_values) for expression in expressions]
        compiled[key] = sp.lambdify(symbols, numbers, modules=[np], cse=True)
    values = compiled[key](*q.T)
    return np.column_stack([np.broadcast_to(value, len(q)) for value in values]).astype(float)
