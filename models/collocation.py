"""Collocation steps under the true contact law, in numpy, as a check of plans made of such steps.

    q_next, v_next = advance(kernel, Scheme.RADAU_IIA_2, q, v, u, h)  # (n, nq): n steps at once
    q, v, made = rollout(kernel, Scheme.RADAU_IIA_2, start, u, h)  # consecutive steps

The stage accelerations solve a_i = M^-1 (tau + J' lam)(Q_i, V_i, u) with V = v + h A a and
Q = q + h c v + h^2 A^2 a, by Newton's method with difference Jacobians. The code is independent of
the transcription.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from models.codegen.kernel import Kernel, KernelError
from models.schemes import Scheme, tableau
from models.trajectory import Trajectory

# Newton needs 3 to 5 iterations, a few more if contacts open and close within a step.
_ITERATIONS = 40
# Smallest Newton step, relative to the largest acceleration.
_TOLERANCE = 1e-13
_DIFFERENCE = 1e-7
# Accelerations [m/s^2, rad/s^2] without a solution; positions and velocities are still finite.
_LARGEST = 1e100


def advance(
    kernel: Kernel,
    scheme: Scheme,
    q: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    h: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states after a collocation step, under the true contact law.

    q, v (n, nq) [m, rad, m/s, rad/s], u (n, nu) [N, N m], h a number or (n,) [s]. NaN without a
    solution. Raises KernelError for a scene with friction.
    """
    scene = kernel.scene
    if scene.nf:
        raise KernelError(
            f"scene {scene.name}: its friction has no collocation step; friction belongs to semi-implicit Euler."
        )
    table = tableau(scheme)
    steps, nq, s = (
        np.broadcast_to(np.asarray(h, dtype=float), len(q)).reshape(-1, 1, 1),
        scene.nq,
        table.stages,
    )
    squared = table.a @ table.a
    inputs = np.repeat(np.asarray(u, dtype=float), s, axis=0)

    def residual(a: np.ndarray) -> np.ndarray:
        """Return the residual of the equations at accelerations (m, n, s, nq) [m/s^2, rad/s^2].

        Raises KernelError if the mass matrix is not positive definite.
        """
        at_q = (
            q[:, None]
            + steps * table.c[:, None] * v[:, None]
            + steps**2 * np.einsum("ij,mnjk->mnik", squared, a)
        )
        at_v = v[:, None] + steps * np.einsum("ij,mnjk->mnik", table.a, a)
        at_q, at_v = at_q.reshape(-1, nq), at_v.reshape(-1, nq)
        return a - kernel.acceleration(
            at_q, at_v, np.tile(inputs, (len(a), 1)), kernel.contact_force(at_q, v=at_v)
        ).reshape(a.shape)

    first = kernel.acceleration(q, v, u, kernel.contact_force(q, v=v))
    a = np.repeat(first[:, None], s, axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        a = _newton(residual, a)
        weights = table.b @ table.a
        moved = steps[:, 0] * v + steps[:, 0] ** 2 * np.einsum("i,nik->nk", weights, a)
        return q + moved, v + steps[:, 0] * np.einsum("i,nik->nk", table.b, a)


def _newton(residual: Callable[[np.ndarray], np.ndarray], a: np.ndarray) -> np.ndarray:
    """Return (n, s, nq) roots, row by row, NaN without one."""
    n, shape = len(a), a.shape
    size = a[0].size
    columns = np.arange(size)
    lost, settled = ~(np.abs(a).max(axis=(1, 2)) < _LARGEST), np.zeros(n, bool)
    for _ in range(_ITERATIONS):
        a[lost] = 0.0  # positions are then finite
        # All columns of the Jacobian together: a call of the kernel takes 40 us, a row of it 1 us.
        moved = np.repeat(a.reshape(1, n, size), size + 1, axis=0)
        delta = _DIFFERENCE * (1.0 + np.abs(moved[0].T))
        moved[columns + 1, :, columns] += delta
        values = residual(moved.reshape(-1, *shape)).reshape(moved.shape)
        value, jacobian = values[0], np.moveaxis((values[1:] - values[0]) / delta[..., None], 0, -1)
        lost |= ~(np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(value).all(axis=1))
        jacobian[lost] = np.eye(size)
        try:
            step = np.linalg.solve(jacobian, value[..., None])[..., 0].reshape(shape)
        except np.linalg.LinAlgError:  # differences of a row are below its rounding
            lost |= np.linalg.slogdet(jacobian)[0] == 0.0
            jacobian[lost] = np.eye(size)
            step = np.linalg.solve(jacobian, value[..., None])[..., 0].reshape(shape)
        step[settled] = 0.0  # rounding could unsettle the row
        a = a - step
        lost |= ~(np.abs(a).max(axis=(1, 2)) < _LARGEST)
        settled = np.abs(step).max(axis=(1, 2)) <= _TOLERANCE * (1.0 + np.abs(a).max(axis=(1, 2)))
        if (settled | lost).all():
            break
    else:  # only rounding of large accelerations may remain
        lost |= np.abs(step).max(axis=(1, 2)) > 1e-9 * (1.0 + np.abs(a).max(axis=(1, 2)))
    a[lost] = np.nan
    return a


def rollout(
    kernel: Kernel, scheme: Scheme, start: np.ndarray, u: np.ndarray, h: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Perform consecutive collocation steps under the true contact law.

    Raises KernelError for a scene with friction.

    Parameters
    ----------
    start
        State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
    u
        Inputs (steps, nu) [N, N m].
    h
        Lengths of the steps [s]: a number, or (steps,).

    Returns
    -------
    q, v
        Positions and velocities (steps + 1, nq).
    made
        The number of steps before a state was not finite.
    """
    nq, steps = kernel.scene.nq, len(u)
    q, v = np.full((steps + 1, nq), np.nan), np.full((steps + 1, nq), np.nan)
    q[0], v[0] = start[:nq], start[nq:]
    lengths = np.broadcast_to(np.asarray(h, dtype=float), steps)
    for step in range(steps):
        after = advance(
            kernel,
            scheme,
            q[step : step + 1],
            v[step : step + 1],
            u[step : step + 1],
            lengths[step],
        )
        if not (np.isfinite(after[0]).all() and np.isfinite(after[1]).all()):
            return q, v, step
        q[step + 1], v[step + 1] = after[0][0], after[1][0]
    return q, v, steps


def defect(kernel: Kernel, plan: Trajectory) -> np.ndarray:
    """Return the largest errors (2*nq,) [m, rad, m/s, rad/s] of a plan's own collocation steps.

    Contact forces follow the true law; infinite without a solution. Raises ValueError for a plan
    without a scheme, KernelError for a scene with friction.
    """
    if plan.scheme is None:
        raise ValueError("a plan that declares no scheme has no defect.")
    q, v = advance(kernel, plan.scheme, plan.q[:-1], plan.v[:-1], plan.u, np.diff(plan.t))
    miss = np.hstack([q - plan.q[1:], v - plan.v[1:]])
    return np.abs(miss).max(axis=0) if np.isfinite(miss).all() else np.full(miss.shape[1], np.inf)


def switch_error(kernel: Kernel, plan: Trajectory) -> float:
    """Return a bound of the velocity error by opening and closing contacts, summed [m/s, rad/s].

    Per step switch_constant h^2 |phi'| |M^-1 J' k| with phi' of either end, first order in h. A
    contact that opens and closes within a step is included if its velocity reverses.
    """
    assert plan.scheme is not None, "the plan of a collocation scheme"
    scene, table = kernel.scene, tableau(plan.scheme)
    if not scene.nc:
        return 0.0
    h, k = np.diff(plan.t), kernel.stiffness()
    phi = kernel.penetration(plan.q)
    first, last = (
        penetration_rates(kernel, plan.q[ends], plan.v[ends])
        for ends in (slice(-1), slice(1, None))
    )
    speed = np.maximum(
        np.abs(np.diff(phi, axis=0) / h[:, None]), np.maximum(np.abs(first), np.abs(last))
    )
    within = np.minimum(np.abs(phi[:-1]), np.abs(phi[1:])) <= speed * h[:, None]
    switches = (phi[:-1] * phi[1:] <= 0.0) & (phi[:-1] != phi[1:]) | within & (
        first * last < 0.0
    ) & (phi[:-1] < 0.0)
    total = 0.0
    still = np.zeros((1, scene.nl))
    for step, contact in zip(*np.nonzero(switches), strict=True):
        at = plan.q[step : step + 1], plan.v[step : step + 1], plan.u[step : step + 1]
        push = still.copy()
        push[0, contact] = k[contact]
        response = np.abs(kernel.acceleration(*at, push) - kernel.acceleration(*at, still)).max()
        total += (
            table.switch_constant
            * float(h[step]) ** 2
            * float(speed[step, contact])
            * float(response)
        )
    return total


def penetration_rates(kernel: Kernel, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return phi' = d phi/dq v (n, nc) [m/s], by a central difference along v.

    q and v are (n, nq) [m, rad, m/s, rad/s]. Raises KernelError for an array of another shape.
    """
    reach = 1e-6 / (1.0 + np.abs(v).max(axis=1, keepdims=True))
    return (kernel.penetration(q + reach * v) - kernel.penetration(q - reach * v)) / (2.0 * reach)


def lowest_between(
    t: np.ndarray, gap: np.ndarray, rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the minimum between two rows of the cubic through gaps and rates.

    Parameters
    ----------
    t : (n,) times of the rows [s]
    gap : (n, nc) gaps [m]
    rate : (n, nc) rates of the gaps [m/s]

    Returns
    -------
    (n-1, nc) minima [m], and (n-1, nc) their places as a share of the interval [-]

    Raises
    ------
    ValueError : if the shapes do not fit
    """
    h = np.diff(t)[:, None]
    first, last, slope_first, slope_last = gap[:-1], gap[1:], h * rate[:-1], h * rate[1:]
    # g(s) = first + b s + c s^2 + d s^3
    b, c, d = (
        slope_first,
        3.0 * (last - first) - 2.0 * slope_first - slope_last,
        2.0 * (first - last) + slope_first + slope_last,
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(c * c - 3.0 * d * b)
        # Root of g'(s) = b + 2 c s + 3 d s^2 with g'' > 0, without cancellation.
        inner = np.where(c < 0.0, (root - c) / (3.0 * d), b / -(c + root))
    places = np.clip(
        np.nan_to_num(
            np.stack([inner, np.zeros_like(first), np.ones_like(first)]),
            nan=0.0,
            posinf=1.0,
            neginf=0.0,
        ),
        0.0,
        1.0,
    )
    values = first + places * (b + places * (c + places * d))
    best = values.argmin(axis=0)[None]
    return np.take_along_axis(values, best, 0)[0], np.take_along_axis(places, best, 0)[0]
