"""SolverFactory("mpec_ipopt"): any Pyomo model with Complementarity components.

    import formulations.mpec
    solver = pyo.SolverFactory("mpec_ipopt")
    solver.options["strategy"] = "scholtes"           # its own options; others go to Ipopt
    results = solver.solve(model)
    pyo.assert_optimal_termination(results)           # B-stationary, certified by residuals recomputed from the model
    solver.last_result.certificate.sentence

The model keeps its components as they were (nothing is transformed in place); values, and the suffixes `dual`, `ipopt_zL_out`,
`ipopt_zU_out` where the model imports them, are loaded.

MpecResult -> Pyomo's SolverResults and suffixes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pyomo.core.base import Suffix
from pyomo.core.base.label import NumericLabeler
from pyomo.core.base.symbol_map import SymbolMap
from pyomo.opt import ProblemSense, SolverFactory, SolverResults, SolverStatus, TerminationCondition
from pyomo.opt.results.solution import Solution, SolutionStatus

from formulations.ipopt.pyomo_solver import CONDITIONS, PyomoPlugin
from formulations.mpec.result import MpecResult, is_feasible, load
from formulations.mpec.settings import read_settings
from formulations.mpec.solve import solve_mpec
from formulations.solution import Outcome


def condition_of(result: MpecResult) -> tuple[SolverStatus, TerminationCondition]:
    """Pyomo's words for how the solve ended; "optimal" is a B-stationary point here, not a proved global optimum."""
    if result.outcome is Outcome.STALLED and is_feasible(result):
        return SolverStatus.warning, TerminationCondition.feasible
    return CONDITIONS[result.outcome]


def solver_results(name: str, result: MpecResult) -> SolverResults:
    results = SolverResults()
    facts = results.problem
    facts.name = name
    facts.sense = ProblemSense.minimize if result.sense == 1 else ProblemSense.maximize
    facts.number_of_objectives = int(result.has_objective)
    facts.number_of_constraints = len(result.rows)
    facts.number_of_variables = facts.number_of_continuous_variables = len(result.variables)
    facts.number_of_binary_variables = facts.number_of_integer_variables = 0
    if (result.solved or is_feasible(result)) and np.isfinite(result.objective):  # a feasible point bounds the optimum from one side
        if result.sense == 1:
            facts.upper_bound = result.objective
        else:
            facts.lower_bound = result.objective
    told = results.solver
    told.name = "mpec_ipopt"
    told.status, told.termination_condition = condition_of(result)
    told.message = told.termination_message = result.message
    told.wallclock_time = result.seconds
    told.statistics.black_box.number_of_iterations = result.iterations
    return results


def pyomo_multipliers(result: MpecResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(dual, zL, zU) in Pyomo's signs: the change of the objective when a bound grows by one."""
    return -result.sense * result.lagrange, result.sense * result.zl, -result.sense * result.zu


def fill_suffixes(model: Any, result: MpecResult) -> None:
    """Write multipliers into the import suffixes the model declares. Where there are none the suffixes are emptied."""
    dual, lower, upper = pyomo_multipliers(result)
    for name, components, values in (
        ("dual", result.rows, dual),
        ("ipopt_zL_out", result.variables, lower),
        ("ipopt_zU_out", result.variables, upper),
    ):
        suffix = model.component(name)
        if isinstance(suffix, Suffix) and suffix.active and suffix.import_enabled():
            suffix.clear()
            if result.has_multipliers:
                suffix.update(zip(components, values.tolist(), strict=True))


def with_solution(results: SolverResults, result: MpecResult) -> SolverResults:
    """The same results carrying the point, for `model.solutions.load_from(results)`."""
    if not result.has_point:
        return results
    symbols, solution = SymbolMap(), Solution()
    labels = {"x": NumericLabeler("x"), "c": NumericLabeler("c")}
    dual, lower, upper = pyomo_multipliers(result)
    solution.status = SolutionStatus.optimal if result.solved else SolutionStatus.unknown
    for variable, value, zl, zu in zip(result.variables, result.x.tolist(), lower.tolist(), upper.tolist(), strict=True):
        entry = {"Value": value, "ipopt_zL_out": zl, "ipopt_zU_out": zu} if result.has_multipliers else {"Value": value}
        solution.variable[symbols.getSymbol(variable, labels["x"])] = entry
    if result.has_multipliers:
        for constraint, multiplier in zip(result.rows, dual.tolist(), strict=True):
            solution.constraint[symbols.getSymbol(constraint, labels["c"])] = {"Dual": multiplier}
    results.solution.insert(solution)
    results._smap = symbols
    return results


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
