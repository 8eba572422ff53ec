"""Growth of a disturbance over the horizon: against eigenvalues, against the adjoint, and in words where a method fails of it."""

import math

import numpy as np
import pytest
from example_scenes import example_scene

from formulations.pipelines import load_method
from formulations.shooting.diagnosis import sensitivity
from formulations.shooting.objective import Objective
from formulations.shooting.stage import GradientGrowth, measure_growth
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw

HILL = example_scene("leaning_mass")


def _growth(steps: int) -> GradientGrowth:
    found = measure_growth(load_steps(HILL.with_task(steps=steps)), np.zeros((steps + 1, 2)), np.zeros((steps, 1)))
    assert found is not None
    return found


@pytest.mark.parametrize("steps", [200, 20000])
def test_the_rate_is_the_larger_root_of_the_step(steps: int):
    """z^2 - (2 + 4 h^2) z + 1 = 0; also where the factor is beyond all floats (e^800)."""
    h = HILL.task.step
    trace = 2.0 + 4.0 * h * h
    root = math.log((trace + math.sqrt(trace * trace - 4.0)) / 2.0) / h
    growth = _growth(steps)
    assert growth.rate == pytest.approx(root, rel=2e-2 if steps == 200 else 1e-3)
    assert growth.exponents[-1] == 0.0
    assert math.isfinite(growth.factor)
    assert f"over the {h * steps:g} s" in growth.sentence()


def test_the_factor_is_that_of_the_adjoint():
    scene = load_scene("acrobot_limits")
    u = np.random.default_rng(0).normal(size=(scene.task.steps, 1))
    objective = Objective(load_kernel(scene), law=ContactLaw.RELU)
    plan = load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
    growth = measure_growth(load_steps(scene), np.hstack([plan.q, plan.v]), u)
    assert growth.factor == pytest.approx(sensitivity(objective, u).growth, rel=1e-9)


def test_what_does_not_grow_is_not_told():
    scene = load_scene("three_cart")
    with load_method("relu_gd").open(scene, {"iterations": 3}) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=60.0)
    assert "grows" not in solution.message
    assert solution.residuals["gradient_growth"] < 2.0


def test_a_shooting_method_that_fails_of_growth_says_so():
    """Left alone for 5 s the acrobot is far beyond what a gradient can be carried over."""
    scene = load_scene("acrobot_limits").with_task(steps=5000)
    with load_method("relu_lbfgs").open(scene, {"max_iterations": 30}) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=60.0)
    assert solution.outcome is not Outcome.SOLVED
    assert "The gradient grows by" in solution.message
    assert "over the 5 s" in solution.message
    assert "multiple shooting does not carry it" in solution.message
    assert solution.residuals["growth_rate"] > 0.5
