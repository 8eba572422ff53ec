"""The expressions of a scene that enter its equations, and the functions they may use: smooth ones, that have a form in C, as their derivatives have.

Plans need derivatives: Ipopt's are of the forces, and so of the second derivatives of the energies; gradients by rollouts, the error growth and the
tracking gains are those of the C kernel. A corner has none. Of Max, Abs and Piecewise in a force the kernel makes do with one-sided slopes, but
strict_lcp, relaxed_lcp, mpcc, collocation and proofs cannot; of sign and Heaviside, or of an energy with a corner, nothing can.
"""

from __future__ import annotations

from functools import cache
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

import sympy as sp
from sympy.core.function import ArgumentIndexError
from sympy.printing.c import C99CodePrinter
from sympy.printing.codeprinter import PrintMethodNotImplementedError

if TYPE_CHECKING:
    from models.scene import Scene

# Functions with corners or jumps, and what to write instead; r is the radius of the rounding, a parameter.
_ROUNDED = {
    sp.Abs: "sqrt(x^2 + r^2) for Abs(x)",
    sp.Max: "(x + y + sqrt((x - y)^2 + r^2))/2 for Max(x, y)",
    sp.Min: "(x + y - sqrt((x - y)^2 + r^2))/2 for Min(x, y)",
    sp.sign: "tanh(x/r) for sign(x), or a Friction where it rubs",
    sp.Heaviside: "(1 + tanh(x/r))/2 for Heaviside(x), or a Contact where it pushes on one side",
    sp.Piecewise: "pieces weighed with (1 + tanh(x/r))/2, or a Contact where it pushes on one side",
    sp.floor: "x for floor(x)",
    sp.ceiling: "x for ceiling(x)",
    sp.Mod: "a sine of the same period for Mod(x, y)",
}
_WITH_CORNERS = tuple(_ROUNDED)
# Symbols, numbers and operations of an expression that is written out.
_MOST_PARTS = 300


class NamedExpression(NamedTuple):
    """An expression of a scene: its field, as messages name it, what it is, and its unit; None: whatever its author weighs.

    of: what it may depend on, p parameters, q positions, v velocities, u inputs.
    """

    field: str
    expression: sp.Expr
    what: str
    unit: str | None
    of: str


def named_expressions(scene: Scene) -> list[NamedExpression]:
    """All that enters the equations of motion, the contact laws and the cost."""
    found = [
        NamedExpression("kinetic_energy", scene.kinetic_energy, "an energy", "J", "pqv"),
        NamedExpression("potential_energy", scene.potential_energy, "an energy", "J", "pq"),
    ]
    for coordinate, force in zip(scene.coordinates, scene.forces, strict=True):
        above, _, below = coordinate.unit.partition("/")
        unit = {"m": "N", "rad": "N m"}.get(coordinate.unit, f"J {below.replace('/', ' ')}/{above}")
        found.append(NamedExpression(f"forces[{coordinate.name}]", force, f"the force of a coordinate in {coordinate.unit}", unit, "pqvu"))
    for contact in scene.contacts:
        where, unit = f"contact {contact.name}", contact.damping_law.unit
        found.append(NamedExpression(f"{where}: penetration", contact.penetration, "a penetration", "m", "pq"))
        found.append(NamedExpression(f"{where}: stiffness", contact.stiffness, "a stiffness", "N/m", "p"))
        found.append(NamedExpression(f"{where}: damping", contact.damping, "a damping", unit, "p"))
    for friction in scene.frictions:
        where = f"friction {friction.name}"
        found.append(NamedExpression(f"{where}: slip", friction.slip, "a slip", "m/s", "pqv"))
        found.append(NamedExpression(f"{where}: coefficient", friction.coefficient, "a coefficient of friction", "1", "p"))
        if friction.normal_force is not None:
            found.append(NamedExpression(f"{where}: normal_force", friction.normal_force, "a normal force", "N", "pq"))
    found.append(NamedExpression("task.running_cost", scene.task.running_cost, "a cost", None, "pqvu"))
    found.append(NamedExpression("task.final_cost", scene.task.final_cost, "a cost", None, "pqv"))
    return found


def depths(scene: Scene) -> list[NamedExpression]:
    """How deep each contact's model reaches, which enters no equation."""
    return [NamedExpression(f"contact {contact.name}: depth", contact.depth, "a depth", "m", "p") for contact in scene.contacts]


def function_problem(scene: Scene) -> str | None:
    """`forces[x] contains gamma, whose derivative polygamma has no form in C ..`, the first of them; None: all are smooth and have one."""
    for field, expression, *_ in named_expressions(scene):
        corners = sorted(expression.atoms(*_WITH_CORNERS), key=lambda used: (type(used).__name__, shortened(used)))
        if corners:
            advice = next(words for kind, words in _ROUNDED.items() if isinstance(corners[0], kind))
            mend = f"round it off: {advice}"
            if field.endswith(": penetration"):
                mend = f"give each side a contact of its own, or {mend}"
            elif field.endswith((": stiffness", ": damping", ": coefficient")):
                mend = "make it a parameter of its value"
            return f"{field} contains {shortened(corners[0])}, which is not differentiable everywhere, as plans need it; {mend}."
        for name, function, count in sorted(
            {(str(used.func), used.func, len(used.args)) for used in expression.atoms(sp.Function)}, key=str
        ):
            missing = _missing(function, count)
            if missing is not None:
                what = name if missing == name else f"{name}, whose derivative contains {missing}"
                return f"{field} contains {what}, which has no form in C; use smooth elementary functions (sin, exp, sqrt, tanh ..)."
    return None


def shortened(expression: sp.Basic) -> str:
    """For a sentence. Of thousands of terms only the symbols are told: SymPy takes minutes to write them in order."""
    if is_longer(expression, _MOST_PARTS):
        return f"a long expression in {', '.join(sorted(str(symbol) for symbol in expression.free_symbols))}"
    text = str(expression)
    return text if len(text) <= 60 else f"{text[:57]}..."


def is_longer(expression: sp.Basic, parts: int) -> bool:
    """Whether an expression has more symbols, numbers and operations than that."""
    return sum(1 for _ in islice(sp.preorder_traversal(expression), parts + 1)) > parts


@cache
def _missing(function: type[sp.Function], count: int) -> str | None:
    """The function without a form in C in that of `count` arguments, or else in its derivatives."""
    arguments = [sp.Dummy(f"x{index}", real=True) for index in range(count)]
    value = function(*arguments)
    try:
        C99CodePrinter().doprint(value)
        for argument in arguments:
            C99CodePrinter().doprint(value.diff(argument))
    except PrintMethodNotImplementedError as error:
        return str(error).splitlines()[0].rpartition(": ")[2]
    except ArgumentIndexError:  # no derivative by that argument, which may well be a constant
        return None
    return None
