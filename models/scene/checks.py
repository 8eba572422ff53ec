"""The physics of a scene is possible: checked by computer algebra when it is loaded, and before anything is derived from it.

What needs no computer algebra is checked when a scene is created (models.scene.scene).
"""

from __future__ import annotations

from weakref import WeakSet

import sympy as sp

from models.errors import SceneError
from models.scene import Scene
from models.scene.dimensions import dimension_problem
from models.scene.functions import function_problem

_PASSED: WeakSet[Scene] = WeakSet()


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
