"""Contact, damping and friction in a plan's model: variables, laws, relaxation, fixed modes.

equations = SceneExpressions(derive(scene))
equations.penetration(q, p)  # [Pyomo expression per contact]
set_relaxation(model, 1e-4)  # without building the model again
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

import numpy as np
import pyomo.environ as pyo
import sympy as sp
from pyomo.mpec import Complementarity

from formulations.transcription import equations
from formulations.transcription.method import SMOOTH, check_smooth
from models.contact_law import sharpness
from models.dynamics import Dynamics
from models.errors import TouchstoneError
from models.scene import Scene
from models.scene.contacts import DampingLaw

_NAMESPACE = {**{name: getattr(pyo, name) for name in SMOOTH}, "pi": math.pi, "E": math.e}

Entries = Callable[..., Sequence[Any]]


class SceneExpressions:
    """The functions of a scene on Pyomo variables and Params.

    Arguments are sequences in the scene's order: q, v (nq), u (nu), lam (nc), p (np). Zero entries
    are the number 0. Raises SceneError for a function that Pyomo does not have (atan2).
    """

    def __init__(self, dynamics: Dynamics) -> None:
        d = dynamics
        self.nq = len(d.q)
        # nq*nq entries, by rows.
        self.mass = _function(d, "the mass matrix", list(d.mass_matrix), d.q, d.p)
        self.force = _function(
            d,
            "the generalised force",
            list(d.generalised_force),
            d.q,
            d.v,
            d.u,
            (*d.lam, *d.f),
            d.p,
        )
        self.penetration = _function(d, "a penetration", list(d.penetration), d.q, d.p)
        self.stiffness = _function(d, "a stiffness", list(d.stiffness), d.p)
        self.damping = _function(d, "a damping", list(d.damping), d.p)
        self.penetration_rate = _function(
            d, "a rate of penetration", list(-d.gap_jacobian * sp.Matrix(d.v)), d.q, d.v, d.p
        )
        self.slip = _function(d, "a slip", list(d.slip), d.q, d.v, d.p)
        self.friction_limit = _function(
            d, "a friction coefficient or normal force", list(d.friction_limit), d.q, d.lam, d.p
        )
        self.running_cost = _function(d, "the running cost", [d.running_cost], d.q, d.v, d.u, d.p)
        self.final_cost = _function(
            d, "the final cost", [] if d.final_cost == 0 else [d.final_cost], d.q, d.v, d.p
        )  # 0 or 1 entry


def _function(
    dynamics: Dynamics, what: str, expressions: list[sp.Expr], *groups: Sequence[sp.Symbol]
) -> Entries:
    check_smooth(dynamics.scene, what, expressions)
    return sp.lambdify(
        [list(group) for group in groups], expressions, modules=[_NAMESPACE], cse=True
    )


def rows_by_time(variable: Any, count: int) -> list[list[Any]]:
    """Return the variables of each time, in the scene's order."""
    rows: list[list[Any]] = [[] for _ in range(count)]
    for (t, _), data in variable.items():
        rows[t].append(data)
    return rows


class ContactFormulation(Enum):
    """SOFTPLUS: smooth force at a distance, eps in (0, 1).

    COMPLEMENTARITY: lam (lam - k phi) <= eps [N^2]; eps = 0 is the true law.
    """

    SOFTPLUS = "softplus"
    COMPLEMENTARITY = "complementarity"


class ModelError(TouchstoneError):
    """A model does not have the requested part."""


def relax(block: Any, eps: float) -> None:
    """Relax the complementarity of a block in place: lam * v <= mpec_bound, v = lam - k phi.

    This is Pyomo's `mpec.simple_nonlinear`. Relax a clone to keep the untransformed model.

    Raises
    ------
    ModelError
        if there is nothing to relax, or the block is relaxed already: a second transformation
        would silently disconnect the first bound
    """
    if not _families(block):
        raise ModelError(
            f"model {block.name} has no complementarity to relax; build it with contact=ContactFormulation.COMPLEMENTARITY and eps=None."
        )
    if hasattr(block, "mpec_bound"):
        raise ModelError(
            f"model {block.name} is relaxed already; move its bound with set_relaxation(model, eps)."
        )
    bound = _checked_bound(block, eps)
    pyo.TransformationFactory("mpec.simple_nonlinear").apply_to(block, mpec_bound=bound)
    for _, pair in pairs(block):
        # The variable's bound already states this; a row would add a slack.
        pair.c.deactivate()
    settle_separation(block)  # the transformation leaves v without a value


def settle_separation(block: Any) -> None:
    """Set separation forces (reserves of friction), slips and springs from their equations."""
    _settle_slip(block)
    _settle_springs(block)
    if not hasattr(block, "mpec_bound"):  # never relaxed
        return
    for _, pair in pairs(block):
        pair.v.set_value(0.0, skip_validation=True)
        # ve: v - (lam - k phi) == 0.
        pair.v.set_value(max(0.0, -pyo.value(pair.ve.body)), skip_validation=True)


def set_relaxation(block: Any, eps: float) -> None:
    """Set b = |ln eps| / L of softplus, or the bound eps >= 0 [N^2] of complementarity.

    Raises
    ------
    ModelError
        if the block has no relaxation
    """
    if hasattr(block, "parameter_sharpness"):
        block.parameter_sharpness.value = sharpness(eps, pyo.value(block.parameter_length))
    elif hasattr(block, "mpec_bound"):
        block.mpec_bound.value = _checked_bound(block, eps)
    else:
        raise ModelError(
            f"model {block.name} has no relaxation to tighten; build it with an eps, or relax(model, eps) first."
        )


def pairs(block: Any) -> list[tuple[Any, Any]]:
    """Return (variable, pair) of every complementarity: contacts, frictions, springs, switches.

    The variables are lam, the slip one way, the spring force and the switch.
    """
    return [
        item
        for family in _families(block)
        for item in zip(family[0].values(), family[1].values(), strict=True)
    ]


def sides(block: Any) -> list[tuple[Any, Any]]:
    """Return the two variables of every relaxed pair, by steps as in `hold_modes`.

    (lam, lam - k phi) of contacts, (slip forward, mu N + f), (slip backward, mu N - f) of
    frictions, then the pairs of springs and of switches.
    """
    steps = len(block.set_steps)
    rows: list[list[tuple[Any, Any]]] = [[] for _ in range(steps)]
    for variables, components in _families(block):
        couples = [
            (variable, pair.v)
            for variable, pair in zip(variables.values(), components.values(), strict=True)
        ]
        width = len(couples) // steps
        for t, row in enumerate(rows):
            row += couples[t * width : (t + 1) * width]
    return [couple for row in rows for couple in row]


def _families(block: Any) -> list[tuple[Any, Any]]:
    kinds = (("lam", "contact"), ("slip", "friction"), ("spring", "spring"), ("touch", "touch"))
    names = [(f"variable_{variable}", f"complementarity_{pair}") for variable, pair in kinds]
    families = [(block.component(variable), block.component(pair)) for variable, pair in names]
    return [(variable, pair) for variable, pair in families if pair is not None]


def hold_modes(block: Any, closed: np.ndarray) -> None:
    """Fix every pair of a relaxed block, and switch the products off.

    closed (steps, nc + 2 nf + springs + switches) [-]: the modes of each step, in this order:

    - whether each contact is closed (lam = k phi, else 0)
    - whether it may slip forward (f = -mu N) and backward
    - spring and switch of each damped contact

    The rest is a convex quadratic program for a linear scene without friction. Friction of an open
    contact is never fixed: it has no force and any slip. Raises ValueError for modes of another
    shape.
    """
    for _, pair in pairs(block):
        pair.ccon.deactivate()
    couples = sides(block)
    for (force, separation), is_closed in zip(couples, closed.ravel().tolist(), strict=True):
        force.setlb(0.0)
        separation.setlb(0.0)
        force.setub(None if is_closed else 0.0)
        separation.setub(0.0 if is_closed else None)
    _free_unpressed(block, couples, closed)


def release_modes(block: Any) -> None:
    """Undo `hold_modes`: free the pairs, and bound their products by mpec_bound."""
    for variable, pair in pairs(block):
        pair.ccon.activate()
        for side in (variable, pair.v):
            side.setlb(0.0)
            side.setub(None)


def _checked_bound(block: Any, eps: Any) -> float:
    if isinstance(eps, bool) or not isinstance(eps, (int, float)) or not 0.0 <= eps < math.inf:
        raise ModelError(
            f"model {block.name}: eps is {eps!r}, but the bound of lam (lam - k phi) must be a finite number of at least 0 N^2."
        )
    return float(eps)


def add_contact_law(
    block: Any,
    index: tuple[Any, ...],
    contact: ContactFormulation,
    b: float | None,
    softplus: Callable[..., Any],
    push: Callable[..., Any],
) -> None:
    """Add the law of the contact forces.

    index: the sets of `variable_lam`
    b: sharpness of softplus, or None
    softplus: equation of the smoothed law, by index
    push: expression whose positive part is the force, by index
    """
    if contact is ContactFormulation.SOFTPLUS:
        block.parameter_sharpness = pyo.Param(initialize=b, mutable=True)
        block.constraint_contact_softplus = pyo.Constraint(
            *index, rule=lambda _, *at: softplus(*at)
        )
        return
    lam = block.variable_lam
    block.complementarity_contact = Complementarity(
        *index, rule=lambda _, *at: equations.complementarity_contact(lam[at], push(*at))
    )


def damped_softplus(scene: Scene, contact: int, phi: Any, rate: Any, k: Any, c: Any, b: Any) -> Any:
    """Return the smoothed force of a damped contact [N]."""
    if scene.contacts[contact].damping_law is DampingLaw.KELVIN_VOIGT:
        return equations.expression_kelvin_voigt_softplus(phi, rate, k, c, b)
    return equations.expression_hunt_crossley_softplus(phi, rate, k, c, b, scene.length)


def add_springs(
    block: Any,
    scene: Scene,
    law: SceneExpressions,
    phi: list[Any],
    q: list[Any],
    v: list[Any],
    parameters: list[Any],
) -> list[dict[int, Any]]:
    """Add the variables and pairs of the damped contacts, with rates r at the start of the step.

        variable_spring[t, name]   sigma = k max(phi, 0) [N]
        variable_touch[t, name]    w, Kelvin-Voigt only: 1 for phi > 0, 0 for phi < 0
        Hunt-Crossley   push = sigma (1 + d r)   0 <= sigma  complements  sigma - k phi >= 0
        Kelvin-Voigt    push = sigma + c w r     0 <= sigma  complements  1 - w >= 0,
                                                 0 <= w      complements  sigma - k phi >= 0

    lam = max(push, 0). Kelvin-Voigt's force jumps at contact: k phi + c r may be positive before,
    hence
    the switch w. phi are penetrations by step, q and v variables by node. Return the push of each
    damped
    contact, by step.
    """
    names = [scene.contacts[index].name for index in scene.damped]
    switched = [
        scene.contacts[index].name
        for index in scene.damped
        if scene.contacts[index].damping_law is DampingLaw.KELVIN_VOIGT
    ]
    k, c = law.stiffness(parameters), law.damping(parameters)
    rate = [
        law.penetration_rate(q_now, v_now, parameters)
        for q_now, v_now in zip(q[:-1], v[:-1], strict=True)
    ]
    place = {contact.name: index for index, contact in enumerate(scene.contacts)}
    block.set_damped = pyo.Set(initialize=names)
    block.variable_spring = pyo.Var(
        block.set_steps, block.set_damped, bounds=(0.0, None), initialize=0.0
    )
    block.expression_spring = pyo.Expression(
        block.set_steps,
        block.set_damped,
        rule=lambda _, t, name: k[place[name]] * phi[t][place[name]],
    )
    if switched:
        block.set_switched = pyo.Set(initialize=switched)
        block.variable_touch = pyo.Var(
            block.set_steps, block.set_switched, bounds=(0.0, None), initialize=0.0
        )

    def spring(b: Any, t: int, name: str) -> Any:
        i = place[name]
        force = b.variable_spring[t, name]
        if name in switched:
            # A compressed spring touches.
            return equations.complementarity_reserve(force, 1 - b.variable_touch[t, name])
        return equations.complementarity_contact(force, k[i] * phi[t][i])

    def touch(b: Any, t: int, name: str) -> Any:
        i = place[name]
        # There is no gap while touching.
        return equations.complementarity_reserve(
            b.variable_touch[t, name], b.variable_spring[t, name] - k[i] * phi[t][i]
        )

    block.complementarity_spring = Complementarity(block.set_steps, block.set_damped, rule=spring)
    if switched:
        block.complementarity_touch = Complementarity(
            block.set_steps, block.set_switched, rule=touch
        )
    pushes: list[dict[int, Any]] = []
    for t in block.set_steps:
        row = {}
        for name in names:
            i, force = place[name], block.variable_spring[t, name]
            if name in switched:
                row[i] = equations.expression_kelvin_voigt(
                    force, block.variable_touch[t, name], c[i], rate[t][i]
                )
            else:
                row[i] = equations.expression_hunt_crossley(force, c[i], rate[t][i])
        pushes.append(row)
    return pushes


def _settle_springs(block: Any) -> None:
    if block.component("variable_spring") is None:
        return
    for index, expression in block.expression_spring.items():
        force = pyo.value(expression)
        block.variable_spring[index].set_value(max(force, 0.0), skip_validation=True)
        if block.component("variable_touch") is not None and index in block.variable_touch:
            block.variable_touch[index].set_value(1.0 if force > 0.0 else 0.0, skip_validation=True)


FORWARD = "forward"
BACKWARD = "backward"


def add_friction(
    block: Any,
    scene: Scene,
    law: SceneExpressions,
    sharpness: float | None,
    plan: tuple[list, list, list],
    parameters: list[Any],
) -> list[list[Any]]:
    """Add the friction forces and their law, by the slip s = S(q[t]) v[t+1] at the end of the step.

        regularised (softplus)   f = -mu N tanh(|ln eps| s / (2 nominal))
        complementarity          s = s_forward - s_backward,
                                 0 <= s_forward   complements  mu N + f >= 0,
                                 0 <= s_backward  complements  mu N - f >= 0

    Only the slip at the end lets a step stick. In the plane complementarity is the model of Stewart
    and Trinkle (maximal dissipation) with one variable less.

    - sharpness: b of the regularised law, or None
    - plan: q, v (nodes) and lam (steps) as variables

    Return the variables f[t][friction].
    """
    q, v, lam = plan
    names = [friction.name for friction in scene.frictions]
    block.set_frictions = pyo.Set(initialize=names)
    block.set_pressed = pyo.Set(
        initialize=[(item.name, contact) for item in scene.frictions for contact in item.pressing],
        dimen=2,
    )
    block.variable_friction = pyo.Var(block.set_steps, block.set_frictions, initialize=0.0)
    force = rows_by_time(block.variable_friction, scene.task.steps)
    slip = [
        law.slip(q_now, v_next, parameters) for q_now, v_next in zip(q[:-1], v[1:], strict=True)
    ]
    limit = [
        law.friction_limit(q_now, lam_now, parameters)
        for q_now, lam_now in zip(q[:-1], lam, strict=True)
    ]
    place = {name: index for index, name in enumerate(names)}
    if sharpness is not None:
        nominal = {friction.name: friction.nominal for friction in scene.frictions}
        if not scene.nc:
            block.parameter_sharpness = pyo.Param(initialize=sharpness, mutable=True)

        def regularised(b: Any, t: int, name: str) -> Any:
            i = place[name]
            steepness = b.parameter_sharpness / (2.0 * nominal[name] / scene.length)
            return equations.constraint_friction_regularised(
                force[t][i], limit[t][i], slip[t][i], steepness
            )

        block.constraint_friction_regularised = pyo.Constraint(
            block.set_steps, block.set_frictions, rule=regularised
        )
        return force

    block.set_ways = pyo.Set(initialize=[FORWARD, BACKWARD])
    block.variable_slip = pyo.Var(
        block.set_steps, block.set_frictions, block.set_ways, bounds=(0.0, None), initialize=0.0
    )

    def split(b: Any, t: int, name: str) -> Any:
        forward, backward = b.variable_slip[t, name, FORWARD], b.variable_slip[t, name, BACKWARD]
        return equations.constraint_slip(forward, backward, slip[t][place[name]])

    def complementarity(b: Any, t: int, name: str, way: str) -> Any:
        i = place[name]
        against = force[t][i] if way == FORWARD else -force[t][i]
        return equations.complementarity_reserve(
            b.variable_slip[t, name, way], limit[t][i] + against
        )

    block.constraint_slip = pyo.Constraint(block.set_steps, block.set_frictions, rule=split)
    block.complementarity_friction = Complementarity(
        block.set_steps, block.set_frictions, block.set_ways, rule=complementarity
    )
    return force


def _settle_slip(block: Any) -> None:
    """Set the two slip speeds of each friction from their equation; one is zero."""
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
    """Return (contact, way forward) as columns of `hold_modes` for each friction of a contact.

    The way backward is the next column.
    """
    if block.component("set_pressed") is None:
        return []
    contacts, frictions = list(block.component("set_contacts") or ()), list(block.set_frictions)
    return [
        (contacts.index(contact), len(contacts) + 2 * frictions.index(friction))
        for friction, contact in block.set_pressed
    ]


def _free_unpressed(block: Any, couples: list[tuple[Any, Any]], closed: np.ndarray) -> None:
    """Free the pairs of frictions whose contact is open.

    couples: (slip, reserve) of all pairs
    closed: as in `hold_modes`

    One equation for the force, mu N + f = 0 with N = 0, and one slip variable of either sign
    remain. The redundant bound mu N - f >= 0 would leave no interior; a fixed way would constrain
    the flight.
    """
    for contact, forward in pressed_columns(block):
        for t in np.flatnonzero(~closed[:, contact]).tolist():
            (slip, reserve), (other_slip, other_reserve) = couples[
                t * closed.shape[1] + forward : t * closed.shape[1] + forward + 2
            ]
            slip.setlb(None)
            slip.setub(None)
            reserve.setub(0.0)
            other_slip.setub(0.0)
            other_reserve.setlb(None)
            other_reserve.setub(None)
