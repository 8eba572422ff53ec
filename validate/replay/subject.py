"""What is replayed: a scene, or somebody's FMU of which only names, units, a goal and limits are known.

A `ForeignModel` answers what replay and score ask a scene, in the same words; what only a scene has - equations, a compiled kernel - it lacks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from models.scene import Scene
from models.scene_annotations import Limit


@dataclass(frozen=True, kw_only=True)
class ForeignCoordinate:
    name: str
    velocity_name: str
    unit: str = "1"
    velocity_unit: str = "1/s"
    nominal: float = 1.0
    description: str = ""
    velocity_lower: float = -math.inf
    velocity_upper: float = math.inf
    has_velocity_bounds: bool = False


@dataclass(frozen=True, kw_only=True)
class ForeignInput:
    name: str
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class ForeignContact:
    name: str
    force_name: str
    gap_name: str
    nominal: float = 1.0
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class ForeignTask:
    """start, goal: (2*nq,) positions, then velocities; None where nothing is asked. step: the plan's shortest [s]."""

    start: tuple[float, ...]
    goal: tuple[float | None, ...]
    step: float

    @property
    def has_goal(self) -> bool:
        return any(value is not None for value in self.goal)


@dataclass(frozen=True, kw_only=True)
class ForeignModel:
    """lacks: what cannot be shown, as {"v": "no velocities are named", ...}; keys are v, lam, gap."""

    name: str
    coordinates: tuple[ForeignCoordinate, ...]
    inputs: tuple[ForeignInput, ...]
    contacts: tuple[ForeignContact, ...]
    task: ForeignTask
    limits: tuple[Limit, ...] = ()
    lacks: Mapping[str, str] = field(default_factory=dict)
    frictions: tuple[()] = ()
    answers: tuple[()] = ()
    nf: int = 0

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
    def nl(self) -> int:
        return self.nc

    @property
    def force_names(self) -> tuple[str, ...]:
        return tuple(contact.force_name for contact in self.contacts)

    def limit(self, figure: str) -> Limit | None:
        return next((limit for limit in self.limits if limit.figure == figure), None)


Subject = Scene | ForeignModel
