"""The subject of a replay: a scene, or an external FMU (`ForeignModel`).

A ForeignModel has the attributes of a scene that replay and score need, but no equations.
`find_variables` returns the variables of a scene in its FMU; `recorded` returns a simulation's
outputs by name, computing missing ones from the scene's equations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from models.codegen.kernel import load_kernel
from models.dynamics import derive
from models.scene import Scene
from models.scene.parts import Limit
from models.scene.scene import Counted
from models.trajectory import grouped_names
from validate.fmi.archive import FmuError
from validate.fmi.description import REAL, Package
from validate.judge.replay.result import Recorded, Run
from validate.judge.replay.wiring import ENERGIES, INTERNAL_STEP, POWERS, Variables

if TYPE_CHECKING:
    from validate.judge.replay.result import Difference


@dataclass(frozen=True, kw_only=True)
class ForeignCoordinate:
    """A mapped position and its velocity, in the plan's units."""

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
    """A mapped input, with bounds in the plan's unit."""

    name: str
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class ForeignContact:
    """A mapped contact; depth: largest valid penetration [m]; nominal_force: typical [N]."""

    name: str
    force_name: str
    gap_name: str
    description: str = ""
    depth: float | None = None
    nominal_force: float | None = None


@dataclass(frozen=True, kw_only=True)
class ForeignParameter:
    """An uncertain parameter [unit of the FMU]; uncertainty None: a fraction of its value."""

    name: str
    value: float
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    uncertainty: float | None = None
    uncertainty_reason: str = ""
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ForeignTask:
    """Task of a plan on an external FMU.

    - goal: (2*nq,) positions, then velocities, None if free.
    - step [s]: a five-hundredth of the task, which sets the tolerance of the duration and the
      resolution of the motion.
    - horizon [s]: None if the map has no duration.
    """

    goal: tuple[float | None, ...]
    step: float
    horizon: float | None = None

    @property
    def has_goal(self) -> bool:
        """Return whether any position or velocity has a goal."""
        return any(value is not None for value in self.goal)


@dataclass(frozen=True, kw_only=True)
class ForeignModel(Counted):
    """A model known by its FMU only, with the attributes of a scene.

    - lacks: missing groups of q, v, lam, gap with reasons.
    - accuracy: stated errors of Co-Simulation, infinite if not stated.
    - not_asked: metrics without data, and how to provide it.
    - notes: for the report.
    - begin (2*nq,): start in the plan's units, 0 if unknown.
    - startable: settable places.
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
    parameters: tuple[ForeignParameter, ...] = ()
    begin: tuple[float, ...] = ()
    startable: tuple[int, ...] = ()
    frictions: tuple[()] = ()
    answers: tuple[()] = ()
    damped: tuple[()] = ()

    @property
    def depths(self) -> tuple[float | None, ...]:
        """Return the largest valid penetrations (nc,) [m], None if the map has none."""
        return tuple(contact.depth for contact in self.contacts)


@dataclass(frozen=True, kw_only=True)
class Foreign:
    """An external FMU, wired: model, references, and conversion to the plan's units.

    - scale, offset (outputs,): plan = scale * FMU + offset, ordered as Variables.outputs.
    - input_scale, input_offset (nu,): FMU = scale * plan + offset.
    - start: in the FMU's units, ordered as Variables.start.
    - parameters: references.
    """

    model: ForeignModel
    variables: Variables
    scale: np.ndarray
    offset: np.ndarray
    input_scale: np.ndarray
    input_offset: np.ndarray
    start: np.ndarray
    parameters: tuple[int, ...] = ()

    @property
    def units(self) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Return scale and offset of the state, and of the inputs."""
        nx = len(self.variables.q) + len(self.variables.v)
        return (self.scale[:nx], self.offset[:nx]), (self.input_scale, self.input_offset)


Subject = Scene | ForeignModel


def recorded(
    subject: Subject, variables: Variables, run: Run, rows: list[int] | None = None
) -> Recorded:
    """Return the outputs of a run by name, at all or some rows; unknown ones are zero."""
    scene, chosen = (
        subject if isinstance(subject, Scene) else None,
        slice(None) if rows is None else rows,
    )
    values = np.array(run.outputs).reshape(len(run.t), len(variables.outputs))[chosen]
    count, nq, nc = len(values), subject.nq, subject.nc
    widths = [nq, *map(len, (variables.v, variables.lam, variables.gap, variables.friction))]
    q, v, lam, gap, friction, energies = (
        part.copy() for part in np.split(values, np.cumsum(widths), axis=1)
    )
    zeros = np.zeros((count, nc))  # for groups that a foreign model lacks
    if not variables.v and nq:
        v = np.zeros((count, nq))
    if not variables.lam and nc:
        lam = zeros if scene is None else load_kernel(scene).contact_force(q, v=v)
    if not variables.gap and nc:
        gap = zeros if scene is None else -load_kernel(scene).penetration(q)
    if not variables.friction:
        friction = np.zeros((count, subject.nf))
    measured_energies = dict(zip(variables.energies, energies.T.copy(), strict=True))
    sums = (
        np.array(run.accumulated).reshape(len(run.t), len(variables.rates))[chosen]
        if run.accumulated
        else None
    )

    def energy(name: str) -> np.ndarray:
        """Return an energy (n,) [J]. Raises nothing."""
        if name in measured_energies:
            return measured_energies[name]
        if name in variables.zero or scene is None:
            return np.zeros(count)
        if name == "contact_energy":
            return (np.maximum(-gap, 0.0) ** 2 @ load_kernel(scene).stiffness()) / 2
        kinetic, potential = load_kernel(scene).energy(q, v)
        return np.array(kinetic if name == "kinetic_energy" else potential)

    def work(power: str) -> np.ndarray | None:
        """Return the work of a power since the start (n,) [J], None if not integrated.

        Raises nothing.
        """
        if power in variables.zero:
            return np.zeros(count)
        if sums is None or power not in variables.powers:
            return None
        return sums[:, len(variables.lam) + list(variables.powers).index(power)].copy()

    return Recorded(
        q=q, v=v, lam=lam, gap=gap, friction=friction, **{name: energy(name) for name in ENERGIES},
        input_work=work("input_power"),
        dissipated_work=work("dissipated_power"),
        contact_impulse=None if sums is None or len(variables.lam) != nc else sums[:, :nc].copy(),
    )  # fmt: skip


def find_variables(package: Package, scene: Scene) -> Variables:
    """Return the FMU's variables named as in the scene.

    Raises FmuError if a position, velocity or input is missing, or has a wrong type.
    """
    groups = {**grouped_names(scene), "gap": tuple(item.gap_name for item in scene.contacts)}
    by_name = {variable.name: variable for variable in package.description.modelVariables}

    def reference(name: str) -> int | None:
        variable = by_name.get(name)
        if variable is not None and variable.type not in REAL:
            raise FmuError(
                f"FMU {package.path}: {variable.name} is of type {variable.type}, but must be {' or '.join(REAL)}."
            )
        return None if variable is None else int(variable.valueReference)

    references_by_group: dict[str, Any] = {}
    for which, group in groups.items():
        references = [reference(name) for name in group]
        missing = [name for name, item in zip(group, references, strict=True) if item is None]
        if missing and which in ("q", "v", "u"):
            raise FmuError(
                f"FMU {package.path}: it has no variable {missing[0]!r} of scene {scene.name}; give its name in the FMU by a map."
            )
        references_by_group[which] = (
            () if missing else tuple(item for item in references if item is not None)
        )
    for name, item in zip(groups["u"], references_by_group["u"], strict=True):
        if by_name[name].causality != "input":
            raise FmuError(
                f"FMU {package.path}: {name} (value reference {item}) is no input, but the plan drives it."
            )

    parameters = []
    for parameter in scene.parameters:
        item = reference(parameter.name)
        if item is not None and by_name[parameter.name].causality == "parameter":
            parameters.append((item, parameter.value))
    structure = derive(scene).structure
    absent = {
        "potential_energy": not structure.conservative_forces,
        "contact_energy": not structure.contacts,
        "input_power": not structure.inputs,
        "dissipated_power": not (
            structure.dissipation or structure.friction or structure.contact_damping
        ),
    }

    def present(group: tuple[str, ...]) -> Mapping[str, int]:
        return {name: item for name in group if (item := reference(name)) is not None}

    return Variables(
        **references_by_group,
        energies=present(ENERGIES),
        powers=present(POWERS),
        zero=frozenset(name for name, is_absent in absent.items() if is_absent),
        parameters=tuple(parameters),
        start=references_by_group["q"] + references_by_group["v"],
        internal_step=reference(INTERNAL_STEP),
    )
