"""The table of figures: name, unit, meaning, how it is measured, and how wrong the replay may make it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.scene import Scene
from models.schemes import Scheme
from validate.replay.subject import Subject
from validate.score import equations as eq
from validate.score.closed_forms import answer_error
from validate.score.evidence import Evidence, Unmeasured


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One row. measure gives the value, or (value, error by the replay's own error); it raises Unmeasured with a reason."""

    name: str
    unit: Callable[[Subject], str]
    meaning: str
    measure: Callable[[Evidence], float | tuple[float, float]]
    applies: Callable[[Subject], bool] = lambda scene: True


def _units(*names: str) -> str:
    return ", ".join(dict.fromkeys(names))


def _position_unit(scene: Subject) -> str:
    return _units(*(item.unit for item in scene.coordinates))


def _state_unit(scene: Subject) -> str:
    return _units(*(item.unit for item in scene.coordinates), *(item.velocity_unit for item in scene.coordinates))


def _input_unit(scene: Subject) -> str:
    return _units(*(item.unit for item in scene.inputs))


def _unit(text: str) -> Callable[[Subject], str]:
    return lambda scene: text


def _has_contacts(scene: Subject) -> bool:
    return scene.nc > 0


def _has_friction(scene: Subject) -> bool:
    return scene.nf > 0


def _has_velocity_bounds(scene: Subject) -> bool:
    return any(item.has_velocity_bounds for item in scene.coordinates)


def _velocity_unit(scene: Subject) -> str:
    return _units(*(item.velocity_unit for item in scene.coordinates))


def _has_goal(scene: Subject) -> bool:
    return scene.task.has_goal


def _has_goal_position(scene: Subject) -> bool:
    return any(value is not None for value in scene.task.goal[: scene.nq])


def _physics(case: Evidence) -> float:
    return eq.physics(lam=case.lam, push=case.push)


def _physics_scaled(case: Evidence) -> float:
    return eq.physics_scaled(lam=case.lam, push=case.push, k=case.k, length=case.length, h=case.h)


def _defect(case: Evidence) -> float:
    if (
        case.trajectory.scheme is not Scheme.SEMI_IMPLICIT_EULER
    ):  # stages are not stored: its forces are taken to be those of the true law there
        found = case.collocation_defect
        if not np.isfinite(found):
            raise Unmeasured(f"a step of scheme {case.trajectory.scheme.value} from a node of the plan has no solution.")
        return found
    return eq.defect(q=case.trajectory.q, v=case.v, acceleration=case.acceleration, h=case.h)


def _start_error(case: Evidence) -> float:
    return float(np.abs(case.trajectory.start - np.array(case.scene.task.start)).max())


def _bound_violation(case: Evidence) -> float:
    inputs = case.scene.inputs
    lower, upper = np.array([item.lower for item in inputs]), np.array([item.upper for item in inputs])
    return eq.bound_violation(u=case.trajectory.u, lower=lower, upper=upper)


def _velocity_bound_violation(case: Evidence) -> float:
    items = case.scene.coordinates
    lower, upper = np.array([item.velocity_lower for item in items]), np.array([item.velocity_upper for item in items])
    return eq.velocity_bound_violation(v=case.v, lower=lower, upper=upper)


def _terminal_error(case: Evidence) -> float:
    return eq.distance(case.end, case.goal)


def _terminal_position_error(case: Evidence) -> float:
    return eq.distance(case.q[-1], case.goal[: case.scene.nq])


def _discrete_terminal_error(case: Evidence) -> float:
    return eq.distance(case.true_end, case.goal)


def _discrete_terminal_position_error(case: Evidence) -> float:
    return eq.distance(case.true_end[: case.scene.nq], case.goal[: case.scene.nq])


def _law_error(case: Evidence) -> float:
    return eq.largest_difference(case.trajectory.q, case.true_motion[0])[0]


def _replay_terminal_error(case: Evidence) -> tuple[float, float]:
    return eq.distance(case.replay_end, case.goal), case.error.state


def _replay_terminal_position_error(case: Evidence) -> tuple[float, float]:
    # The norm over positions cannot differ by more than the norm over the state does.
    return eq.distance(case.replay_q[-1], case.goal[: case.scene.nq]), case.error.state


def _replay_error(case: Evidence) -> tuple[float, float]:
    return eq.largest_difference(case.q, case.replay_q)[0], case.error.position


def _replay_error_time(case: Evidence) -> float:
    return float(case.trajectory.t[eq.largest_difference(case.q, case.replay_q)[1]])


def _grid_error(case: Evidence) -> tuple[float, float]:
    return eq.largest_difference(case.true_motion[0], case.replay_q)[0], case.error.position


def _ghost_impulse(case: Evidence) -> tuple[float, float]:
    def ghost(shift: float) -> float:
        return eq.ghost_impulse(plan_lam=case.lam, step_of=case.step_of, gap=case.replay_gap, duration=case.duration, shift=shift)

    if not np.isfinite(case.error.gap):
        return ghost(0.0), np.inf
    return ghost(0.0), max(abs(ghost(case.error.gap) - ghost(0.0)), abs(ghost(-case.error.gap) - ghost(0.0)))


def _missed_impulse(case: Evidence) -> tuple[float, float]:
    case.need("lam")
    value = eq.missed_impulse(plan_lam=case.lam, step_of=case.step_of, lam=case.replay.lam, duration=case.duration)
    if not isinstance(case.scene, Scene):
        return value, np.inf  # how wrong a force is that somebody's FMU puts out, only its own stiffness would say
    # Each force may be wrong by k times the error of its gap, all the time; a damped one also by its error in the velocities.
    error = float(case.slopes[0].sum() * case.duration.sum()) * case.error.gap
    return value, error + (float(case.slopes[1].sum() * case.duration.sum()) * case.error.state if case.scene.damped else 0.0)


def _friction_violation(case: Evidence) -> float:
    return eq.friction_violation(case.friction, case.friction_limit)


def _friction_dissipation_error(case: Evidence) -> float:
    return eq.friction_dissipation_error(case.friction, case.friction_limit, case.slip)


def _friction_impulse_error(case: Evidence) -> float:
    return eq.friction_impulse_error(case.friction, case.step_of, case.replay.friction, case.duration)


def _max_penetration(case: Evidence) -> tuple[float, float]:
    return eq.max_penetration(case.replay_gap), case.error.gap


def _work(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    if case.replay.input_work is None or case.replay.dissipated_work is None:
        raise Unmeasured("the FMU has no outputs input_power and dissipated_power.")
    return case.replay.input_work, case.replay.dissipated_work


def _energy_residual(case: Evidence) -> float:
    return eq.energy_residual(case.replay.energy, *_work(case))


def _energy_residual_relative(case: Evidence) -> float:
    turnover = eq.energy_turnover(case.replay.energy, *_work(case))
    if turnover == 0.0:
        raise Unmeasured("nothing moves: no energy is turned over.")
    return _energy_residual(case) / turnover


TABLE = (
    Entry(
        name="physics", unit=_unit("N^2"), measure=_physics, applies=_has_contacts,
        meaning="how far the plan's contact forces are from complementarity: sum over steps and contacts of |lam (lam - k phi)|, k phi with its damping",
    ),
    Entry(
        name="physics_scaled", unit=_unit("s"), measure=_physics_scaled, applies=_has_contacts,
        meaning="sum of h |lam (lam - k phi)| / (k L)^2, with L the nominal penetration of the contact: physics, but the same on any grid and stiffness",
    ),
    Entry(
        name="defect", unit=_state_unit, measure=_defect,
        meaning="largest residual of the plan in its own time step, with its own contact forces (a collocation: with those of the true law at its stages)",
    ),
    Entry(
        name="start_error", unit=_state_unit, measure=_start_error, applies=lambda scene: isinstance(scene, Scene),
        meaning="largest distance of the plan's first state from the task's start",
    ),
    Entry(
        name="bound_violation", unit=_input_unit, measure=_bound_violation, applies=lambda scene: scene.nu > 0,
        meaning="by how much the plan's inputs leave their bounds",
    ),
    Entry(
        name="velocity_bound_violation", unit=_velocity_unit, measure=_velocity_bound_violation, applies=_has_velocity_bounds,
        meaning="by how much the plan's velocities leave their bounds at the start of a step",
    ),
    Entry(
        name="terminal_error", unit=_state_unit, measure=_terminal_error, applies=_has_goal,
        meaning="norm of x_T - x_f in the plan, positions and velocities",
    ),
    Entry(
        name="terminal_position_error", unit=_position_unit, measure=_terminal_position_error, applies=_has_goal_position,
        meaning="norm of q_T - q_f in the plan",
    ),
    Entry(
        name="discrete_terminal_error", unit=_state_unit, measure=_discrete_terminal_error, applies=_has_goal,
        meaning="norm of x_T - x_f when the plan's inputs run through its own time step with the true contact law: what the relaxation cheats",
    ),
    Entry(
        name="discrete_terminal_position_error", unit=_position_unit, measure=_discrete_terminal_position_error, applies=_has_goal_position,
        meaning="norm of q_T - q_f in the plan's own time step with the true contact law (the paper's stability of gradient descent)",
    ),
    Entry(
        name="law_error", unit=_position_unit, measure=_law_error,
        meaning="largest position difference between the plan and its inputs under the true law on the same grid: the contact law's share of replay_error",
    ),
    Entry(
        name="replay_terminal_error", unit=_state_unit, measure=_replay_terminal_error, applies=_has_goal,
        meaning="norm of x_T - x_f when the plan's inputs drive the true continuous dynamics",
    ),
    Entry(
        name="replay_terminal_position_error", unit=_position_unit, measure=_replay_terminal_position_error, applies=_has_goal_position,
        meaning="norm of q_T - q_f in the replay",
    ),
    Entry(name="replay_error", unit=_position_unit, measure=_replay_error, meaning="largest position difference between plan and replay at the plan's nodes"),
    Entry(name="replay_error_time", unit=_unit("s"), measure=_replay_error_time, meaning="when plan and replay differ most"),
    Entry(
        name="grid_error", unit=_position_unit, measure=_grid_error,
        meaning="largest position difference between the true law on the plan's grid and in continuous time: the time step's share of replay_error",
    ),
    Entry(
        name="ghost_impulse", unit=_unit("N s"), measure=_ghost_impulse, applies=_has_contacts,
        meaning="impulse of planned contact force where the replay has a gap",
    ),
    Entry(
        name="missed_impulse", unit=_unit("N s"), measure=_missed_impulse, applies=_has_contacts,
        meaning="impulse by which the replay's contact forces exceed the planned ones",
    ),
    Entry(
        name="friction_violation", unit=_unit("N"), measure=_friction_violation, applies=_has_friction,
        meaning="by how much a planned friction force exceeds mu N, with N what the plan itself presses with",
    ),
    Entry(
        name="friction_dissipation_error", unit=_unit("W"), measure=_friction_dissipation_error, applies=_has_friction,
        meaning="largest mu N |s| + f s in the plan: slip that is not held back by all of mu N, as in creep",
    ),
    Entry(
        name="friction_impulse_error", unit=_unit("N s"), measure=_friction_impulse_error, applies=_has_friction,
        meaning="impulse of the difference between planned and replayed friction forces; the time step's share is in it",
    ),
    Entry(name="max_penetration", unit=_unit("m"), measure=_max_penetration, applies=_has_contacts, meaning="deepest penetration in the replay"),
    Entry(
        name="answer_error", unit=_unit("1"), measure=answer_error, applies=lambda scene: any(answer.measure for answer in scene.answers),
        meaning="largest distance of the replay from a closed form of the scene, in units of that answer's tolerance",
    ),
    Entry(
        name="energy_residual", unit=_unit("J"), measure=_energy_residual,
        meaning="self-check of the replay: work in - dissipated - change of energy, largest over time",
    ),
    Entry(
        name="energy_residual_relative", unit=_unit("1"), measure=_energy_residual_relative,
        meaning="energy_residual over the largest of work in, dissipated work and change of energy",
    ),
)  # fmt: skip
