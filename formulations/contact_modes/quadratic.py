"""The planning problem of a linear scene with its contact modes fixed: a convex quadratic program, solved to rounding.

    problem = ModesProblem(linear)
    # closed (steps, nc): True where lam = k phi, False where lam = 0
    answer = problem.solve(closed)
    answer.u, answer.cost, answer.point.z

    minimise sum_t cost   subject to   the time step,  z[T] = goal,  lower <= u <= upper,
                                       phi >= 0 where closed,  phi <= 0 where open

A dual active-set method names the active conditions; where it finds too many of them an
interior-point method does (`dual_active_set`). Then the equality problem is solved once more by a
factorisation that holds them, and every sign is checked: the answer is exact or there is none.

The multipliers of the fixed modes say whether other modes are cheaper. With G = lam >= 0 and H =
lam - k phi >= 0 and one of them zero at each step, the problem with fixed modes has multipliers s_G
and s_H per newton (L = ... - s_G G - s_H H). Where one of G and H is positive its multiplier is
zero and the other may have any sign. Where both are zero (a biactive pair: the bodies touch without
pressing) the signs decide:

    S  both >= 0: no mode of these pairs is cheaper to first order   M
        both > 0, or one of them zero
    C  the product is >= 0      A  one of them >= 0      W  neither
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

_ZERO = 1e-6  # part of the largest multiplier that counts as zero


@dataclass(frozen=True, kw_only=True)
class ModeStationarity:
    """Whether no multiplier of a biactive pair is negative, the number of these pairs, and their least multiplier [1/N] (0 without pairs)."""

    strong: bool
    biactive: int
    least: float

    @property
    def sentence(self) -> str:
        """The same in words."""
        if not self.biactive:
            return "S-stationary: no contact touches without pressing."
        pairs = "pair touches" if self.biactive == 1 else "pairs touch"
        kind = "S-stationary" if self.strong else "Not S-stationary"
        return f"{kind}: {self.biactive} {pairs} without pressing, with multipliers of at least {self.least:.3g}."


def stationarity_of(
    of_force: np.ndarray, of_separation: np.ndarray, biactive: np.ndarray
) -> ModeStationarity:
    """Return the stationarity that the signs of the multipliers show.

    Parameters
    ----------
    of_force, of_separation : (steps, nc) [1/N], multipliers s_G and s_H
    biactive : (steps, nc) [-], whether both G and H are zero

    Raises
    ------
    IndexError
        For arrays of different shapes.
    """
    pairs = np.stack([of_force[biactive], of_separation[biactive]])
    if not pairs.size:
        return ModeStationarity(strong=True, biactive=0, least=0.0)
    zero = _ZERO * max(1.0, float(np.abs(np.stack([of_force, of_separation])).max()))
    least = float(pairs.min())
    return ModeStationarity(strong=least >= -zero, biactive=int(biactive.sum()), least=least)


# of the active set before it counts as going in circles; from a neighbour's set 2 to 4 are needed
_ROUNDS = 12
# From a neighbour's set so many rounds (a factorisation each), before the dual method is asked (one
# factorisation, and a back substitution for each condition): worth it where that set has more
# conditions than this.
_WARM_ROUNDS = 5
_MANY = 12
_VIOLATED = 1e-12  # [m], [N]: rounding of the banded solution
_WRONG_SIGN = 1e-9  # a multiplier below minus this asks for its condition to be dropped
_BIACTIVE = 1e-11  # [m] penetration or gap below which a pair touches without pressing
_SAME = 1e-10  # part of a cost by which two are the same
_SOLVED = 1e-8  # largest residual of the linear system that still counts as a solution


@dataclass(frozen=True, kw_only=True, eq=False)
class ModesAnswer:
    """An optimum for fixed modes: closed (steps, nc), u (steps, nu) [N, N m], its cost and phi (steps, nc) [m].

    of_force, of_separation: (steps, nc) [1/N], multipliers s_G and s_H; biactive (steps, nc): pairs
        that touch without pressing, but for those of the
    first step, which the start decides; dual_infeasibility: largest derivative of the Lagrangian
        that should be zero.
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
        """Return the stationarity by the pairs that touch without pressing."""
        return stationarity_of(self.of_force, self.of_separation, self.biactive)

    @property
    def biactive_multiplier(self) -> np.ndarray:
        """Smaller multiplier of a biactive pair where it is negative, else 0: (steps, nc) [1/N].

        There the other mode is cheaper.
        """
        return np.where(
            self.biactive, np.minimum(0.0, np.minimum(self.of_force, self.of_separation)), 0.0
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadraticAnswer(ModesAnswer):
    """The same with states and multipliers of the whole optimality system, and its active conditions."""

    point: Point
    active: WorkingSet


class ModesProblem:
    """The quadratic program of one scene; `softness` may be moved between solves.

    softness: where positive, the goal need not be met: |z[T] - goal|^2 / (2 softness) is added to
        the cost. The modes of any rollout have a plan then.
    """

    def __init__(self, linear: LinearScene) -> None:
        self.linear = linear
        self.kkt = BandedKKT(linear)
        self.solves, self.softness = 0, 0.0
        # by softness and modes: no plan costs less
        self._floors: dict[tuple[float, bytes], float] = {}
        self._dual = DualActiveSet(linear, self.kkt)

    def solve(
        self, closed: np.ndarray, near: QuadraticAnswer | None = None, below: float = np.inf
    ) -> QuadraticAnswer | None:
        """Find the optimum for these modes.

        What modes were found to cost at least is remembered, since searches from other starts end
        among the same modes.

        Parameters
        ----------
        closed : (steps, nc) [-], whether a contact is closed in a step
        near : the answer of similar modes, whose active conditions are tried first
        below : cost above which no plan is of interest

        Returns
        -------
        The optimum, or None where these modes have no plan of a cost below `below`.

        Raises
        ------
        ValueError
            For modes of another shape.
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
        found = self._optimum(closed, near, below)
        self._floors[key] = max(floor, below if found is None else found.cost)
        return found

    def _optimum(
        self, closed: np.ndarray, near: QuadraticAnswer | None, below: float
    ) -> QuadraticAnswer | None:
        if near is not None and near.active.count > _MANY:
            found = self._rounds(closed, near.active, _WARM_ROUNDS, below)
            if found is not None:
                return found if found.cost < below else None
        guess = self._dual.solve(closed, below, self.softness)
        if guess is None:
            return None
        found = self._rounds(closed, guess)
        if found is None:
            active = interior_point_active_set(self.linear, closed, self.softness)
            found = None if active is None else self._rounds(closed, active)
        return found if found is not None and found.cost < below else None

    def _whole(self, closed: np.ndarray) -> np.ndarray:
        """The same modes with those of the first step, which the start decides, and those of the bounds of velocities, never closed."""
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
        """(steps, nu) derivative of the Lagrangian with respect to u: 0 where u is free, the multiplier of its bound elsewhere."""
        lin, n = self.linear, self.linear.n
        x = np.hstack([point.z[:-1], point.u])
        return x @ lin.H[:, n:] + lin.g[n:] + point.y @ lin.B

    def _rounds(
        self, closed: np.ndarray, active: WorkingSet, most: int = _ROUNDS, below: float = np.inf
    ) -> QuadraticAnswer | None:
        """The optimum, from a guess of its active set; or None.

        An answer of a cost of `below` or more may only be a lower bound: imposed conditions whose
        multipliers all have the right sign are those of a problem with fewer.
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
        """With the multipliers of lam >= 0 and lam - k phi >= 0: their sum is that of lam in the time step."""
        lin = self.linear
        both, own = point.y @ lin.E, point.mu / np.where(lin.k > 0.0, lin.k, 1.0)
        of_force = np.where(closed, -own, both - own)
        contacts = slice(lin.contacts)
        phi = lin.penetration(point.z[:-1])[:, contacts]
        biactive = np.abs(phi) <= _BIACTIVE
        biactive[:1] = False  # the start is no choice
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
        keeps = (
            side * slope <= _WRONG_SIGN
        )  # the lower bound pushes up (slope >= 0), the upper one down
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
        if not residual <= _SOLVED * max(1.0, np.abs(right).max()):  # NaN counts as no solution
            return None
        return self.kkt.point(x)
