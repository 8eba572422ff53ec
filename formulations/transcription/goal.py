"""The goal of a built model as a ball instead of a point."""

from __future__ import annotations

from typing import Any

import pyomo.environ as pyo


def open_goal(model: Any, ball: float) -> None:
    """Let the plan end within `ball` of the goal, in the norm of (q, v); 0 leaves the goal as it is."""
    if ball == 0.0:
        return
    last = max(model.set_nodes)
    parts = ((model.variable_q, model.parameter_goal_position), (model.variable_v, model.parameter_goal_velocity))
    model.constraint_goal_position.deactivate()
    model.constraint_goal_velocity.deactivate()
    # in units of the ball: its multiplier then has the size of the cost, however small the ball is
    miss = sum(((state[last, name] - goal[name]) / ball) ** 2 for state, goal in parts for name in model.set_coordinates)
    model.constraint_goal_ball = pyo.Constraint(expr=miss <= 1.0)
