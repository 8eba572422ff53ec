"""How much arithmetic a scene's equations cost: operations counted in the C that is generated for it, function by function.

    count_operations(emit_model(scene))["scene_acceleration"]
    # Operations(add=6, multiply=6, divide=1, call=0)

A sign is not counted (it becomes a subtraction or goes into a constant), nor is arithmetic among numbers, which the compiler does. A power written
as a product counts its multiplications.
"""

from __future__ import annotations

import re
from dataclasses import astuple, dataclass

from models.codegen.emit import model_source
from models.scene import Scene

_FUNCTION = re.compile(r"^SCENE_(?:FUNCTION|INLINE) \w+ (\w+)\([^)]*\)\n\{\n(.*?)^\}$", re.MULTILINE | re.DOTALL)
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)(?P<call>\s*\()?|(?P<sign>[-+*/()\[\],]))"
)
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
    if text.startswith("if "):
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
    return own + _Expression(text).operations


class _Expression:
    """Recursive descent over one C expression of numbers, names, subscripts, calls, parentheses and + - * /."""

    def __init__(self, text: str) -> None:
        self._tokens = list(_TOKEN.finditer(text))
        self._place = 0
        self.operations = Operations()
        self._sum()

    def _peek(self) -> str:
        return (self._tokens[self._place]["sign"] or "") if self._place < len(self._tokens) else ""

    def _sum(self) -> bool:
        """Whether it is a number, as of all three levels."""
        constant = self._product()
        while self._peek() in ("+", "-"):
            self._place += 1
            constant = self._count(constant, self._product(), Operations(add=1))
        return constant

    def _product(self) -> bool:
        constant = self._atom()
        while self._peek() in ("*", "/"):
            operation = Operations(multiply=1) if self._peek() == "*" else Operations(divide=1)
            self._place += 1
            constant = self._count(constant, self._atom(), operation)
        return constant

    def _count(self, left: bool, right: bool, operation: Operations) -> bool:
        if left and right:
            return True
        self.operations += operation
        return False

    def _atom(self) -> bool:
        token = self._tokens[self._place]
        self._place += 1
        if token["sign"] in ("-", "+"):
            return self._atom()
        if token["sign"] == "(":
            return self._inside()
        if token["number"]:
            return True
        if token["call"]:
            constant = self._inside()
            ours = token["name"].startswith("scene_")
            self.operations += Operations() if constant or ours else Operations(call=1)
            return constant
        while self._peek() == "[":
            self._place += 1
            self._inside()
        return False

    def _inside(self) -> bool:
        """Up to and with the closing bracket; several arguments are all looked at."""
        constant = self._sum()
        while self._peek() == ",":
            self._place += 1
            constant = self._sum() and constant
        self._place += 1
        return constant
