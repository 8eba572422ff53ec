"""What is replayed: a scene, or somebody's FMU of which only names, units, a goal and limits are known.

A `ForeignModel` answers what replay and score ask a scene, in the same words; what only a scene has - equations, a compiled kernel - it lacks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from models.scene import Scene
from models.scene_annotations import Limit

if TYPE_CHECKING:
    from validate.replay.result import Difference  # which knows this module


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
    depth: float | None = None
    depth_reason: str = ""


@dataclass(frozen=True, kw_only=True)
class ForeignTask:
    """start, goal: (2*nq,) positions, then velocities; None where nothing is asked. step [s]: a task of an FMU has none of its own, and counts as one of
    500 steps, so that a plan may be a thousandth of its duration off; the plan's shortest where there is no duration. The plan's own would let a plan
    of two rows last as it likes.

    duration: how long a plan of this task lasts [s], None where the map does not say.
    """

    start: tuple[float | None, ...]
    goal: tuple[float | None, ...]
    step: float
    duration: float | None = None

    @property
    def horizon(self) -> float | None:
        """As a scene's task calls it."""
        return self.duration

    @property
    def has_goal(self) -> bool:
        return any(value is not None for value in self.goal)


@dataclass(frozen=True, kw_only=True)
class ForeignModel:
    """lacks: what cannot be shown, as {"v": "no velocities are named", ...}; keys are v, lam, gap.

    accuracy: how wrong the author says its Co-Simulation may be, infinite in what is not stated; None: nothing is stated. not_asked: a sentence
    for each question of the verdict that cannot be asked, with what would make it askable; each begins with the metrics it is about. notes: what else is to be told.
    """

    name: str
    coordinates: tuple[ForeignCoordinate, ...]
    inputs: tuple[ForeignInput, ...]
    contacts: tuple[ForeignContact, ...]
    task: ForeignTask
    limits: tuple[Limit, ...] = ()
    lacks: Mapping[str, str] = field(default_factory=dict)
    accuracy: Difference | None = None
    not_asked: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    frictions: tuple[()] = ()
    answers: tuple[()] = ()
    damped: tuple[()] = ()
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

    @property
    def depths(self) -> tuple[float | None, ...]:
        """(nc,) penetration of each contact at which the model ends [m]; None where the map does not say."""
        return tuple(contact.depth for contact in self.contacts)

    def limit(self, metric: str) -> Limit | None:
        """What the map says of the limit on a metric, or None: then the metric's default holds."""
        return next((limit for limit in self.limits if limit.metric == metric), None)


Subject = Scene | ForeignModel
