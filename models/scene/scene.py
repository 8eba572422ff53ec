"""A scene: the physics of a few bodies in contact, written once in SymPy.

    q, v = sp.Symbol("q"), sp.Symbol("v")
    Scene(
        name="bouncing_mass",
        coordinates=(Coordinate(name="q", symbol=q, velocity=v, unit="m"),),
        kinetic_energy=m * v**2 / 2,
        potential_energy=m * g * q,
        contacts=(Contact(name="floor", bodies=("mass", "floor"), penetration=-q, stiffness=k, depth=0.5, depth_reason="the floor's springs are pressed flat"),),
        ...
    )

Everything else - Pyomo models, the PyTorch rollout, the C kernel, the FMU, the equations in the report - is
derived from this one object. All objects are frozen. Their parts are checked when they are created, their
physics when a scene is loaded or first derived from (models.scene.checks); what is wrong is said in
one sentence that names the scene and the field.

Sign conventions: `penetration` phi is positive in contact; the contact force lam >= 0 pushes the bodies apart, that is,
`M(q) dv/dt = tau(q, v, u) + J(q)' lam` with J the Jacobian of the gap (-phi). The true contact law is
`lam = stiffness * max(phi, 0)`; a contact may also have damping (models.scene.contacts).

What a scene says beside its physics: limits of the score, known answers, how its bodies are drawn.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import InitVar, dataclass, replace
from typing import Any

import sympy as sp

from models.errors import SceneError
from models.scene.contacts import Contact, Friction
from models.scene.values import (
    as_expression,
    as_number,
    check_moving,
    check_name,
    check_symbol,
    check_text,
    check_unit,
    settle,
    settle_bounds,
)

# The shapes that are drawn, and how many lengths their size may have.
_SHAPES = {"box": (2,), "disc": (1,), "line": (1,), "wall": (1, 2)}


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The largest value of a metric of the score with which a plan still holds, and the reason for that number.

    value: in the metric's unit; None waives the limit that the metric has by default (validate.judge.score.table), which takes a reason too.
    """

    metric: str = ""
    value: float | None
    reason: str
    figure: InitVar[str | None] = None  # what `metric` was called up to version 0.1

    def __post_init__(self, figure: str | None) -> None:
        if figure is not None:
            raise SceneError(f"limit on {figure}: figure= is now called metric=; write Limit(metric={figure!r}, value=.., reason=..).")
        check_text("limit: metric", self.metric)
        check_text(f"limit on {self.metric}: reason", self.reason, empty=self.value is not None)
        if self.value is None:
            return
        settle(self, "value", as_number(f"limit on {self.metric}", self.value))
        if self.value < 0.0:
            raise SceneError(f"limit on {self.metric}: {self.value:g} is below 0, which no metric can be.")


def goal_limits(*, position: float | None = None, velocity: float | None = None, reason: str) -> tuple[Limit, ...]:
    """How near to the goal is near enough, the same for a plan and its replay; None where the goal asks for none.

    >>> [limit.metric for limit in goal_limits(position=0.02, reason="as much as the wall shall be pressed in")]
    ['terminal_position_error', 'replay_terminal_position_error']
    """
    return tuple(
        Limit(metric=f"{of}terminal_{part}_error", value=value, reason=reason)
        for part, value in (("position", position), ("velocity", velocity))
        if value is not None
        for of in ("", "replay_")
    )


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A known answer of the scene: what it is, its value, tolerance and source.

    measure: what to hold against it in the replay of the free motion, by a name that the score knows (validate.judge.score.equations); empty: nothing.
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
            raise SceneError(f"answer {self.quantity}: the tolerance is {self.tolerance:g}, but must be positive.")


@dataclass(frozen=True, kw_only=True)
class Shape:
    """How a body is drawn: `kind` "box", "disc", "line" or "wall"; `x`, `y` its centre and `angle`, as expressions in q [m, rad];
    `size`: (width, height), (radius,), or (length,) [m]."""

    name: str
    kind: str
    x: sp.Expr
    y: sp.Expr
    size: tuple[sp.Expr | float, ...]
    angle: sp.Expr = sp.S.Zero

    def __post_init__(self) -> None:
        check_text("shape: name", self.name)
        if not isinstance(self.kind, str) or self.kind not in _SHAPES:
            raise SceneError(f"shape {self.name}: the kind {self.kind!r} is none of {', '.join(_SHAPES)}.")
        for field in ("x", "y", "angle"):
            settle(self, field, as_expression(f"shape {self.name}: {field}", getattr(self, field)))
        if not isinstance(self.size, (tuple, list)) or len(self.size) not in _SHAPES[self.kind]:
            raise SceneError(
                f"shape {self.name}: the size of a {self.kind} is a tuple of {' or '.join(map(str, _SHAPES[self.kind]))} lengths, not {self.size!r}."
            )
        settle(self, "size", tuple(as_expression(f"shape {self.name}: size", value) for value in self.size))


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A physical constant of the scene.

    symbol: its SymPy symbol; value: default, in `unit`; lower, upper: the range in which the scene makes sense.
    """

    symbol: sp.Symbol
    value: float
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""

    def __post_init__(self) -> None:
        where = f"parameter {self.symbol}"
        check_symbol(f"{where}: symbol", self.symbol)
        check_name(where, self.symbol.name)
        check_unit(where, self.unit)
        settle(self, "value", as_number(where, self.value))
        for field in ("lower", "upper"):
            settle(self, field, as_number(f"{where}: {field}", getattr(self, field), finite=False))
        if not self.lower <= self.value <= self.upper:
            raise SceneError(f"{where}: the value {self.value:g} {self.unit} lies outside its range [{self.lower:g}, {self.upper:g}].")

    @property
    def name(self) -> str:
        return self.symbol.name


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """A generalised position q and its velocity v = dq/dt. `nominal`: a typical magnitude of q, in `unit`.

    velocity_lower, velocity_upper: bounds of v at the start of every step, as the inputs have theirs; the end belongs to the goal.
    """

    symbol: sp.Symbol
    velocity: sp.Symbol
    unit: str
    nominal: float = 1.0
    velocity_lower: float = -math.inf
    velocity_upper: float = math.inf
    description: str = ""

    def __post_init__(self) -> None:
        where = f"coordinate {self.symbol}"
        for field, symbol in (("symbol", self.symbol), ("velocity", self.velocity)):
            check_moving(f"{where}: {field}", symbol)
            check_name(where, symbol.name)
        check_unit(where, self.unit)
        settle(self, "nominal", as_number(f"{where}: nominal", self.nominal))
        if self.nominal <= 0:
            raise SceneError(f"{where}: nominal must be positive, not {self.nominal:g}.")
        settle_bounds(self, where, "velocity_lower", "velocity_upper")

    @property
    def has_velocity_bounds(self) -> bool:
        return math.isfinite(self.velocity_lower) or math.isfinite(self.velocity_upper)

    @property
    def name(self) -> str:
        return self.symbol.name

    @property
    def velocity_name(self) -> str:
        return self.velocity.name

    @property
    def velocity_unit(self) -> str:
        return f"{self.unit}/s"


@dataclass(frozen=True, kw_only=True)
class Input:
    """An actuator: a generalised force or torque u within [lower, upper], in `unit`."""

    symbol: sp.Symbol
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""

    def __post_init__(self) -> None:
        where = f"input {self.symbol}"
        check_moving(f"{where}: symbol", self.symbol)
        check_name(where, self.symbol.name)
        check_unit(where, self.unit)
        settle_bounds(self, where, "lower", "upper")

    @property
    def name(self) -> str:
        return self.symbol.name


@dataclass(frozen=True, kw_only=True)
class Task:
    """What is to be done: from `start` to `goal` in `steps` steps of `step` seconds, at least cost.

    start, goal: (2*nq,) positions then velocities; a goal of None leaves its component free at the end, and a goal of nothing but None is
    a free end. running_cost: an expression in q, v, u and parameters, summed over the starts of the steps (not integrated: as in the
    paper, cost = sum_t u^2); final_cost: an expression in q, v and parameters, of the last state, added to that sum.
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
            if isinstance(values, str) or not isinstance(values, Iterable):
                raise SceneError(f"task: {field} must be positions, then velocities, as a tuple of numbers, not {values!r}.")
            may_be_free = field == "goal"
            numbers = (
                None if may_be_free and value is None else as_number(f"task: {field}[{index}]", value) for index, value in enumerate(values)
            )
            settle(self, field, tuple(numbers))
        for field in ("running_cost", "final_cost"):
            settle(self, field, as_expression(f"task: {field}", getattr(self, field)))
        settle(self, "step", as_number("task: step", self.step))
        if self.step <= 0:
            raise SceneError(f"task: step must be positive seconds, not {self.step!r}.")
        if isinstance(self.steps, bool) or not isinstance(self.steps, int) or self.steps < 1:
            raise SceneError(f"task: steps must be a whole number of at least 1, not {self.steps!r}.")

    @property
    def horizon(self) -> float:
        """Duration T = steps * step [s]."""
        return self.steps * self.step

    @property
    def has_goal(self) -> bool:
        """Whether any component of the end is given."""
        return any(value is not None for value in self.goal)


# What the parts of a scene are made of.
_PARTS = {
    "coordinates": Coordinate,
    "inputs": Input,
    "parameters": Parameter,
    "contacts": Contact,
    "frictions": Friction,
    "limits": Limit,
    "answers": Answer,
    "shapes": Shape,
}


@dataclass(frozen=True, kw_only=True)
class Scene:
    """The single source of one scene; see the module docstring.

    kinetic_energy T(q, v) [J], potential_energy V(q) [J] (without contacts), forces Q(q, v, u): (nq,) non-conservative
    generalised forces (inputs, damping) [N, N m]; the equations of motion follow by Lagrange (models.dynamics). quick: whether a quick campaign
    runs it; False where its first plan that holds takes about a minute, or another pipeline. length [m]: what counts as far here, which relaxed contact is measured in
    (models.contact_law); the paper's metre unless a scene is much smaller. unstable: why a robot needs feedback here whatever its plan, as a sentence;
    empty: a plan is expected to hold by its inputs alone. relaxation_time: of a scene without inertia, the symbol by which its drag
    becomes mass; lag [s]: its value where the scene is judged, None on a grid, whose step it is then (models.quasi_static).
    """

    name: str
    title: str
    source: str
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    parameters: tuple[Parameter, ...]
    kinetic_energy: sp.Expr
    potential_energy: sp.Expr
    forces: tuple[sp.Expr, ...]
    contacts: tuple[Contact, ...]
    task: Task
    frictions: tuple[Friction, ...] = ()
    limits: tuple[Limit, ...] = ()
    answers: tuple[Answer, ...] = ()
    shapes: tuple[Shape, ...] = ()
    quick: bool = True
    length: float = 1.0
    unstable: str = ""
    relaxation_time: sp.Symbol | None = None
    lag: float | None = None

    def __post_init__(self) -> None:
        from models.quasi_static import check_quasi_static, relaxation_parameter
        from models.scene.checks import check_scene

        for field, kind in _PARTS.items():
            value = getattr(self, field)
            if not isinstance(value, (tuple, list)):
                raise SceneError(f"scene {self.name}: {field} must be a tuple, not {type(value).__name__}.")
            for index, item in enumerate(value):
                if not isinstance(item, kind):
                    raise SceneError(f"scene {self.name}: {field}[{index}] must be a {kind.__name__}, not {type(item).__name__}.")
            settle(self, field, tuple(value))
        if not isinstance(self.task, Task):
            raise SceneError(f"scene {self.name}: task must be a Task, not {type(self.task).__name__}.")
        if not isinstance(self.forces, (tuple, list)):
            raise SceneError(f"scene {self.name}: forces must be a tuple, not {type(self.forces).__name__}.")
        settle(
            self, "forces", tuple(as_expression(f"scene {self.name}: forces[{index}]", force) for index, force in enumerate(self.forces))
        )
        if self.relaxation_time is not None:
            # It follows the task's step, whatever was changed.
            others = tuple(item for item in self.parameters if item.symbol != self.relaxation_time)
            settle(self, "parameters", (*others, relaxation_parameter(self)))
        settle(self, "length", as_number(f"scene {self.name}: length", self.length))
        for field in ("kinetic_energy", "potential_energy"):
            settle(self, field, as_expression(f"scene {self.name}: {field}", getattr(self, field)))
        check_scene(self)
        check_quasi_static(self)

    @property
    def nq(self) -> int:
        return len(self.coordinates)

    @property
    def nu(self) -> int:
        return len(self.inputs)

    @property
    def nc(self) -> int:
        return len(self.contacts)

    @property
    def nf(self) -> int:
        return len(self.frictions)

    @property
    def damped(self) -> tuple[int, ...]:
        """The damped contacts, by their places among the contacts."""
        return tuple(index for index, contact in enumerate(self.contacts) if contact.is_damped)

    @property
    def nl(self) -> int:
        """Forces a plan holds for each step: nc contact forces, then nf friction forces."""
        return self.nc + self.nf

    @property
    def relaxation_index(self) -> int | None:
        """The place of the relaxation time among the parameters, the last; None for a scene with inertia."""
        return None if self.relaxation_time is None else len(self.parameters) - 1

    @property
    def force_names(self) -> tuple[str, ...]:
        """(nl,) as in the columns of a plan."""
        return tuple(item.force_name for item in (*self.contacts, *self.frictions))

    @property
    def parameter_values(self) -> dict[sp.Symbol, float]:
        return {parameter.symbol: parameter.value for parameter in self.parameters}

    def limit(self, metric: str) -> Limit | None:
        """What this scene says of the limit on a metric, or None: then the metric's default holds."""
        return next((limit for limit in self.limits if limit.metric == metric), None)

    @property
    def depths(self) -> tuple[float, ...]:
        """(nc,) penetration of each contact at which the model ends [m], at the values of the parameters."""
        return tuple(float(contact.depth.subs(self.parameter_values).evalf()) for contact in self.contacts)

    def with_parameters(self, **values: float) -> Scene:
        """This scene with other parameter values, e.g. `scene.with_parameters(k=300.0)`. Raises SceneError for unknown names."""
        known = [parameter.name for parameter in self.parameters]
        for name in values:
            if name not in known:
                raise SceneError(f"scene {self.name}: there is no parameter {name!r}; it has {', '.join(known)}.")
            if self.relaxation_time is not None and name == self.relaxation_time.name:
                raise SceneError(f"scene {self.name}: {name} is the relaxation time, which is the task's step; change that.")
        parameters = tuple(replace(parameter, value=float(values.get(parameter.name, parameter.value))) for parameter in self.parameters)
        return replace(self, parameters=parameters)

    def with_task(self, **changes: Any) -> Scene:
        """This scene with another task, e.g. `scene.with_task(steps=1000, step=0.005)`."""
        return replace(self, task=replace(self.task, **changes))

    def continuous(self, lag: float | None = None) -> Scene:
        """This scene as it is judged, in continuous time: without inertia but for a `lag` (models.quasi_static.LAG unless given [s]); itself where it has
        inertia, or is that already."""
        from models.quasi_static import LAG

        if self.relaxation_time is None or (self.lag is not None and lag is None):
            return self
        return replace(self, lag=LAG if lag is None else lag)
