"""Solve a compiled problem by one run of Ipopt, through cyipopt, and judge the answer before believing it.

A start is what the caller has: a point, perhaps multipliers, perhaps only some of them.
"""

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

# Limits of the barrier parameter that a primal-dual start begins with: Ipopt's own first value, and
# about its last.
_MU_LARGEST = 0.1
_MU_SMALLEST = 1e-9


@dataclass(frozen=True, kw_only=True)
class Start:
    """x (n,).

    Multipliers lagrange (m,), zl, zu (n,) in Ipopt's signs, or None for a primal start.
    """

    x: np.ndarray
    lagrange: np.ndarray | None = None
    zl: np.ndarray | None = None
    zu: np.ndarray | None = None


def _complete_start(problem: IpoptProblem, given: Start | None) -> tuple[Start, int]:
    """The start with all multipliers or none, and the number of variables that had no value.

    Missing lagrange are 0; missing zl and zu are what stationarity leaves to them. Raises
    ValueError for a wrong shape or a NaN.
    """
    if given is None:
        x, missing = problem.start()
        return Start(x=x), missing
    x = _checked("x", given.x, problem.n)
    if given.lagrange is None and given.zl is None and given.zu is None:
        return Start(x=x), 0
    lagrange = (
        np.zeros(problem.m)
        if given.lagrange is None
        else _checked("lagrange", given.lagrange, problem.m)
    )
    zl = None if given.zl is None else _checked("zl", given.zl, problem.n)
    zu = None if given.zu is None else _checked("zu", given.zu, problem.n)
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
    """Options of a primal-dual start.

    The barrier parameter is the mean complementarity of what was given.
    """
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
    """Version of the Ipopt that runs."""
    return tuple(int(part) for part in cyipopt.IPOPT_VERSION)


def version() -> str:
    """Versions of cyipopt and Ipopt in words."""
    return f"cyipopt {cyipopt.__version__}, Ipopt {'.'.join(str(part) for part in ipopt_version())}"


def run(
    problem: IpoptProblem,
    functions: Evaluations,
    start: Start,
    options: Mapping[str, str | int | float],
) -> IpoptExit:
    """One run of Ipopt, from a complete start.

    Raises
    ------
    UnknownOptionError
        for a value that Ipopt does not take
    BaseException
        what a callback raised, as it was
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


# Multipliers of constraints that repeat each other grow without end where rounding hides it. Of
# 1210 solves of random quadratic programs with repeated equations 21 did not end, 18 of them with
# more than this; of those that ended one did. With perturb_always_cd all ended.
_ENDLESS = 1e8
_RESTORATION = -2
# Ipopt stops as diverging where a variable passes 1e20: an objective that went along is below this,
# in any unit.
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
    """Minimise from `warm_start` (default: the current values of the model's variables).

    The model is left as it is.

    Parameters
    ----------
    problem : the compiled model
    options : Ipopt options by name; one of MUMPS asks for MUMPS, unless linear_solver is given
    warm_start : with multipliers (some or all), Ipopt starts primal-dual; `mu_init` defaults to the
        mean complementarity given
    callback : called after each iteration; returning False stops (Outcome.INTERRUPTED), an
        exception propagates
    time_limit : wall time [s], checked once an iteration

    Raises
    ------
    UnknownOptionError
        for an unknown option, before anything runs
    ValueError
        for a start of another shape or with numbers that are not finite, and for a time limit that
        is not positive
    MachineError
        where a linear solver is insisted on that cannot be had
    """
    asked = checked_options(options or {})
    factorised_by = linear_solver(
        _asked_for(asked)
    )  # compiled at its first use, which no solve is to blame for
    begin, cpu = time.perf_counter(), time.process_time()
    start, missing = _complete_start(problem, warm_start)
    used: dict[str, str | int | float] = {
        **DEFAULTS,
        "linear_solver": factorised_by,
        **_warm_options(problem, start),
        **asked,
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


def _asked_for(options: Mapping[str, Any]) -> str:
    """The linear solver that is named, or whose own options are."""
    return str(
        options.get("linear_solver", "")
        or (MUMPS if any(name.startswith("mumps_") for name in options) else "")
    )


class _Recorder:
    """Ipopt's intermediate callback: keeps the log and asks the caller whether to go on."""

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
    """An answer where nothing is left for Ipopt: contradicting bounds, a false constraint of numbers, no variable at all."""
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


# Names listed in a sentence.
_NAMES = 4


def _judge(
    problem: IpoptProblem, answer: IpoptExit, options: Mapping[str, Any]
) -> tuple[Outcome, str, Residuals]:
    """Ipopt's claim, checked: no 'solved' without residuals that say so."""
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
    tolerance = 10.0 * float(
        options.get("tol", 0.0)
    )  # a caller who asks for less is judged by what was asked
    if certificate.meets(tolerance):
        return outcome, message, certificate
    return (
        Outcome.STALLED,
        f"{name_of(answer.status)}, but {certificate.sentence} does not meet the tolerances",
        certificate,
    )


def _too_many_equations(problem: IpoptProblem) -> str:
    """Return a sentence on more equations than free variables; empty if there are not more."""
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
    """List the first names."""
    return ", ".join(names[:_NAMES]) + (", .." if len(names) > _NAMES else "")


def _undefined(problem: IpoptProblem, x: np.ndarray) -> str:
    """Which function is no number where Ipopt stopped."""
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
        return ""  # which is told of every end
    return "; all functions have finite values there, so that one of their derivatives has none"


def repeats_constraints(result: IpoptResult) -> bool:
    """Whether Ipopt ended as where constraints repeat each other, and the option that copes with them was not set.

    That is with multipliers without end, or by giving up the search for a feasible point at one.
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
    """What may help where dependent constraints kept Ipopt from an end; empty elsewhere."""
    if options.get("perturb_always_cd") == "yes" or not _is_endless(outcome, lagrange):
        return ""
    largest = float(np.max(np.abs(lagrange)))
    return f"; multipliers up to {largest:.0e}: constraints may repeat each other there, which the option perturb_always_cd='yes' can cope with"


def _is_unbounded(problem: IpoptProblem, x: np.ndarray) -> bool:
    """Whether iterates that left for infinity took the objective down with them, along points that are feasible but for rounding.

    Of a row that is the rounding of its terms: where it levels off far out, as exp(-x) >= 1e-3
    does, they are small, and it is violated there.
    """
    row, column = problem.jacobianstructure()
    with np.errstate(all="ignore"):  # what is no number, or infinite, is not below
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
