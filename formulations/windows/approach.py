"""From contact modes that miss the goal to modes that reach it: the same search over windows, with the miss as a price that rises.

    answer = approach(problem, closed, stride, is_over)          # closed: the modes of a rollout, whatever it ends at

The modes of a rollout always have a plan if the goal need not be met. Its cost is sum_t cost + |z[T] - goal|^2 / (2 softness); windows are
searched for less of it, the softness falls, until the modes found have a plan that meets the goal. Steering one rollout stops where a contact
would have to begin or end; here that is a neighbour like any other, and the multipliers of touching pairs say which.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from formulations.windows.quadratic import ModesAnswer, ModesProblem
from formulations.windows.search import search_windows
from models.goal import distance

_FIRST = 0.05  # the first miss is worth twenty times the cost of the inputs
_FALL, _LEVELS = 0.02, 4
_TRIES = 120  # modes tried at a level


def approach(problem: ModesProblem, closed: np.ndarray, stride: int, is_over: Callable[[], bool]) -> ModesAnswer | None:
    """The optimum of modes that meet the goal, or None where none were found."""
    linear = problem.linear
    try:
        problem.softness = 1.0
        answer = problem.solve(closed)
        if answer is None:
            return None
        problem.softness = _FIRST * distance(answer.point.z[-1], linear.goal) ** 2 / max(linear.cost(answer.point.z[:-1], answer.u), 1e-12)
        for _ in range(_LEVELS):
            softness = problem.softness
            if not softness > 0.0:
                return None
            answer = problem.solve(closed)
            if answer is None:
                return None
            last = problem.solves + _TRIES
            found = search_windows(
                answer,
                lambda modes, near, below: problem.solve(modes, near=near, below=below),
                stride=stride,
                is_over=lambda last=last: is_over() or problem.solves > last,
            )
            closed, problem.softness = found.best.closed, 0.0
            answer = problem.solve(closed)
            if answer is not None or is_over():
                return answer
            problem.softness = softness * _FALL
        return None
    finally:
        problem.softness = 0.0
