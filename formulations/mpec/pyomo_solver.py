"""SolverFactory("mpec_ipopt"): any Pyomo model with Complementarity components.

    import formulations.mpec
    solver = pyo.SolverFactory("mpec_ipopt")
    solver.options["strategy"] = "scholtes"           # its own options; others go to Ipopt
    results = solver.solve(model)
    pyo.assert_optimal_termination(results)           # B-stationary, certified by residuals recomputed from the model
    solver.last_result.certificate.sentence

The model keeps its components as they were (nothing is transformed in place); values, and the suffixes `dual`, `ipopt_zL_out`,
`ipopt_zU_out` where the model imports them, are loaded.
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

from formulations.ipopt import TouchstoneIpopt
from formulations.mpec.pyomo_results import fill_suffixes, solver_results, with_solution
from formulations.mpec.result import MpecResult, load
from formulations.mpec.settings import read_settings
from formulations.mpec.solve import solve_mpec

logger = logging.getLogger(__name__)

# Keywords of Pyomo's file-based solvers that have nothing to act on here. A start is always taken from the model's values: warmstart says so.
_WITHOUT_EFFECT = frozenset(
    {"keepfiles", "symbolic_solver_labels", "io_options", "report_timing", "suffixes", "solver_io", "use_signal_handling", "warmstart"}
)


@SolverFactory.register("mpec_ipopt", doc="MPECs (pyomo.mpec) by relaxation, active-set polish and certificate, on Ipopt")
class MpecIpopt:
    """A Pyomo solver object. `options` stays from solve to solve; `last_result` is the MpecResult of the last one."""

    def __init__(self, *, options: Mapping[str, Any] | None = None, name: str = "mpec_ipopt", **ignored: Any) -> None:
        unknown = set(ignored) - _WITHOUT_EFFECT - {"type", "doc", "validate"}
        if unknown:
            raise TypeError(f"mpec_ipopt takes no argument {', '.join(sorted(unknown))}")
        self.name = self.type = name
        self.options = Bunch(**(options or {}))
        self.last_result: MpecResult | None = None

    def available(self, exception_flag: bool = False) -> bool:
        """Whether an Ipopt back end is installed; with exception_flag, raise if not."""
        return TouchstoneIpopt().available(exception_flag)

    def license_is_valid(self) -> bool:
        return True

    def warm_start_capable(self) -> bool:
        return True

    def has_capability(self, capability: str) -> bool:
        return capability in {"linear", "quadratic_objective", "quadratic_constraint"}

    def version(self) -> tuple[int, ...]:
        """Version of the Ipopt that would run."""
        return TouchstoneIpopt().version()

    def reset(self) -> None:
        self.last_result = None

    def __enter__(self) -> MpecIpopt:
        return self

    def __exit__(self, *exception: object) -> None:
        return None

    def solve(
        self,
        model: Any,
        *,
        tee: bool = False,
        load_solutions: bool = True,
        timelimit: float | None = None,
        options: Mapping[str, Any] | None = None,
        **ignored: Any,
    ) -> SolverResults:
        """Solve from the model's values and (by default) load. Raises ModelRefusedError for what cannot be treated, before anything runs.

        As with Pyomo's own solvers a result with a warning is loaded and logged, and a result that is an error raises ValueError
        unless load_solutions is False. KeyboardInterrupt leaves the model as it was.
        """
        unknown = set(ignored) - _WITHOUT_EFFECT
        if unknown:
            raise TypeError(f"mpec_ipopt.solve takes no argument {', '.join(sorted(unknown))}")
        self.available(exception_flag=True)
        self.last_result = None
        chosen = {**self.options, **(options or {})}
        if tee:
            chosen.setdefault("print_level", 5)
        settings = read_settings(chosen)
        with capture_output(sys.stdout, capture_fd=True) if tee else nullcontext():
            result = solve_mpec(model, settings, time_limit=timelimit)
        self.last_result = result
        results = solver_results(model.name, result)
        if not load_solutions:
            return with_solution(results, result)
        if results.solver.status == SolverStatus.error:
            raise ValueError(f"mpec_ipopt has no solution to load for '{model.name}': {result.message}")
        if results.solver.status != SolverStatus.ok:
            logger.warning("'%s' ended with %s: %s", model.name, results.solver.termination_condition, result.message)
        if result.has_point:
            load(result)
            fill_suffixes(model, result)
        return results
