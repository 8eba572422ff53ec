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

from formulations.ipopt.contrib_solver import register
from formulations.ipopt.pyomo_solver import PyomoAnswer, PyomoPlugin, pyomo_multipliers
from formulations.mpec.result import is_feasible
from formulations.mpec.settings import read_settings
from formulations.mpec.solve import solve_mpec


@SolverFactory.register("mpec_ipopt", doc="MPECs (pyomo.mpec) by relaxation, active-set polish and certificate, on Ipopt")
class MpecIpopt(PyomoPlugin):
    """A Pyomo solver object; `last_result` is the MpecResult of the last solve. A start is always taken from the model's values.

    "optimal" is a B-stationary point here, not a proved global optimum.
    """

    title = "mpec_ipopt"

    def run(self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool) -> tuple[SolverResults, PyomoAnswer]:
        """Solve with `solve_mpec`."""
        result = self.last_result = solve_mpec(model, read_settings(options), time_limit=timelimit)
        answer = PyomoAnswer(
            outcome=result.outcome,
            message=result.message,
            is_feasible=result.solved or is_feasible(result),
            sense=result.sense,
            objective=result.objective,
            has_objective=result.has_objective,
            equations=result.rows,
            variables=result.variables,
            x=result.x if result.has_point else None,
            multipliers=pyomo_multipliers(result.sense, result.lagrange, result.zl, result.zu) if result.has_multipliers else None,
            iterations=result.iterations,
            wall=result.seconds,
        )
        return answer.results(self.title, model), answer


register(MpecIpopt)
