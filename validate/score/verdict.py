"""From figures and limits to a verdict, and the sentence that says which figure decided.

The rule: a figure is judged only where ten times its error does not reach from its value to its limit, that is,

    value + 10 error <= limit   -> below          value - 10 error > limit   -> above          otherwise not resolved

so that a figure of 1e-9 with an error of 1e-4 is rightly below a limit of 1e-2, and one of 0.0599 with the same error is not judged
against 0.06. The error is that of the replay; figures of the plan alone have none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from validate.score.result import Figure, Verdict

MARGIN = 10.0

# Contact physics, judged apart from what the time step costs: figures that need no replay.
CONTACT = (
    "physics", "physics_scaled", "law_error", "discrete_terminal_error", "discrete_terminal_position_error",
    "friction_violation", "friction_dissipation_error",
)  # fmt: skip
# Figures of the replay in continuous time, and what they are called where the replay is the tracked one.
TWINS = {
    "replay_terminal_error": "tracked_terminal_error",
    "replay_terminal_position_error": "tracked_terminal_position_error",
    "replay_error": "tracked_replay_error",
    "grid_error": "tracked_grid_error",
    "ghost_impulse": "tracked_ghost_impulse",
    "missed_impulse": "tracked_missed_impulse",
    "friction_impulse_error": "tracked_friction_impulse_error",
    "max_penetration": "tracked_max_penetration",
    "energy_residual": "tracked_energy_residual",
    "energy_residual_relative": "tracked_energy_residual_relative",
}
EFFORT = "feedback_effort"
GRID = (*TWINS, "answer_error", *TWINS.values(), EFFORT)

# What each figure says when it is quoted; the first in this order that is above its limit leads the sentence.
_PHRASES = {
    "replay_terminal_position_error": "the replay misses the goal by {}",
    "replay_terminal_error": "the replay misses the goal state by {}",
    "discrete_terminal_position_error": "with the true contact law the plan's own time step misses the goal by {}",
    "discrete_terminal_error": "with the true contact law the plan's own time step misses the goal state by {}",
    "terminal_position_error": "the plan misses the goal by {}",
    "terminal_error": "the plan misses the goal state by {}",
    "replay_error": "the replay leaves the plan by {}",
    "law_error": "the true contact law leads the plan's inputs astray by {}",
    "grid_error": "the plan's time step is off the continuous motion by {}",
    "physics_scaled": "the contact forces are not complementary by {} (scaled)",
    "physics": "the contact forces are not complementary by {}",
    "defect": "the plan misses its own time step by {}",
    "start_error": "the plan starts {} away from the task's start",
    "bound_violation": "the inputs leave their bounds by {}",
    "velocity_bound_violation": "the velocities leave their bounds by {}",
    "ghost_impulse": "force from a distance of {}",
    "missed_impulse": "contact force that the plan does not have of {}",
    "friction_violation": "a planned friction force exceeds mu N by {}",
    "friction_dissipation_error": "the plan slips without all of mu N holding it back, by {}",
    "friction_impulse_error": "the replay's friction differs from the plan's by {}",
    "max_penetration": "the bodies penetrate by {}",
    "answer_error": "the replay is {} tolerances off a closed form of the scene",
    "energy_residual": "the replay's energy does not balance by {}",
    "energy_residual_relative": "the replay's energy does not balance by {} of what is turned over",
}
_PHRASES |= {twin: f"with feedback {_PHRASES[name]}" for name, twin in TWINS.items()}
_PHRASES[EFFORT] = "the feedback takes {} of half the inputs' range (root mean square)"
_ARRIVAL = frozenset(name for name in _PHRASES if "terminal" in name) | {"replay_error", "tracked_replay_error", "law_error"}
# Of the plan alone: where one is above its limit, the replay's inputs, start or motion are not the plan's to begin with.
_OWN = ("bound_violation", "start_error", "defect")
# A ghost impulse is named as the cause from this share of the planned contact impulse on.
_GHOST_SHARE = 0.01


def compare(value: float, error: float, limit: float) -> tuple[bool | None, bool]:
    """(ok, resolved) of a value against its limit by the rule of the module docstring."""
    if value + MARGIN * error <= limit:
        return True, True
    if value - MARGIN * error > limit:
        return False, True
    return None, False


def verdict_of(figures: Iterable[Figure]) -> Verdict:
    """Of the limited figures: one above violates; else one unmeasured or unresolved (or none at all) is not resolved; else it holds."""
    judged = [figure for figure in figures if figure.is_judged]
    if any(figure.ok is False for figure in judged):
        return Verdict.VIOLATES
    if not judged or any(figure.ok is None for figure in judged):
        return Verdict.NOT_RESOLVED
    return Verdict.HOLDS


def explain(figures: Sequence[Figure], verdict: Verdict, planned_impulse: float) -> str:
    """The sentence: what decided, why, and what else. planned_impulse: sum of the plan's contact forces over time [N s]."""
    by_name = {figure.name: figure for figure in figures}
    judged = [by_name[name] for name in _PHRASES if name in by_name and by_name[name].is_judged]
    if verdict is Verdict.VIOLATES:
        above = [figure for figure in judged if figure.ok is False]
        first, others = above[0], above[1:]
        text = _quote(first) + _cause(first, by_name, planned_impulse)
        return text + (f"; also above their limits: {', '.join(figure.name for figure in others)}." if others else ".")
    if verdict is Verdict.NOT_RESOLVED:
        if not judged:
            return "there are no limits, so there is nothing to judge by; give the scene (or the map of an FMU) some, each with its reason."
        open_ones = [figure for figure in judged if figure.ok is None]
        first = open_ones[0]
        if first.value is None:
            text = f"{first.name} could not be measured: {first.reason.rstrip('.')}"
        elif math.isinf(first.error):
            text = f"{_quote(first)}, but the replay has no error estimate"
        else:
            text = f"{_quote(first)}, but the replay's own error of {_number(first.error, first.unit)} is not {MARGIN:g} times below the distance between them"
        others = [figure.name for figure in open_ones[1:]]
        return text + (f"; neither resolved: {', '.join(others)}." if others else ".")
    # What holds is shown by the figure closest to its limit.
    closest = max(judged, key=lambda figure: (figure.value or 0.0) / figure.limit if figure.limit else 0.0)
    text = f"every limit is kept; closest to its own: {_quote(closest)}"
    grid = by_name.get("grid_error")
    if grid is not None and grid.value is not None and (closest.name in TWINS or closest.name == "answer_error"):
        text += f", of which the time step alone may cause {_number(grid.value, grid.unit)}"
    return text + "."


def _cause(figure: Figure, by_name: dict[str, Figure], planned_impulse: float) -> str:
    """Why the replay ends elsewhere: forces from a distance, a motion that its inputs do not make, the contact law, or the time step."""
    if figure.name not in _ARRIVAL:
        return ""
    contact_fails = any(by_name[name].ok is False for name in CONTACT if name in by_name)
    tracked = figure.name in TWINS.values()
    ghost = by_name.get("tracked_ghost_impulse" if tracked else "ghost_impulse")
    if contact_fails and ghost is not None and ghost.value is not None and ghost.value > _GHOST_SHARE * planned_impulse:
        return f": force from a distance of {_number(ghost.value, ghost.unit)}"
    own = next((by_name[name] for name in _OWN if name in by_name and by_name[name].ok is False), None)
    if own is not None:
        return f": {_PHRASES[own.name].format(_number(own.value or 0.0, own.unit))}"
    grid, law = by_name.get("grid_error"), by_name.get("law_error")
    if contact_fails or figure.name not in TWINS or grid is None or grid.value is None:
        return ""
    if law is not None and law.value is not None and law.value > max(grid.value, law.limit or 0.0):
        return f": on the plan's own grid already, the true contact law leads its inputs astray by {_number(law.value, law.unit)}"
    return f": contact physics holds, but the time step is {_number(grid.value, grid.unit)} off the continuous motion"


def _quote(figure: Figure) -> str:
    value, limit = figure.value or 0.0, figure.limit or 0.0
    return f"{_PHRASES[figure.name].format(_number(value, figure.unit))}, limit {_number(limit, figure.unit)}"


def _number(value: float, unit: str) -> str:
    # A norm over positions and velocities has no unit of its own; its number is quoted bare.
    return f"{value:.3g}" if unit == "1" or "," in unit else f"{value:.3g} {unit}"
