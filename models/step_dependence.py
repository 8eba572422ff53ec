"""A parameter of a scene file must not be made of the task's step: the step is a choice of whoever plans, the physics is not.

    STEP, DAMPING = 0.02, 10.0
    .. Parameter(symbol=m, value=STEP * DAMPING, unit="kg") .. Task(step=STEP, ..)        # refused
    STEP = 0.1 * math.sqrt(MASS / STIFFNESS)                                              # fine: the step follows the physics
    STEP = HORIZON / STEPS  ..  value=LENGTH / HORIZON                                    # fine: the duration is what the task asks

Read off the file's text, by names: those that hold the step, and all that is computed of them. Values are not compared: m = 0.02 kg beside a damping of
2 N s/m and a step of 0.01 s is honest chance. So what names no step is not found: a product written out as a number, or computed in another module.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

_DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def step_problem(path: Path, source: str, quasi_static: bool) -> str | None:
    """The first parameter that is made of the step, and what to do; None: there is none."""
    tree = ast.parse(source, str(path))
    steps = {value.id for value in _arguments(tree, "Task", "step") if isinstance(value, ast.Name)}
    bindings = list(_bindings(tree))
    for _ in bindings:  # STEP = H: then H is the step, too
        steps |= {value.id for names, value in bindings if isinstance(value, ast.Name) and set(names) & steps}
    made = set(steps)
    for _ in bindings:
        more = {name for names, value in bindings if _names(value) & made for name in names}
        if more <= made:
            break
        made |= more
    for value in _arguments(tree, "Parameter", "value"):
        used = sorted(_names(value) & made)
        if used:
            held = ", ".join(sorted(steps))
            mend = "give it a value of its own" if quasi_static else (
                "give it a value of its own or, where motion is meant without inertia, declare relaxation_time and make the mass relaxation_time * damping "
                "(docs/extending.md)"
            )
            return f"line {value.lineno}: a parameter has the value {ast.unparse(value)}, which is made of the task's step ({held}); {mend}."
    return None


def _arguments(tree: ast.AST, name: str, keyword: str) -> Iterator[ast.expr]:
    """Values of a keyword in all calls of `name`, or of an attribute of that name."""
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and (getattr(call.func, "id", None) == name or getattr(call.func, "attr", None) == name):
            yield from (item.value for item in call.keywords if item.arg == keyword)


def _bindings(tree: ast.AST) -> Iterator[tuple[list[str], ast.AST]]:
    """Names, and what is bound to them, entry by entry where both sides are tuples; of a function its whole body."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                yield from _bound(target, node.value)
        elif isinstance(node, (ast.AnnAssign, ast.AugAssign, ast.NamedExpr)) and node.value is not None:
            yield from _bound(node.target, node.value)
        elif isinstance(node, (ast.For, ast.comprehension)):
            yield from _bound(node.target, node.iter)
        elif isinstance(node, _DEFINITIONS):
            yield [node.name], node


def _bound(target: ast.expr, value: ast.expr) -> Iterator[tuple[list[str], ast.AST]]:
    if isinstance(target, (ast.Tuple, ast.List)) and isinstance(value, (ast.Tuple, ast.List)) and len(target.elts) == len(value.elts):
        if not any(isinstance(entry, ast.Starred) for entry in (*target.elts, *value.elts)):
            for one, its in zip(target.elts, value.elts, strict=True):
                yield from _bound(one, its)
            return
    yield [name.id for name in ast.walk(target) if isinstance(name, ast.Name)], value


def _names(value: ast.AST) -> set[str]:
    return {node.id for node in ast.walk(value) if isinstance(node, ast.Name)}
