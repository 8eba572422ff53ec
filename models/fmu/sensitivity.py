"""Scene -> `scene_sensitivity.h`: the derivatives an FMU must offer beyond those of `scene_model.h`.

Jacobian-vector products of energies and powers, and of everything with respect to parameters, and their transposes, which
add to the adjoints (q, v, u, p)_bar:

    scene_<quantity>_jvp            energies and powers along (dq, dv, du, dp)
    scene_<quantity>_vjp            the same backwards, times the weight w
    scene_<quantity>_parameter_jvp  penetration, stiffness and acceleration along dp
    scene_<quantity>_parameter_vjp  the same backwards

and, in scenes with damped contacts, those of the rates of penetration and coefficients; in scenes with friction, those of slips, of their rates and of the limits mu N.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from models.codegen.c_function import SceneVectors, Vector, backward_function, forward_function, tangent
from models.codegen.cache import cached_text
from models.codegen.emit import penetration_rate, slip_rate
from models.dynamics import derive
from models.scene import Scene

_HEAD = """\
/* Derivatives of the scene {name} by parameters, and of its energies and powers; generated from its SymPy source. */
#ifndef SCENE_SENSITIVITY_H
#define SCENE_SENSITIVITY_H

#include "scene_model.h"
"""

# M da = (df/dp - dM/dp a) dp and its transpose, for scenes whose mass matrix depends on q.
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
    """Text of `scene_sensitivity.h` (C99, static inline functions; needs `scene_model.h`)."""
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
    """`emit_sensitivity`, cached between processes."""
    return cached_text(scene, "scene_sensitivity.h", lambda: emit_sensitivity(scene))


def _parameter_functions(x: SceneVectors) -> list[str]:
    d, dp = x.dynamics, tangent(x.p)
    phi, stiffness = x.local(d.penetration), x.local(d.stiffness)
    a, a_bar, phi_bar, k_bar = x.q.like("a"), x.q.like("a_bar"), Vector.of("phi_bar", x.contacts), Vector.of("k_bar", x.contacts)
    functions = [
        forward_function("void scene_penetration_parameter_jvp", (x.q, x.p, dp), "d_phi", phi, [x.p]),
        backward_function("void scene_penetration_parameter_vjp", (x.q, x.p, phi_bar), phi, phi_bar, [x.p]),
        forward_function("void scene_stiffness_parameter_jvp", (x.p, dp), "d_k", stiffness, [x.p]),
        backward_function("void scene_stiffness_parameter_vjp", (x.p, k_bar), stiffness, k_bar, [x.p]),
    ]
    if d.acceleration is not None:
        closed, back = x.local(d.acceleration), (*x.arguments, a, a_bar)
        functions += [
            forward_function("int scene_acceleration_parameter_jvp", (*x.arguments, a, dp), "d_a", closed, [x.p], tail="return 0;"),
            backward_function("int scene_acceleration_parameter_vjp", back, closed, a_bar, [x.p], tail="return 0;"),
        ]
    else:
        residual, w = x.local(d.generalised_force) - x.local(d.mass_matrix) * a.column, x.q.like("w")
        functions += [
            forward_function("void scene_residual_parameter_jvp", (*x.arguments, a, dp), "d_f", residual, [x.p]),
            backward_function("void scene_residual_parameter_vjp", (*x.arguments, a, w), residual, w, [x.p]),
            _SOLVES,
        ]
    return functions


def _damping_functions(x: SceneVectors) -> list[str]:
    """Rates of penetration and damping coefficients along the parameters, of a scene with damped contacts."""
    d, dp = x.dynamics, tangent(x.p)
    if not d.structure.contact_damping:
        return []
    rate, damping = penetration_rate(x), x.local(d.damping)
    rate_bar, c_bar = (Vector.of(name, x.contacts) for name in ("rate_bar", "c_bar"))
    moving = (x.q, x.v, x.p)
    return [
        forward_function("void scene_penetration_rate_parameter_jvp", (*moving, dp), "d_rate", rate, [x.p]),
        backward_function("void scene_penetration_rate_parameter_vjp", (*moving, rate_bar), rate, rate_bar, [x.p]),
        forward_function("void scene_damping_parameter_jvp", (x.p, dp), "d_c", damping, [x.p]),
        backward_function("void scene_damping_parameter_vjp", (x.p, c_bar), damping, c_bar, [x.p]),
    ]


def _friction_functions(x: SceneVectors) -> list[str]:
    """Slip, its rate and the limit mu N along everything; backwards what scene_model.h leaves out."""
    d = x.dynamics
    if not d.structure.friction:
        return []
    names = [friction.name for friction in d.scene.frictions]
    a, slip_bar, rate_bar, limit_bar = x.q.like("a"), *(Vector.of(name, names) for name in ("slip_bar", "rate_bar", "limit_bar"))
    slip, rate, limit = x.local(d.slip), slip_rate(x, a), x.local(d.friction_limit)
    moving, turning, pressing = (x.q, x.v, x.p), (x.q, x.v, a, x.p), (x.q, x.lam, x.p)

    def jvp(name: str, function: sp.Matrix, vectors: Sequence[Vector], result: str) -> str:
        return forward_function(f"void {name}", (*vectors, *(tangent(vector) for vector in vectors)), result, function, vectors)

    return [
        jvp("scene_slip_jvp", slip, moving, "d_slip"),
        backward_function("void scene_slip_parameter_vjp", (*moving, slip_bar), slip, slip_bar, [x.p]),
        jvp("scene_slip_rate_jvp", rate, turning, "d_rate"),
        backward_function("void scene_slip_rate_vjp", (*turning, rate_bar), rate, rate_bar, turning),
        jvp("scene_friction_limit_jvp", limit, pressing, "d_limit"),
        backward_function("void scene_friction_limit_parameter_vjp", (*pressing, limit_bar), limit, limit_bar, [x.p]),
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
        functions.append(forward_function(f"double scene_{name}_jvp", arguments, None, local, vectors))
        functions.append(backward_function(f"void scene_{name}_vjp", (*vectors, w), local, w, vectors))
    return functions
