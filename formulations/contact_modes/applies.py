"""To which scenes contact windows apply. Light to import: a method is asked before anything is opened."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from models.scene import Scene


def why_not(scene: Scene) -> str | None:
    """None, or the reason why contact windows do not make a plan of this scene."""
    if not scene.inputs:
        return f"scene {scene.name} has no inputs, so there is nothing to plan."
    if scene.nf:
        return f"scene {scene.name} has friction, and contact windows alone do not say where it sticks; strict_lcp plans it."
    if scene.damped:
        names = ", ".join(scene.contacts[index].name for index in scene.damped)
        return f"scene {scene.name} has damped contacts ({names}), and contact windows alone do not say where they are released; strict_lcp plans it."
    from formulations.transcription.smooth import check_smooth
    from models.errors import SceneError

    # What is smooth as it was written is so once it is derived.
    written = {
        "the kinetic energy": (scene.kinetic_energy,),
        "the potential energy": (scene.potential_energy,),
        "a force": scene.forces,
        "a penetration": [contact.penetration for contact in scene.contacts],
        "a stiffness": [contact.stiffness for contact in scene.contacts],
        "the running cost": (scene.task.running_cost,),
        "the final cost": (scene.task.final_cost,),
    }
    try:
        for what, expressions in written.items():
            check_smooth(scene, what, expressions)
    except SceneError as error:
        return str(error)
    return None
