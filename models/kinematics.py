"""Where a scene's bodies are drawn and how far its contacts are apart, at given positions: what files of plans and replays hold for those who know no scene.

# x, y and angle of every shape;    gap_columns(scene, q, "node")      # the gap of every contact
pose_columns(scene, q, "node")
goal_poses(scene)                   # where the goal puts every shape
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import sympy as sp

from models.dynamics import derive
from models.netcdf import Column, as_columns
from models.scene import Scene


def pose_columns(scene: Scene, q: np.ndarray, dimension: str) -> list[Column]:
    """Where each shape is drawn: columns `pose_x_<n>`, `pose_y_<n>` [m] and `pose_angle_<n>` [rad] of the n-th shape, from 1.

    Numbers, because a shape may have any name, and NetCDF does not allow all of them; the name
    stands in the description.

    Parameters
    ----------
    q
        Positions (n, nq) [m, rad].
    dimension
        Along which the columns lie.

    Returns
    -------
    list[Column]
        Three columns a shape (n,); of what never changes one value, along a dimension of its own: more than half of them.

    Raises
    ------
    TypeError
        For another number of coordinates.
    """
    expressions = [value for shape in scene.shapes for value in (shape.x, shape.y, shape.angle)]
    named = [
        (f"pose_{part}_{place}", unit, f"{part} of {shape.name}")
        for place, shape in enumerate(scene.shapes, 1)
        for part, unit in (("x", "m"), ("y", "m"), ("angle", "rad"))
    ]
    moving = {coordinate.symbol for coordinate in scene.coordinates}
    return [
        column
        if expression.free_symbols & moving
        else replace(column, dimension="once", values=column.values[:1])
        for column, expression in zip(
            as_columns(named, evaluate(scene, expressions, q), dimension), expressions, strict=True
        )
    ]


def gap_columns(scene: Scene, q: np.ndarray, dimension: str) -> list[Column]:
    """The gap -phi(q) [m] of every contact, negative in contact.

    Parameters
    ----------
    q
        Positions (n, nq) [m, rad].
    dimension
        Along which the columns lie.

    Returns
    -------
    list[Column]
        A column (n,) a contact.

    Raises
    ------
    TypeError
        For another number of coordinates.
    """
    named = [
        (item.gap_name, "m", f"gap, negative in contact, {item.description or item.name}")
        for item in scene.contacts
    ]
    return as_columns(named, -evaluate(scene, list(derive(scene).penetration), q), dimension)


def goal_poses(scene: Scene) -> list[tuple[float, float, float | None] | None]:
    """Where the task's goal puts each shape.

    Returns
    -------
    list[tuple[float, float, float | None] | None]
        x, y [m] and angle [rad] of each shape, the angle None where the goal leaves it open; None
        for a shape whose place it leaves open, or that never moves.
    """
    moving = {coordinate.symbol for coordinate in scene.coordinates}
    ends = {
        item.symbol: value
        for item, value in zip(scene.coordinates, scene.task.goal, strict=False)
        if value is not None
    }
    found = []
    for shape in scene.shapes:
        parts = (shape.x, shape.y, shape.angle)
        numbers = [part.subs(scene.parameter_values).subs(ends) for part in parts]
        x, y, angle = (None if part.free_symbols else float(part) for part in numbers)
        moves = any(part.free_symbols & moving for part in parts)
        found.append((x, y, angle) if moves and x is not None and y is not None else None)
    return found


def evaluate(scene: Scene, expressions: list[sp.Expr], q: np.ndarray) -> np.ndarray:
    """Values of expressions in the coordinates; constants are repeated.

    Parameters
    ----------
    expressions
        In coordinates and parameters.
    q
        Positions (n, nq) [m, rad].

    Returns
    -------
    np.ndarray
        (n, len(expressions)), in the units of the expressions [SI].

    Raises
    ------
    TypeError
        For another number of coordinates.
    """
    if not expressions:
        return np.zeros((len(q), 0))
    symbols = [coordinate.symbol for coordinate in scene.coordinates]
    numbers = [expression.subs(scene.parameter_values) for expression in expressions]
    values = sp.lambdify(symbols, numbers, modules=[np], cse=True)(*q.T)
    return np.column_stack([np.broadcast_to(value, len(q)) for value in values]).astype(float)
