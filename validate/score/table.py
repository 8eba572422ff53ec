"""The table of metrics: name, the question that it answers, unit, meaning, how it is measured, and the limit where a scene sets none.

Every metric of the score stands here once; those of question `SHOWN` are told and judge nothing. A scene may set another limit with a reason, or
waive it; it cannot forget one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Hold
from validate.replay.subject import Subject
from validate.score import equations as eq
from validate.score.closed_forms import answer_error
from validate.score.evidence import Evidence, LeavesBounds, Unmeasured
from validate.score.result import Question
from validate.score.unexplained import unexplained_force


@dataclass(frozen=True, kw_only=True)
class Measured:
    """values (n,): of each component, all in one unit or in `units`; error: by the replay's own error; scales (n,): what counts as large of each
    component; allowed (n,): what printing may be the cause of, which is added to the limit; base: added to the default limit alone."""

    values: np.ndarray
    error: float | np.ndarray = 0.0
    scales: np.ndarray | float = 1.0
    allowed: np.ndarray | float = 0.0
    base: float = 0.0
    units: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One row. measure raises Unmeasured with a reason.

    default: the limit where the scene sets none, as a factor of the component's scale, with its reason; None: only a scene's limit judges it.
    needs: what the plan must say for the metric to be asked, of "q", "v", "lam", "friction", "scheme", "no scheme", "no defect"; of_replay: whether it is of the
    replay, and so has a twin where there is a replay with feedback.
    """

    name: str
    question: Question
    unit: Callable[[Subject], str]
    meaning: str
    measure: Callable[[Evidence], Measured | tuple[float, float] | float]
    applies: Callable[[Subject], bool] = lambda scene: True
    needs: tuple[str, ...] = ()
    default: tuple[float, str] | None = None
    of_replay: bool = False


def _units(*names: str) -> str:
    return ", ".join(dict.fromkeys(names))


def _position_unit(scene: Subject) -> str:
    return _units(*(item.unit for item in scene.coordinates))


def _velocity_unit(scene: Subject) -> str:
    return _units(*(item.velocity_unit for item in scene.coordinates))


def _state_unit(scene: Subject) -> str:
    return _units(_position_unit(scene), _velocity_unit(scene))


def _input_unit(scene: Subject) -> str:
    return _units(*(item.unit for item in scene.inputs))


def _unit(text: str) -> Callable[[Subject], str]:
    return lambda scene: text


def _has_contacts(scene: Subject) -> bool:
    return scene.nc > 0


def _has_friction(scene: Subject) -> bool:
    return scene.nf > 0


def _has_bounds(scene: Subject) -> bool:
    return any(np.isfinite((item.lower, item.upper)).any() for item in scene.inputs)


def _has_velocity_bounds(scene: Subject) -> bool:
    return any(item.has_velocity_bounds for item in scene.coordinates)


def _is_scene(scene: Subject) -> bool:
    return isinstance(scene, Scene)


def _has_duration(scene: Subject) -> bool:
    return scene.task.horizon is not None


def _has_goal(scene: Subject) -> bool:
    return scene.task.has_goal


def _has_goal_position(scene: Subject) -> bool:
    return any(value is not None for value in scene.task.goal[: scene.nq])


def _has_goal_velocity(scene: Subject) -> bool:
    return any(value is not None for value in scene.task.goal[scene.nq :])


def _has_depths(scene: Subject) -> bool:
    return any(depth is not None for depth in scene.depths)


def _nominals(scene: Subject) -> np.ndarray:
    return np.array([item.nominal for item in scene.coordinates])


def _position_units(scene: Subject) -> tuple[str, ...]:
    return tuple(item.unit for item in scene.coordinates)


def _velocity_units(scene: Subject) -> tuple[str, ...]:
    return tuple(item.velocity_unit for item in scene.coordinates)


# Question 1


def _start_error(case: Evidence) -> Measured:
    nominals = _nominals(case.scene)
    off = np.abs(case.trajectory.start - np.array(case.scene.task.start))
    said = "v" not in case.trajectory.missing
    return Measured(
        values=off if said else off[: case.scene.nq],
        scales=np.concatenate([nominals, nominals]) if said else nominals,
        allowed=np.repeat([case.printing("q"), case.printing("v")], case.scene.nq) if said else case.printing("q"),
        units=(*_position_units(case.scene), *_velocity_units(case.scene)),
    )


def _duration_error(case: Evidence) -> Measured:
    asked = float(case.scene.task.horizon or 0.0)
    return Measured(values=np.array([abs(case.trajectory.duration - asked)]), scales=case.scene.task.step)


def _bound_violation(case: Evidence) -> Measured:
    inputs = case.scene.inputs
    lower, upper = np.array([item.lower for item in inputs]), np.array([item.upper for item in inputs])
    plan = case.trajectory
    applied = np.vstack([plan.u, plan.u_end]) if plan.u_end is not None and plan.hold is Hold.LINEAR else plan.u
    return Measured(
        values=eq.outside(applied, lower, upper), scales=_ranges(lower, upper), allowed=case.printing("u"),
        units=tuple(item.unit for item in inputs),
    )  # fmt: skip


def _velocity_bounds(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    items = case.scene.coordinates
    return np.array([item.velocity_lower for item in items]), np.array([item.velocity_upper for item in items])


def _velocity_bound_violation(case: Evidence) -> Measured:
    """At the starts of the steps: the end belongs to the goal."""
    lower, upper = _velocity_bounds(case)
    return Measured(
        values=eq.outside(case.v[:-1], lower, upper),
        scales=_ranges(lower, upper),
        allowed=case.printing("v"),
        units=_velocity_units(case.scene),
    )


def _ranges(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Widths; of one finite bound its size, or 1 where that is 0."""
    width = upper - lower
    one = np.where(np.isfinite(lower), np.abs(lower), np.where(np.isfinite(upper), np.abs(upper), 1.0))
    return np.where(np.isfinite(width), width, np.where(one > 0.0, one, 1.0))


# Question 2


def _terminal_error(case: Evidence) -> float:
    return eq.distance(case.end, case.goal)


def _terminal_position_error(case: Evidence) -> Measured:
    nq = case.scene.nq
    return Measured(values=np.array([eq.distance(case.q[-1], case.goal[:nq])]), allowed=case.printing("q") * np.sqrt(nq))


def _terminal_velocity_error(case: Evidence) -> Measured:
    nq = case.scene.nq
    return Measured(values=np.array([eq.distance(case.v[-1], case.goal[nq:])]), allowed=case.printing("v") * np.sqrt(nq))


def _cost(case: Evidence) -> float:
    return case.cost_of(case.q, case.v, case.trajectory.u)


# Question 3


def _physics(case: Evidence) -> float:
    return eq.physics(lam=case.lam, push=case.push)


def _physics_scaled(case: Evidence) -> Measured:
    value = eq.physics_scaled(lam=case.lam, push=case.push, k=case.k, length=case.length, h=case.h)
    p_lam, p_push = case.printing("lam"), case.k * case.printing("q")
    rounded = p_lam * (2.0 * np.abs(case.lam) + np.abs(case.push)) + np.abs(case.lam) * p_push + p_lam * (p_lam + p_push)
    allowed = float((case.h[:, None] * rounded * (case.lam != 0.0) / (case.k * case.length) ** 2).sum())
    return Measured(values=np.array([value]), scales=case.trajectory.duration * case.scene.nc, allowed=allowed)


def _contact_law_error(case: Evidence) -> Measured:
    value = eq.contact_law_error(lam=case.lam, law=case.law, h=case.h)
    touching = (case.lam != 0.0) | (np.maximum(case.law[:-1], case.law[1:]) > 0.0)
    off = case.printing("lam") + case.k * case.printing("q")
    # Rounding of a plan that is only just in touch is no force.
    tiny = 1e-9 * float((case.k * case.length).max()) * case.trajectory.duration
    return Measured(values=np.array([value]), scales=case.planned_impulse, allowed=float((case.h[:, None] * touching * off).sum()) + tiny)


def _force_sign_violation(case: Evidence) -> Measured:
    lam = case.lam
    return Measured(
        values=np.array([max(float(-lam.min(initial=0.0)), 0.0)]), scales=float(np.abs(lam).max(initial=0.0)), allowed=case.printing("lam")
    )


def _friction_violation(case: Evidence) -> Measured:
    limit = case.friction_limit
    mu = np.divide(limit, np.abs(case.trajectory.lam[:, : case.scene.nc]).max(axis=1, initial=0.0)[:, None], out=np.zeros_like(limit),
                   where=np.abs(case.trajectory.lam[:, : case.scene.nc]).max(axis=1, initial=0.0)[:, None] > 0.0)  # fmt: skip
    return Measured(
        values=np.array([eq.friction_violation(case.friction, limit)]), scales=float(limit.max(initial=0.0)),
        allowed=case.printing("lam") * (1.0 + float(mu.max(initial=0.0))),
    )  # fmt: skip


def _friction_dissipation_error(case: Evidence) -> Measured:
    limit, slip = case.friction_limit, case.slip
    values = eq.friction_dissipation_error(case.friction, limit, slip)
    nominal = np.array([item.nominal for item in case.scene.frictions])
    largest = limit.max(axis=0, initial=0.0)
    p_slip = 2.0 * (case.printing("v") + float(np.abs(case.v).max(initial=0.0)) * case.printing("q"))
    allowed = 2.0 * largest * p_slip + 2.0 * case.printing("lam") * np.abs(slip).max(axis=0, initial=0.0)
    return Measured(values=values, scales=largest * nominal, allowed=allowed)


# Question 4


def _replay_error(case: Evidence) -> Measured:
    values = np.abs(case.q - case.replay_q).max(axis=0)
    return Measured(
        values=values,
        error=case.error.position,
        scales=_nominals(case.scene),
        allowed=case.printing("q"),
        units=_position_units(case.scene),
    )


def _replay_terminal_error(case: Evidence) -> tuple[float, float]:
    return eq.distance(case.replay_end, case.goal), case.error.state


def _replay_terminal_position_error(case: Evidence) -> tuple[float, float]:
    # The norm over positions differs by at most as much as each of them does.
    error = min(case.error.state, case.error.position * float(np.sqrt(case.scene.nq)))
    return eq.distance(case.replay_q[-1], case.goal[: case.scene.nq]), error


def _replay_terminal_velocity_error(case: Evidence) -> tuple[float, float]:
    return eq.distance(case.replay_v[-1], case.goal[case.scene.nq :]), case.error.state


def _replay_cost(case: Evidence) -> tuple[float, float]:
    replay = case.replay
    u = case.trajectory.u if replay.applied is None else replay.applied
    q, v, error = case.replay_q, case.replay_v, case.error.state
    value = case.cost_of(q, v, u)
    around = [case.cost_of(q + sign * error, v + sign * error, u) for sign in (1.0, -1.0)] if np.isfinite(error) else [np.inf]
    return value, max(abs(one - value) for one in around)


def _replay_error_time(case: Evidence) -> float:
    return float(case.trajectory.t[eq.largest_difference(case.q, case.replay_q)[1]])


def _grid_error(case: Evidence) -> tuple[float, float]:
    return eq.largest_difference(case.true_motion[0], case.replay_q)[0], case.error.position


def _grid_order(case: Evidence) -> float:
    """Log2 of what the last halving of the plan's step does to its distance from the replay, its inputs held; halved until it is near, or seven times."""
    error, near = _grid_error(case)[0], _replay_limit(case) / 4.0
    if error <= near:
        raise Unmeasured("the discretisation error is far below the limit on replay_error, so that nothing need be known of its order.")
    order = 0.0
    for halvings in range(1, _HALVINGS + 1):
        finer, _ = eq.largest_difference(case.refined_motion(2**halvings), case.replay_q)
        order = float(np.log2(error / finer)) if finer > 0.0 else np.inf
        error = finer
        if error <= near:
            break
    return min(order, _HALVINGS)


def _replay_limit(case: Evidence) -> float:
    own = case.scene.limit("replay_error")
    return own.value if own is not None and own.value is not None else 1e-2 * float(_nominals(case.scene).min())


# Question 5


def _max_penetration(case: Evidence) -> Measured:
    depths = np.array([np.inf if depth is None else depth for depth in case.scene.depths])
    return Measured(values=eq.deepest(case.replay.t, case.replay_gap, case.gap_rate), error=case.error.gap, scales=depths)


def _ghost_impulse(case: Evidence) -> Measured:
    value = eq.ghost_impulse(plan_lam=case.lam, largest=case.force_window[1], h=case.h)
    return Measured(values=np.array([value]), error=_impulse_error(case), scales=case.planned_impulse, allowed=_printed_impulse(case))


def _missed_impulse(case: Evidence) -> Measured:
    value = eq.missed_impulse(plan_lam=case.lam, least=case.force_window[0], h=case.h)
    replayed = float((np.maximum(case.force_window[0], 0.0) * case.h[:, None]).sum())
    return Measured(
        values=np.array([value]), error=_impulse_error(case), scales=max(case.planned_impulse, replayed), allowed=_printed_impulse(case)
    )


def _printed_impulse(case: Evidence) -> float:
    return float(case.h.sum()) * case.scene.nc * case.printing("lam")


def _impulse_error(case: Evidence) -> float:
    """Each force may be wrong by k times the error of its gap while there is contact; a damped one also by its error in the velocities."""
    touching = float((case.duration[:, None] * ((case.replay.lam[:-1] > 0.0) | (case.replay.lam[1:] > 0.0))).sum())
    if not isinstance(case.scene, Scene):  # its stiffness is what its own forces and gaps say
        pressed = case.replay_gap < 0.0
        stiffness = np.divide(case.replay.lam, -case.replay_gap, out=np.zeros_like(case.replay.lam), where=pressed).max(initial=0.0)
        return float(stiffness) * touching * case.error.gap if touching else 0.0
    error = float(case.slopes[0].max(initial=0.0)) * touching * case.error.gap
    return error + (float(case.slopes[1].max(initial=0.0)) * touching * case.error.state if case.scene.damped else 0.0)


def _replay_velocity_bound_violation(case: Evidence) -> Measured:
    lower, upper = _velocity_bounds(case)
    return Measured(
        values=eq.outside(case.all_replay_v[:-1], lower, upper),
        error=case.error.state,
        scales=_nominals(case.scene),
        units=_velocity_units(case.scene),
    )


# Question 6


def _defect(case: Evidence) -> Measured:
    p_q, p_v, h = case.printing("q"), case.printing("v"), float(case.h.max())
    if case.trajectory.scheme is not Scheme.SEMI_IMPLICIT_EULER:
        # Stages are not stored: its forces are taken to be those of the true law there.
        values = case.collocation_defect
        if not np.isfinite(values).all():
            raise LeavesBounds(f"a step of scheme {case.trajectory.scheme.value} from a node of the plan has no solution.")  # type: ignore[union-attr]
    else:
        values = eq.defect(q=case.q, v=case.v, acceleration=case.acceleration, h=case.h)
    nominals = _nominals(case.scene)
    position = 2.0 * p_q + h * p_v
    velocity = 2.0 * p_v + h * case.printing_acceleration
    return Measured(
        values=values, scales=np.concatenate([nominals, nominals]), allowed=np.repeat([position, velocity], case.scene.nq),
        units=(*_position_units(case.scene), *_velocity_units(case.scene)),
    )  # fmt: skip


def _explained(case: Evidence) -> float:
    """What a defect at its limit explains if each step has one and none grows or dies: steps times 1e-6 of the nominal."""
    return case.trajectory.steps * DEFECT * float(_nominals(case.scene).min()) + case.trajectory.steps * case.printing("q")


def _law_error(case: Evidence) -> Measured:
    return Measured(values=np.array([eq.largest_difference(case.q, case.true_motion[0])[0]]), scales=_explained(case))


def _discrete_terminal_error(case: Evidence) -> float:
    return eq.distance(case.true_end, case.goal)


def _discrete_terminal(part: str, value: Callable[[Evidence], float]) -> Callable[[Evidence], Measured]:
    """Beyond what the plan itself may miss the goal by."""

    def measure(case: Evidence) -> Measured:
        own = case.scene.limit(f"terminal_{part}_error")
        return Measured(
            values=np.array([value(case)]), scales=_explained(case), allowed=0.0 if own is None or own.value is None else own.value
        )

    return measure


def _discrete_position(case: Evidence) -> float:
    return eq.distance(case.true_end[: case.scene.nq], case.goal[: case.scene.nq])


def _discrete_velocity(case: Evidence) -> float:
    return eq.distance(case.true_end[case.scene.nq :], case.goal[case.scene.nq :])


# The judge


def _work(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    if case.replay.input_work is None or case.replay.dissipated_work is None:
        raise Unmeasured("the FMU has no outputs input_power and dissipated_power.")
    return case.replay.input_work, case.replay.dissipated_work


def _energy_residual(case: Evidence) -> float:
    return eq.energy_residual(case.replay.energy, *_work(case))


def _energy_residual_relative(case: Evidence) -> float:
    replay, work = case.replay, _work(case)
    turned = eq.energy_turnover(replay.kinetic_energy, replay.potential_energy, replay.contact_energy, *work)
    speeds = _nominals(case.scene)[None, :]
    typical = float(case.kernel.energy(replay.q[:1], speeds)[0][0])
    return _energy_residual(case) / max(turned, _AT_REST * typical)


def _friction_impulse_error(case: Evidence) -> float:
    return eq.friction_impulse_error(case.friction, case.step_of, case.replay.friction, case.duration)


DEFECT = 1e-6
_HALVINGS = 7
# Where next to nothing moves, energy is measured by this share of what moving at nominal speeds would take.
_AT_REST = 1e-3

TABLE = (
    Entry(
        name="start_error", question=Question.TASK, unit=_state_unit, measure=_start_error, applies=_is_scene, needs=("q",),
        default=(1e-6, "1e-6 of the nominal: a plan from another start solves another task"),
        meaning="largest distance of the plan's first state from the task's start",
    ),
    Entry(
        name="duration_error", question=Question.TASK, unit=_unit("s"), measure=_duration_error, applies=_has_duration,
        default=(0.5, "half a step of the task: a plan that lasts another time solves another task"),
        meaning="by how much the plan is longer or shorter than the task",
    ),
    Entry(
        name="bound_violation", question=Question.TASK, unit=_input_unit, measure=_bound_violation, applies=_has_bounds,
        default=(1e-6, "1e-6 of the range, the solvers' own tolerance: the actuators give no more"),
        meaning="by how much the plan's inputs leave their bounds",
    ),
    Entry(
        name="velocity_bound_violation", question=Question.TASK, unit=_velocity_unit, measure=_velocity_bound_violation,
        applies=_has_velocity_bounds, needs=("v",), default=(1e-6, "1e-6 of the range, the solvers' own tolerance"),
        meaning="by how much the plan's velocities leave their bounds at the start of a step",
    ),
    Entry(
        name="terminal_position_error", question=Question.GOAL, unit=_position_unit, measure=_terminal_position_error, applies=_has_goal_position,
        needs=("q",), meaning="norm of q_T - q_f in the plan",
    ),
    Entry(
        name="terminal_velocity_error", question=Question.GOAL, unit=_velocity_unit, measure=_terminal_velocity_error, applies=_has_goal_velocity,
        needs=("v",), meaning="norm of v_T - v_f in the plan",
    ),
    Entry(
        name="cost", question=Question.GOAL, unit=_unit("1"), measure=_cost, applies=_is_scene, needs=("q", "v"),
        meaning="the task's cost of the plan: sum of the running cost over its steps, and the final cost",
    ),
    Entry(
        name="contact_law_error", question=Question.FORCES, unit=_unit("N s"), measure=_contact_law_error,
        applies=lambda scene: _is_scene(scene) and _has_contacts(scene), needs=("lam", "q", "no scheme"),
        default=(0.01, "1 % of the planned contact impulse: forces of the start of a step, of its end and means over it all lie in the range"),
        meaning="impulse by which the planned contact forces lie outside the range of the true law over the two ends of their step",
    ),
    Entry(
        name="physics_scaled", question=Question.FORCES, unit=_unit("s"), measure=_physics_scaled,
        applies=lambda scene: _is_scene(scene) and _has_contacts(scene), needs=("lam", "q", "scheme"),
        default=(2e-6, "averaged over plan and contacts a product of 2e-6 (k L)^2: a thousandth of k L where the gap is just closed, less at a distance"),
        meaning="sum of h |lam (lam - k phi)| / (k L)^2, with L the nominal penetration of the contact: complementarity violation, the same on any grid",
    ),
    Entry(
        name="force_sign_violation", question=Question.FORCES, unit=_unit("N"), measure=_force_sign_violation, applies=_has_contacts, needs=("lam",),
        default=(1e-6, "1e-6 of the largest force: contact does not pull"), meaning="largest planned contact force that pulls",
    ),
    Entry(
        name="friction_violation", question=Question.FORCES, unit=_unit("N"), measure=_friction_violation, applies=_has_friction,
        needs=("friction", "q"), default=(1e-4, "1e-4 of the largest mu N: more is force that friction does not have"),
        meaning="by how much a planned friction force exceeds mu N, with N what the plan itself presses with",
    ),
    Entry(
        name="friction_dissipation_error", question=Question.FORCES, unit=_unit("W"), measure=_friction_dissipation_error, applies=_has_friction,
        needs=("friction", "v"), default=(1e-4, "1e-4 of the largest mu N times the nominal slip: more is creep"),
        meaning="largest mu N |s| + f s in the plan: slip that is not held back by all of mu N, as in creep",
    ),
    Entry(
        name="replay_error", question=Question.MOTION, unit=_position_unit, measure=_replay_error, needs=("q",), of_replay=True,
        default=(1e-2, "1e-2 of the nominal"), meaning="largest position difference between plan and replay at the plan's nodes",
    ),
    Entry(
        name="replay_terminal_position_error", question=Question.MOTION, unit=_position_unit, measure=_replay_terminal_position_error,
        applies=_has_goal_position, of_replay=True, meaning="norm of q_T - q_f in the replay",
    ),
    Entry(
        name="replay_terminal_velocity_error", question=Question.MOTION, unit=_velocity_unit, measure=_replay_terminal_velocity_error,
        applies=_has_goal_velocity, of_replay=True, meaning="norm of v_T - v_f in the replay",
    ),
    Entry(
        name="replay_cost", question=Question.MOTION, unit=_unit("1"), measure=_replay_cost, applies=_is_scene, of_replay=True,
        meaning="the task's cost of the replay, at the plan's nodes",
    ),
    Entry(
        name="unexplained_force", question=Question.MOTION, unit=_unit("1"), measure=unexplained_force, applies=_is_scene, needs=("q", "no defect"),
        default=(0.1, "10 % of the peak contact force: as much as a step of a good grid leaves open"),
        meaning="largest mean force over a step that inputs and true contact do not explain, from the plan's own states, as a share of the peak contact force",
    ),
    Entry(
        name="max_penetration", question=Question.POSSIBLE, unit=_unit("m"), measure=_max_penetration,
        applies=lambda scene: _has_contacts(scene) and _has_depths(scene), of_replay=True,
        default=(1.0, "the depth at which the model of the contact ends"), meaning="deepest penetration in the replay, of the contact that is nearest to the depth at which its model ends",
    ),
    Entry(
        name="ghost_impulse", question=Question.POSSIBLE, unit=_unit("N s"), measure=_ghost_impulse, applies=_has_contacts, needs=("lam",),
        of_replay=True, default=(0.01, "1 % of the planned contact impulse"),
        meaning="impulse of planned contact force that the replay has at no time within a step of it: force at a distance",
    ),
    Entry(
        name="missed_impulse", question=Question.POSSIBLE, unit=_unit("N s"), measure=_missed_impulse, applies=_has_contacts, needs=("lam",),
        of_replay=True, default=(0.01, "1 % of the contact impulse"),
        meaning="impulse of the replay's contact force beyond what is planned at any time within a step of it",
    ),
    Entry(
        name="replay_velocity_bound_violation", question=Question.POSSIBLE, unit=_velocity_unit, measure=_replay_velocity_bound_violation,
        applies=_has_velocity_bounds, of_replay=True, default=(1e-2, "1e-2 of the nominal, as the replay may differ from the plan"),
        meaning="by how much the replay's velocities leave their bounds",
    ),
    Entry(
        name="defect", question=Question.SCHEME, unit=_state_unit, measure=_defect, applies=_is_scene, needs=("q", "v", "lam", "friction", "scheme"),
        default=(DEFECT, "1e-6 of the nominal: a plan that misses its own time step by more was not solved to the end"),
        meaning="largest residual of the plan in its declared scheme, with its own contact forces (a collocation: with those of the true law at its stages)",
    ),
    Entry(
        name="law_error", question=Question.SCHEME, unit=_position_unit, measure=_law_error, applies=_is_scene, needs=("q", "v", "scheme"),
        default=(10.0, "ten times what a defect of 1e-6 in every step explains"),
        meaning="largest position difference between the plan and its inputs under the true law on the same grid: the contact law's share of replay_error",
    ),
    Entry(
        name="discrete_terminal_position_error", question=Question.SCHEME, unit=_position_unit,
        measure=_discrete_terminal("position", _discrete_position), applies=lambda scene: _is_scene(scene) and _has_goal_position(scene),
        needs=("q", "v", "scheme"), default=(10.0, "what the plan may miss the goal by, and ten times what a defect of 1e-6 in every step explains"),
        meaning="norm of q_T - q_f in the plan's own time step with the true contact law (the paper's stability of gradient descent)",
    ),
    Entry(
        name="discrete_terminal_velocity_error", question=Question.SCHEME, unit=_velocity_unit,
        measure=_discrete_terminal("velocity", _discrete_velocity), applies=lambda scene: _is_scene(scene) and _has_goal_velocity(scene),
        needs=("q", "v", "scheme"), default=(10.0, "what the plan may miss the goal by, and ten times what a defect of 1e-6 in every step explains"),
        meaning="norm of v_T - v_f in the plan's own time step with the true contact law",
    ),
    Entry(
        name="answer_error", question=Question.JUDGE, unit=_unit("1"), measure=answer_error, of_replay=False,
        applies=lambda scene: any(answer.measure for answer in scene.answers), default=(1.0, "the tolerance of the closed form"),
        meaning="largest distance of the replay from a closed form of the scene, in units of that answer's tolerance",
    ),
    Entry(
        name="energy_residual_relative", question=Question.JUDGE, unit=_unit("1"), measure=_energy_residual_relative, applies=_is_scene, of_replay=True,
        default=(1e-6, "a replay whose energy does not balance to a millionth is wrong"),
        meaning="energy_residual over the largest energy that is there to be turned over",
    ),
    Entry(
        name="physics", question=Question.SHOWN, unit=_unit("N^2"), measure=_physics, applies=lambda scene: _is_scene(scene) and _has_contacts(scene),
        needs=("lam", "q"), meaning="sum over steps and contacts of |lam (lam - k phi)|, k phi with its damping: the paper's physics",
    ),
    Entry(
        name="terminal_error", question=Question.SHOWN, unit=_state_unit, measure=_terminal_error, applies=_has_goal, needs=("q",),
        meaning="norm of x_T - x_f in the plan, positions and velocities: the paper's stability",
    ),
    Entry(
        name="discrete_terminal_error", question=Question.SHOWN, unit=_state_unit, measure=_discrete_terminal_error,
        applies=lambda scene: _is_scene(scene) and _has_goal(scene), needs=("q", "v"),
        meaning="norm of x_T - x_f when the plan's inputs run through its own time step with the true contact law",
    ),
    Entry(
        name="replay_terminal_error", question=Question.SHOWN, unit=_state_unit, measure=_replay_terminal_error, applies=_has_goal, of_replay=True,
        meaning="norm of x_T - x_f when the plan's inputs drive the true continuous dynamics",
    ),
    Entry(
        name="replay_error_time", question=Question.SHOWN, unit=_unit("s"), measure=_replay_error_time, needs=("q",),
        meaning="when plan and replay differ most",
    ),
    Entry(
        name="grid_error", question=Question.SHOWN, unit=_position_unit, measure=_grid_error, applies=_is_scene, needs=("q", "v", "scheme"), of_replay=False,
        meaning="largest position difference between the true law on the plan's grid and in continuous time: the discretisation error",
    ),
    Entry(
        name="grid_order", question=Question.SHOWN, unit=_unit("1"), measure=_grid_order, applies=_is_scene, needs=("q", "v", "scheme"),
        meaning="order with which the discretisation error shrinks as the plan's own grid is refined under its inputs",
    ),
    Entry(
        name="friction_impulse_error", question=Question.SHOWN, unit=_unit("N s"), measure=_friction_impulse_error, applies=_has_friction,
        needs=("friction",), of_replay=True,
        meaning="impulse of the difference between planned and replayed friction forces (sticking forces are not unique)",
    ),
    Entry(
        name="energy_residual", question=Question.JUDGE, unit=_unit("J"), measure=_energy_residual, applies=_is_scene, of_replay=True,
        meaning="self-check of the replay: work in - dissipated - change of energy, largest over time",
    ),
)  # fmt: skip
