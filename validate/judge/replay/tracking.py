"""Feedback around a plan (time-varying LQR, held and saturated), and growth of errors without.

    u_t = sat(u_plan_t + K_t (x_plan_t - x(t)))    at the nodes, the correction held between
    K_t = (R + B' P B)^-1 B' P A,     P <- Q + A' P (A - B K_t),     from P = Q_T

is the discrete Riccati recursion (Anderson and Moore, Optimal Control: Linear Quadratic Methods,
1990, section 2.4). `design_feedback` takes A, B from a scene's kernel, `design_foreign` from an
FMU's directional derivatives, and `feedback_from` sets the weights. `measure_growth` explains
verdicts, and decides none: an exact plan is at edges of contact and friction, whose one-sided
derivatives depend on rounding.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from models.codegen.kernel import Kernel, KernelError
from models.errors import TouchstoneError
from models.scene import Scene
from models.scene.goal import goal_state
from models.stability import step_stability
from models.trajectory import Trajectory
from validate.fmi.description import Package, read_package, unpacked
from validate.fmi.instance import faults_of
from validate.judge.replay.reference import ExchangeModel
from validate.judge.replay.result import Growth
from validate.judge.replay.subject import Foreign, Subject
from validate.judge.replay.wiring import Feedback, Variables
from validate.processes.isolated import Limits, packed, run_isolated, unpacked_from


def tracking_refusal(package: Package, variables: Variables) -> str | None:
    """Return why no feedback can be designed for this FMU, or None."""
    exchange = package.exchange
    if exchange is None:
        return "it offers no Model Exchange, whose states feedback needs"
    if not package.can(
        "ModelExchange", f"providesDirectionalDerivative{'s' if package.is_three else ''}"
    ):
        return "it provides no directional derivatives"
    if not variables.u:
        return "it has no inputs"
    states = {int(item.valueReference): item.name for item in _states(package)}
    mapped = (*variables.q, *variables.v)
    unmapped = [name for reference, name in states.items() if reference not in mapped]
    if unmapped:
        return f"its state {unmapped[0]} is none of the positions and velocities of the map"
    if len(states) != len(mapped) or len(set(mapped)) != len(mapped):
        return "positions and velocities of the map are not its states, one for one"
    return None


def design_foreign(
    foreign: Foreign, package: Package, plan: Trajectory, limits: Limits
) -> tuple[Feedback, Growth | None]:
    """Return the feedback around a plan on an external FMU, and the growth, None if not finite.

    plan: in its own units. Raises TrackingError if the plan has no positions, or the FMU cannot be
    linearised.
    """
    if "q" in plan.missing:
        raise TrackingError("plan: it does not say its positions, so there is nothing to track.")
    (a, b), (c, d) = foreign.units
    states = (np.hstack([plan.q, plan.v]) - b) / a
    A, B = linearised(
        package, foreign.variables, plan.with_inputs_in(c, d), foreign.start, states, limits
    )
    A, B = A * (a[:, None] / a[None, :]), B * (a[:, None] * c[None, :])
    return feedback_from(foreign.model, plan, A, B), largest_growth(
        A, plan.t, nominals(foreign.model)
    )


def linearised(
    package: Package,
    variables: Variables,
    plan: Trajectory,
    start: np.ndarray,
    states: np.ndarray,
    limits: Limits,
) -> tuple[np.ndarray, np.ndarray]:
    """Linearise an FMU along a plan: A (steps, nx, nx), B (steps, nx, nu) of x' = A x + B u.

    In the FMU's units, states ordered as variables.q + variables.v. One step is exp(h (F_t +
    F_{t+1})/2), F the Jacobian of the rates by states and held inputs. This is of second order in
    h, with half a contact if it closes within the step.

    Parameters
    ----------
    start
        (n,) start values [unit of each variable], in the order of Variables.start.
    states
        (nodes, nx) the plan's states [unit of each].

    Raises
    ------
    TrackingError
        If directional derivatives of these states are missing, refused, or not finite.
    """
    refusal = tracking_refusal(package, variables)
    if refusal is not None:
        raise TrackingError(f"FMU {package.path}: the plan cannot be tracked, because {refusal}.")
    request, arrays = (
        str(package.path.resolve()),
        packed(variables) | {"t": plan.t, "u": plan.u, "start": start, "states": states},
    )
    done = run_isolated(
        "validate.judge.replay.tracking:jacobians",
        request,
        arrays,
        limits=limits,
        what=f"FMU {package.path}",
    )
    if not done.ok:
        raise TrackingError(done.sentence)
    jacobian_arrays = done.arrays
    nx, h = states.shape[1], np.diff(plan.t)
    pair = (
        jacobian_arrays["first"] + jacobian_arrays["last"]
    ) / 2.0  # (steps, nx, nx + nu): mean of both ends of each step
    if not np.isfinite(pair).all():
        raise TrackingError(
            f"FMU {package.path}: the plan cannot be tracked, because a directional derivative is not a finite number."
        )
    square = np.zeros((len(h), pair.shape[2], pair.shape[2]))
    square[:, :nx] = h[:, None, None] * pair
    from scipy.linalg import expm

    whole = expm(square)
    return whole[:, :nx, :nx], whole[:, :nx, nx:]


def jacobians(path: str, arrays: Mapping[str, np.ndarray]) -> tuple[None, dict[str, np.ndarray]]:
    """Return an FMU's directional derivatives at both ends of each step, in a child process.

    At each node events are settled, so that a contact of the plan is closed.

    - arrays: t (nodes,) [s], u (steps, nu), start (n,), states (nodes, nx) [unit of each], packed
      Variables.

    Returns first, last (steps, nx, nx + nu) [unit of the state per second and per unit of the
    known]. Raises FmuError, FMICallException.
    """
    (variables,) = unpacked_from(arrays)
    t, u, states = arrays["t"], arrays["u"], arrays["states"]
    results = {
        name: np.empty((len(u), states.shape[1], states.shape[1] + u.shape[1]))
        for name in ("first", "last")
    }
    with unpacked(read_package(Path(path))) as package, faults_of(package.path):
        order = [int(item.valueReference) for item in _states(package)]
        places = [order.index(reference) for reference in (*variables.q, *variables.v)]
        rates = [int(item.variable.valueReference) for item in package.description.derivatives]
        with closing(ExchangeModel(package, variables)) as model:
            model.start(float(t[0]), arrays["start"], u[0])
            knowns = [*(order[place] for place in places), *variables.u]
            unknowns = [rates[place] for place in places]
            for step in range(len(u)):
                for name, node in (("first", step), ("last", step + 1)):
                    x = np.empty(len(order))
                    x[places] = states[node]
                    model.event(float(t[node]), x, u[step])
                    results[name][step] = model.jacobian(float(t[node]), x, unknowns, knowns)
    return None, results


def _states(package: Package) -> list[Any]:
    return [item.variable.derivative for item in package.description.derivatives]


# Largest number of blocks of a plan, which keeps the cost below that of one replay.
_BLOCKS = 50

# Refinement of the plan's step, until the growth agrees twice in a row.
_FINER = 8
# Largest ratio of growths that agree.
_AGREE = 1.2
# Largest number of steps, a CPU second.
_MOST = 4_000_000
# First step, as a fraction of the longest stable one.
_STABLY = 0.25


def nominals(subject: Subject) -> np.ndarray:
    """Return the nominals of the state (2*nq,) [m or rad, m/s or rad/s]. Raises nothing."""
    sizes = [item.nominal for item in subject.coordinates]
    return np.array(sizes + sizes)


def measure_growth(kernel: Kernel, scene: Scene, plan: Trajectory) -> Growth | None:
    """Return the growth of an error along the plan without feedback.

    The plan is cut into at most 50 blocks. Phi of a block is the exact derivative, with the true
    contact law, of the plan's scheme, or of stable steps fine enough to agree. The amplification is
    the largest 2-norm of S^-1 Phi_qq(j, i) S over i < j, S the nominals: a finite-time Lyapunov
    growth of positions. Velocities are left out, as a contact of frequency w multiplies positions
    by w without growth. None if the motion diverges in a block, the mass matrix is singular, or
    smaller steps do not agree.
    """
    if plan.scheme is not None:
        return _growth_in(1, kernel, scene, plan)
    stable, longest = step_stability(scene).largest_step, float(np.diff(plan.t).max())
    parts, before = 1 if longest < stable else math.ceil(longest / (_STABLY * stable)), None
    while parts * plan.steps <= _MOST:
        growth = _growth_in(parts, kernel, scene, plan)
        if growth is not None and before is not None:
            ratio = max(growth.amplification, 1.0) / max(before.amplification, 1.0)
            if 1.0 / _AGREE <= ratio <= _AGREE:
                return growth
        parts, before = parts * _FINER, growth
    return None


def _growth_in(parts: int, kernel: Kernel, scene: Scene, plan: Trajectory) -> Growth | None:
    h = np.diff(plan.t).tolist()
    uniform = bool(np.allclose(h, scene.task.step, rtol=1e-9, atol=0.0)) or plan.has_uniform_grid()
    edges = _edges(plan.steps) if uniform else np.arange(plan.steps + 1)
    try:
        blocks = [
            kernel.end_derivatives(
                np.concatenate([plan.q[first], plan.v[first]]),
                np.repeat(plan.u[first:last], parts, axis=0),
                h[first] / parts,
            )[0]
            for first, last in pairwise(edges)
        ]
    except KernelError:
        return None
    return largest_growth(np.array(blocks), plan.t[edges], nominals(scene))


def largest_growth(steps: np.ndarray, t: np.ndarray, scale: np.ndarray) -> Growth | None:
    """Return the largest position gain of products of steps, in at most 50 blocks.

    Parameters
    ----------
    steps
        (n, 2*nq, 2*nq) transition matrices of positions and velocities.
    t
        (n + 1,) [s].
    scale
        (2*nq,) nominals [m or rad, then per second].

    Returns
    -------
    Growth or None
        None if a product is not finite.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    scaled = steps * (scale[None, None, :] / scale[None, :, None])
    best, nq = (0.0, 0, 0), len(scale) // 2
    products = np.empty((0, *steps.shape[1:]))
    edges = _edges(len(steps))
    t = t[edges]
    with np.errstate(over="ignore", invalid="ignore"):
        for end, (first, last) in enumerate(pairwise(edges), start=1):
            matrix = np.eye(len(scale))
            for step in scaled[first:last]:
                matrix = step @ matrix
            # Row i: from edge i to edge `end`
            products = np.concatenate([matrix @ products, matrix[None]])
            if not np.isfinite(products).all():
                return None
            gains = np.linalg.norm(products[:, :nq, :nq], ord=2, axis=(1, 2))
            begin = int(gains.argmax())
            best = max(best, (float(gains[begin]), begin, end))
    amplification, begin, end = best
    return Growth(
        amplification=amplification,
        begin=float(t[begin]),
        end=float(t[end]),
        duration=float(t[-1] - t[0]),
    )


def _edges(steps: int) -> np.ndarray:
    return np.linspace(0, steps, min(steps, _BLOCKS) + 1).round().astype(int)


# Kernel steps per plan step for A and B, so that contacts and friction count for their duration.
_SUBSTEPS = 10


class TrackingError(TouchstoneError):
    """No feedback can track this plan; the text has the reason."""


def design_feedback(kernel: Kernel, scene: Scene, plan: Trajectory) -> Feedback:
    """Return the feedback around a plan of a scene. Raises TrackingError."""
    if scene.nu == 0:
        raise TrackingError(
            f"scene {scene.name}: it has no inputs, so there is nothing to feed back to."
        )
    h = np.diff(plan.t) / _SUBSTEPS
    states = np.hstack([plan.q, plan.v])
    try:
        pairs = [
            kernel.end_derivatives(state, np.broadcast_to(u, (_SUBSTEPS, scene.nu)), step)
            for state, u, step in zip(states, plan.u, h.tolist(), strict=False)
        ]
    except KernelError as error:
        raise TrackingError(f"plan: the motion cannot be linearised along it ({error}).") from error
    return feedback_from(
        scene, plan, np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])
    )


def feedback_from(subject: Subject, plan: Trajectory, A: np.ndarray, B: np.ndarray) -> Feedback:
    """Return the feedback of linearised steps A (steps, 2*nq, 2*nq), B (steps, 2*nq, nu) [SI].

    Weights: Q = 1/nominal^2, R = 1/scale^2, so that a nominal error is worth a whole input. The
    last weight is T Q, as much as all steps before, but Q for coordinates with a free goal. Raises
    TrackingError if the Riccati recursion fails.
    """
    lower = np.array([item.lower for item in subject.inputs])
    upper = np.array([item.upper for item in subject.inputs])
    scale = input_scale(lower, upper, plan.u)
    sizes = nominals(subject)
    weight = 1.0 / sizes**2
    free = np.isnan(goal_state(subject.task))  # type: ignore[arg-type] - a foreign task has the same goal
    gains = lqr_gains(A, B, weight, 1.0 / scale**2, np.where(free, weight, plan.steps * weight))
    return Feedback(
        gains=gains, reference=np.hstack([plan.q, plan.v]), u=plan.u, lower=lower, upper=upper,
        scale=scale,
    )  # fmt: skip


def input_scale(lower: np.ndarray, upper: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the unit of effort (nu,) [unit of each input]: half the width of the bounds.

    Without bounds the largest of u (steps, nu), or 1 if that is 0. Raises ValueError if the shapes
    do not fit.
    """
    half = (upper - lower) / 2.0
    largest = np.abs(u).max(axis=0, initial=0.0)
    return np.where(np.isfinite(half), half, np.where(largest > 0.0, largest, 1.0))


def lqr_gains(
    A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray, Q_end: np.ndarray
) -> np.ndarray:
    """Return the gains K (steps, nu, nx) [unit of the input per unit of the state].

    A (steps, nx, nx), B (steps, nx, nu): linearised steps; Q, Q_end (nx,), R (nu,): diagonal
    weights. Raises TrackingError if the recursion overflows or is singular.
    """
    steps, nx, nu = B.shape
    K = np.empty((steps, nu, nx))
    P = np.diag(Q_end)
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(steps - 1, -1, -1):
            BP = B[t].T @ P
            if not np.isfinite(BP).all():
                raise TrackingError(
                    f"plan: the tracking gains overflow at step {t}: an unstable part of the motion there is out of reach of the inputs."
                )
            try:
                K[t] = np.linalg.solve(np.diag(R) + BP @ B[t], BP @ A[t])
            except np.linalg.LinAlgError as error:
                raise TrackingError(
                    f"plan: the tracking gains are lost to rounding at step {t}: the growth there is far larger than the weight of the inputs."
                ) from error
            closed = A[t] - B[t] @ K[t]
            # Joseph's form keeps P symmetric and positive semidefinite in rounding.
            P = np.diag(Q) + closed.T @ P @ closed + K[t].T @ (R[:, None] * K[t])
    return K
