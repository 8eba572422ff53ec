"""Check before a run whether the time step is stable while contacts are closed.

    step_stability(scene).is_stable, .radius, .largest_step, .sentence
    contact_frequency(scene)  # omega: a contact lasts pi/omega

The check uses the exact Jacobian of the compiled step, for every set of contacts that can be closed
together, at typical penetrations; for a damped oscillator it is h^2 w^2 + 2 h c < 4. If the motion
itself is unstable (a falling pole), the step is unstable only if it grows faster.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from models.codegen.kernel import KernelError, load_kernel
from models.dynamics import derive
from models.results.run import StepStability
from models.scene import Scene

# Up to this number of contacts all sets are checked; beyond, single ones and growing unions: a
# further closed contact only adds stiffness.
_EVERY_SET = 6
# Error of a double eigenvalue at 1 (a free body): about the square root of rounding, 1.5e-8.
_ROUNDING = 1e-6
# Growth relative to exp(rate h); they differ by (rate h)^2/24, so 1.2 is a rate h above 2.
_FASTER = 1.2
# Newton steps to a position with closed contacts.
_NEWTON_STEPS = 50
# Relative error of their typical depth.
_CLOSED = 1e-6


@dataclass(frozen=True, eq=False)
class _Linear:
    """da = G dq + D dv with a set of contacts closed; without inertia dv = G dq."""

    contacts: tuple[str, ...]
    G: np.ndarray
    D: np.ndarray
    has_inertia: bool

    def step_matrix(self, h: float) -> np.ndarray:
        """Return the matrix (2*nq, 2*nq) [SI] of a time step of length h [s].

        The step is v' = v + h a, q' = q + h v'. Raises nothing.
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
        # Zero up to rounding, whose square root a double zero has.
        return (
            largest
            if largest > 1e-7 * max(1.0, float(np.sqrt(np.abs(self.G).max(initial=0.0))))
            else 0.0
        )

    def excess(self, h: float) -> float:
        """Return the excess of the step's radius over the motion's growth; negative: stable."""
        exponent = min(_FASTER * self.growth * h, 700.0)
        return self.radius(h) - math.exp(exponent) - _ROUNDING


def spectral_radius(matrix: np.ndarray) -> float:
    """Return the largest |eigenvalue| [-] of a matrix (n, n), 0 if empty.

    Raises LinAlgError for a matrix that is not finite.
    """
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))


def step_stability(scene: Scene) -> StepStability:
    """Check the task's own step. Raises MachineError without a compiler.

    Friction is ignored: sticking is implicit in the step, slipping a constant force.
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
    models = []
    for q in (start, np.where(np.isnan(goal), start, goal)):
        for indices, closed in [((), q), *_closed_positions(scene, q)]:
            # The derivatives of v' = v + h a at h = 1 are those of a.
            try:
                jacobian, _ = kernel.end_derivatives(
                    np.concatenate([closed, at_rest]), u[None], 1.0
                )
            except (
                KernelError
            ):  # singular masses in the search for a closed position, or a step that is not finite
                continue
            names = tuple(scene.contacts[index].name for index in indices)
            inertia = scene.relaxation_time is None
            models.append(
                _Linear(
                    names,
                    jacobian[nq:, :nq],
                    jacobian[nq:, nq:] - (np.eye(nq) if inertia else 0.0),
                    inertia,
                )
            )
    return models


def _closed_positions(scene: Scene, q: np.ndarray) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """Return sets of contacts that can be closed together, with positions (nq,) near q."""
    d = derive(scene)
    phi, jacobian = d.function(d.penetration, d.q), d.function(d.gap_jacobian, d.q)
    depth = np.array([contact.nominal for contact in scene.contacts])

    def closed(indices: tuple[int, ...]) -> np.ndarray | None:
        """Return a position (nq,) [m, rad] with these contacts closed, or None. Raises nothing."""
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
    sets, together = [], ()
    for index in range(scene.nc):
        for indices in dict.fromkeys([(index,), (*together, index)]):
            place = closed(indices)
            if place is not None:
                sets.append((indices, place))
                together = indices if len(indices) > len(together) else together
    return sets


def _largest_step(model: _Linear, h: float) -> float:
    """Return the limit of stable steps [s], by doubling and bisection."""
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
