"""A scene made by a program is refused in its one sentence by whatever uses it first, as a scene's file is when it is loaded."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy as sp

from formulations import ContactFormulation, build_model
from formulations.pipelines import load_method, method_names
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import SceneError
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Trajectory
from validate.judge.judgement import judge


def judged(scene: Scene) -> Any:
    steps = scene.task.steps
    still = np.tile(np.array(scene.task.start), (steps + 1, 1))
    return judge(
        scene,
        Trajectory(
            t=scene.task.step * np.arange(steps + 1), q=still[:, : scene.nq], v=still[:, scene.nq :], u=np.zeros((steps, scene.nu)),
            lam=np.zeros((steps, scene.nl)),
        ),
    )  # fmt: skip


def planned(name: str) -> Callable[[Scene], Any]:
    def plan(scene: Scene) -> Any:
        method = load_method(name)
        if (reason := method.accepts(scene)) is not None:
            pytest.skip(reason)
        with method.open(scene, {}) as session:
            return session.solve(eps=1e-2 if method.needs_eps else None, warm_start=None, time_limit=1.0)

    return plan


USES = {
    "kernel": load_kernel, "FMU": build_fmu, "judge": judged, "Pyomo": lambda scene: build_model(scene, ContactFormulation.SOFTPLUS, eps=1e-3),
    **{name: planned(name) for name in method_names()},
}  # fmt: skip


@pytest.mark.parametrize("use", USES.values(), ids=USES.keys())
def test_an_impossible_scene_is_refused(use: Callable[[Scene], Any]):
    scene = load_scene("three_cart").with_task(steps=5)
    endless = scene.potential_energy + sp.log(scene.coordinates[0].symbol - scene.task.start[0])
    with pytest.raises(SceneError, match=r"^scene three_cart: potential_energy is zoo at the start"):
        use(replace(scene, potential_energy=endless))
