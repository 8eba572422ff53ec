"""Check by computer algebra that the physics of a scene is possible.

These checks run when a scene is loaded, and before anything is derived from the scene. Checks
without computer algebra run when a scene is created (models.scene.scene).

`step_problem` checks the scene's file: no parameter may be computed from the task's step. The step
is the planner's choice, the physics is not.

    STEP, DAMPING = 0.02, 10.0
    .. Parameter(symbol=m, value=STEP * DAMPING, unit="kg") .. Task(step=STEP, ..)        # refused
    STEP = 0.1 * math.sqrt(MASS / STIFFNESS)  # fine: the step follows the physics
    STEP = HORIZON / STEPS  ..  value=LENGTH / HORIZON  # fine: the duration belongs to the task

The check reads the file's text: the names that hold the step, and the values computed from them.
Values are not compared: m = 0.02 kg beside a damping of 2 N s/m and a step of 0.01 s may be chance.
So a product written as a number, or computed in another module, is not found.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from weakref import WeakSet

import sympy as sp

from models.errors import SceneError
from models.scene import Scene
from models.scene.dimensions import dimension_problem
from models.scene.functions import function_problem

_PASSED: WeakSet[Scene] = WeakSet()


def check_expressions(scene: Scene) -> None:
    """Run the checks that need computer algebra, once for each scene object.

    They take up to a third of a second. Raises SceneError.
    """
    if scene in _PASSED:
        return
    problem = function_problem(scene)
    if problem is not None:
        raise _fail(scene, problem)
    _check_finite(scene)
    _check_mass(scene)
    _check_contacts(scene)
    _check_frictions(scene)
    problem = dimension_problem(scene)
    if problem is not None:
        raise _fail(scene, problem)
    _PASSED.add(scene)


def _fail(scene: Scene, text: str) -> SceneError:
    return SceneError(f"scene {scene.name}: {text}")


def _rounded(value: sp.Expr) -> str:
    return f"{float(value):.4g}" if value.is_number and value.is_real else str(value)


def _start(scene: Scene) -> dict[sp.Symbol, sp.Float]:
    values = dict(scene.parameter_values)
    for index, coordinate in enumerate(scene.coordinates):
        values[coordinate.symbol] = scene.task.start[index]
        values[coordinate.velocity] = scene.task.start[scene.nq + index]
    return {symbol: sp.Float(value) for symbol, value in values.items()}


def _check_finite(scene: Scene) -> None:
    """Check energy, forces and running cost at the start.

    Each input is zero, or the bound nearest to zero.
    """
    start, inputs = (
        _start(scene),
        {item.symbol: sp.Float(min(max(0.0, item.lower), item.upper)) for item in scene.inputs},
    )
    fields = [
        ("potential_energy", scene.potential_energy),
        ("task.running_cost", scene.task.running_cost),
    ]
    fields += [
        (f"forces[{coordinate.name}]", force)
        for coordinate, force in zip(scene.coordinates, scene.forces, strict=True)
    ]
    for field, expression in fields:
        value = expression.xreplace(start).xreplace(inputs)  # the state first: 0 u / 0 is no 0
        if value.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I):
            raise _fail(
                scene,
                f"{field} is {value} at the start (inputs at zero), but must be a finite real number there.",
            )


def _check_mass(scene: Scene) -> None:
    velocities = [coordinate.velocity for coordinate in scene.coordinates]
    mass = sp.hessian(scene.kinetic_energy, velocities)
    if any(entry.free_symbols & set(velocities) for entry in mass):
        raise _fail(
            scene,
            "kinetic_energy is not quadratic in the velocities, so there is no mass matrix M(q).",
        )
    rest = sp.expand(
        scene.kinetic_energy - (sp.Matrix([velocities]) * mass * sp.Matrix(velocities))[0] / 2
    )
    if rest != 0 and sp.simplify(rest) != 0:
        raise _fail(
            scene, f"kinetic_energy contains {rest}, which is not quadratic in the velocities."
        )
    numeric = mass.xreplace(_start(scene))
    for size in range(1, scene.nq + 1):
        minor = numeric[:size, :size].det()
        if not (minor.is_number and minor.is_real and float(minor) > 0):
            culprit = scene.coordinates[size - 1].name
            raise _fail(
                scene,
                f"the mass matrix is not positive definite at the start (leading minor {size}, at {culprit}, is {_rounded(minor)}); check the masses.",
            )


def _check_contacts(scene: Scene) -> None:
    start = _start(scene)
    for contact in scene.contacts:
        stiffness = contact.stiffness.xreplace(start).evalf()
        if not (stiffness.is_real and float(stiffness) > 0):
            raise _fail(
                scene,
                f"contact {contact.name}: the stiffness is {stiffness}, but must be positive.",
            )
        damping = contact.damping.xreplace(start).evalf()
        if not (damping.is_real and float(damping) >= 0):
            unit = contact.damping_law.unit
            raise _fail(
                scene,
                f"contact {contact.name}: the damping is {damping} {unit}, but must not be negative; 0 is a contact without damping.",
            )
        gradient = [
            sp.diff(contact.penetration, coordinate.symbol).xreplace(start).evalf()
            for coordinate in scene.coordinates
        ]
        if not all(entry.is_number and entry.is_real and entry.is_finite for entry in gradient):
            raise _fail(
                scene,
                f"contact {contact.name}: the penetration is not differentiable at the start; its gradient there is {gradient}.",
            )
        if not contact.penetration.free_symbols & {
            coordinate.symbol for coordinate in scene.coordinates
        }:
            raise _fail(
                scene,
                f"contact {contact.name}: the penetration depends on no coordinate, so the contact has no direction.",
            )


def _check_frictions(scene: Scene) -> None:
    start = _start(scene)
    velocities = [coordinate.velocity for coordinate in scene.coordinates]
    contacts = [contact.name for contact in scene.contacts]
    for friction in scene.frictions:
        where = f"friction {friction.name}"
        unknown = next((name for name in friction.pressing if name not in contacts), None)
        if unknown is not None:
            known = f"its contacts are {', '.join(contacts)}" if contacts else "it has no contacts"
            raise _fail(
                scene,
                f"{where}: there is no contact {unknown!r} to press the surfaces together; {known}.",
            )
        slope = [sp.diff(friction.slip, velocity) for velocity in velocities]
        at_rest = friction.slip.subs(dict.fromkeys(velocities, 0))
        if any(entry.free_symbols & set(velocities) for entry in slope) or (
            at_rest != 0 and sp.simplify(at_rest) != 0
        ):
            raise _fail(
                scene,
                f"{where}: the slip {friction.slip} is not linear in the velocities, so there is no direction of friction.",
            )
        if all(entry == 0 for entry in slope):
            raise _fail(
                scene,
                f"{where}: the slip depends on no velocity, so the friction has no direction.",
            )
        for field in ("coefficient", "normal_force"):
            value = getattr(friction, field)
            number = None if value is None else value.xreplace(start).evalf()
            if number is not None and not (number.is_real and float(number) >= 0):
                raise _fail(
                    scene,
                    f"{where}: the {field} is {number} at the start, but must not be negative.",
                )


_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
_SCOPES = (*_FUNCTIONS, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


def step_problem(source: str | bytes) -> tuple[int, str] | None:
    """Return line and advice for the first parameter that is computed from the step, or None."""
    found = _Reading()
    try:
        found.read(ast.parse(source), ())
        return _first(found)
    except RecursionError:  # thousands of operations, generated by a program without names
        return None


def _first(found: _Reading) -> tuple[int, str] | None:
    steps = {
        _key(value, scopes) for value, scopes in found.steps if not isinstance(value, ast.Constant)
    }
    changed = bool(steps)
    while changed:  # STEP = H: H is the step too
        also = {
            _key(value, scopes)
            for names, value, scopes in found.bindings
            if names & steps and isinstance(value, ast.Name)
        }
        changed = not also <= steps
        steps |= also
    made, changed = set(steps), bool(steps)
    parts = (
        [(names, _keys(value, scopes)) for names, value, scopes in found.bindings] if steps else []
    )
    while changed:
        also = {name for names, keys in parts if keys & made for name in names}
        changed = not also <= made
        made |= also
    for symbol, value, scopes in found.values if steps else ():
        if _keys(value, scopes) & made:
            return value.lineno, (
                f"the value of parameter {symbol}, {ast.unparse(value)}, is made of the task's step, which physics does not know; give it a value of its "
                "own or, where motion is meant without inertia, declare a relaxation_time and make the mass relaxation_time * damping (docs/extending.md)."
            )
    return None


# Functions and comprehensions around a node, the outermost first, each with its local names.
_Scopes = tuple[tuple[ast.AST, frozenset[str]], ...]


class _Reading:
    """Steps, values of parameters and bound names in a file, each with the scopes around it.

    A value has the symbol of its parameter, a name the value bound to it.
    """

    def __init__(self) -> None:
        self.steps: list[tuple[ast.expr, _Scopes]] = []
        self.values: list[tuple[str, ast.expr, _Scopes]] = []
        self.bindings: list[tuple[frozenset[str], ast.AST, _Scopes]] = []

    def read(self, node: ast.AST, scopes: _Scopes) -> None:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            self.bindings.append((frozenset({_name(node.name, scopes)}), node, scopes))
        if isinstance(node, _SCOPES):
            scopes = (*scopes, (node, _own(node)))
        if isinstance(node, ast.Assign):
            for target in node.targets:
                self._bind(target, node.value, scopes)
        elif (
            isinstance(node, (ast.AnnAssign, ast.AugAssign, ast.NamedExpr))
            and node.value is not None
        ):
            self._bind(node.target, node.value, scopes)
        elif isinstance(node, (ast.For, ast.comprehension)):
            self._bind(node.target, node.iter, scopes)
        elif isinstance(node, ast.Call):
            called = getattr(node.func, "id", None) or getattr(node.func, "attr", None)
            given = [(item.arg, item.value) for item in node.keywords]
            self.steps += [
                (value, scopes)
                for name, value in given
                if called in ("Task", "with_task") and name == "step"
            ]
            if called == "Parameter":
                symbol = next((ast.unparse(value) for name, value in given if name == "symbol"), "")
                self.values += [(symbol, value, scopes) for name, value in given if name == "value"]
            elif called == "with_parameters":
                self.values += [(name or "", value, scopes) for name, value in given]
        for child in ast.iter_child_nodes(node):
            self.read(child, scopes)

    def _bind(self, target: ast.expr, value: ast.expr, scopes: _Scopes) -> None:
        """Bind entry by entry if both sides are written as tuples."""
        sides = [
            side.elts if isinstance(side, (ast.Tuple, ast.List)) else [] for side in (target, value)
        ]
        if len(sides[0]) == len(sides[1]) > 0 and not any(
            isinstance(entry, ast.Starred) for side in sides for entry in side
        ):
            for one, its in zip(*sides, strict=True):
                self._bind(one, its, scopes)
        else:
            self.bindings.append(
                (frozenset(_name(name, scopes) for name in _stored(target)), value, scopes)
            )


def _stored(node: ast.AST) -> Iterator[str]:
    return (
        name.id
        for name in ast.walk(node)
        if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)
    )


def _own(scope: ast.AST) -> frozenset[str]:
    """Return the local names of a function or comprehension: arguments and assigned names."""
    arguments = (
        {argument.arg for argument in ast.walk(scope.args) if isinstance(argument, ast.arg)}
        if isinstance(scope, _FUNCTIONS)
        else set()
    )
    return frozenset(arguments | set(_stored(scope)))


def _name(name: str, scopes: _Scopes) -> str:
    """Return a name that differs from equal names of other scopes."""
    owner = next((scope for scope, own in reversed(scopes) if name in own), None)
    return name if owner is None else f"{name} of {id(owner)}"


def _key(value: ast.AST, scopes: _Scopes) -> str:
    """Return the key of an expression: a name in its scope, else the text."""
    return _name(value.id, scopes) if isinstance(value, ast.Name) else ast.unparse(value)


def _keys(value: ast.AST, scopes: _Scopes) -> set[str]:
    """Return the keys of all expressions within a value, or in the body of a function."""
    if isinstance(value, _SCOPES):
        scopes = (*scopes, (value, _own(value)))
    found = (
        {_key(value, scopes)} if isinstance(value, (ast.Name, ast.Attribute, ast.BinOp)) else set()
    )
    return found.union(*(_keys(child, scopes) for child in ast.iter_child_nodes(value)))
