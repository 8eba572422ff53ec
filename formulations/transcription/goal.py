"""The goal of a built model as a ball instead of a point."""

from __future__ import annotations

from typing import Any

import pyomo.environ as pyo


def open_goal(model: Any, ball: float) -> None:
    """Let the plan end within `ball` of the goal, in the norm of (q, v); 0 leaves the goal as it is, and a free end stays free."""
    if ball == 0.0:
        return
    given = release_goal(model)
    if given:
        # in units of the ball: its multiplier then has the size of the cost, however small the ball is
        model.parameter_goal_ball = radius = pyo.Param(initialize=ball, mutable=True)
        model.constraint_goal_ball = pyo.Constraint(expr=sum(((state - goal) / radius) ** 2 for state, goal, _ in given) <= 1.0)


def move_ball(model: Any, ball: float) -> None:
    """Another radius for the ball that `open_goal` has put around the goal; nothing where there is none."""
    if model.component("parameter_goal_ball") is not None:
        model.parameter_goal_ball.value = ball


def release_goal(model: Any) -> list[tuple[Any, Any, str]]:
    """Take the goal's constraints out; returns (last state, goal, coordinate) of every component that was given."""
    last = max(model.set_nodes)
    given = []
    for part, variable in (("position", model.variable_q), ("velocity", model.variable_v)):
        constraint, goal = model.component(f"constraint_goal_{part}"), model.component(f"parameter_goal_{part}")
        if constraint is not None:
            constraint.deactivate()
            given += [(variable[last, name], goal[name], name) for name in goal]
    return given
