"""SolverFactory("touchstone_ipopt"): Ipopt behind both of Pyomo's solver interfaces.

    results = pyo.SolverFactory("touchstone_ipopt").solve(model, tee=True, timelimit=60)

Suffixes work as in Pyomo's ipopt: `dual`, `ipopt_zL_out` and `ipopt_zU_out` are filled if the
model imports them; with warmstart=True `dual`, `ipopt_zL_in` and `ipopt_zU_in` start the solve.
A Pyomo dual is the change of the objective when the constraint's bound grows by one, so
`min x, x >= 1` has dual +1, and zU is negative when minimising.
"""

from __future__ import annotations

import logging
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from pyomo.common.collections import Bunch, ComponentMap
from pyomo.common.tee import TeeStream, capture_output
from pyomo.contrib.solver.common import results as second
from pyomo.contrib.solver.common.base import Availability, SolverBase
from pyomo.contrib.solver.common.solution_loader import SolutionLoader
from pyomo.contrib.solver.common.util import (
    NoDualsError,
    NoFeasibleSolutionError,
    NoOptimalSolutionError,
    NoReducedCostsError,
    NoSolutionError,
)
from pyomo.core.base import Block, Suffix
from pyomo.core.base.label import NumericLabeler
from pyomo.core.base.symbol_map import SymbolMap
from pyomo.opt import ProblemSense, SolverResults, SolverStatus, TerminationCondition
from pyomo.opt.results.solution import Solution, SolutionStatus

from formulations.ipopt.problem import IpoptProblem, compile_model
from formulations.ipopt.result import NOT_SENT, IpoptResult, write_point
from formulations.ipopt.solve import Start, ipopt_version, repeats_constraints, solve
from formulations.solution import Outcome


def dual_start(problem: IpoptProblem) -> Start | None:
    """Return the start from the model's values and export suffixes, or None without duals."""
    exported = {
        "lagrange": _exported(problem.model, "dual", problem.equations),
        "zl": _exported(problem.model, "ipopt_zL_in", problem.variables),
        "zu": _exported(problem.model, "ipopt_zU_in", problem.variables),
    }
    if all(values is None for values in exported.values()):
        return None
    signs = {"lagrange": -problem.sense, "zl": problem.sense, "zu": -problem.sense}
    multipliers = {
        name: signs[name] * values for name, values in exported.items() if values is not None
    }
    return Start(x=problem.start()[0], **multipliers)


def _exported(model: Any, name: str, components: tuple[Any, ...]) -> np.ndarray | None:
    suffixes = [
        s
        for s in model.component_data_objects(Suffix, active=True, descend_into=Block)
        if s.local_name == name and s.export_enabled() and len(s)
    ]
    if not suffixes:
        return None
    values = np.zeros(len(components))
    for suffix in suffixes:
        for k, component in enumerate(components):
            number = suffix.get(component)
            if number is not None:
                values[k] = number
    return values


# Outcome -> (status, termination condition); `PyomoAnswer` refines STALLED. Pyomo's own ipopt also
# reports "optimal" for a KKT point.
_CONDITIONS = MappingProxyType({
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


@dataclass(frozen=True, kw_only=True, eq=False)
class PyomoAnswer:
    """The answer of a solver in the form of Pyomo's results, suffixes and models.

    - result: the solver's own result, with outcome, message, objective and iterations
    - is_feasible: whether the point is known to satisfy the model
    - x: (n,) values of `variables`, or None without a usable point
    - multipliers: dual (m,) of `equations`, zL, zU (n,) in Pyomo's signs, or None
    - pair_multipliers: (complementarity, multipliers of its two arguments), in the same signs
    """

    result: Any
    is_feasible: bool
    sense: int
    has_objective: bool
    equations: tuple[Any, ...]
    variables: tuple[Any, ...]
    x: np.ndarray | None
    multipliers: tuple[np.ndarray, np.ndarray, np.ndarray] | None
    wall: float
    pair_multipliers: tuple[tuple[Any, tuple[float, float]], ...] = ()

    def results(self, solver: str, model: Any) -> SolverResults:
        """Return Pyomo's report of the solve, without the point."""
        results = SolverResults()
        facts = results.problem
        facts.name = model.name
        facts.sense = ProblemSense.minimize if self.sense == 1 else ProblemSense.maximize
        facts.number_of_objectives = int(self.has_objective)
        facts.number_of_constraints = len(self.equations)
        facts.number_of_variables = facts.number_of_continuous_variables = len(self.variables)
        facts.number_of_binary_variables = facts.number_of_integer_variables = 0
        # A feasible point bounds the optimum from one side.
        if self.is_feasible and np.isfinite(self.result.objective):
            if self.sense == 1:
                facts.upper_bound = self.result.objective
            else:
                facts.lower_bound = self.result.objective
        report = results.solver
        report.name = solver
        report.status, report.termination_condition = _CONDITIONS[self.result.outcome]
        if self.result.outcome is Outcome.STALLED and self.is_feasible:
            report.termination_condition = TerminationCondition.feasible
        report.message = report.termination_message = self.result.message
        report.wallclock_time = self.wall
        report.statistics.black_box.number_of_iterations = self.result.iterations
        return results

    def load(self, model: Any) -> None:
        """Write the point into the variables, and the multipliers into the model's import suffixes.

        Import suffixes without multipliers are emptied.
        """
        if self.x is None:
            return
        write_point(self.variables, self.x)
        suffixes: dict[str, Any] = dict.fromkeys(("dual", "ipopt_zL_out", "ipopt_zU_out"), ())
        if self.multipliers is not None:
            owners = (self.equations, self.variables, self.variables)
            suffixes = {
                name: zip(owner, values.tolist(), strict=True)
                for name, owner, values in zip(suffixes, owners, self.multipliers, strict=True)
            }
        for name, values in {**suffixes, "pair_dual": self.pair_multipliers}.items():
            suffix = model.component(name)
            if isinstance(suffix, Suffix) and suffix.active and suffix.import_enabled():
                suffix.clear()
                suffix.update(values)

    def carry(self, results: SolverResults) -> SolverResults:
        """Return the results with the point, for `model.solutions.load_from(results)`."""
        if self.x is None:
            return results
        symbols, solution = SymbolMap(), Solution()
        label, row_label = NumericLabeler("x"), NumericLabeler("c")
        solution.status = (
            SolutionStatus.optimal
            if self.result.outcome is Outcome.SOLVED
            else SolutionStatus.unknown
        )
        entries = [{"Value": value} for value in self.x.tolist()]
        if self.multipliers is not None:
            dual, lower, upper = (values.tolist() for values in self.multipliers)
            for entry, zl, zu in zip(entries, lower, upper, strict=True):
                entry |= {"ipopt_zL_out": zl, "ipopt_zU_out": zu}
            for constraint, multiplier in zip(self.equations, dual, strict=True):
                solution.constraint[symbols.getSymbol(constraint, row_label)] = {"Dual": multiplier}
        for variable, entry in zip(self.variables, entries, strict=True):
            solution.variable[symbols.getSymbol(variable, label)] = entry
        results.solution.insert(solution)
        results._smap = symbols
        return results


def pyomo_multipliers(
    sense: int, lagrange: np.ndarray, zl: np.ndarray, zu: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return dual (m,), zL (n,), zU (n,) in Pyomo's signs [objective per bound]. Raises nothing.

    A Pyomo multiplier is the change of the objective when a bound grows by one.
    """
    return -sense * lagrange, sense * zl, -sense * zu


logger = logging.getLogger(__name__)

# Keywords of Pyomo's file-based solvers without effect here: no file is written, no name shortened.
_WITHOUT_EFFECT = frozenset(
    {
        "keepfiles",
        "symbolic_solver_labels",
        "io_options",
        "report_timing",
        "suffixes",
        "solver_io",
        "use_signal_handling",
    }
)


class PyomoPlugin(ABC):
    """The first of Pyomo's solver interfaces; a subclass defines `title` and `run`.

    `options` persist between solves; `last_result` is the solver's own result.
    """

    title: str

    def __init__(
        self, *, options: Mapping[str, Any] | None = None, name: str = "", **ignored: Any
    ) -> None:
        unknown = set(ignored) - _WITHOUT_EFFECT - {"type", "doc", "validate"}
        if unknown:
            raise TypeError(f"{self.title} takes no argument {', '.join(sorted(unknown))}")
        self.name = self.type = name or self.title
        self.options = Bunch(**(options or {}))
        self.last_result: Any = None

    # -- Pyomo's solver interface

    def available(self, exception_flag: bool = False) -> bool:
        """Return True."""
        return True

    def license_is_valid(self) -> bool:
        """Return True."""
        return True

    def warm_start_capable(self) -> bool:
        """Return True."""
        return True

    def has_capability(self, capability: str) -> bool:
        """Return whether models of this kind can be solved."""
        return capability in {"linear", "quadratic_objective", "quadratic_constraint"}

    def version(self) -> tuple[int, ...]:
        """Return Ipopt's version."""
        return ipopt_version()

    def set_options(self, text: str) -> None:
        """Set options from 'name=value name=value'."""
        self.options.update(_options_of_text(text))

    def reset(self) -> None:
        """Forget the last result."""
        self.last_result = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        return None

    # -- solving

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
        logfile: str | Path | None = None,
        **ignored: Any,
    ) -> SolverResults:
        """Translate, solve and (by default) load.

        `logfile` receives Ipopt's log and the final message.

        A result with a warning is loaded and logged, as by Pyomo's own solvers. KeyboardInterrupt
        leaves the model unchanged.

        Raises
        ------
        ModelRefusedError
            for a model that cannot be solved, before the solve starts
        ValueError
            for a result that is an error, unless load_solutions is False
        OSError
            if the log file cannot be written
        """
        unknown = set(ignored) - _WITHOUT_EFFECT
        if unknown:
            raise TypeError(f"{self.title}.solve takes no argument {', '.join(sorted(unknown))}")
        if isinstance(options, str):
            raise TypeError(
                f"{self.title}.solve takes options as a dict, not {options!r}; options_string takes a text"
            )
        if timelimit is not None and (isinstance(timelimit, (bool, str)) or not timelimit > 0):
            raise ValueError(
                f"{self.title}.solve: timelimit is a positive number of seconds, not {timelimit!r}"
            )
        self.last_result = None
        chosen = {**self.options, **(options or {}), **_options_of_text(options_string)}
        chosen.pop("solver", None)
        with ExitStack() as stack:
            log = (
                None
                if logfile is None
                else stack.enter_context(Path(logfile).open("w", encoding="utf-8"))
            )
            streams = [
                stream for stream in (sys.stdout if tee else None, log) if stream is not None
            ]
            with _shown_on(streams, chosen):
                results, answer = self.run(
                    model, options=chosen, timelimit=timelimit, warmstart=warmstart
                )
            if log is not None:
                log.write(f"{self.title}: {answer.result.message}\n")
        if not load_solutions:
            return answer.carry(results)
        if results.solver.status == SolverStatus.error:
            raise ValueError(
                f"{self.title} has no solution to load for '{model.name}': {results.solver.message}"
            )
        if results.solver.status != SolverStatus.ok:
            logger.warning(
                "'%s' ended with %s: %s",
                model.name,
                results.solver.termination_condition,
                results.solver.message,
            )
        answer.load(model)
        return results

    @abstractmethod
    def run(
        self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool
    ) -> tuple[SolverResults, PyomoAnswer]:
        """Solve, set `last_result`, and return the answer for Pyomo; the model is only read."""


def _shown_on(streams: Sequence[Any], options: dict[str, Any]) -> Any:
    if not streams:
        return nullcontext()
    options.setdefault("print_level", 5)
    return capture_output(TeeStream(*streams), capture_fd=True)


def _options_of_text(text: str) -> dict[str, str]:
    options = {}
    for word in text.split():
        name, equals, value = word.partition("=")
        if not equals:
            raise ValueError(f"options are written name=value, not {word!r}")
        options[name] = value
    return options


_AGAIN = "solved again with perturb_always_cd='yes', because constraints may be dependent"


class TouchstoneIpopt(PyomoPlugin):
    """Ipopt as a Pyomo solver; `last_result` is the IpoptResult of the last solve."""

    title = "touchstone_ipopt"

    def run(
        self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool
    ) -> tuple[SolverResults, PyomoAnswer]:
        """Solve, and solve again with `perturb_always_cd` if constraints may repeat each other."""
        problem = compile_model(model)
        primal_dual = warmstart or str(options.get("warm_start_init_point", "no")) == "yes"
        start = dual_start(problem) if primal_dual else None
        begin = perf_counter()
        result = solve(problem, options=options, warm_start=start, time_limit=timelimit)
        left = None if timelimit is None else timelimit - (perf_counter() - begin)
        if (
            repeats_constraints(result)
            and "perturb_always_cd" not in options
            and (left is None or left > 0)
        ):
            again = solve(
                problem,
                options={**options, "perturb_always_cd": "yes"},
                warm_start=start,
                time_limit=left,
            )
            if again.outcome is Outcome.SOLVED:
                result = replace(again, message=f"{again.message}; {_AGAIN}")
        self.last_result = result
        answer = PyomoAnswer(
            result=result,
            is_feasible=result.residuals.feasible,
            sense=problem.sense,
            has_objective=problem.objective_data is not None,
            equations=problem.equations,
            variables=problem.variables,
            x=result.x if _has_point(result) else None,
            multipliers=pyomo_multipliers(problem.sense, result.lagrange, result.zl, result.zu),
            wall=result.seconds.wall,
        )
        results = answer.results(self.title, model)
        results.problem.number_of_nonzeros = len(problem.jacobianstructure()[0])
        results.solver.return_code = result.status
        results.solver.user_time = result.seconds.cpu
        results.solver.statistics.black_box.number_of_function_evaluations = result.calls.get(
            "values", 0
        )
        results.solver.statistics.black_box.number_of_gradient_evaluations = result.calls.get(
            "derivatives", 0
        )
        return results, answer


_WITHOUT_POINT = frozenset(
    {Outcome.EVALUATION_ERROR, Outcome.REFUSED, Outcome.CRASHED, Outcome.FAILED}
)


def _has_point(result: IpoptResult) -> bool:
    if result.outcome in _WITHOUT_POINT or (result.status == NOT_SENT and not result.solved):
        return False
    return bool(np.all(np.isfinite(result.x)))


# A local solver finds infeasibility only near the start and proves nothing.
_SECOND_CONDITIONS = MappingProxyType({
    Outcome.SOLVED: second.TerminationCondition.convergenceCriteriaSatisfied,
    Outcome.ITERATION_LIMIT: second.TerminationCondition.iterationLimit,
    Outcome.TIME_LIMIT: second.TerminationCondition.maxTimeLimit,
    Outcome.INFEASIBLE: second.TerminationCondition.locallyInfeasible,
    Outcome.DIVERGED: second.TerminationCondition.unbounded,
    Outcome.STALLED: second.TerminationCondition.minStepLength,
    Outcome.INTERRUPTED: second.TerminationCondition.interrupted,
})  # fmt: skip


class _Loader(SolutionLoader):
    def __init__(self, model: Any, answer: PyomoAnswer) -> None:
        self._pyomo_model, self._answer = model, answer

    def get_number_of_solutions(self) -> int:
        return int(self._answer.x is not None)

    def get_vars(self, vars_to_load: Sequence[Any] | None = None) -> Mapping[Any, float]:
        if self._answer.x is None:
            raise NoSolutionError
        return _chosen(
            zip(self._answer.variables, self._answer.x.tolist(), strict=True), vars_to_load
        )

    def get_duals(self, cons_to_load: Sequence[Any] | None = None) -> Any:
        if self._answer.multipliers is None:
            raise NoDualsError
        return _chosen(
            zip(self._answer.equations, self._answer.multipliers[0].tolist(), strict=True),
            cons_to_load,
        )

    def get_reduced_costs(self, vars_to_load: Sequence[Any] | None = None) -> Mapping[Any, float]:
        if self._answer.multipliers is None:
            raise NoReducedCostsError
        _, lower, upper = self._answer.multipliers
        return _chosen(
            zip(self._answer.variables, np.add(lower, upper).tolist(), strict=True), vars_to_load
        )

    def load_solution(self) -> None:
        self._answer.load(self._pyomo_model)
        suffix = self._pyomo_model.component("rc")
        if isinstance(suffix, Suffix) and suffix.active and suffix.import_enabled():
            suffix.clear()
            if self._answer.multipliers is not None:
                suffix.update(self.get_reduced_costs())


def _chosen(pairs: Any, wanted: Sequence[Any] | None) -> Any:
    values = ComponentMap(pairs)
    return values if wanted is None else ComponentMap((item, values[item]) for item in wanted)


class ContribSolver(SolverBase):
    """A solver of the first interface, offered through Pyomo's second interface.

    from pyomo.contrib.solver.common.factory import SolverFactory
    results = SolverFactory("mpec_ipopt").solve(model, time_limit=60, load_solutions=False)
    results.solution_loader.load_vars()
    """

    def __init__(self, plugin: type[PyomoPlugin], **settings: Any) -> None:
        super().__init__(name=plugin.title, **settings)
        self.plugin = plugin
        self.last_result: Any = None

    def available(self) -> Availability:
        """Return full availability."""
        return Availability.FullLicense

    def version(self) -> tuple[int, ...]:
        """Return Ipopt's version."""
        return self.plugin().version()

    def solve(self, model: Any, **settings: Any) -> second.Results:
        """Solve; settings are those of `pyomo.contrib.solver.common.config.SolverConfig`.

        Raises
        ------
        ModelRefusedError, MissingValueError, UnknownOptionError
            before the solve starts
        NoOptimalSolutionError
            unless raise_exception_on_nonoptimal_result is False
        NoFeasibleSolutionError
            if there is no point to load, unless load_solutions is False
        """
        began, begun = perf_counter(), datetime.now(UTC)
        config = self.config(value=settings, preserve_implicit=True)
        options, plugin = config.solver_options.value(), self.plugin()
        with _shown_on(config.tee, options):
            _, answer = plugin.run(
                model, options=options, timelimit=config.time_limit, warmstart=False
            )
        self.last_result = plugin.last_result
        results = second.Results()
        results.solver_name, results.solver_version, results.solver_config = (
            self.name,
            self.version(),
            config,
        )
        results.termination_condition = _SECOND_CONDITIONS.get(
            answer.result.outcome, second.TerminationCondition.error
        )
        results.solution_status = _status(answer)
        results.solution_loader = _Loader(model, answer)
        results.incumbent_objective = (
            answer.result.objective if answer.is_feasible and answer.has_objective else None
        )
        results.extra_info.message = answer.result.message
        results.extra_info.iteration_count = answer.result.iterations
        results.timing_info.start_timestamp, results.timing_info.wall_time = (
            begun,
            perf_counter() - began,
        )
        if (
            config.raise_exception_on_nonoptimal_result
            and results.solution_status is not second.SolutionStatus.optimal
        ):
            raise NoOptimalSolutionError(
                f"{NoOptimalSolutionError.default_message} It ended with: {answer.result.message}"
            )
        if config.load_solutions:
            if answer.x is None:
                raise NoFeasibleSolutionError
            results.solution_loader.load_solution()
        return results


def _status(answer: PyomoAnswer) -> second.SolutionStatus:
    if answer.x is None:
        return second.SolutionStatus.noSolution
    if answer.result.outcome is Outcome.SOLVED:
        return second.SolutionStatus.optimal
    return (
        second.SolutionStatus.feasible if answer.is_feasible else second.SolutionStatus.infeasible
    )
