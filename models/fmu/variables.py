"""The variables of a scene's FMU: one table, from which C, XML and the documentation are written.

variable_names(scene).q          ("q1", "q2", "q3")
variable_table(scene)            every variable with unit, start, range; its position is its value reference

What a variable of an FMU can be, and what FMI calls it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import sympy as sp

from models.dynamics import derive
from models.errors import SceneError
from models.scene import Parameter, Scene

# The methods of Co-Simulation: name and meaning, numbered from 1 as in `shell/model.h`; the last is the default.
INTEGRATORS = (
    ("explicit_euler", "order 1, contacts are not located"),
    ("semi_implicit_euler", "order 1, the time step of the plans: velocities first, contacts are not located"),
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


# Kind -> (causality, variability, initial) in the words of FMI.
_ROLES: dict[VariableKind, tuple[str, str, str | None]] = {
    VariableKind.TIME: ("independent", "continuous", None),
    VariableKind.POSITION: ("output", "continuous", "exact"),
    VariableKind.VELOCITY: ("output", "continuous", "exact"),
    VariableKind.POSITION_RATE: ("local", "continuous", "calculated"),
    VariableKind.VELOCITY_RATE: ("local", "continuous", "calculated"),
    VariableKind.INPUT: ("input", "continuous", None),
    VariableKind.PARAMETER: ("parameter", "fixed", "exact"),
    VariableKind.INTERNAL_STEP: ("parameter", "tunable", "exact"),
    VariableKind.INTEGRATOR: ("parameter", "tunable", "exact"),
}
_OUTPUT = ("output", "continuous", "calculated")


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One variable; `index` is its place among those of its kind (friction forces stand behind contact forces). start is None where the value is calculated.

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


# The internal step may be shortened to this [s]; below it a communication step of 10 ms takes ten million steps.
SMALLEST_INTERNAL_STEP = 1e-9
# Internal steps within one step of the task: the everyday replay then follows the motion to about 1e-8 of its size.
INTERNAL_STEPS = 100


@dataclass(frozen=True, kw_only=True)
class VariableNames:
    """Names of the variables of a scene's FMU, in the order of the scene; None for what the scene does not have.

    q, v, u, lam, gap, friction, slip, der_q, der_v, parameters: one name an entry; energies [J] and powers [W]: one name each.
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

    def single(kind: VariableKind) -> str | None:
        return next(iter(names(kind)), None)

    return VariableNames(
        q=names(VariableKind.POSITION),
        v=names(VariableKind.VELOCITY),
        der_q=names(VariableKind.POSITION_RATE),
        der_v=names(VariableKind.VELOCITY_RATE),
        u=names(VariableKind.INPUT),
        lam=names(VariableKind.FORCE)[: scene.nc],
        gap=names(VariableKind.GAP),
        friction=names(VariableKind.FORCE)[scene.nc :],
        slip=names(VariableKind.SLIP),
        parameters=names(VariableKind.PARAMETER),
        kinetic_energy=names(VariableKind.KINETIC_ENERGY)[0],
        potential_energy=single(VariableKind.POTENTIAL_ENERGY),
        contact_energy=single(VariableKind.CONTACT_ENERGY),
        input_power=single(VariableKind.INPUT_POWER),
        dissipated_power=single(VariableKind.DISSIPATED_POWER),
        internal_step=names(VariableKind.INTERNAL_STEP)[0],
        integrator=names(VariableKind.INTEGRATOR)[0],
    )


def variable_table(scene: Scene) -> tuple[Variable, ...]:
    """Every variable of the scene's FMU; the position in the table is the value reference.

    Raises SceneError if the scene uses a name that the FMU needs for itself.
    """
    table = (
        Variable(name="time", kind=VariableKind.TIME, unit="s", description="time"),
        *_states(scene),
        *_inputs(scene),
        *_contacts(scene),
        *_frictions(scene),
        *_pressing(scene),
        *_energies(scene),
        *parameter_variables(scene.parameters),
        *_settings(scene),
    )
    for name, count in Counter(variable.name for variable in table).items():
        if count > 1:
            raise SceneError(f"scene {scene.name}: the name {name!r} is also that of a variable every FMU has; choose another.")
    return table


def _states(scene: Scene) -> list[Variable]:
    positions, velocities, position_rates, velocity_rates = [], [], [], []
    for index, coordinate in enumerate(scene.coordinates):
        q, v, unit = coordinate.name, coordinate.velocity_name, coordinate.unit
        what = coordinate.description or f"coordinate {q}"
        start, nominal = scene.task.start, coordinate.nominal
        positions.append(
            Variable(name=q, kind=VariableKind.POSITION, index=index, unit=unit, start=start[index], nominal=nominal, description=what)
        )
        velocities.append(
            Variable(
                name=v,
                kind=VariableKind.VELOCITY,
                index=index,
                unit=coordinate.velocity_unit,
                start=start[scene.nq + index],
                nominal=nominal,
                description=f"velocity of {q}",
            )
        )
        rate = Variable(
            name=f"der({q})", kind=VariableKind.POSITION_RATE, index=index, unit=coordinate.velocity_unit, description=f"rate of {q}"
        )
        position_rates.append(rate)
        rate = Variable(
            name=f"der({v})", kind=VariableKind.VELOCITY_RATE, index=index, unit=f"{unit}/s^2", description=f"acceleration of {q}"
        )
        velocity_rates.append(rate)
    return [*positions, *velocities, *position_rates, *velocity_rates]


def _inputs(scene: Scene) -> list[Variable]:
    return [
        Variable(
            name=item.name,
            kind=VariableKind.INPUT,
            index=index,
            unit=item.unit,
            start=0.0,
            lower=item.lower,
            upper=item.upper,
            description=item.description or f"input {item.name}",
        )
        for index, item in enumerate(scene.inputs)
    ]


def _contacts(scene: Scene) -> list[Variable]:
    stiffness = [float(contact.stiffness.subs(scene.parameter_values)) for contact in scene.contacts]
    forces = [
        Variable(
            name=contact.force_name,
            kind=VariableKind.FORCE,
            index=index,
            unit="N",
            nominal=stiffness[index] * contact.nominal,
            description=f"contact force, {contact.description or contact.name}",
        )
        for index, contact in enumerate(scene.contacts)
    ]
    gaps = [
        Variable(
            name=contact.gap_name,
            kind=VariableKind.GAP,
            index=index,
            unit="m",
            nominal=contact.nominal,
            description=f"gap, negative in contact, {contact.description or contact.name}",
        )
        for index, contact in enumerate(scene.contacts)
    ]
    return [*forces, *gaps]


def friction_nominals(scene: Scene) -> list[float]:
    """Typical friction forces (nf,) [N]: mu times the nominal force of the contact, or the given normal force at the start; at least 1e-6 N."""
    start = dict(zip((coordinate.symbol for coordinate in scene.coordinates), scene.task.start, strict=False))
    pressing = {contact.name: contact.stiffness * contact.nominal for contact in scene.contacts}
    forces = [
        item.coefficient * (pressing[item.contact] if item.contact is not None else sp.sympify(item.normal_force))
        for item in scene.frictions
    ]
    return [max(float(force.subs(start).subs(scene.parameter_values)), 1e-6) for force in forces]


def _frictions(scene: Scene) -> list[Variable]:
    nominals = friction_nominals(scene)
    rows = [(item, item.description or item.name, nominals[index], index) for index, item in enumerate(scene.frictions)]
    forces = [
        Variable(
            name=item.force_name,
            kind=VariableKind.FORCE,
            index=scene.nc + index,
            unit="N",
            nominal=nominal,
            description=f"friction force, {what}",
        )
        for item, what, nominal, index in rows
    ]
    slips = [
        Variable(
            name=item.slip_name, kind=VariableKind.SLIP, index=index, unit="m/s", nominal=item.nominal, description=f"slip speed, {what}"
        )
        for item, what, _, index in rows
    ]
    reserves = [
        Variable(
            name=f"reserve_{item.name}",
            kind=VariableKind.RESERVE,
            index=index,
            unit="1",
            nominal=1.0,
            description=f"to the next change between slipping and sticking, {what}: slip over {item.nominal:g} m/s, or mu N - |f| over {nominal:g} N",
        )
        for item, what, nominal, index in rows
    ]
    return [*forces, *slips, *reserves]


def _pressing(scene: Scene) -> list[Variable]:
    """Of each damped contact; in the rows of forces they stand behind the frictions."""
    return [
        Variable(
            name=scene.contacts[contact].pressing_name,
            kind=VariableKind.PRESSING,
            index=scene.nl + row,
            unit="1",
            nominal=1.0,
            description=f"what pushes while the contact is closed, as a share: below 0 it is released, {scene.contacts[contact].description or scene.contacts[contact].name}",
        )
        for row, contact in enumerate(scene.damped)
    ]


def _energies(scene: Scene) -> list[Variable]:
    """Energies and powers the scene has: no contact energy without contacts, no input power without inputs, and so on."""
    dynamics = derive(scene)
    parts = [f"{what} and by " for what, present in (("friction", scene.nf), ("the damping of contacts", scene.damped)) if present]
    rows = (
        ("kinetic_energy", VariableKind.KINETIC_ENERGY, "J", "kinetic energy", True),
        ("potential_energy", VariableKind.POTENTIAL_ENERGY, "J", "potential energy without contacts", dynamics.potential_energy != 0),
        ("contact_energy", VariableKind.CONTACT_ENERGY, "J", "energy stored in the contacts, sum of k/2 max(phi, 0)^2", scene.nc > 0),
        ("input_power", VariableKind.INPUT_POWER, "W", "power put in by the inputs", dynamics.input_power != 0),
        (
            "dissipated_power",
            VariableKind.DISSIPATED_POWER,
            "W",
            f"power taken out by {''.join(parts)}forces that remain without inputs",
            dynamics.dissipated_power != 0 or bool(parts),
        ),
    )
    return [Variable(name=name, kind=kind, unit=unit, description=text) for name, kind, unit, text, present in rows if present]


def parameter_variables(parameters: Sequence[Parameter]) -> list[Variable]:
    """The physical parameters as variables, in their order."""
    return [
        Variable(
            name=parameter.name,
            kind=VariableKind.PARAMETER,
            index=index,
            unit=parameter.unit,
            start=parameter.value,
            lower=parameter.lower,
            upper=parameter.upper,
            description=parameter.description or f"parameter {parameter.name}",
        )
        for index, parameter in enumerate(parameters)
    ]


def _settings(scene: Scene) -> list[Variable]:
    """How Co-Simulation integrates."""
    step = Variable(
        name="internal_step",
        kind=VariableKind.INTERNAL_STEP,
        unit="s",
        start=min(scene.task.step / INTERNAL_STEPS, math.inf if scene.lag is None else scene.lag),
        lower=SMALLEST_INTERNAL_STEP,
        description="largest internal step of Co-Simulation; equal steps divide each communication step",
    )
    integrator = Variable(
        name="integrator",
        kind=VariableKind.INTEGRATOR,
        unit="",
        start=float(len(INTEGRATORS)),
        lower=1.0,
        upper=float(len(INTEGRATORS)),
        description="method of Co-Simulation",
    )
    return [step, integrator]
