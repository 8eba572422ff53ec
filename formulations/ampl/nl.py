"""Read a `.nl` file, text or binary, as a Pyomo model.

    model = read_nl("bard1.nl")
    model.x  # variables, by the names of bard1.col, or by number from 0
    model.row, model.pair  # constraints and complementarities, by the names of bard1.row
    model.objective, model.defined  # objectives and common expressions, by number
    model.dual, ..  # start values of duals, and the file's suffixes

The format is D. M. Gay's, "Writing .nl Files" (2005). A row `5 k i` complements variable i - 1:
k = 1: `0 <= body _|_ x >= lower`; k = 2: `0 >= body _|_ x <= upper`; k = 3: `body _|_ lower <= x <=
upper`; k = 0: `body == 0`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import add, mul, neg, sub, truediv
from pathlib import Path
from typing import Any

import pyomo.environ as pyo
from pyomo.core.expr.numeric_expr import LinearExpression, MaxExpression, MinExpression
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.mpec import Complementarity, complements

from formulations.ampl.source import BinarySource, NlError, TextSource
from formulations.ipopt.model import unbounded_if_huge


def read_nl(
    path: str | Path, *, objective: int = 1, relax_integers: bool = False
) -> pyo.ConcreteModel:
    """Read a problem as a model.

    Parameters
    ----------
    path : the file; `.nl` may be omitted
    objective : number of the active objective, from 1; 0 for none
    relax_integers : whether integer and binary variables become continuous within their bounds

    Raises
    ------
    NlError
        for a missing or damaged file, or content that a smooth model cannot express
    """
    return read_problem(path, objective=objective, relax_integers=relax_integers).model


@dataclass(frozen=True, kw_only=True)
class NlProblem:
    """A model in the order of its file; rows are constraints or complementarities."""

    file: Path
    header: Header
    model: pyo.ConcreteModel
    variables: Sequence[Any]
    rows: Sequence[Any]


def read_problem(
    path: str | Path, *, objective: int = 1, relax_integers: bool = False
) -> NlProblem:
    """Read a problem with the order of its file; parameters and errors as in `read_nl`."""
    file = Path(path)
    if not file.name:
        raise NlError(f"'{path}' is no file. Name a .nl file.")
    file = file if file.suffix == ".nl" else file.with_name(f"{file.name}.nl")
    try:
        data = file.read_bytes()
    except OSError as error:
        raise NlError(f"{file} cannot be read: {error.strerror}. Name a .nl file.") from error
    reader = _Reader(file, data)
    reader.read()
    return reader.complete(objective, relax_integers)


@dataclass(frozen=True, kw_only=True)
class Header:
    """The counts in a file's first ten lines; a `.sol` file repeats AMPL's `options`."""

    letter: str
    options: tuple[str, ...]
    variables: int
    rows: int
    objectives: int
    nonlinear_blocks: tuple[int, int, int]
    nonlinear_integers: tuple[int, int, int]
    integers: int
    arithmetic: int
    nonzeros: tuple[int, int]
    defined: int


_HEADER_LINES = 10


def read_header(file: Path, data: bytes) -> tuple[Header, int]:
    """Return the header and the byte at which the problem begins; raise NlError if damaged."""
    lines = data.split(b"\n", _HEADER_LINES)
    letter = data[:1].decode("latin-1")
    if letter not in "gbz" or len(lines) <= _HEADER_LINES:
        raise NlError(
            f"{file} is no .nl file: its first {_HEADER_LINES} lines should be a header that begins with g (text) or b (binary)."
        )
    texts = [line.decode("latin-1").partition("#")[0].split() for line in lines[:_HEADER_LINES]]

    def numbers(line: int, least: int, most: int) -> list[int]:
        try:
            counts = [int(word) for word in texts[line - 1][:most]]
        except ValueError:
            counts = []
        if len(counts) < least or min(counts, default=0) < 0:
            raise NlError(
                f"{file}, line {line}: at least {least} whole numbers should stand here, not '{' '.join(texts[line - 1])}'."
            )
        return counts + [0] * (most - len(counts))

    variables, rows, objectives, _, _, logical = numbers(2, 3, 6)
    in_rows, in_objectives, in_both = numbers(5, 2, 3)
    _, _, arithmetic, _ = numbers(6, 2, 4)
    binaries, integers, *nonlinear_integers = numbers(7, 2, 5)
    jacobian, gradient = numbers(8, 2, 2)
    if logical:
        raise NlError(
            f"{file} has {logical} logical constraints, which a smooth model cannot express. State them as equations or pairs."
        )
    if arithmetic > 2:
        raise NlError(
            f"{file}, line 6: arithmetic {arithmetic} is not IEEE's. Write the file as text (`-og`)."
        )
    if not variables:
        raise NlError(f"{file} has no variables.")
    if variables + rows > len(data):  # each has a bound of at least one byte
        raise NlError(
            f"{file}, line 2: {variables} variables and {rows} rows do not fit into {len(data)} bytes; the file is damaged or cut short."
        )
    header = Header(
        letter=letter,
        options=tuple(texts[0][1:]) if texts[0][0] == letter else (texts[0][0][1:], *texts[0][1:]),
        variables=variables,
        rows=rows,
        objectives=objectives,
        nonlinear_blocks=(in_both, in_rows - in_both, max(in_objectives - in_rows, 0)),
        nonlinear_integers=(nonlinear_integers[0], nonlinear_integers[1], nonlinear_integers[2]),
        integers=binaries + integers,
        arithmetic=arithmetic,
        nonzeros=(jacobian, gradient),
        defined=sum(numbers(10, 5, 5)),
    )
    return header, sum(len(line) + 1 for line in lines[:_HEADER_LINES])


# Opcodes with one, two, and any number of arguments (Gay's table 6) that are smooth, or can be at
# the answer.
_UNARY: dict[int, Callable[[Any], Any]] = {
    15: abs, 16: neg, 37: pyo.tanh, 38: pyo.tan, 39: pyo.sqrt, 40: pyo.sinh, 41: pyo.sin,
    42: pyo.log10, 43: pyo.log, 44: pyo.exp, 45: pyo.cosh,
    46: pyo.cos, 47: pyo.atanh, 49: pyo.atan, 50: pyo.asinh, 51: pyo.asin, 52: pyo.acosh,
    53: pyo.acos, 77: lambda base: base**2,
}  # fmt: skip
_BINARY: dict[int, Callable[[Any, Any], Any]] = {
    0: add,
    1: sub,
    2: mul,
    3: truediv,
    5: pow,
    76: pow,
    78: pow,
}
_ANY: dict[int, Callable[..., Any]] = {
    11: lambda *terms: MinExpression(terms),
    12: lambda *terms: MaxExpression(terms),
    54: lambda *terms: pyo.quicksum(terms),
}
_REFUSED = {
    4: "rem", 6: "less", 13: "floor", 14: "ceil", 20: "or", 21: "and", 22: "<", 23: "<=", 24: "=",
    28: ">=", 29: ">", 30: "!=",
    34: "not", 35: "if", 48: "atan2", 55: "div", 56: "precision", 57: "round", 58: "trunc",
    59: "count", 60: "numberof", 61: "numberof (symbolic)",
    62: "atleast", 63: "atmost", 64: "piecewise-linear term", 65: "if (symbolic)", 66: "exactly",
    67: "not atleast", 68: "not atmost",
    69: "not exactly", 70: "forall", 71: "exists", 72: "implies", 73: "iff", 74: "alldiff",
    75: "not alldiff",
}  # fmt: skip


class _Reader:
    def __init__(self, file: Path, data: bytes) -> None:
        self.file = file
        self.header, begin = read_header(file, data)
        counts = self.header
        self.source: TextSource | BinarySource
        if counts.letter == "g":
            self.source = TextSource(file, data, _HEADER_LINES)
        else:
            self.source = BinarySource(
                file,
                data,
                begin,
                ">" if counts.arithmetic == 2 else "<",
                "h" if counts.letter == "z" else "i",
            )
        self.model = pyo.ConcreteModel(name=file.stem)
        self.model.x = pyo.Var(names_beside(file, ".col", counts.variables))
        self.variables = list(self.model.x.values())
        self.model.defined = pyo.Expression(range(counts.defined))
        self.is_defined = [False] * counts.defined
        self.rows: list[Any] = [0.0] * counts.rows
        self.objectives: list[Any] = [0.0] * counts.objectives
        self.senses = [pyo.minimize] * counts.objectives
        self.linear: dict[str, dict[int, list[tuple[int, float]]]] = {"J": {}, "G": {}}
        self.row_bounds: list[_Bounds] = []
        self.bounds: list[_Bounds] = []
        self.functions: dict[int, str] = {}
        self.suffixes: list[tuple[str, int, list[tuple[int, float]]]] = []
        self.duals: list[tuple[int, float]] = []

    def read(self) -> None:
        source = self.source
        while not source.at_end():
            code = source.code()
            match code:
                case "C":
                    (row,) = source.values("i")
                    self._check(row, self.header.rows, "row")
                    self.rows[row] = self._expression()
                case "O":
                    number, sense = source.values("ii")
                    self._check(number, self.header.objectives, "objective")
                    self.senses[number] = pyo.maximize if sense else pyo.minimize
                    self.objectives[number] = self._expression()
                case "V":
                    number, terms, _ = source.values("iii")
                    self._check(
                        number - self.header.variables, self.header.defined, "common expression"
                    )
                    linear = self._pairs(terms, self.header.variables)
                    self.model.defined[number - self.header.variables] = self._sum(
                        self._expression(), linear
                    )
                    self.is_defined[number - self.header.variables] = True
                case "J" | "G":
                    number, terms = source.values("ii")
                    self._check(
                        number,
                        self.header.rows if code == "J" else self.header.objectives,
                        "row" if code == "J" else "objective",
                    )
                    self.linear[code][number] = self._pairs(terms, self.header.variables)
                case "r":
                    source.values("")
                    self.row_bounds = [
                        self._bounds(f"row {number}") for number in range(self.header.rows)
                    ]
                case "b":
                    source.values("")
                    self.bounds = [
                        self._bounds(f"variable {number}")
                        for number in range(self.header.variables)
                    ]
                case "x":
                    for number, value in self._pairs(source.values("i")[0], self.header.variables):
                        self.variables[number].set_value(value, skip_validation=True)
                case "d":
                    self.duals = self._pairs(source.values("i")[0], self.header.rows)
                case "k" | "K":
                    for _ in range(
                        source.values("i")[0]
                    ):  # lengths of the Jacobian's columns, redundant
                        source.values("i")
                case "S":
                    kind, count, name = source.values("iis")
                    most = (self.header.variables, self.header.rows, self.header.objectives, 1)[
                        kind & 3
                    ]
                    self.suffixes.append(
                        (name, kind, self._pairs(count, most, "d" if kind & 4 else "i"))
                    )
                case "F":
                    number, _, _, name = source.values("iiis")
                    self.functions[number] = name
                case "L":
                    raise self._refused("a logical constraint")
                case _:
                    raise self._damaged(f"'{code}' begins no segment")
        self._check_complete()

    def _check_complete(self) -> None:
        lacking = [] if self.bounds else ["bounds of variables (b)"]
        if self.header.rows and not self.row_bounds:
            lacking.append("bounds of rows (r)")
        for wanted, code, what in zip(
            self.header.nonzeros, "JG", ("the Jacobian (J)", "the gradients (G)"), strict=True
        ):
            entries = sum(map(len, self.linear[code].values()))
            if entries < wanted:
                lacking.append(f"{wanted - entries} of {wanted} entries of {what}")
        if lacking:
            raise NlError(
                f"{self.file} lacks {', '.join(lacking)}: the file is cut off. Write it again."
            )

    def _damaged(self, what: str) -> NlError:
        return NlError(
            f"{self.file}, {self.source.place}: {what}. The file is damaged, or its byte order differs from its sixth line."
        )

    def _refused(self, what: str) -> NlError:
        return NlError(
            f"{self.file}, {self.source.place}: {what} cannot be expressed in a smooth Pyomo model. State it by equations or pairs."
        )

    def _check(self, number: int, count: int, what: str) -> None:
        if not 0 <= number < count:
            raise self._damaged(
                f"{what} {number} is not one of 0 to {count - 1}"
                if count
                else f"there is no {what}"
            )

    def _pairs(self, count: int, most: int, kind: str = "d") -> list[tuple[int, Any]]:
        if not 0 <= count <= most:
            raise self._damaged(f"{count} entries are given where at most {most} can be")
        pairs = [self.source.values(f"i{kind}") for _ in range(count)]
        for number, value in pairs:
            self._check(number, most, "entry")
            if not math.isfinite(value):
                raise self._damaged(f"entry {number} is not finite")
        return [(number, value) for number, value in pairs]

    def _bounds(self, of: str) -> _Bounds:
        source, kind = self.source, self.source.code()
        lower, upper = -math.inf, math.inf
        if kind == "5" and of.startswith("row"):
            sides, number = source.values("ii")
            if not 1 <= number <= self.header.variables:
                raise self._damaged(
                    f"{of} complements variable {number - 1}, and there are those from 0 to {self.header.variables - 1}"
                )
            if not 0 <= sides <= 3:
                raise self._damaged(f"{of} complements sides {sides}; they are 0, 1, 2 or 3")
            return _Bounds(lower, upper, sides, number - 1)
        match kind:
            case "0":
                lower, upper = source.values("dd")
            case "1":
                (upper,) = source.values("d")
            case "2":
                (lower,) = source.values("d")
            case "3":
                source.values("")
            case "4":
                lower = upper = source.values("d")[0]
            case _:
                raise self._damaged(f"'{kind}' is no kind of bounds for {of}")
        if math.isnan(lower) or math.isnan(upper):
            raise self._damaged(f"a bound of {of} is no number")
        if lower > upper or lower == math.inf or upper == -math.inf:
            raise self._damaged(
                f"{of} has the bounds {lower:g} and {upper:g}, between which nothing lies"
            )
        return _Bounds(lower, upper)

    def _expression(self) -> Any:
        source = self.source
        open_calls: list[tuple[Callable[..., Any], int, list[Any]]] = []
        while True:
            code = source.code()
            if code == "o":
                open_calls.append((*self._operator(source.values("o")[0]), []))
                continue
            if code in source.number:
                value: Any = source.values(source.number[code])[0]
            elif code == "v":
                value = self._variable(source.values("i")[0])
            elif code == "f":
                number, _ = source.values("ii")
                raise self._refused(f"the imported function '{self.functions.get(number, number)}'")
            elif code == "h":
                raise self._refused("a text")
            else:
                raise self._damaged(f"'{code}' begins no expression")
            while open_calls:
                function, wanted, arguments = open_calls[-1]
                arguments.append(value)
                if len(arguments) < wanted:
                    break
                open_calls.pop()
                try:
                    value = function(*arguments)
                except (ArithmeticError, ValueError) as error:
                    raise self._damaged(
                        f"an expression of constants has no value ({error})"
                    ) from None
            else:
                return value

    def _operator(self, number: int) -> tuple[Callable[..., Any], int]:
        if number in _UNARY:
            return _UNARY[number], 1
        if number in _BINARY:
            return _BINARY[number], 2
        if number in _ANY:
            (count,) = self.source.values("i")
            if count < 1:
                raise self._damaged(f"an operator of {count} terms")
            return _ANY[number], count
        if number in _REFUSED:
            raise self._refused(f"the operator '{_REFUSED[number]}'")
        raise self._damaged(f"{number} is no operator's number")

    def _variable(self, number: int) -> Any:
        if number < self.header.variables:
            self._check(number, self.header.variables, "variable")
            return self.variables[number]
        number -= self.header.variables
        if number >= self.header.defined or not self.is_defined[number]:
            raise self._damaged(f"common expression {number} is used before it is defined")
        return self.model.defined[number]

    def _sum(self, nonlinear: Any, linear: list[tuple[int, float]]) -> Any:
        terms = [(self.variables[number], factor) for number, factor in linear if factor]
        if not terms:
            return nonlinear
        variables, factors = zip(*terms, strict=True)
        return nonlinear + LinearExpression(
            constant=0.0, linear_coefs=list(factors), linear_vars=list(variables)
        )

    def complete(self, objective: int, relax_integers: bool) -> NlProblem:
        """Build bounds, rows, pairs, objectives and suffixes.

        Raises NlError for an unknown objective, or a pair without its bound.
        """
        model, header = self.model, self.header
        if not 0 <= objective <= max(header.objectives, 1):
            raise NlError(
                f"{self.file} has {header.objectives} objectives; {objective} is none of them. Name one from 1, or 0 for none."
            )
        for variable, bounds in zip(self.variables, self.bounds, strict=True):
            variable.setlb(bounds.lower if bounds.lower > -math.inf else None)
            variable.setub(bounds.upper if bounds.upper < math.inf else None)
        if not relax_integers:
            for number in self._integers():
                self.variables[number].domain = pyo.Integers
        names = names_beside(self.file, ".row", header.rows)
        model.row, model.pair, model.objective = (
            pyo.Constraint(pyo.Any),
            Complementarity(pyo.Any),
            pyo.Objective(pyo.Any),
        )
        stated: list[Any] = []
        for number, (name, bounds) in enumerate(zip(names, self.row_bounds, strict=True)):
            body = self._sum(self.rows[number], self.linear["J"].get(number, []))
            if bounds.sides:
                stated.append(model.pair.add(name, self._complements(body, bounds, number)))
                continue
            if not is_potentially_variable(
                body
            ):  # Pyomo refuses a row of constants; the solver decides whether it holds
                body = LinearExpression(
                    constant=pyo.value(body), linear_coefs=[0.0], linear_vars=[self.variables[0]]
                )
            lower, upper = (0.0, 0.0) if bounds.sides == 0 else (bounds.lower, bounds.upper)
            if lower == upper:
                model.row[name] = body == lower
            else:
                model.row[name] = (
                    lower if lower > -math.inf else None,
                    body,
                    upper if upper < math.inf else None,
                )
            stated.append(model.row[name])
        for number, sense in enumerate(self.senses):
            model.objective[number + 1] = self._sum(
                self.objectives[number], self.linear["G"].get(number, [])
            )
            model.objective[number + 1].sense = sense
            if number + 1 != objective:
                model.objective[number + 1].deactivate()
        self._state_suffixes(stated)
        return NlProblem(
            file=self.file, header=header, model=model, variables=self.variables, rows=stated
        )

    def _integers(self) -> Iterator[int]:
        """Yield the integer variables: the last of all, and of each nonlinear block."""
        end = 0
        for block, count in zip(
            self.header.nonlinear_blocks, self.header.nonlinear_integers, strict=True
        ):
            end += block
            yield from range(end - count, end)
        yield from range(self.header.variables - self.header.integers, self.header.variables)

    def _complements(self, body: Any, bounds: _Bounds, number: int) -> Any:
        variable, of, sides = (
            self.variables[bounds.complements],
            self.bounds[bounds.complements],
            bounds.sides or 0,
        )
        lacking = [
            word
            for bit, word, value in ((1, "lower", of.lower), (2, "upper", of.upper))
            if sides & bit and math.isinf(value)
        ]
        if lacking:
            raise NlError(
                f"{self.file}: row {number} complements the {lacking[0]} bound of variable {bounds.complements}, which has none. "
                "Give the variable that bound, or complement its other side."
            )
        if sides == 3:  # a huge bound is infinite
            huge = (
                unbounded_if_huge(of.lower) == -math.inf,
                unbounded_if_huge(of.upper) == math.inf,
            )
            sides = {(False, True): 1, (True, False): 2}.get(huge, sides)
        if sides == 1:
            return complements(body >= 0, variable >= of.lower)
        if sides == 2:
            return complements(body <= 0, variable <= of.upper)
        return complements(body, pyo.inequality(of.lower, variable, of.upper))

    def _state_suffixes(self, rows: Sequence[Any]) -> None:
        kinds: tuple[Sequence[Any], ...] = (
            self.variables,
            rows,
            list(self.model.objective.values()),
            [self.model],
        )
        for name, kind, entries in (
            *self.suffixes,
            *([("dual", 1, self.duals)] if self.duals else []),
        ):
            if isinstance(self.model.component(name), pyo.Suffix):
                suffix = self.model.component(name)
            else:
                suffix = pyo.Suffix(direction=pyo.Suffix.IMPORT_EXPORT)
                self.model.add_component(
                    name if not hasattr(self.model, name) else f"suffix_{name}", suffix
                )
            for number, value in entries:
                suffix[kinds[kind & 3][number]] = value


@dataclass(frozen=True)
class _Bounds:
    """Bounds of a variable or row.

    sides: of a row that complements a variable: 1 lower, 2 upper, 3 both, 0 an equation
    """

    lower: float
    upper: float
    sides: int | None = None
    complements: int = -1


def names_beside(file: Path, ending: str, count: int) -> Sequence[Any]:
    """Return the names in the file with this ending, or numbers from 0 if these do not fit."""
    try:
        names = (
            file.with_suffix(ending)
            .read_text(encoding="utf-8", errors="replace")
            .split("\n")[:count]
        )
    except OSError:
        return range(count)
    return names if len(set(names)) == count else range(count)
