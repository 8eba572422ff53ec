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

from typing import Any

from pyomo.opt import SolverFactory, SolverResults

from formulations.ipopt.compiler import compile_model
from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.pyomo_plugin import PyomoPlugin
from formulations.ipopt.pyomo_results import has_point, solver_results, with_solution
from formulations.ipopt.pyomo_suffixes import dual_start, fill_suffixes
from formulations.ipopt.result import IpoptResult, load
from formulations.ipopt.solve import solve

Solved = tuple[IpoptProblem, IpoptResult]


@SolverFactory.register("touchstone_ipopt", doc="Ipopt through cyipopt, without AMPL executables")
class TouchstoneIpopt(PyomoPlugin):
    """A Pyomo solver object. `options` holds Ipopt options; `last_result` is the IpoptResult of the last solve."""

    title = "touchstone_ipopt"

    def run(self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool) -> tuple[SolverResults, Solved]:
        problem = compile_model(model)
        primal_dual = warmstart or str(options.get("warm_start_init_point", "no")) == "yes"
        start = dual_start(problem) if primal_dual else None
        result = self.last_result = solve(problem, options=options, warm_start=start, time_limit=timelimit)
        return solver_results(problem, result), (problem, result)

    def load(self, model: Any, solved: Solved) -> None:
        if has_point(solved[1]):
            load(*solved)
            fill_suffixes(*solved)

    def carry(self, results: SolverResults, solved: Solved) -> SolverResults:
        return with_solution(results, *solved)
