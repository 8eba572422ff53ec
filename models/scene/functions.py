"""The functions that the expressions of a scene may use.

    function_problem(scene)   # "forces[x] contains gamma(x), which a scene cannot use; .."

Plans need derivatives. Ipopt uses those of the forces, and so the second derivatives of the
energies. Rollout gradients, error growth and tracking gains use those of the C kernel. A corner has
no derivative. The kernel uses one-sided slopes of Max, Abs and Piecewise in a force, but
strict_lcp, relaxed_lcp, mpcc and collocation cannot. No method can use sign, Heaviside, or an
energy with a corner.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice

import sympy as sp
from sympy.core.function import ArgumentIndexError

from models.scene.scene import Scene, named_expressions

# Smooth functions of C99, NumPy and PyTorch. Their derivatives consist of these functions too.
FUNCTIONS = (
    *(sp.sin, sp.cos, sp.tan, sp.asin, sp.acos, sp.atan, sp.atan2),
    *(sp.sinh, sp.cosh, sp.tanh, sp.asinh, sp.acosh, sp.atanh),
    *(sp.exp, sp.log),
)
_OPERATIONS = (sp.Symbol, sp.Number, sp.NumberSymbol, sp.Add, sp.Mul, sp.Pow)

# Functions with corners or jumps, and their replacements; r is the radius of the rounding, a
# parameter.
ROUNDED = {
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
_WITH_CORNERS = tuple(ROUNDED)
# Highest order of derivatives in a model: Ipopt's, of the forces of an energy.
_DERIVATIVES = 3
# Largest number of symbols, numbers and operations of an expression in a message.
_MOST_PARTS = 300


def function_problem(scene: Scene) -> str | None:
    """Return a sentence on the first part that a scene cannot use; None if there is none."""
    for field, expression, *_ in named_expressions(scene):
        corners = sorted(
            expression.atoms(*_WITH_CORNERS),
            key=lambda used: (type(used).__name__, shortened(used)),
        )
        if corners:
            advice = next(words for kind, words in ROUNDED.items() if isinstance(corners[0], kind))
            mend = f"round it off: {advice}"
            if field.endswith(": penetration"):
                mend = f"give each side a contact of its own, or {mend}"
            elif field.endswith((": stiffness", ": damping", ": coefficient")):
                mend = "make it a parameter of its value"
            return f"{field} contains {shortened(corners[0])}, which is not differentiable everywhere, as plans need it; {mend}."
        for number in sorted(expression.atoms(sp.Number), key=str):
            if number != 0 and float(abs(number)) in (0.0, math.inf):
                return f"{field} contains {sp.N(number, 3)}, which no double holds; use numbers from 1e-300 to 1e300."
        unusable = sorted(_unusable(expression, _DERIVATIVES), key=lambda text: (len(text), text))
        if unusable:
            names = ", ".join(function.__name__ for function in FUNCTIONS)
            return f"{field} contains {unusable[0]}, which a scene cannot use; write it with + - * / **, sqrt, {names}."
    return None


def shortened(expression: sp.Basic) -> str:
    """Return the text of an expression for a sentence.

    The text for thousands of terms has only their symbols: SymPy takes minutes to order the terms.
    """
    if is_longer(expression, _MOST_PARTS):
        return f"a long expression in {', '.join(sorted(str(symbol) for symbol in expression.free_symbols))}"
    text = str(expression)
    return text if len(text) <= 60 else f"{text[:57]}..."


def is_longer(expression: sp.Basic, parts: int) -> bool:
    """Return whether an expression has more symbols, numbers and operations than `parts`."""
    return sum(1 for _ in islice(sp.preorder_traversal(expression), parts + 1)) > parts


def _unusable(expression: sp.Expr, derivatives: int) -> Iterator[str]:
    """Yield parts, of the expression and its derivatives up to an order, that C cannot express.

    A function of the scene's author is usable if its class has `_ccode` and `fdiff`.
    """
    for part in sp.preorder_traversal(expression):
        if isinstance(part, _OPERATIONS) or part.func in FUNCTIONS:
            continue
        if not hasattr(part, "_ccode"):
            yield shortened(part)
        elif derivatives:
            plain = [sp.Dummy(f"x{index}", real=True) for index in range(len(part.args))]
            for argument in plain:
                with suppress(ArgumentIndexError):  # constant in this argument
                    slope = part.func(*plain).diff(argument)
                    names = dict(zip(plain, part.args, strict=True))
                    yield from _unusable(slope.xreplace(names), derivatives - 1)
