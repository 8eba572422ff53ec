"""One C function from SymPy expressions: arguments are vectors whose entries have names, common subexpressions are shared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from sympy.printing.c import C99CodePrinter
from sympy.printing.precedence import PRECEDENCE

# (symbol, value) pairs, each value in terms of the arguments and of symbols before it.
Definitions = Sequence[tuple[sp.Symbol, sp.Expr]]

# Integer powers up to this one are written as products: exact, faster than pow(), and equal on every libm.
_LARGEST_PRODUCT = 4


class _Printer(C99CodePrinter):
    """Of one function. What is multiplied with itself is computed once: it becomes a constant of its own, in `lines`."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []
        self._factors: dict[str, str] = {}

    def statements(self, head: str, expression: sp.Expr) -> list[str]:
        """`head expression;`, after the constants it needs."""
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

    def _print_Pow(self, expr: sp.Pow) -> str:  # noqa: N802 - SymPy finds it by this name
        base, exponent = expr.base, expr.exp
        if exponent.is_Integer and 2 <= abs(int(exponent)) <= _LARGEST_PRODUCT:
            factor = self._factor(base)
            product = "*".join([factor] * abs(int(exponent)))
            return f"({product})" if int(exponent) > 0 else f"(1.0/({product}))"
        return super()._print_Pow(expr)


@dataclass(frozen=True)
class Vector:
    """An argument `const double *name` with one symbol for each entry."""

    name: str
    entries: tuple[str, ...]
    symbols: tuple[sp.Symbol, ...]

    @classmethod
    def of(cls, name: str, entries: Sequence[str]) -> Vector:
        return cls(name, tuple(entries), tuple(sp.Symbol(f"{name}_{entry}", real=True) for entry in entries))

    def like(self, name: str) -> Vector:
        """A vector of the same entries under another name (a tangent or an adjoint of this one)."""
        return Vector.of(name, self.entries)

    @property
    def column(self) -> sp.Matrix:
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
    """A static inline C function.

    output: the name of the array written from `expressions`; or several (name, column) pairs; or None to return the one
    expression. operator: "=" or "+=". tail: a last statement. definitions: of symbols in which the expressions are written.
    """
    outputs = [(output, expressions)] if isinstance(output, str) else list(output or [])
    columns = [sp.Matrix(column) for _, column in outputs if column is not None] if outputs else [sp.Matrix(expressions)]
    entries = [entry for column in columns for entry in column]
    values = [value for _, value in definitions]
    shared, reduced = sp.cse([*values, *entries], symbols=sp.numbered_symbols("shared"), order="canonical")
    symbols, reduced = [symbol for symbol, _ in definitions], list(reduced)
    shared = _needed([*shared, *zip(symbols, reduced[: len(symbols)], strict=True)], reduced[len(symbols) :]) if symbols else shared
    reduced = reduced[len(symbols) :]
    used = set().union(*(entry.free_symbols for entry in [*reduced, *(value for _, value in shared)]), set())

    parameters = [f"const double *{vector.name}" for vector in arguments] + [f"double *{target}" for target, _ in outputs]
    lines = [f"SCENE_FUNCTION {result} {name}({', '.join(parameters)})", "{"]
    for vector in arguments:
        entries = [(index, symbol) for index, symbol in enumerate(vector.symbols) if symbol in used]
        lines += [f"    const double {symbol.name} = {vector.name}[{index}];" for index, symbol in entries]
        if not entries:
            lines.append(f"    (void){vector.name};")
    printer = _Printer()
    for symbol, value in shared:
        lines += printer.statements(f"const double {symbol.name} =", value)
    if not outputs:
        lines += printer.statements("return", reduced[0])
    position = 0
    for (target, _), column in zip(outputs, columns if outputs else [], strict=True):
        statements = []
        for index in range(len(column)):
            expression = reduced[position]
            position += 1
            if operator == "+=" and expression == 0:
                continue
            statements += printer.statements(f"{target}[{index}] {operator}", expression)
        lines += statements or [f"    (void){target};"]
    if tail:
        lines.append(f"    {tail}")
    return "\n".join([*lines, "}", ""])


def _needed(definitions: Definitions, entries: Sequence[sp.Expr]) -> list[tuple[sp.Symbol, sp.Expr]]:
    """Those definitions of which the entries make use, each after those in whose symbols it is written."""
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
