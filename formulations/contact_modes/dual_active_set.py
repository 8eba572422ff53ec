"""Find the active conditions of the quadratic program of fixed modes (`quadratic`).

The dual active-set method (Goldfarb and Idnani 1983) adds the most violated condition until none is
left, at one back substitution each. Its cost rises towards the optimum, so that a search can stop
it early; no library does so as fast (PIQP takes 0.9 to 3.2 times the CPU). With many active
conditions Clarabel's interior-point method names them.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse as sp

from formulations.contact_modes.linear import BandedKKT, LinearScene

# Clarabel's default of 1e-8 takes as long and separates slack from multiplier less clearly.
_TOLERANCE = 1e-10
# Smallest violation of a condition [m], [N].
_VIOLATED = 1e-11
# A condition with a smaller share of its own curvature depends on those imposed already.
_DEPENDENT = 1e-11
# Limit of conditions imposed or dropped; beyond it the interior-point method is faster.
_MOST = 80


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkingSet:
    """The active conditions.

    side: (steps, nu), -1 at the lower bound, 1 at the upper, 0 free
    touching: (steps, nc), whether phi = 0 is imposed
    """

    side: np.ndarray
    touching: np.ndarray

    @classmethod
    def none(cls, linear: LinearScene) -> WorkingSet:
        """Return the empty set."""
        return cls(
            side=np.zeros((linear.steps, linear.nu), dtype=int),
            touching=np.zeros((linear.steps, linear.nc), dtype=bool),
        )

    @property
    def count(self) -> int:
        """Return the number of active conditions."""
        return int(np.count_nonzero(self.side) + np.count_nonzero(self.touching))

    def same_as(self, other: WorkingSet) -> bool:
        """Return whether both sets have the same conditions."""
        return np.array_equal(self.side, other.side) and np.array_equal(
            self.touching, other.touching
        )


def interior_point_active_set(
    linear: LinearScene, closed: np.ndarray, softness: float = 0.0
) -> WorkingSet | None:
    """Return the active conditions by Clarabel, or None without an optimum.

    closed is (steps, nc) [-], softness as in `ModesProblem`. The unknowns are z[0..T], u and the
    error of a soft goal. Raises ValueError for an array of another shape.
    """
    T, n, nu, nc = linear.steps, linear.n, linear.nu, linear.nc
    aimed = np.flatnonzero(linear.aimed)
    soft = len(aimed) * (softness > 0.0)
    each, now, later, inputs = (
        sp.eye(T),
        sp.eye(T, T + 1),
        sp.eye(T, T + 1, k=1),
        sp.eye(T * nu, format="csr"),
    )

    states = sp.bmat(
        [
            [sp.kron(now.T @ now, linear.H[:n, :n]), sp.kron(now.T, linear.H[:n, n:])],
            [None, sp.kron(each, linear.H[n:, n:])],
        ]
    )
    price = np.full(soft, 1.0 / softness if soft else 0.0)
    slope = np.concatenate(
        [np.tile(linear.g[:n], T), np.zeros(n), np.tile(linear.g[n:], T), np.zeros(soft)]
    )

    phi, pushed = sp.kron(now, linear.P, format="csr"), closed * linear.k
    forward = (
        sp.kron(later, np.eye(n))
        - sp.kron(now, linear.A)
        - sp.kron(each, linear.E) @ sp.diags(pushed.ravel()) @ phi
    )
    sign = np.where(closed[1:], 1.0, -1.0)  # the start fixes phi there
    low, up = (np.tile(np.isfinite(bound), T) for bound in (linear.lower, linear.upper))
    blocks = [
        [sp.eye(n, (T + 1) * n), None, None],
        [forward, -sp.kron(each, linear.B), None],
        [sp.eye((T + 1) * n, format="csr")[T * n + aimed], None, -sp.eye(len(aimed), soft)],
        [-sp.diags(sign.ravel()) @ phi[nc:], None, None],
        [None, -inputs[low], None],
        [None, inputs[up], None],
        [None, None, sp.csr_matrix((1, soft))],
    ]
    values = [
        linear.start,
        (linear.c + (pushed * linear.p) @ linear.E.T).ravel(),
        linear.goal[aimed],
        (sign * linear.p).ravel(),
        -np.tile(linear.lower, T)[low],
        np.tile(linear.upper, T)[up],
        np.zeros(1),
    ]
    fixed, free = (sum(len(part) for part in parts) for parts in (values[:3], values[3:6]))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.direct_solve_method = (
        False,
        "qdldl",
    )  # one thread: reproducible results
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
    solution = clarabel.DefaultSolver(
        sp.triu(sp.block_diag([states, sp.diags(price)]), format="csc"),
        slope,
        sp.bmat(blocks, format="csc"),
        np.concatenate(values),
        # The last row is the empty condition 0 >= 0, without which Clarabel rounds differently.
        [clarabel.ZeroConeT(fixed), clarabel.NonnegativeConeT(free), clarabel.SecondOrderConeT(1)],
        settings,
    ).solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    active = (np.array(solution.z) > np.array(solution.s))[fixed : fixed + free]
    touching, on_lower, on_upper = np.split(active, np.cumsum([sign.size, int(low.sum())]))
    side = np.zeros(T * nu, dtype=int)
    side[low] -= on_lower
    side[up] += on_upper
    return WorkingSet(
        side=side.reshape(T, nu),
        touching=np.vstack([np.zeros((1, nc), dtype=bool), touching.reshape(T - 1, nc)]),
    )


class DualActiveSet:
    """The dual active-set method.

    A condition is (kind, t, column); kind -1 and 1 are bounds of u, kind 0 is the sign of phi.
    """

    def __init__(self, linear: LinearScene, kkt: BandedKKT) -> None:
        self._linear, self._kkt = linear, kkt

    def solve(self, closed: np.ndarray, ceiling: float, softness: float = 0.0) -> WorkingSet | None:
        """Impose violated conditions until none is left, or the cost exceeds `ceiling`.

        Parameters
        ----------
        closed : (steps, nc) [-], whether a contact is closed in a step
        ceiling : cost above which the search stops
        softness : of the goal, as in `ModesProblem`

        Returns
        -------
        The active conditions of the optimum; the empty set if it was not found; None without a plan
        below the ceiling.

        Raises
        ------
        ValueError
            for an array of another shape
        """
        lin, kkt = self._linear, self._kkt
        sign = np.where(closed, 1.0, -1.0)
        none_u, none_c = (
            np.zeros((lin.steps, lin.nu), dtype=bool),
            np.zeros((lin.steps, lin.nc), dtype=bool),
        )
        if not kkt.factor(closed, none_u, none_c, softness=softness):
            return None
        right = kkt.right_side(closed, none_u, np.zeros(none_u.shape), none_c)
        x = kkt.solve(right)
        if not np.abs(kkt.product(x) - right).max() <= 1e-8 * max(1.0, np.abs(right).max()):
            return None
        imposed: list[tuple[int, int, int]] = []
        columns = np.zeros((_MOST, lin.steps * (lin.nc + lin.nu)))
        gram, force = np.zeros((0, 0)), np.zeros(0)
        cost, values = lin.soft_cost(kkt.point(x), softness), self._moved(x, sign)
        values[: sign.size] += np.vstack([np.zeros((1, lin.nc)), sign[1:] * lin.p]).ravel()
        for _ in range(_MOST):
            condition, violation = self._worst(values, imposed)
            if condition is None:
                active = WorkingSet.none(lin)
                for kind, t, column in imposed:
                    (active.touching if kind == 0 else active.side)[t, column] = kind or 1
                return active
            if cost >= ceiling:
                return None
            column = self._moved(kkt.solve(self._right(condition, sign), refine=False), sign)
            own, own_force = self._value(column, condition), 0.0
            cross = np.array([self._value(column, other) for other in imposed])
            while True:
                held = len(imposed)
                try:
                    share = np.linalg.solve(gram, cross) if held else np.zeros(0)
                except np.linalg.LinAlgError:  # dependent conditions: for the interior point
                    return WorkingSet.none(lin)
                slope = own - float(cross @ share)
                falling = np.flatnonzero(share > 1e-14)
                drop = (
                    int(falling[np.argmin(force[falling] / share[falling])]) if falling.size else -1
                )
                partial = float(force[drop] / share[drop]) if drop >= 0 else np.inf
                full = -violation / slope if slope > _DEPENDENT * own else np.inf
                step = min(partial, full)
                if not np.isfinite(step):
                    return None
                if np.isfinite(full):
                    values += step * (column - share @ columns[:held])
                    cost += step * slope * (0.5 * step + own_force)
                    violation += step * slope
                force, own_force = force - step * share, own_force + step
                if full <= partial:
                    break
                imposed.pop(drop)
                columns[drop : held - 1] = columns[drop + 1 : held]
                keep = np.arange(held) != drop
                force, cross, gram = force[keep], cross[keep], gram[np.ix_(keep, keep)]
            gram = np.block([[gram, cross[:, None]], [cross[None], np.array([[own]])]])
            force = np.append(force, own_force)
            columns[len(imposed)] = column
            imposed.append(condition)
        return WorkingSet.none(lin)

    def _moved(self, x: np.ndarray, sign: np.ndarray) -> np.ndarray:
        """Return the conditions' values (steps * (nc + nu),): signed phi - p, then u."""
        phi = np.zeros(sign.shape)
        phi[1:] = sign[1:] * (x[self._kkt.rows_z[:-1]] @ self._linear.P.T)
        return np.concatenate([phi.ravel(), x[self._kkt.rows_u].ravel()])

    def _worst(
        self, values: np.ndarray, imposed: list[tuple[int, int, int]]
    ) -> tuple[tuple[int, int, int] | None, float]:
        """Return the most violated condition and its negative value; phi counts as force k phi."""
        lin = self._linear
        phi, u = (
            values[: lin.steps * lin.nc].reshape(lin.steps, lin.nc),
            values[lin.steps * lin.nc :].reshape(lin.steps, lin.nu),
        )
        worst: tuple[float, tuple[int, int, int] | None, float] = (0.0, None, 0.0)
        for kind, slack, weight in (
            (0, phi, lin.k),
            (-1, u - lin.lower, 1.0),
            (1, lin.upper - u, 1.0),
        ):
            short = np.where(slack < -_VIOLATED, slack * weight, 0.0)
            for other in imposed:
                if other[0] == kind:
                    short[other[1:]] = 0.0
            if short.size and short.min() < worst[0]:
                t, column = (int(i) for i in np.unravel_index(int(short.argmin()), short.shape))
                worst = (float(short.min()), (kind, t, column), float(slack[t, column]))
        return worst[1], worst[2]

    def _right(self, condition: tuple[int, int, int], sign: np.ndarray) -> np.ndarray:
        kind, t, column = condition
        right = np.zeros(self._kkt.size)
        if kind == 0:
            right[self._kkt.rows_z[t - 1]] = sign[t, column] * self._linear.P[column]
        else:
            right[self._kkt.rows_u[t, column]] = -float(kind)
        return right

    def _value(self, moved: np.ndarray, condition: tuple[int, int, int]) -> float:
        kind, t, column = condition
        lin = self._linear
        return float(
            moved[t * lin.nc + column]
            if kind == 0
            else -kind * moved[lin.steps * lin.nc + t * lin.nu + column]
        )
