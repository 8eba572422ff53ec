"""Ipopt through cyipopt: the back end that must work wherever touchstone is installed."""

from __future__ import annotations

import importlib.util

import numpy as np

from formulations.ipopt.backend import Answer
from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.evaluations import Evaluations
from formulations.ipopt.guard import Guard


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
                _set_option(nlp, name, value)
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
