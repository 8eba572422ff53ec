"""The seam between this package and an Ipopt: a back end is anything with `name`, `version()`, `available()` and `run(...)`.

cyipopt is the one we require. Another wrapper of Ipopt fits here by one class and an entry in `backends.backends`; what ran is named in
every result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

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

    def ipopt_version(self) -> tuple[int, ...]: ...

    def version(self) -> str: ...

    def knows(self, option: str) -> bool:
        """Whether its Ipopt has an option of that name."""
        ...

    def takes_ldlt(self) -> bool:
        """Whether its Ipopt can be handed our factorisation."""
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
