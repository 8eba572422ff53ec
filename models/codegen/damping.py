"""What a scene with damped contacts adds to the generated C: their coefficients and laws, and how the rates of penetration change.

Hand-written C has it between `#ifdef DAMPING` and `#else` or `#endif`, or in one line as `DAMPED(statement;)`. `for_scene` leaves that out of the sources of a scene that has none, so that they are
the same, byte for byte, as if there were no damping at all.
"""

from __future__ import annotations

from pathlib import Path

import sympy as sp

from models.codegen.c_function import Vector, c_function
from models.codegen.chain_rule import backward_function, forward_function, tangent
from models.codegen.vectors import SceneVectors
from models.scene import Scene

_OPEN, _OPEN_WITHOUT, _ELSE, _CLOSE, _LINE = "#ifdef DAMPING", "#ifndef DAMPING", "#else", "#endif", "DAMPED("


def damping_source() -> str:
    """Text of `damping.h`, the hand-written law of a damped contact: of scenes with one."""
    return Path(__file__).with_name("damping.h").read_text(encoding="utf-8")


def for_scene(scene: Scene, text: str) -> str:
    """A hand-written C source as this scene needs it: whole, or without what is for damped contacts only."""
    if scene.damped or not ("DAMPING" in text or _LINE in text):
        return text
    kept: list[str] = []
    depth, taken = 0, True  # depth within the section that is being taken apart
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
            if (
                taken and not words.startswith(_LINE) and (words or not kept or kept[-1].strip())
            ):  # what is left out leaves no empty line behind
                kept.append(line)
    return "".join(kept)


def penetration_rate(x: SceneVectors) -> sp.Matrix:
    """d phi / dt (nc, 1) along the velocities v [m/s]."""
    return -x.local(x.dynamics.gap_jacobian) * x.v.column


def damping_functions(x: SceneVectors) -> list[str]:
    """Laws, coefficients, and derivatives of the rates of penetration; nothing for a scene without a damped contact."""
    d = x.dynamics
    if not d.structure.contact_damping:
        return []
    laws = ", ".join(str(contact.damping_law.value if contact.is_damped else 0) for contact in d.scene.contacts)
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
        forward_function("void scene_penetration_rate_jvp", (*state, x.p, *map(tangent, state)), "d_rate", rate, state),
        backward_function("void scene_penetration_rate_vjp", (*state, x.p, rate_bar), rate, rate_bar, state),
    ]
