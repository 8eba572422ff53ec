"""Damped contacts in a plan's model. Their rates of penetration r are those at the start of the step, as their penetrations are.

    variable_lam[t, name]            the contact force: 0 <= lam  complements  lam - push >= 0, so lam = max(push, 0)
    variable_spring[t, name]         sigma = k max(phi, 0) [N]
    variable_touch[t, name]          w, Kelvin-Voigt only: 1 where phi > 0, 0 where phi < 0, and between where it touches

    Hunt-Crossley    push = sigma (1 + d r)       0 <= sigma  complements  sigma - k phi >= 0
    Kelvin-Voigt     push = sigma + c w r         0 <= sigma  complements  1 - w >= 0,    0 <= w  complements  sigma - k phi >= 0

The force of Kelvin-Voigt jumps where it touches, so no formulation without a switch is exact: k phi + c r may be positive before anything
touches. What the two pairs of the switch say: where sigma > 0, w = 1; where w > 0, sigma = k phi; so phi > 0 gives sigma = k phi and w = 1, and
phi < 0 gives w = 0 and sigma = 0. Softplus (models/codegen/damping.h) needs neither variable.
"""

from __future__ import annotations

from typing import Any

import pyomo.environ as pyo
from pyomo.mpec import Complementarity

from formulations.transcription import equations
from formulations.transcription.expressions import SceneExpressions
from models.contacts import DampingLaw
from models.scene import Scene


def damped_softplus(scene: Scene, contact: int, phi: Any, rate: Any, k: Any, c: Any, b: Any) -> Any:
    """The smoothed force of a damped contact [N]."""
    if scene.contacts[contact].damping_law is DampingLaw.KELVIN_VOIGT:
        return equations.expression_kelvin_voigt_softplus(phi, rate, k, c, b)
    return equations.expression_hunt_crossley_softplus(phi, rate, k, c, b, scene.length)


def add_springs(
    block: Any, scene: Scene, law: SceneExpressions, phi: list[Any], q: list[Any], v: list[Any], parameters: list[Any]
) -> list[dict[int, Any]]:
    """Variables and pairs of the damped contacts; phi: penetrations by step; returns the push of each damped contact, by step."""
    names = [scene.contacts[index].name for index in scene.damped]
    switched = [scene.contacts[index].name for index in scene.damped if scene.contacts[index].damping_law is DampingLaw.KELVIN_VOIGT]
    k, c = law.stiffness(parameters), law.damping(parameters)
    rate = [law.penetration_rate(q_now, v_now, parameters) for q_now, v_now in zip(q[:-1], v[:-1], strict=True)]
    place = {contact.name: index for index, contact in enumerate(scene.contacts)}
    block.set_damped = pyo.Set(initialize=names)
    block.variable_spring = pyo.Var(block.set_steps, block.set_damped, bounds=(0.0, None), initialize=0.0)
    block.expression_spring = pyo.Expression(
        block.set_steps, block.set_damped, rule=lambda _, t, name: k[place[name]] * phi[t][place[name]]
    )
    if switched:
        block.set_switched = pyo.Set(initialize=switched)
        block.variable_touch = pyo.Var(block.set_steps, block.set_switched, bounds=(0.0, None), initialize=0.0)

    def spring(b: Any, t: int, name: str) -> Any:
        i = place[name]
        force = b.variable_spring[t, name]
        if name in switched:
            return equations.complementarity_switch(force, b.variable_touch[t, name])
        return equations.complementarity_contact(force, k[i] * phi[t][i])

    def touch(b: Any, t: int, name: str) -> Any:
        i = place[name]
        return equations.complementarity_touch(b.variable_touch[t, name], b.variable_spring[t, name], k[i] * phi[t][i])

    block.complementarity_spring = Complementarity(block.set_steps, block.set_damped, rule=spring)
    if switched:
        block.complementarity_touch = Complementarity(block.set_steps, block.set_switched, rule=touch)
    pushes: list[dict[int, Any]] = []
    for t in block.set_steps:
        row = {}
        for name in names:
            i, force = place[name], block.variable_spring[t, name]
            if name in switched:
                row[i] = equations.expression_kelvin_voigt(force, block.variable_touch[t, name], c[i], rate[t][i])
            else:
                row[i] = equations.expression_hunt_crossley(force, c[i], rate[t][i])
        pushes.append(row)
    return pushes


def settle_springs(block: Any) -> None:
    """Give the springs and switches of a block the values that their penetrations ask for."""
    if block.component("variable_spring") is None:
        return
    for index, expression in block.expression_spring.items():
        force = pyo.value(expression)
        block.variable_spring[index].set_value(max(force, 0.0), skip_validation=True)
        if block.component("variable_touch") is not None and index in block.variable_touch:
            block.variable_touch[index].set_value(1.0 if force > 0.0 else 0.0, skip_validation=True)
