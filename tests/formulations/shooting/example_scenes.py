"""Scenes by name, those of the catalog and those that only tests use.

And a method's answer to one.
"""

from functools import cache
from pathlib import Path

from formulations.pipelines import load_method
from formulations.solution import Solution
from models.catalog import load_scene, scene_names
from models.scene import Scene
from models.trajectory import Trajectory


@cache
def example_scene(name: str) -> Scene:
    return load_scene(
        name if name in scene_names() else str(Path(__file__).parents[2] / "scenes" / f"{name}.py")
    )


def solve(
    scene: Scene,
    method: str = "relu_gd",
    eps: float | None = None,
    plan: Trajectory | None = None,
    **options: object,
) -> Solution:
    with load_method(method).open(scene, options) as session:
        return session.solve(eps=eps, warm_start=plan, time_limit=60.0)
