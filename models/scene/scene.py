"""A scene: the physics of a few bodies in contact, written once in SymPy.

    q, v = sp.Symbol("q"), sp.Symbol("v")
    Scene(
        name="bouncing_mass",
        coordinates=(Coordinate(symbol=q, velocity=v, unit="m"),),
        kinetic_energy=m * v**2 / 2,
        potential_energy=m * g * q,
        contacts=(Contact(name="floor", bodies=("mass", "floor"), penetration=-q, stiffness=k, depth=0.5, depth_reason="the floor's springs are pressed flat"),),
        ...
    )

Everything else is derived from this one object: Pyomo models, the PyTorch rollout, the C kernel,
the FMU, the equations in the report. All objects are frozen, and checked when they are created. The
physics is checked when a scene is loaded or first derived from (models.scene.checks). An error is
one sentence that names the scene and the field.

Sign conventions: `penetration` phi is positive in contact. The contact force lam >= 0 pushes the
bodies apart: `M(q) dv/dt = tau(q, v, u) + J(q)' lam`, with J the Jacobian of the gap (-phi). The
true contact law is `lam = stiffness * max(phi, 0)`; a contact may also have damping
(models.scene.contacts).
"""

from __future__ import annotations

import keyword
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import sympy as sp

from models.errors import SceneError, nearest
from models.scene.contacts import Contact, Friction
from models.scene.parts import Answer, Coordinate, Input, Limit, Parameter, Shape, Task
from models.scene.quasi_static import LAG, check_quasi_static, relaxation_parameter
from models.scene.values import (
    as_expression,
    as_number,
    check_symbol,
    check_text,
    named_fields,
    settle,
)

# Names with a meaning of their own in plans and reports.
_TAKEN = {
    "t": "the time in a plan",
    "time": "the time in a plan and in an FMU",
    "h": "the time step in the equations of a report",
}
# Words of C: no name may be one in a generated file.
_WORDS_OF_C = """
    auto case char const default do double enum extern float goto inline int long register restrict short signed sizeof static
    struct switch typedef union unsigned void volatile
"""
# Reason why a name may not be that of a quantity, by the name.
_RESERVED = {
    **dict.fromkeys(_WORDS_OF_C.split(), "a word of C"),
    **dict.fromkeys(keyword.kwlist, "a word of Python"),
    **_TAKEN,
}
# Largest number of values in a plan: 8 GB.
_MOST_NUMBERS = 10**9

# Similarity from which an unknown name counts as a misspelling of another.
_ALIKE = 0.8

# Types of the parts of a scene.
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


class Counted:
    """Counts and names of the parts of a model.

    The model is a scene or an external FMU (validate.judge.replay.subject).
    """

    coordinates: tuple[Any, ...]
    inputs: tuple[Any, ...]
    contacts: tuple[Any, ...]
    frictions: tuple[Any, ...]
    limits: tuple[Limit, ...]

    @property
    def nq(self) -> int:
        """Return the number of coordinates."""
        return len(self.coordinates)

    @property
    def nu(self) -> int:
        """Return the number of inputs."""
        return len(self.inputs)

    @property
    def nc(self) -> int:
        """Return the number of contacts."""
        return len(self.contacts)

    @property
    def nf(self) -> int:
        """Return the number of frictions."""
        return len(self.frictions)

    @property
    def nl(self) -> int:
        """Return the number of forces of a step: nc contact forces, then nf friction forces."""
        return self.nc + self.nf

    @property
    def force_names(self) -> tuple[str, ...]:
        """Return the (nl,) names of the forces, as in the columns of a plan."""
        return tuple(item.force_name for item in (*self.contacts, *self.frictions))

    def limit(self, metric: str) -> Limit | None:
        """Return the scene's limit of a metric, or None: then the metric's default holds."""
        return next((limit for limit in self.limits if limit.metric == metric), None)


@named_fields
@dataclass(frozen=True, kw_only=True)
class Scene(Counted):
    """The physics of bodies in contact, and the task to plan; nq is the number of coordinates.

    Attributes
    ----------
    name
        Name of the scene file without .py.
    title
        One line, shown in lists and reports.
    source
        Source of the equations.
    coordinates
        Positions and velocities, in the order of `start`, `goal` and `forces`.
    inputs
        Actuators; () if there are none.
    parameters
        Constants; () if there are none.
    kinetic_energy
        T(q, v) [J], quadratic in the velocities.
    potential_energy
        V(q) [J], without the contacts.
    forces
        (nq,) generalised forces without those of contact and friction, one a coordinate: N for m,
        N m for rad.
    contacts
        Unilateral contacts; () if there are none.
    task
        Start, goal, cost and time steps.
    frictions
        Dry friction.
    limits
        Limits of this scene; other metrics have a default limit. A goal needs some (`goal_limits`).
    answers
        Known answers.
    shapes
        How the bodies are drawn.
    quick
        True if `all --quick` runs the scene.
    length
        Range of relaxed contact at gap zero [m]: b = |ln eps| / length. The default is the smallest
        depth of the contacts.
    unstable
        Reason why every plan needs feedback; empty: a plan must hold by its inputs alone.
    relaxation_time
        For a scene without inertia: symbol that turns drag into mass (models.scene.quasi_static).
    lag
        Leave it out: the judge sets it [s].
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
    length: float = None  # pyright: ignore[reportAssignmentType] - settled when it is created
    unstable: str = ""
    relaxation_time: sp.Symbol | None = None
    lag: float | None = None

    def __post_init__(self) -> None:
        for field, kind in _PARTS.items():
            value = getattr(self, field)
            if not isinstance(value, (tuple, list)):
                raise SceneError(
                    f"scene {self.name}: {field} must be a tuple, not {type(value).__name__}; "
                    f"write {field}=({kind.__name__}(..),), with a comma behind each, or {field}=() for none."
                )
            for index, item in enumerate(value):
                if not isinstance(item, kind):
                    raise SceneError(
                        f"scene {self.name}: {field}[{index}] must be a {kind.__name__}, not {type(item).__name__}."
                    )
            settle(self, field, tuple(value))
        if not isinstance(self.task, Task):
            raise SceneError(
                f"scene {self.name}: task must be a Task, not {type(self.task).__name__}."
            )
        if not isinstance(self.forces, (tuple, list)):
            raise SceneError(
                f"scene {self.name}: forces must be a tuple, not {type(self.forces).__name__}; "
                "write forces=(u,), one for each coordinate, with a comma behind each."
            )
        settle(
            self,
            "forces",
            tuple(
                as_expression(f"scene {self.name}: forces[{index}]", force)
                for index, force in enumerate(self.forces)
            ),
        )
        if self.relaxation_time is not None:
            check_symbol(f"scene {self.name}: relaxation_time", self.relaxation_time)
            # The relaxation time follows every change of the task's step.
            others = tuple(item for item in self.parameters if item.symbol != self.relaxation_time)
            tau = relaxation_parameter(
                self.relaxation_time, self.task.step if self.lag is None else self.lag
            )
            settle(self, "parameters", (*others, tau))
        if self.length is not None:
            settle(self, "length", as_number(f"scene {self.name}: length", self.length))
        for field in ("kinetic_energy", "potential_energy"):
            settle(self, field, as_expression(f"scene {self.name}: {field}", getattr(self, field)))
        _check(self)
        if self.length is None:
            # At gap 0 softplus contact pushes with ln 2/|ln eps| k L. At eps = 1e-3 this is a tenth
            # of the force at which the contact model ends.
            settle(self, "length", min(self.depths, default=1.0))

    @property
    def damped(self) -> tuple[int, ...]:
        """Return the indices of the damped contacts."""
        return tuple(index for index, contact in enumerate(self.contacts) if contact.is_damped)

    @property
    def relaxation_index(self) -> int | None:
        """Return the index of the relaxation time among the parameters, the last one.

        None for a scene with inertia.
        """
        return None if self.relaxation_time is None else len(self.parameters) - 1

    @property
    def parameter_values(self) -> dict[sp.Symbol, float]:
        """Return the values of the parameters by symbol."""
        return {parameter.symbol: parameter.value for parameter in self.parameters}

    @property
    def depths(self) -> tuple[float, ...]:
        """Return the (nc,) penetrations [m] at which the contact model ends."""
        return tuple(
            float(contact.depth.subs(self.parameter_values).evalf()) for contact in self.contacts
        )

    def with_parameters(self, **values: float) -> Scene:
        """Return the scene with other parameter values, e.g. `scene.with_parameters(k=300.0)`.

        Raises SceneError for unknown names.
        """
        known = [parameter.name for parameter in self.parameters]
        for name in values:
            if name not in known:
                raise SceneError(
                    f"scene {self.name}: there is no parameter {name!r}; it has {', '.join(known)}."
                )
            if self.relaxation_time is not None and name == self.relaxation_time.name:
                raise SceneError(
                    f"scene {self.name}: {name} is the relaxation time, which is the task's step; change that."
                )
        parameters = tuple(
            replace(parameter, value=float(values.get(parameter.name, parameter.value)))
            for parameter in self.parameters
        )
        return replace(self, parameters=parameters)

    def with_task(self, **changes: Any) -> Scene:
        """Return the scene with another task, e.g. `scene.with_task(steps=1000, step=0.005)`."""
        return replace(self, task=replace(self.task, **changes))

    def continuous(self, lag: float | None = None) -> Scene:
        """Return the scene as it is judged, in continuous time.

        A scene with inertia, or already in continuous time, is returned unchanged.

        lag: the relaxation time of a scene without inertia [s]; None: LAG of
        models.scene.quasi_static.
        """
        if self.relaxation_time is None or (self.lag is not None and lag is None):
            return self
        return replace(self, lag=LAG if lag is None else lag)


def _check(scene: Scene) -> None:
    """Check a new scene.

    Raises SceneError with one sentence naming the scene and the field.
    """
    _check_names(scene)
    _check_words(scene)
    _check_lengths(scene)
    _check_steps(scene)
    _check_symbols(scene)
    _check_bodies(scene)
    _check_limits(scene)
    if scene.relaxation_time is not None:
        check_quasi_static(
            scene.name, scene.relaxation_time, scene.kinetic_energy, scene.coordinates, scene.forces
        )
    elif scene.lag is not None:
        raise _fail(
            scene, "lag is the value of a relaxation time, but it names none (relaxation_time=..)."
        )


def _fail(scene: Scene, text: str) -> SceneError:
    return SceneError(f"scene {scene.name}: {text}")


def _check_names(scene: Scene) -> None:
    if not isinstance(scene.name, str) or not (scene.name.isidentifier() and scene.name.isascii()):
        raise SceneError(
            f"scene: the name {scene.name!r} is not an identifier of ASCII letters, which an FMU needs; use letters, digits and _ (it must equal the file name)."
        )
    if not scene.coordinates:
        raise _fail(scene, "it has no coordinates; a scene needs at least one.")
    for kind, items in (("contacts", scene.contacts), ("frictions", scene.frictions)):
        for name, count in Counter(item.name for item in items).items():
            if count > 1:
                raise _fail(
                    scene, f"{count} {kind} are named {name!r}; each needs a name of its own."
                )
    names = [coordinate.name for coordinate in scene.coordinates] + [
        coordinate.velocity_name for coordinate in scene.coordinates
    ]
    names += [item.name for item in scene.inputs] + [
        parameter.name for parameter in scene.parameters
    ]
    names += [name for contact in scene.contacts for name in (contact.force_name, contact.gap_name)]
    names += [contact.pressing_name for contact in scene.contacts if contact.is_damped]
    names += [
        name for friction in scene.frictions for name in (friction.force_name, friction.slip_name)
    ]
    for name, count in Counter(names).items():
        if count > 1:
            raise _fail(
                scene,
                f"the name {name!r} is used {count} times; coordinates, velocities, inputs, parameters, contacts and frictions need names of their own.",
            )
        if name in _RESERVED:
            raise _fail(
                scene, f"the name {name!r} is reserved: it is {_RESERVED[name]}; choose another."
            )


def _check_words(scene: Scene) -> None:
    for field in ("title", "source"):
        check_text(f"scene {scene.name}: {field}", getattr(scene, field))
    check_text(f"scene {scene.name}: unstable", scene.unstable, empty=True)
    if scene.length is not None and scene.length <= 0:
        raise _fail(
            scene,
            f"length (in m, what relaxed contact is measured in) must be positive, not {scene.length:g}.",
        )
    if not isinstance(scene.quick, bool):
        raise _fail(
            scene,
            f"quick says whether a quick campaign runs the scene: True or False, not {scene.quick!r}.",
        )


def _check_lengths(scene: Scene) -> None:
    if len(scene.forces) != scene.nq:
        raise _fail(
            scene,
            f"forces has {len(scene.forces)} entries, but there are {scene.nq} coordinates; give one generalised force each.",
        )
    for field in ("start", "goal"):
        length = len(getattr(scene.task, field))
        if length != 2 * scene.nq:
            raise _fail(
                scene,
                f"task.{field} has {length} numbers, but {2 * scene.nq} are needed: {scene.nq} positions, then {scene.nq} velocities.",
            )
    for coordinate, velocity in zip(scene.coordinates, scene.task.start[scene.nq :], strict=True):
        if not coordinate.velocity_lower <= velocity <= coordinate.velocity_upper:
            raise _fail(
                scene,
                f"task.start has {coordinate.velocity_name} = {velocity:g}, outside its bounds "
                f"[{coordinate.velocity_lower:g}, {coordinate.velocity_upper:g}].",
            )


def _check_steps(scene: Scene) -> None:
    """Check that a plan alone fits into memory; methods need hundreds of times as much."""
    each = 1 + 2 * scene.nq + scene.nu + scene.nl
    if scene.task.steps * each > _MOST_NUMBERS:
        raise _fail(
            scene,
            f"task.steps is {scene.task.steps}: a plan would hold {scene.task.steps * each:.3g} numbers of 8 bytes, more than a machine's memory; "
            f"{each} a step allow {_MOST_NUMBERS // each} steps at most.",
        )


class NamedExpression(NamedTuple):
    """An expression of a scene with its field in messages, its meaning and its unit.

    - unit: None if its author chooses it
    - of: kinds of symbols it may depend on: p parameters, q positions, v velocities, u inputs
    """

    field: str
    expression: sp.Expr
    what: str
    unit: str | None
    of: str


def named_expressions(scene: Scene) -> list[NamedExpression]:
    """Return all expressions of the equations of motion, the contact laws and the cost."""
    found = [
        NamedExpression("kinetic_energy", scene.kinetic_energy, "an energy", "J", "pqv"),
        NamedExpression("potential_energy", scene.potential_energy, "an energy", "J", "pq"),
    ]
    for coordinate, force in zip(scene.coordinates, scene.forces, strict=True):
        above, _, below = coordinate.unit.partition("/")
        unit = {"m": "N", "rad": "N m"}.get(coordinate.unit, f"J {below.replace('/', ' ')}/{above}")
        found.append(
            NamedExpression(
                f"forces[{coordinate.name}]",
                force,
                f"the force of a coordinate in {coordinate.unit}",
                unit,
                "pqvu",
            )
        )
    for contact in scene.contacts:
        where, unit = f"contact {contact.name}", contact.damping_law.unit
        found.append(
            NamedExpression(
                f"{where}: penetration", contact.penetration, "a penetration", "m", "pq"
            )
        )
        found.append(
            NamedExpression(f"{where}: stiffness", contact.stiffness, "a stiffness", "N/m", "p")
        )
        found.append(NamedExpression(f"{where}: damping", contact.damping, "a damping", unit, "p"))
    for friction in scene.frictions:
        where = f"friction {friction.name}"
        found.append(NamedExpression(f"{where}: slip", friction.slip, "a slip", "m/s", "pqv"))
        found.append(
            NamedExpression(
                f"{where}: coefficient", friction.coefficient, "a coefficient of friction", "1", "p"
            )
        )
        if friction.normal_force is not None:
            found.append(
                NamedExpression(
                    f"{where}: normal_force", friction.normal_force, "a normal force", "N", "pq"
                )
            )
    found.append(
        NamedExpression("task.running_cost", scene.task.running_cost, "a cost", None, "pqvu")
    )
    found.append(NamedExpression("task.final_cost", scene.task.final_cost, "a cost", None, "pqv"))
    return found


def depth_expressions(scene: Scene) -> list[NamedExpression]:
    """Return the depths at which the contact models end, which enter no equation."""
    return [
        NamedExpression(f"contact {contact.name}: depth", contact.depth, "a depth", "m", "p")
        for contact in scene.contacts
    ]


def _check_symbols(scene: Scene) -> None:
    symbols = {
        "p": {parameter.symbol for parameter in scene.parameters},
        "q": {coordinate.symbol for coordinate in scene.coordinates},
        "v": {coordinate.velocity for coordinate in scene.coordinates},
        "u": {item.symbol for item in scene.inputs},
    }
    asked = [
        (item.field, item.expression, item.of)
        for item in named_expressions(scene) + depth_expressions(scene)
    ]
    for shape in scene.shapes:
        asked += [
            (f"shape {shape.name}: {field}", getattr(shape, field), "pq")
            for field in ("x", "y", "angle")
        ]
        asked += [(f"shape {shape.name}: size", size, "p") for size in shape.size]
    for field, expression, kinds in asked:
        allowed = set().union(*(symbols[kind] for kind in kinds))
        unknown = sorted(symbol.name for symbol in expression.free_symbols - allowed)
        known = sorted(symbol.name for symbol in allowed)
        twin = next((name for name in unknown if name in known), None)
        if twin is not None:
            raise _fail(
                scene,
                f"{field} uses a symbol {twin} with other assumptions than the declared one; use the same SymPy symbol in both places.",
            )
        if unknown:
            raise _fail(
                scene,
                f"{field} uses {', '.join(unknown)}, which is neither a parameter nor a variable allowed there ({', '.join(known)}){_declared(symbols, unknown[0])}",
            )


def _declared(symbols: dict[str, set[sp.Symbol]], name: str) -> str:
    """Advise a declaration of a symbol that no part of the scene has."""
    everywhere = {symbol.name for group in symbols.values() for symbol in group}
    if name in everywhere:
        return "."
    near = nearest(name, everywhere, _ALIKE)
    return (
        f"; did you mean {near}, or is a Parameter missing?"
        if near
        else "; declare it as a Parameter."
    )


# Names for an end of a contact that is no drawn body.
_FIXED = ("ground", "wall", "joint")


def _check_bodies(scene: Scene) -> None:
    drawn = [shape.name for shape in scene.shapes]
    for contact in scene.contacts:
        unknown = [body for body in contact.bodies if body not in drawn and body not in _FIXED]
        if drawn and unknown:
            raise _fail(
                scene,
                f"contact {contact.name}: bodies names {unknown[0]!r}, which is no shape of the scene ({', '.join(drawn)}), nor one of {', '.join(_FIXED)}.",
            )
    for contact, depth in zip(scene.contacts, scene.depths, strict=True):
        if not depth > 0.0:
            raise _fail(
                scene, f"contact {contact.name}: depth is {depth:g} m, but must be positive."
            )


def _check_limits(scene: Scene) -> None:
    """Check that a metric has one limit.

    A goal needs limits of the plan and of its replay, for positions and velocities separately.
    """
    for metric, count in Counter(limit.metric for limit in scene.limits).items():
        if count > 1:
            raise _fail(scene, f"there are {count} limits on {metric}; leave one of them.")
    goal = scene.task.goal
    parts = {"position": goal[: scene.nq], "velocity": goal[scene.nq :]}
    asked = [part for part, values in parts.items() if any(value is not None for value in values)]
    needed = [f"{of}terminal_{part}_error" for part in asked for of in ("", "replay_")]
    missing = [metric for metric in needed if scene.limit(metric) is None]
    if not missing:
        return
    stated = [limit.metric for limit in scene.limits if limit.metric not in needed]
    near = nearest(missing[0], stated, _ALIKE)
    if near is not None:
        raise _fail(scene, f"limit on {near!r}: did you mean {missing[0]!r}?")
    fields = "".join(f"{part}=.., " for part in asked)
    raise _fail(
        scene,
        f"task.goal asks for a {' and a '.join(asked)}, but no limit says how near is near enough: {', '.join(missing)}; add *goal_limits({fields}reason=..).",
    )
