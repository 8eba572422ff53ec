"""The solvers by Pyomo's second interface: results as an object, solutions loaded when asked for, errors unless the answer is optimal.

from pyomo.contrib.solver.common.factory import SolverFactory       # the names are those of the first interface
results = SolverFactory("mpec_ipopt").solve(model, time_limit=60, solver_options={"strategy": "scholtes"}, load_solutions=False)
results.termination_condition, results.solution_status, results.incumbent_objective
results.solution_loader.load_vars()
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from datetime import UTC, datetime
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np
from pyomo.common.collections import ComponentMap
from pyomo.common.tee import TeeStream, capture_output
from pyomo.contrib.solver.common.base import Availability, SolverBase
from pyomo.contrib.solver.common.results import Results, SolutionStatus, TerminationCondition
from pyomo.contrib.solver.common.solution_loader import SolutionLoader
from pyomo.contrib.solver.common.util import (
    NoDualsError,
    NoFeasibleSolutionError,
    NoOptimalSolutionError,
    NoReducedCostsError,
    NoSolutionError,
)
from pyomo.core.base.suffix import Suffix

from formulations.ipopt.pyomo_solver import PyomoAnswer, PyomoPlugin
from formulations.solution import Outcome

# Infeasible only near the start: a local solver proves nothing.
_CONDITIONS = MappingProxyType({
    Outcome.SOLVED: TerminationCondition.convergenceCriteriaSatisfied,
    Outcome.ITERATION_LIMIT: TerminationCondition.iterationLimit,
    Outcome.TIME_LIMIT: TerminationCondition.maxTimeLimit,
    Outcome.INFEASIBLE: TerminationCondition.locallyInfeasible,
    Outcome.DIVERGED: TerminationCondition.unbounded,
    Outcome.STALLED: TerminationCondition.minStepLength,
    Outcome.INTERRUPTED: TerminationCondition.interrupted,
})  # fmt: skip


class _Loader(SolutionLoader):
    """One answer, on its way into the model."""

    def __init__(self, model: Any, answer: PyomoAnswer) -> None:
        self._pyomo_model, self._answer = model, answer

    def get_number_of_solutions(self) -> int:
        return int(self._answer.x is not None)

    def get_vars(self, vars_to_load: Sequence[Any] | None = None) -> Mapping[Any, float]:
        if self._answer.x is None:
            raise NoSolutionError
        return _chosen(zip(self._answer.variables, self._answer.x.tolist(), strict=True), vars_to_load)

    def get_duals(self, cons_to_load: Sequence[Any] | None = None) -> Any:
        if self._answer.multipliers is None:
            raise NoDualsError
        return _chosen(zip(self._answer.equations, self._answer.multipliers[0].tolist(), strict=True), cons_to_load)

    def get_reduced_costs(self, vars_to_load: Sequence[Any] | None = None) -> Mapping[Any, float]:
        if self._answer.multipliers is None:
            raise NoReducedCostsError
        _, lower, upper = self._answer.multipliers
        return _chosen(zip(self._answer.variables, np.add(lower, upper).tolist(), strict=True), vars_to_load)

    def load_solution(self) -> None:
        self._answer.load(self._pyomo_model)
        suffix = self._pyomo_model.component("rc")
        if isinstance(suffix, Suffix) and suffix.active and suffix.import_enabled():
            suffix.clear()
            if self._answer.multipliers is not None:
                suffix.update(self.get_reduced_costs())


def _chosen(pairs: Any, wanted: Sequence[Any] | None) -> Any:
    found = ComponentMap(pairs)
    return found if wanted is None else ComponentMap((item, found[item]) for item in wanted)


class ContribSolver(SolverBase):
    """A plugin of the first interface, asked in the words of the second."""

    def __init__(self, plugin: type[PyomoPlugin], **settings: Any) -> None:
        super().__init__(name=plugin.title, **settings)
        self.plugin = plugin
        self.last_result: Any = None

    def available(self) -> Availability:
        """Always: importing the package needs Ipopt."""
        return Availability.FullLicense

    def version(self) -> tuple[int, ...]:
        """Version of the Ipopt that would run."""
        return self.plugin().version()

    def solve(self, model: Any, **settings: Any) -> Results:
        """Solve; settings are those of `pyomo.contrib.solver.common.config.SolverConfig`.

        Raises
        ------
        ModelRefusedError, MissingValueError, UnknownOptionError
            before anything runs
        NoOptimalSolutionError
            unless raise_exception_on_nonoptimal_result is False
        NoFeasibleSolutionError
            where there is nothing to load, unless load_solutions is False
        """
        began, begun = perf_counter(), datetime.now(UTC)
        config = self.config(value=settings, preserve_implicit=True)
        options, plugin = config.solver_options.value(), self.plugin()
        if config.tee:
            options.setdefault("print_level", 5)
        with capture_output(TeeStream(*config.tee), capture_fd=True) if config.tee else nullcontext():
            _, answer = plugin.run(model, options=options, timelimit=config.time_limit, warmstart=False)
        self.last_result = plugin.last_result
        results = Results()
        results.solver_name, results.solver_version, results.solver_config = self.name, self.version(), config
        results.termination_condition = _CONDITIONS.get(answer.outcome, TerminationCondition.error)
        results.solution_status = _status(answer)
        results.solution_loader = _Loader(model, answer)
        results.incumbent_objective = answer.objective if answer.is_feasible and answer.has_objective else None
        results.extra_info.message = answer.message
        results.extra_info.iteration_count = answer.iterations
        results.timing_info.start_timestamp, results.timing_info.wall_time = begun, perf_counter() - began
        if config.raise_exception_on_nonoptimal_result and results.solution_status is not SolutionStatus.optimal:
            raise NoOptimalSolutionError(f"{NoOptimalSolutionError.default_message} It ended with: {answer.message}")
        if config.load_solutions:
            if answer.x is None:
                raise NoFeasibleSolutionError
            results.solution_loader.load_solution()
        return results


def _status(answer: PyomoAnswer) -> SolutionStatus:
    if answer.x is None:
        return SolutionStatus.noSolution
    if answer.outcome is Outcome.SOLVED:
        return SolutionStatus.optimal
    return SolutionStatus.feasible if answer.is_feasible else SolutionStatus.infeasible
