"""Replays held against closed forms: they meet them to the stated digits, and a wrong form is found."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay.run import replay
from validate.judge.score import Score, Verdict, score
from validate.judge.score.evidence import Evidence
from validate.judge.score.measures import MEASURES


def judged(scene: Scene, *others: Scene) -> list[Score]:
    """The motion by the scene's own time step, judged on it, and on others that differ from it in their answers alone."""
    task = scene.task
    motion = load_kernel(scene).rollout(np.array(task.start), np.zeros((task.steps, 0)), task.step)
    plan = Trajectory(t=uniform_grid(task.step, task.steps), q=motion.q, v=motion.v, u=np.zeros((task.steps, 0)), lam=motion.lam)
    replayed = replay(scene, build_fmu(scene), plan)
    return [score(one, plan, replayed) for one in (scene, *others)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bouncing_mass", "two_body_collision"])
def test_the_replay_meets_every_closed_form(name: str):
    scene = load_scene(name)
    measured = [index for index, answer in enumerate(scene.answers) if answer.measure]
    moved = [replace(answer, value=answer.value + 10.0 * answer.tolerance) for answer in scene.answers]
    result, *wrong = judged(scene, *(replace(scene, answers=(*scene.answers[:i], moved[i], *scene.answers[i + 1 :])) for i in measured))
    assert result.verdict is Verdict.CONSISTENT, result.why  # nothing is asked of a motion that nobody plans
    assert {answer.measure for answer in scene.answers} - {""} <= set(MEASURES)
    metric = result.metric("answer_error")
    assert metric.value < 0.1
    assert len(wrong) == len(measured) > 0, "each answer alone is watched: moved by ten tolerances, it is found"
    for result in wrong:
        assert result.verdict is Verdict.UNDECIDED, "it accuses the judge, never the plan"
        assert "the judge is not well" in result.why
        assert "tolerances off a closed form" in result.why


@pytest.mark.slow
def test_a_contact_that_never_closes_is_not_measured():
    scene = load_scene("bouncing_mass").with_task(steps=100)
    (result,) = judged(scene)
    assert result.verdict is Verdict.UNDECIDED
    assert "no contact closes" in result.why


def test_contact_forces_change_by_penetration_and_by_its_rate():
    """Kelvin-Voigt: k and c. Hunt-Crossley, F = b phi (1 + d phi'): at most b times the largest share F / (b phi), and b d times the largest depth."""
    scene = load_scene("damped_collision")
    values = {symbol.name: value for symbol, value in scene.parameter_values.items()}
    k, c, b, d = (values[name] for name in "kcbd")
    gap = np.array([[-0.1, -0.2], [0.3, -0.4], [-0.5, 0.0]])
    lam = np.array([[9.0, 1.5 * b * 0.2], [0.0, 0.5 * b * 0.4], [9.0, 7.0]])
    case = SimpleNamespace(equations=scene, k=np.array([k, b]), replay_gap=gap, replay=SimpleNamespace(lam=lam))
    by_depth, by_rate = Evidence.slopes.func(case)
    assert by_depth == pytest.approx([k, 1.5 * b])
    assert by_rate == pytest.approx([c, d * b * 0.4])
    lam[0, 1] = 0.0  # no share is above 1 then
    assert Evidence.slopes.func(case)[0] == pytest.approx([k, b])
    case = SimpleNamespace(equations=load_scene("three_cart"), k=np.array([30.0, 31.0]))
    assert [part.tolist() for part in Evidence.slopes.func(case)] == [[30.0, 31.0], [0.0, 0.0]]
