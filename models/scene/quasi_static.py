"""Scenes without inertia: drag alone resists, D v = F(q, u), the first-order model.

    Scene(..., relaxation_time=tau, kinetic_energy=tau * (d * v_x**2 + ..) / 2, forces=(-d * v_x, ..))

Such a scene has a mass, because all code steps M dv/dt = F - D v. M = tau D gives tau dv/dt = D^-1
F - v. tau is no parameter of the scene; the caller chooses it:

- On a grid tau = h. Semi-implicit Euler, v' = v + h/tau (D^-1 F - v), is then v' = D^-1 F exactly:
  the explicit Euler step of the first-order model. The compiled step sets tau to its own step
  (Kernel.parameters_of), the task's or a fiftieth of it.
- In the judge tau = LAG, as short as an integrator bears, so that the result depends on no grid.
  tau (v' - v0) + q' - q0 is the integral of D^-1 F. So the lag moves the motion by tau times the
  speed, as if the forces were evaluated tau earlier. This error is of first order in tau; each
  replay measures it by a second replay with 2 tau.

`Scene.continuous()` is the scene with the short tau; a scene with inertia is returned unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from models.errors import SceneError
from models.scene.parts import Coordinate, Parameter

# Relaxation time of judged scenes [s]. A finger of push_box at 0.4 m/s lags 8 um behind. The errors
# of its plans grow 1e5 times, so the replay is off by 0.1 mm, and by 0.4 mm with feedback, a
# hundredth of the limit. The time of the reference (CVODE) does not depend on this lag. The time of
# the everyday replay is proportional to its inverse: 1 CPU s here.
LAG = 2e-5


def relaxation_parameter(symbol: sp.Symbol, value: float) -> Parameter:
    """Return the relaxation time tau of a scene as a parameter.

    Parameters
    ----------
    symbol
        The scene's relaxation_time.
    value
        The task's step, or the lag of a judged scene [s].

    Returns
    -------
    Parameter
        tau.
    """
    return Parameter(
        symbol=symbol,
        value=value,
        unit="s",
        lower=1e-9,
        description="relaxation time, mass over drag: the step on a grid, next to nothing in continuous time",
    )


def check_quasi_static(
    scene: str,
    tau: sp.Symbol,
    kinetic_energy: sp.Expr,
    coordinates: Sequence[Coordinate],
    forces: Sequence[sp.Expr],
) -> None:
    """Raise SceneError unless all of the mass is tau times the drag.

    This makes the time step v' = D^-1 F.
    """
    velocities = sp.Matrix([coordinate.velocity for coordinate in coordinates])
    drag = sp.Matrix([sp.diff(kinetic_energy, velocity) for velocity in velocities]) / tau
    moving = {tau, *velocities, *(coordinate.symbol for coordinate in coordinates)}
    changing = [
        entry
        for entry in drag.jacobian(velocities).applyfunc(sp.expand)
        if entry.free_symbols & moving
    ]
    if any(sp.simplify(entry).free_symbols & moving for entry in changing):
        raise SceneError(
            f"scene {scene}: with a relaxation time, kinetic_energy must be {tau}/2 v' D v with a constant drag D, so that all of the mass "
            "vanishes with it."
        )
    for coordinate, force, resists in zip(coordinates, forces, drag, strict=True):
        if sp.expand(force + resists).free_symbols & {tau, *velocities}:
            raise SceneError(
                f"scene {scene}: forces[{coordinate.name}] must resist with the drag of kinetic_energy, {-resists}, and depend on no velocity "
                "besides: a time step is the quasi-static law only then."
            )
