"""How much arithmetic a scene's equations cost: operations counted in the C that is generated for it, function by function.

    count_operations(emit_model(scene))["scene_acceleration"]
    # Operations(add=6, multiply=6, divide=1, call=0)

A sign is not counted (it becomes a subtraction or goes into a constant), nor is arithmetic among numbers, which the compiler does. A power written
as a product counts its multiplications.
"""

from __future__ import annotations

import ast
import re
from dataclasses import astuple, dataclass

from models.codegen.emit import model_source
from models.scene import Scene

_FUNCTION = re.compile(r"^SCENE_(?:FUNCTION|INLINE) \w+ (\w+)\([^)]*\)\n\{\n(.*?)^\}$", re.MULTILINE | re.DOTALL)
# What a time step evaluates once, before the contact law and the two updates.
_OF_A_STEP = ("scene_penetration", "scene_slip", "scene_friction_limit", "scene_mass", "scene_force", "scene_solve", "scene_acceleration")


@dataclass(frozen=True)
class Operations:
    """Additions and subtractions, multiplications, divisions, and calls (square roots, sines ..)."""

    add: int = 0
    multiply: int = 0
    divide: int = 0
    call: int = 0

    def __add__(self, other: Operations) -> Operations:
        return Operations(*(mine + its for mine, its in zip(astuple(self), astuple(other), strict=True)))

    @property
    def total(self) -> int:
        """The operations of all kinds."""
        return sum(astuple(self))


_KINDS: dict[type[ast.operator], Operations] = {
    ast.Add: Operations(add=1),
    ast.Sub: Operations(add=1),
    ast.Mult: Operations(multiply=1),
    ast.Div: Operations(divide=1),
}


def step_operations(scene: Scene) -> Operations:
    """Operations of the equations that one time step of the scene evaluates: gaps, slips, and accelerations under given forces.

    The contact law (two operations a contact) and the updates of v and q (four a coordinate) are the same for every scene, and not in it.
    """
    found = count_operations(model_source(scene))
    return sum((found.get(name, Operations()) for name in _OF_A_STEP), Operations())


def count_operations(source: str) -> dict[str, Operations]:
    """The operations of every function of `emit_model`'s text, by its name; calls of functions of this text are left out."""
    return {name: sum((_of_statement(line) for line in body.splitlines()), Operations()) for name, body in _FUNCTION.findall(source)}


def _of_statement(line: str) -> Operations:
    """Of what stands right of `=` or `return`, and of `+=`, `-=` and `/=`; declarations, casts to void and braces have none."""
    text = line.strip().removesuffix(";")
    if text.startswith(("if ", "for ")):
        return Operations()
    if text.startswith("return "):
        own, text = Operations(), text.removeprefix("return ")
    elif " += " in text or " -= " in text:
        own, text = Operations(add=1), text.partition("= ")[2]
    elif " /= " in text:
        own, text = Operations(divide=1), text.partition("= ")[2]
    elif " = " in text:
        own, text = Operations(), text.partition(" = ")[2]
    else:
        return Operations()
    return own + _of_expression(ast.parse(text, mode="eval").body)[0]


def _of_expression(node: ast.expr) -> tuple[Operations, bool]:
    """Of numbers, names, subscripts, calls and + - * /, which C writes as Python does; and whether it is a number."""
    match node:
        case ast.UnaryOp():
            return _of_expression(node.operand)
        case ast.BinOp():
            (left, is_left), (right, is_right) = _of_expression(node.left), _of_expression(node.right)
            own = Operations() if is_left and is_right else _KINDS[type(node.op)]
            return left + right + own, is_left and is_right
        case ast.Call():
            found = [_of_expression(argument) for argument in node.args]
            is_number = all(is_one for _, is_one in found)
            ours = is_number or ast.unparse(node.func).startswith("scene_")
            return sum((inside for inside, _ in found), Operations() if ours else Operations(call=1)), is_number
        case ast.Subscript():
            return _of_expression(node.slice)[0], False
    return Operations(), isinstance(node, ast.Constant)
