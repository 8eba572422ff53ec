"""What a variable of an FMU can be, and what FMI calls it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

# The methods of Co-Simulation: name and meaning, numbered from 1 as in `shell/model.h`; the last is the default.
INTEGRATORS = (
    ("explicit_euler", "order 1, contacts are not located"),
    ("semi_implicit_euler", "order 1, the time step of the plans: velocities first, contacts are not located"),
    ("heun", "order 2, steps are divided where a contact opens or closes"),
    ("runge_kutta", "order 4, steps are divided where a contact opens or closes"),
)


class Kind(Enum):
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
_ROLES: dict[Kind, tuple[str, str, str | None]] = {
    Kind.TIME: ("independent", "continuous", None),
    Kind.POSITION: ("output", "continuous", "exact"),
    Kind.VELOCITY: ("output", "continuous", "exact"),
    Kind.POSITION_RATE: ("local", "continuous", "calculated"),
    Kind.VELOCITY_RATE: ("local", "continuous", "calculated"),
    Kind.INPUT: ("input", "continuous", None),
    Kind.PARAMETER: ("parameter", "fixed", "exact"),
    Kind.INTERNAL_STEP: ("parameter", "tunable", "exact"),
    Kind.INTEGRATOR: ("parameter", "tunable", "exact"),
}
_OUTPUT = ("output", "continuous", "calculated")


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One variable; `index` is its place among those of its kind (friction forces stand behind contact forces). start is None where the value is calculated.

    unit is empty for an enumeration, which is the only kind that is not a real number.
    """

    name: str
    kind: Kind
    index: int = 0
    unit: str
    description: str
    start: float | None = None
    nominal: float | None = None
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def causality(self) -> str:
        return _ROLES.get(self.kind, _OUTPUT)[0]

    @property
    def variability(self) -> str:
        return _ROLES.get(self.kind, _OUTPUT)[1]

    @property
    def initial(self) -> str | None:
        return _ROLES.get(self.kind, _OUTPUT)[2]

    @property
    def is_enumeration(self) -> bool:
        return self.kind is Kind.INTEGRATOR
