"""Scene -> `scene_model.h`: static inline C functions, common subexpressions eliminated, names kept.

The text depends on the scene alone (no date, no random names), so that equal scenes give equal bytes. What the scene
does not need is not written: a constant mass matrix is inverted here, symbolically, and only a scene whose mass matrix
depends on q gets a Cholesky factorisation.

Within the C functions every entry of a vector has a name of its own, `<vector>_<name>`: `q_q1`, `lam_left`, `p_k`.
"""

from __future__ import annotations

import sympy as sp
from sympy.printing.codeprinter import PrintMethodNotImplementedError

from models.codegen.c_function import Vector, c_function
from models.codegen.chain_rule import backward_function, forward_function, tangent
from models.codegen.cholesky import cholesky_function
from models.codegen.damping import damping_functions
from models.codegen.friction import friction_functions
from models.codegen.kept import kept_text
from models.codegen.vectors import SceneVectors
from models.dynamics import derive
from models.errors import SceneError
from models.scene import Scene


def emit_model(scene: Scene, *, defaults: bool = True) -> str:
    """Text of `scene_model.h` (C99, no I/O, static inline functions only).

    defaults: also write the default parameter values; without them one header serves all parameter values of a scene.
    """
    vectors = SceneVectors.of(derive(scene))
    try:
        parts = [
            _head(scene, defaults),
            *_contact_functions(vectors),
            *damping_functions(vectors),
            *friction_functions(vectors),
            *_acceleration_functions(vectors),
            *_energy_functions(vectors),
        ]
    except PrintMethodNotImplementedError as error:
        function = str(error).splitlines()[0].rpartition(": ")[2].rpartition(".")[2].rstrip("'>")  # a name, or the whole of a class
        raise SceneError(
            f"scene {scene.name}: its equations or their derivatives contain {function}, which has no form in C; "
            "use smooth elementary functions (sin, exp, sqrt, tanh ..)."
        ) from error
    return "\n".join([*parts, "#endif", ""])


def model_source(scene: Scene) -> str:
    """`emit_model` without default values, kept between processes."""
    return kept_text(scene, "scene_model.h", lambda: emit_model(scene, defaults=False))


def _head(scene: Scene, defaults: bool) -> str:
    sizes = {"NQ": scene.nq, "NU": scene.nu, "NC": scene.nc, "NF": scene.nf, "NP": len(scene.parameters)}
    lines = [
        f"/* Equations of motion of the scene {scene.name}; generated from its SymPy source. */",
        "#ifndef SCENE_MODEL_H",
        "#define SCENE_MODEL_H",
        "",
        "#include <math.h>",
        "",
        f'#define SCENE_NAME "{scene.name}"',
        *(f"#define {name} {size}" for name, size in sizes.items()),
        "",
        "#if defined(__GNUC__)",
        "#define SCENE_UNUSED __attribute__((unused))",
        "#else",
        "#define SCENE_UNUSED",
        "#endif",
        "#define SCENE_FUNCTION static inline SCENE_UNUSED",
        "",
    ]
    if scene.nf:
        nominals = ", ".join(repr(float(friction.nominal)) for friction in scene.frictions)
        lines += [f"static const double scene_friction_nominals[] SCENE_UNUSED = {{{nominals}}};", ""]
    if scene.nf or scene.damped:
        lines += [f"#define SCENE_LENGTH {scene.length!r}", ""]
    if defaults:
        values = [parameter.value for parameter in scene.parameters] or [0.0]
        lines += [
            f"static const double scene_default_parameters[] SCENE_UNUSED = {{{', '.join(repr(float(value)) for value in values)}}};",
            "",
        ]
    return "\n".join(lines)


def _contact_functions(x: SceneVectors) -> list[str]:
    d = x.dynamics
    phi, stiffness = x.local(d.penetration), x.local(d.stiffness)
    phi_bar = Vector.of("phi_bar", x.contacts)
    return [
        c_function("void", "scene_penetration", (x.q, x.p), "phi", phi),
        c_function("void", "scene_stiffness", (x.p,), "k", stiffness),
        forward_function("void scene_penetration_jvp", (x.q, x.p, tangent(x.q)), "d_phi", phi, [x.q]),
        backward_function("void scene_penetration_vjp", (x.q, x.p, phi_bar), phi, phi_bar, [x.q]),
    ]


def _energy_functions(x: SceneVectors) -> list[str]:
    d = x.dynamics
    cost, cost_bar = x.local(d.running_cost), Vector.of("cost", ["bar"])
    return [
        c_function("double", "scene_kinetic_energy", (x.q, x.v, x.p), None, x.local(d.kinetic_energy)),
        c_function("double", "scene_potential_energy", (x.q, x.p), None, x.local(d.potential_energy)),
        c_function("double", "scene_input_power", (x.q, x.v, x.u, x.p), None, x.local(d.input_power)),
        c_function("double", "scene_dissipated_power", (x.q, x.v, x.p), None, x.local(d.dissipated_power)),
        c_function("double", "scene_running_cost", (x.q, x.v, x.u, x.p), None, cost),
        backward_function("void scene_running_cost_vjp", (x.q, x.v, x.u, x.p, cost_bar), cost, cost_bar, [x.q, x.v, x.u]),
        *_final_cost_functions(x, cost_bar),
    ]


def _final_cost_functions(x: SceneVectors, cost_bar: Vector) -> list[str]:
    """The cost of the last state; nothing for a task without one."""
    if x.dynamics.final_cost == 0:
        return []
    cost = x.local(x.dynamics.final_cost)
    return [
        "#define FINAL_COST",
        c_function("double", "scene_final_cost", (x.q, x.v, x.p), None, cost),
        backward_function("void scene_final_cost_vjp", (x.q, x.v, x.p, cost_bar), cost, cost_bar, [x.q, x.v]),
    ]


def _acceleration_functions(x: SceneVectors) -> list[str]:
    closed = x.dynamics.acceleration
    return _factorised_acceleration(x) if closed is None else _closed_acceleration(x, x.local(closed))


def _closed_acceleration(x: SceneVectors, acceleration: sp.Matrix) -> list[str]:
    a_bar, moving = x.q.like("a_bar"), (x.q, x.v, x.u, x.lam)
    along = (*x.arguments, *map(tangent, moving))
    return [
        c_function("int", "scene_acceleration", x.arguments, "a", acceleration, tail="return 0;"),
        forward_function("int scene_acceleration_jvp", along, "d_a", acceleration, moving, tail="return 0;"),
        backward_function("int scene_acceleration_vjp", (*x.arguments, a_bar), acceleration, a_bar, moving, tail="return 0;"),
    ]


# Cholesky factorisation and solve, written only for scenes whose mass matrix depends on q.
_SOLVES = """\
SCENE_FUNCTION int scene_acceleration(const double *q, const double *v, const double *u, const double *lam, const double *p, double *a)
{
    double M[NQ][NQ];
    scene_mass(q, p, &M[0][0]);
    scene_force(q, v, u, lam, p, a);
    return scene_solve(M, a);
}

/* M da = df - (dM/dq dq) a */
SCENE_FUNCTION int scene_acceleration_jvp(const double *q, const double *v, const double *u, const double *lam, const double *p,
    const double *dq, const double *dv, const double *du, const double *dlam, double *d_a)
{
    double M[NQ][NQ], a[NQ];
    if (scene_acceleration(q, v, u, lam, p, a)) return 1;
    scene_mass(q, p, &M[0][0]);
    scene_force_jvp(q, v, u, lam, p, a, dq, dv, du, dlam, d_a);
    return scene_solve(M, d_a);
}

/* w = M^-1 a_bar; then (q, v, u, lam)_bar += (df/dx)' w - (w' dM/dq a) */
SCENE_FUNCTION int scene_acceleration_vjp(const double *q, const double *v, const double *u, const double *lam, const double *p,
    const double *a_bar, double *q_bar, double *v_bar, double *u_bar, double *lam_bar)
{
    double M[NQ][NQ], a[NQ], w[NQ];
    if (scene_acceleration(q, v, u, lam, p, a)) return 1;
    scene_mass(q, p, &M[0][0]);
    for (int i = 0; i < NQ; i++) w[i] = a_bar[i];
    if (scene_solve(M, w)) return 1;
    scene_force_vjp(q, v, u, lam, p, a, w, q_bar, v_bar, u_bar, lam_bar);
    return 0;
}
"""


def _factorised_acceleration(x: SceneVectors) -> list[str]:
    d = x.dynamics
    mass, force = x.local(d.mass_matrix), x.local(d.generalised_force)
    a, w, moving = x.q.like("a"), x.q.like("w"), (x.q, x.v, x.u, x.lam)
    # For fixed a, the residual f - M a has the Jacobian that both products below need.
    residual = force - mass * a.column
    return [
        cholesky_function(d.mass_matrix),
        c_function("void", "scene_mass", (x.q, x.p), "M", sp.Matrix(list(mass))),
        c_function("void", "scene_force", x.arguments, "f", force),
        forward_function("void scene_force_jvp", (*x.arguments, a, *map(tangent, moving)), "d_f", residual, moving),
        backward_function("void scene_force_vjp", (*x.arguments, a, w), residual, w, moving),
        _SOLVES,
    ]
