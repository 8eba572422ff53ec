"""How each metric of the table is measured: from the evidence to a number, its error, and what counts as large (validate.judge.score.table)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from models.dynamics import derive
from models.scene import Scene
from models.scene.default_limits import REPLAY_ERROR
from models.scene.goal import distance
from models.schemes import Scheme
from models.trajectory import WINDOWS, Hold
from validate.judge.replay.result import Difference, Event
from validate.judge.replay.subject import Subject
from validate.judge.score import equations as eq
from validate.judge.score.depths import deepest
from validate.judge.score.evidence import Evidence
from validate.judge.score.forces import force_window
from validate.judge.score.verdict import Contradicted, LeavesBounds, Unmeasured

DEFECT = 1e-6
_HALVINGS = 7
# A halving that moves the motion by less than this share of what is missing does not bring it
# nearer: after two in a row the rest is not the grid's.
IDLE = 0.01
# Below this share of the largest a force or a gap is nothing.
_CLEARLY = 1e-2
# Forces are a multiple of the law's where that leaves this share of what the law itself leaves, or
# less.
_EXPLAINED = 0.1
# Largest share of forces that fall while the gap closes, of a law by the gap alone.
_MONOTONE = 0.05
# Where next to nothing moves, energy is measured by this share of what moving at nominal speeds
# would take.
_AT_REST = 1e-3


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What was measured of one metric.

    values (n,): of each component, in the units of its row, or one number; error: by the replay's
    own error; scales (n,): what counts as large of each component; allowed (n,): what printing may
    be the cause of, which is added to the limit.
    """

    values: np.ndarray | float
    error: np.ndarray | float = 0.0
    scales: np.ndarray | float = 1.0
    allowed: np.ndarray | float = 0.0


def _nominals(scene: Subject) -> np.ndarray:
    return np.array([item.nominal for item in scene.coordinates])


# Question 1


def start_error(case: Evidence) -> Measured:
    """Distance of the plan's first state from where the replay starts, of each component."""
    start, nominals = case.task_start, _nominals(case.scene)
    asked = np.abs(case.goal - start)
    # A task of a micrometre is not started a millionth of a metre away.
    scales = np.fmin(np.concatenate([nominals, nominals]), np.where(asked > 0.0, asked, np.nan))
    off = np.abs(np.concatenate([case.q[0], case.trajectory.v[0]]) - start)
    # Without inertia the inputs decide the velocity at the start.
    said = "v" not in {*case.trajectory.missing, *case.lacking} and case.has_inertia
    return Measured(
        values=off if said else off[: case.scene.nq],
        scales=scales if said else scales[: case.scene.nq],
        allowed=np.concatenate([case.rounding[of][0] for of in ("q", *(["v"] if said else []))]),
    )


def duration_error(case: Evidence) -> Measured:
    """Difference of the plan's duration and the task's [s]."""
    asked = float(case.scene.task.horizon or 0.0)
    return Measured(values=abs(case.trajectory.duration - asked), scales=case.scene.task.step)


def bound_violation(case: Evidence) -> Measured:
    """How far the plan's inputs leave their bounds, of each input."""
    inputs = case.scene.inputs
    lower, upper = (
        np.array([item.lower for item in inputs]),
        np.array([item.upper for item in inputs]),
    )
    plan = case.trajectory
    applied = (
        np.vstack([plan.u, plan.u_end])
        if plan.u_end is not None and plan.hold is Hold.LINEAR
        else plan.u
    )
    return Measured(
        values=eq.outside(applied, lower, upper),
        scales=_ranges(lower, upper),
        allowed=case.rounding["u"].max(axis=0, initial=0.0),
    )


def _velocity_bounds(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    items = case.scene.coordinates
    return np.array([item.velocity_lower for item in items]), np.array(
        [item.velocity_upper for item in items]
    )


def velocity_bound_violation(case: Evidence) -> Measured:
    """At the starts of the steps: the end belongs to the goal."""
    bounds = _velocity_bounds(case)
    values = eq.outside(case.v[:-1], *bounds)
    return Measured(values=values, scales=_ranges(*bounds), allowed=case.rounding["v"].max(axis=0))


def _ranges(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Widths; of one finite bound its size, or 1 where that is 0."""
    width = upper - lower
    one = np.where(
        np.isfinite(lower), np.abs(lower), np.where(np.isfinite(upper), np.abs(upper), 1.0)
    )
    return np.where(np.isfinite(width), width, np.where(one > 0.0, one, 1.0))


# Question 2


def terminal_error(case: Evidence) -> float:
    """Euclidean distance of the plan's end from the goal, over what the goal gives."""
    return distance(case.end, case.goal)


def terminal_position_error(case: Evidence) -> Measured:
    """Euclidean distance of the plan's last positions from the goal."""
    nq = case.scene.nq
    return Measured(
        values=distance(case.q[-1], case.goal[:nq]),
        allowed=float(np.linalg.norm(case.rounding["q"][-1])),
    )


def terminal_velocity_error(case: Evidence) -> Measured:
    """Euclidean distance of the plan's last velocities from the goal."""
    nq = case.scene.nq
    return Measured(
        values=distance(case.v[-1], case.goal[nq:]),
        allowed=float(np.linalg.norm(case.rounding["v"][-1])),
    )


def cost(case: Evidence) -> float:
    """The task's cost as the plan's own method counts it."""
    return case.cost_of_rows


# Question 3


def physics(case: Evidence) -> float:
    """Complementarity violation of the paper's (10) [N^2]."""
    return eq.physics(lam=case.lam, push=case.push)


def physics_scaled(case: Evidence) -> Measured:
    """Complementarity violation, the same on any grid [s]."""
    value = eq.physics_scaled(lam=case.lam, push=case.push, k=case.k, length=case.length, h=case.h)
    p_lam, p_push = case.rounding["lam"][:, : case.scene.nc], case.rounding_of_law
    rounded = (
        p_lam * (2.0 * np.abs(case.lam) + np.abs(case.push))
        + np.abs(case.lam) * p_push
        + p_lam * (p_lam + p_push)
    )
    allowed = float(
        (case.h[:, None] * rounded * (case.lam != 0.0) / (case.k * case.length) ** 2).sum()
    )
    return Measured(values=value, scales=case.trajectory.duration * case.scene.nc, allowed=allowed)


def contact_law_error(case: Evidence) -> Measured:
    """Impulse by which the planned contact forces miss the law, by the convention that suits them best [N s]."""
    law = case.laws[case.convention]
    touching = (case.lam != 0.0) | (law > 0.0) | (case.law_within.max(axis=0) > 0.0)
    off = case.rounding["lam"][:, : case.scene.nc] + case.rounding_of_law
    return Measured(
        values=float(case.h @ np.abs(case.lam - law).sum(axis=1)),
        scales=case.impulse_yardstick,
        allowed=float(case.h @ (touching * off).sum(axis=1)) + _grazing(case),
    )


def contact_force_error(case: Evidence) -> Measured:
    """Largest planned contact force beyond all that the law gives within a step of it, or below [N]."""
    within = case.law_within
    least, most = within.min(axis=0), within.max(axis=0)
    with suppress(Unmeasured):
        replayed = case.force_window
        least, most = np.minimum(least, replayed[0]), np.maximum(most, replayed[1])
    off = np.maximum(case.lam - most, least - case.lam)
    allowed = case.rounding["lam"][:, : case.scene.nc] + case.rounding_of_law
    value = float((off - allowed).max(initial=0.0))
    return Measured(values=value, scales=case.typical_force)


def velocity_error(case: Evidence) -> Measured:
    """Largest integral of abs(v - dq/dt) over a tenth of the plan, of each position [m or rad].

    The difference that rows as coarse as these show of the true motion is no fault of the plan.
    """
    t, q, v, step = case.trajectory.t, case.q, case.v, case.scene.task.step
    off = eq.rate_misfit(t, q, v, step)
    with suppress(Unmeasured):
        case.need("v")
        knots = case.replay.knots
        off = off - eq.rate_misfit(t, case.replay_q, case.replay_v[knots], step)
    nodes, shortest = slice(1, -1), np.maximum(np.minimum(np.diff(t)[1:], np.diff(t)[:-1]), step)
    off -= case.rounding["v"][nodes] + 2.0 * case.rounding["q"][nodes] / shortest[:, None]
    weights = (t[2:] - t[:-2]) / 2.0
    sums = np.vstack([0.0 * v[:1], np.cumsum(weights[:, None] * np.maximum(off, 0.0), axis=0)])
    ends = (t[1:] + t[:-1]) / 2.0
    later = [np.interp(ends + (t[-1] - t[0]) / 10.0, ends, column) for column in sums.T]
    return Measured(values=(np.array(later).T - sums).max(axis=0), scales=_nominals(case.scene))


def times_the_law(case: Evidence) -> np.ndarray:
    """How many times what the contact law gives the planned forces are, (nc,) [-]: 1 of a contact without force.

    By one convention for all. Raises Unmeasured where that does not explain them far better than
    the law itself does.
    """
    h, lam, least = case.h[:, None], case.lam, np.inf
    times = np.ones(case.scene.nc)
    for law in case.laws.values():
        given = (h * law**2).sum(axis=0)
        found = np.divide(
            (h * law * lam).sum(axis=0), given, out=np.ones_like(given), where=given > 0.0
        )
        left, of_law = (float((h * np.abs(lam - other)).sum()) for other in (found * law, law))
        if left <= _EXPLAINED * of_law and left < least:
            times, least = found, left
    if not math.isfinite(least):
        raise Unmeasured("the planned contact forces are no multiple of those of contact.")
    return times


def is_relaxed(case: Evidence) -> bool:
    """Whether the planned contact forces follow a relaxed law: they push at open gaps, the less the wider the gap is."""
    if "lam" in case.trajectory.missing or not isinstance(case.scene, Scene):
        return False
    depth = case.kernel.penetration(case.q[:-1])
    for lam, pen in zip(case.lam.T, depth.T, strict=True):
        order = np.argsort(pen, kind="stable")
        sorted_lam = lam[order]
        falls = float((np.maximum.accumulate(sorted_lam) - sorted_lam).sum())
        apart = float(lam[pen < 0.0].clip(0.0).sum())
        if apart > _CLEARLY * float(np.abs(lam).sum()) and falls <= _MONOTONE * float(lam.sum()):
            return True
    return False


def _grazing(case: Evidence) -> float:
    """Impulse of what is only just in touch [N s]: rounding, and no force."""
    return (
        1e-9 * float((case.k * case.length).max()) * case.trajectory.duration
        if isinstance(case.scene, Scene)
        else 0.0
    )


def force_sign_violation(case: Evidence) -> Measured:
    """Largest planned contact force that pulls [N]."""
    pulls = np.maximum(-case.lam, 0.0) - case.rounding["lam"][:, : case.scene.nc]
    return Measured(values=float(pulls.max(initial=0.0)), scales=case.typical_force)


def friction_violation(case: Evidence) -> Measured:
    """How far planned friction forces exceed mu N of their own rows, of each friction [N]."""
    return Measured(values=case.friction_excess.max(axis=0), scales=case.typical_friction)


def friction_dissipation_error(case: Evidence) -> Measured:
    """Power mu N |s| + f s that friction does not dissipate as it must, of each friction [W]."""
    (least, most), slip = case.friction_limits, case.slip
    nominal = np.array([item.nominal for item in case.scene.frictions])
    moving = np.abs(case.v[:-1]).max(axis=1) * case.rounding["q"][:-1].max(axis=1)
    p_slip = 2.0 * (case.rounding["v"][:-1].max(axis=1) + moving)[:, None]
    allowed = 2.0 * most * p_slip + 2.0 * case.rounding["lam"][:, case.scene.nc :] * np.abs(slip)
    values = eq.friction_dissipation_error(case.friction, least, most, slip) - allowed
    return Measured(
        values=np.maximum(values, 0.0).max(axis=0), scales=case.typical_friction * nominal
    )


# Question 4


def replay_error(case: Evidence) -> Measured:
    """Largest difference of plan and replay at the plan's nodes, of each position."""
    values = np.abs(case.q - case.replay_q).max(axis=0)
    return Measured(
        values=values,
        error=case.error.position,
        scales=_nominals(case.scene),
        allowed=case.rounding["q"].max(axis=0),
    )


def replay_terminal_error(case: Evidence) -> tuple[float, float]:
    """Euclidean distance of the replay's end from the goal, and its error."""
    return distance(case.replay_end, case.goal), case.error.state


def replay_terminal_position_error(case: Evidence) -> tuple[float, float]:
    """Euclidean distance of the replay's last positions from the goal, and its error."""
    # The norm over positions differs by at most as much as each of them does.
    error = min(case.error.state, case.error.position * float(np.sqrt(case.scene.nq)))
    return distance(case.replay_q[-1], case.goal[: case.scene.nq]), error


def replay_terminal_velocity_error(case: Evidence) -> tuple[float, float]:
    """Euclidean distance of the replay's last velocities from the goal, and its error."""
    return distance(case.replay_v[-1], case.goal[case.scene.nq :]), case.error.state


def replay_cost(case: Evidence) -> tuple[float, float]:
    """The task's cost of the replay, and its error."""
    replay, error = case.replay, case.error.state
    u = case.trajectory.u if replay.applied is None else replay.applied
    case.need("q", "v")
    t, q, v = replay.t, replay.q, replay.v
    value = case.cost_of(t, q, v, u)
    around = (
        [case.cost_of(t, q + sign * error, v + sign * error, u) for sign in (1.0, -1.0)]
        if np.isfinite(error)
        else [np.inf]
    )
    return value, max(abs(one - value) for one in around)


def replay_error_time(case: Evidence) -> float:
    """Time at which plan and replay differ most [s]."""
    return float(case.trajectory.t[eq.largest_difference(case.q, case.replay_q)[1]])


def grid_error(case: Evidence) -> tuple[float, float]:
    """Discretisation error: largest difference of the true law on the plan's grid and in continuous time [m or rad], and its error."""
    return eq.largest_difference(case.true_motion[0], case.replay_q)[0], case.error.position


def grid_order(case: Evidence) -> float:
    """Log2 of what the last halving of the plan's step does to its distance from the replay, its inputs held; halved as `halved` does."""
    error, near = grid_error(case)[0], float(replay_limits(case.scene).min()) / 4.0
    if error <= near:
        raise Unmeasured(
            "the discretisation error is far below the limit on replay_error, so that nothing need be known of its order."
        )
    order = 0.0
    for finer in halved(case, near):
        order = float(np.log2(error / finer)) if finer > 0.0 else np.inf
        error = finer
    return min(order, _HALVINGS)


def halved(case: Evidence, near: float) -> Iterator[float]:
    """The grid error with the plan's step halved once, twice, ... its inputs held [m or rad].

    Until it is at most `near`, two halvings in a row change next to nothing of what is left, or
    seven times. Raises Unmeasured.
    """
    before, idle = case.true_motion[0], 0
    for halvings in range(1, _HALVINGS + 1):
        q = case.own_motion(2**halvings)[0]
        error, _ = eq.largest_difference(q, case.replay_q)
        yield error
        idle = idle + 1 if eq.largest_difference(q, before)[0] < IDLE * (error - near) else 0
        if error <= near or idle == 2:
            return
        before = q


def replay_limits(scene: Subject) -> np.ndarray:
    """How far each position of a replay may be from the plan's, (nq,) [m or rad], where that is asked. Raises nothing."""
    own, nominals = scene.limit("replay_error"), _nominals(scene)
    if own is None or own.value is None:
        return REPLAY_ERROR * nominals
    return np.full(scene.nq, own.value)


# Question 5


def max_penetration(case: Evidence) -> Measured:
    """Deepest penetration of each contact in the replay [m]."""
    depths = np.array([np.inf if depth is None else depth for depth in case.scene.depths])
    depth, unsure = deepest(case)
    error = case.error.gap + unsure
    if not isinstance(case.scene, Scene):
        _check_gaps(case)
        # Between rows a smooth gap is below their chord by an eighth of its second difference.
        bends = (
            np.abs(
                np.diff(
                    np.vstack([case.replay_gap[:1], case.replay_gap, case.replay_gap[-1:]]),
                    2,
                    axis=0,
                )
            )
            / 8.0
        )
        error += np.take_along_axis(bends, case.replay_gap.argmin(axis=0)[None], 0)[0]
    return Measured(values=depth, error=error, scales=depths)


def _check_gaps(case: Evidence) -> None:
    """Raise Contradicted where a contact of somebody's FMU pushes, but its gap is open most of that time: gaps are negative in contact."""
    if "lam" in case.scene.lacks or "gap" in case.scene.lacks:  # type: ignore[union-attr] - a foreign model has it
        return
    pieces = np.append(case.duration, 0.0) + np.append(
        0.0, case.duration
    )  # twice the time around each row
    for contact, depth, force, gap in zip(
        case.scene.contacts, case.scene.depths, case.replay.lam.T, case.replay_gap.T, strict=True
    ):
        pushes = force > _CLEARLY * force.max(initial=0.0)
        opens = pushes & (gap > _CLEARLY * np.abs(gap[pushes]).max(initial=0.0))
        if depth is not None and 2.0 * pieces[opens].sum() > pieces[pushes].sum():
            share = pieces[opens].sum() / pieces[pushes].sum()
            raise Contradicted(
                f"contact {contact.name} pushes, but its gap is open in {100.0 * share:.0f} % of that time, and a gap is negative in contact; "
                "the map may have its sign (scale) or its zero (offset) wrong."
            )


def ghost_impulse(case: Evidence) -> Measured:
    """Planned contact impulse where the replay has none within a step [N s]."""
    return _of_impulses(
        case, lambda of: of.force_window[1], lambda most: eq.excess_impulse(case.lam, most, case.h)
    )


def missed_impulse(case: Evidence) -> Measured:
    """Contact impulse of the replay where the plan has none within a step [N s]."""
    return _of_impulses(
        case,
        lambda of: of.force_window[0],
        lambda least: eq.excess_impulse(least, case.lam, case.h),
    )


def _of_impulses(
    case: Evidence, window: Callable[[Evidence], np.ndarray], excess: Callable[[np.ndarray], float]
) -> Measured:
    """Measured by the impulse that plan and replay have in common, or a typical force for a moment.

    excess: the impulse [N s], by one end of the window of the replay's forces, (steps, nc) [N].
    """
    printed = float((case.h[:, None] * case.rounding["lam"][:, : case.scene.nc]).sum())
    forces, lagging = window(case), case.replay.lagging
    value, error = excess(forces), _impulse_error(case)
    if (
        lagging is not None
    ):  # both ways by twice what the lag changes, which is right to first order
        off = 2.0 * np.abs(forces - window(Evidence(case.scene, case.trajectory, lagging)))
        error += max(
            abs(excess(np.maximum(moved, 0.0)) - value) for moved in (forces + off, forces - off)
        )
    return Measured(
        values=value,
        error=error,
        scales=case.impulse_yardstick,
        allowed=printed + _grazing(case),
    )


def _impulse_error(case: Evidence) -> float:
    """Each force may be wrong by k times the error of its gap while there is contact.

    A damped one also by its error in the velocities; but for the lag's.
    """
    touching = float(
        (
            case.duration[:, None] * ((case.replay.lam[:-1] > 0.0) | (case.replay.lam[1:] > 0.0))
        ).sum()
    )
    if not isinstance(case.scene, Scene):  # its stiffness is what its own forces and gaps say
        # Where a contact begins, a damper's force stands over a depth of nothing.
        pressed = case.replay_gap < np.minimum(_CLEARLY * case.replay_gap.min(axis=0), 0.0)
        stiffness = np.divide(
            case.replay.lam, -case.replay_gap, out=np.zeros_like(case.replay.lam), where=pressed
        ).max(initial=0.0)
        return float(stiffness) * touching * case.error.gap if touching else 0.0
    lag = case.replay.error.lag or Difference(position=0.0, state=0.0, gap=0.0)
    error = float(case.slopes[0].max(initial=0.0)) * touching * (case.error.gap - lag.gap)
    return error + (
        float(case.slopes[1].max(initial=0.0)) * touching * (case.error.state - lag.state)
        if case.scene.damped
        else 0.0
    )


def replay_velocity_bound_violation(case: Evidence) -> Measured:
    """How far the replay's velocities leave their bounds, of each velocity."""
    values = eq.outside(case.replay_v[:-1], *_velocity_bounds(case))
    return Measured(values=values, error=case.error.state, scales=_nominals(case.scene))


# Question 6


def defect(case: Evidence) -> Measured:
    """How far the plan misses its declared scheme, of each component of the state."""
    p_q, p_v = (case.rounding[of].max(axis=0) for of in ("q", "v"))
    h = float(case.h.max())
    scheme = case.trajectory.scheme
    if scheme is not Scheme.SEMI_IMPLICIT_EULER:
        # Stages are not stored: its forces are taken to be those of the true law there.
        values = case.collocation_defect
        if not np.isfinite(values).all():
            name = "" if scheme is None else scheme.value
            raise LeavesBounds(f"a step of scheme {name} from a node of the plan has no solution.")
    else:
        values = eq.defect(q=case.q, v=case.v, acceleration=case.acceleration, h=case.h)
    nominals = _nominals(case.scene)
    position = 2.0 * p_q + h * p_v
    velocity = 2.0 * p_v + h * case.printing_acceleration
    return Measured(
        values=values,
        scales=np.concatenate([nominals, nominals]),
        allowed=np.concatenate([position, velocity]),
    )


def _explained(case: Evidence) -> float:
    """What a defect at its limit explains if each step has one and none grows or dies: steps times 1e-6 of the nominal."""
    return case.trajectory.steps * DEFECT * float(
        _nominals(case.scene).min()
    ) + case.trajectory.steps * float(case.rounding["q"].max(initial=0.0))


def law_error(case: Evidence) -> Measured:
    """Largest difference of the plan and its own time step under the true contact law [m or rad]."""
    return Measured(
        values=eq.largest_difference(case.q, case.true_motion[0])[0], scales=_explained(case)
    )


def discrete_terminal_error(case: Evidence) -> float:
    """Euclidean distance from the goal of the end of the plan's own time step under the true contact law."""
    return distance(case.true_end, case.goal)


def discrete_terminal(case: Evidence, part: str) -> Measured:
    """The same of the "position" or the "velocity" alone, beyond what the plan itself may miss the goal by."""
    own, nq = case.scene.limit(f"terminal_{part}_error"), case.scene.nq
    rows = slice(nq) if part == "position" else slice(nq, None)
    allowed = 0.0 if own is None or own.value is None else own.value
    return Measured(
        values=distance(case.true_end[rows], case.goal[rows]),
        scales=_explained(case),
        allowed=allowed,
    )


# The judge


def _work(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    if case.replay.input_work is None or case.replay.dissipated_work is None:
        raise Unmeasured("the FMU has no outputs input_power and dissipated_power.")
    return case.replay.input_work, case.replay.dissipated_work


def energy_residual(case: Evidence) -> float:
    """Energy that the replay makes or loses: work in, less dissipated, less the change of energy [J]."""
    return eq.energy_residual(case.replay.energy, *_work(case))


def energy_residual_relative(case: Evidence) -> float:
    """The same as a share of the energy that is turned over [-]."""
    replay, work = case.replay, _work(case)
    turned = eq.energy_turnover(
        replay.kinetic_energy, replay.potential_energy, replay.contact_energy, *work
    )
    speeds = _nominals(case.scene)[None, :]
    typical = float(case.kernel.energy(replay.q[:1], speeds)[0][0])
    return energy_residual(case) / max(turned, _AT_REST * typical)


def friction_impulse_error(case: Evidence) -> Measured:
    """Impulse of planned friction beyond what the replay has within a step of it, or below [N s].

    Frictions that hold a body together may share their load as they like: only what they do
    together counts.
    """
    kernel, scene, nc = case.kernel, case.equations, case.scene.nc
    least, most = force_window(case.replay.friction, case.step_of, case.trajectory.steps)
    q, v, u = case.replay_q[:-1], case.replay_v[case.replay.knots[:-1]], case.trajectory.u
    none = np.zeros_like(case.trajectory.lam)
    still = kernel.acceleration(q, v, u, none)

    def effect(friction: np.ndarray) -> np.ndarray:
        """Accelerations (steps, nq) [m/s^2, rad/s^2] by friction forces (steps, nf) [N].

        Raises KernelError.
        """
        forces = none.copy()
        forces[:, nc:] = friction
        return kernel.acceleration(q, v, u, forces) - still

    units = np.array([effect(row * np.ones((len(q), 1))) for row in np.eye(scene.nf)])
    unit = np.abs(units).max(axis=0)
    off = np.full(len(q), np.inf)
    for true in (np.clip(case.friction, least, most), (least + most) / 2.0):
        moved = np.abs(effect(case.friction - true))
        share = np.divide(moved, unit, out=np.zeros_like(moved), where=unit > 0.0)
        off = np.minimum(off, share.max(axis=1))
    off -= case.rounding["lam"][:, nc:].max(axis=1)
    held = float((np.abs(case.replay.friction[:-1]).sum(axis=1) * case.duration).sum())
    least_impulse = float(case.typical_friction.max()) * case.trajectory.duration / WINDOWS
    return Measured(values=float(case.h @ np.maximum(off, 0.0)), scales=max(held, least_impulse))


# Closed forms that the scene states (models.scene.parts.Answer.measure): each measure gives a value
# and how wrong the replay may make it, and speaks of the first contact: the first that closes, and
# the time until that one opens again.


def _first_contact(case: Evidence) -> tuple[Event, Event]:
    """The events at which the first contact closes and opens."""
    events = case.replay.events
    closing = next((event for event in events if event.closes), None)
    if closing is None:
        raise Unmeasured("no contact closes in the replay.")
    opening = next(
        (
            event
            for event in events
            if not event.closes and event.contact == closing.contact and event.time > closing.time
        ),
        None,
    )
    if opening is None:
        raise Unmeasured(f"contact {closing.contact} does not open again in the replay.")
    return closing, opening


def _gap_rate(case: Evidence, event: Event) -> float:
    """Rate of the gap of an event's contact at the event [m/s]."""
    row = int(np.argmin(np.abs(case.replay.t - event.time)))
    return _rate(case, row, [contact.name for contact in case.scene.contacts].index(event.contact))


def _rate(case: Evidence, row: int, contact: int) -> float:
    dynamics, replay = derive(case.equations), case.replay
    return float(
        dynamics.function(dynamics.gap_jacobian, dynamics.q)(replay.q[row])[contact] @ replay.v[row]
    )


def _closing_time(case: Evidence) -> tuple[float, float]:
    closing, _ = _first_contact(case)
    return closing.time, case.error.gap / abs(_gap_rate(case, closing))


def _duration(case: Evidence) -> tuple[float, float]:
    closing, opening = _first_contact(case)
    return opening.time - closing.time, sum(
        case.error.gap / abs(_gap_rate(case, event)) for event in (closing, opening)
    )


def _restitution(case: Evidence) -> tuple[float, float]:
    before, after = (_gap_rate(case, event) for event in _first_contact(case))
    return -after / before, 2.0 * case.error.state / abs(before)


def _depth(case: Evidence) -> tuple[float, float]:
    """Between the rows of the replay too: the gap there is the cubic with the gaps and their rates at both ends."""
    t, gap = case.replay.t, case.replay.gap
    deepest, contact = np.unravel_index(int(np.argmin(gap)), gap.shape)
    rows = range(max(0, int(deepest) - 1), min(len(t) - 1, int(deepest) + 1))
    s = np.linspace(
        0.0, 1.0, 2001
    )  # the depth is flat where it is largest: half a step there is 1e-7 of the fall since the row before
    lowest = 0.0
    for row in rows:
        h = t[row + 1] - t[row]
        ends, rates = (
            gap[row : row + 2, contact],
            [h * _rate(case, at, int(contact)) for at in (row, row + 1)],
        )
        cubic = (
            (1 + 2 * s) * (1 - s) ** 2 * ends[0]
            + s * (1 - s) ** 2 * rates[0]
            + s**2 * (3 - 2 * s) * ends[1]
            - s**2 * (1 - s) * rates[1]
        )
        lowest = min(lowest, float(cubic.min()))
    return -lowest, case.error.gap


MEASURES: dict[str, Callable[[Evidence], tuple[float, float]]] = {
    "closing time": _closing_time,
    "contact time": _duration,
    "restitution": _restitution,
    "depth": _depth,
}


def answer_error(case: Evidence) -> tuple[float, float]:
    """Largest distance of the replay from a measured answer of the scene, in that answer's tolerance, and its own error in the same unit."""
    distances, errors = [], []
    for answer in case.scene.answers:
        if answer.measure:
            value, error = MEASURES[answer.measure](case)
            distances.append(abs(value - answer.value) / answer.tolerance)
            errors.append(error / answer.tolerance)
    return max(distances), max(errors)
