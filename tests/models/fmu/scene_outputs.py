"""Outputs of an FMU by the scene's equations in numpy."""

from functools import cache

import numpy as np

from models.dynamics import derive
from models.fmu.variables import friction_nominals
from models.scene import Scene
from validate.truth.exact_motion import Equations


@cache
def _energies(scene: Scene):
    """Name -> (function, its arguments as letters of q, v, u)."""
    d = derive(scene)
    return {
        "kinetic_energy": (d.function([d.kinetic_energy], d.q, d.v), "qv"),
        "potential_energy": (d.function([d.potential_energy], d.q), "q"),
        "input_power": (d.function([d.input_power], d.q, d.v, d.u), "qvu"),
        "dissipated_power": (d.function([d.dissipated_power], d.q, d.v), "qv"),
    }


def scene_outputs(equations: Equations, x: np.ndarray, u: np.ndarray) -> dict[str, float]:
    """Return all outputs but positions and velocities, by the names of the FMU.

    x: state (2*nq,) [m, rad, m/s, rad/s]; u: inputs (nu,) [N, N m]. Values: forces [N], gaps [m],
    slips [m/s], energies [J], powers [W], shares [-].
    """
    scene, n = equations.scene, equations.n
    now, modes = equations.at(x), equations.modes(x, u)
    phi, slip = now["phi"], now["slip"]
    spring = equations.stiffness * np.maximum(phi, 0.0)
    lam = np.maximum(equations.contact_force(x, phi > 0), 0.0)
    friction = equations.motion(x, u, modes)[1]
    values = {}
    for index, contact in enumerate(scene.contacts):
        values[contact.force_name] = lam[index]
        values[contact.gap_name] = -phi[index]
    for row, index in enumerate(scene.damped):
        values[scene.contacts[index].pressing_name] = (
            float(now["share"][row]) if phi[index] > 0 else 1.0
        )
    parts = {"q": x[:n], "v": x[n:], "u": u}
    for name, (function, letters) in _energies(scene).items():
        values[name] = function(*(parts[letter] for letter in letters)).item()
    nominals = friction_nominals(scene)
    for index, item in enumerate(scene.frictions):
        size = item.nominal if modes.slips[index] else nominals[index]
        values[item.force_name] = friction[index]
        values[item.slip_name] = slip[index]
        values[f"reserve_{item.name}"] = equations.reserve(x, u, modes, index) / size
    rate = -now["jacobian"] @ x[n:]
    values["dissipated_power"] -= float(friction @ slip)
    values["dissipated_power"] += sum(
        float((lam - spring)[index] * rate[index]) for index in scene.damped
    )
    values["contact_energy"] = float(np.sum(spring * phi) / 2)
    return values
