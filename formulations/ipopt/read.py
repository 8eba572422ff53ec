"""Read Pyomo expressions into linear triplets and nonlinear terms, without recursion.

    m.p * x[1] + 3 * x[2] - sin(x[1] * x[2]) + 4

gives the triplet (row, x[2], 3), the constant 4, and the terms ("*", "p", 0) and ("sin", "*", 0, 1)
with weights 1 and -1. A term that is too long as a tree starts with `"shared"`: operands come
first, and `("ref", k)` repeats the k-th operation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pyomo.common.numeric_types import native_numeric_types
from pyomo.core.base.expression import ExpressionData, ScalarExpression
from pyomo.core.base.objective import ObjectiveData, ScalarObjective
from pyomo.core.base.param import ParamData, ScalarParam
from pyomo.core.base.var import ScalarVar, VarData
from pyomo.core.expr import numeric_expr as pe
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.core.expr.visitor import identify_variables

from formulations.ipopt.graph import UNARY
from formulations.ipopt.model import EvaluatedExpression, ModelRefusedError, as_data

(
    _NUMBER,
    _LEAF,
    _MONOMIAL,
    _SUM,
    _PRODUCT,
    _DIVISION,
    _NEGATION,
    _POWER,
    _FUNCTION,
    _NAMED,
    _OTHER,
    _READ,
) = range(12)


class _Read(NamedTuple):
    node: Any
    operator: Any


_KIND: dict[type, int] = {
    VarData: _LEAF, ScalarVar: _LEAF, ParamData: _LEAF, ScalarParam: _LEAF,
    pe.MonomialTermExpression: _MONOMIAL,
    pe.SumExpression: _SUM, pe.LinearExpression: _SUM, pe.NPV_SumExpression: _SUM,
    pe.ProductExpression: _PRODUCT, pe.NPV_ProductExpression: _PRODUCT,
    pe.DivisionExpression: _DIVISION, pe.NPV_DivisionExpression: _DIVISION,
    pe.NegationExpression: _NEGATION, pe.NPV_NegationExpression: _NEGATION,
    pe.PowExpression: _POWER, pe.NPV_PowExpression: _POWER,
    pe.UnaryFunctionExpression: _FUNCTION, pe.NPV_UnaryFunctionExpression: _FUNCTION,
    ExpressionData: _NAMED, ScalarExpression: _NAMED, ObjectiveData: _NAMED,
    ScalarObjective: _NAMED,
    _Read: _READ,
}  # fmt: skip


def _kind_of(node: Any) -> int:
    known = _KIND.get(node.__class__)
    return _classify(node, node.__class__) if known is None else known


def _classify(node: Any, cls: type) -> int:
    if cls in native_numeric_types:
        _KIND[cls] = _NUMBER
        return _NUMBER
    if not hasattr(node, "is_numeric_type") or not node.is_numeric_type():
        raise ModelRefusedError(
            f"{str(node)!r} of type {cls.__name__} is not a number, a Param, a variable or a numeric expression"
        )
    if node.is_variable_type() or node.is_parameter_type():
        return _LEAF
    if node.is_named_expression_type():
        return _NAMED
    return _OTHER


_ONE = ("c", 1.0)
# A data factor is carried into a sum with more summands than this, so that p * (x1**2 + .. +
# x5000**2) is 5000 small terms instead of a huge one.
_WIDE_SUM = 16
# Nodes inspected in the search for a wide sum.
_SHORT_LOOK = 64
# After this many repeated summands, sums are left to the reader of shared terms. A sum repeated
# inside one expression (e = e + 0.1 * e, sixty times) is a small graph but a huge tree.
_REPEATED = 100_000
# A term with more tokens is read as a shared term: repeated substitution (x_next = f(x), five
# hundred times) gives a small graph but a huge tree.
_LONG_TERM = 4_000


@dataclass
class Bucket:
    """All terms of one signature, in parallel flat lists.

    slots, numbers and params have a fixed number of entries per term.
    """

    rows: list[int] = field(default_factory=list)
    weights: list[float] = field(default_factory=list)
    slots: list[int] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)
    params: list[int] = field(default_factory=list)


class TermReader:
    """Read the expressions of one model into rows.

    Variables get columns in order of first appearance; Params and fixed variables get data numbers.
    """

    def __init__(self, rows: int) -> None:
        self.variables: list[Any] = []
        # Params, fixed variables, EvaluatedExpressions: all have `.value`.
        self.data: list[Any] = []
        # Named expressions and their content when read.
        self.named: dict[int, tuple[Any, Any]] = {}
        self.buckets: dict[tuple, Bucket] = {}
        self.rows: list[int] = []
        self.columns: list[int] = []
        self.slopes: list[float] = []
        self.constants = [0.0] * rows
        self._place: dict[int, int] = {}  # id(leaf) -> column >= 0, or ~(data number)
        self._domains: dict[int, tuple[Any, bool]] = {}
        self.where: Any = None

    # -- leaves

    def place(self, leaf: Any) -> int:
        """Return the column of a free variable, or ~k for the k-th datum.

        Raises ModelRefusedError for a variable that is not continuous.
        """
        place = self._place.get(id(leaf))
        if place is not None:
            return place
        if leaf.__class__ is EvaluatedExpression:
            for variable in identify_variables(leaf.expression, include_fixed=True):
                self.place(variable)  # a refresh then detects an unfixed variable
        elif leaf.is_variable_type() and not leaf.fixed:
            self._require_continuous(leaf)
            self._place[id(leaf)] = len(self.variables)
            self.variables.append(leaf)
            return len(self.variables) - 1
        self._place[id(leaf)] = ~len(self.data)
        self.data.append(leaf)
        return ~(len(self.data) - 1)

    def _require_continuous(self, variable: Any) -> None:
        domain = variable.domain
        entry = self._domains.get(id(domain))
        if entry is None:
            entry = self._domains[id(domain)] = (domain, variable.is_continuous())
        if not entry[1]:
            raise ModelRefusedError(
                f"variable '{variable.name}' has the domain {variable.domain.name}: Ipopt treats continuous variables only "
                "(fix it, relax it with core.relax_integer_vars, or use a mixed-integer solver)"
            )

    # -- top level: a sum of terms

    def read(self, row: int, expression: Any, sign: float, where: Any) -> None:
        """Add sign * expression to a row; `where` is the component named in messages.

        Raises ModelRefusedError if this is not a smooth expression of continuous variables.
        """
        self.where = where
        place, kind = self._place.get, _KIND.get
        rows, columns, slopes = self.rows, self.columns, self.slopes
        met: set[int] = set()
        repeated = 0
        # (summand, number, data or None): their product
        stack: list[tuple[Any, float, Any]] = [(expression, sign, None)]
        while stack:
            node, weight, data = stack.pop()
            code = kind(node.__class__)
            if code is None:
                code = _kind_of(node)
            if code == _MONOMIAL and data is None:
                factor, variable = (
                    node._args_ if node.__class__ is pe.MonomialTermExpression else node.args
                )
                if factor.__class__ in native_numeric_types:
                    column = place(id(variable))
                    if column is None:
                        column = self.place(variable)
                    if column >= 0:
                        rows.append(row)
                        columns.append(column)
                        slopes.append(weight * factor)
                        continue
                self._term(row, weight, node, None)
            elif code == _LEAF and data is None:
                column = place(id(node))
                if column is None:
                    column = self.place(node)
                if column >= 0:
                    rows.append(row)
                    columns.append(column)
                    slopes.append(weight)
                else:
                    self._term(row, weight, node, None)
            elif code == _SUM:
                if repeated > _REPEATED:
                    self._term(row, weight, node, data)
                    continue
                children = node.args
                if id(node) in met:
                    repeated += len(children)
                met.add(id(node))
                stack.extend((child, weight, data) for child in reversed(children))
            elif code == _NUMBER and data is None:
                self.constants[row] += weight * node
            elif code == _NEGATION:
                stack.append((node.args[0], -weight, data))
            elif code == _NAMED:
                stack.append((self.open_named(node), weight, data))
            elif code in (_PRODUCT, _DIVISION):
                self._factor(row, node, weight, data, stack)
            else:
                self._term(row, weight, node, data)

    def _factor(
        self, row: int, node: Any, weight: float, data: Any, stack: list[tuple[Any, float, Any]]
    ) -> None:
        """Move numbers of a product or quotient into the weight, and data into wide sums."""
        inside, factor, divides = _data_factor(node)
        if factor.__class__ in native_numeric_types and not (divides and factor == 0):
            stack.append((inside, weight / factor if divides else weight * factor, data))
        elif factor is not None and (data is not None or _leads_to_wide_sum(inside)):
            carried = 1.0 if data is None else data
            stack.append((inside, weight, carried / factor if divides else carried * factor))
        elif (multiplied := _variable_and_wide_sum(node)) is not None:
            variable, summands = multiplied
            stack.extend((variable * summand, weight, data) for summand in reversed(summands))
        else:
            self._term(row, weight, node, data)

    def open_named(self, named: Any) -> Any:
        """Return the content of a named expression; raise ModelRefusedError if it is empty."""
        inside = named.args[0]
        self.named[id(named)] = (named, inside)
        if inside is None:
            raise ModelRefusedError(
                f"'{self.where.name}' uses the expression '{named.name}', which has not been given a value"
            )
        return inside

    def _term(self, row: int, weight: float, node: Any, data: Any) -> None:
        if data is not None:
            node = data * node
        signature, slots, numbers, params = self._tokens(node)
        bucket = self.buckets.get(signature)
        if bucket is None:
            bucket = self.buckets[signature] = Bucket()
        bucket.rows.append(row)
        bucket.weights.append(weight)
        bucket.slots += slots
        bucket.numbers += numbers
        bucket.params += params

    # -- one term

    def _tokens(
        self, root: Any, *, shared: bool = False
    ) -> tuple[tuple, list[int], list[float], list[int]]:
        """Return tokens, columns by slot, numbers and data numbers of a term.

        shared: operands first, and each subexpression once.
        """
        place, kind = self._place.get, _KIND.get
        tokens: list[Any] = ["shared"] if shared else []
        numbers: list[float] = []
        params: list[int] = []
        slot: dict[int, int] = {}
        written: dict[int, int] = {}  # id(expression) -> number of its operation
        stack = [root]
        while stack:
            node = stack.pop()
            code = kind(node.__class__)
            if code is None:
                code = _kind_of(node)
            if code == _LEAF:
                where = place(id(node))
                if where is None:
                    where = self.place(node)
                if where >= 0:
                    tokens.append(slot.setdefault(where, len(slot)))
                else:
                    tokens.append("p")
                    params.append(~where)
            elif code == _NUMBER:
                if node == 1:
                    tokens.append(_ONE)
                else:
                    tokens.append("n")
                    numbers.append(node)
            # Duplicate of `_operator` for speed: products are a tenth of the whole translation.
            elif not shared and code in (_PRODUCT, _MONOMIAL):
                tokens.append("*")
                stack.extend(reversed(node.args))
            elif code == _NAMED:
                stack.append(self.open_named(node))
            elif code == _READ:
                tokens.append(node.operator)
                written[id(node.node)] = len(written)
            elif id(node) in written:
                tokens.append(("ref", written[id(node)]))
            else:
                operation = _operator(node, code)
                if operation is None:
                    tokens.append("p")
                    params.append(~self.place(as_data(node, self.where)))
                    continue
                operator, operands = operation
                if shared:
                    stack.append(_Read(node, operator))
                else:
                    tokens.append(operator)
                stack.extend(reversed(operands))
            if len(tokens) > _LONG_TERM and not shared:
                return self._tokens(root, shared=True)
        return tuple(tokens), list(slot), numbers, params


def _operator(node: Any, code: int) -> tuple[Any, Sequence[Any]] | None:
    if code in (_PRODUCT, _MONOMIAL):
        return "*", node.args
    if code == _SUM:
        operands = node.args
        return ("+", len(operands)), operands
    if code == _POWER:
        base, exponent = node.args
        return (
            (("^", float(exponent)), (base,))
            if exponent.__class__ in native_numeric_types
            else ("^", (base, exponent))
        )
    if code == _DIVISION:
        return "/", node.args
    if code == _NEGATION:
        return "neg", node.args
    if code == _FUNCTION and node.getname() in UNARY:
        return node.getname(), node.args
    return None


def _data_factor(node: Any) -> tuple[Any, Any, bool]:
    """Return (rest, data, whether it divides) of a product or quotient, or (node, None, False)."""
    left, right = node.args
    if _kind_of(node) == _DIVISION:
        return (node, None, False) if is_potentially_variable(right) else (left, right, True)
    if left.__class__ in native_numeric_types:
        return right, left, False
    if right.__class__ in native_numeric_types:
        return left, right, False
    if not is_potentially_variable(left):
        return right, left, False
    return (node, None, False) if is_potentially_variable(right) else (left, right, False)


def _variable_and_wide_sum(node: Any) -> tuple[Any, Sequence[Any]] | None:
    """Return (variable, summands) of a variable times a wide sum, else None.

    In x' A x each row of A would be a shape with a dense Hessian: 6 of 8 CPU s with 100 variables.
    """
    if _kind_of(node) == _PRODUCT:
        for variable, summands in (node.args, node.args[::-1]):
            if (
                _kind_of(variable) == _LEAF
                and _kind_of(summands) == _SUM
                and summands.nargs() > _WIDE_SUM
            ):
                return variable, summands.args
    return None


def _leads_to_wide_sum(node: Any) -> bool:
    stack = [node]
    for _ in range(_SHORT_LOOK):
        if not stack:
            return False
        node = stack.pop()
        code = _kind_of(node)
        if code == _SUM:
            if node.nargs() > _WIDE_SUM:
                return True
            stack.extend(node.args)
        elif code in (_NEGATION, _NAMED):
            stack.append(node.args[0])
        elif code in (_PRODUCT, _DIVISION):
            inside, factor, _ = _data_factor(node)
            if factor is not None:
                stack.append(inside)
    return False
