"""The mean force a step that a plan's inputs and true contact do not explain, from the plan's own states: needs no scheme and no force column.

From each of the plan's states the true motion is run over one step under the plan's inputs
(validate.judge.score.own_steps). What the plan's next velocity differs by, dv, takes a mean force M
dv/h that nobody gives. Forces along different coordinates are compared in the norm of M^-1, in
which a contact force lam has the size lam sqrt(J M^-1 J'): so a force that is not there is measured
in contact forces of the same effect.

Of a scene without inertia (models.scene.quasi_static) forces are velocities: what its position
differs by after the step, dq, takes the mean force D dq/h.

A plan that says both must not move by more or less than its velocities at both ends of the step, or
the true motion, allow. Friction forces that it claims must move it as the true ones do: within mu N
a sticking one is not free, it is what holds. Velocities that it does not say follow from its
positions, in whichever of two ways explains it better: those with which the true motion arrives at
the next position - what then jumps at a node is unexplained, and by how much the next position is
missed -, or backward differences, which are the velocities of whoever steps as semi-implicit Euler
does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.scene import Scene
from models.trajectory import Trajectory
from validate.judge.replay.result import Replay
from validate.judge.score.evidence import Evidence, sizes
from validate.judge.score.own_steps import ROUNDED
from validate.judge.score.verdict import Unmeasured

# What the metric is limited by where a scene sets nothing.
LIMIT = 0.1
# Velocities by which a coordinate would move so many times further than it does, over the whole
# plan, are not those of its positions.
_OTHERWISE = 10.0


def unexplained_force(case: Evidence) -> float:
    """Largest unexplained mean force of a step, as a share of the peak contact force of the replay (or of what else drives it: `Evidence.reference_force`)."""
    reference = case.reference_force
    return float(_forces(case, LIMIT * reference).max()) / reference


def _forces(case: Evidence, enough: float) -> np.ndarray:
    """(steps,) sqrt(dv' M dv)/h of each step, less what printing may be the cause of.

    `enough` explains it.
    """
    found = _of_motion(case, enough)
    if (
        not case.scene.nf
        or case.trajectory.missing & {"friction", "lam"}
        or case.trajectory.scheme is not None
    ):
        return found
    try:
        return np.maximum(found, _of_friction(case))
    except Unmeasured:
        if found.max() > enough:
            return found
        raise


def _of_friction(case: Evidence) -> np.ndarray:
    """(steps,) the force by which the friction that a plan claims moves it otherwise than the true one: sticking friction is whatever holds, no more.

    Several frictions may share that as they like: what counts is the sum of what they do. The true
    one of a step is any between its least and most in this step and the next, whose input may set
    in at the node.
    """
    kernel, plan, nc = case.kernel, case.trajectory, case.scene.nc
    own = case.own_steps(case.own_velocities[:-1])
    least, most = (array[:, nc:] for array in (own.least, own.most))
    least, most = (
        np.minimum(least, np.vstack([least[1:], least[-1:]])),
        np.maximum(most, np.vstack([most[1:], most[-1:]])),
    )
    p_lam = case.printing["lam"]

    def differs(true: np.ndarray) -> np.ndarray:
        """(steps,) [N] between the claimed friction and a true one (steps, nf) [N].

        Raises KernelError.
        """
        claimed, real = plan.lam.copy(), plan.lam.copy()
        claimed[:, nc:], real[:, nc:] = case.friction, true
        v = case.own_velocities[:-1]
        change = kernel.acceleration(case.q[:-1], v, plan.u, claimed) - kernel.acceleration(
            case.q[:-1], v, plan.u, real
        )
        return sizes(case.masses[:-1], change)

    return np.minimum(
        differs(np.clip(case.friction, least - p_lam, most + p_lam)), differs((least + most) / 2.0)
    )


def _of_motion(case: Evidence, enough: float) -> np.ndarray:
    """(steps,) the same of the motion alone."""
    plan, h = case.trajectory, np.diff(case.trajectory.t)
    if "v" not in plan.missing:
        return _by_velocities(case, h, plan.v, _off(case, "v"))
    if case.equations.relaxation_index is not None:
        return _without_inertia(case, h, case.departures.v)
    return _of_positions(case, h, enough)[1]


def _of_positions(case: Evidence, h: np.ndarray, enough: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocities (nodes, nq) that explain the positions better, and what they leave (steps,)."""
    backward = np.vstack([case.start_velocity, np.diff(case.q, axis=0) / h[:, None]])
    found = _by_velocities(case, h, backward, 2.0 * case.printing["q"] / float(h.min()))
    if found.max() > enough and (departing := _by_departures(case, h)).max() < found.max():
        return case.own_velocities, departing
    return backward, found


def with_velocities(scene: Scene, plan: Trajectory, replayed: Replay) -> Trajectory:
    """A plan of positions alone beside the velocities that explain its motion, for feedback to follow; any other plan, and one without inertia, as it is."""
    if "v" not in plan.missing or not plan.has_states or scene.relaxation_index is not None:
        return plan
    case = Evidence(scene, plan, replayed)
    try:
        v = _of_positions(case, np.diff(plan.t), LIMIT * case.reference_force)[0]
    except Unmeasured:
        return plan
    return replace(plan, v=np.vstack([case.start_velocity, v[1:]]))


def _off(case: Evidence, group: str) -> float:
    """What printing and rounding may change of the plan's "t", "q" or "v".

    In the unit of the group.
    """
    return max(
        case.printing[group],
        ROUNDED * float(np.abs(getattr(case.trajectory, group)).max(initial=0.0)),
    )


def _by_velocities(case: Evidence, h: np.ndarray, v: np.ndarray, p_v: float) -> np.ndarray:
    """(steps,) with velocities v (nodes, nq) printed to p_v."""
    q, p_q, mass = case.q, _off(case, "q"), case.masses
    late = 2.0 * _off(
        case, "t"
    )  # a node that is printed late has moved on by its speed, and its speed by its acceleration
    moved = np.diff(q, axis=0)
    low, high = np.minimum(v[:-1], v[1:]) * h[:, None], np.maximum(v[:-1], v[1:]) * h[:, None]
    beyond = np.maximum(np.maximum(moved - high, low - moved), 0.0)
    try:
        ends = case.own_steps(v[:-1]).ends
    except Unmeasured:  # as of velocities in another unit, too fast for any number of parts: what the positions then say needs no motion
        otherwise = beyond.sum(axis=0) > _OTHERWISE * np.abs(moved).sum(axis=0)
        needed = sizes(mass[1:], beyond * otherwise / h[:, None]) / (
            h if case.equations.relaxation_index is None else _relaxation_time(case)
        )
        if needed.max() > LIMIT * case.reference_force:
            return needed
        raise
    arriving_q, arriving = ends[:, : case.scene.nq], ends[:, case.scene.nq :]
    beyond = np.minimum(beyond, np.abs(q[1:] - arriving_q))
    beyond = (
        np.maximum(beyond - 2.0 * p_q - h[:, None] * p_v - late * np.abs(v[:-1]), 0.0) / h[:, None]
    )
    if case.equations.relaxation_index is not None:
        return np.maximum(
            _without_inertia(case, h, v[:-1]), sizes(mass[1:], beyond) / _relaxation_time(case)
        )
    jump = v[1:] - arriving
    allowed = (
        2.0 * p_v
        + h * case.printing_acceleration
        + late * np.abs((arriving - v[:-1]) / h[:, None]).max(axis=1)
    )
    return (
        np.maximum(
            sizes(mass[1:], jump) - allowed * sizes(mass[1:], np.ones(case.scene.nq)),
            sizes(mass[1:], beyond),
        ).clip(0.0)
        / h
    )


def _without_inertia(case: Evidence, h: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(steps,) of a scene whose forces are velocities, from velocities v (steps, nq) at the starts: D (moved - moves)/h, with M = tau D."""
    mass = case.masses[1:]
    missed = (case.q[1:] - case.own_steps(v).ends[:, : case.scene.nq]) / h[:, None]
    allowed = (
        2.0 * _off(case, "q") + 2.0 * _off(case, "t") * np.abs(v).max(axis=1)
    ) / h + h * case.printing_acceleration
    return (sizes(mass, missed) - allowed * sizes(mass, np.ones(case.scene.nq))).clip(
        0.0
    ) / _relaxation_time(case)


def _relaxation_time(case: Evidence) -> float:
    """Relaxation time tau [s] of a scene without inertia."""
    return case.equations.parameters[case.equations.relaxation_index].value  # type: ignore[index] - asked where there is one


def _by_departures(case: Evidence, h: np.ndarray) -> np.ndarray:
    """(steps,) with the velocities that lead from each position to the next.

    The first must be the task's.
    """
    p_q, mass, departing, gains = (
        _off(case, "q"),
        case.masses,
        case.departures.v,
        case.departures.gains,
    )
    late = 2.0 * _off(case, "t")
    arriving = case.own_steps(departing).ends[:, case.scene.nq :]
    jump = np.vstack([departing[:1] - case.start_velocity, departing[1:] - arriving[:-1]])
    spans = np.concatenate([h[:1], (h[1:] + h[:-1]) / 2.0])
    allowed = (2.0 * p_q + late * np.abs(departing).max(axis=1)) * (
        gains + np.concatenate([gains[:1], gains[:-1]])
    ) + h * case.printing_acceleration
    unit = sizes(mass[:-1], np.ones(case.scene.nq))
    missed = (sizes(mass[:-1], case.departures.missed) - 2.0 * p_q * unit) / h**2
    return np.maximum((sizes(mass[:-1], jump) - allowed * unit) / spans, missed).clip(0.0)
