"""Perturbed worlds of a plan, and samples of them.

    causes = perturbations(scene, plan)  # parameters, start, gains of the inputs, noise, delay
    worlds = draw(causes, samples=1000, seed=0)
    worlds.world(0, nominal_world(scene, plan))

Sizes are in docs/robustness.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.errors import TrajectoryError, did_you_mean
from models.results.robustness import Perturbation, PerturbationKind
from models.scene import Parameter, Scene
from models.trajectory import Trajectory, columns_of
from validate.judge.replay.subject import Subject
from validate.judge.replay.tracking import input_scale, nominals
from validate.judge.replay.wiring import World

_PARAMETER = 0.05  # of the value, without a stated uncertainty
_START = 0.01  # of the nominal
_GAIN = 0.02  # of the input
_NOISE = 0.01  # standard deviation, of the input's range
_DELAY = 1.0  # steps


def perturbations(
    subject: Subject,
    plan: Trajectory,
    asked: Sequence[PerturbationKind | str] = tuple(PerturbationKind),
) -> tuple[Perturbation, ...]:
    """Return the perturbations of a plan's worlds, without those of size 0.

    asked: kinds, or names. Raises TrajectoryError for an unknown name.
    """
    main = {
        alias: item.name
        for item in subject.parameters
        if not isinstance(item, Parameter)
        for alias in item.aliases
    }
    names, kinds, result = (
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
            result.append(
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
    columns = columns_of(subject)  # type: ignore[arg-type] - a foreign model has the attributes of a scene
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
    _check_all_found(subject, names, result)
    return tuple(result)


def _check_all_found(subject: Subject, names: Sequence[str], found: Sequence[Perturbation]) -> None:
    """Raise TrajectoryError for a name without a perturbation, or if there is none."""
    kinds = [kind.value for kind in PerturbationKind]
    known = [*kinds, *(item.name for item in subject.parameters)]
    for name in names:
        if name not in kinds and name not in [item.name for item in found]:
            none = "its uncertainty is 0 (by default a share of its value). State how far it may be from its value ([uncertainty] in a map, Parameter(uncertainty=..) in a scene)."
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
    """Return the world of the scene or FMU, unperturbed."""
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
    """Return a moved world; sizes (causes,) [-] are clipped to the largest moves.

    noise: (steps, nu) [-] of standard deviation 1, or None. Raises ValueError if the shapes do not
    fit.
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
    """Sampled worlds: points (samples, causes) in sizes, [-1, 1], noise and delay [0, 1]."""

    causes: tuple[Perturbation, ...]
    points: np.ndarray
    seed: int

    def world(self, number: int, nominal: World) -> World:
        """Return one of the worlds. Raises IndexError."""
        noise = np.random.default_rng([self.seed, number]).standard_normal(nominal.noise.shape)
        return moved(nominal, self.causes, self.points[number], noise)


def draw(causes: Sequence[Perturbation], samples: int, seed: int) -> Draw:
    """Draw even worlds by a scrambled Sobol sequence over all causes; noise has its full size.

    Raises ValueError without causes, or with more than Sobol's sequence supports.
    """
    # Imported here: half a second, which a replay does not need.
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
