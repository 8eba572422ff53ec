"""The mean force a step that a plan's inputs and true contact do not explain, from the plan's own states: needs no scheme and no force column.

From each of the plan's states the true motion is run over one step under the plan's inputs (small steps of the compiled kernel). What the plan's next
velocity differs by, dv, takes a mean force M dv/h that nobody gives. Forces along different coordinates are compared in the norm of M^-1, in which a
contact force lam has the size lam sqrt(J M^-1 J'): so a force that is not there is measured in contact forces of the same effect.

Of a scene without inertia (models.quasi_static) forces are velocities: what its position differs by after the step, dq, takes the mean force D dq/h.

A plan that says both must not move by more or less than its velocities at both ends of the step, or the true motion, allow. Velocities that it does
not say follow from its positions, in whichever of two ways explains it better: those with which the true motion arrives at the next position - what
then jumps at a node is unexplained -, or backward differences, which are the velocities of whoever steps as semi-implicit Euler does.
"""

from __future__ import annotations

import numpy as np

from models.codegen.kernel import KernelError
from models.dynamics import derive
from validate.score.evidence import Evidence, LeavesBounds, Unmeasured

# Small steps within one of the plan's: the error of a force is a hundredth of its change over the step.
_SUBSTEPS = 50
# Newton steps towards the velocity with which the next position is reached; dq/dv is h I but for what contacts turn.
_SHOTS = 4
# What counts as a contact force at least, of the inputs' range: a plan that only grazes is not held to a millionth of a newton.
_SHARE_OF_RANGE = 0.1


def unexplained_force(case: Evidence) -> float:
    """Largest unexplained mean force of a step, as a share of the peak contact force of the replay (or of the inputs: `_reference`)."""
    reference = _reference(case)
    if reference == 0.0:
        raise Unmeasured("there is neither contact force nor input to measure it by.")
    return float(_forces(case).max()) / reference


def _forces(case: Evidence) -> np.ndarray:
    """(steps,) sqrt(dv' M dv)/h of each step, less what printing may be the cause of."""
    plan, h = case.trajectory, np.diff(case.trajectory.t)
    if "v" not in plan.missing:
        return _by_velocities(case, h, plan.v, case.printing("v"))
    if case.equations.relaxation_index is not None:
        return _without_inertia(case, h, _departures(case, h))
    backward = np.vstack([case.start_velocity, np.diff(case.q, axis=0) / h[:, None]])
    readings = _by_departures(case, h), _by_velocities(case, h, backward, 2.0 * case.printing("q") / float(h.min()))
    return min(readings, key=lambda forces: forces.max())


def _by_velocities(case: Evidence, h: np.ndarray, v: np.ndarray, p_v: float) -> np.ndarray:
    """(steps,) with velocities v (nodes, nq) printed to p_v."""
    q, p_q, mass = case.q, case.printing("q"), _masses(case, case.q)
    late = 2.0 * case.printing("t")  # a node that is printed late has moved on by its speed, and its speed by its acceleration
    ends = _arrivals(case, h, v[:-1])
    arriving_q, arriving = ends[:, : case.scene.nq], ends[:, case.scene.nq :]
    moved = np.diff(q, axis=0)
    low, high = np.minimum(v[:-1], v[1:]) * h[:, None], np.maximum(v[:-1], v[1:]) * h[:, None]
    beyond = np.maximum(np.maximum(moved - high, low - moved), 0.0)
    beyond = np.minimum(beyond, np.abs(q[1:] - arriving_q))
    beyond = np.maximum(beyond - 2.0 * p_q - h[:, None] * p_v - late * np.abs(v[:-1]), 0.0) / h[:, None]
    if case.equations.relaxation_index is not None:
        return np.maximum(_without_inertia(case, h, v[:-1]), _sizes(mass[1:], beyond) / _relaxation_time(case))
    jump = v[1:] - arriving
    allowed = 2.0 * p_v + h * case.printing_acceleration + late * np.abs((arriving - v[:-1]) / h[:, None]).max(axis=1)
    return np.maximum(_sizes(mass[1:], jump) - allowed * _sizes(mass[1:], np.ones(case.scene.nq)), _sizes(mass[1:], beyond)).clip(0.0) / h


def _without_inertia(case: Evidence, h: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(steps,) of a scene whose forces are velocities, from velocities v (steps, nq) at the starts: D (moved - moves)/h, with M = tau D."""
    mass = _masses(case, case.q)[1:]
    missed = (case.q[1:] - _arrivals(case, h, v)[:, : case.scene.nq]) / h[:, None]
    allowed = (2.0 * case.printing("q") + 2.0 * case.printing("t") * np.abs(v).max(axis=1)) / h + h * case.printing_acceleration
    return (_sizes(mass, missed) - allowed * _sizes(mass, np.ones(case.scene.nq))).clip(0.0) / _relaxation_time(case)


def _relaxation_time(case: Evidence) -> float:
    """tau [s] of a scene without inertia."""
    return case.equations.parameters[case.equations.relaxation_index].value  # type: ignore[index] - asked where there is one


def _by_departures(case: Evidence, h: np.ndarray) -> np.ndarray:
    """(steps,) with the velocities that lead from each position to the next; the first must be the task's."""
    p_q, mass, departing = case.printing("q"), _masses(case, case.q), _departures(case, h)
    late = 2.0 * case.printing("t")
    arriving = _arrivals(case, h, departing)[:, case.scene.nq :]
    jump = np.vstack([departing[:1] - case.start_velocity, departing[1:] - arriving[:-1]])
    spans = np.concatenate([h[:1], (h[1:] + h[:-1]) / 2.0])
    allowed = (2.0 * p_q + late * np.abs(departing).max(axis=1)) * (
        1.0 / h + 1.0 / np.concatenate([h[:1], h[:-1]])
    ) + h * case.printing_acceleration
    return (_sizes(mass[:-1], jump) - allowed * _sizes(mass[:-1], np.ones(case.scene.nq))).clip(0.0) / spans


def _arrivals(case: Evidence, h: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(steps, 2 nq) true states at the ends of the steps, from the plan's positions and velocities v (steps, nq)."""
    return np.array([_advance(case, step, v[step], h[step]) for step in range(len(h))])


def _advance(case: Evidence, step: int, v: np.ndarray, h: float) -> np.ndarray:
    """(2 nq,) the true state at the end of a step from the plan's position and velocity v (nq,)."""
    held = case.held_inputs
    within = np.arange(_SUBSTEPS)[:, None] + 0.5
    u = held.values[step] + held.slopes[step] * (within * h / _SUBSTEPS)
    run = case.kernel.rollout(np.concatenate([case.trajectory.q[step], v]), u, h / _SUBSTEPS)
    if run.diverged:
        raise LeavesBounds(
            f"from the plan's own state at t = {case.trajectory.t[step]:g} s the true motion leaves every bound within a step."
        )
    return np.concatenate([run.q[-1], run.v[-1]])


def _departures(case: Evidence, h: np.ndarray) -> np.ndarray:
    """(steps, nq) velocities at the start of each step with which the true motion arrives at the next position."""
    q = case.q
    found = np.diff(q, axis=0) / h[:, None]
    for step in range(len(h)):
        v = found[step]
        for _ in range(_SHOTS):
            miss = q[step + 1] - _advance(case, step, v, h[step])[: case.scene.nq]
            v = v + miss / h[step]
            if np.abs(miss).max() < 1e-13:
                break
        found[step] = v
    return found


def _masses(case: Evidence, q: np.ndarray) -> np.ndarray:
    """(n, nq, nq)."""
    d = derive(case.equations)
    mass = d.function(d.mass_matrix, d.q)
    return np.array([np.array(mass(row), dtype=float).reshape(len(row), len(row)) for row in q])


def _sizes(mass: np.ndarray, dv: np.ndarray) -> np.ndarray:
    """(n,) sqrt(dv' M dv) of changes dv (n, nq) or (nq,)."""
    dv = np.broadcast_to(dv, mass.shape[:2])
    return np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", dv, mass, dv), 0.0))


def _reference(case: Evidence) -> float:
    """The largest contact force of the replay, or a tenth of the inputs' range where that is more; without contact their range. In the norm of M^-1."""
    scene, kernel = case.equations, case.kernel
    q = case.opened_q
    v, u, none = np.zeros_like(q), np.zeros((len(q), scene.nu)), np.zeros((len(q), scene.nl))
    mass, largest = _masses(case, q), 0.0
    try:
        still = kernel.acceleration(q, v, u, none)
        for contact in range(scene.nc):
            push = none.copy()
            push[:, contact] = case.opened_lam[:, contact]
            largest = max(largest, float(_sizes(mass, kernel.acceleration(q, v, u, push) - still).max()))
        share = _SHARE_OF_RANGE if largest > 0.0 else 1.0
        ranges = [item.upper - item.lower for item in scene.inputs]
        for place, width in enumerate(ranges):
            pull = u.copy()
            pull[:, place] = share * (width if np.isfinite(width) else 2.0 * np.abs(case.trajectory.u[:, place]).max())
            largest = max(largest, float(_sizes(mass, kernel.acceleration(q, v, pull, none) - still).max()))
    except KernelError as error:
        raise Unmeasured(str(error)) from error
    return largest
