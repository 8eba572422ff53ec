"""How deep and how far apart a contact can be at each step: the big-M of the mixed-integer program, valid by construction.

    bounds = pair_bounds(scene, linear, ceiling=13.63)  # of all plans that cost at most the ceiling

Three sources, each valid for every exact plan that costs at most the ceiling (infinite: for every
    exact plan):
1. physics (`energy_bound`), where the scene is of its form: a largest penetration, and how fast a
    gap can change;
2. reach, step by step: phi[t] depends on the forces before t alone, whose bounds are known by then;
3. again, with all bounds at once, as long as that decides more.
2 and 3 minimise and maximise phi[t] over the convex relaxation: two second-order cone programs a
    pair.

A bound from physics: contact forces do no work of their own, so a plan that costs little never gets
much energy.

For M dv/dt = -C v + B u + J' lam with M, C constant and diagonal, running cost u' R u + (what is
not negative), and E = 1/2 v' M v + 1/2 sum k max(phi, 0)^2, one semi-implicit step of length h
obeys

    E[t+1] - E[t] <= h (w' B u - w' D w),     w = v[t+1],     D = C - h/2 (C M^-1 C + J' K J).

Proof. The elastic energy U(q) has gradient -J' lam and grows at most like its quadratic model with
    K everywhere closed, so
U(q + h w) - U(q) <= -h lam' J w + h^2/2 w' J' K J w. With d = w - v: 1/2 w' M w - 1/2 v' M v = w' M
    d - 1/2 d' M d = h w' (-C v + B u + J' lam)
- 1/2 d' M d, and -h w' C v = -h w' C w + h w' C d <= -h w' C w + 1/2 d' M d + h^2/2 w' C M^-1 C w.
  The terms of lam and d cancel. []

Where D is positive definite, w' B u - w' D w <= 1/4 u' B' D^-1 B u <= g u' R u with g the largest
eigenvalue of 1/4 R^-1/2 B' D^-1 B R^-1/2, hence

    E[t] <= E[0] + h g (cost).

The convex relaxation of a linear scene's planning problem, and the questions it answers by
Clarabel.

Each pair's graph lam = k max(phi, 0), l <= phi <= h, is replaced by its convex hull, a triangle:

    lam >= 0,   lam >= k phi,   lam <= k h+ (phi - l-) / (h+ - l-),   l- = min(l, 0), h+ = max(h, 0)

so that every exact plan whose penetrations keep their bounds is one of the relaxation, and a pair
    with l = 0 or h = 0 is exact. Unknowns by
time: u[t], lam[t], z[t+1]. Rows with an infinite bound are left out.

Clarabel's bound is the objective of its dual point, with duals feasible to 1e-8: it is lowered by
`SLACK` of its size before it is believed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sparse
import sympy as sp

from formulations.contact_modes.linear import LinearScene
from models.dynamics import derive
from models.scene import Scene

SLACK = 1e-6  # relative, and absolute for bounds below 1: a hundred times Clarabel's own tolerance


class Relaxation:
    """The relaxation as matrices.

    Its questions take bounds of phi [m], lower and upper (steps, nc), whose row 0 belongs to the
    start and is not used.

    Each answer is a bound of a minimum from below, lowered by SLACK: inf where no plan keeps the
    bounds, -inf where Clarabel does not end.
    """

    def __init__(self, linear: LinearScene) -> None:
        self._linear = linear
        lin, T = linear, linear.steps
        n, nu, nc = lin.n, lin.nu, lin.contacts
        block = (nu + nc + n) * np.arange(T)[:, None]
        self._u, self._lam, self._z = (
            block + np.arange(nu),
            block + nu + np.arange(nc),
            block + nu + nc + np.arange(n),
        )
        self._size = T * (nu + nc + n)
        self._penetration = self._rows([(self._z[:-1], lin.P[:nc])])
        self._force = self._rows([(self._lam[1:], np.eye(nc))])
        self._k, self._offset = np.tile(lin.k[:nc], T - 1), np.tile(lin.p[:nc], T - 1)
        self._equalities = self._dynamics()
        self._always = self._bounds()

    def least_cost(self, lower: np.ndarray, upper: np.ndarray) -> float:
        """A lower bound of the cost.

        Raises nothing: -inf where the program is not solved.

        Parameters
        ----------
        lower, upper : (steps, nc) bounds of the penetrations [m]
        """
        factor, offset, linear_part, constant = self._cost
        quadratic = sparse.triu(factor.T @ factor).tocsc()
        constant += 0.5 * float(offset @ offset)
        return _lowered(
            self._solve(quadratic, linear_part + factor.T @ offset, lower, upper, [], []) + constant
        )

    def least_penetration(
        self,
        t: int,
        contact: int,
        sign: float,
        lower: np.ndarray,
        upper: np.ndarray,
        ceiling: float,
    ) -> float:
        """A lower bound of sign * phi[t, contact], t >= 1, over all plans that cost at most the ceiling.

        Raises nothing: -inf where the program is not solved.

        Parameters
        ----------
        t, contact : the pair
        sign : 1 or -1
        lower, upper : (steps, nc) bounds of the penetrations [m]
        ceiling : the most that plans may cost; infinite: all plans
        """
        row = (t - 1) * self._linear.contacts + contact
        objective = sign * self._penetration[[row]].toarray().ravel()
        cones, rows = [], []
        if np.isfinite(ceiling):
            factor, offset, linear_part, constant = (
                self._cost
            )  # |factor x + offset|^2 <= room - 2 linear_part' x =: r
            room = 2.0 * (ceiling - constant)
            slope = sparse.csr_matrix(linear_part)  # |(factor x + offset, (1 - r)/2)| <= (1 + r)/2
            rows = [
                (
                    sparse.vstack([slope, -slope, -factor]),
                    np.concatenate([[0.5 * (1.0 + room), 0.5 * (1.0 - room)], offset]),
                )
            ]
            cones = [clarabel.SecondOrderConeT(2 + len(offset))]
        answer = self._solve(
            sparse.csc_matrix((self._size, self._size)), objective, lower, upper, rows, cones
        )
        return _lowered(answer + sign * self._offset[row])

    def _solve(
        self,
        quadratic: Any,
        objective: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        rows: list,
        cones: list,
    ) -> float:
        left, right = self._equalities
        inner = [self._always, *self._hull(lower[1:].ravel(), upper[1:].ravel())]
        matrix = sparse.vstack(
            [left, *(part[0] for part in inner), *(part[0] for part in rows)]
        ).tocsc()
        vector = np.concatenate([right, *(part[1] for part in inner), *(part[1] for part in rows)])
        nonnegative = sum(len(part[1]) for part in inner)
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        kinds = [clarabel.ZeroConeT(len(right)), clarabel.NonnegativeConeT(nonnegative), *cones]
        found = clarabel.DefaultSolver(
            quadratic, objective, matrix, vector, kinds, settings
        ).solve()
        status = str(found.status)
        return (
            np.inf
            if status == "PrimalInfeasible"
            else float(found.obj_val_dual)
            if status == "Solved"
            else -np.inf
        )

    def _hull(self, lower: np.ndarray, upper: np.ndarray) -> list[tuple[Any, np.ndarray]]:
        """Rows A x <= b of the triangles and of the bounds themselves."""
        phi, force, k, offset = self._penetration, self._force, self._k, self._offset
        found = [(-force, np.zeros(len(k))), (sparse.diags(k) @ phi - force, -k * offset)]
        for matrix, bound, keep in (
            (phi, upper - offset, np.isfinite(upper)),
            (-phi, offset - lower, np.isfinite(lower)),
        ):
            found.append((matrix[keep], bound[keep]))
        keep = np.isfinite(upper) & np.isfinite(lower)
        low, high = np.minimum(lower[keep], 0.0), np.maximum(upper[keep], 0.0)
        width = high - low
        chord = k[keep] * np.divide(high, width, out=np.ones_like(width), where=width > 0.0)
        found.append((force[keep] - sparse.diags(chord) @ phi[keep], chord * (offset[keep] - low)))
        return found

    def _dynamics(self) -> tuple[Any, np.ndarray]:
        """z[t+1] = A z[t] + B u[t] + c + E lam[t], the forces of the start, and what is given of the end."""
        lin, nc = self._linear, self._linear.contacts
        rest = np.tile(lin.c, (lin.steps, 1))
        rest[0] += lin.A @ lin.start
        now = self._rows([(self._z, np.eye(lin.n)), (self._u, -lin.B), (self._lam, -lin.E[:, :nc])])
        before = self._rows([(self._z[:-1], -lin.A)])
        pad = sparse.csr_matrix((lin.n, self._size))
        first = np.maximum(lin.k[:nc] * (lin.P[:nc] @ lin.start + lin.p[:nc]), 0.0)
        ends = [
            self._rows([(self._lam[:1], np.eye(nc))]),
            self._rows([(self._z[-1:], np.eye(lin.n)[lin.aimed])]),
        ]
        return sparse.vstack([now + sparse.vstack([pad, before]), *ends]), np.concatenate(
            [rest.ravel(), first, lin.goal[lin.aimed]]
        )

    def _bounds(self) -> tuple[Any, np.ndarray]:
        """Bounds of inputs and velocities as rows A x <= b."""
        lin = self._linear
        inputs = self._rows([(self._u, np.eye(lin.nu))])
        upper, lower = np.tile(lin.upper, lin.steps), np.tile(lin.lower, lin.steps)
        speeds = self._rows([(self._z[:-1], lin.P[lin.contacts :])])
        parts = [
            (inputs[np.isfinite(upper)], upper[np.isfinite(upper)]),
            (-inputs[np.isfinite(lower)], -lower[np.isfinite(lower)]),
        ]
        parts.append((speeds, -np.tile(lin.p[lin.contacts :], lin.steps - 1)))
        return sparse.vstack([part[0] for part in parts]), np.concatenate(
            [part[1] for part in parts]
        )

    @cached_property
    def _cost(self) -> tuple[Any, np.ndarray, np.ndarray, float]:
        """(F, f, g, constant): the cost is 1/2 |F x + f|^2 + g' x + constant."""
        lin, n = self._linear, self._linear.n
        values, vectors = np.linalg.eigh(lin.H)
        keep = values > 0.0
        root = np.sqrt(values[keep])[:, None] * vectors[:, keep].T  # H = root' root
        factor = self._rows([(self._u, root[:, n:])])
        states = self._rows([(self._z[:-1], root[:, :n])])
        factor = (
            factor + sparse.vstack([sparse.csr_matrix((len(root), self._size)), states])
        ).tocsr()
        offset = np.zeros(factor.shape[0])
        offset[: len(root)] = root[:, :n] @ lin.start
        slope = np.zeros(self._size)
        slope[self._u] = lin.g[n:]
        slope[self._z[:-1]] = lin.g[:n]
        return factor, offset, slope, lin.constant * lin.steps + float(lin.g[:n] @ lin.start)

    def _rows(self, parts: list[tuple[np.ndarray, np.ndarray]]) -> Any:
        """The same dense blocks at each time: columns (times, b), block (a, b) -> (times * a, size)."""
        times, height = len(parts[0][0]), len(parts[0][1])
        rows, columns, values = [], [], []
        for place, block in parts:
            i, j = np.nonzero(block)
            rows.append((height * np.arange(times)[:, None] + i).ravel())
            columns.append(place[:, j].ravel())
            values.append(np.tile(block[i, j], times))
        data = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return sparse.csr_matrix(data, shape=(times * height, self._size))


def relaxed_bound(
    linear: LinearScene, lower: np.ndarray, upper: np.ndarray, ceiling: float = np.inf
) -> float:
    """A cost below which there is no plan.

    Raises nothing: -inf where the program is not solved.

    Parameters
    ----------
    linear : the scene
    lower, upper : (steps, nc) bounds of the penetrations of all plans that cost at most the ceiling
        [m]
    ceiling : the most that plans may cost
    """
    return min(Relaxation(linear).least_cost(lower, upper), ceiling)


def _lowered(bound: float) -> float:
    return bound - SLACK * max(1.0, abs(bound)) if np.isfinite(bound) else bound


@dataclass(frozen=True)
class EnergyBound:
    """Bounds of all plans that cost at most the ceiling: penetration, approach (nc,), the largest phi [m] and abs(dphi/dt) [m/s]."""

    penetration: np.ndarray
    approach: np.ndarray


def energy_bound(scene: Scene, ceiling: float) -> EnergyBound | None:
    """The bound, or None where the scene is not of the form above."""
    d, task, nq = derive(scene), scene.task, scene.nq
    values = scene.parameter_values
    tau, states = d.tau.subs(values), [*d.q, *d.v]
    if (
        not d.structure.linear
        or not d.structure.diagonal_mass
        or tau.jacobian(d.q) != sp.zeros(nq, nq)
        or not scene.nu
    ):
        return None
    drag, inputs = -tau.jacobian(d.v), tau.jacobian(d.u)
    if not drag.is_diagonal() or any(
        entry != 0 for entry in tau.subs(dict.fromkeys([*states, *d.u], 0))
    ):
        return None
    cost = sp.expand(d.running_cost.subs(values))
    if cost.free_symbols & set(states) or sp.expand(d.final_cost) != 0:
        return None
    weight = np.array(sp.hessian(cost, list(d.u)), dtype=float) / 2.0
    rest = cost - (sp.Matrix([list(d.u)]) * sp.Matrix(weight) * sp.Matrix(list(d.u)))[0]
    if sp.expand(rest) != 0 or np.linalg.eigvalsh(weight)[0] <= 0.0:
        return None
    M, C, B = (
        np.array(matrix, dtype=float) for matrix in (d.mass_matrix.subs(values), drag, inputs)
    )
    J, k = (
        np.array(d.gap_jacobian.subs(values), dtype=float).reshape(scene.nc, nq),
        np.array(d.stiffness.subs(values), dtype=float).ravel(),
    )
    D = C - 0.5 * task.step * (C @ np.linalg.inv(M) @ C + J.T @ np.diag(k) @ J)
    if np.linalg.eigvalsh(D)[0] <= 0.0:
        return None
    root = np.linalg.inv(np.linalg.cholesky(weight))
    gain = float(np.linalg.eigvalsh(0.25 * root @ B.T @ np.linalg.inv(D) @ B @ root.T)[-1])
    v = np.array(task.start[nq:])
    phi = np.array(
        d.penetration.subs(values).subs(dict(zip(d.q, task.start[:nq], strict=True))), dtype=float
    ).ravel()
    energy = (
        0.5 * float(v @ M @ v)
        + 0.5 * float(k @ np.maximum(phi, 0.0) ** 2)
        + task.step * gain * ceiling
    )
    return EnergyBound(
        penetration=np.sqrt(2.0 * energy / k),
        approach=np.sqrt(2.0 * energy * np.einsum("ci,ij,cj->c", J, np.linalg.inv(M), J)),
    )


# of source 3 at most; three carts: the second round moves bounds by less than a hundredth of their
# width
_ROUNDS = 3
_WORTH = 0.9  # a round is followed by another if it leaves less than this part of the summed widths


@dataclass(frozen=True, kw_only=True, eq=False)
class PairBounds:
    """lower, upper (steps, nc): of phi [m], for all exact plans that cost at most `ceiling`.

    Row 0 is the start. is_empty: there are none.
    """

    lower: np.ndarray
    upper: np.ndarray
    ceiling: float
    is_empty: bool = False

    @property
    def decided(self) -> np.ndarray:
        """Mask (steps, nc) of pairs that can only be open, or only be closed [-]."""
        return (self.upper <= 0.0) | (self.lower >= 0.0)

    @property
    def is_finite(self) -> bool:
        """Whether each pair has a bound on both sides."""
        return bool(np.isfinite(self.lower).all() and np.isfinite(self.upper).all())


def physical_bounds(scene: Scene, linear: LinearScene, ceiling: float) -> PairBounds:
    """Source 1 alone; infinite where the scene is not of the form of `energy_bound`."""
    T, nc = linear.steps, linear.contacts
    lower, upper = np.full((T, nc), -np.inf), np.full((T, nc), np.inf)
    start = linear.penetration(linear.start[None])[0, :nc]
    found = energy_bound(scene, ceiling) if np.isfinite(ceiling) else None
    if found is not None:
        time = linear.step * np.arange(T)[:, None]
        lower, upper = (
            start - found.approach * time,
            np.minimum(found.penetration, start + found.approach * time),
        )
        if linear.aimed[: scene.nq].all():
            end = linear.penetration(np.nan_to_num(linear.goal)[None])[
                0, :nc
            ]  # of places alone: velocities may be free
            left = linear.step * (T - np.arange(T))[:, None]
            lower, upper = (
                np.maximum(lower, end - found.approach * left),
                np.minimum(upper, end + found.approach * left),
            )
    lower[0] = upper[0] = start
    return PairBounds(lower=lower, upper=upper, ceiling=ceiling)


def pair_bounds(
    scene: Scene,
    linear: LinearScene,
    ceiling: float = np.inf,
    *,
    is_over: Callable[[], bool] = lambda: False,
) -> PairBounds:
    """Bounds of every pair, from all three sources of the module docstring.

    Parameters
    ----------
    scene, linear : the scene, and its linear form
    ceiling : the most that plans may cost
    is_over : whether to stop; bounds not reached by then are those of physics, or infinite
    """
    relaxation = Relaxation(linear)
    bounds = physical_bounds(scene, linear, ceiling)
    width = np.inf
    for _ in range(1 + _ROUNDS):
        bounds = _swept(relaxation, bounds, is_over)
        if bounds.is_empty or is_over() or not bounds.is_finite:
            break
        before, width = width, float((bounds.upper - bounds.lower)[~bounds.decided].sum())
        if width > _WORTH * before or width == 0.0:
            break
    return bounds


def _swept(relaxation: Relaxation, bounds: PairBounds, is_over: Callable[[], bool]) -> PairBounds:
    """Every pair once, in the order of time, each with the bounds found before it."""
    lower, upper = bounds.lower.copy(), bounds.upper.copy()
    for t in range(1, len(lower)):
        for contact in range(lower.shape[1]):
            for sign, side in ((1.0, lower), (-1.0, upper)):
                if is_over():
                    return replace(bounds, lower=lower, upper=upper)
                found = relaxation.least_penetration(t, contact, sign, lower, upper, bounds.ceiling)
                if np.isneginf(found) and np.isinf(
                    side[t, contact]
                ):  # the ceiling makes the program harder; any bound will do
                    found = relaxation.least_penetration(t, contact, sign, lower, upper, np.inf)
                if np.isposinf(found):
                    return replace(bounds, lower=lower, upper=upper, is_empty=True)
                side[t, contact] = sign * max(sign * side[t, contact], found)
    return replace(bounds, lower=lower, upper=upper)
