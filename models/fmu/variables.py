"""The table of variables of a scene's FMU, from which C, XML and documentation are written.

variable_names(scene).q  # ("q1", "q2", "q3")
variable_table(scene)  # every variable; its position is its value reference
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import sympy as sp

from models.dynamics import derive
from models.errors import SceneError
from models.scene import Input, Parameter, Scene

# Methods of Co-Simulation: name and meaning, numbered from 1 as in `shell/model.h`; the last is the
# default.
INTEGRATORS = (
    ("explicit_euler", "order 1, contacts are not located"),
    (
        "semi_implicit_euler",
        "order 1, the time step of the plans: velocities first, contacts are not located",
    ),
    ("heun", "order 2, steps are divided where a contact opens or closes"),
    ("runge_kutta", "order 4, steps are divided where a contact opens or closes"),
)


class VariableKind(Enum):
    """Kind of a variable; the value is the constant of `shell/model.h`."""

    TIME = "KIND_TIME"
    POSITION = "KIND_POSITION"
    VELOCITY = "KIND_VELOCITY"
    POSITION_RATE = "KIND_POSITION_RATE"
    VELOCITY_RATE = "KIND_VELOCITY_RATE"
    INPUT = "KIND_INPUT"
    PARAMETER = "KIND_PARAMETER"
    FORCE = "KIND_FORCE"
    GAP = "KIND_GAP"
    SLIP = "KIND_SLIP"
    RESERVE = "KIND_RESERVE"
    PRESSING = "KIND_PRESSING"
    KINETIC_ENERGY = "KIND_KINETIC_ENERGY"
    POTENTIAL_ENERGY = "KIND_POTENTIAL_ENERGY"
    CONTACT_ENERGY = "KIND_CONTACT_ENERGY"
    INPUT_POWER = "KIND_INPUT_POWER"
    DISSIPATED_POWER = "KIND_DISSIPATED_POWER"
    INTERNAL_STEP = "KIND_INTERNAL_STEP"
    INTEGRATOR = "KIND_INTEGRATOR"
    TUNABLE = "KIND_TUNABLE"
    OUTPUT = "KIND_OUTPUT"


# Kind -> FMI's (causality, variability, initial).
_ROLES: dict[VariableKind, tuple[str, str, str | None]] = {
    VariableKind.TIME: ("independent", "continuous", None),
    VariableKind.POSITION: ("output", "continuous", "exact"),
    VariableKind.VELOCITY: ("output", "continuous", "exact"),
    VariableKind.POSITION_RATE: ("local", "continuous", "calculated"),
    VariableKind.VELOCITY_RATE: ("local", "continuous", "calculated"),
    VariableKind.INPUT: ("input", "continuous", None),
    VariableKind.PARAMETER: ("parameter", "fixed", "exact"),
    VariableKind.TUNABLE: ("parameter", "tunable", "exact"),
    VariableKind.INTERNAL_STEP: ("parameter", "tunable", "exact"),
    VariableKind.INTEGRATOR: ("parameter", "tunable", "exact"),
}
_OUTPUT = ("output", "continuous", "calculated")


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One variable.

    index: its place among those of its kind (friction forces follow contact forces)
    start: None for a calculated value
    unit: empty for an enumeration
    """

    name: str
    kind: VariableKind
    index: int = 0
    unit: str
    description: str
    start: float | None = None
    nominal: float | None = None
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def causality(self) -> str:
        """Return FMI's causality: input, output, parameter .."""
        return _ROLES.get(self.kind, _OUTPUT)[0]

    @property
    def variability(self) -> str:
        """Return FMI's variability: continuous, fixed, tunable .."""
        return _ROLES.get(self.kind, _OUTPUT)[1]

    @property
    def initial(self) -> str | None:
        """Return FMI's attribute `initial`, or None."""
        return _ROLES.get(self.kind, _OUTPUT)[2]

    @property
    def is_enumeration(self) -> bool:
        """Return whether the variable is an enumeration."""
        return self.kind is VariableKind.INTEGRATOR


# Smallest internal step [s]; with it a communication step of 10 ms has ten million steps.
SMALLEST_INTERNAL_STEP = 1e-9
# Internal steps per step of the task, for a replay error of about 1e-8.
INTERNAL_STEPS = 100


@dataclass(frozen=True, kw_only=True)
class VariableNames:
    """Names of the variables of a scene's FMU, in the order of the scene; None if missing.

    q, v, u, lam, gap, friction, slip, der_q, der_v, parameters have one name per entry; energies
    [J] and powers [W] have one name each.
    """

    q: tuple[str, ...]
    v: tuple[str, ...]
    der_q: tuple[str, ...]
    der_v: tuple[str, ...]
    u: tuple[str, ...]
    lam: tuple[str, ...]
    gap: tuple[str, ...]
    friction: tuple[str, ...]
    slip: tuple[str, ...]
    parameters: tuple[str, ...]
    kinetic_energy: str
    potential_energy: str | None
    contact_energy: str | None
    input_power: str | None
    dissipated_power: str | None
    internal_step: str
    integrator: str


def variable_names(scene: Scene) -> VariableNames:
    """Return the names of the scene's quantities in its FMU."""
    table = variable_table(scene)

    def names(kind: VariableKind) -> tuple[str, ...]:
        return tuple(variable.name for variable in table if variable.kind is kind)

    forces, kinds = names(VariableKind.FORCE), VariableKind
    several = {
        "q": kinds.POSITION, "v": kinds.VELOCITY, "der_q": kinds.POSITION_RATE,
        "der_v": kinds.VELOCITY_RATE, "u": kinds.INPUT, "gap": kinds.GAP,
        "slip": kinds.SLIP, "parameters": kinds.PARAMETER,
    }  # fmt: skip
    single = (
        "kinetic_energy",
        "potential_energy",
        "contact_energy",
        "input_power",
        "dissipated_power",
        "internal_step",
        "integrator",
    )
    fields: dict[str, Any] = {name: names(kind) for name, kind in several.items()}
    fields |= {name: next(iter(names(kinds[name.upper()])), None) for name in single}
    return VariableNames(lam=forces[: scene.nc], friction=forces[scene.nc :], **fields)


def variable_table(scene: Scene) -> tuple[Variable, ...]:
    """Return the variables of the scene's FMU; the position in the table is the value reference.

    Raises SceneError if the scene uses a name that every FMU has.
    """
    table = (
        Variable(name="time", kind=VariableKind.TIME, unit="s", description="time"),
        *_states(scene),
        *_given(VariableKind.INPUT, scene.inputs, [0.0] * scene.nu, "input"),
        *_contacts(scene),
        *_frictions(scene),
        *_energies(scene),
        *parameter_variables(scene.parameters),
        *_settings(scene),
    )
    for name, count in Counter(variable.name for variable in table).items():
        if count > 1:
            raise SceneError(
                f"scene {scene.name}: the name {name!r} is also that of a variable every FMU has; choose another."
            )
    return table


def _states(scene: Scene) -> list[Variable]:
    start, items = scene.task.start, scene.coordinates
    positions = [
        (item.name, item.unit, item.description or f"coordinate {item.name}", item.nominal)
        for item in items
    ]
    velocities = [
        (item.velocity_name, item.velocity_unit, f"velocity of {item.name}", item.nominal)
        for item in items
    ]
    rates = [(f"der({item.name})", item.velocity_unit, f"rate of {item.name}") for item in items]
    accelerations = [
        (f"der({item.velocity_name})", f"{item.unit}/s^2", f"acceleration of {item.name}")
        for item in items
    ]
    states, kinds = list[Variable](), VariableKind
    for kind, rows, values in (
        (kinds.POSITION, positions, start[: scene.nq]),
        (kinds.VELOCITY, velocities, start[scene.nq :]),
    ):
        states += numbered(
            kind,
            [(*row, value) for row, value in zip(rows, values, strict=True)],
            then=["nominal", "start"],
        )
    return [
        *states,
        *numbered(kinds.POSITION_RATE, rates),
        *numbered(kinds.VELOCITY_RATE, accelerations),
    ]


def numbered(
    kind: VariableKind,
    rows: Iterable[tuple],
    first: int = 0,
    *,
    then: Sequence[str] = ("start", "lower", "upper"),
) -> list[Variable]:
    """Number the variables of a kind from `first`; a row is name, unit, description, and `then`."""
    fields = ("name", "unit", "description", *then)
    return [
        Variable(kind=kind, index=index, **dict(zip(fields, row, strict=False)))
        for index, row in enumerate(rows, first)
    ]


def _given(
    kind: VariableKind, items: Sequence[Input | Parameter], starts: Sequence[float], what: str
) -> list[Variable]:
    return numbered(
        kind,
        [
            (
                item.name,
                item.unit,
                item.description or f"{what} {item.name}",
                start,
                item.lower,
                item.upper,
            )
            for item, start in zip(items, starts, strict=True)
        ],
    )


def _contacts(scene: Scene) -> list[Variable]:
    rows = [
        (item, float(item.stiffness.subs(scene.parameter_values)), item.description or item.name)
        for item in scene.contacts
    ]
    forces = (
        (item.force_name, "N", f"contact force, {what}", stiffness * item.nominal)
        for item, stiffness, what in rows
    )
    gaps = (
        (item.gap_name, "m", f"gap, negative in contact, {what}", item.nominal)
        for item, _, what in rows
    )
    return [
        *numbered(VariableKind.FORCE, forces, then=["nominal"]),
        *numbered(VariableKind.GAP, gaps, then=["nominal"]),
    ]


def friction_nominals(scene: Scene) -> list[float]:
    """Return typical friction forces (nf,) [N], at least 1e-6 N.

    mu times the contact's nominal force, or the given normal force at the start. Raises nothing.
    """
    start = dict(
        zip((coordinate.symbol for coordinate in scene.coordinates), scene.task.start, strict=False)
    )
    pressing = {contact.name: contact.stiffness * contact.nominal for contact in scene.contacts}
    forces = [
        item.coefficient
        * sp.Add(
            *(pressing[name] for name in item.pressing),
            0 if item.normal_force is None else item.normal_force,
        )
        for item in scene.frictions
    ]
    return [max(float(force.subs(start).subs(scene.parameter_values)), 1e-6) for force in forces]


def _frictions(scene: Scene) -> list[Variable]:
    """Return the frictions, then whether each damped contact presses, as in the rows of forces."""
    rows = [
        (item, item.description or item.name, nominal)
        for item, nominal in zip(scene.frictions, friction_nominals(scene), strict=True)
    ]
    forces = (
        (item.force_name, "N", f"friction force, {what}", nominal) for item, what, nominal in rows
    )
    slips = ((item.slip_name, "m/s", f"slip speed, {what}", item.nominal) for item, what, _ in rows)
    change = "to the next change between slipping and sticking, {}: slip over {:g} m/s, or mu N - |f| over {:g} N"
    reserves = (
        (f"reserve_{item.name}", "1", change.format(what, item.nominal, nominal), 1.0)
        for item, what, nominal in rows
    )
    share = "what pushes while the contact is closed, as a share: below 0 it is released, {}"
    damped = [scene.contacts[index] for index in scene.damped]
    pressing = (
        (item.pressing_name, "1", share.format(item.description or item.name), 1.0)
        for item in damped
    )
    kinds = VariableKind
    groups = (
        (kinds.FORCE, forces, scene.nc),
        (kinds.SLIP, slips, 0),
        (kinds.RESERVE, reserves, 0),
        (kinds.PRESSING, pressing, scene.nl),
    )
    return [
        variable
        for kind, group, first in groups
        for variable in numbered(kind, group, first, then=["nominal"])
    ]


def _energies(scene: Scene) -> list[Variable]:
    dynamics = derive(scene)
    dissipation = "friction and by " * bool(scene.nf) + "the damping of contacts and by " * bool(
        scene.damped
    )
    rows = (
        ("kinetic_energy", "J", "kinetic energy", True),
        (
            "potential_energy",
            "J",
            "potential energy without contacts",
            dynamics.potential_energy != 0,
        ),
        (
            "contact_energy",
            "J",
            "energy stored in the contacts, sum of k/2 max(phi, 0)^2",
            scene.nc > 0,
        ),
        ("input_power", "W", "power put in by the inputs", dynamics.input_power != 0),
        (
            "dissipated_power",
            "W",
            f"power taken out by {dissipation}forces that remain without inputs",
            dynamics.dissipated_power != 0 or dissipation,
        ),
    )
    return [
        Variable(name=name, kind=VariableKind[name.upper()], unit=unit, description=text)
        for name, unit, text, present in rows
        if present
    ]


def parameter_variables(parameters: Sequence[Parameter]) -> list[Variable]:
    """Return the physical parameters as variables, in order."""
    return _given(
        VariableKind.PARAMETER,
        parameters,
        [parameter.value for parameter in parameters],
        "parameter",
    )


def _settings(scene: Scene) -> list[Variable]:
    largest = min(scene.task.step / INTERNAL_STEPS, math.inf if scene.lag is None else scene.lag)
    words = "largest internal step of Co-Simulation; equal steps divide each communication step; it is for motions like that of the task, faster ones need a smaller one"
    methods = float(len(INTEGRATORS))
    return [
        *numbered(
            VariableKind.INTERNAL_STEP,
            [("internal_step", "s", words, largest, SMALLEST_INTERNAL_STEP)],
        ),
        *numbered(
            VariableKind.INTEGRATOR,
            [("integrator", "", "method of Co-Simulation", methods, 1.0, methods)],
        ),
    ]
