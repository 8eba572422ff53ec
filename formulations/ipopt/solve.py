"""Solve a compiled problem with one run of Ipopt, and check the answer by its residuals."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import cyipopt
import numpy as np
from pyomo.core.expr.visitor import identify_variables

from formulations.ipopt.linear_solver import MUMPS, linear_solver, settings
from formulations.ipopt.options import (
    DEFAULTS,
    WARM_START_DEFAULTS,
    UnknownOptionError,
    checked_options,
)
from formulations.ipopt.problem import Evaluations, IpoptProblem
from formulations.ipopt.result import (
    FEASIBILITY,
    NOT_SENT,
    UNKNOWN,
    IpoptExit,
    IpoptResult,
    Iteration,
    Residuals,
    bound_products,
    name_of,
    outcome_of,
    residuals,
)
from formulations.ipopt.slopes import endless_slope
from formulations.solution import Outcome, Seconds

# Largest initial barrier parameter of a primal-dual start: Ipopt's default first value.
_MU_LARGEST = 0.1
# Smallest initial barrier parameter: roughly Ipopt's last value.
_MU_SMALLEST = 1e-9


@dataclass(frozen=True, kw_only=True)
class Start:
    """A start: x (n,), and for a primal-dual start lagrange (m,), zl (n,), zu (n,).

    Multipliers have Ipopt's signs; None is a missing multiplier.
    """

    x: np.ndarray
    lagrange: np.ndarray | None = None
    zl: np.ndarray | None = None
    zu: np.ndarray | None = None


def _complete_start(problem: IpoptProblem, start: Start | None) -> tuple[Start, int]:
    """Return the start with all multipliers or none, and the number of variables without a value.

    Missing lagrange are 0; missing zl and zu follow from stationarity.
    """
    if start is None:
        x, missing = problem.start()
        return Start(x=x), missing
    x = _checked("x", start.x, problem.n)
    if start.lagrange is None and start.zl is None and start.zu is None:
        return Start(x=x), 0
    lagrange = (
        np.zeros(problem.m)
        if start.lagrange is None
        else _checked("lagrange", start.lagrange, problem.m)
    )
    zl = None if start.zl is None else _checked("zl", start.zl, problem.n)
    zu = None if start.zu is None else _checked("zu", start.zu, problem.n)
    if zl is None or zu is None:
        slope = np.nan_to_num(
            problem.lagrangian_gradient(x, lagrange), nan=0.0, posinf=0.0, neginf=0.0
        )
        if zl is None:
            zl = np.where(np.isfinite(problem.lower), np.maximum(slope, 0.0), 0.0)
        if zu is None:
            zu = np.where(np.isfinite(problem.upper), np.maximum(-slope, 0.0), 0.0)
    return Start(x=x, lagrange=lagrange, zl=zl, zu=zu), 0


def _checked(name: str, values: np.ndarray, size: int) -> np.ndarray:
    array = np.array(values, dtype=float)
    if array.shape != (size,):
        raise ValueError(f"warm_start.{name} has shape {array.shape}, the problem needs ({size},)")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"warm_start.{name} holds a number that is not finite")
    return array


def _warm_options(problem: IpoptProblem, start: Start) -> dict[str, str | int | float]:
    if start.lagrange is None or start.zl is None or start.zu is None:
        return {}
    inequality = problem.constraint_lower < problem.constraint_upper
    products = bound_products(
        problem,
        start.x,
        problem.constraints(start.x),
        start.lagrange,
        start.zl,
        start.zu,
        inequality,
    )
    products = products[np.isfinite(products)]
    mean = float(np.mean(products)) if products.size else _MU_SMALLEST
    return {**WARM_START_DEFAULTS, "mu_init": min(_MU_LARGEST, max(_MU_SMALLEST, mean))}


def ipopt_version() -> tuple[int, ...]:
    """Return the version of the installed Ipopt."""
    return tuple(int(part) for part in cyipopt.IPOPT_VERSION)


def version() -> str:
    """Return the versions of cyipopt and Ipopt as text."""
    return f"cyipopt {cyipopt.__version__}, Ipopt {'.'.join(str(part) for part in ipopt_version())}"


def run(
    problem: IpoptProblem,
    functions: Evaluations,
    start: Start,
    options: Mapping[str, str | int | float],
) -> IpoptExit:
    """Run Ipopt once, from a complete start.

    Raises UnknownOptionError for a value that Ipopt rejects, and a callback's exception unchanged.
    """
    nlp = cyipopt.Problem(
        n=problem.n,
        m=problem.m,
        problem_obj=functions,
        lb=problem.lower,
        ub=problem.upper,
        cl=problem.constraint_lower,
        cu=problem.constraint_upper,
    )
    try:
        for name, value in options.items():
            for part, setting in settings(name, value):
                try:
                    nlp.add_option(part, setting)
                except TypeError as error:
                    raise UnknownOptionError(
                        f"Ipopt does not accept {value!r} for the option '{name}'"
                    ) from error
        duals = (
            {}
            if start.lagrange is None
            else {"lagrange": start.lagrange, "zl": start.zl, "zu": start.zu}
        )
        x, info = nlp.solve(start.x, **duals)
    finally:
        nlp.close()
    if functions.error is not None:
        raise functions.error
    return IpoptExit(
        status=int(info["status"]),
        x=np.array(x, dtype=float),
        lagrange=np.array(info["mult_g"], dtype=float).reshape(problem.m),
        zl=np.array(info["mult_x_L"], dtype=float),
        zu=np.array(info["mult_x_U"], dtype=float),
    )


# Multipliers of dependent constraints grow without limit if rounding hides the dependence. In 1210
# random quadratic programs with repeated equations 21 did not converge, 18 of them with multipliers
# above this limit; only one converged problem exceeded it. With perturb_always_cd all converged.
_ENDLESS = 1e8
# Ipopt's status of a failed restoration.
_RESTORATION = -2
# Ipopt reports divergence when a variable exceeds 1e20. An objective that diverges too is below
# -1e8 in any unit.
_UNBOUNDED = 1e8

Callback = Callable[[Iteration], "bool | None"]


def solve(
    problem: IpoptProblem,
    *,
    options: Mapping[str, Any] | None = None,
    warm_start: Start | None = None,
    callback: Callback | None = None,
    time_limit: float | None = None,
) -> IpoptResult:
    """Minimise from `warm_start`, by default from the current values of the model's variables.

    The model is not changed.

    Parameters
    ----------
    problem : the compiled model
    options : Ipopt options by name; a MUMPS option selects MUMPS unless linear_solver is set
    warm_start : with any multipliers Ipopt starts primal-dual; `mu_init` then defaults to the mean
        complementarity of the start
    callback : called after each iteration; False stops the solve (Outcome.INTERRUPTED), an
        exception propagates
    time_limit : wall time [s], checked once per iteration

    Raises
    ------
    UnknownOptionError
        for an unknown option, before the solve starts
    ValueError
        for a start of a wrong shape or with non-finite numbers, or a time limit that is not
        positive
    MachineError
        if the selected linear solver is not available
    """
    user_options = checked_options(options or {})
    # Compiled at the first use, before the clock of the solve starts.
    factorised_by = linear_solver(_requested_solver(user_options))
    begin, cpu = time.perf_counter(), time.process_time()
    start, missing = _complete_start(problem, warm_start)
    used: dict[str, str | int | float] = {
        **DEFAULTS,
        "linear_solver": factorised_by,
        **_warm_options(problem, start),
        **user_options,
    }
    if time_limit is not None:
        if not time_limit > 0:
            raise ValueError(f"time_limit is a positive number of seconds, not {time_limit!r}")
        used["max_wall_time"] = float(time_limit)
    recorder = _Recorder(problem.sense, callback)
    functions = Evaluations(problem, recorder)

    answer = _decided_without_ipopt(problem, start)
    if answer is None:
        answer = run(problem, functions, start, used)
    wall = time.perf_counter() - begin
    outcome, message, certificate = _judge(problem, answer, used)
    message += _hint(outcome, answer.lagrange, used)
    if outcome is not Outcome.SOLVED and (endless := endless_slope(problem, answer.x)):
        message += f"; {endless}"
    if missing:
        message += f"; {missing} variable(s) without a value started from the point of their bounds nearest 0"
    return IpoptResult(
        **{**vars(answer), "message": message},
        outcome=outcome,
        objective=problem.sense * problem.objective(answer.x),
        iterations=recorder.lines[-1].iteration if recorder.lines else 0,
        residuals=certificate,
        history=tuple(recorder.lines),
        seconds=Seconds(
            evaluate=functions.seconds,
            linear_algebra=max(0.0, wall - functions.seconds - recorder.seconds),
            wall=wall,
            cpu=time.process_time() - cpu,
        ),
        calls=MappingProxyType(functions.calls),
        options=MappingProxyType(used),
        version=version(),
    )


def _requested_solver(options: Mapping[str, Any]) -> str:
    return str(
        options.get("linear_solver", "")
        or (MUMPS if any(name.startswith("mumps_") for name in options) else "")
    )


class _Recorder:
    """Ipopt's intermediate callback: store the log, and return whether to continue."""

    def __init__(self, sense: int, callback: Callback | None) -> None:
        self.lines: list[Iteration] = []
        self.seconds = 0.0
        self._sense = sense
        self._callback = callback

    def __call__(self, mode: int, iteration: int, objective: float, *others: float) -> bool:
        *measures, trials = others
        line = Iteration(
            int(iteration),
            bool(mode),
            self._sense * float(objective),
            *map(float, measures),
            trials=int(trials),
        )
        self.lines.append(line)
        if self._callback is None:
            return True
        begin = time.perf_counter()
        go_on = self._callback(line)
        self.seconds += time.perf_counter() - begin
        return go_on is None or bool(go_on)


def _decided_without_ipopt(problem: IpoptProblem, start: Start) -> IpoptExit | None:
    """Return an answer for crossing bounds, a false trivial constraint, or no free variable."""
    violation, name = problem.trivial_violation()
    crossed = np.flatnonzero(problem.lower > problem.upper)
    ranges = np.flatnonzero(problem.constraint_lower > problem.constraint_upper)
    message = None
    if not violation <= FEASIBILITY:
        message = f"constraint '{name}' holds no free variable and is violated by {violation:.3g}"
    elif crossed.size:
        message = f"variable '{problem.variables[crossed[0]].name}' has a lower bound above its upper bound"
    elif ranges.size:
        message = f"constraint '{problem.equations[ranges[0]].name}' has a lower bound above its upper bound"
    elif problem.n == 0:
        message = ""
    if message is None:
        return None
    zero = np.zeros(problem.n)
    return IpoptExit(
        status=NOT_SENT,
        message=message,
        x=start.x,
        lagrange=np.zeros(problem.m),
        zl=zero,
        zu=zero.copy(),
    )


# Names listed in one message.
_NAMES = 4


def _judge(
    problem: IpoptProblem, answer: IpoptExit, options: Mapping[str, Any]
) -> tuple[Outcome, str, Residuals]:
    vectors = (answer.x, answer.lagrange, answer.zl, answer.zu)
    finite = all(np.isfinite(v).all() for v in vectors)
    certificate = residuals(problem, *vectors) if finite else UNKNOWN
    if answer.status == NOT_SENT:
        if answer.message:
            return Outcome.INFEASIBLE, answer.message, certificate
        if not np.isfinite(problem.objective(answer.x)):
            return (
                Outcome.EVALUATION_ERROR,
                "there is no free variable, and the objective is not a finite number",
                certificate,
            )
        return Outcome.SOLVED, "there is no free variable; all constraints hold", certificate
    outcome = outcome_of(answer.status)
    message = f"{name_of(answer.status)}: {certificate.sentence}"
    if outcome is Outcome.EVALUATION_ERROR:
        message += _undefined(problem, answer.x)
    if outcome is Outcome.REFUSED:
        message = (
            f"{name_of(answer.status)}: {_too_many_equations(problem) or certificate.sentence}"
        )
    if outcome is Outcome.DIVERGED and not (finite and _is_unbounded(problem, answer.x)):
        return (
            Outcome.STALLED,
            f"{message}; the objective does not fall without end there at feasible points",
            certificate,
        )
    if outcome is not Outcome.SOLVED:
        return outcome, message, certificate
    if not finite or certificate.constraint_violation != certificate.constraint_violation:
        return (
            Outcome.EVALUATION_ERROR,
            f"{name_of(answer.status)}, but the point holds numbers that are not finite",
            certificate,
        )
    # A caller who sets a looser tol is judged by that tol.
    tolerance = 10.0 * float(options.get("tol", 0.0))
    if certificate.meets(tolerance):
        return outcome, message, certificate
    return (
        Outcome.STALLED,
        f"{name_of(answer.status)}, but {certificate.sentence} does not meet the tolerances",
        certificate,
    )


def _too_many_equations(problem: IpoptProblem) -> str:
    equal = np.flatnonzero(problem.constraint_lower == problem.constraint_upper)
    if len(equal) <= problem.n:
        return ""
    fixed = dict.fromkeys(
        variable.name
        for row in equal
        for variable in identify_variables(problem.equations[row].body)
        if variable.fixed
    )
    free = _some([variable.name for variable in problem.variables])
    unfix = f"unfix {_some(list(fixed))} or " if fixed else ""
    noun = "variable" if problem.n == 1 else "variables"
    return (
        f"{len(equal)} equations for {problem.n} free {noun} ({free}): {unfix}leave an equation out"
    )


def _some(names: list[str]) -> str:
    return ", ".join(names[:_NAMES]) + (", .." if len(names) > _NAMES else "")


def _undefined(problem: IpoptProblem, x: np.ndarray) -> str:
    if not np.all(np.isfinite(x)):
        name = problem.variables[int(np.flatnonzero(~np.isfinite(x))[0])].name
        return f"; variable '{name}' is no finite number there: give it one to start from"
    undefined = np.flatnonzero(~np.isfinite(problem.constraints(x)))
    if undefined.size:
        more = f" and {undefined.size - 1} more" if undefined.size > 1 else ""
        return f"; constraint '{problem.equations[undefined[0]].name}'{more} has no finite value there: start where it has, or bound what it takes"
    if not np.isfinite(problem.objective(x)):
        return (
            "; the objective has no finite value there: start where it has, or bound what it takes"
        )
    if endless_slope(problem, x):
        return ""
    return "; all functions have finite values there, but a derivative does not"


def repeats_constraints(result: IpoptResult) -> bool:
    """Return whether dependent constraints may have stopped Ipopt, without perturb_always_cd set.

    They cause multipliers above the limit, or a failed restoration at a feasible point.
    """
    if result.options.get("perturb_always_cd") == "yes":
        return False
    gave_up = result.status == _RESTORATION and result.residuals.constraint_violation <= FEASIBILITY
    return gave_up or _is_endless(result.outcome, result.lagrange)


def _is_endless(outcome: Outcome, lagrange: np.ndarray) -> bool:
    return outcome in (Outcome.STALLED, Outcome.ITERATION_LIMIT) and bool(
        np.max(np.abs(lagrange), initial=0.0) > _ENDLESS
    )


def _hint(outcome: Outcome, lagrange: np.ndarray, options: Mapping[str, Any]) -> str:
    if options.get("perturb_always_cd") == "yes" or not _is_endless(outcome, lagrange):
        return ""
    largest = float(np.max(np.abs(lagrange)))
    return f"; multipliers up to {largest:.0e}: constraints may be dependent; try the option perturb_always_cd='yes'"


def _is_unbounded(problem: IpoptProblem, x: np.ndarray) -> bool:
    """Return whether the objective decreased without limit along points feasible up to rounding.

    The rounding of a row is that of its terms. A row that levels off, such as exp(-x) >= 1e-3, has
    small terms far out, and its violation counts.
    """
    row, column = problem.jacobianstructure()
    with np.errstate(all="ignore"):  # non-finite values compare as False
        g, terms = (
            problem.constraints(x),
            np.bincount(row, np.abs(problem.jacobian(x) * x[column]), problem.m),
        )
        rows = np.maximum(
            problem.constraint_lower - g, g - problem.constraint_upper
        ) < FEASIBILITY * np.maximum(1.0, terms)
        bounds = np.maximum(problem.lower - x, x - problem.upper) < FEASIBILITY * np.maximum(
            1.0, np.abs(x)
        )
    return problem.objective(x) < -_UNBOUNDED and bool(np.all(rows) and np.all(bounds))
