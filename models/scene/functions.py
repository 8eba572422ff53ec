"""The functions that the expressions of a scene may use: smooth ones, that have a form in C, as their derivatives have.

Plans need derivatives: Ipopt's are of the forces, and so of the second derivatives of the energies;
gradients by rollouts, the error growth and the tracking gains are those of the C kernel. A corner
has none. Of Max, Abs and Piecewise in a force the kernel makes do with one-sided slopes, but
strict_lcp, relaxed_lcp, mpcc and collocation cannot; of sign and Heaviside, or of an energy
with a corner, nothing can.
"""

from __future__ import annotations

from functools import cache
from itertools import islice

import sympy as sp
from sympy.core.function import ArgumentIndexError
from sympy.printing.c import C99CodePrinter
from sympy.printing.codeprinter import PrintMethodNotImplementedError

from models.scene.scene import Scene, named_expressions

# Functions with corners or jumps, and what to write instead; r is the radius of the rounding, a
# parameter.
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


def function_problem(scene: Scene) -> str | None:
    """`forces[x] contains gamma, whose derivative polygamma has no form in C ..`, the first of them; None: all are smooth and have one."""
    for field, expression, *_ in named_expressions(scene):
        corners = sorted(
            expression.atoms(*_WITH_CORNERS),
            key=lambda used: (type(used).__name__, shortened(used)),
        )
        if corners:
            advice = next(words for kind, words in _ROUNDED.items() if isinstance(corners[0], kind))
            mend = f"round it off: {advice}"
            if field.endswith(": penetration"):
                mend = f"give each side a contact of its own, or {mend}"
            elif field.endswith((": stiffness", ": damping", ": coefficient")):
                mend = "make it a parameter of its value"
            return f"{field} contains {shortened(corners[0])}, which is not differentiable everywhere, as plans need it; {mend}."
        for name, function, count in sorted(
            {(str(used.func), used.func, len(used.args)) for used in expression.atoms(sp.Function)},
            key=str,
        ):
            missing = _missing(function, count)
            if missing is not None:
                what = name if missing == name else f"{name}, whose derivative contains {missing}"
                return f"{field} contains {what}, which has no form in C; use smooth elementary functions (sin, exp, sqrt, tanh ..)."
    return None


def shortened(expression: sp.Basic) -> str:
    """For a sentence.

    Of thousands of terms only the symbols are told: SymPy takes minutes to write them in order.
    """
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
