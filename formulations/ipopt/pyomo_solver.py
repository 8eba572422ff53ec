"""SolverFactory("touchstone_ipopt"): this bridge behind Pyomo's own solver interface, for any smooth model.

    import formulations.ipopt
    solver = pyo.SolverFactory("touchstone_ipopt")
    solver.options["tol"] = 1e-9
    results = solver.solve(model, tee=True, timelimit=60)
    pyo.assert_optimal_termination(results)

Suffixes as with Pyomo's ipopt: `dual`, `ipopt_zL_out`, `ipopt_zU_out` are filled where the model imports them; with warmstart=True (or the
option warm_start_init_point=yes) `dual`, `ipopt_zL_in`, `ipopt_zU_in` start the next solve where the model exports them. After a solve
`solver.last_result` is the IpoptResult: history, unscaled residuals, where the time went.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from typing import Any

from pyomo.common.collections import Bunch
from pyomo.common.tee import capture_output
from pyomo.opt import SolverFactory, SolverResults, SolverStatus

from formulations.ipopt.backends import default_backend
from formulations.ipopt.compiler import compile_model
from formulations.ipopt.pyomo_results import has_point, solver_results, with_solution
from formulations.ipopt.pyomo_suffixes import dual_start, fill_suffixes
from formulations.ipopt.result import IpoptResult, load
from formulations.ipopt.solve import solve
from models.errors import MachineError

logger = logging.getLogger(__name__)

# Keywords of Pyomo's file-based solvers that have nothing to act on here: no file is written, no name is shortened.
_WITHOUT_EFFECT = frozenset(
    {"keepfiles", "symbolic_solver_labels", "io_options", "report_timing", "suffixes", "solver_io", "use_signal_handling"}
)


@SolverFactory.register("touchstone_ipopt", doc="Ipopt through cyipopt, without AMPL executables")
class TouchstoneIpopt:
    """A Pyomo solver object. `options` holds Ipopt options and stays from solve to solve."""

    def __init__(self, *, options: Mapping[str, Any] | None = None, name: str = "touchstone_ipopt", **ignored: Any) -> None:
        unknown = set(ignored) - _WITHOUT_EFFECT - {"type", "doc", "validate"}
        if unknown:
            raise TypeError(f"touchstone_ipopt takes no argument {', '.join(sorted(unknown))}")
        self.name = self.type = name
        self.options = Bunch(**(options or {}))
        self.last_result: IpoptResult | None = None

    # -- what Pyomo asks of a solver ----------------------------------------------------------------------------------------------

    def available(self, exception_flag: bool = False) -> bool:
        """Whether an Ipopt back end is installed; with exception_flag, raise if not."""
        try:
            default_backend()
        except MachineError:
            if exception_flag:
                raise
            return False
        return True

    def license_is_valid(self) -> bool:
        return True

    def warm_start_capable(self) -> bool:
        return True

    def has_capability(self, capability: str) -> bool:
        return capability in {"linear", "quadratic_objective", "quadratic_constraint"}

    def version(self) -> tuple[int, ...]:
        """Version of the Ipopt that would run."""
        return default_backend().ipopt_version()

    def set_options(self, text: str) -> None:
        """Options as 'name=value name=value'."""
        self.options.update(_options_of_text(text))

    def reset(self) -> None:
        self.last_result = None

    def __enter__(self) -> TouchstoneIpopt:
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
        """Translate, solve and (by default) load. Raises ModelRefusedError for what Ipopt cannot treat, before anything runs.

        As with Pyomo's own solvers a result with a warning is loaded and logged, and a result that is an error raises ValueError
        unless load_solutions is False. KeyboardInterrupt leaves the model as it was.
        """
        unknown = set(ignored) - _WITHOUT_EFFECT
        if unknown:
            raise TypeError(f"touchstone_ipopt.solve takes no argument {', '.join(sorted(unknown))}")
        self.available(exception_flag=True)
        self.last_result = None
        chosen = {**self.options, **(options or {}), **_options_of_text(options_string)}
        chosen.pop("solver", None)
        if tee:
            chosen.setdefault("print_level", 5)
        problem = compile_model(model)
        primal_dual = warmstart or str(chosen.get("warm_start_init_point", "no")) == "yes"
        start = dual_start(problem) if primal_dual else None
        with capture_output(sys.stdout, capture_fd=True) if tee else nullcontext():
            result = solve(problem, options=chosen, warm_start=start, time_limit=timelimit)
        self.last_result = result

        results = solver_results(problem, result)
        if not load_solutions:
            return with_solution(results, problem, result)
        if results.solver.status == SolverStatus.error:
            raise ValueError(f"touchstone_ipopt has no solution to load for '{model.name}': {result.message}")
        if results.solver.status != SolverStatus.ok:
            logger.warning("'%s' ended with %s: %s", model.name, results.solver.termination_condition, result.message)
        if has_point(result):
            load(problem, result)
            fill_suffixes(problem, result)
        return results


def _options_of_text(text: str) -> dict[str, str]:
    options = {}
    for word in text.split():
        name, equals, value = word.partition("=")
        if not equals:
            raise ValueError(f"options are written name=value, not {word!r}")
        options[name] = value
    return options
