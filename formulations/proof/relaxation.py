"""The convex relaxation of a linear scene's planning problem, and the questions it answers by Clarabel.

Each pair's graph lam = k max(phi, 0), l <= phi <= h, is replaced by its convex hull, a triangle:

    lam >= 0,    lam >= k phi,    lam <= k h+ (phi - l-) / (h+ - l-),      l- = min(l, 0), h+ = max(h, 0)

so that every exact plan whose penetrations keep their bounds is one of the relaxation, and a pair with l = 0 or h = 0 is exact. Unknowns by
time: u[t], lam[t], z[t+1]. Rows with an infinite bound are left out.

Clarabel's bound is the objective of its dual point, with duals feasible to 1e-8: it is lowered by `SLACK` of its size before it is believed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sp

from formulations.contact_modes.linear import LinearScene

SLACK = 1e-6  # relative, and absolute for bounds below 1: a hundred times Clarabel's own tolerance


@dataclass(frozen=True)
class RelaxationResult:
    """status: "solved", "infeasible" or "unfinished"; bound: of the minimum from below, lowered by SLACK (-inf if unfinished)."""

    status: str
    bound: float


class Relaxation:
    """The relaxation as matrices; its questions take bounds of phi [m], lower and upper (steps, nc), whose row 0 belongs to the start and is not used."""

    def __init__(self, linear: LinearScene) -> None:
        self._linear = linear
        lin, T = linear, linear.steps
        n, nu, nc = lin.n, lin.nu, lin.contacts
        block = (nu + nc + n) * np.arange(T)[:, None]
        self._u, self._lam, self._z = block + np.arange(nu), block + nu + np.arange(nc), block + nu + nc + np.arange(n)
        self._size = T * (nu + nc + n)
        self._penetration = self._rows([(self._z[:-1], lin.P[:nc])])
        self._force = self._rows([(self._lam[1:], np.eye(nc))])
        self._k, self._offset = np.tile(lin.k[:nc], T - 1), np.tile(lin.p[:nc], T - 1)
        self._equalities = self._dynamics()
        self._always = self._bounds()

    def least_cost(self, lower: np.ndarray, upper: np.ndarray) -> RelaxationResult:
        """A lower bound of the cost.

        Raises nothing: -inf where the program is not solved.

        Parameters
        ----------
        lower, upper : (steps, nc) bounds of the penetrations [m]
        """
        factor, offset, linear_part, constant = self._cost
        quadratic = sp.triu(factor.T @ factor).tocsc()
        constant += 0.5 * float(offset @ offset)
        answer = self._solve(quadratic, linear_part + factor.T @ offset, lower, upper, [], [])
        return RelaxationResult(answer.status, _lowered(answer.bound + constant))

    def least_penetration(
        self, t: int, contact: int, sign: float, lower: np.ndarray, upper: np.ndarray, ceiling: float
    ) -> RelaxationResult:
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
            factor, offset, linear_part, constant = self._cost  # |factor x + offset|^2 <= room - 2 linear_part' x =: r
            room = 2.0 * (ceiling - constant)
            slope = sp.csr_matrix(linear_part)  # |(factor x + offset, (1 - r)/2)| <= (1 + r)/2
            rows = [(sp.vstack([slope, -slope, -factor]), np.concatenate([[0.5 * (1.0 + room), 0.5 * (1.0 - room)], offset]))]
            cones = [clarabel.SecondOrderConeT(2 + len(offset))]
        answer = self._solve(sp.csc_matrix((self._size, self._size)), objective, lower, upper, rows, cones)
        return RelaxationResult(answer.status, _lowered(answer.bound + sign * self._offset[row]))

    def _solve(
        self, quadratic: Any, objective: np.ndarray, lower: np.ndarray, upper: np.ndarray, rows: list, cones: list
    ) -> RelaxationResult:
        left, right = self._equalities
        inner = [self._always, *self._hull(lower[1:].ravel(), upper[1:].ravel())]
        matrix = sp.vstack([left, *(part[0] for part in inner), *(part[0] for part in rows)]).tocsc()
        vector = np.concatenate([right, *(part[1] for part in inner), *(part[1] for part in rows)])
        nonnegative = sum(len(part[1]) for part in inner)
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        kinds = [clarabel.ZeroConeT(len(right)), clarabel.NonnegativeConeT(nonnegative), *cones]
        found = clarabel.DefaultSolver(quadratic, objective, matrix, vector, kinds, settings).solve()
        status = str(found.status)
        if status == "PrimalInfeasible":
            return RelaxationResult("infeasible", np.inf)
        if status != "Solved":
            return RelaxationResult("unfinished", -np.inf)
        return RelaxationResult("solved", float(found.obj_val_dual))

    def _hull(self, lower: np.ndarray, upper: np.ndarray) -> list[tuple[Any, np.ndarray]]:
        """Rows A x <= b of the triangles and of the bounds themselves."""
        phi, force, k, offset = self._penetration, self._force, self._k, self._offset
        found = [(-force, np.zeros(len(k))), (sp.diags(k) @ phi - force, -k * offset)]
        for matrix, bound, keep in ((phi, upper - offset, np.isfinite(upper)), (-phi, offset - lower, np.isfinite(lower))):
            found.append((matrix[keep], bound[keep]))
        keep = np.isfinite(upper) & np.isfinite(lower)
        low, high = np.minimum(lower[keep], 0.0), np.maximum(upper[keep], 0.0)
        width = high - low
        chord = k[keep] * np.divide(high, width, out=np.ones_like(width), where=width > 0.0)
        found.append((force[keep] - sp.diags(chord) @ phi[keep], chord * (offset[keep] - low)))
        return found

    def _dynamics(self) -> tuple[Any, np.ndarray]:
        """z[t+1] = A z[t] + B u[t] + c + E lam[t], the forces of the start, and what is given of the end."""
        lin, nc = self._linear, self._linear.contacts
        rest = np.tile(lin.c, (lin.steps, 1))
        rest[0] += lin.A @ lin.start
        now = self._rows([(self._z, np.eye(lin.n)), (self._u, -lin.B), (self._lam, -lin.E[:, :nc])])
        before = self._rows([(self._z[:-1], -lin.A)])
        pad = sp.csr_matrix((lin.n, self._size))
        first = np.maximum(lin.k[:nc] * (lin.P[:nc] @ lin.start + lin.p[:nc]), 0.0)
        ends = [self._rows([(self._lam[:1], np.eye(nc))]), self._rows([(self._z[-1:], np.eye(lin.n)[lin.aimed])])]
        return sp.vstack([now + sp.vstack([pad, before]), *ends]), np.concatenate([rest.ravel(), first, lin.goal[lin.aimed]])

    def _bounds(self) -> tuple[Any, np.ndarray]:
        """Bounds of inputs and velocities as rows A x <= b."""
        lin = self._linear
        inputs = self._rows([(self._u, np.eye(lin.nu))])
        upper, lower = np.tile(lin.upper, lin.steps), np.tile(lin.lower, lin.steps)
        speeds = self._rows([(self._z[:-1], lin.P[lin.contacts :])])
        parts = [(inputs[np.isfinite(upper)], upper[np.isfinite(upper)]), (-inputs[np.isfinite(lower)], -lower[np.isfinite(lower)])]
        parts.append((speeds, -np.tile(lin.p[lin.contacts :], lin.steps - 1)))
        return sp.vstack([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    @cached_property
    def _cost(self) -> tuple[Any, np.ndarray, np.ndarray, float]:
        """(F, f, g, constant): the cost is 1/2 |F x + f|^2 + g' x + constant."""
        lin, n = self._linear, self._linear.n
        values, vectors = np.linalg.eigh(lin.H)
        keep = values > 0.0
        root = np.sqrt(values[keep])[:, None] * vectors[:, keep].T  # H = root' root
        factor = self._rows([(self._u, root[:, n:])])
        states = self._rows([(self._z[:-1], root[:, :n])])
        factor = (factor + sp.vstack([sp.csr_matrix((len(root), self._size)), states])).tocsr()
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
        return sp.csr_matrix(data, shape=(times * height, self._size))


def relaxed_bound(linear: LinearScene, lower: np.ndarray, upper: np.ndarray, ceiling: float = np.inf) -> float:
    """A cost below which there is no plan.

    Raises nothing: -inf where the program is not solved.

    Parameters
    ----------
    linear : the scene
    lower, upper : (steps, nc) bounds of the penetrations of all plans that cost at most the ceiling [m]
    ceiling : the most that plans may cost
    """
    answer = Relaxation(linear).least_cost(lower, upper)
    return min(answer.bound, ceiling)


def _lowered(bound: float) -> float:
    return bound - SLACK * max(1.0, abs(bound)) if np.isfinite(bound) else bound
