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

from typing import Any

from pyomo.opt import SolverFactory, SolverResults

from formulations.ipopt.pyomo_plugin import PyomoPlugin
from formulations.mpec.pyomo_results import fill_suffixes, solver_results, with_solution
from formulations.mpec.result import MpecResult, load
from formulations.mpec.settings import read_settings
from formulations.mpec.solve import solve_mpec


@SolverFactory.register("mpec_ipopt", doc="MPECs (pyomo.mpec) by relaxation, active-set polish and certificate, on Ipopt")
class MpecIpopt(PyomoPlugin):
    """A Pyomo solver object; `last_result` is the MpecResult of the last solve. A start is always taken from the model's values."""

    title = "mpec_ipopt"

    def run(self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool) -> tuple[SolverResults, MpecResult]:
        result = self.last_result = solve_mpec(model, read_settings(options), time_limit=timelimit)
        return solver_results(model.name, result), result

    def load(self, model: Any, solved: MpecResult) -> None:
        if solved.has_point:
            load(solved)
            fill_suffixes(model, solved)

    def carry(self, results: SolverResults, solved: MpecResult) -> SolverResults:
        return with_solution(results, solved)
