"""Ipopt through ipyopt: an older Ipopt (3.12) whose MUMPS is three to four times faster on banded problems.

Measured with MUMPS on `three_cart`, T = 500, strict complementarity after softplus collocation: 118 iterations in 4.7 CPU s with cyipopt, 110 in
1.2 with this one, the same optimum to 1e-13 - the MUMPS in its wheel amalgamates the elimination tree, the other one does not. With our own
factorisation (`linear_solver`) the two are nearly equal.

ipyopt knows no wall-time limit and no way to say that a point cannot be evaluated but NaN; `Guard` and the adapters below see to both.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np

from formulations.ipopt.backend import Answer, Intermediate, Start
from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.evaluations import Evaluations
from formulations.ipopt.guard import Guard
from formulations.ipopt.linear_solver import LDLT, available, hand_to
from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.status import STATUS_NAMES

_USER_STOP, _TIME_LIMIT = 5, -5
_MA27 = "ma27"  # whose calls our factorisation stands behind


class NotFiniteError(ArithmeticError):
    """A function or derivative is not a finite number at this point."""


@cache
def _known_options() -> frozenset[str]:
    import ipyopt

    return frozenset(option["name"] for option in ipyopt.get_ipopt_options())


class Ipyopt:
    """See the module docstring."""

    name = "ipyopt"
    evaluation_error: type[Exception] = NotFiniteError

    def available(self) -> bool:
        return importlib.util.find_spec("ipyopt") is not None

    def ipopt_version(self) -> tuple[int, ...]:
        return (3, 12, 12)  # what the wheels of ipyopt 0.12 carry; the package itself does not tell

    def version(self) -> str:
        return f"ipyopt {version('ipyopt')}, Ipopt {'.'.join(str(part) for part in self.ipopt_version())}"

    def knows(self, option: str) -> bool:
        # The time limit is kept by the guard below; the file of options is never read (its name is set empty).
        return option in {"max_wall_time", "option_file_name"} or option in _known_options()

    def takes_ldlt(self) -> bool:
        import ipyopt.ipyopt

        return available() and hand_to(str(ipyopt.ipyopt.__file__))

    def run(
        self,
        problem: IpoptProblem,
        functions: Evaluations,
        start: Start,
        options: Mapping[str, str | int | float],
        intermediate: Intermediate,
    ) -> Answer:
        import ipyopt

        limit = options.get("max_wall_time")
        guard = Guard(intermediate, NotFiniteError, None if limit is None else float(limit))
        nlp = ipyopt.Problem(
            problem.n,
            _floats(problem.lower),
            _floats(problem.upper),
            problem.m,
            _floats(problem.constraint_lower),
            _floats(problem.constraint_upper),
            _pattern(functions.jacobianstructure()),
            _pattern(functions.hessianstructure()),
            _number(guard.function(functions.objective)),
            _array(guard.function(functions.gradient)),
            _array(guard.function(functions.constraints)),
            _array(guard.function(functions.jacobian)),
            _array(guard.function(functions.hessian)),
            guard.intermediate,
        )
        # A derivative that is not finite must end the solve, not reach the factorisation.
        for name, value in {"check_derivatives_for_naninf": "yes", **options}.items():
            if name == "linear_solver" and value == LDLT:
                value = _MA27
            if name != "max_wall_time":
                _set_option(nlp, name, value)
        x = _floats(start.x)
        lagrange = np.zeros(problem.m) if start.lagrange is None else _floats(start.lagrange)
        zl = np.zeros(problem.n) if start.zl is None else _floats(start.zl)
        zu = np.zeros(problem.n) if start.zu is None else _floats(start.zu)
        x, _, status = nlp.solve(x, mult_g=lagrange, mult_x_L=zl, mult_x_U=zu)
        guard.raise_kept()
        if status == _USER_STOP and guard.out_of_time:
            status = _TIME_LIMIT
        message = STATUS_NAMES.get(int(status), f"unknown status {status}")
        return Answer(status=int(status), message=message, x=x, lagrange=lagrange, zl=zl, zu=zu)


def _set_option(nlp: Any, name: str, value: str | int | float) -> None:
    try:
        nlp.set(**{name: value})
    except (ValueError, TypeError) as error:
        raise UnknownOptionError(f"Ipopt does not accept {value!r} for the option '{name}'") from error


def _floats(values: np.ndarray) -> np.ndarray:
    """A contiguous copy of its own: ipyopt writes into what it is given."""
    return np.array(values, dtype=float, order="C")


def _pattern(structure: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = structure
    return np.ascontiguousarray(rows), np.ascontiguousarray(columns)


def _number(function: Callable[..., float]) -> Callable[..., float]:
    """A function value; NaN where it cannot be evaluated, at which Ipopt cuts the step."""

    def call(*arguments: np.ndarray) -> float:
        try:
            return float(function(*arguments))
        except NotFiniteError:
            return float("nan")

    return call


def _array(function: Callable[..., np.ndarray]) -> Callable[..., None]:
    """A vector written into the last argument; NaN where it cannot be evaluated."""

    def call(*arguments: Any) -> None:
        *given, out = arguments
        try:
            out[:] = function(*given)
        except NotFiniteError:
            out.fill(np.nan)

    return call
