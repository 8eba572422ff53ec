"""How deep and how far apart a contact can be at each step: the big-M of the mixed-integer program, valid by construction.

    bounds = pair_bounds(scene, linear, ceiling=13.63)       # of all plans that cost at most the ceiling

Three sources, each valid for every exact plan that costs at most the ceiling (infinite: for every exact plan):
1. physics (`energy`), where the scene is of its form: a largest penetration, and how fast a gap can change;
2. reach, step by step: phi[t] depends on the forces before t alone, whose bounds are known by then;
3. again, with all bounds at once, as long as that decides more.
2 and 3 minimise and maximise phi[t] over the convex relaxation: two second-order cone programs a pair.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from formulations.proof.energy import energy_bound
from formulations.proof.relaxation import Relaxation
from formulations.windows.linear_scene import LinearScene
from models.scene import Scene

_ROUNDS = 3  # of source 3 at most; three carts: the second round moves bounds by less than a hundredth of their width
_WORTH = 0.9  # a round is followed by another if it leaves less than this part of the summed widths


@dataclass(frozen=True, kw_only=True, eq=False)
class PairBounds:
    """lower, upper (steps, nc): of phi [m], for all exact plans that cost at most `ceiling`; row 0 is the start. is_empty: there are none."""

    lower: np.ndarray
    upper: np.ndarray
    ceiling: float
    is_empty: bool = False

    @property
    def decided(self) -> np.ndarray:
        """(steps, nc) pairs that can only be open, or only be closed."""
        return (self.upper <= 0.0) | (self.lower >= 0.0)

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.lower).all() and np.isfinite(self.upper).all())


def physical_bounds(scene: Scene, linear: LinearScene, ceiling: float) -> PairBounds:
    """Source 1 alone; infinite where the scene is not of the form of `energy`."""
    T, nc = linear.steps, linear.contacts
    lower, upper = np.full((T, nc), -np.inf), np.full((T, nc), np.inf)
    start = linear.penetration(linear.start[None])[0, :nc]
    found = energy_bound(scene, ceiling) if np.isfinite(ceiling) else None
    if found is not None:
        time = linear.step * np.arange(T)[:, None]
        lower, upper = start - found.approach * time, np.minimum(found.penetration, start + found.approach * time)
        if linear.aimed[: scene.nq].all():
            end = linear.penetration(linear.goal[None])[0, :nc]
            left = linear.step * (T - np.arange(T))[:, None]
            lower, upper = np.maximum(lower, end - found.approach * left), np.minimum(upper, end + found.approach * left)
    lower[0] = upper[0] = start
    return PairBounds(lower=lower, upper=upper, ceiling=ceiling)


def pair_bounds(
    scene: Scene, linear: LinearScene, ceiling: float = np.inf, *, is_over: Callable[[], bool] = lambda: False, rounds: int = _ROUNDS
) -> PairBounds:
    """See the module docstring. is_over: whether to stop; bounds not reached by then are those of physics, or infinite."""
    relaxation = Relaxation(linear)
    bounds = physical_bounds(scene, linear, ceiling)
    width = np.inf
    for _ in range(1 + rounds):
        bounds = _swept(relaxation, bounds, is_over)
        if bounds.is_empty or is_over() or not bounds.is_finite:
            break
        before, width = width, float((bounds.upper - bounds.lower)[~bounds.decided].sum())
        if width > _WORTH * before or width == 0.0:
            break
    return bounds


def _swept(relaxation: Relaxation, bounds: PairBounds, is_over: Callable[[], bool]) -> PairBounds:
    """Every pair once, in the order of time, each with the bounds found before it."""
    lower, upper = bounds.lower.copy(), bounds.upper.copy()
    for t in range(1, len(lower)):
        for contact in range(lower.shape[1]):
            for sign, side in ((1.0, lower), (-1.0, upper)):
                if is_over():
                    return PairBounds(lower=lower, upper=upper, ceiling=bounds.ceiling)
                found = relaxation.least_penetration(t, contact, sign, lower, upper, bounds.ceiling)
                if found.status == "unfinished" and np.isinf(side[t, contact]):  # the ceiling makes the program harder; any bound will do
                    found = relaxation.least_penetration(t, contact, sign, lower, upper, np.inf)
                if found.status == "infeasible":
                    return PairBounds(lower=lower, upper=upper, ceiling=bounds.ceiling, is_empty=True)
                if found.status == "solved":
                    side[t, contact] = sign * max(sign * side[t, contact], found.bound)
    return PairBounds(lower=lower, upper=upper, ceiling=bounds.ceiling)
