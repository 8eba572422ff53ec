"""Ipopt through cyipopt: the back end that must work wherever touchstone is installed."""

from __future__ import annotations

import importlib.util
from functools import cache

import numpy as np

from formulations.ipopt.backend import Answer
from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.evaluations import Evaluations
from formulations.ipopt.guard import Guard
from formulations.ipopt.linear_solver import LDLT, available, ldlt_library


class Cyipopt:
    """Ipopt through cyipopt."""

    name = "cyipopt"

    def available(self) -> bool:
        return importlib.util.find_spec("cyipopt") is not None

    def ipopt_version(self) -> tuple[int, ...]:
        import cyipopt

        return tuple(int(part) for part in cyipopt.IPOPT_VERSION)

    def version(self) -> str:
        import cyipopt

        return f"cyipopt {cyipopt.__version__}, Ipopt {'.'.join(str(part) for part in self.ipopt_version())}"

    def knows(self, option: str) -> bool:
        return True  # `options.known_options` is the list of its Ipopt

    def takes_ldlt(self) -> bool:
        return available() and _loads_solvers()

    @property
    def evaluation_error(self) -> type[Exception]:
        from cyipopt import CyIpoptEvaluationError

        return CyIpoptEvaluationError

    def run(self, problem, functions, start, options, intermediate) -> Answer:
        import cyipopt

        guard = Guard(intermediate, self.evaluation_error)
        callbacks = _Callbacks(functions, guard)
        nlp = cyipopt.Problem(
            n=problem.n,
            m=problem.m,
            problem_obj=callbacks,
            lb=problem.lower,
            ub=problem.upper,
            cl=problem.constraint_lower,
            cu=problem.constraint_upper,
        )
        try:
            for name, value in options.items():
                for part, setting in _settings(name, value):
                    _set_option(nlp, part, setting)
            duals = {} if start.lagrange is None else {"lagrange": start.lagrange, "zl": start.zl, "zu": start.zu}
            x, info = nlp.solve(start.x, **duals)
        finally:
            nlp.close()
        guard.raise_kept()
        message = info["status_msg"]
        return Answer(
            status=int(info["status"]),
            message=message.decode("utf-8", "replace") if isinstance(message, bytes) else str(message),
            x=np.array(x, dtype=float),
            lagrange=np.array(info["mult_g"], dtype=float).reshape(problem.m),
            zl=np.array(info["mult_x_L"], dtype=float),
            zu=np.array(info["mult_x_U"], dtype=float),
        )


def _settings(name: str, value: str | int | float) -> tuple[tuple[str, str | int | float], ...]:
    """Our factorisation stands behind the calls of MA27."""
    if name == "linear_solver" and value == LDLT:
        return (("hsllib", str(ldlt_library())), ("linear_solver", "ma27"))
    return ((name, value),)


@cache
def _loads_solvers() -> bool:
    """Whether this Ipopt was built to load linear solvers at run time, as those of the wheels are."""
    import cyipopt

    nlp = cyipopt.Problem(1, 0, _Nothing(), [0.0], [1.0])
    try:
        nlp.add_option("hsllib", str(ldlt_library()))
        nlp.add_option("linear_solver", "ma27")
    except TypeError:
        return False
    finally:
        nlp.close()
    return True


class _Nothing:
    """A problem that is never solved."""

    def objective(self, x: np.ndarray) -> float:
        return 0.0

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return 0.0 * x


def _set_option(nlp, name: str, value: str | int | float) -> None:
    try:
        nlp.add_option(name, value)
    except TypeError as error:
        raise UnknownOptionError(f"Ipopt does not accept {value!r} for the option '{name}'") from error


class _Callbacks:
    """The attributes cyipopt looks for."""

    def __init__(self, functions: Evaluations, guard: Guard) -> None:
        self.objective = guard.function(functions.objective)
        self.gradient = guard.function(functions.gradient)
        self.constraints = guard.function(functions.constraints)
        self.jacobian = guard.function(functions.jacobian)
        self.jacobianstructure = functions.jacobianstructure
        self.hessian = guard.function(functions.hessian)
        self.hessianstructure = functions.hessianstructure
        self.intermediate = guard.intermediate
