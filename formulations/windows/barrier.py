"""An interior-point method for the same quadratic program, on the same banded matrix: it does not mind how many conditions are active.

Its answer is only used to name the active conditions, those whose multiplier exceeds their slack; the equality problem then solves exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from formulations.windows.goal_ball import nearest_goal
from formulations.windows.kkt import BandedKKT
from formulations.windows.linear_scene import LinearScene

_ITERATIONS = 60
_GAP = 1e-13  # mean product of slack and multiplier at which the active conditions are named
_STEP = 0.99  # part of the way to the nearest bound
_ENORMOUS = 1e100  # what a singular matrix that was not found out leaves
# Mean product of slack and multiplier, in units of the cost's largest coefficient, beyond which nothing is feasible: it begins at 1; where there was an
# optimum it came to 500, where there is none the multipliers grow without end.
_DIVERGES = 1e12
_INFEASIBLE = 1e-7  # a slack that still misses its condition by more when the gap is closed

Triple = list[np.ndarray]  # one array a kind of condition: u - lower (steps, nu), upper - u (steps, nu), sign * phi (steps, nc)


@dataclass(frozen=True, eq=False)
class _Iterate:
    slack: Triple
    dual: Triple
    u: np.ndarray

    def gap(self, kinds: Triple) -> float:
        """Mean product of slack and multiplier over the conditions that there are."""
        count = max(1, sum(int(kind.sum()) for kind in kinds))
        return sum(float((s * d)[kind].sum()) for kind, s, d in zip(kinds, self.slack, self.dual, strict=True)) / count

    def moved(self, towards: _Iterate, primal: float, dual: float) -> _Iterate:
        return _Iterate(
            [s + primal * ds for s, ds in zip(self.slack, towards.slack, strict=True)],
            [d + dual * dd for d, dd in zip(self.dual, towards.dual, strict=True)],
            self.u + primal * towards.u,
        )


class BarrierMethod:
    """See the module docstring."""

    def __init__(self, linear: LinearScene, kkt: BandedKKT) -> None:
        self._linear, self._kkt = linear, kkt
        shape = (linear.steps, linear.nu)
        inner = np.ones((linear.steps, linear.nc), dtype=bool)
        inner[:1] = False  # the start decides phi there
        self._kinds = [np.broadcast_to(np.isfinite(linear.lower), shape), np.broadcast_to(np.isfinite(linear.upper), shape), inner]
        self._lower = np.where(np.isfinite(linear.lower), linear.lower, 0.0)
        self._upper = np.where(np.isfinite(linear.upper), linear.upper, 0.0)

    def active_set(self, closed: np.ndarray, goal: np.ndarray, ball: float, softness: float = 0.0) -> tuple[np.ndarray, np.ndarray] | None:
        """(side (steps, nu), touching (steps, nc)) at the optimum, or None where none was found."""
        kinds, cost = self._kinds, max(1.0, *(float(np.abs(part).max(initial=0.0)) for part in (self._linear.H, self._linear.g)))
        here = _Iterate(
            [np.ones(kind.shape) for kind in kinds],
            [kind.astype(float) for kind in kinds],
            np.clip(np.zeros(kinds[0].shape), self._linear.lower, self._linear.upper),
        )
        for _ in range(_ITERATIONS):
            gap = here.gap(kinds)
            if gap > _DIVERGES * cost:
                return None
            columns = self._factor(closed, here, ball, softness)
            if columns is None:
                return None
            affine = self._newton(closed, goal, ball, columns, here, [np.zeros(kind.shape) for kind in kinds])
            if affine is None:
                return None
            after = here.moved(affine, _length(here.slack, affine.slack), _length(here.dual, affine.dual)).gap(kinds)
            centre = gap * min(1.0, after / gap) ** 3
            target = [centre - ds * dd for ds, dd in zip(affine.slack, affine.dual, strict=True)]
            step = self._newton(closed, goal, ball, columns, here, target)
            if step is None:
                return None
            primal = min(1.0, _STEP * _length(here.slack, step.slack))
            missed = max(float(np.abs(ds).max(initial=0.0)) for ds in step.slack) * (1.0 - primal)
            here = here.moved(step, primal, min(1.0, _STEP * _length(here.dual, step.dual)))
            if gap < _GAP and missed <= _INFEASIBLE:
                on = [kind & (d > s) for kind, s, d in zip(kinds, here.slack, here.dual, strict=True)]
                return on[1].astype(int) - on[0].astype(int), on[2]
        return None

    def _factor(self, closed: np.ndarray, here: _Iterate, ball: float, softness: float) -> np.ndarray | None:
        """Factorise at an iterate; the columns of the goal if there is a ball (else none), or None where the matrix is singular."""
        low, up = self._ratios(here)
        held = np.zeros(self._kinds[0].shape, dtype=bool)
        if not self._kkt.factor(closed, held, self._kinds[2], stiffness=low + up, compliance=self._compliance(here), softness=softness):
            return None
        return self._kkt.solve(self._kkt.goal_columns()) if ball > 0.0 else np.zeros((0, 0))

    def _ratios(self, here: _Iterate) -> tuple[np.ndarray, np.ndarray]:
        """Multiplier over slack of the lower and the upper bounds."""
        low, up = (np.where(kind, d / s, 0.0) for kind, s, d in zip(self._kinds[:2], here.slack, here.dual, strict=False))
        return low, up

    def _compliance(self, here: _Iterate) -> np.ndarray:
        """Slack over multiplier of the signs of phi."""
        inner = self._kinds[2]
        return np.where(inner, here.slack[2] / np.where(inner, here.dual[2], 1.0), 0.0)

    def _newton(
        self, closed: np.ndarray, goal: np.ndarray, ball: float, columns: np.ndarray, here: _Iterate, target: Triple
    ) -> _Iterate | None:
        """The step towards slack * dual = target with the matrix factorised at `here`."""
        lin, kkt, inner = self._linear, self._kkt, self._kinds[2]
        sign = np.where(closed, 1.0, -1.0)
        low, up = self._ratios(here)
        pull_low, pull_up = (np.where(kind, t / s, 0.0) for kind, t, s in zip(self._kinds[:2], target, here.slack, strict=False))
        base_low, base_up = self._lower + here.slack[0], self._upper - here.slack[1]
        right = kkt.right_side(closed, np.zeros(low.shape, dtype=bool), here.u, np.zeros_like(inner), goal)
        right[kkt.rows_u] += pull_low + low * base_low - pull_up + up * base_up
        reach = np.where(inner, target[2] / np.where(inner, here.dual[2], 1.0), 0.0) + here.slack[2]
        right[kkt.rows_mu[:-1]] = (sign * reach - lin.p)[1:]
        x = kkt.solve(right)
        if not max(np.abs(x).max(), np.abs(columns).max(initial=0.0)) < _ENORMOUS:
            return None
        if ball > 0.0:
            x, right = nearest_goal(kkt, x, columns, right, ball)
        point = kkt.point(x)
        slack = [point.u - self._lower, self._upper - point.u, sign * lin.penetration(point.z[:-1])]
        dual = [pull_low - low * (point.u - base_low), pull_up + up * (point.u - base_up), -sign * point.mu]
        return _Iterate(
            [np.where(kind, new - s, 0.0) for kind, new, s in zip(self._kinds, slack, here.slack, strict=True)],
            [np.where(kind, new - d, 0.0) for kind, new, d in zip(self._kinds, dual, here.dual, strict=True)],
            point.u - here.u,
        )


def _length(values: Triple, steps: Triple) -> float:
    """The longest step, at most 1, that keeps all values at least 0."""
    longest = 1.0
    for value, step in zip(values, steps, strict=True):
        falling = step < 0.0
        if falling.any():
            longest = min(longest, float((-value[falling] / step[falling]).min()))
    return longest
