"""Plausibility warnings: what is possible in a scene, but probably a mistake; they stop nothing.

# ("scene own: contact wall is 0.4 deep at the start, 8 times its nominal 0.05; ...",)
scene_doubts(scene)
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator

import sympy as sp

from models.catalog import load_scene, scene_names
from models.errors import MachineError
from models.scene import Scene
from models.scene.text import scene_text
from models.stability import step_stability
from validate.judge.score.table import TABLE

# Scenes of the bank start at most one nominal penetration deep.
DEEP = 3.0


def scene_doubts(scene: Scene) -> tuple[str, ...]:
    """Sentences: contacts that are deep at the start or goal, parameters that change nothing, inputs that move nothing, limits on nothing."""
    return (*_deep_starts(scene), *_deep_goals(scene), *_idle(scene), *_idle_limits(scene))


def warnings_of(scenes: Iterable[Scene], *, steps: bool = False) -> list[str]:
    """Sentences on scenes, each scene once. steps: also on a time step that is unstable in contact, for which scenes that are not in the bank are compiled."""
    each = list({scene.name: scene for scene in scenes}.values())
    return [
        *(sentence for scene in each for sentence in scene_doubts(scene)),
        *(_unstable(each) if steps else ()),
    ]


def _unstable(scenes: Iterable[Scene]) -> Iterator[str]:
    bank = set(scene_names())
    for scene in scenes:
        if scene.name in bank and scene_text(load_scene(scene.name)) == scene_text(scene):
            continue
        with contextlib.suppress(MachineError):  # without a compiler: whoever runs it is told
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
    """Contacts into which the goal leads deeper than their model reaches.

    Of a goal that leaves a body free nothing is known.
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
