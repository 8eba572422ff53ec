"""A scene in other units: the same physics, all numbers of another size.

    small = in_units(scene, length=0.01, mass=0.001, time=0.1)     # cm, g, tenths of a second

A pipeline that finds a plan in one of the two alone fails by scale, and by nothing else. Numbers
inside expressions are taken to have no unit: a scene is written with parameters.
"""

from __future__ import annotations

from dataclasses import replace

from models.scene import Scene
from models.scene.values import base_exponents


def in_units(scene: Scene, *, length: float, mass: float, time: float) -> Scene:
    """Return the scene with these as its units of length [m], mass [kg] and time [s]."""
    sizes = {"m": length, "kg": mass, "s": time, "rad": 1.0}

    def of(unit: str) -> float:
        value = 1.0
        for base, exponent in base_exponents(unit).items():
            value *= sizes[base] ** exponent
        return value

    positions = [of(item.unit) for item in scene.coordinates]
    state = [*positions, *(size / time for size in positions)]
    task = replace(
        scene.task,
        start=tuple(value / size for value, size in zip(scene.task.start, state, strict=True)),
        goal=tuple(
            None if value is None else value / size
            for value, size in zip(scene.task.goal, state, strict=True)
        ),
        step=scene.task.step / time,
    )
    # A limit of the goal is a norm over its components, which have one unit in a drawn scene.
    aimed = [
        size
        for value, size in zip(scene.task.goal[: scene.nq], positions, strict=True)
        if value is not None
    ]
    position = aimed[0] if aimed else 1.0
    limits = tuple(
        replace(
            item, value=item.value / (position / time if "velocity" in item.metric else position)
        )
        if item.value is not None and "terminal" in item.metric
        else item
        for item in scene.limits
    )
    return replace(
        scene,
        coordinates=tuple(
            replace(
                item,
                nominal=item.nominal / size,
                velocity_lower=item.velocity_lower / (size / time),
                velocity_upper=item.velocity_upper / (size / time),
            )
            for item, size in zip(scene.coordinates, positions, strict=True)
        ),
        inputs=tuple(
            replace(item, lower=item.lower / of(item.unit), upper=item.upper / of(item.unit))
            for item in scene.inputs
        ),
        parameters=tuple(
            replace(
                item,
                value=item.value / of(item.unit),
                lower=item.lower / of(item.unit),
                upper=item.upper / of(item.unit),
            )
            for item in scene.parameters
        ),
        contacts=tuple(
            replace(item, nominal=item.nominal / length, depth=item.depth / length)
            for item in scene.contacts
        ),
        frictions=tuple(
            replace(item, nominal=item.nominal / (length / time)) for item in scene.frictions
        ),
        task=task,
        limits=limits,
        length=scene.length / length,
    )
