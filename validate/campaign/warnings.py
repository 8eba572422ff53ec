"""Report implausible properties of a scene, and figures of a scene outside the bank.

    # ("scene own: contact wall is 0.4 deep at the start, 8 times its nominal 0.05; ...",)
    scene_doubts(scene)
    # ("a contact lasts 0.02 s, 4 steps of 0.005 s (omega h = 0.77); ...", ..)
    scene_figures(scene)

Warnings do not stop a campaign.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator

import sympy as sp

from formulations.pipelines import SOFTPLUS_EPS
from models.catalog import load_scene, scene_names
from models.contact_law import ContactLaw, contact_force, sharpness
from models.errors import MachineError
from models.scene import Scene
from models.scene.text import scene_text
from models.stability import contact_frequency, step_stability
from validate.judge.score.table import TABLE

# Suspicious depth at the start [nominal penetrations]; scenes of the bank have at most 1.
DEEP = 3.0
# Largest omega h of a resolved contact. Semi-implicit Euler changes the contact's period by
# (omega h)^2/24, 1 % at this value.
_COARSE = 0.5


def scene_doubts(scene: Scene) -> tuple[str, ...]:
    """Return sentences on parameters, inputs and limits without effect, and on deep contacts.

    Contacts are checked at the start and at the goal.
    """
    return (*_deep_starts(scene), *_deep_goals(scene), *_idle(scene), *_idle_limits(scene))


def warnings_of(scenes: Iterable[Scene], *, steps: bool = False) -> list[str]:
    """Return the doubts of all scenes, each scene once.

    steps: also report time steps that are unstable in contact; compiles scenes outside the bank.
    """
    each = list({scene.name: scene for scene in scenes}.values())
    return [
        *(sentence for scene in each for sentence in scene_doubts(scene)),
        *(_unstable(each) if steps else ()),
    ]


def is_of_bank(scene: Scene) -> bool:
    """Return whether the scene is in the bank, unchanged."""
    return scene.name in scene_names() and scene_text(load_scene(scene.name)) == scene_text(scene)


def scene_figures(scene: Scene) -> tuple[str, ...]:
    """Return sentences on contact time, stability of the step, relaxed contact and units.

    Raises MachineError without a compiler.
    """
    found = step_stability(scene)
    limit = "no limit" if math.isinf(found.largest_step) else f"limit {found.largest_step:.3g} s"
    word = "stable" if found.is_stable else "unstable"
    stable = f"the step of {scene.task.step:g} s is {word} in contact ({limit})"
    units = "units agree: energies in J, forces in N or N m, penetrations in m"
    return (*_contact_time(scene), stable, *_force_at_gap_zero(scene), units)


def _contact_time(scene: Scene) -> Iterator[str]:
    omega, h = contact_frequency(scene), scene.task.step
    if omega > 0.0:
        coarse = f"; this is coarse: a step below {_COARSE / omega:.2g} s resolves it"
        yield (
            f"a contact lasts {math.pi / omega:.3g} s, {math.pi / (omega * h):.1f} steps of {h:g} s "
            f"(omega h = {omega * h:.2g}){coarse if omega * h > _COARSE else ''}"
        )


def _force_at_gap_zero(scene: Scene) -> Iterator[str]:
    """Compare the force of softplus contact at gap zero with the inputs, if these are forces."""
    if not scene.contacts:
        return
    stiffness = {
        item.name: float(item.stiffness.subs(scene.parameter_values)) for item in scene.contacts
    }
    name = max(stiffness, key=lambda name: stiffness[name])
    forces = [
        float(contact_force(0.0, stiffness[name], ContactLaw.SOFTPLUS, eps, scene.length))  # type: ignore[arg-type]
        for eps in SOFTPLUS_EPS
    ]
    said = ", ".join(
        f"{force:.3g} N at eps {eps:g}" for force, eps in zip(forces, SOFTPLUS_EPS, strict=True)
    )
    bounds = [
        max(abs(item.lower), abs(item.upper))
        for item in scene.inputs
        if item.unit == "N" and math.isfinite(item.lower) and math.isfinite(item.upper)
    ]
    beside = f"; the largest input is {max(bounds):g} N" if bounds else ""
    advice = ""
    if bounds and forces[0] > max(bounds):
        # k L ln 2 / |ln eps| = largest input, solved for L.
        length = max(bounds) / (stiffness[name] * math.log(2.0) / sharpness(SOFTPLUS_EPS[0]))
        advice = f", so relaxed contact outweighs it: Scene(length=..) below {length:.2g} m (now {scene.length:g} m) mends that"
    yield f"softplus contact {name} pushes at gap zero with {said}{beside}{advice}"


def _unstable(scenes: Iterable[Scene]) -> Iterator[str]:
    for scene in scenes:
        if is_of_bank(scene):
            continue
        with contextlib.suppress(MachineError):  # without a compiler, the run raises the error
            if sentence := step_stability(scene).sentence:
                yield sentence


def _deep_starts(scene: Scene) -> Iterator[str]:
    start = {
        **scene.parameter_values,
        **{
            item.symbol: value
            for item, value in zip(scene.coordinates, scene.task.start, strict=False)
        },
    }
    for contact in scene.contacts:
        depth = float(contact.penetration.subs(start).evalf())
        if depth > DEEP * contact.nominal:
            yield (
                f"scene {scene.name}: contact {contact.name} is {depth:.3g} deep at the start, {depth / contact.nominal:.3g} times its nominal "
                f"{contact.nominal:.3g}; is the sign of its penetration right? It is positive in contact."
            )


def _deep_goals(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each contact that is deeper at the goal than its model allows.

    Contacts of bodies that the goal leaves free are skipped.
    """
    goal = {
        item.symbol: value
        for item, value in zip(scene.coordinates, scene.task.goal, strict=False)
        if value is not None
    }
    for contact, most in zip(scene.contacts, scene.depths, strict=True):
        penetration = contact.penetration.subs(scene.parameter_values).subs(goal)
        if penetration.is_number and (depth := float(penetration.evalf())) > most:
            yield (
                f"scene {scene.name}: contact {contact.name} is {depth:.3g} m deep at the goal, and its model ends at {most:.3g} m (depth): no plan that "
                "gets there can hold; is the goal right?"
            )


def _idle(scene: Scene) -> list[str]:
    physics: list[sp.Expr | None] = [scene.kinetic_energy, scene.potential_energy, *scene.forces]
    physics += [
        part
        for contact in scene.contacts
        for part in (contact.penetration, contact.stiffness, contact.damping)
    ]
    physics += [
        part
        for friction in scene.frictions
        for part in (friction.slip, friction.coefficient, friction.normal_force)
    ]
    drawn = [
        part for shape in scene.shapes for part in (shape.x, shape.y, shape.angle, *shape.size)
    ]
    asked = [scene.task.running_cost, scene.task.final_cost]
    used = _symbols([*physics, *asked, *drawn])
    moving = _symbols(scene.forces)
    found = [
        f"scene {scene.name}: parameter {item.name} changes nothing; nothing of the scene contains it."
        for item in scene.parameters
        if item.symbol not in used
    ]
    found += [
        f"scene {scene.name}: input {item.name} moves nothing; no force contains it."
        for item in scene.inputs
        if item.symbol not in moving
    ]
    return found


def _idle_limits(scene: Scene) -> list[str]:
    absent = {entry.name: entry.meaning for entry in TABLE if not entry.applies(scene)}
    return [
        f"scene {scene.name}: the limit on {limit.metric} judges nothing; nothing here has this metric ({absent[limit.metric]})."
        for limit in scene.limits
        if limit.metric in absent
    ]


def _symbols(parts: Iterable[sp.Expr | None]) -> set[sp.Basic]:
    return {symbol for part in parts if part is not None for symbol in part.free_symbols}
