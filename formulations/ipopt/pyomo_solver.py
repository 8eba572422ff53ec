"""SolverFactory("touchstone_ipopt"): this bridge behind Pyomo's own solver interface, for any smooth model.

    import formulations.ipopt
    solver = pyo.SolverFactory("touchstone_ipopt")
    solver.options["tol"] = 1e-9
    results = solver.solve(model, tee=True, timelimit=60)
    pyo.assert_optimal_termination(results)

Suffixes as with Pyomo's ipopt: `dual`, `ipopt_zL_out`, `ipopt_zU_out` are filled where the model imports them; with warmstart=True (or the
option warm_start_init_point=yes) `dual`, `ipopt_zL_in`, `ipopt_zU_in` start the next solve where the model exports them. After a solve
`solver.last_result` is the IpoptResult: history, unscaled residuals, where the time went.

Where equations repeat each other Ipopt may miss an end by rounding: multipliers grow without one, or it gives up at a feasible point. Such a solve is made once more with its option
perturb_always_cd, which its message says, and may take as many iterations again; setting the option to yes or no leaves it at one solve.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any

from pyomo.opt import SolverFactory, SolverResults

from formulations.ipopt.compiler import compile_model
from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.pyomo_plugin import PyomoPlugin
from formulations.ipopt.pyomo_results import has_point, solver_results, with_solution
from formulations.ipopt.pyomo_suffixes import dual_start, fill_suffixes
from formulations.ipopt.result import IpoptResult, load
from formulations.ipopt.solve import repeats_constraints, solve
from formulations.solution import Outcome

_AGAIN = "once more with perturb_always_cd='yes', because constraints may repeat each other"

Solved = tuple[IpoptProblem, IpoptResult]


@SolverFactory.register("touchstone_ipopt", doc="Ipopt through cyipopt, without AMPL executables")
class TouchstoneIpopt(PyomoPlugin):
    """A Pyomo solver object. `options` holds Ipopt options; `last_result` is the IpoptResult of the last solve."""

    title = "touchstone_ipopt"

    def run(self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool) -> tuple[SolverResults, Solved]:
        problem = compile_model(model)
        primal_dual = warmstart or str(options.get("warm_start_init_point", "no")) == "yes"
        start = dual_start(problem) if primal_dual else None
        begin = perf_counter()
        result = solve(problem, options=options, warm_start=start, time_limit=timelimit)
        left = None if timelimit is None else timelimit - (perf_counter() - begin)
        if repeats_constraints(result) and "perturb_always_cd" not in options and (left is None or left > 0):
            again = solve(problem, options={**options, "perturb_always_cd": "yes"}, warm_start=start, time_limit=left)
            if again.outcome is Outcome.SOLVED:
                result = replace(again, message=f"{again.message}; {_AGAIN}")
        self.last_result = result
        return solver_results(problem, result), (problem, result)

    def load(self, model: Any, solved: Solved) -> None:
        if has_point(solved[1]):
            load(*solved)
            fill_suffixes(*solved)

    def carry(self, results: SolverResults, solved: Solved) -> SolverResults:
        return with_solution(results, *solved)
