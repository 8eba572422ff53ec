"""Forces of a plan against the contact law, by one convention for the whole plan.

A planned force is the one at the start of its step, at its middle, at its end, or the mean over the
step. Within a step the plan moves along the cubic with its positions and velocities at both ends;
the mean over a step may also be the one of the replay, which sees contacts that are shorter.
"""

from __future__ import annotations

import numpy as np

from models.codegen.kernel import Kernel
from models.dynamics import derive
from models.scene import Scene

# Points of a step at which the law is evaluated: odd, so that the middle is one.
_POINTS = 17
# Share of the inputs' range that is a typical force of a scene without static load.
_OF_RANGE = 0.1
# A body that falls without end has left its scene by so many nominals.
_LOST = 1e3


def within_steps(
    q: np.ndarray, v: np.ndarray, h: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return positions and velocities (steps, nq) at equal parts of each step, ends included.

    Parameters
    ----------
    q, v : (nodes, nq) of the plan [m or rad], [m/s or rad/s].
    h : (steps,) [s].

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    h = h[:, None]
    moved, begins, ends = np.diff(q, axis=0), h * v[:-1], h * v[1:]
    squares, cubes = 3.0 * moved - 2.0 * begins - ends, begins + ends - 2.0 * moved
    parts = np.linspace(0.0, 1.0, _POINTS)
    places = [q[:-1] + s * begins + s**2 * squares + s**3 * cubes for s in parts]
    speeds = [(begins + 2.0 * s * squares + 3.0 * s**2 * cubes) / h for s in parts]
    return places, speeds


def by_convention(points: np.ndarray, replayed: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return the forces (steps, n) [N] of each convention.

    Parameters
    ----------
    points : (points, steps, n) of the law at equal parts of each step [N].
    replayed : (steps, n) means of the replay [N]; None if unknown.

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    mean = (points[:-1] + points[1:]).mean(axis=0) / 2.0
    found = {
        "start": points[0],
        "middle": points[len(points) // 2],
        "end": points[-1],
        "mean": mean,
    }
    return found if replayed is None else {**found, "mean of the replay": replayed}


def force_window(
    lam: np.ndarray, step_of: np.ndarray, steps: int, mean: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Range of a replay's forces from the step before each of the plan's to the one after.

    A planned force may be one of the start of its step, of its end, or a mean, and a contact may
    open or close a step sooner or later than on the plan's grid.

    Parameters
    ----------
    lam : (n, nc) forces of the replay [N].
    step_of : (n-1,) the plan's step of each piece of the replay's grid [-].
    steps : of the plan.
    mean : (steps, nc) over each step, where it is known [N].

    Returns
    -------
    Least and largest, (steps, nc) each [N].

    Raises
    ------
    ValueError : if a step has no row, or the shapes do not fit.
    """
    first = np.searchsorted(step_of, np.arange(steps))
    last = np.searchsorted(step_of, np.arange(steps), side="right")
    rows = [slice(i, j + 1) for i, j in zip(first, last, strict=True)]
    shape = steps, lam.shape[1]
    least = np.array([lam[of].min(axis=0) for of in rows]).reshape(shape)
    largest = np.array([lam[of].max(axis=0) for of in rows]).reshape(shape)
    if mean is not None:
        least, largest = np.minimum(least, mean), np.maximum(largest, mean)
    before, after = [0, *range(steps - 1)], [*range(1, steps), steps - 1]
    return (
        np.minimum(np.minimum(least[before], least), least[after]),
        np.maximum(np.maximum(largest[before], largest), largest[after]),
    )


def least_slip(slips: np.ndarray) -> np.ndarray:
    """The slip of least magnitude of each step; 0 where it turns round.

    Parameters
    ----------
    slips : (n, steps, nf) slips of each step [m/s].

    Returns
    -------
    (steps, nf) [m/s]

    Raises
    ------
    ValueError : for no slips.
    """
    low, high = slips.min(axis=0), slips.max(axis=0)
    return np.where(low * high <= 0.0, 0.0, np.where(np.abs(low) < np.abs(high), low, high))


def typical_force(scene: Scene, kernel: Kernel) -> float:
    """Return the yardstick of a scene's contact forces [N].

    The largest force with which the scene rests from its start without inputs; without static load
    the force with the effect of a tenth of the inputs' range, and without inputs that of the
    contacts' nominal penetration.
    """
    rests = _force_at_rest(scene, kernel)
    if rests > 0.0:
        return rests
    nq = scene.nq
    q, v = (np.array(part, dtype=float)[None] for part in np.split(np.array(scene.task.start), 2))
    u, lam = np.zeros((1, scene.nu)), np.zeros((1, scene.nl))
    d = derive(scene)
    mass = np.asarray(d.function(d.mass_matrix, d.q)(q[0]), dtype=float).reshape(nq, nq)
    still = kernel.acceleration(q, 0.0 * v, u, lam)

    def size(place: int, of_input: bool, value: float) -> float:
        """Size of an input or a contact force in the norm of the inverse mass matrix."""
        pulled, pushed = u.copy(), lam.copy()
        (pulled if of_input else pushed)[0, place] = value
        change = (kernel.acceleration(q, 0.0 * v, pulled, pushed) - still)[0]
        return float(np.sqrt(change @ mass @ change))

    widths = [item.upper - item.lower for item in scene.inputs]
    effects = [size(i, True, w) for i, w in enumerate(widths) if np.isfinite(w)]
    units = [size(i, False, 1.0) for i in range(scene.nc)]
    effect, unit = max(effects, default=0.0), max(units, default=0.0)
    if effect > 0.0 and unit > 0.0:
        return _OF_RANGE * effect / unit
    return float((kernel.stiffness() * [item.nominal for item in scene.contacts]).max(initial=0.0))


def _force_at_rest(scene: Scene, kernel: Kernel) -> float:
    """Return the largest contact force of the equilibrium below the start [N]; 0 if there is none."""
    if scene.potential_energy == 0 or not scene.nc:
        return 0.0
    from scipy.optimize import minimize  # 0.3 CPU s to import

    d, k = derive(scene), kernel.stiffness()
    start = np.array(scene.task.start[: scene.nq], dtype=float)
    scale = np.array([item.nominal for item in scene.coordinates])
    slope = d.function(_slope(scene), d.q)
    bend = d.function(d.gap_jacobian, d.q)
    none = np.zeros((1, scene.nq))

    def energy(x: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy [J] at scaled positions x (nq,) [-], and its slope (nq,) [J]. Raises nothing."""
        q = scale * x
        depth = np.maximum(kernel.penetration(q[None])[0], 0.0)
        value = float(kernel.energy(q[None], none)[1][0] + (k * depth**2).sum() / 2.0)
        return value, scale * (slope(q).ravel() - (k * depth) @ bend(q).reshape(scene.nc, -1))

    with np.errstate(all="ignore"):
        found = minimize(energy, start / scale, jac=True, method="L-BFGS-B")
    if not np.isfinite(found.x).all() or np.abs(found.x - start / scale).max() > _LOST:
        return 0.0
    return float((k * np.maximum(kernel.penetration((scale * found.x)[None])[0], 0.0)).max())


def _slope(scene: Scene) -> list[object]:
    return [scene.potential_energy.diff(item.symbol) for item in scene.coordinates]
