"""Mistakes that a programmer could make, one place at a time, in Python and in C.

for mistake in python_mistakes(text):
    print(mistake.line, mistake.kind, mistake.before, "->", mistake.after)
    wrong = replaced(text, mistake)
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Mistake:
    """One replacement in a text: text[start:end] is `before` and becomes `after`; line counts from 1."""

    kind: str
    line: int
    start: int
    end: int
    before: str
    after: str


def replaced(text: str, mistake: Mistake) -> str:
    """Return the text with the mistake in it."""
    return text[: mistake.start] + mistake.after + text[mistake.end :]


_OPPOSITE: dict[type[ast.AST], tuple[str, type[ast.AST]]] = {
    ast.Add: ("sign", ast.Sub), ast.Sub: ("sign", ast.Add), ast.Mult: ("operator", ast.Div),
    ast.Div: ("operator", ast.Mult),
    ast.Lt: ("comparison", ast.LtE), ast.LtE: ("comparison", ast.Lt),
    ast.Gt: ("comparison", ast.Lt), ast.GtE: ("comparison", ast.Gt),
    ast.Eq: ("comparison", ast.NotEq), ast.NotEq: ("comparison", ast.Eq),
    ast.Is: ("comparison", ast.IsNot), ast.IsNot: ("comparison", ast.Is),
    ast.In: ("comparison", ast.NotIn), ast.NotIn: ("comparison", ast.In),
    ast.And: ("condition", ast.Or), ast.Or: ("condition", ast.And),
}  # fmt: skip
_TWINS = {
    "max": "min",
    "min": "max",
    "any": "all",
    "all": "any",
    "maximum": "minimum",
    "minimum": "maximum",
}
# Their arguments may change places.
_COMMUTE = {*_TWINS, "Max", "hypot", "array_equal", "gcd", "suppress"}


def mistakes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """What could be written in a node's place by mistake: (kind, node)."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if not isinstance(left, ast.JoinedStr):
            if type(op) in _OPPOSITE:
                kind, other = _OPPOSITE[type(op)]
                yield kind, ast.BinOp(left, other(), right)
            if isinstance(op, (ast.Add, ast.Sub)):
                yield "dropped term", left
        case ast.AugAssign(target=target, op=op, value=value) if type(op) in _OPPOSITE:
            kind, other = _OPPOSITE[type(op)]
            yield kind, ast.AugAssign(target, other(), value)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield "sign", operand
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "condition", operand
        case ast.Compare(left=left, ops=[op], comparators=comparators):
            kind, other = _OPPOSITE[type(op)]
            yield kind, ast.Compare(left, [other()], comparators)
        case ast.BoolOp(op=op, values=values):
            kind, other = _OPPOSITE[type(op)]
            yield kind, ast.BoolOp(other(), values)
            yield "condition", values[0]
        case ast.If(test=test) | ast.IfExp(test=test) if not (
            isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"
        ):
            yield "condition always true", ast.Constant(True)
        case ast.Constant(value=value) if isinstance(value, (int, float)) and not isinstance(
            value, bool
        ):
            yield "constant", ast.Constant(2 * value if value else type(value)(1))
        case ast.Subscript(value=value, slice=ast.Constant(value=int(index))):
            yield "index", ast.Subscript(value, ast.Constant(index + 1))
        case ast.Subscript(
            value=value, slice=ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(index)))
        ):
            yield (
                "index",
                ast.Subscript(
                    value,
                    ast.Constant(index - 1)
                    if index == 1
                    else ast.UnaryOp(ast.USub(), ast.Constant(index - 1)),
                ),
            )
        case ast.Call(func=func, args=args, keywords=keywords):
            name = (
                func.id
                if isinstance(func, ast.Name)
                else func.attr
                if isinstance(func, ast.Attribute)
                else ""
            )
            if (
                name not in _COMMUTE
                and len(args) > 1
                and not any(isinstance(item, ast.Starred) for item in args[:2])
            ):
                yield "arguments swapped", ast.Call(func, [args[1], args[0], *args[2:]], keywords)
            for values in _neighbours([item.value for item in keywords]):
                given = [
                    ast.keyword(item.arg, value)
                    for item, value in zip(keywords, values, strict=True)
                ]
                yield "columns exchanged", ast.Call(func, args, given)
            if name == "abs" and len(args) == 1:
                yield "sign", args[0]
            if name in _TWINS:
                other = _TWINS[name]
                yield (
                    "extreme",
                    ast.Call(
                        ast.Name(other)
                        if isinstance(func, ast.Name)
                        else ast.Attribute(func.value, other),
                        args,
                        keywords,
                    ),
                )
        case ast.Dict(keys=keys, values=values) if None not in keys:
            for exchanged in _neighbours(values):
                yield "columns exchanged", ast.Dict(keys, exchanged)
        case _:
            return


def _neighbours(values: list[ast.expr]) -> Iterator[list[ast.expr]]:
    """The values with two neighbours exchanged."""
    for second in range(1, len(values)):
        yield [*values[: second - 1], values[second], values[second - 1], *values[second + 1 :]]


def _places(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes whose value matters when the program runs: not annotations, docstrings, decorators, nor what only a type checker reads."""
    todo: list[ast.AST] = [tree]
    while todo:
        node = todo.pop()
        yield node
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            todo += [
                item
                for item in (value if isinstance(value, list) else [value])
                if isinstance(item, ast.AST)
            ]


def python_mistakes(text: str) -> Iterator[Mistake]:
    """Yield every mistake in a Python module, except in docstrings and annotations."""
    lines = text.splitlines(keepends=True)
    begins = [0]
    for line in lines:
        begins.append(begins[-1] + len(line))

    def offset(line: int, column: int) -> int:
        """Return the index of a place; the columns of `ast` count bytes."""
        return begins[line - 1] + len(lines[line - 1].encode()[:column].decode())

    for node in _places(ast.parse(text)):
        for kind, other in mistakes(node):
            place = node.test if isinstance(node, ast.If | ast.IfExp) else node
            assert isinstance(place, ast.expr | ast.stmt)
            assert place.end_lineno is not None
            assert place.end_col_offset is not None
            written = ast.unparse(ast.fix_missing_locations(other))
            if written == ast.unparse(place):
                continue
            if isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare):
                written = f"({written})"
            start = offset(place.lineno, place.col_offset)
            end = offset(place.end_lineno, place.end_col_offset)
            yield Mistake(kind, place.lineno, start, end, text[start:end], written)


# Comments, strings, characters and preprocessor lines: no mistakes are made there.
_C_TEXT = re.compile(
    r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'|^[ \t]*#(?:\\\n|[^\n])*',
    re.DOTALL | re.MULTILINE,
)
_C_OPERATORS = {
    " + ": ("sign", " - "),
    " - ": ("sign", " + "),
    " += ": ("sign", " -= "),
    " -= ": ("sign", " += "),
    " * ": ("operator", " / "),
    " / ": ("operator", " * "),
    " < ": ("comparison", " <= "),
    " <= ": ("comparison", " < "),
    " > ": ("comparison", " < "),
    " >= ": ("comparison", " > "),
    " == ": ("comparison", " != "),
    " != ": ("comparison", " == "),
    " && ": ("condition", " || "),
    " || ": ("condition", " && "),
}
# An operator between spaces, a negation, a number that is no part of a name, or min and max.
_C_PLACE = re.compile(
    r" (?:[-+*/<>]|[-+<>=!]=|&&|\|\|) "
    r"|(?<=\()!(?=\w)"
    r"|(?<![\w.])(?:\d+\.\d*(?:e[-+]?\d+)?|\d+)(?![\w.])"
    r"|\bfm(?:ax|in)\b"
)


def c_mistakes(text: str) -> Iterator[Mistake]:
    """Yield mistakes in C code that still compile, except in comments, strings and macros."""
    code = _C_TEXT.sub(lambda match: re.sub(r"[^\n]", "\0", match[0]), text)
    for match in _C_PLACE.finditer(code):
        before = match[0]
        line = code.count("\n", 0, match.start()) + 1
        whole = code.splitlines()[line - 1].lstrip()
        if whole.startswith(("case ", "typedef ", "static const ", "enum ")):
            continue
        if before in _C_OPERATORS:
            kind, after = _C_OPERATORS[before]
        elif before == "!":
            kind, after = "condition", ""
        elif before in ("fmax", "fmin"):
            kind, after = "extreme", "fmin" if before == "fmax" else "fmax"
        elif "." in before:
            kind, after = "constant", repr(2.0 * float(before) if float(before) else 1.0)
        else:
            kind, after = "constant", str(2 * int(before) if int(before) else 1)
        yield Mistake(kind, line, match.start(), match.end(), before, after)


def mistakes_in(name: str, text: str) -> dict[int, list[Mistake]]:
    """Return the mistakes of a file, Python or C by its name, grouped by line."""
    found: dict[int, list[Mistake]] = {}
    for mistake in (python_mistakes if name.endswith(".py") else c_mistakes)(text):
        found.setdefault(mistake.line, []).append(mistake)
    return found
