"""Scenes without inertia: drag alone resists, D v = F(q, u), the first-order model.

They are written with a mass all the same.

    Scene(..., relaxation_time=tau, kinetic_energy=tau * (d * v_x**2 + ..) / 2, forces=(-d * v_x, ..))

Everything here steps M dv/dt = F - D v. With M = tau D that is tau dv/dt = D^-1 F - v, and tau is
no parameter of the scene but a number of whoever uses it:

on a grid       tau = h. Semi-implicit Euler, v' = v + h/tau (D^-1 F - v), is then v' = D^-1 F
                exactly: the explicit Euler step of the first-order model.
                The compiled step takes it from the step it is told (Kernel.parameters_of), be that the task's or a fiftieth of it.
in the judge    tau = LAG, as short as an integrator bears: what is judged depends on no grid. tau
                (v' - v0) + q' - q0 is the integral of D^-1 F, so
                that the lag moves the motion by tau times the speed, as if its forces were asked
                tau earlier: an error of first order in tau, which each replay measures with 2 tau
                beside it.

`Scene.continuous()` is the scene with the short tau; scenes with inertia are their own.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from models.errors import SceneError
from models.scene.parts import Coordinate, Parameter

# [s] A finger of push_box at 0.4 m/s lags 8 um behind; of its plans, whose errors grow 1e5 times,
# the replay is then off by 0.1 mm, and by 0.4 mm with feedback, a hundredth of their limit. The
# reference (CVODE) does not feel how short it is; the everyday replay's time is as its inverse: 1
# CPU s here.
LAG = 2e-5


def relaxation_parameter(symbol: sp.Symbol, value: float) -> Parameter:
    """The relaxation time tau of a scene, as its models have it.

    Parameters
    ----------
    symbol
        What the scene gives as its relaxation_time.
    value
        The task's step, or the lag of a scene that is judged [s].

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
    """Raise SceneError unless all of the mass is tau times the drag, which makes the time step v' = D^-1 F."""
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
