"""Functions that a scene may use: those that have a form in C, and whose derivatives have one, which every plan needs."""

from __future__ import annotations

from functools import cache

import sympy as sp
from sympy.core.function import ArgumentIndexError
from sympy.printing.c import C99CodePrinter
from sympy.printing.codeprinter import PrintMethodNotImplementedError

from models.scene import Scene

# Their derivatives are jumps, which are said where they matter: of a penetration by `scene_checks`, else by code generation.
_WITH_CORNERS = (sp.Abs, sp.sign, sp.Max, sp.Min, sp.floor, sp.ceiling, sp.Mod, sp.Heaviside, sp.Piecewise)


def function_problem(scene: Scene) -> str | None:
    """`forces[x] contains gamma, whose derivative polygamma has no form in C ..`, the first of them; None: all have one."""
    fields = [("kinetic_energy", scene.kinetic_energy), ("potential_energy", scene.potential_energy)]
    fields += [(f"forces[{coordinate.name}]", force) for coordinate, force in zip(scene.coordinates, scene.forces, strict=True)]
    for contact in scene.contacts:
        parts = (("penetration", contact.penetration), ("stiffness", contact.stiffness), ("damping", contact.damping))
        fields += [(f"contact {contact.name}: {part}", expression) for part, expression in parts]
    for friction in scene.frictions:
        parts = (("slip", friction.slip), ("coefficient", friction.coefficient), ("normal_force", friction.normal_force))
        fields += [(f"friction {friction.name}: {part}", expression) for part, expression in parts if expression is not None]
    fields += [("task.running_cost", scene.task.running_cost), ("task.final_cost", scene.task.final_cost)]
    for field, expression in fields:
        for used in sorted(expression.atoms(sp.Function), key=str):
            missing = _missing(used.func, len(used.args))
            if missing is not None:
                name = str(used.func)
                what = name if missing == name else f"{name}, whose derivative contains {missing}"
                return f"{field} contains {what}, which has no form in C; use smooth elementary functions (sin, exp, sqrt, tanh ..)."
    return None


@cache
def _missing(function: type[sp.Function], count: int) -> str | None:
    """The function without a form in C in that of `count` arguments, or else in its derivatives."""
    if issubclass(function, _WITH_CORNERS):
        return None
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
