"""The free motion of scenes without inputs: what the time step makes of the start, and refusal of anything that could be planned."""

import numpy as np
import pytest
from example_scenes import example_scene

from formulations.method import Kind, OptionError
from formulations.pipelines import PIPELINES, load_method, pipelines_for
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel

METHOD = load_method("free_motion")


@pytest.mark.parametrize("name", ["bouncing_mass", "two_body_collision"])
def test_it_is_the_scenes_own_time_step_with_true_contact(name: str):
    scene = load_scene(name)
    with METHOD.open(scene) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=600.0)
    assert solution.outcome is Outcome.SOLVED
    assert METHOD.kind is Kind.DIRECT
    plan = solution.trajectory
    expected = load_kernel(scene).rollout(np.array(scene.task.start), np.zeros((scene.task.steps, 0)), scene.task.step)
    assert np.array_equal(plan.q, expected.q)
    assert np.array_equal(plan.lam, expected.lam)
    assert plan.lam.max() > 1.0
    assert solution.cost == 0.0


def test_a_scene_with_inputs_is_refused_with_a_reason():
    scene = load_scene("three_cart")
    assert "has inputs" in str(METHOD.accepts(scene))
    with pytest.raises(OptionError, match="free_motion: scene three_cart has inputs"):
        METHOD.open(scene)


def test_a_step_beyond_the_stability_limit_diverges_and_says_so():
    oscillator = example_scene("oscillator")
    scene = oscillator.with_task(step=3.0, steps=2000)  # h w = 3, beyond 2
    with METHOD.open(scene) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=600.0)
    assert solution.outcome is Outcome.DIVERGED
    assert solution.trajectory is None
    assert "use a smaller one" in solution.message


def test_it_is_tried_only_where_nothing_can_be_planned():
    assert "free_motion" not in [pipeline.name for pipeline in pipelines_for(load_scene("three_cart"))]
    assert pipelines_for(load_scene("bouncing_mass")) == PIPELINES


def test_eps_and_other_options_are_refused():
    with METHOD.open(load_scene("bouncing_mass")) as session, pytest.raises(OptionError, match="takes no eps"):
        session.solve(eps=0.1, warm_start=None, time_limit=1.0)
    with pytest.raises(OptionError, match="colour"):
        METHOD.open(load_scene("bouncing_mass"), {"colour": "red"})
