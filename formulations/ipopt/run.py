"""One run of Ipopt, through cyipopt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cyipopt
import numpy as np

from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.evaluations import Evaluations
from formulations.ipopt.linear_solver import settings
from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.warm_start import Start


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Where Ipopt ended: its status code, the point and its multipliers in Ipopt's signs; a message only where Ipopt was not needed."""

    status: int
    message: str = ""
    x: np.ndarray
    lagrange: np.ndarray
    zl: np.ndarray
    zu: np.ndarray


def ipopt_version() -> tuple[int, ...]:
    return tuple(int(part) for part in cyipopt.IPOPT_VERSION)


def version() -> str:
    return f"cyipopt {cyipopt.__version__}, Ipopt {'.'.join(str(part) for part in ipopt_version())}"


def run(problem: IpoptProblem, functions: Evaluations, start: Start, options: Mapping[str, str | int | float]) -> Answer:
    """Raises UnknownOptionError for a value that Ipopt does not take, and what a callback raised, as it was."""
    nlp = cyipopt.Problem(
        n=problem.n,
        m=problem.m,
        problem_obj=functions,
        lb=problem.lower,
        ub=problem.upper,
        cl=problem.constraint_lower,
        cu=problem.constraint_upper,
    )
    try:
        for name, value in options.items():
            for part, setting in settings(name, value):
                try:
                    nlp.add_option(part, setting)
                except TypeError as error:
                    raise UnknownOptionError(f"Ipopt does not accept {value!r} for the option '{name}'") from error
        duals = {} if start.lagrange is None else {"lagrange": start.lagrange, "zl": start.zl, "zu": start.zu}
        x, info = nlp.solve(start.x, **duals)
    finally:
        nlp.close()
    if functions.error is not None:
        raise functions.error
    return Answer(
        status=int(info["status"]),
        x=np.array(x, dtype=float),
        lagrange=np.array(info["mult_g"], dtype=float).reshape(problem.m),
        zl=np.array(info["mult_x_L"], dtype=float),
        zu=np.array(info["mult_x_U"], dtype=float),
    )
