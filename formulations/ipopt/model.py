"""Read the active parts of a Pyomo model, its data and its bounds.

Raise ModelRefusedError for everything that a solve would otherwise ignore.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pyomo.core.base import (
    Block,
    Constraint,
    Expression,
    ExternalFunction,
    Objective,
    Param,
    RangeSet,
    Set,
    Suffix,
    Var,
    minimize,
)
from pyomo.core.base.block import BlockData
from pyomo.core.base.component import ActiveComponent
from pyomo.core.expr import value
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.core.expr.relational_expr import (
    EqualityExpression,
    InequalityExpression,
    RangedExpression,
)

from formulations.ipopt.graph import UNARY


class ModelRefusedError(ValueError):
    """The model contains a component that a smooth solver cannot treat or would ignore."""


class NotSmoothError(ModelRefusedError):
    """The model applies abs, min or max to variables; `mpec_ipopt` accepts these."""


class MissingValueError(ValueError):
    """A Param, a fixed variable or a bound of the model has no finite value."""


class StructureChangedError(RuntimeError):
    """The model's structure differs from the compiled one; compile the model again."""


_ADVICE = {
    "abs": "use mpec_ipopt, which splits it into a pair, or write sqrt(x**2 + eps**2)",
    "max": "use mpec_ipopt, which writes it as a pair, or an epigraph variable t >= each argument",
    "min": "use mpec_ipopt, which writes it as a pair, or a hypograph variable t <= each argument",
    "Expr_if": "write the two cases as a complementarity or blend them smoothly",
}


class EvaluatedExpression:
    """An expression of data, read like a Param: `value` evaluates it."""

    __slots__ = ("expression",)

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    @property
    def value(self) -> float:
        """Return the current number."""
        return value(self.expression)

    @property
    def name(self) -> str:
        """Return the expression as text."""
        return str(self.expression)


def as_data(node: Any, where: Any) -> EvaluatedExpression:
    """Return the node as data; raise ModelRefusedError naming `where` if it has free variables."""
    if not node.is_fixed():
        name = node.getname() if hasattr(node, "getname") else type(node).__name__
        known = "known are + - * / ** and " + " ".join(sorted(UNARY))
        refusal = NotSmoothError if name in ("abs", "max", "min") else ModelRefusedError
        raise refusal(
            f"'{where.name}' applies {name} to a variable: only smooth functions can be handed to Ipopt ({_ADVICE.get(name, known)})"
        )
    return EvaluatedExpression(node)


_TREATED = frozenset(
    {Block, Constraint, Objective, Var, Param, Expression, Set, RangeSet, Suffix, ExternalFunction}
)

# Other components change the problem if they can be active, or are variables or expressions
# (a derivative without discretisation would be a free variable).
_MATTERS = (ActiveComponent, Var, Expression)

# Attributes by which Pyomo marks a row that represents a whole complementarity in a file for
# another solver; as a constraint the row states only half of the complementarity.
_HALF_COMPLEMENTARITY = ("_complementarity", "_complementarity_type")

_WHAT_TO_DO = {
    "DerivativeVar": "apply a dae transformation such as 'dae.collocation' first",
    "Integral": "apply a dae transformation such as 'dae.collocation' first",
    "Complementarity": "apply a transformation such as 'mpec.simple_nonlinear' to a clone first, or use SolverFactory('mpec_ipopt')",
    "Disjunction": "apply a gdp transformation first; its binary variables then need a mixed-integer solver",
    "Disjunct": "apply a gdp transformation first; its binary variables then need a mixed-integer solver",
    "LogicalConstraint": "logic needs binary variables and a mixed-integer solver",
    "SOSConstraint": "special ordered sets need a mixed-integer solver",
    "Port": "apply 'network.expand_arcs' first",
    "Arc": "apply 'network.expand_arcs' first",
}


def refuse_no_model(model: Any) -> None:
    """Raise ModelRefusedError if the object is not a Pyomo model, or is an abstract one."""
    if not isinstance(model, BlockData):
        raise ModelRefusedError(
            f"expected a Pyomo ConcreteModel or Block, got {type(model).__name__}"
        )
    if not model.is_constructed():
        raise ModelRefusedError(
            f"the model '{model.name}' is abstract: call create_instance() first"
        )


def refuse_unknown_components(model: Any, *, also: frozenset[type] = frozenset()) -> None:
    """Raise ModelRefusedError for an active component that a smooth problem cannot contain.

    `also` are component types that the caller treats itself.
    """
    refuse_no_model(model)
    for block in model.block_data_objects(active=True, descend_into=Block):
        for ctype in block.collect_ctypes(active=None, descend_into=False):
            if ctype in _TREATED or ctype in also or not issubclass(ctype, _MATTERS):
                continue
            for component in block.component_data_objects(ctype, active=True, descend_into=False):
                name = ctype.__name__
                advice = _WHAT_TO_DO.get(name, "deactivate it, or transform it into Constraints")
                raise ModelRefusedError(
                    f"'{component.name}' is an active {name}, which Ipopt cannot treat: {advice}"
                )
    if not model.active:
        raise ModelRefusedError(f"the model '{model.name}' is deactivated")
    for row in active_constraints(model):
        if any(hasattr(row, mark) for mark in _HALF_COMPLEMENTARITY):
            raise ModelRefusedError(
                f"constraint '{row.name}' is one half of a complementarity that 'mpec.nl' or 'mpec.standard_form' transformed: "
                "give the model before that transformation to SolverFactory('mpec_ipopt'), or apply 'mpec.simple_nonlinear' instead"
            )


def active_constraints(model: Any) -> list[Any]:
    """Return the active constraint data in declaration order, including nested blocks."""
    return list(model.component_data_objects(Constraint, active=True, descend_into=Block))


def active_objective(model: Any) -> Any | None:
    """Return the active objective, or None; raise ModelRefusedError if several are active."""
    objectives = list(model.component_data_objects(Objective, active=True, descend_into=Block))
    if len(objectives) > 1:
        names = ", ".join(f"'{o.name}'" for o in objectives[:3])
        raise ModelRefusedError(
            f"{len(objectives)} objectives are active ({names}{', ..' if len(objectives) > 3 else ''}): deactivate all but one"
        )
    return objectives[0] if objectives else None


def sense_of(objective: Any | None) -> int:
    """Return -1 for an objective to maximise, else +1."""
    return 1 if objective is None or objective.sense == minimize else -1


def sides_of(constraint: Any) -> tuple[Any, Any | None, Any, Any]:
    """Return (body, subtracted, lower, upper): lower <= body - subtracted <= upper.

    subtracted may be None; bounds are numbers, data expressions or None. Raises ModelRefusedError
    for a range with a variable bound, and without an expression.
    """
    expression = constraint.expr
    kind = expression.__class__
    if kind is EqualityExpression or kind is InequalityExpression:
        left, right = expression.args
        equal = kind is EqualityExpression
        if not is_potentially_variable(right):
            return left, None, right if equal else None, right
        if not is_potentially_variable(left):
            return right, None, left, left if equal else None
        return left, right, 0.0 if equal else None, 0.0
    if kind is RangedExpression:
        lower, body, upper = expression.args
        for bound in (lower, upper):
            if is_potentially_variable(bound) and not bound.is_fixed():
                raise ModelRefusedError(
                    f"constraint '{constraint.name}' is a range with a variable bound: write it as two constraints"
                )
        return body, None, lower, upper
    lower, body, upper = constraint.to_bounded_expression()
    if body is None:
        raise ModelRefusedError(f"constraint '{constraint.name}' has no expression")
    return body, None, lower, upper


def read_data(sources: tuple[Any, ...]) -> np.ndarray:
    """Return the numbers (data,) of Params, fixed variables and expressions [data units].

    Raises MissingValueError if a source has no value, or its value is not a number.
    """
    numbers = np.array([read_number(source) for source in sources], dtype=float)
    for k in np.flatnonzero(np.isnan(numbers)):
        raise MissingValueError(
            f"'{sources[k].name}' has no value (or not a number), and the model needs one{_why_none(sources[k])}"
        )
    return numbers


def read_number(source: Any) -> float:
    """Return the value of a Param, fixed variable or expression, NaN without a value."""
    try:
        return float(source.value)
    except (TypeError, ValueError, ArithmeticError):
        return math.nan


def _why_none(source: Any) -> str:
    try:
        float(source.value)
    except (TypeError, ValueError, ArithmeticError) as error:
        return f" ({' '.join(str(error).split())})"
    return ""


def read_bounds(variables: tuple[Any, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return lower (n,) and upper (n,) [variable units], infinite if missing.

    Raises MissingValueError if a bound has no value.
    """
    lower, upper = (
        np.array([bounds_of(variable) for variable in variables], dtype=float)
        .reshape(-1, 2)
        .T.copy()
    )
    return lower, upper


# Ipopt's nlp_upper_bound_inf.
_NO_BOUND = 1e19


def bounds_of(variable: Any) -> tuple[float, float]:
    """Return a variable's bounds, infinite if missing; raise MissingValueError without value."""
    try:
        low, high = variable.bounds
    except ValueError as error:
        raise MissingValueError(f"a bound of variable '{variable.name}' has no value") from error
    return (
        -math.inf if low is None else unbounded_if_huge(float(low)),
        math.inf if high is None else unbounded_if_huge(float(high)),
    )


def unbounded_if_huge(bound: float) -> float:
    """Return the bound, or infinity if Ipopt, AMPL and GAMS read the number as infinite."""
    return math.copysign(math.inf, bound) if abs(bound) >= _NO_BOUND else bound


def read_bound(expression: Any, kind: str, component: Any, unbounded: float) -> float:
    """Evaluate a bound; None counts as `unbounded`.

    Raises MissingValueError if the expression has no value.
    """
    try:
        number = value(expression)
    except (TypeError, ValueError, ArithmeticError) as error:
        raise MissingValueError(
            f"a bound of {kind} '{component.name}' has no value ({' '.join(str(error).split())})"
        ) from error
    return unbounded if number is None else unbounded_if_huge(float(number))
