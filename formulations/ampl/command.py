"""`touchstone-mpec STUB -AMPL [name=value ..]`: the MPEC solver as AMPL calls its solvers.

    touchstone-mpec bard1                        reads bard1.nl, prints how it ended
    touchstone-mpec bard1 -AMPL strategy=scholtes
        writes bard1.sol instead, for AMPL, JuMP (AmplNLWriter) or Pyomo (`SolverFactory("asl:touchstone-mpec")`)
    touchstone-mpec -=                           names the options

Options also come from the environment: `touchstone_mpec_options='strategy=scholtes max_iter=500'`;
those of the command line count last.

AMPL's `.sol` files: how a solve ended, duals, values and suffixes, in the order of the `.nl` file.
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

import pyomo.environ  # noqa: F401 - before anything of ours that needs it, once

from formulations.ampl.nl import Header, NlError, NlProblem, read_problem
from formulations.ipopt import MissingValueError, ModelRefusedError, UnknownOptionError
from formulations.mpec import MpecSettings, read_settings
from formulations.mpec.result import MpecResult, is_feasible
from formulations.mpec.solve import solve_mpec
from formulations.solution import Outcome

NAME = "touchstone-mpec"
# Where AMPL puts its options: the solver's name and `_options`.
_ENVIRONMENT = ("touchstone_mpec_options", f"{NAME}_options")
_USAGE = f"usage: {NAME} STUB [-AMPL] [name=value ..]     (STUB.nl is read; with -AMPL, STUB.sol is written; {NAME} -= names the options)"
# Of the command itself; the others are those of `mpec_ipopt` and of Ipopt.
_OWN = {
    "objno": "which objective, from 1; 0 for none (1)",
    "relax_integers": "1: integer variables become continuous (0)",
    "timelimit": "wall time in seconds (none)",
    "outlev": "0: nothing is printed, 1: how it ended (1; with -AMPL 0, since AMPL prints it)",
}


# AMPL's codes from here on are of problems without a solution.
_NO_SOLUTION = 200


def main(words: Sequence[str] | None = None) -> int:
    """Run the command.

    The exit code is 0 where an answer was written for AMPL or a solution printed, 1 where none was
    found, 2 for what cannot be read, 3 where the answer cannot be written.
    """
    given = list(sys.argv[1:] if words is None else words)
    flags, rest = (
        [word for word in given if word.startswith("-")],
        [word for word in given if not word.startswith("-")],
    )
    if "-v" in flags or "--version" in flags:
        return _told(f"{NAME} {metadata.version('touchstone-contact')}")
    if "-=" in flags:
        return _told(_options_in_words())
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
    written = _told(message) if message else 0
    return written or (1 if code >= _NO_SOLUTION and not for_ampl else 0)


def _told(text: str) -> int:
    """Print it; the exit code."""
    if sys.stdout is None:  # Python's way to say that it was closed
        print(f"{NAME}: the answer cannot be written: standard output is closed.", file=sys.stderr)
        return 3
    try:
        print(text, flush=True)
    except OSError as error:
        os.dup2(
            os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
        )  # what the stream still holds is not tried again as Python ends
        print(f"{NAME}: the answer cannot be written: {error.strerror}.", file=sys.stderr)
        return 3
    return 0


class _RefusedError(Exception):
    """What ends the command with exit code 2, in one sentence."""


class _UnwrittenError(Exception):
    """What ends the command with exit code 3, in one sentence."""


def _solved(stub: Path, words: list[str], for_ampl: bool) -> tuple[str, int]:
    """Solve, and write the answer for AMPL; return the text to print and AMPL's code."""
    own, others = _split(words)
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
        result = solve_mpec(problem.model, read_settings(others), time_limit=own["timelimit"])
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
    """The command's own options, with their defaults, and the solver's.

    Raises _RefusedError for values that are none.
    """
    own: dict[str, Any] = {"objno": 1, "relax_integers": 0, "timelimit": None, "outlev": None}
    others: dict[str, Any] = {}
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
            others[name] = value
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
    return own, others


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
    """AMPL's code; a feasible point without a proof is 100."""
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
    """(variables,) values in the order of the file.

    A variable that no row mentions keeps its start, within its bounds.
    """
    found = dict(zip(map(id, result.variables), result.x.tolist(), strict=True))
    return [found.get(id(variable), _at_rest(variable)) for variable in problem.variables]


def _at_rest(variable: Any) -> float:
    value = 0.0 if variable.value is None else float(variable.value)
    return min(
        max(value, -math.inf if variable.lb is None else variable.lb),
        math.inf if variable.ub is None else variable.ub,
    )


def _suffixes(problem: NlProblem, result: MpecResult) -> dict[str, dict[int, float]]:
    """`pair_dual` of each row that complements a variable: the multiplier of the variable's side."""
    found = {id(pair): both for pair, both in result.pair_multipliers}
    numbers = {k: found[id(row)][1] for k, row in enumerate(problem.rows) if id(row) in found}
    return {"pair_dual": numbers} if numbers else {}


def _duals(problem: NlProblem, result: MpecResult) -> list[float]:
    """(rows,) duals in AMPL's signs: the change of the objective by the right-hand side, of a complementarity by what its body is compared with."""
    if not result.has_multipliers:
        return []
    found = dict(zip(map(id, result.rows), (-result.sense * result.lagrange).tolist(), strict=True))
    found |= {id(pair): both[0] for pair, both in result.pair_multipliers}
    return [found.get(id(row), 0.0) for row in problem.rows]


# A suffix's kind: 1 for rows, and 4 for numbers that are not whole.
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
    """Write a solution.

    Parameters
    ----------
    path : the file
    header : of the `.nl` file
    message : sentences for the user; empty lines are left out, since the first one ends the message
    code : AMPL's: 0 to 99 solved, 100 a point without its proof, 200 infeasible, 300 unbounded, 400
        a limit, 500 a failure
    duals : (rows,) change of the objective by the right-hand side; empty if there are none
    values : (variables,) empty if there is no point
    objective : the objective that was solved, from 1
    of_rows : suffixes, each with a number for some rows

    Raises
    ------
    OSError
        where the file cannot be written
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
