"""Write SymPy expressions as C functions, and differentiate them with shared subexpressions.

    definitions, df = push_forward(f, [x])  # df = (df/dx) dx
    definitions, columns = pull_back(f, w, [x])  # (df/dx)' w

Differentiating whole expressions would repeat every shared part: minutes of computer algebra for a
box pushed by a finger. Griewank and Walther, Evaluating Derivatives (2008), sections 3.1 and 3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from sympy.printing.c import C99CodePrinter
from sympy.printing.precedence import PRECEDENCE

from models.dynamics import Dynamics


@dataclass(frozen=True)
class SceneVectors:
    """The argument vectors of one scene, and its equations in their entries.

    lam holds all contact forces, then all friction forces; both act linearly.
    """

    dynamics: Dynamics
    q: Vector
    v: Vector
    u: Vector
    lam: Vector
    p: Vector

    @classmethod
    def of(cls, d: Dynamics) -> SceneVectors:
        """Return the vectors of a scene's equations."""

        def vector(name: str, symbols: Sequence[sp.Symbol]) -> Vector:
            return Vector.of(name, [symbol.name for symbol in symbols])

        lam = Vector.of(
            "lam",
            [contact.name for contact in d.scene.contacts]
            + [friction.force_name for friction in d.scene.frictions],
        )
        return cls(
            d,
            q=vector("q", d.q),
            v=vector("v", d.v),
            u=vector("u", d.u),
            lam=lam,
            p=vector("p", d.p),
        )

    @property
    def arguments(self) -> tuple[Vector, ...]:
        """Return (q, v, u, lam, p), the arguments of an acceleration."""
        return (self.q, self.v, self.u, self.lam, self.p)

    @property
    def contacts(self) -> tuple[str, ...]:
        """Return the names of the contacts, in order."""
        return tuple(contact.name for contact in self.dynamics.scene.contacts)

    def local(self, expression: sp.Expr | sp.Matrix) -> sp.Matrix:
        """Return an expression or matrix of the scene in the entries of these vectors."""
        d = self.dynamics
        pairs = zip(
            (*d.q, *d.v, *d.u, *d.lam, *d.f, *d.p),
            (s for vector in self.arguments for s in vector.symbols),
            strict=True,
        )
        matrix = expression if isinstance(expression, sp.MatrixBase) else sp.Matrix([[expression]])
        return matrix.xreplace(dict(pairs))


# (symbol, value) pairs, each value in terms of arguments and earlier symbols.
Definitions = Sequence[tuple[sp.Symbol, sp.Expr]]


def push_forward(function: sp.Matrix, vectors: Sequence[Vector]) -> tuple[Definitions, sp.Matrix]:
    """Return (df/dx) dx (m, 1) of a column f along the tangents of `vectors`, with definitions."""
    shared, entries = _shared(function)
    moving: dict[sp.Symbol, sp.Expr] = {
        x: dx
        for vector in vectors
        for x, dx in zip(vector.symbols, tangent(vector).symbols, strict=True)
    }
    definitions: list[tuple[sp.Symbol, sp.Expr]] = []
    for number, (symbol, value) in enumerate(shared):
        definitions.append((symbol, value))
        along = _along(value, moving)
        if along != 0:
            moving[symbol] = sp.Symbol(f"tangent{number}", real=True)
            definitions.append((moving[symbol], along))
    return definitions, sp.Matrix(len(entries), 1, [_along(entry, moving) for entry in entries])


def pull_back(
    function: sp.Matrix, weights: Vector, vectors: Sequence[Vector]
) -> tuple[Definitions, list[sp.Matrix]]:
    """Return (df/dx)' w for each x of `vectors`, of a column f (m, 1), with definitions."""
    shared, entries = _shared(function)
    wanted = {symbol for vector in vectors for symbol in vector.symbols}
    for symbol, value in shared:  # other symbols need no adjoint
        if value.free_symbols & wanted:
            wanted.add(symbol)
    adjoint: dict[sp.Symbol, sp.Expr] = dict.fromkeys(wanted, sp.Integer(0))

    def distribute(value: sp.Expr, weight: sp.Expr) -> None:
        for argument in sorted(value.free_symbols & wanted, key=lambda symbol: symbol.name):
            adjoint[argument] += sp.diff(value, argument) * weight

    for entry, weight in zip(entries, weights.symbols, strict=True):
        distribute(entry, weight)
    backward: list[tuple[sp.Symbol, sp.Expr]] = []
    for number, (symbol, value) in reversed(list(enumerate(shared))):
        if adjoint.get(symbol, 0) == 0:
            continue
        bar = sp.Symbol(f"adjoint{number}", real=True)
        backward.append((bar, adjoint[symbol]))
        distribute(value, bar)
    return [*shared, *backward], [
        sp.Matrix(len(vector.symbols), 1, [adjoint[symbol] for symbol in vector.symbols])
        for vector in vectors
    ]


def tangent(vector: Vector) -> Vector:
    """Return the direction d<vector>."""
    return vector.like(f"d{vector.name}")


def forward_function(
    head: str,
    arguments: Sequence[Vector],
    output: str | None,
    function: sp.Matrix,
    vectors: Sequence[Vector],
    tail: str = "",
) -> str:
    """Return the C function `head` (type and name): the Jacobian times d<vector> of `vectors`."""
    definitions, column = push_forward(function, vectors)
    result, name = head.split()
    return c_function(result, name, arguments, output, column, tail=tail, definitions=definitions)


def backward_function(
    head: str,
    arguments: Sequence[Vector],
    function: sp.Matrix,
    weights: Vector,
    vectors: Sequence[Vector],
    tail: str = "",
) -> str:
    """Return the C function `head` that adds Jacobian' weights to <vector>_bar of `vectors`."""
    definitions, columns = pull_back(function, weights, vectors)
    result, name = head.split()
    outputs = [
        (f"{vector.name}_bar", column) for vector, column in zip(vectors, columns, strict=True)
    ]
    return c_function(
        result, name, arguments, outputs, operator="+=", tail=tail, definitions=definitions
    )


def _shared(function: sp.Matrix) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[sp.Expr]]:
    return sp.cse(list(function), symbols=sp.numbered_symbols("part", real=True), order="canonical")


def _along(value: sp.Expr, moving: dict[sp.Symbol, sp.Expr]) -> sp.Expr:
    symbols = sorted(
        (symbol for symbol in value.free_symbols if symbol in moving),
        key=lambda symbol: symbol.name,
    )
    return sp.Add(*(sp.diff(value, symbol) * moving[symbol] for symbol in symbols))


# Largest power written as a product: exact, faster than pow(), and equal on every libm.
_LARGEST_PRODUCT = 4
# Largest int literal in C; larger numbers are double literals.
_LARGEST_INT = 2**31 - 1


class _Printer(C99CodePrinter):
    """The printer of one function; repeated factors become constants in `lines`."""

    def __init__(self) -> None:
        super().__init__({"math_macros": {}})  # M_PI and similar macros are POSIX, not C99
        self.lines: list[str] = []
        self._factors: dict[str, str] = {}

    def statements(self, head: str, expression: sp.Expr) -> list[str]:
        text = self.doprint(expression)
        lines, self.lines = self.lines, []
        return [f"    {line}" for line in (*lines, f"{head} {text};")]

    def _factor(self, base: sp.Expr) -> str:
        text = self._print(base)
        if base.is_Atom:
            return self.parenthesize(base, PRECEDENCE["Atom"])
        if text not in self._factors:
            self._factors[text] = f"factor{len(self._factors)}"
            self.lines.append(f"const double {self._factors[text]} = {text};")
        return self._factors[text]

    def _print_Pow(self, expr: sp.Pow) -> str:  # noqa: N802 - SymPy's name
        base, exponent = expr.base, expr.exp
        if exponent.is_Integer and 2 <= abs(int(exponent)) <= _LARGEST_PRODUCT:
            factor = self._factor(base)
            product = "*".join([factor] * abs(int(exponent)))
            return f"({product})" if int(exponent) > 0 else f"(1.0/({product}))"
        return super()._print_Pow(expr)

    def _print_NumberSymbol(self, expr: sp.NumberSymbol) -> str:  # noqa: N802 - SymPy's name
        return self._print(sp.Float(expr, 17))

    def _print_Exp1(self, expr: sp.NumberSymbol) -> str:  # noqa: N802 - SymPy's name
        return self._print_NumberSymbol(expr)

    def _print_Integer(self, expr: sp.Integer) -> str:  # noqa: N802 - SymPy's name
        return str(expr) if abs(int(expr)) <= _LARGEST_INT else repr(float(expr))

    def _print_Rational(self, expr: sp.Rational) -> str:  # noqa: N802 - SymPy's name
        if max(abs(int(expr.p)), int(expr.q)) <= _LARGEST_INT:
            return super()._print_Rational(expr)
        return f"({float(expr)!r})"


@dataclass(frozen=True)
class Vector:
    """An argument `const double *name` with one symbol per entry."""

    name: str
    entries: tuple[str, ...]
    symbols: tuple[sp.Symbol, ...]

    @classmethod
    def of(cls, name: str, entries: Sequence[str]) -> Vector:
        """Return a vector of real symbols `<name>_<entry>`, all different.

        Another `_` separates entry bar_x of `a` from x of `a_bar`, and a second equal entry.
        """
        symbols: list[sp.Symbol] = []
        for entry in entries:
            symbol = sp.Symbol(f"{name}_{entry}", real=True)
            if symbol in symbols or entry.split("_")[0] == "bar":
                symbol = sp.Symbol(f"{name}__{entry}", real=True)
            symbols.append(symbol)
        return cls(name, tuple(entries), tuple(symbols))

    def like(self, name: str) -> Vector:
        """Return a vector of the same entries under another name."""
        return Vector.of(name, self.entries)

    @property
    def column(self) -> sp.Matrix:
        """Return the symbols as a column (n, 1)."""
        return sp.Matrix(len(self.symbols), 1, list(self.symbols))


def c_function(
    result: str,
    name: str,
    arguments: Sequence[Vector],
    output: str | Sequence[tuple[str, sp.Matrix]] | None,
    expressions: sp.Matrix | None = None,
    *,
    operator: str = "=",
    tail: str = "",
    definitions: Definitions = (),
) -> str:
    """Return a static inline C function.

    output: name of the array written from `expressions`, several (name, column) pairs, or None to
        return the single expression
    operator: "=" or "+="
    tail: a last statement
    definitions: of symbols in the expressions
    """
    outputs = [(output, expressions)] if output is None or isinstance(output, str) else output
    columns = [sp.Matrix(column) for _, column in outputs]
    entries = [entry for column in columns for entry in column]
    values = [value for _, value in definitions]
    shared, reduced = sp.cse(
        [*values, *entries], symbols=sp.numbered_symbols("shared"), order="canonical"
    )
    symbols, reduced = [symbol for symbol, _ in definitions], list(reduced)
    shared = (
        _needed(
            [*shared, *zip(symbols, reduced[: len(symbols)], strict=True)], reduced[len(symbols) :]
        )
        if symbols
        else shared
    )
    reduced = reduced[len(symbols) :]
    used = set().union(
        *(entry.free_symbols for entry in [*reduced, *(value for _, value in shared)])
    )

    parameters = [f"const double *{vector.name}" for vector in arguments] + [
        f"double *{target}" for target, _ in outputs if target
    ]
    lines = [f"SCENE_FUNCTION {result} {name}({', '.join(parameters)})", "{"]
    for vector in arguments:
        entries = [(index, symbol) for index, symbol in enumerate(vector.symbols) if symbol in used]
        lines += [
            f"    const double {symbol.name} = {vector.name}[{index}];" for index, symbol in entries
        ]
        if not entries:
            lines.append(f"    (void){vector.name};")
    printer = _Printer()
    for symbol, value in shared:
        lines += printer.statements(f"const double {symbol.name} =", value)
    remaining = iter(reduced)
    for (target, _), column in zip(outputs, columns, strict=True):
        statements = []
        for index, expression in zip(range(len(column)), remaining, strict=False):
            if operator == "=" or expression != 0:
                statements += printer.statements(
                    f"{target}[{index}] {operator}" if target else "return", expression
                )
        lines += statements or [f"    (void){target};"]
    if tail:
        lines.append(f"    {tail}")
    return "\n".join([*lines, "}", ""])


def _needed(
    definitions: Definitions, entries: Sequence[sp.Expr]
) -> list[tuple[sp.Symbol, sp.Expr]]:
    """Return the definitions used by the entries, in order of evaluation."""
    values, ordered = dict(definitions), {}
    waiting = [(symbol, False) for entry in reversed(entries) for symbol in _by_name(entry)]
    while waiting:
        symbol, ready = waiting.pop()
        if symbol in ordered or symbol not in values:
            continue
        if ready:
            ordered[symbol] = values[symbol]
        else:
            waiting.append((symbol, True))
            waiting += [(part, False) for part in _by_name(values[symbol])]
    return list(ordered.items())


def _by_name(expression: sp.Expr) -> list[sp.Symbol]:
    return sorted(expression.free_symbols, key=lambda symbol: symbol.name)
