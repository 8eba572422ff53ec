"""Feedback around a plan: the time-varying LQR, held over each step and saturated at the bounds.

And how much errors grow without it.

    u_t = sat(u_plan_t + K_t (x_plan_t - x(t)))
        at the nodes; between them the correction is held, as a robot's computer does

K_t, t = T-1 .. 0, is the discrete Riccati recursion (Anderson and Moore, Optimal Control: Linear
Quadratic Methods, 1990, section 2.4)

    K_t = (R + B' P B)^-1 B' P A,     P <- Q + A' P (A - B K_t),     from P = Q_T

with A, B the exact derivatives of the true motion over step t at the plan's state and input: ten
small steps of the compiled kernel, so that a contact that opens or closes within the step, sticks
or slips counts for as long as it does. Where the plan touches, the true law's spring is in A; where
it does not, there is none, whatever force the plan claims.

Weights, for every scene alike: Q = 1/nominal^2 of each component of the state, R = 1/scale^2 with
an input's scale half the width of its bounds (without bounds the plan's own largest value), so that
an error of the nominal size is worth all of an input. At the end Q_T = T Q, as much as all the
steps before it, but Q alone for what the goal leaves free.

An FMU without a scene is linearised by its own directional derivatives (`design_foreign`). At each
    node its states are set to the plan's and its events
are settled, so that a contact that the plan closes is closed. One step is exp(h (F_t + F_{t+1})/2)
    with F the Jacobian of the rates by states and held
inputs: of second order in h, and half a contact where it closes in between.

How much an error grows in the open loop (`measure_growth`): the plan is cut into at most 50 blocks.
Phi of a block is the exact derivative of the plan's own time step (of one that declares no scheme:
of steps that are stable in contact, and so small that smaller ones give the same), with the true
contact law, from the block's first state on under the plan's inputs; Phi(j, i) is the product of
the blocks i .. j - 1. The amplification is the largest 2-norm over i < j of S^-1 Phi_qq(j, i) S,
the positions that positions lead to, with S the scene's nominals: a finite-time Lyapunov growth.
Its rate is such that amplification = exp(rate T). Velocities are left out: in a contact of
frequency w a position becomes w times as much speed, which is no growth.

An exact plan lies on edges: a contact just touches, friction just sticks. The derivative there is
that of one side, and rounding decides which. So the number explains a verdict, and decides none.
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
    """None, or why no feedback can be designed for this FMU."""
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
    """The feedback around a plan for an FMU without a scene, and how much errors grow along it.

    Parameters
    ----------
    plan : in its own units.
    limits : of the child that asks the FMU.

    Returns
    -------
    The feedback in the plan's units, and the growth, None where it is not finite.

    Raises
    ------
    TrackingError : if the plan says no positions, or the FMU cannot be linearised along it.
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
    """An FMU's motion over each step, linearised along a plan, in the FMU's units, states in the order of variables.q + variables.v.

    Parameters
    ----------
    plan : its times and inputs.
    start : (n,) start values [unit of each variable], in the order of Variables.start.
    states : (nodes, nx) the plan's states [unit of each state].
    limits : of the child that asks the FMU.

    Returns
    -------
    A (steps, nx, nx), B (steps, nx, nu) of x' = A x + B u.

    Raises
    ------
    TrackingError : if the FMU offers no directional derivatives of these states, refuses them, or
        gives one that is not finite.
    """
    refusal = tracking_refusal(package, variables)
    if refusal is not None:
        raise TrackingError(f"FMU {package.path}: the plan cannot be tracked, because {refusal}.")
    request, given = (
        str(package.path.resolve()),
        packed(variables) | {"t": plan.t, "u": plan.u, "start": start, "states": states},
    )
    done = run_isolated(
        "validate.judge.replay.tracking:jacobians",
        request,
        given,
        limits=limits,
        what=f"FMU {package.path}",
    )
    if not done.ok:
        raise TrackingError(done.sentence)
    found = done.arrays
    nx, h = states.shape[1], np.diff(plan.t)
    pair = (
        found["first"] + found["last"]
    ) / 2.0  # (steps, nx, nx + nu): at both ends of each step, with the input of the step
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
    """Derivatives of an FMU's rates at both ends of each step, by its own directional derivatives, in a child.

    Parameters
    ----------
    path : of the FMU.
    arrays : t (nodes,) [s], u (steps, nu), start (n,), states (nodes, nx) [unit of each variable];
        and the Variables, packed.

    Returns
    -------
    None, and first, last (steps, nx, nx + nu) [unit of the state per second and per unit of the
        known].

    Raises
    ------
    FmuError, FMICallException : if the FMU cannot be opened, misbehaves, or refuses a call.
    """
    (variables,) = unpacked_from(arrays)
    t, u, states = arrays["t"], arrays["u"], arrays["states"]
    found = {
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
                    found[name][step] = model.jacobian(float(t[node]), x, unknowns, knowns)
    return None, found


def _states(package: Package) -> list[Any]:
    return [item.variable.derivative for item in package.description.derivatives]


# Blocks in which a plan is cut: growth within one is told by the next product, and fifty keep the
# cost below that of one replay.
_BLOCKS = 50

# Parts of a plan's step, more and more until twice in a row the growth is the same up to this
# factor, or they are so many in all (a CPU second). The first are no longer than this share of the
# longest stable ones.
_FINER = 8
_AGREE = 1.2
_MOST = 4_000_000
_STABLY = 0.25


def nominals(subject: Subject) -> np.ndarray:
    """Typical size of each component of the state, (2*nq,) [m or rad], of a velocity that of its position [m/s or rad/s]. Raises nothing."""
    sizes = [item.nominal for item in subject.coordinates]
    return np.array(sizes + sizes)


def measure_growth(kernel: Kernel, scene: Scene, plan: Trajectory) -> Growth | None:
    """How much an error grows along the plan in the open loop.

    None where the true law leads out of every bound within a block, the mass matrix is singular,
    or, of a plan that declares no scheme, smaller steps keep giving another number: then it is the
    steps that are unstable.
    """
    if plan.scheme is not None:
        return _growth_in(1, kernel, scene, plan)
    stable, longest = step_stability(scene).largest_step, float(np.diff(plan.t).max())
    parts, before = 1 if longest < stable else math.ceil(longest / (_STABLY * stable)), None
    while parts * plan.steps <= _MOST:
        found = _growth_in(parts, kernel, scene, plan)
        if found is not None and before is not None:
            ratio = max(found.amplification, 1.0) / max(before.amplification, 1.0)
            if 1.0 / _AGREE <= ratio <= _AGREE:
                return found
        parts, before = parts * _FINER, found
    return None


def _growth_in(parts: int, kernel: Kernel, scene: Scene, plan: Trajectory) -> Growth | None:
    """With each step of the plan in so many parts."""
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
    """The largest gain of products of transition matrices, from positions to positions, taken in at most 50 blocks.

    Parameters
    ----------
    steps : (n, 2*nq, 2*nq) transition matrices of positions and velocities from t[i] to t[i + 1].
    t : (n + 1,) [s].
    scale : (2*nq,) typical size of each component of the state [m or rad, then per second].

    Returns
    -------
    The growth; None where a product is not finite.

    Raises
    ------
    ValueError : if the shapes do not fit.
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
            # Row i: from edge i to edge `end`.
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
    """(blocks + 1,) steps at which blocks begin, and the last end."""
    return np.linspace(0, steps, min(steps, _BLOCKS) + 1).round().astype(int)


# Small steps in one of the plan's, for A and B.
_SUBSTEPS = 10


class TrackingError(TouchstoneError):
    """No feedback can track this plan; the text says why."""


def design_feedback(kernel: Kernel, scene: Scene, plan: Trajectory) -> Feedback:
    """The feedback around a plan of a scene. Raises TrackingError."""
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
    """The feedback for linearised steps of a plan.

    Parameters
    ----------
    A : (steps, 2*nq, 2*nq) by the state [m or rad, then per second].
    B : (steps, 2*nq, nu) by the inputs [N or N m].

    Raises
    ------
    TrackingError : if the Riccati recursion overflows or is singular.
    """
    lower = np.array([item.lower for item in subject.inputs])
    upper = np.array([item.upper for item in subject.inputs])
    scale = input_scale(lower, upper, plan.u)
    sizes = nominals(subject)
    weight = 1.0 / sizes**2
    free = np.isnan(goal_state(subject.task))  # type: ignore[arg-type] - a foreign task has a goal of the same form
    gains = lqr_gains(A, B, weight, 1.0 / scale**2, np.where(free, weight, plan.steps * weight))
    return Feedback(
        gains=gains, reference=np.hstack([plan.q, plan.v]), u=plan.u, lower=lower, upper=upper,
        scale=scale,
    )  # fmt: skip


def input_scale(lower: np.ndarray, upper: np.ndarray, u: np.ndarray) -> np.ndarray:
    """What an input's effort is a share of: half the width of its bounds.

    Parameters
    ----------
    lower, upper : (nu,) bounds [unit of each input], may be infinite.
    u : (steps, nu) the plan's inputs [unit of each input].

    Returns
    -------
    (nu,) [unit of each input]; without bounds the largest value in the plan, or 1 where that is 0.

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    half = (upper - lower) / 2.0
    largest = np.abs(u).max(axis=0, initial=0.0)
    return np.where(np.isfinite(half), half, np.where(largest > 0.0, largest, 1.0))


def lqr_gains(
    A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray, Q_end: np.ndarray
) -> np.ndarray:
    """Gains of the discrete Riccati recursion of the module docstring.

    Parameters
    ----------
    A : (steps, nx, nx) by the state [unit of the state per unit of the state].
    B : (steps, nx, nu) by the inputs [unit of the state per unit of the input].
    Q, Q_end : (nx,) diagonals of the weights on the state, and at the end.
    R : (nu,) diagonal of the weight on the inputs.

    Returns
    -------
    (steps, nu, nx) gains K [unit of the input per unit of the state].

    Raises
    ------
    TrackingError : if the recursion overflows or is singular.
    """
    steps, nx, nu = B.shape
    K = np.empty((steps, nu, nx))
    P = np.diag(Q_end)
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(steps - 1, -1, -1):
            BP = B[t].T @ P
            if not np.isfinite(BP).all():
                raise TrackingError(
                    f"plan: the tracking gains overflow at step {t}; what grows there no input reaches."
                )
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
