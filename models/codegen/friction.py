"""What a scene with friction adds to the generated C: slips, their rates, and the limits mu N of the forces."""

from __future__ import annotations

from pathlib import Path

import sympy as sp

from models.codegen.c_function import Vector, c_function
from models.codegen.chain_rule import backward_function
from models.codegen.vectors import SceneVectors


def friction_source() -> str:
    """Text of `friction.h`, the hand-written friction within a time step: of scenes with friction."""
    return Path(__file__).with_name("friction.h").read_text(encoding="utf-8")


def friction_functions(x: SceneVectors) -> list[str]:
    """Slip speeds and the limits mu N of the friction forces; nothing for a scene without friction."""
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
        backward_function("void scene_slip_vjp", (x.q, x.v, x.p, slip_bar), slip, slip_bar, [x.q, x.v]),
        c_function("void", "scene_friction_limit", (x.q, x.lam, x.p), "limit", limit),
        backward_function("void scene_friction_limit_vjp", (x.q, x.lam, x.p, limit_bar), limit, limit_bar, [x.q, x.lam]),
    ]


def slip_rate(x: SceneVectors, a: Vector) -> sp.Matrix:
    """ds/dt (nf, 1) along the velocities v and the accelerations a [m/s^2]."""
    slip = x.local(x.dynamics.slip)
    return slip.jacobian(x.q.column) * x.v.column + slip.jacobian(x.v.column) * a.column
