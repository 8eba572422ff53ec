"""AMPL's `.sol` files: how a solve ended, duals, values and suffixes, in the order of the `.nl` file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from formulations.ampl.nl import Header

# A suffix's kind: 1 for rows, and 4 for numbers that are not whole.
_REAL_OF_ROWS = 1 + 4


def write_sol(
    path: Path,
    header: Header,
    *,
    message: str,
    code: int,
    duals: Sequence[float] = (),
    values: Sequence[float] = (),
    objective: int = 1,
    of_rows: Mapping[str, Mapping[int, float]] = MappingProxyType({}),
) -> None:
    """Write a solution.

    Parameters
    ----------
    path : the file
    header : of the `.nl` file
    message : sentences for the user; empty lines are left out, since the first one ends the message
    code : AMPL's: 0 to 99 solved, 100 a point without its proof, 200 infeasible, 300 unbounded, 400 a limit, 500 a failure
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
    lines += [*tolerance, *map(_number, duals), *map(_number, values), f"objno {max(objective - 1, 0)} {code}"]
    for name, numbers in of_rows.items():
        lines += [
            f"suffix {_REAL_OF_ROWS} {len(numbers)} {len(name) + 1} 0 0",
            name,
            *(f"{row} {_number(x)}" for row, x in numbers.items()),
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _number(value: float) -> str:
    return f"{float(value):.17g}"
