"""Dry friction in a plan's model. Its forces belong to the slip speed at the end of the step, s = S(q[t]) v[t+1]: only so can a step stick.

    variable_friction[t, name]       the friction force f [N]
    regularised (softplus):          f = -mu N tanh(|ln eps| s / (2 nominal)), a logistic function of the slip
    complementarity:                 s = s_forward - s_backward,  0 <= s_forward  complements  mu N + f >= 0,
                                                                  0 <= s_backward complements  mu N - f >= 0

In the plane this is the model of Stewart and Trinkle (maximal dissipation) with one variable less: whoever slips forward is held back
by all of mu N, and whoever is held by less does not slip.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyomo.environ as pyo
from pyomo.mpec import Complementarity

from formulations.transcription import equations
from formulations.transcription.expressions import SceneExpressions
from models.scene import Scene

FORWARD, BACKWARD = "forward", "backward"


def add_friction(
    block: Any, scene: Scene, law: SceneExpressions, sharpness: float | None, plan: tuple[list, list, list], parameters: list[Any]
) -> list[list[Any]]:
    """The friction forces and their law; plan: q, v (nodes) and lam (steps) as rows of variables; returns the variables f[t][friction].

    sharpness: b of the regularised law, or None for complementarity.
    """
    q, v, lam = plan
    names = [friction.name for friction in scene.frictions]
    block.set_frictions = pyo.Set(initialize=names)
    block.set_pressed = pyo.Set(initialize=[(item.name, item.contact) for item in scene.frictions if item.contact is not None], dimen=2)
    block.variable_friction = pyo.Var(block.set_steps, block.set_frictions, initialize=0.0)
    force: list[list[Any]] = [[] for _ in range(scene.task.steps)]
    for (t, _), data in block.variable_friction.items():
        force[t].append(data)
    slip = [law.slip(q_now, v_next, parameters) for q_now, v_next in zip(q[:-1], v[1:], strict=True)]
    limit = [law.friction_limit(q_now, lam_now, parameters) for q_now, lam_now in zip(q[:-1], lam, strict=True)]
    place = {name: index for index, name in enumerate(names)}
    if sharpness is not None:
        nominal = {friction.name: friction.nominal for friction in scene.frictions}
        if not scene.nc:
            block.parameter_sharpness = pyo.Param(initialize=sharpness, mutable=True)

        def regularised(b: Any, t: int, name: str) -> Any:
            i = place[name]
            steepness = b.parameter_sharpness / (2.0 * nominal[name] / scene.length)
            return equations.constraint_friction_regularised(force[t][i], limit[t][i], slip[t][i], steepness)

        block.constraint_friction_regularised = pyo.Constraint(block.set_steps, block.set_frictions, rule=regularised)
        return force

    block.set_ways = pyo.Set(initialize=[FORWARD, BACKWARD])
    block.variable_slip = pyo.Var(block.set_steps, block.set_frictions, block.set_ways, bounds=(0.0, None), initialize=0.0)

    def split(b: Any, t: int, name: str) -> Any:
        forward, backward = b.variable_slip[t, name, FORWARD], b.variable_slip[t, name, BACKWARD]
        return equations.constraint_slip(forward, backward, slip[t][place[name]])

    def complementarity(b: Any, t: int, name: str, way: str) -> Any:
        i = place[name]
        against = force[t][i] if way == FORWARD else -force[t][i]
        return equations.complementarity_friction(b.variable_slip[t, name, way], limit[t][i] + against)

    block.constraint_slip = pyo.Constraint(block.set_steps, block.set_frictions, rule=split)
    block.complementarity_friction = Complementarity(block.set_steps, block.set_frictions, block.set_ways, rule=complementarity)
    return force


def settle_slip(block: Any) -> None:
    """Give the two slip speeds of each friction the values that their own equation asks for (one of them zero)."""
    if block.component("constraint_slip") is None:
        return
    for (t, name), row in block.constraint_slip.items():
        forward, backward = (block.variable_slip[t, name, way] for way in (FORWARD, BACKWARD))
        for data in (forward, backward):
            data.set_value(0.0, skip_validation=True)
        slip = -(pyo.value(row.body) - pyo.value(row.upper))  # forward - backward - s == 0
        forward.set_value(max(slip, 0.0), skip_validation=True)
        backward.set_value(max(-slip, 0.0), skip_validation=True)


def pressed_columns(block: Any) -> list[tuple[int, int]]:
    """For each friction pressed by a contact: the columns, as in `contact_laws.hold_modes`, of that contact and of its way forward (backward
    is the next)."""
    if block.component("set_pressed") is None:
        return []
    contacts, frictions = list(block.component("set_contacts") or ()), list(block.set_frictions)
    return [(contacts.index(contact), len(contacts) + 2 * frictions.index(friction)) for friction, contact in block.set_pressed]


def free_unpressed(block: Any, couples: list[tuple[Any, Any]], closed: np.ndarray) -> None:
    """Bounds of frictions whose contact is open; couples: (slip, reserve) of all pairs and closed as in `contact_laws.hold_modes`.

    One equation for the force, mu N + f = 0 with N = 0, and one variable for the slip, of either sign. That mu N - f >= 0 then follows; kept as a
    bound it would leave an interior-point method no interior, and a way decided for a slip that nothing holds would be a constraint on
    the flight.
    """
    for contact, forward in pressed_columns(block):
        for t in np.flatnonzero(~closed[:, contact]).tolist():
            (slip, reserve), (other_slip, other_reserve) = couples[t * closed.shape[1] + forward : t * closed.shape[1] + forward + 2]
            slip.setlb(None)
            slip.setub(None)
            reserve.setub(0.0)
            other_slip.setub(0.0)
            other_reserve.setlb(None)
            other_reserve.setub(None)
