"""What is replayed: a scene, or somebody's FMU of which only names, units, a goal and limits are known (`ForeignModel`).

A ForeignModel answers what replay and score ask of a scene, in the same words; equations and a
compiled kernel it lacks.

`find_variables` finds the variables of a scene in its FMU; `recorded` takes apart by name what a
simulation recorded, and computes from the scene's equations what the FMU does not give.
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
    """A position that the map names, and its velocity, in the plan's units."""

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
    """An input that the map names, with its bounds in the plan's unit."""

    name: str
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class ForeignContact:
    """A contact that the map names; depth [m]: penetration at which its model ends; nominal_force [N]: a typical one."""

    name: str
    force_name: str
    gap_name: str
    description: str = ""
    depth: float | None = None
    nominal_force: float | None = None


@dataclass(frozen=True, kw_only=True)
class ForeignParameter:
    """A parameter of the FMU that may be otherwise [unit of the FMU].

    uncertainty: None: a share of its value; aliases: its other names.
    """

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
    """What a plan on somebody's FMU is to do.

    goal: (2*nq,) positions, then velocities; None where nothing is asked. step [s]: a task
        of an FMU has none of its own, and counts as one of
    500 steps, so that a plan may be a thousandth of its duration off and a motion is seen as often
        however few rows its plan has.
    horizon: how long a plan of this task lasts [s], None where the map does not say.
    """

    goal: tuple[float | None, ...]
    step: float
    horizon: float | None = None

    @property
    def has_goal(self) -> bool:
        """Whether any position or velocity has a goal."""
        return any(value is not None for value in self.goal)


@dataclass(frozen=True, kw_only=True)
class ForeignModel(Counted):
    """A model of which only the FMU is known: what replay and score ask of a scene, in the same words.

    lacks: what cannot be shown, as {"v": "no velocities are named", ...}; keys are q, v, lam, gap.
        accuracy: how wrong the author says its
    Co-Simulation may be, infinite in what is not stated; None: nothing is stated. not_asked: a
        sentence for each question of the verdict that cannot
    be asked, with what would make it askable; each begins with the metrics it is about. notes: what
        else is to be reported.
    parameters: those that may be otherwise; begin (2*nq,): where a simulation starts, in the plan's
        units, 0 where nobody says; startable: the places
    in that which can be set.
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
        """(nc,) penetration of each contact at which the model ends [m].

        None where the map does not say.
        """
        return tuple(contact.depth for contact in self.contacts)


@dataclass(frozen=True, kw_only=True)
class Foreign:
    """Somebody's FMU, wired (validate.judge.replay.mapping): what it is called, its references, and how its numbers become the plan's.

    scale, offset (outputs,): plan's value = scale * FMU's + offset, in the order of
    Variables.outputs; input_scale, input_offset (nu,): FMU's value = scale * plan's + offset;
    start: values in the FMU's units, in the order of Variables.start; hold as the plan's;
    parameters: references of the model's.
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
        """Scale and offset of positions and velocities, and of the inputs."""
        nx = len(self.variables.q) + len(self.variables.v)
        return (self.scale[:nx], self.offset[:nx]), (self.input_scale, self.input_offset)


Subject = Scene | ForeignModel


def recorded(
    subject: Subject, variables: Variables, run: Run, rows: list[int] | None = None
) -> Recorded:
    """The numbers of a run by name, at all its points or at some rows.

    Zero what neither the FMU nor a scene gives.
    """
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
    zeros = np.zeros((count, nc))  # of a foreign model, for what its `lacks` names
    if not variables.v and nq:
        v = np.zeros((count, nq))
    if not variables.lam and nc:
        lam = zeros if scene is None else load_kernel(scene).contact_force(q, v=v)
    if not variables.gap and nc:
        gap = zeros if scene is None else -load_kernel(scene).penetration(q)
    if not variables.friction:
        friction = np.zeros((count, subject.nf))
    given = dict(zip(variables.energies, energies.T.copy(), strict=True))
    sums = (
        np.array(run.accumulated).reshape(len(run.t), len(variables.rates))[chosen]
        if run.accumulated
        else None
    )

    def energy(name: str) -> np.ndarray:
        """One of the energies, (n,) [J]. Raises nothing."""
        if name in given:
            return given[name]
        if name in variables.zero or scene is None:
            return np.zeros(count)
        if name == "contact_energy":
            return (np.maximum(-gap, 0.0) ** 2 @ load_kernel(scene).stiffness()) / 2
        kinetic, potential = load_kernel(scene).energy(q, v)
        return np.array(kinetic if name == "kinetic_energy" else potential)

    def work(power: str) -> np.ndarray | None:
        """Work since the start of one of the powers, (n,) [J]; None where it was not integrated.

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
    """The variables of the FMU that have the names of the scene's.

    Positions, velocities and inputs must be there; the rest may be missing. Raises FmuError naming
    the variable.
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

    found: dict[str, Any] = {}
    for which, group in groups.items():
        references = [reference(name) for name in group]
        missing = [name for name, item in zip(group, references, strict=True) if item is None]
        if missing and which in ("q", "v", "u"):
            raise FmuError(
                f"FMU {package.path}: it has no variable {missing[0]!r} of scene {scene.name}; give its name in the FMU by a map."
            )
        found[which] = () if missing else tuple(item for item in references if item is not None)
    for name, item in zip(groups["u"], found["u"], strict=True):
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
        **found,
        energies=present(ENERGIES),
        powers=present(POWERS),
        zero=frozenset(name for name, is_absent in absent.items() if is_absent),
        parameters=tuple(parameters),
        start=found["q"] + found["v"],
        internal_step=reference(INTERNAL_STEP),
    )
