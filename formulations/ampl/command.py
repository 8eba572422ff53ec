"""`touchstone-mpec STUB -AMPL [name=value ..]`: the MPEC solver as a solver of AMPL.

    touchstone-mpec bard1                          read bard1.nl, print the result
    touchstone-mpec bard1 -AMPL strategy=scholtes  write bard1.sol, for AMPL, JuMP or Pyomo
    touchstone-mpec -=                             list the options

The environment variable touchstone_mpec_options='strategy=scholtes max_iter=500' sets options too;
those of the command line have priority.
"""

from __future__ import annotations

import math
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from importlib import metadata
from pathlib import Path
from typing import Any

import pyomo.environ  # noqa: F401 - before our own modules that need it

from formulations.ampl.nl import Header, NlError, NlProblem, read_problem
from formulations.ipopt import MissingValueError, ModelRefusedError, UnknownOptionError
from formulations.mpec import MpecSettings, read_settings
from formulations.mpec.result import MpecResult, is_feasible
from formulations.mpec.solve import solve_mpec
from formulations.solution import Outcome

NAME = "touchstone-mpec"
# AMPL's environment variables for options.
_ENVIRONMENT = ("touchstone_mpec_options", f"{NAME}_options")
_USAGE = f"usage: {NAME} STUB [-AMPL] [name=value ..]     (STUB.nl is read; with -AMPL, STUB.sol is written; {NAME} -= names the options)"
# Options of the command; further ones are those of `mpec_ipopt` and of Ipopt.
_OWN = {
    "objno": "which objective, from 1; 0 for none (1)",
    "relax_integers": "1: integer variables become continuous (0)",
    "timelimit": "wall time in seconds (none)",
    "outlev": "0: nothing is printed, 1: how it ended (1; with -AMPL 0, since AMPL prints it)",
}


# AMPL's smallest code of a problem without a solution.
_NO_SOLUTION = 200


def main(words: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    0: an answer was written for AMPL or a solution printed; 1: no solution; 2: invalid input;
    3: the answer cannot be written.
    """
    arguments = list(sys.argv[1:] if words is None else words)
    flags, rest = (
        [word for word in arguments if word.startswith("-")],
        [word for word in arguments if not word.startswith("-")],
    )
    if "-v" in flags or "--version" in flags:
        return _print(f"{NAME} {metadata.version('touchstone-contact')}")
    if "-=" in flags:
        return _print(_options_in_words())
    stubs = [word for word in rest if "=" not in word]
    if len(stubs) != 1 or set(flags) - {"-AMPL", "-s"} or "-?" in flags:
        print(_USAGE, file=sys.stderr)
        return 2
    for_ampl = bool({"-AMPL", "-s"} & set(flags))
    environment = next((os.environ[name] for name in _ENVIRONMENT if name in os.environ), "")
    try:
        message, code = _solved(
            Path(stubs[0]),
            [*shlex.split(environment), *(word for word in rest if "=" in word)],
            for_ampl,
        )
    except _RefusedError as refused:
        print(f"{NAME}: {refused}", file=sys.stderr)
        return 2
    except _UnwrittenError as unwritten:
        print(f"{NAME}: {unwritten}", file=sys.stderr)
        return 3
    written = _print(message) if message else 0
    return written or (1 if code >= _NO_SOLUTION and not for_ampl else 0)


def _print(text: str) -> int:
    if sys.stdout is None:  # standard output is closed
        print(f"{NAME}: the answer cannot be written: standard output is closed.", file=sys.stderr)
        return 3
    try:
        print(text, flush=True)
    except OSError as error:
        # Python does not flush the stream again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"{NAME}: the answer cannot be written: {error.strerror}.", file=sys.stderr)
        return 3
    return 0


class _RefusedError(Exception):
    """Exit code 2, with one sentence."""


class _UnwrittenError(Exception):
    """Exit code 3, with one sentence."""


def _solved(stub: Path, words: list[str], for_ampl: bool) -> tuple[str, int]:
    """Solve, and write the answer for AMPL; return the text to print and AMPL's code."""
    own, solver_options = _split(words)
    try:
        problem = read_problem(
            stub, objective=own["objno"], relax_integers=bool(own["relax_integers"])
        )
    except NlError as error:
        raise _RefusedError(str(error)) from error
    target = problem.file.with_suffix(".sol")
    duals: Sequence[float] = ()
    values: Sequence[float] = ()
    of_rows: dict[str, dict[int, float]] = {}
    try:
        result = solve_mpec(
            problem.model, read_settings(solver_options), time_limit=own["timelimit"]
        )
        message, code = f"{NAME}: {_sentence(result)}", _code(result)
        if result.has_point:
            duals, values, of_rows = (
                _duals(problem, result),
                _values(problem, result),
                _suffixes(problem, result),
            )
    except (ModelRefusedError, MissingValueError, UnknownOptionError) as error:
        message, code = f"{NAME}: {error}", 500
        if not for_ampl:
            raise _RefusedError(str(error)) from error
    if for_ampl:
        try:
            write_sol(
                target,
                problem.header,
                message=message,
                code=code,
                duals=duals,
                values=values,
                objective=own["objno"],
                of_rows=of_rows,
            )
        except OSError as error:
            raise _UnwrittenError(f"{target} cannot be written: {error.strerror}.") from error
    if not for_ampl and code >= _NO_SOLUTION:
        message = f"{message} (AMPL's code {code})"
    return message if not for_ampl or own["outlev"] else "", code


def _split(words: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split options into the command's, with defaults, and the solver's; raise _RefusedError."""
    own: dict[str, Any] = {"objno": 1, "relax_integers": 0, "timelimit": None, "outlev": None}
    solver_options: dict[str, Any] = {}
    for word in words:
        name, is_set, text = word.partition("=")
        if not name or not is_set or not text:
            raise _RefusedError(
                f"'{word}' is no option: write name=value, without spaces around the sign."
            )
        value: Any = text
        for kind in (int, float):
            try:
                value = kind(text)
                break
            except ValueError:
                continue
        if name not in own:
            solver_options[name] = value
        elif (
            isinstance(value, str)
            or not math.isfinite(value)
            or value < 0
            or (name != "timelimit" and not isinstance(value, int))
        ):
            raise _RefusedError(
                f"the option '{name}' is {'a number of seconds' if name == 'timelimit' else 'a whole number'}, not '{text}'."
            )
        else:
            own[name] = value
    if own["timelimit"] == 0:
        own["timelimit"] = None
    return own, solver_options


def _options_in_words() -> str:
    rows = [f"{name:28}{text}" for name, text in _OWN.items()]
    rows += [
        f"{item.name:28}of mpec_ipopt ({item.default})"
        for item in fields(MpecSettings)
        if item.name != "ipopt"
    ]
    return "\n".join([*rows, "and every option of Ipopt, as max_iter, tol, print_level"])


def _sentence(result: MpecResult) -> str:
    value = (
        f"objective {result.objective:.12g}; " if result.has_point and result.has_objective else ""
    )
    return f"{result.outcome.name.lower().replace('_', ' ')}; {value}{result.message}"


def _code(result: MpecResult) -> int:
    codes = {
        Outcome.SOLVED: 0,
        Outcome.INFEASIBLE: 200,
        Outcome.DIVERGED: 300,
        Outcome.ITERATION_LIMIT: 400,
        Outcome.TIME_LIMIT: 401,
        Outcome.INTERRUPTED: 402,
    }
    if result.outcome is Outcome.STALLED:
        return 100 if is_feasible(result) else 501
    return codes.get(result.outcome, 500)


def _values(problem: NlProblem, result: MpecResult) -> list[float]:
    values = dict(zip(map(id, result.variables), result.x.tolist(), strict=True))
    return [values.get(id(variable), _at_rest(variable)) for variable in problem.variables]


def _at_rest(variable: Any) -> float:
    value = 0.0 if variable.value is None else float(variable.value)
    return min(
        max(value, -math.inf if variable.lb is None else variable.lb),
        math.inf if variable.ub is None else variable.ub,
    )


def _suffixes(problem: NlProblem, result: MpecResult) -> dict[str, dict[int, float]]:
    multipliers = {id(pair): both for pair, both in result.pair_multipliers}
    numbers = {
        k: multipliers[id(row)][1] for k, row in enumerate(problem.rows) if id(row) in multipliers
    }
    return {"pair_dual": numbers} if numbers else {}


def _duals(problem: NlProblem, result: MpecResult) -> list[float]:
    """Return the duals (rows,) in AMPL's signs: change of the objective per right-hand side."""
    if not result.has_multipliers:
        return []
    duals = dict(zip(map(id, result.rows), (-result.sense * result.lagrange).tolist(), strict=True))
    duals |= {id(pair): both[0] for pair, both in result.pair_multipliers}
    return [duals.get(id(row), 0.0) for row in problem.rows]


# Kind of a suffix: 1 for rows, plus 4 for real numbers.
_REAL_OF_ROWS = 1 + 4


def write_sol(
    path: Path,
    header: Header,
    *,
    message: str,
    code: int,
    duals: Sequence[float],
    values: Sequence[float],
    objective: int,
    of_rows: Mapping[str, Mapping[int, float]],
) -> None:
    """Write a solution file.

    - message: text for the user, without its empty lines, since the first one ends the message
    - code: AMPL's: 0 solved, 100 a point without proof, 200 infeasible, 300 unbounded, 400 a limit,
      500 a failure
    - duals, values: (rows,) and (variables,), or empty
    - objective: number of the solved objective, from 1
    - of_rows: suffixes, with numbers by row

    Raises OSError if the file cannot be written.
    """
    count, *options = header.options or ("0",)
    has_tolerance = len(options) > 2 and options[1] == "3"
    options, tolerance = (options[:-1], options[-1:]) if has_tolerance else (options, [])
    lines = [line for line in message.splitlines() if line.strip()]
    lines += ["", "Options", str(int(count) + 2 * has_tolerance), *options]
    lines += [str(number) for number in (header.rows, len(duals), header.variables, len(values))]
    lines += [
        *tolerance,
        *map(_number, duals),
        *map(_number, values),
        f"objno {max(objective - 1, 0)} {code}",
    ]
    for name, numbers in of_rows.items():
        lines += [
            f"suffix {_REAL_OF_ROWS} {len(numbers)} {len(name) + 1} 0 0",
            name,
            *(f"{row} {_number(x)}" for row, x in numbers.items()),
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _number(value: float) -> str:
    return f"{float(value):.17g}"
