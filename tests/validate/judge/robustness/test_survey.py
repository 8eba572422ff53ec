"""What a campaign asks of a plan that holds: against the worlds one by one, against first failures along every perturbation, and refused where nothing is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.catalog import load_scene
from validate.judge.judgement import Judgement
from validate.judge.robustness import robustness, survey
from validate.judge.robustness.robustness import FEWEST
from validate.judge.robustness.trials import SceneArena, asked_limits
from validate.judge.robustness.worlds import draw, moved, perturbations

SCENE = load_scene("three_cart")


@pytest.mark.slow
def test_a_plan_is_tried_in_the_same_worlds_as_by_itself(judged: Judgement):
    limits = asked_limits(judged.score)
    found = survey(SCENE, judged.plan, limits, False)
    worlds = draw(perturbations(SCENE, judged.plan), 256, 0)
    with SceneArena.of(SCENE, judged.plan, limits) as arena:
        arrived = [
            arena.trial(worlds.world(number, arena.nominal)).arrives for number in range(256)
        ]
        cause = next(item for item in worlds.causes if item.name == found.weakest)
        for share, arrives in ((0.98, True), (1.02, False)):
            trial = arena.trial(
                moved(arena.nominal, [cause], np.array([share * found.amount / cause.size]))
            )
            assert trial.arrives is arrives
        assert trial.fails_by == found.by
    assert (found.alone.samples, found.alone.arrived) == (256, sum(arrived))
    assert found.feedback.samples == 64
    assert (found.checked, found.differ) == (20, 0)
    along_all = robustness(SCENE, judged.plan, samples=10, kinds=["parameters"]).weakest
    assert (found.weakest, found.sizes) == (
        along_all.cause.name,
        pytest.approx(along_all.sizes, rel=0.02),
    )
    record = found
    assert (record.alone.arrived, record.weakest, record.message) == (sum(arrived), "c", "")  # type: ignore[union-attr]


@pytest.mark.slow
def test_what_is_dear_is_tried_in_fewer_worlds_and_without_states_without_feedback(
    judged: Judgement,
):
    plan = judged.plan
    fine = np.linspace(0.0, plan.duration, 40 * plan.steps + 1)
    still, missing = np.tile(plan.q[:1], (len(fine), 1)), frozenset({"q", "v", "lam", "friction"})
    u, lam = (np.repeat(held, 40, axis=0) for held in (plan.u, plan.lam))
    long = replace(plan, t=fine, q=still, v=0.0 * still, u=u, lam=lam, missing=missing)
    found = survey(SCENE, long, asked_limits(judged.score), False)
    assert (found.alone.samples, found.feedback) == (FEWEST, None)
    assert found.sizes == pytest.approx(0.83, abs=0.02), "the same inputs"
