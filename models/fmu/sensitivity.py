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

from models.codegen.c_function import Vector, c_function
from models.codegen.damping import penetration_rate
from models.codegen.friction import slip_rate
from models.codegen.kept import kept_text
from models.codegen.vectors import SceneVectors
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
    """`emit_sensitivity`, kept between processes."""
    return kept_text(scene, "scene_sensitivity.h", lambda: emit_sensitivity(scene))


def _jvp(function: sp.Matrix, vectors: Sequence[Vector]) -> sp.Matrix:
    """Jacobian-vector product of a column along d<vector> of each of `vectors`."""
    total = sp.zeros(function.rows, 1)
    for vector in vectors:
        if vector.symbols and function.rows:
            total += function.jacobian(vector.column) * _tangent(vector).column
    return total


def _vjp(function: sp.Matrix, weights: Vector, vectors: Sequence[Vector]) -> list[tuple[str, sp.Matrix]]:
    """(name of the adjoint, Jacobian' weights) for each of `vectors`."""
    return [
        (f"{vector.name}_bar", function.jacobian(vector.column).T * weights.column if vector.symbols and function.rows else sp.zeros(0, 1))
        for vector in vectors
    ]


def _tangent(vector: Vector) -> Vector:
    return vector.like(f"d{vector.name}")


def _parameter_functions(x: SceneVectors) -> list[str]:
    d, dp = x.dynamics, _tangent(x.p)
    phi, stiffness = x.local(d.penetration), x.local(d.stiffness)
    a, a_bar, phi_bar, k_bar = x.q.like("a"), x.q.like("a_bar"), Vector.of("phi_bar", x.contacts), Vector.of("k_bar", x.contacts)
    functions = [
        c_function("void", "scene_penetration_parameter_jvp", (x.q, x.p, dp), "d_phi", _jvp(phi, [x.p])),
        c_function("void", "scene_penetration_parameter_vjp", (x.q, x.p, phi_bar), _vjp(phi, phi_bar, [x.p]), operator="+="),
        c_function("void", "scene_stiffness_parameter_jvp", (x.p, dp), "d_k", _jvp(stiffness, [x.p])),
        c_function("void", "scene_stiffness_parameter_vjp", (x.p, k_bar), _vjp(stiffness, k_bar, [x.p]), operator="+="),
    ]
    if d.acceleration is not None:
        closed, back = x.local(d.acceleration), (*x.arguments, a, a_bar)
        name = "scene_acceleration_parameter"
        functions += [
            c_function("int", f"{name}_jvp", (*x.arguments, a, dp), "d_a", _jvp(closed, [x.p]), tail="return 0;"),
            c_function("int", f"{name}_vjp", back, _vjp(closed, a_bar, [x.p]), operator="+=", tail="return 0;"),
        ]
    else:
        residual, w = x.local(d.generalised_force) - x.local(d.mass_matrix) * a.column, x.q.like("w")
        name = "scene_residual_parameter"
        functions += [
            c_function("void", f"{name}_jvp", (*x.arguments, a, dp), "d_f", _jvp(residual, [x.p])),
            c_function("void", f"{name}_vjp", (*x.arguments, a, w), _vjp(residual, w, [x.p]), operator="+="),
            _SOLVES,
        ]
    return functions


def _damping_functions(x: SceneVectors) -> list[str]:
    """Rates of penetration and damping coefficients along the parameters, of a scene with damped contacts."""
    d, dp = x.dynamics, _tangent(x.p)
    if not d.structure.contact_damping:
        return []
    rate, damping = penetration_rate(x), x.local(d.damping)
    rate_bar, c_bar = (Vector.of(name, x.contacts) for name in ("rate_bar", "c_bar"))
    moving = (x.q, x.v, x.p)
    return [
        c_function("void", "scene_penetration_rate_parameter_jvp", (*moving, dp), "d_rate", _jvp(rate, [x.p])),
        c_function("void", "scene_penetration_rate_parameter_vjp", (*moving, rate_bar), _vjp(rate, rate_bar, [x.p]), operator="+="),
        c_function("void", "scene_damping_parameter_jvp", (x.p, dp), "d_c", _jvp(damping, [x.p])),
        c_function("void", "scene_damping_parameter_vjp", (x.p, c_bar), _vjp(damping, c_bar, [x.p]), operator="+="),
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
        return c_function("void", name, (*vectors, *(_tangent(vector) for vector in vectors)), result, _jvp(function, vectors))

    def vjp(name: str, function: sp.Matrix, vectors: Sequence[Vector], weights: Vector, back: Sequence[Vector]) -> str:
        return c_function("void", name, (*vectors, weights), _vjp(function, weights, back), operator="+=")

    return [
        jvp("scene_slip_jvp", slip, moving, "d_slip"),
        vjp("scene_slip_parameter_vjp", slip, moving, slip_bar, [x.p]),
        jvp("scene_slip_rate_jvp", rate, turning, "d_rate"),
        vjp("scene_slip_rate_vjp", rate, turning, rate_bar, turning),
        jvp("scene_friction_limit_jvp", limit, pressing, "d_limit"),
        vjp("scene_friction_limit_parameter_vjp", limit, pressing, limit_bar, [x.p]),
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
        arguments = (*vectors, *(_tangent(vector) for vector in vectors))
        functions.append(c_function("double", f"scene_{name}_jvp", arguments, None, _jvp(local, vectors)))
        functions.append(c_function("void", f"scene_{name}_vjp", (*vectors, w), _vjp(local, w, vectors), operator="+="))
    return functions
