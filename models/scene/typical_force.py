"""The yardstick of a scene's contact forces.

    typical_force(scene, load_kernel(scene))      # [N]

Planner and judge measure differences of contact impulses by this force.
"""

from __future__ import annotations

import numpy as np

from models.codegen.kernel import Kernel
from models.dynamics import derive
from models.scene import Scene

# Share of the inputs' range that is a typical force of a scene without static load.
_OF_RANGE = 0.1
# Distance in nominals beyond which a falling body has left its scene.
_LOST = 1e3


def typical_force(scene: Scene, kernel: Kernel) -> float:
    """Return the yardstick of a scene's contact forces [N].

    The yardstick is the largest force with which the scene rests from its start without inputs.
    Without static load it is the force with the effect of a tenth of the inputs' range. Without
    inputs too it is the force of the contacts' nominal penetration.
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
        """Return the size of an input or a contact force in the norm of the inverse mass matrix."""
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
    """Return the largest contact force [N] of the equilibrium below the start, or 0."""
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
        """Return energy [J] and slope (nq,) [J] at scaled positions x (nq,) [-]. Raises nothing."""
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
