"""Collocation in a plan's model: the scene's equations at the stages of each step.

    model = build_model("three_cart", contact=ContactFormulation.SOFTPLUS, eps=1e-5, steps=100,
    step=0.05, scheme=Scheme.RADAU_IIA_2)

The input is constant over a step. A plan's `lam` at the start of each step is the contact law at
the node.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyomo.environ as pyo

from formulations.transcription import equations
from formulations.transcription.contact import (
    ContactFormulation,
    ModelError,
    SceneExpressions,
    add_contact_law,
    rows_by_time,
    settle_separation,
)
from formulations.transcription.method import why_not_collocated
from models.dynamics import derive
from models.scene import Scene
from models.schemes import Scheme, Tableau, tableau


def add_collocation(
    block: Any,
    scene: Scene,
    contact: ContactFormulation,
    b: float | None,
    scheme: Scheme,
    *,
    integrate_cost: bool = False,
) -> None:
    """Add stages, dynamics, contact law and cost to a block with nodes, inputs and ends.

    Stages are i in 1..s (`set_stages`); the second stage of Radau IIA is the next node.

    | name | index | meaning |
    |---|---|---|
    | variable_stage_q, variable_stage_v | step, coordinate | first stage, at t h + c_1 h ||
    | variable_lam | step, i, contact | contact forces [N] |
    | constraint_position_step, constraint_velocity_step | step, i, coordinate | motion |
    | constraint_position_end, constraint_velocity_end | step, coordinate | implicit midpoint only |
    | constraint_contact_softplus or complementarity_contact | step, i, contact | contact law |
    | expression_penetration | step, contact | phi at the node [m] |
    | expression_stage_penetration | step, i, contact | phi at the stages [m] |

    Raises
    ------
    ModelError
        for a scene without collocation
    """
    reason = why_not_collocated(scene)
    if reason is not None:
        raise ModelError(f"scheme {scheme.value}: {reason}")
    table, law, steps = tableau(scheme), SceneExpressions(derive(scene)), scene.task.steps
    block.scheme = scheme
    block.set_stages = pyo.RangeSet(1, table.stages)
    p = list(block.parameter_scene.values()) if scene.parameters else []
    q, v = rows_by_time(block.variable_q, steps + 1), rows_by_time(block.variable_v, steps + 1)
    u = rows_by_time(block.variable_u, steps) if scene.nu else [[]] * steps
    stage_q, stage_v = _add_stages(block, table, q, v)
    lam: list[list[list[Any]]] = [[[]] * table.stages] * steps
    if scene.nc:
        lam = _add_contact(block, scene, contact, b, law, (q, stage_q), p)
    _add_motion(block, table, law, (q, v, u), (stage_q, stage_v, lam), p)
    if integrate_cost:
        weighed = [
            float(weight) * law.running_cost(stage_q[t][i], stage_v[t][i], u[t], p)[0]
            for t in range(steps)
            for i, weight in enumerate(table.b)
        ]
    else:
        weighed = [
            law.running_cost(*arguments, p)[0] for arguments in zip(q[:-1], v[:-1], u, strict=True)
        ]
    block.expression_cost = pyo.Expression(
        expr=equations.expression_cost([*weighed, *law.final_cost(q[-1], v[-1], p)])
    )


def _add_stages(
    block: Any, table: Tableau, q: list, v: list
) -> tuple[list[list[list[Any]]], list[list[list[Any]]]]:
    """Return stage positions and velocities [t][i][coordinate]; only first stages are variables."""
    states = []
    for name, nodes in (("q", q), ("v", v)):
        start = {data.index()[1]: data.value for data in nodes[0]}
        variable = pyo.Var(
            block.set_steps,
            block.set_coordinates,
            initialize=lambda _, t, c, start=start: start[c],
        )
        block.add_component(f"variable_stage_{name}", variable)
        rows = [[first] for first in rows_by_time(variable, len(nodes) - 1)]
        if table.is_stiffly_accurate:
            rows = [[*stages, after] for stages, after in zip(rows, nodes[1:], strict=True)]
        states.append(rows)
    return states[0], states[1]


def _add_motion(
    block: Any, table: Tableau, law: SceneExpressions, nodes: tuple, stages: tuple, p: list[Any]
) -> None:
    (q, v, u), (stage_q, stage_v, lam), nq, h = nodes, stages, law.nq, block.parameter_step
    place = {name: index for index, name in enumerate(block.set_coordinates)}
    inverse = np.linalg.inv(table.a)
    mass = [[law.mass(at, p) for at in row] for row in stage_q]
    force = [
        [law.force(stage_q[t][i], stage_v[t][i], u[t], lam[t][i], p) for i in range(table.stages)]
        for t in range(len(stage_q))
    ]

    def gained(rows: list, now: list, t: int, i: int) -> list[Any]:
        """Return sum_j D_ij (X_j - x[t]) (nq,), D = A^-1 [-]."""
        return [
            sum(
                float(weight) * (rows[t][j][c] - now[t][c])
                for j, weight in enumerate(inverse[i - 1])
            )
            for c in range(nq)
        ]

    def position(_: Any, t: int, i: int, name: str) -> Any:
        c = place[name]
        return equations.constraint_position_stage(
            gained(stage_q, q, t, i)[c], stage_v[t][i - 1][c], h
        )

    def velocity(_: Any, t: int, i: int, name: str) -> Any:
        c = place[name]
        row = mass[t][i - 1][c * nq : (c + 1) * nq]
        return equations.constraint_velocity_stage(
            row, gained(stage_v, v, t, i), force[t][i - 1][c], h
        )

    block.constraint_position_step = pyo.Constraint(
        block.set_steps, block.set_stages, block.set_coordinates, rule=position
    )
    block.constraint_velocity_step = pyo.Constraint(
        block.set_steps, block.set_stages, block.set_coordinates, rule=velocity
    )
    if table.is_stiffly_accurate:
        return
    for name, rows, now in (("position", stage_q, q), ("velocity", stage_v, v)):
        end = pyo.Constraint(
            block.set_steps,
            block.set_coordinates,
            rule=lambda _, t, coordinate, rows=rows, now=now: equations.constraint_step_end(
                now[t + 1][place[coordinate]],
                now[t][place[coordinate]],
                rows[t][0][place[coordinate]],
            ),
        )
        block.add_component(f"constraint_{name}_end", end)


def _add_contact(
    block: Any,
    scene: Scene,
    contact: ContactFormulation,
    b: float | None,
    law: SceneExpressions,
    states: tuple,
    p: list[Any],
) -> list[list[list[Any]]]:
    """Add the contact forces and their law; return lam[t][i][contact].

    states: nodes q, stages q
    """
    q, stage_q = states
    place = {name: index for index, name in enumerate(block.set_contacts)}
    block.variable_lam = pyo.Var(
        block.set_steps, block.set_stages, block.set_contacts, initialize=0.0
    )
    lam: list[list[list[Any]]] = [[[] for _ in row] for row in stage_q]
    for (t, i, _), data in block.variable_lam.items():
        lam[t][i - 1].append(data)
    k = law.stiffness(p)
    phi = [[law.penetration(at, p) for at in row] for row in stage_q]
    at_nodes = [law.penetration(at, p) for at in q[:-1]]
    block.expression_penetration = pyo.Expression(
        block.set_steps, block.set_contacts, rule=lambda _, t, name: at_nodes[t][place[name]]
    )
    block.expression_stage_penetration = pyo.Expression(
        block.set_steps,
        block.set_stages,
        block.set_contacts,
        rule=lambda _, t, i, name: phi[t][i - 1][place[name]],
    )
    block.expression_stiffness = pyo.Expression(
        block.set_contacts, rule=lambda _, name: k[place[name]]
    )
    if contact is ContactFormulation.COMPLEMENTARITY:
        block.variable_lam.setlb(0.0)

    def softplus(t: int, i: int, name: str) -> Any:
        c = place[name]
        return equations.constraint_contact_softplus(
            lam[t][i - 1][c], phi[t][i - 1][c], k[c], block.parameter_sharpness
        )

    def push(t: int, i: int, name: str) -> Any:
        return k[place[name]] * phi[t][i - 1][place[name]]

    add_contact_law(
        block, (block.set_steps, block.set_stages, block.set_contacts), contact, b, softplus, push
    )
    return lam


def is_collocated(block: Any) -> bool:
    """Return whether the block's steps have stages."""
    return block.component("set_stages") is not None


def settle_stages(block: Any) -> None:
    """Set the stages on the line between their nodes, and the forces by the contact law."""
    table = tableau(block.scheme)
    for name in ("q", "v"):
        variable, nodes = (
            block.component(f"variable_stage_{name}"),
            block.component(f"variable_{name}"),
        )
        for (t, coordinate), data in variable.items():
            before, after = pyo.value(nodes[t, coordinate]), pyo.value(nodes[t + 1, coordinate])
            data.set_value(before + float(table.c[0]) * (after - before), skip_validation=True)
    settle_forces(block)


def settle_forces(block: Any) -> None:
    """Set the forces by the contact law of their stages."""
    if block.component("variable_lam") is None:
        return
    for data, force in zip(
        block.variable_lam.values(),
        _forces(block, stage_penetration(block)).ravel().tolist(),
        strict=True,
    ):
        data.set_value(force, skip_validation=True)
    settle_separation(block)


def forces_at_nodes(block: Any) -> np.ndarray:
    """Return contact forces (steps, nc) [N] at the start of each step, by the block's contact law.

    Raises ValueError if a variable has no value.
    """
    if block.component("variable_lam") is None:
        return np.zeros((len(block.set_steps), 0))
    return _forces(block, _values(block.expression_penetration).reshape(len(block.set_steps), -1))


def stage_penetration(block: Any) -> np.ndarray:
    """Return penetrations (steps, s * nc) [m] at the stages, by stages.

    Raises ValueError if a variable has no value.
    """
    return _values(block.expression_stage_penetration).reshape(len(block.set_steps), -1)


def _forces(block: Any, phi: np.ndarray) -> np.ndarray:
    k = np.resize(_values(block.expression_stiffness), phi.shape[1])
    if block.component("parameter_sharpness") is None:
        return k * np.maximum(phi, 0.0)
    b = pyo.value(block.parameter_sharpness)
    return (k / b) * np.logaddexp(0.0, b * phi)


def _values(expression: Any) -> np.ndarray:
    return np.array([pyo.value(item) for item in expression.values()], dtype=float)
