"""The true continuous motion of a scene under inputs that are constant piece by piece, without any C.

It is integrated by scipy's DOP853 on the scene's equations as numpy functions, restarted at every change of an input or a
contact: what the FMU's own numbers are compared with, by users and by our tests.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from models.dynamics import derive
from models.errors import SceneError
from models.scene import Scene

# Relative tolerance; the absolute one is this times the nominal of each state.
_TOLERANCE = 1e-12
# A penetration below this share of the contact's nominal is on the boundary: there the direction of motion decides the mode.
_BOUNDARY = 1e-10
# Contact changes within one piece before the motion is given up.
_MOST_SWITCHES = 10_000


@dataclass(frozen=True)
class Piece:
    """Constant inputs u (nu,) until `end` [s]."""

    end: float
    u: np.ndarray


class Equations:
    """The scene's equations as numpy functions of flat vectors; x is positions, then velocities."""

    def __init__(self, scene: Scene) -> None:
        d = derive(scene)
        self.scene, self.n = scene, scene.nq
        self._mass, self._force = d.function(d.mass_matrix, d.q), d.function(d.generalised_force, d.q, d.v, d.u, d.lam)
        self._phi, self._jacobian = d.function(d.penetration, d.q), d.function(d.gap_jacobian, d.q)
        self.stiffness = d.function(d.stiffness)().ravel()
        self._band = _BOUNDARY * np.array([contact.nominal for contact in scene.contacts])
        self._energies = {
            "kinetic_energy": (d.function([d.kinetic_energy], d.q, d.v), "qv"),
            "potential_energy": (d.function([d.potential_energy], d.q), "q"),
            "input_power": (d.function([d.input_power], d.q, d.v, d.u), "qvu"),
            "dissipated_power": (d.function([d.dissipated_power], d.q, d.v), "qv"),
        }

    def penetration(self, x: np.ndarray) -> np.ndarray:
        return self._phi(x[: self.n]).ravel()

    def modes(self, x: np.ndarray) -> np.ndarray:
        """(nc,) whether each contact is closed; on its boundary: whether it is closing."""
        phi = self.penetration(x)
        rate = -self._jacobian(x[: self.n]) @ x[self.n :] if phi.size else phi
        return (phi > self._band) | ((np.abs(phi) <= self._band) & (rate > 0))

    def rate(self, x: np.ndarray, u: np.ndarray, closed: np.ndarray) -> np.ndarray:
        """dx/dt (2*nq,) with k phi in closed contacts and nothing in open ones."""
        q, v = x[: self.n], x[self.n :]
        force = self._force(q, v, u, np.where(closed, self.stiffness * self.penetration(x), 0.0)).ravel()
        return np.concatenate([v, np.linalg.solve(self._mass(q), force)])

    def outputs(self, x: np.ndarray, u: np.ndarray) -> dict[str, float]:
        """What the FMU gives besides positions and velocities, by the FMU's names."""
        phi = self.penetration(x)
        lam = self.stiffness * np.maximum(phi, 0.0)
        parts = {"q": x[: self.n], "v": x[self.n :], "u": u}
        values = {contact.force_name: lam[index] for index, contact in enumerate(self.scene.contacts)}
        values |= {contact.gap_name: -phi[index] for index, contact in enumerate(self.scene.contacts)}
        values |= {name: function(*(parts[letter] for letter in letters)).item() for name, (function, letters) in self._energies.items()}
        return values | {"contact_energy": float(np.sum(lam * phi) / 2)}


def true_motion(equations: Equations, pieces: Sequence[Piece], times: np.ndarray) -> np.ndarray:
    """(len(times), 2*nq) states at `times`, from the task's start. Raises SceneError if the motion cannot be followed."""
    scene = equations.scene
    x, t = np.array(scene.task.start, dtype=float), 0.0
    nominal = np.tile([coordinate.nominal for coordinate in scene.coordinates], 2)
    result = np.full((len(times), x.size), np.nan)
    result[times <= t] = x
    for piece in pieces:
        for _ in range(_MOST_SWITCHES):
            if t >= piece.end:
                break
            closed = equations.modes(x)
            found = solve_ivp(
                lambda _, y, u=piece.u, closed=closed: equations.rate(y, u, closed),
                (t, piece.end),
                x,
                method="DOP853",
                rtol=_TOLERANCE,
                atol=_TOLERANCE * nominal,
                max_step=scene.task.step,
                dense_output=True,
                events=[_leaving(equations, index, bool(mode)) for index, mode in enumerate(closed)],
            )
            if not found.success or not np.isfinite(found.y[:, -1]).all():
                raise SceneError(f"scene {scene.name}: its motion cannot be followed beyond t = {found.t[-1]:.6g} s ({found.message}).")
            inside = (times > t) & (times <= found.t[-1])
            if inside.any():
                result[inside] = found.sol(times[inside]).T
            x, t = found.y[:, -1], float(found.t[-1])
    return result


def _leaving(equations: Equations, index: int, closed: bool) -> Callable[[float, np.ndarray], float]:
    """An event function: contact `index` leaves its mode."""

    def penetration(_: float, y: np.ndarray) -> float:
        return float(equations.penetration(y)[index])

    penetration.terminal = True  # type: ignore[attr-defined] - how scipy is told
    penetration.direction = -1.0 if closed else 1.0  # type: ignore[attr-defined]
    return penetration
