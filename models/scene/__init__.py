"""A scene: the physics of a few bodies in contact, and the task to plan, written once in SymPy.

The package also checks scenes and finds their files.
"""

from models.scene.contacts import Contact, DampingLaw, Friction
from models.scene.parts import Answer, Coordinate, Input, Limit, Parameter, Shape, Task, goal_limits
from models.scene.scene import Scene

__all__ = [
    "Answer",
    "Contact",
    "Coordinate",
    "DampingLaw",
    "Friction",
    "Input",
    "Limit",
    "Parameter",
    "Scene",
    "Shape",
    "Task",
    "goal_limits",
]
