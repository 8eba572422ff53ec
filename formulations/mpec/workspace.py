"""Numbers of one solve: the compiled relaxation, the compiled problem without products, and the columns of the pairs in both."""

from __future__ import annotations

from typing import Any

import numpy as np

from formulations.ipopt import IpoptProblem, compile_model
from formulations.ipopt.errors import MissingValueError
from formulations.mpec.lifted import Lifted
from formulations.mpec.strategies import Strategy


class Columns:
    """Where things are in a compiled problem.

    first[k], second[k]: columns of pair k; twin[k]: the column of the user's variable which first[k] equals, or -1; twin_row[k]: the row that says so
    """

    def __init__(self, problem: IpoptProblem, lifted: Lifted) -> None:
        self.problem = problem
        self.place = {id(variable): column for column, variable in enumerate(problem.variables)}
        self.first = np.array([self.place[id(v)] for v in lifted.firsts], dtype=np.intp)
        self.second = np.array([self.place[id(w)] for w in lifted.seconds], dtype=np.intp)
        self.twin = np.array([-1 if u is None else self.place[id(u)] for u in lifted.twins], dtype=np.intp)
        row = {id(equation): number for number, equation in enumerate(problem.equations)}
        self.twin_row = np.array([row[id(pair.ve)] for pair in lifted.pairs], dtype=np.intp)

    def pair_values(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both sides v, w (pairs,) of all pairs at x (n,) [units of the sides]."""
        return x[self.first], x[self.second]


def natural_residual(first: np.ndarray, second: np.ndarray) -> float:
    """Largest |min(v, w)| of a pair, 0 without pairs.

    Parameters
    ----------
    first, second : (pairs,) values of the two sides [units of the sides]
    """
    return float(np.max(np.abs(np.minimum(first, second)))) if first.size else 0.0


class Workspace:
    """Compiled once per strategy; only numbers change afterwards."""

    def __init__(self, lifted: Lifted, strategy: Strategy) -> None:
        self.lifted = lifted
        self.branches = _compile_branches(lifted)
        problem = self.branches.problem
        self.branch_bounds = (problem.lower.copy(), problem.upper.copy(), problem.constraint_lower.copy(), problem.constraint_upper.copy())
        self._strategy = strategy
        strategy.attach(lifted)
        self.relaxed = Columns(compile_model(lifted.shadow), lifted)
        known = self.relaxed.place
        self._to_branch = np.array([known.get(id(variable), -1) for variable in self.branches.problem.variables], dtype=np.intp)

    def set(self, eps: float) -> None:
        """Move the relaxation to eps."""
        self._strategy.set(self.lifted, eps)
        self.relaxed.problem.refresh(check=False)

    def start(self) -> np.ndarray:
        """The user's values in the relaxation's columns; every slack at the value that its own equation asks for, at least its bound.

        Returns
        -------
        (n,) point of the relaxation [units of the variables]

        Raises
        ------
        MissingValueError
            where a variable starts at a number that is not finite
        """
        problem = self.relaxed.problem
        x, _ = problem.start()
        for k in np.flatnonzero(~np.isfinite(x)):
            raise MissingValueError(f"variable '{problem.variables[k].name}' starts at {x[k]}: give it a finite value, or none")
        settle(problem, x, self._slacks())
        return x

    def branch_point(self, x: np.ndarray) -> np.ndarray:
        """A point of the relaxation (n,) in the columns of the problem without products (columns,) [units of the variables]."""
        point = np.zeros(self.branches.problem.n)
        known = self._to_branch >= 0
        point[known] = x[self._to_branch[known]]
        return point

    def _slacks(self) -> list[Any]:
        return [*self.lifted.shadow.slack.values(), *self.lifted.firsts]


def settle(problem: IpoptProblem, x: np.ndarray, slacks: list[Any]) -> None:
    """Give each slack the value that makes its defining row hold, within its bounds.

    The row is an equality that no slack of a later pair enters.

    Parameters
    ----------
    problem : the compiled problem
    x : (n,) point, changed in place [units of the variables]
    slacks : Pyomo variables
    """
    place = {id(variable): column for column, variable in enumerate(problem.variables)}
    columns = np.array([place[id(s)] for s in slacks if id(s) in place], dtype=np.intp)
    if not columns.size:
        return
    x[columns] = np.clip(0.0, problem.lower[columns], problem.upper[columns])
    rows, entries = problem.jacobianstructure()
    for _ in range(2):  # slacks of user expressions first, then v == expression, which may hold such a slack
        values, slopes = problem.constraints(x), problem.jacobian(x)
        is_equality = problem.constraint_lower == problem.constraint_upper
        wanted = np.full(problem.n, np.nan)
        pick = np.isin(entries, columns) & is_equality[rows] & (slopes != 0.0)
        with np.errstate(all="ignore"):
            wanted[entries[pick]] = x[entries[pick]] + (problem.constraint_lower[rows[pick]] - values[rows[pick]]) / slopes[pick]
        chosen = np.where(np.isfinite(wanted[columns]), wanted[columns], x[columns])
        x[columns] = np.clip(chosen, problem.lower[columns], problem.upper[columns])


def _compile_branches(lifted: Lifted) -> Columns:
    """The problem without products. A side that stands nowhere else keeps its row w >= 0, so that it has a column."""
    lifted.products(active=False)
    problem = compile_model(lifted.shadow)
    present = {id(variable) for variable in problem.variables}
    lonely = [pair for pair, second in zip(lifted.pairs, lifted.seconds, strict=True) if id(second) not in present]
    if lonely:
        for pair in lonely:
            pair.c.activate()
        problem = compile_model(lifted.shadow)
        for pair in lonely:
            pair.c.deactivate()
    lifted.products(active=True)
    return Columns(problem, lifted)
