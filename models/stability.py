"""Is the time step stable while contacts are closed? Said before anything is run.

    step_stability(scene).is_stable, .radius, .largest_step, .sentence
    contact_frequency(scene)  # omega: a contact lasts pi/omega

Semi-implicit Euler on a closed contact is a damped oscillator, x' = x + h v', v' = v - h (w^2 x + c
v), and stable only where

    h^2 w^2 + 2 h c < 4

Here the bound is taken from the exact Jacobian of the compiled step itself (its adjoint), for every
set of contacts that can be closed together, each linearised at its typical penetration. A scene may
be unstable by itself (a pole falls over): then the step is unstable only where it grows faster than
the motion does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from models.codegen.kernel import KernelError, load_kernel
from models.dynamics import derive
from models.scene import Scene

# Up to so many contacts every set is looked at; beyond, single ones and those that can be added up:
# a further closed contact only makes it stiffer.
_EVERY_SET = 6
# A double eigenvalue at 1 (a free body) is computed with an error of the square root of rounding,
# 1.5e-8.
_ROUNDING = 1e-6
# The step's own growth of an unstable motion differs from exp(rate h) by (rate h)^2/24; a fifth
# more is a rate h above 2.
_FASTER = 1.2
# Newton steps to a position in which the contacts of a set are closed, and how near their typical
# depth counts.
_NEWTON_STEPS = 50
_CLOSED = 1e-6


@dataclass(frozen=True, kw_only=True)
class StepStability:
    """Whether a time step is stable while contacts are closed, and the largest that is.

    step [s]; radius: spectral radius of the step's Jacobian, of the set of contacts where it
        exceeds the motion's own growth most;
    contacts: that set, by name; growth: rate at which the motion itself grows there [1/s], 0 if it
        does not; largest_step: below it the step is
    stable with every set [s], infinite if there is no limit.
    """

    scene: str
    step: float
    radius: float
    contacts: tuple[str, ...]
    growth: float
    largest_step: float

    @property
    def is_stable(self) -> bool:
        """Whether the step is below the largest stable one."""
        return self.step < self.largest_step

    @property
    def sentence(self) -> str:
        """For the user; empty where there is nothing to warn of."""
        if self.is_stable:
            return ""
        closed = " and ".join(self.contacts) or "no contact"
        return (
            f"scene {self.scene}: with {closed} closed, a step of {self.step:g} s lies past the stability limit of semi-implicit Euler "
            f"(spectral radius {self.radius:.4g}); plans of this grid blow up in contact: take a step below {self.largest_step:.3g} s, or softer contact."
        )


@dataclass(frozen=True, eq=False)
class _Linear:
    """da = G dq + D dv, of the accelerations with a set of contacts closed.

    Of a scene without inertia dv = G dq, and D is nothing.
    """

    contacts: tuple[str, ...]
    G: np.ndarray
    D: np.ndarray
    has_inertia: bool

    def step_matrix(self, h: float) -> np.ndarray:
        """The matrix of a time step v' = v + h a, q' = q + h v'.

        Parameters
        ----------
        h
            Length of the step [s].

        Returns
        -------
        np.ndarray
            (2*nq, 2*nq).
        """
        identity = np.eye(len(self.G))
        vq, vv = (h * self.G, identity + h * self.D) if self.has_inertia else (self.G, self.D)
        return np.block([[identity + h * vq, h * vv], [vq, vv]])

    def radius(self, h: float) -> float:
        return spectral_radius(self.step_matrix(h))

    @property
    def growth(self) -> float:
        identity = np.eye(len(self.G))
        rates = np.linalg.eigvals(
            np.block([[np.zeros_like(self.G), identity], [self.G, self.D]])
            if self.has_inertia
            else self.G
        ).real
        largest = float(rates.max(initial=0.0))
        # zero but for rounding, which a double zero takes the square root of
        return (
            largest
            if largest > 1e-7 * max(1.0, float(np.sqrt(np.abs(self.G).max(initial=0.0))))
            else 0.0
        )

    def excess(self, h: float) -> float:
        """By what the step's radius exceeds what the motion's own growth explains.

        negative: stable.
        """
        exponent = min(_FASTER * self.growth * h, 700.0)
        return self.radius(h) - math.exp(exponent) - _ROUNDING


def spectral_radius(matrix: np.ndarray) -> float:
    """Largest magnitude of an eigenvalue; 0 of an empty matrix.

    Parameters
    ----------
    matrix
        (n, n), of a map from a state to a state [-].

    Returns
    -------
    float
        The radius [-].

    Raises
    ------
    LinAlgError
        For a matrix that is not finite.
    """
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))


def step_stability(scene: Scene) -> StepStability:
    """At the task's own step.

    Friction is left out: sticking is implicit in the step, slipping a constant force.

    Raises MachineError without a compiler.
    """
    h = scene.task.step
    models = _linear_models(replace(scene, frictions=()) if scene.frictions else scene)
    if not models:
        return StepStability(
            scene=scene.name, step=h, radius=1.0, contacts=(), growth=0.0, largest_step=math.inf
        )
    worst = max(models, key=lambda model: model.excess(h))
    return StepStability(
        scene=scene.name,
        step=h,
        radius=worst.radius(h),
        contacts=worst.contacts,
        growth=worst.growth,
        largest_step=min(_largest_step(model, h) for model in models),
    )


def contact_frequency(scene: Scene) -> float:
    """Return the highest angular frequency with a set of contacts closed [rad/s].

    Damping and friction are left out. Return 0 if no contact can close, or without inertia.
    Raise MachineError without a compiler.
    """
    if scene.relaxation_time is not None:
        return 0.0
    models = _linear_models(replace(scene, frictions=()) if scene.frictions else scene)
    stiffest = (
        float(-np.linalg.eigvals(model.G).real.min(initial=0.0))
        for model in models
        if model.contacts
    )
    return math.sqrt(max(stiffest, default=0.0))


def _linear_models(scene: Scene) -> list[_Linear]:
    kernel, nq = load_kernel(scene), scene.nq
    at_rest = np.zeros(nq)
    u = np.array([min(max(0.0, item.lower), item.upper) for item in scene.inputs])
    start, goal = (
        np.array(scene.task.start[:nq]),
        np.array([math.nan if value is None else value for value in scene.task.goal[:nq]]),
    )
    found = []
    for q in (start, np.where(np.isnan(goal), start, goal)):
        for indices, closed in [((), q), *_closed_positions(scene, q)]:
            # The derivatives of v' = v + a do not depend on the step they are taken with: one
            # second makes them those of a itself.
            try:
                jacobian, _ = kernel.end_derivatives(
                    np.concatenate([closed, at_rest]), u[None], 1.0
                )
            except KernelError:  # singular masses, where only the search for a closed position led, or a step that is no number
                continue
            names = tuple(scene.contacts[index].name for index in indices)
            inertia = scene.relaxation_time is None
            found.append(
                _Linear(
                    names,
                    jacobian[nq:, :nq],
                    jacobian[nq:, nq:] - (np.eye(nq) if inertia else 0.0),
                    inertia,
                )
            )
    return found


def _closed_positions(scene: Scene, q: np.ndarray) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """Sets of contacts that can be closed together, as indices, and positions near q (nq,) in which they are, at their typical depth."""
    d = derive(scene)
    phi, jacobian = d.function(d.penetration, d.q), d.function(d.gap_jacobian, d.q)
    depth = np.array([contact.nominal for contact in scene.contacts])

    def closed(indices: tuple[int, ...]) -> np.ndarray | None:
        """A position (nq,) [m, rad] in which these are, or None."""
        rows, place = list(indices), q.copy()
        for _ in range(_NEWTON_STEPS):
            missing = depth[rows] - phi(place).ravel()[rows]
            if np.abs(missing / depth[rows]).max() < _CLOSED:
                return place
            slope = -np.asarray(jacobian(place)).reshape(scene.nc, scene.nq)[rows]
            place = place + np.linalg.lstsq(slope, missing, rcond=1e-12)[0]
            if not np.isfinite(place).all():
                return None
        return None

    if scene.nc <= _EVERY_SET:
        every = [
            indices
            for size in range(1, scene.nc + 1)
            for indices in combinations(range(scene.nc), size)
        ]
        return [(indices, place) for indices in every if (place := closed(indices)) is not None]
    found, together = [], ()
    for index in range(scene.nc):
        for indices in dict.fromkeys([(index,), (*together, index)]):
            place = closed(indices)
            if place is not None:
                found.append((indices, place))
                together = indices if len(indices) > len(together) else together
    return found


def _largest_step(model: _Linear, h: float) -> float:
    """The step at which the model becomes unstable [s], by doubling from far below and bisection."""
    stiffest = float(np.abs(np.linalg.eigvals(model.G)).max(initial=0.0))
    stiffest = math.sqrt(stiffest) if model.has_inertia else stiffest
    rate = max(stiffest, float(np.abs(np.linalg.eigvals(model.D)).max(initial=0.0)))
    if rate == 0.0:
        return math.inf
    low = 0.05 / rate
    while model.excess(low) <= 0.0:
        if low > 1e3 * max(h, 1.0 / rate):
            return math.inf
        low *= 1.25
    high, low = low, low / 1.25
    for _ in range(60):
        middle = (low + high) / 2.0
        low, high = (low, middle) if model.excess(middle) > 0.0 else (middle, high)
    return high
