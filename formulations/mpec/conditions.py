"""What a model's Complementarity components say, in words this solver works with.

    complements(a, b):  both relations hold, and at least one of the inequalities holds as an equality.

Pyomo accepts two finite bounds in all: one on each side (`SimpleCondition`, two expressions of which none is negative and one is zero), both on
one side (`BoxCondition`: l <= body <= u complements a free expression that is >= 0 at l, <= 0 at u and 0 between), or an equality
(`EqualityCondition`: it always holds as an equality, hence nothing is left to choose; the other side holds as it is written).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pyomo.common.numeric_types import native_numeric_types
from pyomo.core.base import Block
from pyomo.core.expr import value
from pyomo.core.expr.relational_expr import EqualityExpression, InequalityExpression, RangedExpression
from pyomo.mpec import Complementarity

from formulations.ipopt.errors import MissingValueError, ModelRefusedError


@dataclass(frozen=True, kw_only=True, eq=False)
class SimpleCondition:
    """0 <= first, 0 <= second, one of them is 0. Flips are -1 where a side is an upper bound minus what the user wrote, else 1."""

    data: Any
    first: Any
    second: Any
    first_flip: float
    second_flip: float


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxCondition:
    """lower <= body <= upper complements free; body is the argument of that number (0 or 1)."""

    data: Any
    argument: int
    body: Any
    lower: Any
    upper: Any
    free: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class EqualityCondition:
    """(number of the argument, (lower, body, upper)) of what must hold; nothing to choose."""

    data: Any
    relations: tuple[tuple[int, tuple[Any, Any, Any]], ...]


Condition = SimpleCondition | BoxCondition | EqualityCondition


def read_conditions(model: Any) -> list[Condition]:
    """Every active Complementarity of a model, in order of declaration; ModelRefusedError names one that cannot be understood."""
    return [_condition(data) for data in model.component_data_objects(Complementarity, active=True, descend_into=Block)]


def _condition(data: Any) -> Condition:
    sides = getattr(data, "_args", None)
    if not sides:
        raise ModelRefusedError(f"complementarity '{data.name}' holds no condition: give it complements(.., ..), or deactivate it")
    relations = tuple(_relation(side, data) for side in sides)
    bounds = tuple(sum(bound is not None for bound in (lower, upper)) for lower, _, upper in relations)
    if any(isinstance(side, EqualityExpression) for side in sides):
        return EqualityCondition(data=data, relations=tuple(enumerate(relations)))
    if sum(bounds) != 2:
        raise ModelRefusedError(
            f"complementarity '{data.name}' has {sum(bounds)} finite bounds, but needs two in all: 'expr >= l' on each side, or 'l <= expr <= u' "
            "on one side and an expression without bounds on the other"
        )
    if bounds == (1, 1):
        (first, first_flip), (second, second_flip) = (_distance(relation) for relation in relations)
        return SimpleCondition(data=data, first=first, second=second, first_flip=first_flip, second_flip=second_flip)
    argument = 0 if bounds == (2, 0) else 1
    (lower, body, upper), (_, free, _) = relations[argument], relations[1 - argument]
    if _number(lower, data) == _number(upper, data):
        return EqualityCondition(data=data, relations=((argument, relations[argument]),))
    return BoxCondition(data=data, argument=argument, body=body, lower=lower, upper=upper, free=free)


def _relation(side: Any, data: Any) -> tuple[Any, Any, Any]:
    """(lower, body, upper) of one argument of `complements`; a bound is None where there is none."""
    kind = side.__class__
    if kind is EqualityExpression:
        return 0.0, side.arg(0) - side.arg(1), 0.0
    if kind is InequalityExpression or kind is RangedExpression:
        strict = side.strict if isinstance(side.strict, (tuple, list)) else (side.strict,)
        if any(strict):
            raise ModelRefusedError(f"complementarity '{data.name}' has a strict inequality ({side}): write <= or >=")
        if kind is RangedExpression:
            lower, body, upper = side.args
            return _finite(lower, data, -math.inf), body, _finite(upper, data, math.inf)
        left, right = side.args
        if _is_number(right):
            return None, left, _finite(right, data, math.inf)
        if _is_number(left):
            return _finite(left, data, -math.inf), right, None
        return 0.0, right - left, None
    if side.__class__ in native_numeric_types or (hasattr(side, "is_numeric_type") and side.is_numeric_type()):
        return None, side, None
    raise ModelRefusedError(f"complementarity '{data.name}' has {side!r} on one side, which is neither an expression nor a relation")


def _is_number(expression: Any) -> bool:
    return expression.__class__ in native_numeric_types or not expression.is_potentially_variable()


def _finite(bound: Any, data: Any, unbounded: float) -> Any:
    """The bound, None for an infinite one."""
    if not _is_number(bound):
        raise ModelRefusedError(
            f"complementarity '{data.name}' has a range with a variable bound ({bound}): write its two sides as differences"
        )
    return None if _number(bound, data) == unbounded else bound


def _number(bound: Any, data: Any) -> float:
    try:
        number = float(value(bound))
    except (TypeError, ValueError, ArithmeticError) as error:
        raise MissingValueError(f"a bound of complementarity '{data.name}' has no value ({' '.join(str(error).split())})") from error
    if math.isnan(number):
        raise MissingValueError(f"a bound of complementarity '{data.name}' is not a number")
    return number


def _distance(relation: tuple[Any, Any, Any]) -> tuple[Any, float]:
    """(how far the body is inside its one bound, sign of the body in it)."""
    lower, body, upper = relation
    if upper is None:
        return (body if lower.__class__ in native_numeric_types and lower == 0 else body - lower), 1.0
    return upper - body, -1.0
