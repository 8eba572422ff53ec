"""The seam between this package and an Ipopt: a back end is anything with `name`, `version()`, `available()` and `run(...)`.

cyipopt is the one we require. Another wrapper of Ipopt (some are built on a faster linear algebra) fits here by one class and an entry in
`BACKENDS`; what ran is named in every result.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.evaluations import Evaluations
from formulations.ipopt.problem import IpoptProblem


@dataclass(frozen=True, kw_only=True)
class Start:
    """x (n,); multipliers lagrange (m,), zl, zu (n,) in Ipopt's signs, or None for a primal start."""

    x: np.ndarray
    lagrange: np.ndarray | None = None
    zl: np.ndarray | None = None
    zu: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Where a back end ended: Ipopt's status code and message, the point and its multipliers in Ipopt's signs."""

    status: int
    message: str
    x: np.ndarray
    lagrange: np.ndarray
    zl: np.ndarray
    zu: np.ndarray


# (alg_mod, iteration, objective, inf_pr, inf_du, mu, d_norm, regularization, alpha_du, alpha_pr, trials) -> go on?
Intermediate = Callable[..., bool]


class Backend(Protocol):
    name: str

    def available(self) -> bool: ...

    def version(self) -> str: ...

    @property
    def evaluation_error(self) -> type[Exception]: ...

    def run(
        self,
        problem: IpoptProblem,
        functions: Evaluations,
        start: Start,
        options: Mapping[str, str | int | float],
        intermediate: Intermediate,
    ) -> Answer: ...


class Cyipopt:
    """Ipopt through cyipopt."""

    name = "cyipopt"

    def available(self) -> bool:
        return importlib.util.find_spec("cyipopt") is not None

    def version(self) -> str:
        import cyipopt

        return f"cyipopt {cyipopt.__version__}, Ipopt {'.'.join(str(part) for part in cyipopt.IPOPT_VERSION)}"

    @property
    def evaluation_error(self) -> type[Exception]:
        from cyipopt import CyIpoptEvaluationError

        return CyIpoptEvaluationError

    def run(self, problem, functions, start, options, intermediate) -> Answer:
        import cyipopt

        callbacks = _Callbacks(functions, intermediate)
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

    def __init__(self, functions: Evaluations, intermediate: Intermediate) -> None:
        self.objective = functions.objective
        self.gradient = functions.gradient
        self.constraints = functions.constraints
        self.jacobian = functions.jacobian
        self.jacobianstructure = functions.jacobianstructure
        self.hessian = functions.hessian
        self.hessianstructure = functions.hessianstructure
        self.intermediate = intermediate


BACKENDS: tuple[Backend, ...] = (Cyipopt(),)


def default_backend() -> Backend:
    """The first installed back end."""
    for backend in BACKENDS:
        if backend.available():
            return backend
    raise ModuleNotFoundError("no Ipopt back end is installed: pip install cyipopt-wheels")
