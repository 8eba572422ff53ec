"""Operations without a derivative rule: data where they depend on data alone, refused where they depend on a variable."""

from __future__ import annotations

from typing import Any

from pyomo.core.expr import value

from formulations.ipopt.errors import ModelRefusedError
from formulations.ipopt.graph import UNARY

_ADVICE = {
    "abs": "write sqrt(x**2 + eps**2), or split x = xp - xn with xp, xn >= 0",
    "max": "write an epigraph variable t >= each argument, or a smooth maximum",
    "min": "write a hypograph variable t <= each argument, or a smooth minimum",
    "Expr_if": "write the two cases as a complementarity or blend them smoothly",
}


class EvaluatedExpression:
    """Data that is an expression rather than a Param: `value` evaluates it (Expr_if, max, abs, .. of data)."""

    __slots__ = ("expression",)

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    @property
    def value(self) -> float:
        return value(self.expression)

    @property
    def name(self) -> str:
        return str(self.expression)


def as_data(node: Any, where: Any) -> EvaluatedExpression:
    """The node as data; raises ModelRefusedError naming the component `where` if it depends on a free variable."""
    if not node.is_fixed():
        name = node.getname() if hasattr(node, "getname") else type(node).__name__
        known = "known are + - * / ** and " + " ".join(sorted(UNARY))
        raise ModelRefusedError(
            f"'{where.name}' applies {name} to a variable: only smooth functions can be handed to Ipopt ({_ADVICE.get(name, known)})"
        )
    return EvaluatedExpression(node)
