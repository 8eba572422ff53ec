"""How large a scene's model is: counted on paper, beside what Ipopt is given.

T steps, g of the 2 nq components of the end given:

    unknowns      2 nq (T+1) + nu T + nc T + nf T       states, inputs, contact and friction forces
    equations     2 nq + g + 2 nq T + nc T + nf T       start, end, time steps, one law a contact and friction

Complementarity adds to each contact and step its separation force and that force's definition; to each friction and step two slip speeds, two
reserves, and the four equations that tie them to the slip and to the force; to each damped contact and step the force of its spring and that
force's complement, its definition and their product, and with Kelvin-Voigt as much for the switch.
"""

from __future__ import annotations

from formulations.solution import ModelSize
from formulations.transcription.contact_laws import ContactLaw
from models.contacts import DampingLaw
from models.scene import Scene


def size_on_paper(scene: Scene, contact: ContactLaw) -> ModelSize:
    """Unknowns and equations of the scene's model by hand; see the module docstring."""
    steps, given = scene.task.steps, sum(value is not None for value in scene.task.goal)
    laws = [scene.contacts[index].damping_law for index in scene.damped]
    pairs = len(laws) + laws.count(DampingLaw.KELVIN_VOIGT)
    extra = scene.nc + 4 * scene.nf + 2 * pairs if contact is ContactLaw.COMPLEMENTARITY else 0
    return ModelSize(
        unknowns=2 * scene.nq * (steps + 1) + (scene.nu + scene.nl + extra) * steps,
        equations=2 * scene.nq + given + (2 * scene.nq + scene.nl + extra) * steps,
    )
