"""What is checked of a Scene: names, symbols and lengths when it is created; that its physics is possible when it is loaded, and before anything is
derived from it."""

from __future__ import annotations

import keyword
from collections import Counter
from collections.abc import Iterable
from weakref import WeakSet

import sympy as sp

from models.errors import SceneError
from models.scene import Scene
from models.scene.dimensions import dimension_problem
from models.scene.functions import function_problem
from models.scene.values import check_text

# Words of C, Python and of our own generated code that may not name a quantity.
_RESERVED = frozenset(keyword.kwlist) | {
    *(
        "t",
        "time",
        "h",
        "bar",
        "auto",
        "case",
        "char",
        "const",
        "default",
        "do",
        "double",
        "enum",
        "extern",
        "float",
        "goto",
        "inline",
        "int",
    ),
    *("long", "register", "restrict", "short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void"),
    "volatile",
}
# Numbers in a plan: 8 GB.
_MOST_NUMBERS = 10**9
_PASSED: WeakSet[Scene] = WeakSet()


def check_scene(scene: Scene) -> None:
    """What needs no computer algebra. Raises SceneError with one sentence naming the scene and the field."""
    _check_names(scene)
    _check_words(scene)
    _check_lengths(scene)
    _check_steps(scene)
    _check_symbols(scene)
    _check_bodies(scene)
    _check_limits(scene)


def check_expressions(scene: Scene) -> None:
    """What takes computer algebra, up to a third of a second of it, once for each scene object. Raises SceneError."""
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


def _check_names(scene: Scene) -> None:
    if not isinstance(scene.name, str) or not scene.name.isidentifier():
        raise SceneError(f"scene: the name {scene.name!r} is not an identifier; use letters, digits and _ (it must equal the file name).")
    if not scene.coordinates:
        raise _fail(scene, "it has no coordinates; a scene needs at least one.")
    for kind, items in (("contacts", scene.contacts), ("frictions", scene.frictions)):
        for name, count in Counter(item.name for item in items).items():
            if count > 1:
                raise _fail(scene, f"{count} {kind} are named {name!r}; each needs a name of its own.")
    names = [coordinate.name for coordinate in scene.coordinates] + [coordinate.velocity_name for coordinate in scene.coordinates]
    names += [item.name for item in scene.inputs] + [parameter.name for parameter in scene.parameters]
    names += [name for contact in scene.contacts for name in (contact.force_name, contact.gap_name)]
    names += [contact.pressing_name for contact in scene.contacts if contact.is_damped]
    names += [name for friction in scene.frictions for name in (friction.force_name, friction.slip_name)]
    for name, count in Counter(names).items():
        if count > 1:
            raise _fail(
                scene,
                f"the name {name!r} is used {count} times; coordinates, velocities, inputs, parameters, contacts and frictions need names of their own.",
            )
        if name in _RESERVED:
            raise _fail(scene, f"the name {name!r} is reserved; choose another.")


def _check_words(scene: Scene) -> None:
    for field in ("title", "source"):
        check_text(f"scene {scene.name}: {field}", getattr(scene, field))
    check_text(f"scene {scene.name}: unstable", scene.unstable, empty=True)
    if scene.length <= 0:
        raise _fail(scene, f"length (in m, what relaxed contact is measured in) must be positive, not {scene.length:g}.")
    if not isinstance(scene.quick, bool):
        raise _fail(scene, f"quick says whether a quick campaign runs the scene: True or False, not {scene.quick!r}.")


def _check_lengths(scene: Scene) -> None:
    if len(scene.forces) != scene.nq:
        raise _fail(
            scene, f"forces has {len(scene.forces)} entries, but there are {scene.nq} coordinates; give one generalised force each."
        )
    for field in ("start", "goal"):
        length = len(getattr(scene.task, field))
        if length != 2 * scene.nq:
            raise _fail(
                scene,
                f"task.{field} has {length} numbers, but {2 * scene.nq} are needed: {scene.nq} positions, then {scene.nq} velocities.",
            )
    for coordinate, velocity in zip(scene.coordinates, scene.task.start[scene.nq :], strict=True):
        if not coordinate.velocity_lower <= velocity <= coordinate.velocity_upper:
            raise _fail(
                scene,
                f"task.start has {coordinate.velocity_name} = {velocity:g}, outside its bounds "
                f"[{coordinate.velocity_lower:g}, {coordinate.velocity_upper:g}].",
            )


def _check_steps(scene: Scene) -> None:
    """A plan alone must fit into memory; methods need hundreds of times as much."""
    each = 1 + 2 * scene.nq + scene.nu + scene.nl
    if scene.task.steps * each > _MOST_NUMBERS:
        raise _fail(
            scene,
            f"task.steps is {scene.task.steps}: a plan would hold {scene.task.steps * each:.3g} numbers of 8 bytes, more than a machine's memory; "
            f"{each} a step allow {_MOST_NUMBERS // each} steps at most.",
        )


def _check_symbols(scene: Scene) -> None:
    parameters = {parameter.symbol for parameter in scene.parameters}
    positions = {coordinate.symbol for coordinate in scene.coordinates}
    velocities = {coordinate.velocity for coordinate in scene.coordinates}
    inputs = {item.symbol for item in scene.inputs}

    def check(field: str, expression: sp.Expr, allowed: Iterable[sp.Symbol]) -> None:
        allowed = set(allowed)
        unknown = sorted(symbol.name for symbol in expression.free_symbols - allowed)
        if unknown:
            known = sorted(symbol.name for symbol in allowed)
            twin = next((name for name in unknown if name in known), None)
            if twin is not None:
                raise _fail(
                    scene,
                    f"{field} uses a symbol {twin} with other assumptions than the declared one; use the same SymPy symbol in both places.",
                )
            raise _fail(
                scene, f"{field} uses {', '.join(unknown)}, which is neither a parameter nor a variable allowed there ({', '.join(known)})."
            )

    check("kinetic_energy", scene.kinetic_energy, parameters | positions | velocities)
    check("potential_energy", scene.potential_energy, parameters | positions)
    for coordinate, force in zip(scene.coordinates, scene.forces, strict=True):
        check(f"forces[{coordinate.name}]", force, parameters | positions | velocities | inputs)
    for contact in scene.contacts:
        check(f"contact {contact.name}: penetration", contact.penetration, parameters | positions)
        check(f"contact {contact.name}: stiffness", contact.stiffness, parameters)
        check(f"contact {contact.name}: damping", contact.damping, parameters)
        check(f"contact {contact.name}: depth", contact.depth, parameters)
    for friction in scene.frictions:
        check(f"friction {friction.name}: slip", friction.slip, parameters | positions | velocities)
        check(f"friction {friction.name}: coefficient", friction.coefficient, parameters)
        if friction.normal_force is not None:
            check(f"friction {friction.name}: normal_force", friction.normal_force, parameters | positions)
    check("task.running_cost", scene.task.running_cost, parameters | positions | velocities | inputs)
    check("task.final_cost", scene.task.final_cost, parameters | positions | velocities)
    for shape in scene.shapes:
        for field, value in (("x", shape.x), ("y", shape.y), ("angle", shape.angle)):
            check(f"shape {shape.name}: {field}", value, parameters | positions)
        for size in shape.size:
            check(f"shape {shape.name}: size", size, parameters)


# What may stand for one end of a contact that is no drawn body.
_FIXED = ("ground", "wall", "joint")


def _check_bodies(scene: Scene) -> None:
    drawn = [shape.name for shape in scene.shapes]
    for contact in scene.contacts:
        unknown = [body for body in contact.bodies if body not in drawn and body not in _FIXED]
        if drawn and unknown:
            raise _fail(
                scene,
                f"contact {contact.name}: bodies names {unknown[0]!r}, which is no shape of the scene ({', '.join(drawn)}), nor one of {', '.join(_FIXED)}.",
            )
    for contact, depth in zip(scene.contacts, scene.depths, strict=True):
        if not depth > 0.0:
            raise _fail(scene, f"contact {contact.name}: depth is {depth:g} m, but must be positive.")


def _check_limits(scene: Scene) -> None:
    """A metric has one limit. A goal says how near is near enough, of the plan and of its replay, positions and velocities apart."""
    for metric, count in Counter(limit.metric for limit in scene.limits).items():
        if count > 1:
            raise _fail(scene, f"there are {count} limits on {metric}; leave one of them.")
    goal = scene.task.goal
    for part, values in (("position", goal[: scene.nq]), ("velocity", goal[scene.nq :])):
        if all(value is None for value in values):
            continue
        for metric in (f"terminal_{part}_error", f"replay_terminal_{part}_error"):
            if scene.limit(metric) is None:
                raise _fail(
                    scene,
                    f"task.goal asks for a {part}, but no limit says how near is near enough; add Limit(metric={metric!r}, value=.., reason=..).",
                )


def _start(scene: Scene) -> dict[sp.Symbol, sp.Float]:
    values = dict(scene.parameter_values)
    for index, coordinate in enumerate(scene.coordinates):
        values[coordinate.symbol] = scene.task.start[index]
        values[coordinate.velocity] = scene.task.start[scene.nq + index]
    return {symbol: sp.Float(value) for symbol, value in values.items()}


def _check_finite(scene: Scene) -> None:
    """Energy, forces and running cost at the start, inputs at zero or at the bound nearest to it."""
    start, inputs = _start(scene), {item.symbol: sp.Float(min(max(0.0, item.lower), item.upper)) for item in scene.inputs}
    fields = [("potential_energy", scene.potential_energy), ("task.running_cost", scene.task.running_cost)]
    fields += [(f"forces[{coordinate.name}]", force) for coordinate, force in zip(scene.coordinates, scene.forces, strict=True)]
    for field, expression in fields:
        value = expression.xreplace(start).xreplace(inputs)  # the state first: 0 u / 0 is no 0
        if value.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I):
            raise _fail(scene, f"{field} is {value} at the start (inputs at zero), but must be a finite real number there.")


def _check_mass(scene: Scene) -> None:
    velocities = [coordinate.velocity for coordinate in scene.coordinates]
    mass = sp.hessian(scene.kinetic_energy, velocities)
    if any(entry.free_symbols & set(velocities) for entry in mass):
        raise _fail(scene, "kinetic_energy is not quadratic in the velocities, so there is no mass matrix M(q).")
    rest = sp.expand(scene.kinetic_energy - (sp.Matrix([velocities]) * mass * sp.Matrix(velocities))[0] / 2)
    if rest != 0 and sp.simplify(rest) != 0:
        raise _fail(scene, f"kinetic_energy contains {rest}, which is not quadratic in the velocities.")
    numeric = mass.xreplace(_start(scene))
    for size in range(1, scene.nq + 1):
        minor = numeric[:size, :size].det()
        if not (minor.is_number and minor.is_real and float(minor) > 0):
            culprit = scene.coordinates[size - 1].name
            raise _fail(
                scene,
                f"the mass matrix is not positive definite at the start (leading minor {size}, at {culprit}, is {minor}); check the masses.",
            )


def _check_contacts(scene: Scene) -> None:
    start = _start(scene)
    for contact in scene.contacts:
        stiffness = contact.stiffness.xreplace(start).evalf()
        if not (stiffness.is_real and float(stiffness) > 0):
            raise _fail(scene, f"contact {contact.name}: the stiffness is {stiffness}, but must be positive.")
        damping = contact.damping.xreplace(start).evalf()
        if not (damping.is_real and float(damping) >= 0):
            unit = contact.damping_law.unit
            raise _fail(
                scene, f"contact {contact.name}: the damping is {damping} {unit}, but must not be negative; 0 is a contact without damping."
            )
        gradient = [sp.diff(contact.penetration, coordinate.symbol).xreplace(start).evalf() for coordinate in scene.coordinates]
        if not all(entry.is_number and entry.is_real and entry.is_finite for entry in gradient):
            raise _fail(
                scene, f"contact {contact.name}: the penetration is not differentiable at the start; its gradient there is {gradient}."
            )
        if not contact.penetration.free_symbols & {coordinate.symbol for coordinate in scene.coordinates}:
            raise _fail(scene, f"contact {contact.name}: the penetration depends on no coordinate, so the contact has no direction.")


def _check_frictions(scene: Scene) -> None:
    start = _start(scene)
    velocities = [coordinate.velocity for coordinate in scene.coordinates]
    contacts = [contact.name for contact in scene.contacts]
    for friction in scene.frictions:
        where = f"friction {friction.name}"
        if friction.contact is not None and friction.contact not in contacts:
            known = f"its contacts are {', '.join(contacts)}" if contacts else "it has no contacts"
            raise _fail(scene, f"{where}: there is no contact {friction.contact!r} to press the surfaces together; {known}.")
        slope = [sp.diff(friction.slip, velocity) for velocity in velocities]
        at_rest = friction.slip.subs(dict.fromkeys(velocities, 0))
        if any(entry.free_symbols & set(velocities) for entry in slope) or (at_rest != 0 and sp.simplify(at_rest) != 0):
            raise _fail(scene, f"{where}: the slip {friction.slip} is not linear in the velocities, so there is no direction of friction.")
        if all(entry == 0 for entry in slope):
            raise _fail(scene, f"{where}: the slip depends on no velocity, so the friction has no direction.")
        for field in ("coefficient", "normal_force"):
            value = getattr(friction, field)
            number = None if value is None else value.xreplace(start).evalf()
            if number is not None and not (number.is_real and float(number) >= 0):
                raise _fail(scene, f"{where}: the {field} is {number} at the start, but must not be negative.")
