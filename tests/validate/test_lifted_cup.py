"""The paper's motivating example: a cup that a relaxed plan lifts with forces that are not there, and an exact plan that really lifts it."""

import pytest
from wording import unsaid

from formulations.pipelines import load_method
from formulations.solution import Solution
from models.catalog import load_scene
from validate.judge.judgement import judge
from validate.judge.score import Question, Score, Verdict


@pytest.fixture(scope="module")
def plans() -> tuple[Solution, Solution]:
    """The relaxed plan from a cold start, and the exact one that starts from it."""
    scene = load_scene("two_finger_lift")
    with load_method("relaxed_lcp").open(scene) as session:
        relaxed = session.solve(eps=1e-2, warm_start=None, time_limit=900.0)
        relaxed = session.solve(eps=1e-4, warm_start=relaxed.trajectory, time_limit=900.0)
    with load_method("strict_lcp").open(scene) as session:
        exact = session.solve(eps=None, warm_start=relaxed.trajectory, time_limit=900.0)
    return relaxed, exact


def judged(solution: Solution) -> Score:
    assert solution.trajectory is not None
    return judge("two_finger_lift", solution).score


@pytest.mark.slow
def test_both_plans_lift_the_cup_on_paper(plans):
    scene = load_scene("two_finger_lift")
    height = [coordinate.name for coordinate in scene.coordinates].index("y")
    for solution in plans:
        y = solution.trajectory.q[:, height]
        assert y[-1] == pytest.approx(scene.task.goal[height], abs=1e-6)
        assert y[-1] - y[0] > 0.02


@pytest.mark.slow
def test_the_relaxed_plan_violates_and_says_where_its_forces_come_from(plans):
    found = judged(plans[0])
    assert found.verdict is Verdict.VIOLATES
    beyond = {metric.name for metric in found.metrics if metric.ok is False}
    assert {
        "physics_scaled",
        "friction_dissipation_error",
        "ghost_impulse",
        "discrete_terminal_velocity_error",
    } <= beyond
    assert not unsaid(found.why, "not those of contact")
    assert dict(found.questions)[Question.GOAL] == "yes", "on paper"


@pytest.mark.slow
def test_the_exact_plan_from_the_same_start_holds(plans):
    """With feedback: what squeezes the cup drives an error of its height on, whatever the plan."""
    found = judged(plans[1])
    assert found.verdict is Verdict.HOLDS_WITH_FEEDBACK, found.why
    assert load_scene("two_finger_lift").unstable
    assert plans[1].cost is not None
    assert plans[1].cost <= 59.40, "as cheap as the best known way"
    values = {metric.name: metric.value for metric in found.metrics}
    assert values["physics_scaled"] < 1e-9
    assert values["friction_violation"] < 1e-9
    assert values["discrete_terminal_error"] < 1e-6
    assert values["feedback_effort"] < 0.01, "a finger's tremble, not another plan"
    assert values["feedback_share"] < 0.05
