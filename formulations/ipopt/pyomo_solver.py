"""SolverFactory("touchstone_ipopt"): this bridge behind Pyomo's own solver interface, for any smooth model.

    import formulations
    solver = pyo.SolverFactory("touchstone_ipopt")
    solver.options["tol"] = 1e-9
    results = solver.solve(model, tee=True, timelimit=60)
    pyo.assert_optimal_termination(results)

Suffixes as with Pyomo's ipopt: `dual`, `ipopt_zL_out`, `ipopt_zU_out` are filled where the model
imports them; with warmstart=True (or the option warm_start_init_point=yes) `dual`, `ipopt_zL_in`,
`ipopt_zU_in` start the next solve where the model exports them. After a solve `solver.last_result`
is the IpoptResult: history, unscaled residuals, where the time went.

Where equations repeat each other Ipopt may miss an end by rounding: multipliers grow without one,
or it gives up at a feasible point. Such a solve is made once more with its option
perturb_always_cd, which its message says, and may take as many iterations again; setting the option
to yes or no leaves it at one solve.

Signs of multipliers. Ipopt: L = sense*f + lagrange' g - zl' x + zu' x with zl, zu >= 0. Pyomo (as
its ipopt interface reports them): a dual is the change of the model's objective when the
constraint's bound grows by one, so that `min x, x >= 1` has dual +1; ipopt_zL_out and ipopt_zU_out
likewise for the bounds of a variable, so zU is negative when minimising.

`PyomoAnswer` and `PyomoPlugin` are the outward manners of a Pyomo solver, shared by all that are
registered here:

    class Solver(PyomoPlugin):
        title = "name_in_the_factory"
        def run(self, model, *, options, timelimit, warmstart): -> (SolverResults, PyomoAnswer)

`ContribSolver` is such a solver by Pyomo's second interface: results as an object, solutions loaded
when asked for, errors unless the answer is optimal.

    # the names are those of the first interface
    from pyomo.contrib.solver.common.factory import SolverFactory
    results = SolverFactory("mpec_ipopt").solve(model, time_limit=60, solver_options={"strategy": "scholtes"}, load_solutions=False)
    results.termination_condition, results.solution_status, results.incumbent_objective
    results.solution_loader.load_vars()
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
    """The start that the model's values and export suffixes describe.

    None where they hold no multiplier.
    """
    found = {
        "lagrange": _exported(problem.model, "dual", problem.equations),
        "zl": _exported(problem.model, "ipopt_zL_in", problem.variables),
        "zu": _exported(problem.model, "ipopt_zU_in", problem.variables),
    }
    if all(values is None for values in found.values()):
        return None
    signs = {"lagrange": -problem.sense, "zl": problem.sense, "zu": -problem.sense}
    given = {name: signs[name] * values for name, values in found.items() if values is not None}
    return Start(x=problem.start()[0], **given)


def _exported(model: Any, name: str, components: tuple[Any, ...]) -> np.ndarray | None:
    """Values of the export suffixes of this name, on any active block.

    A component without entry has 0; None for no entry at all.
    """
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


# Outcome -> (status, termination condition); STALLED is refined in `PyomoAnswer`. "optimal" is what
# Pyomo's own ipopt reports for a KKT point.
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
    """What a solver found, as Pyomo's results, suffixes and models take it.

    found: the solver's own result, with outcome, message, objective and iterations
    is_feasible: whether the point is known to satisfy the model; x (n,): values of `variables`,
        None for no point that is worth loading
    multipliers: dual (m,) of `equations`, zL, zU (n,), in Pyomo's signs; None where there are none
    pair_multipliers: (complementarity, (of its first argument, of its second)), in the same signs
    """

    found: Any
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
        """Pyomo's report of the solve, without the point.

        A stalled solve is `feasible` only where its point is.
        """
        results = SolverResults()
        facts = results.problem
        facts.name = model.name
        facts.sense = ProblemSense.minimize if self.sense == 1 else ProblemSense.maximize
        facts.number_of_objectives = int(self.has_objective)
        facts.number_of_constraints = len(self.equations)
        facts.number_of_variables = facts.number_of_continuous_variables = len(self.variables)
        facts.number_of_binary_variables = facts.number_of_integer_variables = 0
        if self.is_feasible and np.isfinite(
            self.found.objective
        ):  # a feasible point bounds the optimum from one side
            if self.sense == 1:
                facts.upper_bound = self.found.objective
            else:
                facts.lower_bound = self.found.objective
        report = results.solver
        report.name = solver
        report.status, report.termination_condition = _CONDITIONS[self.found.outcome]
        if self.found.outcome is Outcome.STALLED and self.is_feasible:
            report.termination_condition = TerminationCondition.feasible
        report.message = report.termination_message = self.found.message
        report.wallclock_time = self.wall
        report.statistics.black_box.number_of_iterations = self.found.iterations
        return results

    def load(self, model: Any) -> None:
        """Write the point into the variables, and multipliers into the import suffixes that the model declares; suffixes without any are emptied."""
        if self.x is None:
            return
        write_point(self.variables, self.x)
        found: dict[str, Any] = dict.fromkeys(("dual", "ipopt_zL_out", "ipopt_zU_out"), ())
        if self.multipliers is not None:
            owners = (self.equations, self.variables, self.variables)
            found = {
                name: zip(owner, values.tolist(), strict=True)
                for name, owner, values in zip(found, owners, self.multipliers, strict=True)
            }
        for name, values in {**found, "pair_dual": self.pair_multipliers}.items():
            suffix = model.component(name)
            if isinstance(suffix, Suffix) and suffix.active and suffix.import_enabled():
                suffix.clear()
                suffix.update(values)

    def carry(self, results: SolverResults) -> SolverResults:
        """The same results with the point in them, for `model.solutions.load_from(results)`."""
        if self.x is None:
            return results
        symbols, solution = SymbolMap(), Solution()
        label, row_label = NumericLabeler("x"), NumericLabeler("c")
        solution.status = (
            SolutionStatus.optimal
            if self.found.outcome is Outcome.SOLVED
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
    """Multipliers in Pyomo's signs, from Ipopt's.

    Raises nothing.

    Parameters
    ----------
    sense : +1 to minimise, -1 to maximise
    lagrange : (m,) of the constraints [objective per constraint]
    zl, zu : (n,) of the bounds [objective per variable]

    Returns
    -------
    dual (m,), zL (n,), zU (n,): the change of the model's objective when a bound grows by one
    """
    return -sense * lagrange, sense * zl, -sense * zu


logger = logging.getLogger(__name__)

# Keywords of Pyomo's file-based solvers that have nothing to act on here: no file is written, no
# name is shortened.
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
    """What Pyomo asks of a solver.

    `options` stays from solve to solve, `last_result` is what the last one found, in this package's
    own words.
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

    # -- what Pyomo asks of a solver
    #   ----------------------------------------------------------------------------------------------

    def available(self, exception_flag: bool = False) -> bool:
        """True: importing the package needs Ipopt."""
        return True

    def license_is_valid(self) -> bool:
        """True: no license is needed."""
        return True

    def warm_start_capable(self) -> bool:
        """True: a solve starts from the model's values."""
        return True

    def has_capability(self, capability: str) -> bool:
        """Whether models of this kind can be solved."""
        return capability in {"linear", "quadratic_objective", "quadratic_constraint"}

    def version(self) -> tuple[int, ...]:
        """Version of the Ipopt that would run."""
        return ipopt_version()

    def set_options(self, text: str) -> None:
        """Options as 'name=value name=value'."""
        self.options.update(_options_of_text(text))

    def reset(self) -> None:
        """Forget the last result."""
        self.last_result = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        return None

    # -- solving
    #   ------------------------------------------------------------------------------------------------------------------

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
        """Translate, solve and (by default) load. `logfile` takes Ipopt's log, and how it ended.

        As with Pyomo's own solvers a result with a warning is loaded and logged. KeyboardInterrupt
        leaves the model as it was.

        Raises
        ------
        ModelRefusedError
            for what cannot be treated, before anything runs
        ValueError
            for a result that is an error, unless load_solutions is False
        OSError
            for a log file that cannot be written
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
                log.write(f"{self.title}: {answer.found.message}\n")
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
        """Solve, keep `last_result`, and say it in Pyomo's words. The model is only read."""


def _shown_on(streams: Sequence[Any], options: dict[str, Any]) -> Any:
    """Ipopt's log on these streams while the context lasts; nothing is said to none."""
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


_AGAIN = "once more with perturb_always_cd='yes', because constraints may repeat each other"


class TouchstoneIpopt(PyomoPlugin):
    """A Pyomo solver object.

    `options` holds Ipopt options; `last_result` is the IpoptResult of the last solve.
    """

    title = "touchstone_ipopt"

    def run(
        self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool
    ) -> tuple[SolverResults, PyomoAnswer]:
        """Solve, and once more with `perturb_always_cd` where constraints may repeat each other."""
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
            found=result,
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
    """Whether x is worth loading: Ipopt worked on it, and it is a point."""
    if result.outcome in _WITHOUT_POINT or (result.status == NOT_SENT and not result.solved):
        return False
    return bool(np.all(np.isfinite(result.x)))


# Infeasible only near the start: a local solver proves nothing.
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
    """One answer, on its way into the model."""

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

    def solve(self, model: Any, **settings: Any) -> second.Results:
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
            answer.found.outcome, second.TerminationCondition.error
        )
        results.solution_status = _status(answer)
        results.solution_loader = _Loader(model, answer)
        results.incumbent_objective = (
            answer.found.objective if answer.is_feasible and answer.has_objective else None
        )
        results.extra_info.message = answer.found.message
        results.extra_info.iteration_count = answer.found.iterations
        results.timing_info.start_timestamp, results.timing_info.wall_time = (
            begun,
            perf_counter() - began,
        )
        if (
            config.raise_exception_on_nonoptimal_result
            and results.solution_status is not second.SolutionStatus.optimal
        ):
            raise NoOptimalSolutionError(
                f"{NoOptimalSolutionError.default_message} It ended with: {answer.found.message}"
            )
        if config.load_solutions:
            if answer.x is None:
                raise NoFeasibleSolutionError
            results.solution_loader.load_solution()
        return results


def _status(answer: PyomoAnswer) -> second.SolutionStatus:
    if answer.x is None:
        return second.SolutionStatus.noSolution
    if answer.found.outcome is Outcome.SOLVED:
        return second.SolutionStatus.optimal
    return (
        second.SolutionStatus.feasible if answer.is_feasible else second.SolutionStatus.infeasible
    )
