"""IpoptResult -> Pyomo's SolverResults."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from pyomo.core.base.label import NumericLabeler
from pyomo.core.base.symbol_map import SymbolMap
from pyomo.opt import ProblemSense, SolverResults, SolverStatus, TerminationCondition
from pyomo.opt.results.solution import Solution, SolutionStatus

from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.pyomo_suffixes import pyomo_duals
from formulations.ipopt.result import IpoptResult
from formulations.ipopt.status import NOT_SENT
from formulations.solution import Outcome

# Outcome -> (status, termination condition); STALLED is refined below. "optimal" is what Pyomo's own ipopt reports for a KKT point.
CONDITIONS = MappingProxyType({
    Outcome.SOLVED: (SolverStatus.ok, TerminationCondition.optimal),
    Outcome.ITERATION_LIMIT: (SolverStatus.warning, TerminationCondition.maxIterations),
    Outcome.TIME_LIMIT: (SolverStatus.warning, TerminationCondition.maxTimeLimit),
    Outcome.INFEASIBLE: (SolverStatus.warning, TerminationCondition.infeasible),
    Outcome.DIVERGED: (SolverStatus.warning, TerminationCondition.unbounded),
    Outcome.STALLED: (SolverStatus.warning, TerminationCondition.noSolution),
    Outcome.EVALUATION_ERROR: (SolverStatus.error, TerminationCondition.internalSolverError),
    Outcome.INTERRUPTED: (SolverStatus.aborted, TerminationCondition.userInterrupt),
    Outcome.REFUSED: (SolverStatus.warning, TerminationCondition.invalidProblem),
    Outcome.CRASHED: (SolverStatus.error, TerminationCondition.solverFailure),
    Outcome.FAILED: (SolverStatus.error, TerminationCondition.error),
})  # fmt: skip

_WITHOUT_POINT = frozenset({Outcome.EVALUATION_ERROR, Outcome.REFUSED, Outcome.CRASHED, Outcome.FAILED})


def has_point(result: IpoptResult) -> bool:
    """Whether x is worth loading: Ipopt worked on it, and it is a point."""
    if result.outcome in _WITHOUT_POINT or (result.status == NOT_SENT and not result.solved):
        return False
    return bool(np.all(np.isfinite(result.x)))


def condition_of(result: IpoptResult) -> tuple[SolverStatus, TerminationCondition]:
    """Pyomo's words for how the solve ended; a stalled solve is `feasible` only where the unscaled residuals say so."""
    if result.outcome is Outcome.STALLED and result.residuals.feasible:
        return SolverStatus.warning, TerminationCondition.feasible
    return CONDITIONS[result.outcome]


def solver_results(problem: IpoptProblem, result: IpoptResult) -> SolverResults:
    results = SolverResults()
    facts = results.problem
    facts.name = problem.layout.model.name
    facts.sense = ProblemSense.minimize if problem.sense == 1 else ProblemSense.maximize
    facts.number_of_objectives = 0 if problem.layout.objective is None else 1
    facts.number_of_constraints = problem.m
    facts.number_of_variables = facts.number_of_continuous_variables = problem.n
    facts.number_of_binary_variables = facts.number_of_integer_variables = 0
    facts.number_of_nonzeros = len(problem.jacobianstructure()[0])
    if result.residuals.feasible and np.isfinite(result.objective):  # a feasible point bounds the optimum from one side
        if problem.sense == 1:
            facts.upper_bound = result.objective
        else:
            facts.lower_bound = result.objective

    told = results.solver
    told.name = "touchstone_ipopt"
    told.status, told.termination_condition = condition_of(result)
    told.return_code = result.status
    told.message = told.termination_message = result.message
    told.wallclock_time = result.seconds.wall
    told.user_time = result.seconds.cpu
    told.statistics.black_box.number_of_iterations = result.iterations
    told.statistics.black_box.number_of_function_evaluations = result.calls.get("values", 0)
    told.statistics.black_box.number_of_gradient_evaluations = result.calls.get("derivatives", 0)
    return results


def with_solution(results: SolverResults, problem: IpoptProblem, result: IpoptResult) -> SolverResults:
    """The same results carrying the point, for `model.solutions.load_from(results)`."""
    if not has_point(result):
        return results
    symbols = SymbolMap()
    labels = {"x": NumericLabeler("x"), "c": NumericLabeler("c")}
    dual, lower, upper = pyomo_duals(problem, result)
    solution = Solution()
    solution.status = SolutionStatus.optimal if result.solved else SolutionStatus.unknown
    for variable, value, zl, zu in zip(problem.variables, result.x.tolist(), lower.tolist(), upper.tolist(), strict=True):
        entry = {"Value": value, "ipopt_zL_out": zl, "ipopt_zU_out": zu}
        solution.variable[symbols.getSymbol(variable, labels["x"])] = entry
    for constraint, multiplier in zip(problem.equations, dual.tolist(), strict=True):
        solution.constraint[symbols.getSymbol(constraint, labels["c"])] = {"Dual": multiplier}
    results.solution.insert(solution)
    results._smap = symbols
    return results
