"""Tracking feedback: the time-varying LQR around a plan, held over each step and saturated at the bounds.

    u_t = sat(u_plan_t + K_t (x_plan_t - x(t)))        at the nodes; between them the correction is held, as a robot's computer does

K_t, t = T-1 .. 0, is the discrete Riccati recursion (Anderson and Moore, Optimal Control: Linear Quadratic Methods, 1990, section 2.4)

    K_t = (R + B' P B)^-1 B' P A,     P <- Q + A' P (A - B K_t),     from P = Q_T

with A, B the exact derivatives of the true motion over step t at the plan's state and input: ten small steps of the compiled kernel, so that a contact
that opens or closes within the step, sticks or slips counts for as long as it does. Where the plan touches, the true law's spring is in A; where it
does not, there is none, whatever force the plan claims.

Weights, for every scene alike: Q = 1/nominal^2 of each component of the state, R = 1/scale^2 with an input's scale half the width of its bounds (without
bounds the plan's own largest value), so that an error of the nominal size is worth all of an input. At the end Q_T = T Q, as much as all the steps before
it, but Q alone for what the goal leaves free.
"""

from __future__ import annotations

import numpy as np

from models.codegen.kernel import Kernel, KernelError
from models.errors import TouchstoneError
from models.goal import goal_state
from models.scene import Scene
from models.trajectory import Trajectory
from validate.replay.feedback import Feedback
from validate.replay.growth import FlowDerivative, nominals
from validate.replay.subject import Subject

# Small steps in one of the plan's, for A and B.
_SUBSTEPS = 10


class TrackingError(TouchstoneError):
    """No feedback can track this plan; the text says why."""


def design_feedback(kernel: Kernel, scene: Scene, plan: Trajectory) -> Feedback:
    """The feedback around a plan of a scene. Raises TrackingError."""
    if scene.nu == 0:
        raise TrackingError(f"scene {scene.name}: it has no inputs, so there is nothing to feed back to.")
    h = np.diff(plan.t) / _SUBSTEPS
    states = np.hstack([plan.q, plan.v])
    flow = FlowDerivative(kernel, _SUBSTEPS)
    try:
        pairs = [
            flow.at(state, np.broadcast_to(u, (_SUBSTEPS, scene.nu)), float(step))
            for state, u, step in zip(states, plan.u, h, strict=False)
        ]
    except KernelError as error:
        raise TrackingError(f"plan: the motion cannot be linearised along it ({error}).") from error
    return feedback_from(scene, plan, np.array([a for a, _ in pairs]), np.array([b for _, b in pairs]))


def feedback_from(subject: Subject, plan: Trajectory, A: np.ndarray, B: np.ndarray) -> Feedback:
    """The feedback for linearised steps A (steps, 2*nq, 2*nq), B (steps, 2*nq, nu). Raises TrackingError."""
    lower = np.array([item.lower for item in subject.inputs])
    upper = np.array([item.upper for item in subject.inputs])
    scale = input_scale(lower, upper, plan.u)
    weight = 1.0 / nominals(subject) ** 2
    free = np.isnan(goal_state(subject.task))  # type: ignore[arg-type] - a foreign task has a goal of the same form
    gains = lqr_gains(A, B, weight, 1.0 / scale**2, np.where(free, weight, plan.steps * weight))
    return Feedback(gains=gains, reference=np.hstack([plan.q, plan.v]), u=plan.u, lower=lower, upper=upper, scale=scale)


def input_scale(lower: np.ndarray, upper: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(nu,) half the width of each input's bounds; without bounds its largest value in the plan u (steps, nu), or 1 where that is 0."""
    half = (upper - lower) / 2.0
    largest = np.abs(u).max(axis=0, initial=0.0)
    return np.where(np.isfinite(half), half, np.where(largest > 0.0, largest, 1.0))


def lqr_gains(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray, Q_end: np.ndarray) -> np.ndarray:
    """K (steps, nu, nx) of the Riccati recursion of the module docstring; Q, Q_end (nx,), R (nu,): diagonals. Raises TrackingError where it overflows or is singular."""
    steps, nx, nu = B.shape
    K = np.empty((steps, nu, nx))
    P = np.diag(Q_end)
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(steps - 1, -1, -1):
            BP = B[t].T @ P
            if not np.isfinite(BP).all():
                raise TrackingError(f"plan: the tracking gains overflow at step {t}; what grows there no input reaches.")
            try:
                K[t] = np.linalg.solve(np.diag(R) + BP @ B[t], BP @ A[t])
            except np.linalg.LinAlgError as error:
                raise TrackingError(
                    f"plan: the tracking gains are lost to rounding at step {t}; what grows there swamps the inputs' weight."
                ) from error
            closed = A[t] - B[t] @ K[t]
            # Joseph's form, which keeps P symmetric and positive semidefinite in rounding.
            P = np.diag(Q) + closed.T @ P @ closed + K[t].T @ (R[:, None] * K[t])
    return K
