"""Build a shadow of the user's model, in which every complementarity is a pair of variables.

    0 <= v,  0 <= w,  v w = 0   v: Pyomo's variable of the pair; w: a user's variable or a slack

The shadow references the user's rows and is otherwise independent; the user's model is never
written. Pairs come from `mpec.simple_nonlinear`: `v`, its equation `ve`, the product `ccon`: v w <=
mpec_bound, a mutable Param. complements(a, b) means: both relations hold, and one inequality holds
with equality. The arguments have one of these forms:

- one finite bound on each side
- two bounds on one side (a box): l <= body <= u with a free expression that is >= 0 at l, <= 0 at
  u, 0 between
- an equality, which leaves nothing to choose
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pyomo.environ as pyo
from pyomo.common.gc_manager import PauseGC
from pyomo.common.numeric_types import native_numeric_types
from pyomo.core.base import Block
from pyomo.core.base.var import VarData
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.core.expr.relational_expr import (
    EqualityExpression,
    InequalityExpression,
    RangedExpression,
)
from pyomo.mpec import Complementarity, complements

from formulations.ipopt import MissingValueError, ModelRefusedError
from formulations.ipopt.model import (
    active_constraints,
    active_objective,
    read_bound,
    refuse_unknown_components,
)

Relation = tuple[Any, Any, Any]
Sides = tuple[tuple[int, float], tuple[int, float]]


def relation_of(side: Any, data: Any) -> Relation:
    """Return (lower, body, upper) of one argument of `complements`; a missing bound is None.

    Raises ModelRefusedError for a strict inequality, variable bounds of a range, or no relation,
    MissingValueError if a bound has no value.
    """
    kind = side.__class__
    if kind is EqualityExpression:
        return 0.0, side.arg(0) - side.arg(1), 0.0
    if kind is InequalityExpression or kind is RangedExpression:
        strict = side.strict if isinstance(side.strict, (tuple, list)) else (side.strict,)
        if any(strict):
            raise ModelRefusedError(
                f"complementarity '{data.name}' has a strict inequality ({side}): write <= or >="
            )
        if kind is RangedExpression:
            lower, body, upper = side.args
            return _finite(lower, data, -math.inf), body, _finite(upper, data, math.inf)
        left, right = side.args
        if not is_potentially_variable(right):
            return None, left, _finite(right, data, math.inf)
        if not is_potentially_variable(left):
            return _finite(left, data, -math.inf), right, None
        return 0.0, right - left, None
    if side.__class__ in native_numeric_types or (
        hasattr(side, "is_numeric_type") and side.is_numeric_type()
    ):
        return None, side, None
    raise ModelRefusedError(
        f"complementarity '{data.name}' has {side!r} on one side, which is neither an expression nor a relation"
    )


def _finite(bound: Any, data: Any, unbounded: float) -> Any:
    if is_potentially_variable(bound):
        raise ModelRefusedError(
            f"complementarity '{data.name}' has a range with a variable bound ({bound}): write its two sides as differences"
        )
    return None if _number(bound, data) == unbounded else bound


def _number(bound: Any, data: Any) -> float:
    number = read_bound(bound, "complementarity", data, math.nan)
    if math.isnan(number):
        raise MissingValueError(f"a bound of complementarity '{data.name}' is not a number")
    return number


def _distance(relation: Relation) -> tuple[Any, float]:
    lower, body, upper = relation
    if upper is None:
        return (
            body if lower.__class__ in native_numeric_types and lower == 0 else body - lower
        ), 1.0
    return upper - body, -1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class LiftedPair:
    """Two variables v, w >= 0 of the shadow, one of which is 0.

    - data: the transformed Complementarity with `v`, `ve`, `ccon`
    - second: w
    - condition: the user's Complementarity
    - twin: the user's variable that v equals, if the first side is a variable with lower bound 0
    - swapped: whether v is the side of the second argument
    - sides: for v and w, the argument of `complements` that has its multiplier, and the sign (0:
      none)
    """

    data: Any
    second: Any
    condition: Any
    twin: Any | None
    swapped: bool
    sides: Sides

    @property
    def first(self) -> Any:
        """Return v."""
        return self.data.v


@dataclass(frozen=True, kw_only=True, eq=False)
class Lifted:
    """The shadow and its pairs.

    conditions: the user's Complementarity data
    imposed: (condition, number of its argument, row) of relations without a choice
    """

    shadow: Any
    conditions: tuple[Any, ...]
    pairs: tuple[LiftedPair, ...]
    imposed: tuple[tuple[Any, int, Any], ...]

    def relaxation(self) -> Any:
        """Return a new empty block for a relaxation.

        Remove products and the previous relaxation.
        """
        shadow = self.shadow
        shadow.del_component("relaxation")
        shadow.relaxation = pyo.Block()
        self.products(active=False)
        if self.objective is not None:
            self.objective.activate()
        return shadow.relaxation

    @property
    def objective(self) -> Any | None:
        """Return the objective of the shadow, or None."""
        return next(self.shadow.component_objects(pyo.Objective, descend_into=False), None)

    def products(self, *, active: bool) -> None:
        """Switch all products v w <= mpec_bound on or off."""
        for pair in self.pairs:
            if active:
                pair.data.ccon.activate()
            else:
                pair.data.ccon.deactivate()


_OWN = ("user_rows", "slack", "slack_rows", "pair", "relaxation")


def lift(model: Any) -> Lifted:
    """Read a model and build its shadow.

    Raises ModelRefusedError for an unsupported component, MissingValueError for a bound without
    value.
    """
    refuse_unknown_components(model, also=frozenset({Complementarity}))
    with PauseGC():
        shadow = pyo.ConcreteModel(name=model.name)
        rows = active_constraints(model)
        if rows:
            shadow.user_rows = pyo.Reference(dict(enumerate(rows)), ctype=pyo.Constraint)
        objective = active_objective(model)
        if objective is not None:
            # The user's name for messages; it must not clash with the other components.
            name = "user_objective" if objective.name in _OWN else objective.name
            shadow.add_component(name, pyo.Objective(expr=objective.expr, sense=objective.sense))
        shadow.slack = pyo.VarList(domain=pyo.Reals)
        shadow.slack_rows = pyo.ConstraintList()
        conditions = tuple(
            model.component_data_objects(Complementarity, active=True, descend_into=Block)
        )
        all_choices: list[tuple[Any, Any, Any, bool, Sides]] = []
        held: list[tuple[Any, int, Relation]] = []
        for condition in conditions:
            choices, relations = _read(shadow, condition)
            all_choices += [(condition, *choice) for choice in choices]
            held += [(condition, argument, relation) for argument, relation in relations]
        imposed = [
            (condition, argument, _impose(shadow, *relation))
            for condition, argument, relation in held
        ]
        shadow.pair = Complementarity(
            range(len(all_choices)),
            rule=lambda _, k: complements(all_choices[k][1] >= 0, all_choices[k][2] >= 0),
        )
        transformed = tuple(shadow.pair[k] for k in range(len(all_choices)))
        pyo.TransformationFactory("mpec.simple_nonlinear").apply_to(shadow, mpec_bound=1.0)
        for data in transformed:
            # w >= 0 is already the bound of w; a row would add a slack.
            data.c.deactivate()
    pairs = tuple(
        LiftedPair(
            data=data,
            second=second,
            condition=condition,
            twin=first if _is_nonnegative_variable(first) else None,
            swapped=swapped,
            sides=sides,
        )
        for data, (condition, first, second, swapped, sides) in zip(
            transformed, all_choices, strict=True
        )
    )
    return Lifted(
        shadow=shadow,
        conditions=conditions,
        pairs=pairs,
        imposed=tuple(item for item in imposed if item[2] is not None),
    )


def _read(
    shadow: Any, data: Any
) -> tuple[list[tuple[Any, Any, bool, Sides]], list[tuple[int, Relation]]]:
    """Return the choices of a Complementarity, and the relations that hold without a choice.

    A choice is (expression, variable with lower bound 0, whether swapped, sides), a relation
    (number of the argument, relation). Raises ModelRefusedError for an invalid condition.
    """
    arguments = getattr(data, "_args", None)
    if not arguments:
        raise ModelRefusedError(
            f"complementarity '{data.name}' holds no condition: give it complements(.., ..), or deactivate it"
        )
    relations = tuple(relation_of(side, data) for side in arguments)
    if any(isinstance(side, EqualityExpression) for side in arguments):
        return [], list(enumerate(relations))
    bounds = tuple(
        sum(bound is not None for bound in (lower, upper)) for lower, _, upper in relations
    )
    if sum(bounds) != 2:
        raise ModelRefusedError(
            f"complementarity '{data.name}' has {sum(bounds)} finite bounds, but needs two in all: 'expr >= l' on each side, or 'l <= expr <= u' "
            "on one side and an expression without bounds on the other"
        )
    if bounds == (1, 1):
        (first, first_flip), (second, second_flip) = (_distance(relation) for relation in relations)
        sides: Sides = ((0, first_flip), (1, second_flip))
        swapped = _is_nonnegative_variable(first) and not _is_nonnegative_variable(second)
        if swapped:
            first, second, sides = second, first, (sides[1], sides[0])
        first = _expression(shadow, first)
        return [
            (
                first,
                second if _is_nonnegative_variable(second) else _slack(shadow, second),
                swapped,
                sides,
            )
        ], []
    box, other = (0, 1) if bounds == (2, 0) else (1, 0)
    (lower, body, upper), (_, free, _) = relations[box], relations[other]
    if _number(lower, data) == _number(upper, data):
        return [], [(box, relations[box])]
    above, below = shadow.slack.add(), shadow.slack.add()
    above.setlb(0.0)
    below.setlb(0.0)
    shadow.slack_rows.add(above - below == free)
    return [
        (_expression(shadow, body - lower), above, False, ((box, 1.0), (other, 1.0))),
        (_expression(shadow, upper - body), below, False, ((box, -1.0), (other, 0.0))),
    ], []


def _impose(shadow: Any, lower: Any, body: Any, upper: Any) -> Any | None:
    body = _expression(shadow, body)
    if lower is not None and upper is not None:
        return shadow.slack_rows.add(
            body == lower
            if pyo.value(lower) == pyo.value(upper)
            else pyo.inequality(lower, body, upper)
        )
    if lower is not None:
        return shadow.slack_rows.add(body >= lower)
    return None if upper is None else shadow.slack_rows.add(body <= upper)


def _slack(shadow: Any, expression: Any) -> Any:
    slack = shadow.slack.add()
    slack.setlb(0.0)
    shadow.slack_rows.add(slack == expression)
    return slack


def _is_nonnegative_variable(expression: Any) -> bool:
    return (
        isinstance(expression, VarData)
        and not expression.fixed
        and expression.lb is not None
        and expression.lb >= 0.0
    )


def _expression(shadow: Any, expression: Any) -> Any:
    """Return a fixed variable for a number, because Pyomo evaluates relations between numbers."""
    if expression.__class__ not in native_numeric_types:
        return expression
    constant = shadow.slack.add()
    constant.fix(float(expression))
    return constant
