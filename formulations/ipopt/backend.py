"""The seam between this package and an Ipopt: a back end is anything with `name`, `version()`, `available()` and `run(...)`.

cyipopt is the one we require. Another wrapper of Ipopt fits here by one class and an entry in `backends`, which lists them fastest first;
what ran is named in every result.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.evaluations import Evaluations
from formulations.ipopt.guard import Guard
from formulations.ipopt.problem import IpoptProblem
from models.errors import MachineError


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

    def ipopt_version(self) -> tuple[int, ...]: ...

    def version(self) -> str: ...

    def knows(self, option: str) -> bool:
        """Whether its Ipopt has an option of that name."""
        ...

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


def backends() -> tuple[Backend, ...]:
    """All back ends, fastest first."""
    from formulations.ipopt.backend_ipyopt import Ipyopt

    return (Ipyopt(), Cyipopt())


def default_backend(options: Iterable[str] = ()) -> Backend:
    """The fastest installed back end that knows all these options; $TOUCHSTONE_IPOPT names one to insist on.

    Raises MachineError if there is none.
    """
    wanted = os.environ.get("TOUCHSTONE_IPOPT", "")
    names = tuple(options)
    for backend in backends():
        if wanted in ("", backend.name) and backend.available() and all(backend.knows(name) for name in names):
            return backend
    if wanted:
        known = ", ".join(backend.name for backend in backends())
        raise MachineError(
            f"the environment variable TOUCHSTONE_IPOPT asks for {wanted!r}, which is not installed or lacks an option; there are {known}."
        )
    raise MachineError("no Ipopt is installed; install it with: pip install cyipopt-wheels==1.7.0.dev0")
