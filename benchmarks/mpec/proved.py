"""The global optimum of an MPEC with linear rows and a convex quadratic objective: a tree of convex programs, each with fewer pairs left to decide.

    found = prove(model)            # None if the model is not of that kind
    # no point of the model has a lower objective (higher, where it is maximised)
    found.bound, found.complete

It shares no code with `mpec_ipopt`: rows by Pyomo's standard form, programs by Clarabel, bounds
from their dual objectives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import process_time
from typing import Any

import clarabel
import numpy as np
import pyomo.environ as pyo
import scipy.sparse as sparse
from pyomo.mpec import Complementarity
from pyomo.repn import generate_standard_repn

# A pair counts as decided where one of its sides is below this, relative to max(1, the other);
# bounds this near to the best point are not improved on.
_DECIDED = 1e-7
_NEAR = 1e-7
# Eigenvalues of a convex objective may be this negative, relative to the largest.
_CONVEX = 1e-10


@dataclass(frozen=True, kw_only=True)
class GlobalBound:
    """bound: by the dual objectives of all open leaves.

    best: lowest objective of a point in which all pairs are decided; both in the model's own sense.
    """

    bound: float
    best: float
    complete: bool
    programs: int


class _OtherKindError(Exception):
    pass


class _Rows:
    """A model's linear parts, by the numbers of its variables."""

    def __init__(self, model: Any) -> None:
        self.variables = [v for v in model.component_data_objects(pyo.Var) if not v.fixed]
        self._place = {id(v): k for k, v in enumerate(self.variables)}
        n = len(self.variables)
        (objective,) = list(model.component_data_objects(pyo.Objective, active=True)) or [None]
        self.sense = 1.0 if objective is None or objective.sense == pyo.minimize else -1.0
        self.hessian, self.slope, self.constant = np.zeros((n, n)), np.zeros(n), 0.0
        if objective is not None:
            form = generate_standard_repn(objective.expr, quadratic=True)
            if form.nonlinear_expr is not None:
                raise _OtherKindError
            self.slope, self.constant = self._vector(form), float(form.constant)
            for (a, b), factor in zip(form.quadratic_vars, form.quadratic_coefs, strict=True):
                for i, j in ((a, b), (b, a)):
                    self.hessian[self._place[id(i)], self._place[id(j)]] += factor
        self.hessian, self.slope = self.sense * self.hessian, self.sense * self.slope
        values = np.linalg.eigvalsh(self.hessian)
        if values[0] < -_CONVEX * max(1.0, values[-1]):
            raise _OtherKindError
        self.equal: list[tuple[np.ndarray, float]] = []
        self.least: list[tuple[np.ndarray, float]] = []  # a x >= b
        for row in model.component_data_objects(pyo.Constraint, active=True):
            self._add(row.body, row.lower, row.upper)
        for k, v in enumerate(self.variables):
            unit = np.zeros(n)
            unit[k] = 1.0
            self.least += [(unit, v.lb)] if v.lb is not None else []
            self.least += [(-unit, -v.ub)] if v.ub is not None else []
        self.pairs: list[
            tuple[tuple[np.ndarray, float], tuple[np.ndarray, float]]
        ] = []  # both a x + b >= 0, one of them 0
        for data in model.component_data_objects(Complementarity, active=True):
            self._pair(*(self._relation(side) for side in data._args))

    def _vector(self, form: Any) -> np.ndarray:
        found = np.zeros(len(self.variables))
        for v, factor in zip(form.linear_vars, form.linear_coefs, strict=True):
            found[self._place[id(v)]] += factor
        return found

    def linear(self, expression: Any) -> tuple[np.ndarray, float]:
        form = generate_standard_repn(expression, quadratic=False)
        if form.nonlinear_expr is not None:
            raise _OtherKindError
        return self._vector(form), float(pyo.value(form.constant))

    def _add(self, body: Any, lower: Any, upper: Any) -> None:
        a, b = self.linear(body)
        low, high = (
            None if bound is None else float(pyo.value(bound)) - b for bound in (lower, upper)
        )
        if low is not None and low == high:
            self.equal.append((a, low))
            return
        self.least += [(a, low)] if low is not None else []
        self.least += [(-a, -high)] if high is not None else []

    def _relation(self, side: Any) -> tuple[Any, Any, Any]:
        """(lower, body, upper); the kinds that `read_nl` and MacMPEC's models use."""
        if not side.is_expression_type() or not hasattr(side, "strict"):
            return None, side, None
        if len(side.args) == 3:
            return side.args
        low, high = side.args
        return 0.0, high - low, None

    def _pair(self, first: tuple[Any, Any, Any], second: tuple[Any, Any, Any]) -> None:
        if (
            first[0] is not None
            and first[2] is None
            and second[0] is not None
            and second[2] is None
        ):
            (a, b), (c, d) = self.linear(first[1]), self.linear(second[1])
            self.pairs.append(
                ((a, b - float(pyo.value(first[0]))), (c, d - float(pyo.value(second[0]))))
            )
            self.least += [(a, -b) for a, b in self.pairs[-1]]
            return
        raise _OtherKindError  # boxes are two choices of three: not needed for the sets at hand


def prove(model: Any, *, best: float = math.inf, seconds: float = 20.0) -> GlobalBound | None:
    """Bound the objective, from its best known value on.

    Parameters
    ----------
    model : a Pyomo model
    best : objective of a feasible point, in the model's own sense
    seconds : CPU time after which what is open stays open
    """
    try:
        rows = _Rows(model)
    except _OtherKindError:
        return None
    began, programs = process_time(), _Programs(rows)
    upper = rows.sense * (best - rows.constant) if math.isfinite(best) else math.inf
    open_bounds: list[float] = []
    closed = math.inf  # lowest bound of a leaf that is settled
    todo: list[tuple[dict[int, int], float]] = [({}, -math.inf)]
    while todo:
        decided, known = todo.pop()
        if known >= upper - _NEAR * max(1.0, abs(upper)):
            closed = min(closed, known)
        elif process_time() - began > seconds:
            open_bounds.append(known)
        else:
            answer = programs.solve(decided)
            status = str(answer.status)
            if status == "PrimalInfeasible":
                continue
            left = [k for k in range(len(rows.pairs)) if k not in decided]
            if (
                status != "Solved"
            ):  # unbounded, or without an answer: nothing is known of it but what was known above it
                if not left:
                    open_bounds.append(known)
                else:
                    todo += [({**decided, left[0]: side}, known) for side in (0, 1)]
                continue
            bound, sides = max(known, answer.obj_val_dual), programs.sides(np.array(answer.x))
            least = sides.min(axis=1)[left]
            if not left or least.max() <= _DECIDED:
                upper, closed = min(upper, answer.obj_val), min(closed, bound)
                continue
            chosen = left[int(least.argmax())]
            nearer = int(sides[chosen, 1] < sides[chosen, 0])
            todo += [
                ({**decided, chosen: side}, bound) for side in (1 - nearer, nearer)
            ]  # the last is taken first
    return GlobalBound(
        bound=rows.sense * min([closed, upper, *open_bounds]) + rows.constant,
        best=rows.sense * upper + rows.constant,
        complete=not open_bounds,
        programs=programs.count,
    )


class _Programs:
    """The convex programs of one model: all rows, and the decided sides of pairs as equations."""

    def __init__(self, rows: _Rows) -> None:
        self._rows, self.count = rows, 0
        self._hessian = sparse.csc_matrix(np.triu(rows.hessian))
        n = len(rows.variables)
        self._equal, self._least = (
            sparse.csr_matrix(np.array([a for a, _ in part]).reshape(-1, n))
            for part in (rows.equal, rows.least)
        )
        self._equal_limits, self._least_limits = (
            np.array([b for _, b in part]) for part in (rows.equal, rows.least)
        )
        self._sides = sparse.csr_matrix(
            np.array([a for pair in rows.pairs for a, _ in pair]).reshape(-1, n)
        )
        self._offsets = np.array([b for pair in rows.pairs for _, b in pair])
        self._settings = clarabel.DefaultSettings()
        self._settings.verbose = False

    def solve(self, decided: dict[int, int]) -> Any:
        self.count += 1
        held = [2 * k + side for k, side in decided.items()]
        matrix = sparse.vstack([self._equal, self._sides[held], -self._least], format="csc")
        limits = np.concatenate([self._equal_limits, -self._offsets[held], -self._least_limits])
        cones = [
            clarabel.ZeroConeT(len(self._equal_limits) + len(held)),
            clarabel.NonnegativeConeT(len(self._least_limits)),
        ]
        return clarabel.DefaultSolver(
            self._hessian, self._rows.slope, matrix, limits, cones, self._settings
        ).solve()

    def sides(self, x: np.ndarray) -> np.ndarray:
        """(pairs, 2) values of both sides."""
        return (self._sides @ x + self._offsets).reshape(-1, 2)
