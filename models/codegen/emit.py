"""Write `scene_model.h` of a scene: static inline C functions with shared subexpressions.

Equal scenes give equal bytes. A constant mass matrix is inverted symbolically, and a Cholesky
factorisation covers nonzero entries only. Vector entries are named `<vector>_<name>`: `q_q1`,
`lam_left`. In hand-written C, code for damped contacts is between `#ifdef DAMPING` and `#else` or
`#endif`, or in `DAMPED(statement;)`; `for_scene` removes it for undamped scenes.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import sympy as sp

from models.codegen.c_function import (
    SceneVectors,
    Vector,
    backward_function,
    c_function,
    forward_function,
    tangent,
)
from models.codegen.text_cache import cached_text
from models.dynamics import derive
from models.scene import Scene

_HEAD = """\
/* Factorises the symmetric positive definite M = L L' in place (lower triangle), then solves M x = b in place; entries that are zero for
 * every q are left out. Returns 1 if M is not positive definite, else 0. */
SCENE_INLINE int scene_solve(double M[NQ][NQ], double *b)
{
"""


def cholesky_function(mass: sp.Matrix) -> str:
    """Return `scene_solve` for a mass matrix with these zeros."""
    lower = _factor_pattern(mass)
    n = mass.rows
    lines: list[str] = []
    for j in range(n):
        lines += [f"M[{j}][{j}] -= M[{j}][{k}]*M[{j}][{k}];" for k in range(j) if (j, k) in lower]
        lines += [f"if (!(M[{j}][{j}] > 0.0)) return 1;", f"M[{j}][{j}] = sqrt(M[{j}][{j}]);"]
        for i in range(j + 1, n):
            if (i, j) in lower:
                lines += [
                    f"M[{i}][{j}] -= M[{i}][{k}]*M[{j}][{k}];"
                    for k in range(j)
                    if (i, k) in lower and (j, k) in lower
                ]
                lines.append(f"M[{i}][{j}] /= M[{j}][{j}];")
    for i in range(n):
        lines += [f"b[{i}] -= M[{i}][{k}]*b[{k}];" for k in range(i) if (i, k) in lower]
        lines.append(f"b[{i}] /= M[{i}][{i}];")
    for i in reversed(range(n)):
        lines += [f"b[{i}] -= M[{k}][{i}]*b[{k}];" for k in range(i + 1, n) if (k, i) in lower]
        lines.append(f"b[{i}] /= M[{i}][{i}];")
    return "".join([_HEAD, *(f"    {line}\n" for line in lines), "    return 0;\n}\n"])


def _factor_pattern(mass: sp.Matrix) -> set[tuple[int, int]]:
    """Return the entries (i, j), i > j, of L that can be nonzero: those of M, and the fill."""
    n = mass.rows
    lower = {(i, j) for i in range(n) for j in range(i) if mass[i, j] != 0}
    for k in range(n):
        below = [i for i in range(k + 1, n) if (i, k) in lower]
        lower |= {(i, j) for i in below for j in below if i > j}
    return lower


_OPEN = "#ifdef DAMPING"
_OPEN_WITHOUT = "#ifndef DAMPING"
_ELSE = "#else"
_CLOSE = "#endif"
_LINE = "DAMPED("


def for_scene(scene: Scene, text: str) -> str:
    """Return a hand-written C source for this scene, without unneeded code for damped contacts."""
    if scene.damped or not ("DAMPING" in text or _LINE in text):
        return text
    kept: list[str] = []
    depth, taken = 0, True  # inside a conditional section
    for line in text.splitlines(keepends=True):
        words = line.strip()
        if depth == 0 and words in (_OPEN, _OPEN_WITHOUT):
            depth, taken = 1, words == _OPEN_WITHOUT
        elif depth == 1 and words == _ELSE:
            taken = True
        elif depth == 1 and words == _CLOSE:
            depth, taken = 0, True
        else:
            if depth and words.startswith("#if"):
                depth += 1
            elif depth and words.startswith(_CLOSE):
                depth -= 1
            # Removed code leaves no empty line.
            if taken and not words.startswith(_LINE) and (words or not kept or kept[-1].strip()):
                kept.append(line)
    return "".join(kept)


def penetration_rate(x: SceneVectors) -> sp.Matrix:
    """Return d phi/dt (nc, 1) along the velocities v [m/s]."""
    return -x.local(x.dynamics.gap_jacobian) * x.v.column


def damping_functions(x: SceneVectors) -> list[str]:
    """Return laws, coefficients and rate derivatives of damped contacts, if there are any."""
    d = x.dynamics
    if not d.structure.contact_damping:
        return []
    laws = ", ".join(
        str(contact.damping_law.value if contact.is_damped else 0) for contact in d.scene.contacts
    )
    rate, rate_bar = penetration_rate(x), Vector.of("rate_bar", x.contacts)
    state = (x.q, x.v)
    return [
        "#define DAMPING",
        "#define DAMPED(...) __VA_ARGS__",
        f"#define ND {len(d.scene.damped)}",
        "/* Of each contact: 0 undamped, 1 Kelvin-Voigt, 2 Hunt-Crossley; and which contacts are damped. */",
        f"static const int scene_damping_laws[] SCENE_UNUSED = {{{laws}}};",
        f"static const int scene_damped[] SCENE_UNUSED = {{{', '.join(map(str, d.scene.damped))}}};",
        "",
        c_function("void", "scene_damping", (x.p,), "c", x.local(d.damping)),
        forward_function(
            "void scene_penetration_rate_jvp",
            (*state, x.p, *map(tangent, state)),
            "d_rate",
            rate,
            state,
        ),
        backward_function(
            "void scene_penetration_rate_vjp", (*state, x.p, rate_bar), rate, rate_bar, state
        ),
    ]


def force_sources(scene: Scene) -> dict[str, str]:
    """Return file name -> text of the hand-written laws of a scene: friction, damping."""
    names = [
        name for name, present in (("friction.h", scene.nf), ("damping.h", scene.damped)) if present
    ]
    return {name: Path(__file__).with_name(name).read_text(encoding="utf-8") for name in names}


def friction_functions(x: SceneVectors) -> list[str]:
    """Return slip speeds and limits mu N of the frictions, if there are any."""
    d = x.dynamics
    if not d.structure.friction:
        return []
    names = [friction.name for friction in d.scene.frictions]
    slip, limit = x.local(d.slip), x.local(d.friction_limit)
    slip_bar, limit_bar = Vector.of("slip_bar", names), Vector.of("limit_bar", names)
    a = x.q.like("a")
    return [
        c_function("void", "scene_slip", (x.q, x.v, x.p), "slip", slip),
        c_function("void", "scene_slip_rate", (x.q, x.v, a, x.p), "rate", slip_rate(x, a)),
        backward_function(
            "void scene_slip_vjp", (x.q, x.v, x.p, slip_bar), slip, slip_bar, [x.q, x.v]
        ),
        c_function("void", "scene_friction_limit", (x.q, x.lam, x.p), "limit", limit),
        backward_function(
            "void scene_friction_limit_vjp",
            (x.q, x.lam, x.p, limit_bar),
            limit,
            limit_bar,
            [x.q, x.lam],
        ),
    ]


def slip_rate(x: SceneVectors, a: Vector) -> sp.Matrix:
    """Return ds/dt (nf, 1) along velocities v and accelerations a [m/s^2]."""
    slip = x.local(x.dynamics.slip)
    return slip.jacobian(x.q.column) * x.v.column + slip.jacobian(x.v.column) * a.column


def emit_model(scene: Scene) -> str:
    """Return `scene_model.h` (C99, no I/O), valid for all parameter values of a scene."""
    vectors = SceneVectors.of(derive(scene))
    parts = [
        _head(scene),
        *_contact_functions(vectors),
        *damping_functions(vectors),
        *friction_functions(vectors),
        *(
            _factorised_acceleration(vectors)
            if vectors.dynamics.acceleration is None
            else _closed_acceleration(vectors)
        ),
        *_energy_functions(vectors),
    ]
    return "\n".join([*parts, "#endif", ""])


def model_source(scene: Scene) -> str:
    """Return `emit_model`, cached between processes."""
    return cached_text(scene, "scene_model.h", lambda: emit_model(scene))


def _head(scene: Scene) -> str:
    sizes = {
        "NQ": scene.nq,
        "NU": scene.nu,
        "NC": scene.nc,
        "NF": scene.nf,
        "NP": len(scene.parameters),
    }
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
        "#ifndef SCENE_INLINE",
        "#define SCENE_INLINE SCENE_FUNCTION",
        "#endif",
        "",
    ]
    if scene.nf:
        nominals = ", ".join(repr(float(friction.nominal)) for friction in scene.frictions)
        lines += [
            f"static const double scene_friction_nominals[] SCENE_UNUSED = {{{nominals}}};",
            "",
        ]
    if scene.nf or scene.damped:
        lines += [f"#define SCENE_LENGTH {scene.length!r}", ""]
    return "\n".join(lines)


def _contact_functions(x: SceneVectors) -> list[str]:
    d = x.dynamics
    phi, stiffness = x.local(d.penetration), x.local(d.stiffness)
    phi_bar = Vector.of("phi_bar", x.contacts)
    return [
        c_function("void", "scene_penetration", (x.q, x.p), "phi", phi),
        c_function("void", "scene_stiffness", (x.p,), "k", stiffness),
        forward_function(
            "void scene_penetration_jvp", (x.q, x.p, tangent(x.q)), "d_phi", phi, [x.q]
        ),
        backward_function("void scene_penetration_vjp", (x.q, x.p, phi_bar), phi, phi_bar, [x.q]),
    ]


def _energy_functions(x: SceneVectors) -> list[str]:
    d = x.dynamics
    cost = x.local(d.running_cost)
    cost_bar = Vector("cost", ("bar",), (sp.Symbol("cost_bar", real=True),))
    return [
        c_function(
            "double", "scene_kinetic_energy", (x.q, x.v, x.p), None, x.local(d.kinetic_energy)
        ),
        c_function(
            "double", "scene_potential_energy", (x.q, x.p), None, x.local(d.potential_energy)
        ),
        c_function(
            "double", "scene_input_power", (x.q, x.v, x.u, x.p), None, x.local(d.input_power)
        ),
        c_function(
            "double", "scene_dissipated_power", (x.q, x.v, x.p), None, x.local(d.dissipated_power)
        ),
        c_function("double", "scene_running_cost", (x.q, x.v, x.u, x.p), None, cost),
        backward_function(
            "void scene_running_cost_vjp",
            (x.q, x.v, x.u, x.p, cost_bar),
            cost,
            cost_bar,
            [x.q, x.v, x.u],
        ),
        *_final_cost_functions(x, cost_bar),
    ]


def _final_cost_functions(x: SceneVectors, cost_bar: Vector) -> list[str]:
    if x.dynamics.final_cost == 0:
        return []
    cost = x.local(x.dynamics.final_cost)
    return [
        "#define FINAL_COST",
        c_function("double", "scene_final_cost", (x.q, x.v, x.p), None, cost),
        backward_function(
            "void scene_final_cost_vjp", (x.q, x.v, x.p, cost_bar), cost, cost_bar, [x.q, x.v]
        ),
    ]


def _closed_acceleration(x: SceneVectors) -> list[str]:
    acceleration, a_bar, moving = (
        x.local(x.dynamics.acceleration),
        x.q.like("a_bar"),
        (x.q, x.v, x.u, x.lam),
    )
    along = (*x.arguments, *map(tangent, moving))
    return [
        c_function("int", "scene_acceleration", x.arguments, "a", acceleration, tail="return 0;"),
        forward_function(
            "int scene_acceleration_jvp", along, "d_a", acceleration, moving, tail="return 0;"
        ),
        backward_function(
            "int scene_acceleration_vjp",
            (*x.arguments, a_bar),
            acceleration,
            a_bar,
            moving,
            tail="return 0;",
        ),
    ]


# Cholesky factorisation and solve, for scenes whose mass matrix depends on q.
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
    # For fixed a, both products below use the Jacobian of the residual f - M a.
    residual = force - mass * a.column
    return [
        cholesky_function(d.mass_matrix),
        c_function("void", "scene_mass", (x.q, x.p), "M", sp.Matrix(list(mass))),
        # Inlined, as scene_solve, into the accelerations of an FMU (fmu/shell/model.h), which share
        # sines.
        c_function("void", "scene_force", x.arguments, "f", force).replace(
            "SCENE_FUNCTION", "SCENE_INLINE", 1
        ),
        forward_function(
            "void scene_force_jvp",
            (*x.arguments, a, *map(tangent, moving)),
            "d_f",
            residual,
            moving,
        ),
        backward_function("void scene_force_vjp", (*x.arguments, a, w), residual, w, moving),
        _SOLVES,
    ]


_FUNCTION = re.compile(
    r"^SCENE_(?:FUNCTION|INLINE) \w+ (\w+)\([^)]*\)\n\{\n(.*?)^\}$", re.MULTILINE | re.DOTALL
)
# Functions that a time step evaluates once.
_OF_A_STEP = (
    "scene_penetration",
    "scene_slip",
    "scene_friction_limit",
    "scene_mass",
    "scene_force",
    "scene_solve",
    "scene_acceleration",
)


# Additions and subtractions, multiplications, divisions; calls are counted separately.
_KINDS = {ast.Add: "add", ast.Sub: "add", ast.Mult: "multiply", ast.Div: "divide"}


def step_operations(scene: Scene) -> dict[str, int]:
    """Count the operations (add, multiply, divide, call) of a step: gaps, slips, accelerations.

    The contact law (two operations per contact) and the updates of v and q (four per coordinate)
    are not included.
    """
    functions = count_operations(model_source(scene))
    total = sum((functions[name] for name in _OF_A_STEP if name in functions), Counter())
    return {kind: total[kind] for kind in (*dict.fromkeys(_KINDS.values()), "call")}


def count_operations(source: str) -> dict[str, Counter[str]]:
    """Count the operations of every function of `emit_model`, by name and kind.

    Signs, arithmetic of constants, and calls within the text do not count; a power written as a
    product counts its multiplications.
    """
    return {
        name: sum(map(_of_statement, body.splitlines()), Counter())
        for name, body in _FUNCTION.findall(source)
    }


def _of_statement(line: str) -> Counter[str]:
    """Count the right side of `=` or `return`, and the operator of `+=`, `-=` and `/=`."""
    match = re.match(r"(?!if |for )(?:return |.*? ([-+/]?)= )(.*);", line.strip())
    if match is None:
        return Counter()
    own = {"": (), "+": ("add",), "-": ("add",), "/": ("divide",)}[match[1] or ""]
    return _of_expression(ast.parse(match[2], mode="eval").body)[0] + Counter(own)


def _of_expression(node: ast.expr) -> tuple[Counter[str], bool]:
    """Count an expression in the common syntax of C and Python.

    Return also whether it is a number.
    """
    match node:
        case ast.UnaryOp():
            return _of_expression(node.operand)
        case ast.BinOp():
            (left, is_left), (right, is_right) = (
                _of_expression(node.left),
                _of_expression(node.right),
            )
            own = () if is_left and is_right else (_KINDS[type(node.op)],)
            return left + right + Counter(own), is_left and is_right
        case ast.Call():
            arguments = [_of_expression(argument) for argument in node.args]
            is_number = all(is_one for _, is_one in arguments)
            is_free = is_number or ast.unparse(node.func).startswith("scene_")
            return sum(
                (inside for inside, _ in arguments), Counter(() if is_free else ("call",))
            ), is_number
        case ast.Subscript():
            return _of_expression(node.slice)[0], False
    return Counter(), isinstance(node, ast.Constant)
