"""The worlds a plan is tried in: what may be otherwise than the scene, or somebody's FMU, says, by how much, and samples of it.

    causes = perturbations(scene, plan)  # parameters, start, gains of the inputs, noise, delay
    worlds = draw(causes, samples=1000, seed=0)
    worlds.world(0, nominal_world(scene, plan))          # one of them

Sizes are those of docs/robustness.md: a parameter's own uncertainty, else a twentieth of its value;
the start by a hundredth of nominal; each input's gain by a fiftieth; noise of a hundredth of an
input's range, new in every step; a delay of up to a step. A world is told in these sizes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from models.errors import TrajectoryError, did_you_mean
from models.scene import Parameter, Scene
from models.trajectory import Trajectory, columns_of
from validate.judge.replay.subject import Subject
from validate.judge.replay.tracking import input_scale, nominals
from validate.judge.replay.wiring import World

# Sizes of perturbations.
_PARAMETER = 0.05  # of the value, unless the parameter states its uncertainty
_START = 0.01  # of the nominal size
_GAIN = 0.02  # of the input
_NOISE = 0.01  # of the input's range, standard deviation
_DELAY = 1.0  # steps


class PerturbationKind(Enum):
    """What is perturbed."""

    PARAMETERS = "parameters"
    START = "start"
    GAIN = "gain"
    NOISE = "noise"
    DELAY = "delay"


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """One number of a world that may be otherwise.

    index: its place among those of its kind; nominal, size: its value in the scene and how far it
        may be from that [unit]; below, above: how many
    sizes it may be moved down and up at most.
    """

    kind: PerturbationKind
    name: str
    index: int
    nominal: float
    size: float
    unit: str
    reason: str
    below: float = math.inf
    above: float = math.inf


def perturbations(
    subject: Subject,
    plan: Trajectory,
    asked: Sequence[PerturbationKind | str] = tuple(PerturbationKind),
) -> tuple[Perturbation, ...]:
    """What may be otherwise in the worlds of a plan.

    What has no size (a parameter of value 0 without a stated uncertainty) is left out.

    asked: kinds, or names of single ones. Raises TrajectoryError for a name that nothing has.
    """
    main = {
        alias: item.name
        for item in subject.parameters
        if not isinstance(item, Parameter)
        for alias in item.aliases
    }
    names, kinds, found = (
        [
            item.value if isinstance(item, PerturbationKind) else main.get(item, item)
            for item in asked
        ],
        PerturbationKind,
        [],
    )

    def add(
        kind: PerturbationKind,
        index: int,
        name: str,
        nominal: float,
        size: float,
        unit: str,
        reason: str,
        *range_of: float,
    ) -> None:
        if size > 0.0 and (kind.value in names or name in names):
            lower, upper = range_of or (-math.inf, math.inf)
            below, above = (nominal - lower) / size, (upper - nominal) / size
            found.append(
                Perturbation(
                    kind=kind,
                    name=name,
                    index=index,
                    nominal=nominal,
                    size=size,
                    unit=unit,
                    reason=reason,
                    below=below,
                    above=above,
                )
            )

    for index, item in enumerate(subject.parameters):
        if item.uncertainty is None:
            size, reason = _PARAMETER * abs(item.value), f"{_PARAMETER:.0%} of its value"
        else:
            size, reason = item.uncertainty, item.uncertainty_reason
        add(
            kinds.PARAMETERS,
            index,
            item.name,
            item.value,
            size,
            item.unit,
            reason,
            item.lower,
            item.upper,
        )
    columns = columns_of(subject)  # type: ignore[arg-type] - a foreign model answers what a scene answers
    state = columns["q"] + columns["v"]
    start, sizes = (
        nominal_world(subject, plan).start.tolist(),
        (_START * nominals(subject)).tolist(),
    )
    for index in range(len(state)) if isinstance(subject, Scene) else subject.startable:
        add(
            kinds.START,
            index,
            f"start of {state[index][0]}",
            start[index],
            sizes[index],
            state[index][1],
            f"{_START:.0%} of nominal",
        )
    for index, item in enumerate(subject.inputs):
        add(
            kinds.GAIN,
            index,
            f"gain of {item.name}",
            1.0,
            _GAIN,
            "1",
            f"{_GAIN:.0%}",
            0.0,
            math.inf,
        )
    lower, upper = (
        np.array([item.lower for item in subject.inputs]),
        np.array([item.upper for item in subject.inputs]),
    )
    ranges = 2.0 * input_scale(lower, upper, plan.u) if subject.nu else np.zeros(0)
    for index, (item, width) in enumerate(zip(subject.inputs, ranges.tolist(), strict=True)):
        reason = f"{_NOISE:.0%} of its range as standard deviation, new in every step"
        add(
            kinds.NOISE,
            index,
            f"noise of {item.name}",
            0.0,
            _NOISE * width,
            item.unit,
            reason,
            0.0,
            math.inf,
        )
    if subject.nu:
        add(
            kinds.DELAY,
            0,
            "delay",
            0.0,
            _DELAY * plan.duration / plan.steps,
            "s",
            "a step",
            0.0,
            math.inf,
        )
    _check_all_found(subject, names, found)
    return tuple(found)


def _check_all_found(subject: Subject, names: Sequence[str], found: Sequence[Perturbation]) -> None:
    """Raise TrajectoryError where a name is neither a kind nor one of a perturbation, or nothing is found at all."""
    kinds = [kind.value for kind in PerturbationKind]
    known = [*kinds, *(item.name for item in subject.parameters)]
    for name in names:
        if name not in kinds and name not in [item.name for item in found]:
            none = "it is certain, or 0, of which there is no share; state how far it may be from its value ([uncertainty] in a map, Parameter(uncertainty=..) in a scene)."
            near = did_you_mean(
                name,
                known,
                f"what can be perturbed is {', '.join(known[:12])}{' ..' if len(known) > 12 else '.'}",
            )
            raise TrajectoryError(
                f"{subject.name}: {name!r} cannot be perturbed: {none if name in known else near}"
            )
    if not found:
        raise TrajectoryError(
            f"{subject.name}: nothing of it can be perturbed by {', '.join(names)}."
        )


def nominal_world(subject: Subject, plan: Trajectory) -> World:
    """The world as the scene, or somebody's FMU, says it is."""
    return World(
        parameters=np.array([item.value for item in subject.parameters]),
        start=np.array(
            subject.task.start if isinstance(subject, Scene) else subject.begin, dtype=float
        ),
        gain=np.ones(subject.nu),
        noise=np.zeros((plan.steps, subject.nu)),
    )


def moved(
    world: World, causes: Sequence[Perturbation], sizes: np.ndarray, noise: np.ndarray | None = None
) -> World:
    """Another world.

    Parameters
    ----------
    sizes : (causes,) by how many sizes each is moved; kept within what it may be moved by
    noise : (steps, nu) [-] of standard deviation 1; None: without

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    parameters, start, gain = world.parameters.copy(), world.start.copy(), world.gain.copy()
    added, delay = world.noise.copy(), world.delay
    into = {
        PerturbationKind.PARAMETERS: parameters,
        PerturbationKind.START: start,
        PerturbationKind.GAIN: gain,
    }
    for cause, size in zip(causes, np.asarray(sizes, dtype=float), strict=True):
        change = cause.size * float(np.clip(size, -cause.below, cause.above))
        if cause.kind is PerturbationKind.DELAY:
            delay += change
        elif cause.kind is PerturbationKind.NOISE:
            added[:, cause.index] += 0.0 if noise is None else change * noise[:, cause.index]
        else:
            into[cause.kind][cause.index] += change
    return replace(world, parameters=parameters, start=start, gain=gain, noise=added, delay=delay)


@dataclass(frozen=True, kw_only=True, eq=False)
class Draw:
    """Sampled worlds in sizes: points (samples, causes), each in [-1, 1], of noise and delay in [0, 1]; seed: of the noise of each."""

    causes: tuple[Perturbation, ...]
    points: np.ndarray
    seed: int

    def world(self, number: int, nominal: World) -> World:
        """Return one of the worlds. Raises IndexError."""
        noise = np.random.default_rng([self.seed, number]).standard_normal(nominal.noise.shape)
        return moved(nominal, self.causes, self.points[number], noise)


def draw(causes: Sequence[Perturbation], samples: int, seed: int) -> Draw:
    """Worlds spread evenly: a scrambled Sobol sequence over all causes but noise, whose size is always its own.

    Raises
    ------
    ValueError : for no cause, or more than Sobol's sequence has numbers for.
    """
    # Half a second, which a replay need not pay.
    from scipy.stats import qmc

    spread = [item for item in causes if item.kind is not PerturbationKind.NOISE]
    points = np.ones((samples, len(causes)))
    if spread:
        numbers = qmc.Sobol(len(spread), seed=seed).random_base2(
            max(0, math.ceil(math.log2(samples)))
        )[:samples]
        both = np.array([item.below > 0.0 for item in spread])
        points[:, [item.kind is not PerturbationKind.NOISE for item in causes]] = np.where(
            both, 2.0 * numbers - 1.0, numbers
        )
    return Draw(causes=tuple(causes), points=points, seed=seed)
