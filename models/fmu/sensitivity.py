"""Generate `scene_sensitivity.h`: derivatives of an FMU beyond those of `scene_model.h`.

    scene_<quantity>_jvp            energies and powers along (dq, dv, du, dp)
    scene_<quantity>_vjp            the transpose times w, added to (q, v, u, p)_bar
    scene_<quantity>_parameter_jvp  penetration, stiffness and acceleration along dp
    scene_<quantity>_parameter_vjp  the transpose

With damped contacts also penetration rates and coefficients; with friction also slips, their rates
and the limits mu N.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from models.codegen.c_function import (
    SceneVectors,
    Vector,
    backward_function,
    forward_function,
    tangent,
)
from models.codegen.emit import penetration_rate, slip_rate
from models.codegen.text_cache import cached_text
from models.dynamics import derive
from models.scene import Scene

_HEAD = """\
/* Derivatives of the scene {name} by parameters, and of its energies and powers; generated from its SymPy source. */
#ifndef SCENE_SENSITIVITY_H
#define SCENE_SENSITIVITY_H

#include "scene_model.h"
"""

# M da = (df/dp - dM/dp a) dp and its transpose, if the mass matrix depends on q.
_SOLVES = """\
SCENE_FUNCTION int scene_acceleration_parameter_jvp(const double *q, const double *v, const double *u, const double *lam, const double *p,
    const double *a, const double *dp, double *d_a)
{
    double M[NQ][NQ];
    scene_mass(q, p, &M[0][0]);
    scene_residual_parameter_jvp(q, v, u, lam, p, a, dp, d_a);
    return scene_solve(M, d_a);
}

SCENE_FUNCTION int scene_acceleration_parameter_vjp(const double *q, const double *v, const double *u, const double *lam, const double *p,
    const double *a, const double *a_bar, double *p_bar)
{
    double M[NQ][NQ], w[NQ];
    scene_mass(q, p, &M[0][0]);
    for (int i = 0; i < NQ; i++) w[i] = a_bar[i];
    if (scene_solve(M, w)) return 1;
    scene_residual_parameter_vjp(q, v, u, lam, p, a, w, p_bar);
    return 0;
}
"""


def emit_sensitivity(scene: Scene) -> str:
    """Return the text of `scene_sensitivity.h` (C99), which needs `scene_model.h`."""
    x = SceneVectors.of(derive(scene))
    return "\n".join(
        [
            _HEAD.format(name=scene.name),
            *_parameter_functions(x),
            *_damping_functions(x),
            *_friction_functions(x),
            *_energy_functions(x),
            "#endif",
            "",
        ]
    )


def sensitivity_source(scene: Scene) -> str:
    """Return `emit_sensitivity`, cached between processes."""
    return cached_text(scene, "scene_sensitivity.h", lambda: emit_sensitivity(scene))


def _by_parameters(
    x: SceneVectors,
    head: str,
    arguments: Sequence[Vector],
    output: str,
    function: sp.Matrix,
    weights: Vector,
    tail: str = "",
) -> list[str]:
    """Return the products of a column along dp, forward and backward; `head` lacks the suffix."""
    return [
        forward_function(
            f"{head}_parameter_jvp", (*arguments, tangent(x.p)), output, function, [x.p], tail=tail
        ),
        backward_function(
            f"{head}_parameter_vjp", (*arguments, weights), function, weights, [x.p], tail=tail
        ),
    ]


def _parameter_functions(x: SceneVectors) -> list[str]:
    d, a = x.dynamics, x.q.like("a")
    phi, stiffness, by_a = x.local(d.penetration), x.local(d.stiffness), (*x.arguments, a)
    functions = _by_parameters(
        x, "void scene_penetration", (x.q, x.p), "d_phi", phi, Vector.of("phi_bar", x.contacts)
    )
    functions += _by_parameters(
        x, "void scene_stiffness", (x.p,), "d_k", stiffness, Vector.of("k_bar", x.contacts)
    )
    if d.acceleration is not None:
        closed = x.local(d.acceleration)
        return functions + _by_parameters(
            x, "int scene_acceleration", by_a, "d_a", closed, x.q.like("a_bar"), "return 0;"
        )
    residual = x.local(d.generalised_force) - x.local(d.mass_matrix) * a.column
    return [
        *functions,
        *_by_parameters(x, "void scene_residual", by_a, "d_f", residual, x.q.like("w")),
        _SOLVES,
    ]


def _damping_functions(x: SceneVectors) -> list[str]:
    if not x.dynamics.structure.contact_damping:
        return []
    rate_bar, c_bar = (Vector.of(name, x.contacts) for name in ("rate_bar", "c_bar"))
    rates = _by_parameters(
        x, "void scene_penetration_rate", (x.q, x.v, x.p), "d_rate", penetration_rate(x), rate_bar
    )
    return rates + _by_parameters(
        x, "void scene_damping", (x.p,), "d_c", x.local(x.dynamics.damping), c_bar
    )


def _friction_functions(x: SceneVectors) -> list[str]:
    """Return slip, its rate and mu N along all variables.

    Backward without scene_model.h's parts.
    """
    d = x.dynamics
    if not d.structure.friction:
        return []
    names = [friction.name for friction in d.scene.frictions]
    a, slip_bar, rate_bar, limit_bar = (
        x.q.like("a"),
        *(Vector.of(name, names) for name in ("slip_bar", "rate_bar", "limit_bar")),
    )
    slip, rate, limit = x.local(d.slip), slip_rate(x, a), x.local(d.friction_limit)
    moving, turning, pressing = (x.q, x.v, x.p), (x.q, x.v, a, x.p), (x.q, x.lam, x.p)

    def jvp(name: str, function: sp.Matrix, vectors: Sequence[Vector], result: str) -> str:
        return forward_function(
            f"void {name}",
            (*vectors, *(tangent(vector) for vector in vectors)),
            result,
            function,
            vectors,
        )

    return [
        jvp("scene_slip_jvp", slip, moving, "d_slip"),
        backward_function(
            "void scene_slip_parameter_vjp", (*moving, slip_bar), slip, slip_bar, [x.p]
        ),
        jvp("scene_slip_rate_jvp", rate, turning, "d_rate"),
        backward_function(
            "void scene_slip_rate_vjp", (*turning, rate_bar), rate, rate_bar, turning
        ),
        jvp("scene_friction_limit_jvp", limit, pressing, "d_limit"),
        backward_function(
            "void scene_friction_limit_parameter_vjp",
            (*pressing, limit_bar),
            limit,
            limit_bar,
            [x.p],
        ),
    ]


def _energy_functions(x: SceneVectors) -> list[str]:
    d = x.dynamics
    w = Vector.of("w", ["energy"])
    functions = []
    for name, expression, vectors in (
        ("kinetic_energy", d.kinetic_energy, (x.q, x.v, x.p)),
        ("potential_energy", d.potential_energy, (x.q, x.p)),
        ("input_power", d.input_power, (x.q, x.v, x.u, x.p)),
        ("dissipated_power", d.dissipated_power, (x.q, x.v, x.p)),
    ):
        local = x.local(expression)
        arguments = (*vectors, *(tangent(vector) for vector in vectors))
        functions.append(
            forward_function(f"double scene_{name}_jvp", arguments, None, local, vectors)
        )
        functions.append(
            backward_function(f"void scene_{name}_vjp", (*vectors, w), local, w, vectors)
        )
    return functions
