"""The outward manners of a Pyomo solver object, shared by all that this package registers.

class Solver(PyomoPlugin):
    title = "name_in_the_factory"
    def run(self, model, *, options, tee, timelimit, **keywords): -> (SolverResults, what was solved)
    def load(self, model, solved): ...
    def carry(self, results, solved): ...
"""

from __future__ import annotations

import logging
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import nullcontext
from typing import Any, Self

from pyomo.common.collections import Bunch
from pyomo.common.tee import capture_output
from pyomo.opt import SolverResults, SolverStatus

from formulations.ipopt.run import ipopt_version

logger = logging.getLogger(__name__)

# Keywords of Pyomo's file-based solvers that have nothing to act on here: no file is written, no name is shortened.
_WITHOUT_EFFECT = frozenset(
    {"keepfiles", "symbolic_solver_labels", "io_options", "report_timing", "suffixes", "solver_io", "use_signal_handling"}
)


class PyomoPlugin(ABC):
    """`options` stays from solve to solve; `last_result` is what the last one found, in this package's own words."""

    title: str

    def __init__(self, *, options: Mapping[str, Any] | None = None, name: str = "", **ignored: Any) -> None:
        unknown = set(ignored) - _WITHOUT_EFFECT - {"type", "doc", "validate"}
        if unknown:
            raise TypeError(f"{self.title} takes no argument {', '.join(sorted(unknown))}")
        self.name = self.type = name or self.title
        self.options = Bunch(**(options or {}))
        self.last_result: Any = None

    # -- what Pyomo asks of a solver ----------------------------------------------------------------------------------------------

    def available(self, exception_flag: bool = False) -> bool:
        return True

    def license_is_valid(self) -> bool:
        return True

    def warm_start_capable(self) -> bool:
        return True

    def has_capability(self, capability: str) -> bool:
        return capability in {"linear", "quadratic_objective", "quadratic_constraint"}

    def version(self) -> tuple[int, ...]:
        """Version of the Ipopt that would run."""
        return ipopt_version()

    def set_options(self, text: str) -> None:
        """Options as 'name=value name=value'."""
        self.options.update(_options_of_text(text))

    def reset(self) -> None:
        self.last_result = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        return None

    # -- solving ------------------------------------------------------------------------------------------------------------------

    def solve(
        self,
        model: Any,
        *,
        tee: bool = False,
        load_solutions: bool = True,
        timelimit: float | None = None,
        warmstart: bool = False,
        options: Mapping[str, Any] | None = None,
        options_string: str = "",
        **ignored: Any,
    ) -> SolverResults:
        """Translate, solve and (by default) load. Raises ModelRefusedError for what cannot be treated, before anything runs.

        As with Pyomo's own solvers a result with a warning is loaded and logged, and a result that is an error raises ValueError
        unless load_solutions is False. KeyboardInterrupt leaves the model as it was.
        """
        unknown = set(ignored) - _WITHOUT_EFFECT
        if unknown:
            raise TypeError(f"{self.title}.solve takes no argument {', '.join(sorted(unknown))}")
        if isinstance(options, str):
            raise TypeError(f"{self.title}.solve takes options as a dict, not {options!r}; options_string takes a text")
        if timelimit is not None and (isinstance(timelimit, (bool, str)) or not timelimit > 0):
            raise ValueError(f"{self.title}.solve: timelimit is a positive number of seconds, not {timelimit!r}")
        self.last_result = None
        chosen = {**self.options, **(options or {}), **_options_of_text(options_string)}
        chosen.pop("solver", None)
        if tee:
            chosen.setdefault("print_level", 5)
        with capture_output(sys.stdout, capture_fd=True) if tee else nullcontext():
            results, solved = self.run(model, options=chosen, timelimit=timelimit, warmstart=warmstart)
        if not load_solutions:
            return self.carry(results, solved)
        if results.solver.status == SolverStatus.error:
            raise ValueError(f"{self.title} has no solution to load for '{model.name}': {results.solver.message}")
        if results.solver.status != SolverStatus.ok:
            logger.warning("'%s' ended with %s: %s", model.name, results.solver.termination_condition, results.solver.message)
        self.load(model, solved)
        return results

    @abstractmethod
    def run(self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool) -> tuple[SolverResults, Any]:
        """Solve, keep `last_result`, and tell it in Pyomo's words. The model is only read."""

    @abstractmethod
    def load(self, model: Any, solved: Any) -> None:
        """Write the point, where there is one, and its multipliers into the model."""

    @abstractmethod
    def carry(self, results: SolverResults, solved: Any) -> SolverResults:
        """The same results with the point in them, for `model.solutions.load_from(results)`."""


def _options_of_text(text: str) -> dict[str, str]:
    options = {}
    for word in text.split():
        name, equals, value = word.partition("=")
        if not equals:
            raise ValueError(f"options are written name=value, not {word!r}")
        options[name] = value
    return options
