"""Which Pyomo classes mean which operation. Exact classes are looked up; a class met for the first time is asked what it is."""

from __future__ import annotations

from typing import Any

from pyomo.common.numeric_types import native_numeric_types, native_types
from pyomo.core.base.expression import ExpressionData, ScalarExpression
from pyomo.core.base.objective import ObjectiveData, ScalarObjective
from pyomo.core.base.param import ParamData, ScalarParam
from pyomo.core.base.var import ScalarVar, VarData
from pyomo.core.expr import numeric_expr as pe

from formulations.ipopt.errors import ModelRefusedError

NUMBER, LEAF, MONOMIAL, SUM, PRODUCT, DIVISION, NEGATION, POWER, FUNCTION, NAMED, OTHER = range(11)

KIND: dict[type, int] = {
    VarData: LEAF, ScalarVar: LEAF, ParamData: LEAF, ScalarParam: LEAF,
    pe.MonomialTermExpression: MONOMIAL,
    pe.SumExpression: SUM, pe.LinearExpression: SUM, pe.NPV_SumExpression: SUM,
    pe.ProductExpression: PRODUCT, pe.NPV_ProductExpression: PRODUCT,
    pe.DivisionExpression: DIVISION, pe.NPV_DivisionExpression: DIVISION,
    pe.NegationExpression: NEGATION, pe.NPV_NegationExpression: NEGATION,
    pe.PowExpression: POWER, pe.NPV_PowExpression: POWER,
    pe.UnaryFunctionExpression: FUNCTION, pe.NPV_UnaryFunctionExpression: FUNCTION,
    ExpressionData: NAMED, ScalarExpression: NAMED, ObjectiveData: NAMED, ScalarObjective: NAMED,
}  # fmt: skip


def is_data(node: Any) -> bool:
    return node.__class__ in native_types or not node.is_potentially_variable()


def kind_of(node: Any) -> int:
    """The kind of an expression node or leaf."""
    known = KIND.get(node.__class__)
    return classify(node, node.__class__) if known is None else known


def classify(node: Any, cls: type) -> int:
    """The kind of a class that was not met before; remembered unless it depends on the object."""
    if cls in native_numeric_types:
        KIND[cls] = NUMBER
        return NUMBER
    if not hasattr(node, "is_numeric_type") or not node.is_numeric_type():
        raise ModelRefusedError(f"{str(node)!r} of type {cls.__name__} is not a number, a Param, a variable or a numeric expression")
    if node.is_variable_type() or node.is_parameter_type():
        return LEAF
    if node.is_named_expression_type():
        return NAMED
    return OTHER
