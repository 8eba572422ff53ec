"""Measures of the metrics: from the evidence to a number, its error and its scale."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from models.collocation import penetration_rates
from models.scene import Scene
from models.scene.goal import distance
from models.scene.impulses import excess_impulse, force_window
from models.schemes import Scheme
from models.trajectory import WINDOWS, Hold
from validate.judge.replay.result import Difference
from validate.judge.replay.subject import Subject
from validate.judge.score import equations as eq
from validate.judge.score.depths import deepest
from validate.judge.score.evidence import Evidence
from validate.judge.score.verdict import Contradicted, LeavesBounds, Unmeasured

DEFECT = 1e-6
# Lowest order of an error that vanishes with the step: halfway between one that stays (0) and the
# lowest order of a right step (1).
LEAST_ORDER = 0.5
# Largest order that is reported, of an error that vanishes at once.
_LARGEST_ORDER = 7.0
# Relative size below which a force or gap is zero.
_CLEARLY = 1e-2
# Largest unexplained share of forces that are a multiple of the law's.
_EXPLAINED = 0.1
# Largest decreasing share of forces that depend on the gap alone.
_MONOTONE = 0.05
# Scale of energy at rest, as a fraction of the kinetic energy at nominal speeds.
_AT_REST = 1e-3


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Values (n,) of a metric's components, in the units of its row, or one number.

    - error: by the replay's error.
    - scales (n,): of the default limit.
    - allowed (n,): by rounding, added to the limit.
    """

    values: np.ndarray | float
    error: np.ndarray | float = 0.0
    scales: np.ndarray | float = 1.0
    allowed: np.ndarray | float = 0.0


def _nominals(scene: Subject) -> np.ndarray:
    return np.array([item.nominal for item in scene.coordinates])


def start_error(case: Evidence) -> Measured:
    """Return the distance of the plan's first state from the replay's start, by component."""
    start, nominals = case.task_start, _nominals(case.scene)
    to_goal = np.abs(case.goal - start)
    # A task of a micrometre must not start a millionth of a metre away.
    scales = np.fmin(np.tile(nominals, 2), np.where(to_goal > 0.0, to_goal, np.nan))
    values, groups, rows = np.abs(case.q[0] - start[: case.scene.nq]), ["q"], case.scene.nq
    # Without inertia the inputs determine the initial velocity.
    if "v" not in {*case.trajectory.missing, *case.lacking} and case.has_inertia:
        values = np.append(values, np.abs(case.trajectory.v[0] - start[rows:]))
        groups, rows = ["q", "v"], 2 * rows
    allowed = np.concatenate([case.rounding[of][0] for of in groups])
    return Measured(values=values, scales=scales[:rows], allowed=allowed)


def duration_error(case: Evidence) -> Measured:
    """Return the difference of the plan's and the task's duration [s]."""
    horizon = float(case.scene.task.horizon or 0.0)
    return Measured(values=abs(case.trajectory.duration - horizon), scales=case.scene.task.step)


def bound_violation(case: Evidence) -> Measured:
    """Return the violation of the bounds by each input."""
    plan, inputs = case.trajectory, case.scene.inputs
    lower, upper = np.array([(item.lower, item.upper) for item in inputs]).reshape(-1, 2).T
    applied = plan.u
    if plan.u_end is not None and plan.hold is Hold.LINEAR:
        applied = np.vstack([plan.u, plan.u_end])
    return Measured(
        values=eq.outside(applied, lower, upper),
        scales=_ranges(lower, upper),
        allowed=case.rounding["u"].max(axis=0, initial=0.0),
    )


def _velocity_bounds(case: Evidence) -> tuple[np.ndarray, np.ndarray]:
    bounds = [(item.velocity_lower, item.velocity_upper) for item in case.scene.coordinates]
    lower, upper = np.array(bounds).T
    return lower, upper


def velocity_bound_violation(case: Evidence) -> Measured:
    """Return the violation at the starts of steps; the end belongs to the goal."""
    bounds = _velocity_bounds(case)
    values = eq.outside(case.v[:-1], *bounds)
    return Measured(values=values, scales=_ranges(*bounds), allowed=case.rounding["v"].max(axis=0))


def _ranges(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the widths; for one finite bound its size, or 1."""
    width, finite = upper - lower, np.where(np.isfinite(lower), lower, upper)
    one = np.where(np.isfinite(finite) & (finite != 0.0), np.abs(finite), 1.0)
    return np.where(np.isfinite(width), width, one)


# Last positions and velocities (nq,) [m or rad, per s] by the prefix of the metrics.
_ENDS: dict[str, tuple[Callable[[Evidence], np.ndarray], Callable[[Evidence], np.ndarray]]] = {
    "": (lambda case: case.q[-1], lambda case: case.v[-1]),
    "replay_": (lambda case: case.replay_q[-1], lambda case: case.replay_v[-1]),
    "discrete_": (lambda case: case.true_motion[0][-1], lambda case: case.true_motion[1][-1]),
}


def end_error(case: Evidence, of: str, part: str) -> Measured:
    """Return the distance of an end from the goal; of: prefix; part: "position", "velocity", ""."""
    goals = np.split(case.goal, 2)
    parts = [index for index, name in enumerate(("position", "velocity")) if part in (name, "")]
    parts = [index for index in parts if np.isfinite(goals[index]).any()]
    values = np.linalg.norm([distance(_ENDS[of][index](case), goals[index]) for index in parts])
    if of == "replay_":
        # A norm over positions differs at most by the norm of their errors.
        error = case.error.position * float(np.sqrt(case.scene.nq))
        error = min(case.error.state, error) if parts == [0] else case.error.state
        return Measured(values=float(values), error=error)
    if not part:
        return Measured(values=float(values))
    if of == "":
        rounding = case.rounding["q" if part == "position" else "v"][-1]
        return Measured(values=float(values), allowed=float(np.linalg.norm(rounding)))
    own = case.scene.limit(f"terminal_{part}_error")
    return Measured(
        values=float(values),
        scales=_explained(case),
        allowed=0.0 if own is None or own.value is None else own.value,
    )


def cost(case: Evidence) -> float:
    """Return the task's cost as methods compute it."""
    return case.cost_of_rows


def physics(case: Evidence) -> float:
    """Return the complementarity violation (10) of the paper [N^2]."""
    return eq.physics(lam=case.lam, push=case.push)


def physics_scaled(case: Evidence) -> Measured:
    """Return the complementarity violation on any grid [s]."""
    lam, push, h, length = case.lam, case.push, case.h, case.length
    value = eq.physics_scaled(lam=lam, push=push, k=case.k, length=length, h=h)
    p_lam, p_push = case.rounding["lam"][:, : case.scene.nc], case.rounding_of_law
    rounded = p_lam * (2.0 * np.abs(lam) + np.abs(push)) + np.abs(lam) * p_push
    rounded += p_lam * (p_lam + p_push)
    allowed = float((h[:, None] * rounded * (lam != 0.0) / (case.k * length) ** 2).sum())
    return Measured(values=value, scales=case.trajectory.duration * case.scene.nc, allowed=allowed)


def contact_law_error(case: Evidence) -> Measured:
    """Return the impulse error of planned contact forces by their best convention [N s]."""
    law = case.laws[case.convention]
    touching = (case.lam != 0.0) | (law > 0.0) | (case.law_within.max(axis=0) > 0.0)
    off = case.rounding["lam"][:, : case.scene.nc] + case.rounding_of_law
    return Measured(
        values=float(case.h @ np.abs(case.lam - law).sum(axis=1)),
        scales=case.impulse_yardstick,
        allowed=float(case.h @ (touching * off).sum(axis=1)) + _grazing(case),
    )


def contact_force_error(case: Evidence) -> Measured:
    """Return the largest excess of a planned contact force over the law near its step [N]."""
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
    """Return the largest integral of abs(v - dq/dt) over a tenth of the plan, by position.

    The true motion's own difference on such coarse rows is subtracted.
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
    """Return planned forces over the law's, (nc,) [-], 1 without force, by one convention.

    Raises Unmeasured unless that explains them far better than the law does.
    """
    h, lam, found = case.h[:, None], case.lam, []
    for law in case.laws.values():
        norm = (h * law**2).sum(axis=0)
        factors = (h * law * lam).sum(axis=0) / np.where(norm > 0.0, norm, 1.0)
        factors = np.where(norm > 0.0, factors, 1.0)
        left, of_law = (float((h * np.abs(lam - other)).sum()) for other in (factors * law, law))
        if left <= _EXPLAINED * of_law:
            found.append((left, factors))
    if not found:
        raise Unmeasured("the planned contact forces are no multiple of those of contact.")
    return min(found, key=lambda one: one[0])[1]


def is_relaxed(case: Evidence) -> bool:
    """Return whether planned forces act at open gaps, decreasing with the gap."""
    if "lam" in case.trajectory.missing or not isinstance(case.scene, Scene):
        return False
    depths = case.kernel.penetration(case.q[:-1])
    for lam, depth in zip(case.lam.T, depths.T, strict=True):
        rising = lam[np.argsort(depth, kind="stable")]
        falls = float((np.maximum.accumulate(rising) - rising).sum())
        apart = float(lam[depth < 0.0].clip(0.0).sum())
        if apart > _CLEARLY * np.abs(lam).sum() and falls <= _MONOTONE * lam.sum():
            return True
    return False


def _grazing(case: Evidence) -> float:
    """Return the impulse of grazing contacts [N s], which is rounding."""
    if not isinstance(case.scene, Scene):
        return 0.0
    return 1e-9 * float((case.k * case.length).max()) * case.trajectory.duration


def force_sign_violation(case: Evidence) -> Measured:
    """Return the largest pulling contact force of the plan [N]."""
    pulls = np.maximum(-case.lam, 0.0) - case.rounding["lam"][:, : case.scene.nc]
    return Measured(values=float(pulls.max(initial=0.0)), scales=case.typical_force)


def friction_violation(case: Evidence) -> Measured:
    """Return the excess of planned friction over mu N, by friction [N]."""
    return Measured(values=case.friction_excess.max(axis=0), scales=case.typical_friction)


def friction_dissipation_error(case: Evidence) -> Measured:
    """Return the power mu N |s| + f s that friction fails to dissipate, by friction [W]."""
    (least, most), slip = case.friction_limits, case.slip
    nominal = np.array([item.nominal for item in case.scene.frictions])
    moving = np.abs(case.v[:-1]).max(axis=1) * case.rounding["q"][:-1].max(axis=1)
    p_slip = 2.0 * (case.rounding["v"][:-1].max(axis=1) + moving)[:, None]
    allowed = 2.0 * most * p_slip + 2.0 * case.rounding["lam"][:, case.scene.nc :] * np.abs(slip)
    values = eq.friction_dissipation_error(case.friction, least, most, slip) - allowed
    return Measured(
        values=np.maximum(values, 0.0).max(axis=0), scales=case.typical_friction * nominal
    )


def replay_error(case: Evidence) -> Measured:
    """Return the largest difference of plan and replay at nodes, by position."""
    values, allowed = np.abs(case.q - case.replay_q).max(axis=0), case.rounding["q"].max(axis=0)
    scales = _nominals(case.scene)
    return Measured(values=values, error=case.error.position, scales=scales, allowed=allowed)


def replay_cost(case: Evidence) -> tuple[float, float]:
    """Return the task's cost of the replay, and its error."""
    case.need("q", "v")
    replay, error = case.replay, case.error.state
    u = case.trajectory.u if replay.applied is None else replay.applied
    t, q, v = replay.t, replay.q, replay.v
    value = case.cost_of(t, q, v, u)
    if not np.isfinite(error):
        return value, np.inf
    around = (case.cost_of(t, q + off, v + off, u) for off in (error, -error))
    return value, max(abs(one - value) for one in around)


def grid_error(case: Evidence) -> tuple[float, float]:
    """Return the discretisation error [m or rad] of the plan's grid, and its own error."""
    return case.grid_errors[0], case.error.position


def grid_order(case: Evidence) -> float:
    """Return the order with which the last halving of the step reduces the discretisation error."""
    if len(case.grid_errors) == 1:
        raise Unmeasured("the discretisation error is far below the limit on replay_error.")
    coarse, fine = case.grid_errors[-2:]
    return min(float(np.log2(coarse / fine)), _LARGEST_ORDER) if fine > 0.0 else _LARGEST_ORDER


def max_penetration(case: Evidence) -> Measured:
    """Return the deepest penetration of each contact in the replay [m]."""
    depths = np.array([np.inf if depth is None else depth for depth in case.scene.depths])
    depth, unsure = deepest(case)
    error = case.error.gap + unsure
    if not isinstance(case.scene, Scene):
        _check_gaps(case)
        # Between rows a smooth gap is below its chord by an eighth of its second difference.
        bends = np.abs(np.diff(np.pad(case.replay_gap, ((1, 1), (0, 0)), mode="edge"), 2, axis=0))
        lowest = case.replay_gap.argmin(axis=0)[None]
        error += np.take_along_axis(bends, lowest, 0)[0] / 8.0
    return Measured(values=depth, error=error, scales=depths)


def _check_gaps(case: Evidence) -> None:
    """Raise Contradicted if a contact of an external FMU pushes mostly at open gaps."""
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
    """Return the planned contact impulse without the replay's within a step [N s]."""
    return _of_impulses(case, 1, lambda most: excess_impulse(case.lam, most, case.h))


def missed_impulse(case: Evidence) -> Measured:
    """Return the replay's contact impulse without the plan's within a step [N s]."""
    return _of_impulses(case, 0, lambda least: excess_impulse(least, case.lam, case.h))


def _of_impulses(case: Evidence, end: int, excess: Callable[[np.ndarray], float]) -> Measured:
    """Return the impulse [N s] in excess of one end of the force window (steps, nc) [N]."""
    printed = float((case.h[:, None] * case.rounding["lam"][:, : case.scene.nc]).sum())
    forces, lagging = case.force_window[end], case.replay.lagging
    value, error = excess(forces), _impulse_error(case)
    if lagging is not None:  # both ways, by twice the lag's first-order change
        late = Evidence(case.scene, case.trajectory, lagging).force_window[end]
        off = 2.0 * np.abs(forces - late)
        moved = [np.maximum(forces + change, 0.0) for change in (off, -off)]
        error += max(abs(excess(one) - value) for one in moved)
    allowed = printed + _grazing(case)
    return Measured(values=value, error=error, scales=case.impulse_yardstick, allowed=allowed)


def _impulse_error(case: Evidence) -> float:
    """Return the error of impulses: stiffness times gap error, damping times velocity error.

    The lag's error is excluded.
    """
    lam, gap, error = case.replay.lam, case.replay_gap, case.error
    touches = (lam[:-1] > 0.0) | (lam[1:] > 0.0)
    touching = float((case.duration[:, None] * touches).sum())
    if not isinstance(case.scene, Scene):  # stiffness from its own forces and gaps
        # At the start of a contact, damping divides by a depth near zero.
        pressed = gap < np.minimum(_CLEARLY * gap.min(axis=0), 0.0)
        stiffness = np.divide(lam, -gap, out=np.zeros_like(lam), where=pressed).max(initial=0.0)
        return float(stiffness) * touching * error.gap if touching else 0.0
    lag = case.replay.error.lag or Difference(position=0.0, state=0.0, gap=0.0)
    by_depth, by_rate = (float(part.max(initial=0.0)) for part in case.slopes)
    found = by_depth * touching * (error.gap - lag.gap)
    return found + (by_rate * touching * (error.state - lag.state) if case.scene.damped else 0.0)


def replay_velocity_bound_violation(case: Evidence) -> Measured:
    """Return the violation of bounds by the replay's velocities."""
    values = eq.outside(case.replay_v[:-1], *_velocity_bounds(case))
    return Measured(values=values, error=case.error.state, scales=_nominals(case.scene))


def defect(case: Evidence) -> Measured:
    """Return the residual of the declared scheme, by component of the state."""
    p_q, p_v = (case.rounding[of].max(axis=0) for of in ("q", "v"))
    h, scheme = float(case.h.max()), case.trajectory.scheme
    if scheme is Scheme.SEMI_IMPLICIT_EULER:
        values = eq.defect(q=case.q, v=case.v, acceleration=case.acceleration, h=case.h)
    else:  # stages are not stored; their forces are those of the true law
        values = case.collocation_defect
        if not np.isfinite(values).all():
            raise LeavesBounds(
                f"a step of scheme {scheme and scheme.value} from a node of the plan has no solution."
            )
    rounded = np.append(2.0 * p_q + h * p_v, 2.0 * p_v + h * case.printing_acceleration)
    return Measured(values=values, scales=np.tile(_nominals(case.scene), 2), allowed=rounded)


def _explained(case: Evidence) -> float:
    """Return the effect of a defect at its limit in each step: steps times 1e-6 nominal."""
    return case.trajectory.steps * DEFECT * float(
        _nominals(case.scene).min()
    ) + case.trajectory.steps * float(case.rounding["q"].max(initial=0.0))


def law_error(case: Evidence) -> Measured:
    """Return the difference of the plan and its scheme under true contact [m or rad]."""
    return Measured(
        values=eq.largest_difference(case.q, case.true_motion[0])[0], scales=_explained(case)
    )


def energy_residual_relative(case: Evidence) -> float:
    """Return the largest error of the replay's energy balance, of the energy turned over [-]."""
    replay = case.replay
    if replay.input_work is None or replay.dissipated_work is None:
        raise Unmeasured("the FMU has no outputs input_power and dissipated_power.")
    works = replay.input_work, replay.dissipated_work
    turned = [*map(np.max, (replay.kinetic_energy, replay.contact_energy, *np.abs(works)))]
    speeds = _nominals(case.scene)[None, :]
    typical = float(case.kernel.energy(replay.q[:1], speeds)[0][0])
    largest = max(*turned, np.ptp(replay.potential_energy), _AT_REST * typical)
    return eq.energy_residual(replay.energy, *works) / float(largest)


def friction_impulse_error(case: Evidence) -> Measured:
    """Return the friction impulse beyond the replay's within a step [N s].

    Frictions on one body may share loads arbitrarily, so only their joint effect counts.
    """
    kernel, scene, nc = case.kernel, case.equations, case.scene.nc
    least, most = force_window(case.replay.friction, case.step_of, case.trajectory.steps)
    q, v, u = case.replay_q[:-1], case.replay_v[case.replay.knots[:-1]], case.trajectory.u
    none = np.zeros_like(case.trajectory.lam)
    still = kernel.acceleration(q, v, u, none)

    def effect(friction: np.ndarray) -> np.ndarray:
        """Return accelerations (steps, nq) [m/s^2, rad/s^2] by friction (steps, nf) [N].

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


# Measures of closed forms (models.scene.parts.Answer.measure): value and error, of the first
# contact from its closing to its opening.


def _first_contact(case: Evidence) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the times [s] and gap rates [m/s] at the first contact's closing and opening."""
    events = iter(case.replay.events)
    closing = next((event for event in events if event.closes), None)
    if closing is None:
        raise Unmeasured("no contact closes in the replay.")
    name = closing.contact
    opening = next((event for event in events if not event.closes and event.contact == name), None)
    if opening is None:
        raise Unmeasured(f"contact {name} does not open again in the replay.")
    times = closing.time, opening.time
    rows = [int(np.argmin(np.abs(case.replay.t - time))) for time in times]
    contact = [item.name for item in case.scene.contacts].index(name)
    rates = -penetration_rates(case.kernel, case.replay.q[rows], case.replay.v[rows])[:, contact]
    return times, (float(rates[0]), float(rates[1]))


def _closing_time(case: Evidence) -> tuple[float, float]:
    (closing, _), (rate, _) = _first_contact(case)
    return closing, case.error.gap / abs(rate)


def _duration(case: Evidence) -> tuple[float, float]:
    (closing, opening), rates = _first_contact(case)
    return opening - closing, sum(case.error.gap / abs(rate) for rate in rates)


def _restitution(case: Evidence) -> tuple[float, float]:
    _, (before, after) = _first_contact(case)
    return -after / before, 2.0 * case.error.state / abs(before)


def _depth(case: Evidence) -> tuple[float, float]:
    depth, unsure = deepest(case)
    contact = int(depth.argmax())
    return float(depth[contact]), case.error.gap + float(unsure[contact])


MEASURES: dict[str, Callable[[Evidence], tuple[float, float]]] = {
    "closing time": _closing_time,
    "contact time": _duration,
    "restitution": _restitution,
    "depth": _depth,
}


def answer_error(case: Evidence) -> tuple[float, float]:
    """Return the replay's largest distance from measured answers, and error, in tolerances."""
    answers = [answer for answer in case.scene.answers if answer.measure]
    found = [(answer, *MEASURES[answer.measure](case)) for answer in answers]
    distances = [abs(value - answer.value) / answer.tolerance for answer, value, _ in found]
    return max(distances), max(error / answer.tolerance for answer, _, error in found)
