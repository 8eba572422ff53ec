"""Rewrite abs, min and max of variables as complementarities, in a copy of the model.

    e = p - n,  0 <= p  complementary to  n >= 0
    |e| = p + n,   max(a, b) = b + p with e = a - b,   min(a, b) = a - p

The copy has the same points and objective. A pair with e != 0 at the answer is smooth there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pyomo.environ as pyo
from pyomo.common.gc_manager import PauseGC
from pyomo.core.base import Block
from pyomo.core.expr.numeric_expr import AbsExpression, MaxExpression, MinExpression
from pyomo.core.expr.visitor import ExpressionReplacementVisitor
from pyomo.mpec import Complementarity, complements


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothCopy:
    """A copy without kinks.

    users: the user's components by the `id` of their copies
    block: the added components
    """

    model: Any
    users: dict[int, Any]
    block: Any


def smooth_copy(model: Any) -> SmoothCopy:
    """Return a copy of the model without abs, min and max of its variables; only read the model."""
    with PauseGC():
        copy = model.clone()
        both = [
            zip(
                *(
                    list(one.component_data_objects(kind, descend_into=Block))
                    for one in (copy, model)
                ),
                strict=True,
            )
            for kind in (pyo.Var, pyo.Constraint, Complementarity)
        ]
        users = {id(mine): theirs for pairs in both for mine, theirs in pairs}
        block = pyo.Block(concrete=True)
        copy.add_component(_free_name(model), block)
        block.positive, block.negative = (
            pyo.VarList(domain=pyo.NonNegativeReals) for _ in range(2)
        )
        block.parts, block.pair = pyo.ConstraintList(), Complementarity(pyo.Any)
        visitor = _Replacing(block)
        for data in list(
            copy.component_data_objects(
                (pyo.Objective, pyo.Constraint), active=True, descend_into=Block
            )
        ):
            if data.parent_block() is not block:
                data.set_value(visitor.walk_expression(data.expr))
        for data in list(
            copy.component_data_objects(Complementarity, active=True, descend_into=Block)
        ):
            if data.parent_block() is not block:
                data._args = tuple(visitor.walk_expression(side) for side in data._args)
    return SmoothCopy(model=copy, users=users, block=block)


def _free_name(model: Any) -> str:
    name = "kinks"
    while model.component(name) is not None:
        name += "_"
    return name


class _Replacing(ExpressionReplacementVisitor):
    def __init__(self, block: Any) -> None:
        super().__init__(descend_into_named_expressions=True, remove_named_expressions=False)
        self._block = block

    def exitNode(self, node: Any, data: Any) -> Any:  # noqa: N802 - the visitor's own name
        rewritten = super().exitNode(node, data)
        if isinstance(rewritten, AbsExpression) and not rewritten.is_fixed():
            positive, negative = self._parts(rewritten.args[0])
            return positive + negative
        if isinstance(rewritten, MaxExpression | MinExpression) and not rewritten.is_fixed():
            chosen, *rest = rewritten.args
            for other in rest:
                positive, _ = self._parts(chosen - other)
                chosen = (
                    other + positive if isinstance(rewritten, MaxExpression) else chosen - positive
                )
            return chosen
        return rewritten

    def _parts(self, expression: Any) -> tuple[Any, Any]:
        block = self._block
        positive, negative = block.positive.add(), block.negative.add()
        now = pyo.value(expression, exception=False)
        if now is not None:
            positive.set_value(max(now, 0.0))
            negative.set_value(max(-now, 0.0))
        block.parts.add(positive - negative == expression)
        block.pair.add(len(block.positive), complements(positive >= 0, negative >= 0))
        return positive, negative
