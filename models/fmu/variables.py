"""The variables of a scene's FMU: one table, from which C, XML and the documentation are written.

variable_names(scene).q          ("q1", "q2", "q3")
variable_table(scene)            every variable with unit, start, range; its position is its value
                                 reference

What a variable of an FMU can be, and what FMI calls it.
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

# The methods of Co-Simulation: name and meaning, numbered from 1 as in `shell/model.h`; the last is
# the default.
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
    """What a variable is; the value is the constant of `shell/model.h`."""

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


# Kind -> (causality, variability, initial) in the words of FMI.
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

    `index` is its place among those of its kind (friction forces stand behind contact forces).
    start is None where the value is calculated.

    unit is empty for an enumeration, which is the only kind that is not a real number.
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
        """FMI's causality: input, output, parameter .."""
        return _ROLES.get(self.kind, _OUTPUT)[0]

    @property
    def variability(self) -> str:
        """FMI's variability: continuous, fixed, tunable .."""
        return _ROLES.get(self.kind, _OUTPUT)[1]

    @property
    def initial(self) -> str | None:
        """FMI's attribute `initial`; None where it has none."""
        return _ROLES.get(self.kind, _OUTPUT)[2]

    @property
    def is_enumeration(self) -> bool:
        """Whether it is an enumeration instead of a real number."""
        return self.kind is VariableKind.INTEGRATOR


# The internal step may be shortened to this [s]; below it a communication step of 10 ms takes ten
# million steps.
SMALLEST_INTERNAL_STEP = 1e-9
# Internal steps within one step of the task: the everyday replay then follows the motion to about
# 1e-8 of its size.
INTERNAL_STEPS = 100


@dataclass(frozen=True, kw_only=True)
class VariableNames:
    """Names of the variables of a scene's FMU, in the order of the scene.

    None for what the scene does not have.

    q, v, u, lam, gap, friction, slip, der_q, der_v, parameters: one name an entry; energies [J] and
        powers [W]: one name each.
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
    """The names under which the scene's quantities appear in its FMU."""
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
    found: dict[str, Any] = {name: names(kind) for name, kind in several.items()}
    found |= {name: next(iter(names(kinds[name.upper()])), None) for name in single}
    return VariableNames(lam=forces[: scene.nc], friction=forces[scene.nc :], **found)


def variable_table(scene: Scene) -> tuple[Variable, ...]:
    """Every variable of the scene's FMU; the position in the table is the value reference.

    Raises SceneError if the scene uses a name that the FMU needs for itself.
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
    found, kinds = list[Variable](), VariableKind
    for kind, rows, values in (
        (kinds.POSITION, positions, start[: scene.nq]),
        (kinds.VELOCITY, velocities, start[scene.nq :]),
    ):
        found += numbered(
            kind,
            [(*row, value) for row, value in zip(rows, values, strict=True)],
            then=["nominal", "start"],
        )
    return [
        *found,
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
    """Variables of a kind, numbered from `first`.

    A row is name, unit, description, and what it has of `then`.
    """
    fields = ("name", "unit", "description", *then)
    return [
        Variable(kind=kind, index=index, **dict(zip(fields, row, strict=False)))
        for index, row in enumerate(rows, first)
    ]


def _given(
    kind: VariableKind, items: Sequence[Input | Parameter], starts: Sequence[float], what: str
) -> list[Variable]:
    """What the importer sets, with its range."""
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
    """Typical friction forces (nf,) [N]: mu times the nominal force of the contact, or the given normal force at the start; at least 1e-6 N."""
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
    """And of each damped contact whether it presses: in the rows of forces these stand behind the frictions."""
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
    """Energies and powers the scene has: no contact energy without contacts, no input power without inputs, and so on."""
    dynamics = derive(scene)
    taken = "friction and by " * bool(scene.nf) + "the damping of contacts and by " * bool(
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
            f"power taken out by {taken}forces that remain without inputs",
            dynamics.dissipated_power != 0 or taken,
        ),
    )
    return [
        Variable(name=name, kind=VariableKind[name.upper()], unit=unit, description=text)
        for name, unit, text, present in rows
        if present
    ]


def parameter_variables(parameters: Sequence[Parameter]) -> list[Variable]:
    """The physical parameters as variables, in their order."""
    return _given(
        VariableKind.PARAMETER,
        parameters,
        [parameter.value for parameter in parameters],
        "parameter",
    )


def _settings(scene: Scene) -> list[Variable]:
    """How Co-Simulation integrates."""
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
