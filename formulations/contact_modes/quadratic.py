"""Solve the planning problem of a linear scene with fixed modes: a convex quadratic program.

    answer = problem.solve(closed)  # closed (steps, nc): True: lam = k phi, False: lam = 0
    minimise sum_t cost   subject to   the time step,  z[T] = goal,  lower <= u <= upper,
                                       phi >= 0 where closed,  phi <= 0 where open

The active conditions come from `dual_active_set`; then the equality problem is solved and every
sign checked, so that an answer is exact. With G = lam >= 0, H = lam - k phi >= 0 the Lagrangian is
L = ... - s_G G - s_H H. The multipliers s_G, s_H [1/N] of biactive pairs show whether other modes
are cheaper. If both are >= 0 (S), no other modes are cheaper to first order.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b

import numpy as np

from formulations.contact_modes.dual_active_set import (
    DualActiveSet,
    WorkingSet,
    interior_point_active_set,
)
from formulations.contact_modes.linear import BandedKKT, LinearScene, Point

# A multiplier with a smaller share of the largest one counts as zero.
_ZERO = 1e-6


@dataclass(frozen=True, kw_only=True)
class ModeStationarity:
    """Absence of negative multipliers of biactive pairs; number and least multiplier [1/N]."""

    strong: bool
    biactive: int
    least: float

    @property
    def sentence(self) -> str:
        """Return the stationarity as text."""
        if not self.biactive:
            return "S-stationary: no contact touches without pressing."
        pairs = "pair touches" if self.biactive == 1 else "pairs touch"
        kind = "S-stationary" if self.strong else "Not S-stationary"
        return f"{kind}: {self.biactive} {pairs} without pressing, with multipliers of at least {self.least:.3g}."


def stationarity_of(
    of_force: np.ndarray, of_separation: np.ndarray, biactive: np.ndarray
) -> ModeStationarity:
    """Return the stationarity that the signs of the multipliers show.

    of_force, of_separation (steps, nc) [1/N] are s_G and s_H, biactive (steps, nc) [-] marks pairs
    with G = H = 0. Raises IndexError for arrays of different shapes.
    """
    pairs = np.stack([of_force[biactive], of_separation[biactive]])
    if not pairs.size:
        return ModeStationarity(strong=True, biactive=0, least=0.0)
    zero = _ZERO * max(1.0, float(np.abs(np.stack([of_force, of_separation])).max()))
    least = float(pairs.min())
    return ModeStationarity(strong=least >= -zero, biactive=int(biactive.sum()), least=least)


# Rounds of the active set before it counts as cycling; from a neighbour's set 2 to 4 are needed.
_ROUNDS = 12
# Rounds from a neighbour's set (a factorisation each) before the dual method (one factorisation, a
# back substitution per condition).
_WARM_ROUNDS = 5
# Smallest size of a neighbour's set for which these rounds are worth it.
_MANY = 12
# Smallest violation of a condition [m], [N]: rounding of the banded solution.
_VIOLATED = 1e-12
# A condition with a multiplier below minus this is dropped.
_WRONG_SIGN = 1e-9
# Largest |phi| [m] of a pair that touches without force.
_BIACTIVE = 1e-11
# Relative difference of equal costs.
_SAME = 1e-10
# Largest residual of a solution of the linear system.
_SOLVED = 1e-8


@dataclass(frozen=True, kw_only=True, eq=False)
class ModesAnswer:
    """An optimum for fixed modes: closed (steps, nc), u (steps, nu) [N, N m], phi (steps, nc) [m].

    - of_force, of_separation: (steps, nc) [1/N], multipliers s_G and s_H
    - biactive: (steps, nc), pairs that touch without force, except those of the first step
    - dual_infeasibility: largest derivative of the Lagrangian that should be zero
    """

    closed: np.ndarray
    u: np.ndarray
    cost: float
    phi: np.ndarray
    of_force: np.ndarray
    of_separation: np.ndarray
    biactive: np.ndarray
    dual_infeasibility: float

    def stationarity(self) -> ModeStationarity:
        """Return the stationarity by the biactive pairs."""
        return stationarity_of(self.of_force, self.of_separation, self.biactive)

    @property
    def biactive_multiplier(self) -> np.ndarray:
        """Return the smaller multiplier (steps, nc) [1/N] of a biactive pair if negative, else 0.

        The other mode is cheaper there. Raises nothing.
        """
        return np.where(
            self.biactive, np.minimum(0.0, np.minimum(self.of_force, self.of_separation)), 0.0
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadraticAnswer(ModesAnswer):
    """An answer with the whole solution and its active conditions."""

    point: Point
    active: WorkingSet


class ModesProblem:
    """The quadratic program of one scene; `softness` may change between solves.

    softness: if positive, |z[T] - goal|^2 / (2 softness) replaces the goal; the modes of any
        rollout then have a plan
    """

    def __init__(self, linear: LinearScene) -> None:
        self.linear = linear
        self.kkt = BandedKKT(linear)
        self.solves, self.softness = 0, 0.0
        # Lower bounds of the cost, by softness and modes.
        self._floors: dict[tuple[float, bytes], float] = {}
        self._dual = DualActiveSet(linear, self.kkt)

    def solve(
        self, closed: np.ndarray, near: QuadraticAnswer | None = None, below: float = np.inf
    ) -> QuadraticAnswer | None:
        """Return the optimum for these modes if it costs less than `below`, else None.

        Lower bounds of the cost are stored, because searches from other starts meet the same modes.

        Parameters
        ----------
        closed : (steps, nc) [-], whether a contact is closed in a step
        near : the answer of similar modes; its active conditions are tried first
        below : upper limit of the cost

        Raises
        ------
        ValueError
            for modes of another shape
        """
        closed = self._whole(closed)
        self.solves += 1
        key = (
            self.softness,
            blake2b(np.packbits(closed).tobytes(), digest_size=16).digest(),
        )
        floor = self._floors.get(key, -np.inf)
        if floor == np.inf or (np.isfinite(below) and floor >= below - _SAME * abs(below)):
            return None
        answer = self._optimum(closed, near, below)
        self._floors[key] = max(floor, below if answer is None else answer.cost)
        return answer

    def _optimum(
        self, closed: np.ndarray, near: QuadraticAnswer | None, below: float
    ) -> QuadraticAnswer | None:
        if near is not None and near.active.count > _MANY:
            answer = self._rounds(closed, near.active, _WARM_ROUNDS, below)
            if answer is not None:
                return answer if answer.cost < below else None
        guess = self._dual.solve(closed, below, self.softness)
        if guess is None:
            return None
        answer = self._rounds(closed, guess)
        if answer is None:
            active = interior_point_active_set(self.linear, closed, self.softness)
            answer = None if active is None else self._rounds(closed, active)
        return answer if answer is not None and answer.cost < below else None

    def _whole(self, closed: np.ndarray) -> np.ndarray:
        """Return the modes with those of the start, and with open velocity bounds."""
        lin = self.linear
        fixed = np.hstack(
            [
                np.array(closed, dtype=bool),
                np.zeros((len(closed), lin.nc - lin.contacts), dtype=bool),
            ]
        )
        fixed[0] = lin.penetration(lin.start[None])[0] > 0.0
        return fixed

    def _slopes(self, point: Point) -> np.ndarray:
        """Return the Lagrangian's derivative by u (steps, nu): a bound's multiplier, else 0."""
        lin, n = self.linear, self.linear.n
        x = np.hstack([point.z[:-1], point.u])
        return x @ lin.H[:, n:] + lin.g[n:] + point.y @ lin.B

    def _rounds(
        self, closed: np.ndarray, active: WorkingSet, most: int = _ROUNDS, below: float = np.inf
    ) -> QuadraticAnswer | None:
        """Return the optimum from a guess of its active set, or None.

        An answer that costs `below` or more may be only a lower bound, of a problem with fewer
        conditions.
        """
        sign = np.where(closed, 1.0, -1.0)
        active = WorkingSet(
            side=active.side, touching=active.touching & (np.arange(len(closed)) > 0)[:, None]
        )
        for _ in range(most):
            point = self._equality(closed, active)
            if point is None:
                return None
            better = self._next(point, sign, active)
            is_bound = (
                not ((better.side != active.side) & (active.side != 0)).any()
                and not (active.touching & ~better.touching).any()
            )
            if better.same_as(active) or (
                is_bound and self.linear.soft_cost(point, self.softness) >= below
            ):
                return self._answer(closed, point, active)
            active = better
        return None

    def _answer(self, closed: np.ndarray, point: Point, active: WorkingSet) -> QuadraticAnswer:
        lin = self.linear
        both, own = point.y @ lin.E, point.mu / np.where(lin.k > 0.0, lin.k, 1.0)
        of_force = np.where(closed, -own, both - own)
        contacts = slice(lin.contacts)
        phi = lin.penetration(point.z[:-1])[:, contacts]
        biactive = np.abs(phi) <= _BIACTIVE
        biactive[:1] = False  # the start decides these
        return QuadraticAnswer(
            closed=closed[:, contacts],
            u=point.u,
            point=point,
            active=active,
            cost=lin.soft_cost(point, self.softness),
            phi=phi,
            biactive=biactive,
            of_force=of_force[:, contacts],
            of_separation=(both - of_force)[:, contacts],
            dual_infeasibility=float(
                np.abs(np.where(active.side == 0, self._slopes(point), 0.0)).max(initial=0.0)
            ),
        )

    def _next(self, point: Point, sign: np.ndarray, active: WorkingSet) -> WorkingSet:
        lin, side = self.linear, active.side
        slope = self._slopes(point)
        # The lower bound pushes up (slope >= 0), the upper one down.
        keeps = side * slope <= _WRONG_SIGN
        moved = np.where(
            side == 0,
            np.sign(
                (point.u > lin.upper + _VIOLATED).astype(int) - (point.u < lin.lower - _VIOLATED)
            ),
            side * keeps,
        )
        separation = sign * lin.penetration(point.z[:-1])
        touching = np.where(
            active.touching, -sign * point.mu >= -_WRONG_SIGN, separation < -_VIOLATED
        )
        touching[0] = False
        return WorkingSet(side=moved.astype(int), touching=touching)

    def _equality(self, closed: np.ndarray, active: WorkingSet) -> Point | None:
        lin, held = self.linear, active.side != 0
        if not self.kkt.factor(closed, held, active.touching, softness=self.softness):
            return None
        bound = np.where(active.side > 0, lin.upper, np.where(active.side < 0, lin.lower, 0.0))
        right = self.kkt.right_side(closed, held, bound, active.touching)
        x = self.kkt.solve(right)
        residual = np.abs(self.kkt.product(x) - right).max()
        if not residual <= _SOLVED * max(1.0, np.abs(right).max()):  # also for NaN
            return None
        return self.kkt.point(x)
