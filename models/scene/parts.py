"""The parts of a scene except its contacts: coordinates, inputs, parameters, the task.

The module also contains limits of the score, known answers and drawn shapes.

    Coordinate(symbol=q, velocity=v, unit="m")
    Task(start=(1.0, 0.0), goal=(0.0, 0.0), running_cost=u**2, step=0.01, steps=100)

All are frozen, and checked when they are created.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import sympy as sp

from models.errors import SceneError, named_arguments
from models.scene.values import (
    as_expression,
    as_number,
    check_moving,
    check_name,
    check_symbol,
    check_text,
    check_unit,
    named_fields,
    settle,
    settle_bounds,
)

# Kinds of drawn shapes, and the possible numbers of lengths in their size.
_SHAPES = {"box": (2,), "disc": (1,), "line": (1,), "wall": (1, 2)}


@named_fields
@dataclass(frozen=True, kw_only=True)
class Limit:
    """The largest value of a metric with which a plan still holds, and the reason for that number.

    Attributes
    ----------
    metric
        Name of a metric of the verdict (docs/verdict.md).
    value
        Largest value, in the metric's unit; None waives the metric's default limit.
    reason
        Reason for this number; may be empty unless the limit is waived.
    """

    metric: str
    value: float | None
    reason: str

    def __post_init__(self) -> None:
        check_text("limit: metric", self.metric)
        check_text(f"limit on {self.metric}: reason", self.reason, empty=self.value is not None)
        if self.value is None:
            return
        settle(self, "value", as_number(f"limit on {self.metric}", self.value))
        if self.value < 0.0:
            raise SceneError(
                f"limit on {self.metric}: {self.value:g} is below 0, which no metric can be."
            )


def limits(**stated: tuple[float | None, str]) -> tuple[Limit, ...]:
    """Return limits by metric, each with its value and its reason.

    >>> limits(replay_error=(0.02, "twice what the time step leaves the continuous motion by"))
    (Limit(metric='replay_error', value=0.02, reason='twice what the time step leaves the continuous
        motion by'),)
    """
    return tuple(
        Limit(metric=metric, value=value, reason=reason)
        for metric, (value, reason) in stated.items()
    )


@named_arguments(SceneError)
def goal_limits(
    *, position: float | None = None, velocity: float | None = None, reason: str
) -> tuple[Limit, ...]:
    """Return the limits of the distance to the goal, the same for a plan and its replay.

    None: the goal needs no such limit.

    >>> [limit.metric for limit in goal_limits(position=0.02, reason="as much as the wall shall be pressed in")]
    ['terminal_position_error', 'replay_terminal_position_error']
    """
    return tuple(
        Limit(metric=f"{of}terminal_{part}_error", value=value, reason=reason)
        for part, value in (("position", position), ("velocity", velocity))
        if value is not None
        for of in ("", "replay_")
    )


def known_motion_limits(energy: str) -> tuple[Limit, ...]:
    """Return limits for a scene without inputs whose motion is known in closed form.

    energy: reason why the energy is conserved, and its amount.
    """
    known = "the continuous motion is known exactly: a replay that is further off than the tolerance of a closed form is wrong"
    evaluated = "the time step is evaluated, not solved for: only rounding is left"
    return limits(
        answer_error=(1.0, known),
        energy_residual_relative=(1e-8, energy),
        defect=(1e-9, evaluated),
    )


@named_fields
@dataclass(frozen=True, kw_only=True)
class Answer:
    """A known answer of the scene, which the judge compares with the replay of the free motion.

    Attributes
    ----------
    quantity
        Name of the known quantity, in words.
    value
        The known value, in the unit of the quantity.
    tolerance
        Largest difference from it, in the same unit; positive.
    source
        Source of the value.
    measure
        Name of the measured quantity (validate.judge.score.measures); empty: nothing is compared.
    """

    quantity: str
    value: float
    tolerance: float
    source: str
    measure: str = ""

    def __post_init__(self) -> None:
        check_text("answer: quantity", self.quantity)
        check_text(f"answer {self.quantity}: source", self.source, empty=True)
        for field in ("value", "tolerance"):
            settle(self, field, as_number(f"answer {self.quantity}: {field}", getattr(self, field)))
        if self.tolerance <= 0.0:
            raise SceneError(
                f"answer {self.quantity}: the tolerance is {self.tolerance:g}, but must be positive."
            )


@named_fields
@dataclass(frozen=True, kw_only=True)
class Shape:
    """The drawing of a body; a scene without shapes is planned and judged in the same way.

    Attributes
    ----------
    name
        Name of the body, which `bodies` of a contact uses.
    kind
        "box", "disc", "line" or "wall".
    x
        Horizontal place of the centre [m], of positions and parameters.
    y
        Vertical place of the centre [m], of positions and parameters.
    size
        (width, height) of a box, (radius,) of a disc, (length,) of a line, (length,) or
        (length, thickness) of a wall [m].
    angle
        Angle of the body, counter-clockwise [rad].
    """

    name: str
    kind: str
    x: sp.Expr
    y: sp.Expr
    size: tuple[sp.Expr | float, ...]
    angle: sp.Expr = sp.S.Zero

    def __post_init__(self) -> None:
        check_text("shape: name", self.name)
        if not isinstance(self.kind, str) or self.kind not in _SHAPES:
            raise SceneError(
                f"shape {self.name}: the kind {self.kind!r} is none of {', '.join(_SHAPES)}."
            )
        for field in ("x", "y", "angle"):
            settle(self, field, as_expression(f"shape {self.name}: {field}", getattr(self, field)))
        if not isinstance(self.size, (tuple, list)) or len(self.size) not in _SHAPES[self.kind]:
            raise SceneError(
                f"shape {self.name}: the size of a {self.kind} is a tuple of {' or '.join(map(str, _SHAPES[self.kind]))} lengths, not {self.size!r}."
            )
        settle(
            self,
            "size",
            tuple(as_expression(f"shape {self.name}: size", value) for value in self.size),
        )


class _Named:
    """A part that is named after its symbol."""

    symbol: sp.Symbol

    @property
    def name(self) -> str:
        """Return the name of the symbol."""
        return self.symbol.name

    def _checked(self, kind: str, symbol: str = "symbol") -> str:
        """Return the part's name in messages, after checking its symbol and the symbol's name.

        symbol: the field of the symbol.
        """
        where = f"{kind} {self.symbol}"
        check_moving(f"{where}: {symbol}", getattr(self, symbol))
        check_name(where, getattr(self, symbol).name)
        return where


@named_fields
@dataclass(frozen=True, kw_only=True)
class Parameter(_Named):
    """A physical constant of the scene.

    Attributes
    ----------
    symbol
        Its SymPy symbol; the name of the symbol is the name of the parameter.
    value
        Default value, in `unit`.
    unit
        Made of 1, kg, m, s, rad, N, J, W and Hz, such as "N s/m" or "rad/s^2"; "1" has no unit.
    lower
        Least value with which the scene makes sense, in `unit`.
    upper
        Largest value with which the scene makes sense, in `unit`.
    description
        Shown in reports and in the FMU.
    uncertainty
        Largest deviation from `value` in `robust`, in `unit`; None: a twentieth of `value`.
    uncertainty_reason
        Reason for this deviation; needed with an uncertainty.
    """

    symbol: sp.Symbol
    value: float
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""
    uncertainty: float | None = None
    uncertainty_reason: str = ""

    def __post_init__(self) -> None:
        where = f"parameter {self.symbol}"
        check_symbol(f"{where}: symbol", self.symbol)
        check_name(where, self.symbol.name)
        check_unit(where, self.unit)
        settle(self, "value", as_number(where, self.value))
        for field in ("lower", "upper"):
            settle(self, field, as_number(f"{where}: {field}", getattr(self, field), finite=False))
        if not self.lower <= self.value <= self.upper:
            raise SceneError(
                f"{where}: the value {self.value:g} {self.unit} lies outside its range [{self.lower:g}, {self.upper:g}]."
            )
        if self.uncertainty is not None:
            settle(self, "uncertainty", as_number(f"{where}: uncertainty", self.uncertainty))
            if not (
                self.uncertainty >= 0.0
                and self.lower <= self.value - self.uncertainty
                and self.value + self.uncertainty <= self.upper
            ):
                raise SceneError(
                    f"{where}: the uncertainty {self.uncertainty:g} {self.unit} must be at least 0 and stay within the range [{self.lower:g}, {self.upper:g}] around {self.value:g}."
                )
        check_text(
            f"{where}: uncertainty_reason", self.uncertainty_reason, empty=self.uncertainty is None
        )


@named_fields
@dataclass(frozen=True, kw_only=True)
class Coordinate(_Named):
    """A generalised position q and its velocity v = dq/dt.

    Attributes
    ----------
    symbol
        SymPy symbol of q; declare it with real=True.
    velocity
        SymPy symbol of v; declare it with real=True.
    unit
        "m" or "rad".
    nominal
        Typical magnitude of q, in `unit`, positive; default limits and tolerances are shares of it.
    velocity_lower
        Least velocity at the start of a step, in `unit`/s. A position has no bounds: make a contact.
    velocity_upper
        Largest velocity at the start of a step, in `unit`/s; the end belongs to the goal.
    description
        Shown in reports and in the FMU.
    """

    symbol: sp.Symbol
    velocity: sp.Symbol
    unit: str
    nominal: float = 1.0
    velocity_lower: float = -math.inf
    velocity_upper: float = math.inf
    description: str = ""

    def __post_init__(self) -> None:
        where = self._checked("coordinate")
        self._checked("coordinate", "velocity")
        check_unit(where, self.unit)
        settle(self, "nominal", as_number(f"{where}: nominal", self.nominal))
        if self.nominal <= 0:
            raise SceneError(f"{where}: nominal must be positive, not {self.nominal:g}.")
        settle_bounds(self, where, "velocity_lower", "velocity_upper")

    @property
    def has_velocity_bounds(self) -> bool:
        """Return whether the velocity has a finite bound."""
        return math.isfinite(self.velocity_lower) or math.isfinite(self.velocity_upper)

    @property
    def velocity_name(self) -> str:
        """Return the name of the velocity's symbol."""
        return self.velocity.name

    @property
    def velocity_unit(self) -> str:
        """Return the unit of the velocity: `unit` per second."""
        return f"{self.unit}/s"


@named_fields
@dataclass(frozen=True, kw_only=True)
class Input(_Named):
    """An actuator: a generalised force or torque u, constant over a step.

    Attributes
    ----------
    symbol
        SymPy symbol of u; declare it with real=True.
    unit
        "N" or "N m", or the unit that the forces make of it.
    lower
        Least value, in `unit`; a plan that leaves the bounds does not hold.
    upper
        Largest value, in `unit`.
    description
        Shown in reports and in the FMU.
    """

    symbol: sp.Symbol
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""

    def __post_init__(self) -> None:
        where = self._checked("input")
        check_unit(where, self.unit)
        settle_bounds(self, where, "lower", "upper")


@named_fields
@dataclass(frozen=True, kw_only=True)
class Task:
    """The motion from `start` to `goal` in `steps` steps of `step` seconds, at least cost.

    Attributes
    ----------
    start
        (2*nq,) all positions, then all velocities, in the order of the coordinates.
    goal
        (2*nq,) the same order; None leaves a component free at the end, goal=() all of them.
    running_cost
        Cost of q, v, u and parameters; summed over the starts of steps, not integrated over time.
    step
        Length of a time step [s].
    steps
        Number of steps; the plan lasts steps * step.
    final_cost
        Cost of q, v and parameters at the end; added to the sum once.
    """

    start: tuple[float, ...]
    goal: tuple[float | None, ...]
    running_cost: sp.Expr
    step: float
    steps: int
    final_cost: sp.Expr = sp.S.Zero

    def __post_init__(self) -> None:
        for field in ("start", "goal"):
            values = getattr(self, field)
            if field == "goal" and (values is None or values == ()):
                values = (None,) * len(self.start)
            if isinstance(values, str) or not isinstance(values, Iterable):
                raise SceneError(
                    f"task: {field} must be positions, then velocities, as a tuple of numbers, not {values!r}."
                )
            may_be_free = field == "goal"
            numbers = (
                None
                if may_be_free and value is None
                else as_number(f"task: {field}[{index}]", value)
                for index, value in enumerate(values)
            )
            settle(self, field, tuple(numbers))
        for field in ("running_cost", "final_cost"):
            settle(self, field, as_expression(f"task: {field}", getattr(self, field)))
        settle(self, "step", as_number("task: step", self.step))
        if self.step <= 0:
            raise SceneError(f"task: step must be positive seconds, not {self.step!r}.")
        if isinstance(self.steps, bool) or not isinstance(self.steps, int) or self.steps < 1:
            raise SceneError(
                f"task: steps must be a whole number of at least 1, not {self.steps!r}."
            )

    @property
    def horizon(self) -> float:
        """Return the duration T = steps * step [s]."""
        return self.steps * self.step

    @property
    def has_goal(self) -> bool:
        """Return whether any component of the end is given."""
        return any(value is not None for value in self.goal)
