"""Plans of the cart-pole between walls under tracking: an exact one is followed, one that cheats is not saved."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wording import unsaid

from formulations.pipelines import load_method
from models.catalog import load_scene
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Trajectory
from validate.cli.group import run
from validate.judge.judgement import judge
from validate.judge.replay.run import replay
from validate.judge.score import Verdict, score

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Half the bank's step: of 0.02 s the plan is so coarse that feedback has to give most of what the plan itself gives."""
    return load_scene("cart_pole_walls").with_task(step=0.01, steps=200)


@pytest.fixture(scope="module")
def plans(scene: Scene) -> dict[str, Trajectory]:
    """cheat: force from a distance.

    exact: what strict complementarity makes of its last tightening.
    """
    found: dict[str, Trajectory] = {}
    plan = None
    with load_method("softplus_dc").open(scene, {}) as session:
        for eps in (1e-3, 1e-5, 1e-7):
            plan = session.solve(eps=eps, warm_start=plan, time_limit=60.0).trajectory
            found.setdefault("cheat", plan)
    with load_method("strict_lcp").open(scene, {}) as session:
        exact = session.solve(eps=None, warm_start=plan, time_limit=60.0).trajectory
    return found | {"exact": exact}


def test_an_exact_plan_is_followed_where_alone_it_falls(scene: Scene, plans: dict[str, Trajectory]):
    exact = replay(scene, build_fmu(scene), plans["exact"], track=True)
    told = score(scene, plans["exact"], exact)
    assert (told.verdict, told.judged) == (Verdict.HOLDS_WITH_FEEDBACK, "feedback"), told.why
    assert not unsaid(told.why, "not for the inputs alone: … the motion ends")
    assert "unstable in the open loop (amplification 1" in told.why
    assert (
        abs(exact.growth.rate - 3.67) < math.log(2.0) / 2.0
    )  # of the upright pole, within a factor of two over its two seconds
    assert (
        (told.value("replay_terminal_velocity_error") or 0.0)
        > 0.2
        > (told.value("tracked_replay_terminal_velocity_error") or 1.0)
    )
    assert (told.value("feedback_effort") or 1.0) < 0.25
    assert (told.value("feedback_share") or 1.0) < 0.4
    assert (told.value("tracked_energy_residual_relative") or 1.0) < 1e-9
    planned = scene.task.step * plans["exact"].lam.sum()
    assert exact.tracked.contact_impulse[-1].sum() == pytest.approx(
        planned, rel=0.1
    )  # by the wall, as planned
    assert planned > 0.5
    assert np.abs(exact.tracked.applied).max() <= 4.0  # type: ignore[arg-type] - of a type that was checked or made so above


@pytest.mark.parametrize("tells", [True, False])
@pytest.mark.parametrize("declares", [True, False])
def test_feedback_does_not_save_a_plan_whose_walls_push_from_a_distance(
    scene, plans, tells, declares
):
    """With its forces in the plan, and with a plan that keeps them to itself, its scheme too."""
    plan = plans["cheat"]
    plan = plan if tells else replace(plan, lam=0.0 * plan.lam, missing=frozenset({"lam"}))
    plan = plan if declares else replace(plan, scheme=None)
    told = judge(scene, plan)
    assert told.verdict is Verdict.VIOLATES
    if tells:
        assert told.replay.tracked is None
        named = "physics_scaled" if declares else "contact_law_error"
        assert told.score.metric(named).ok is False
    forced = score(scene, plan, replay(scene, build_fmu(scene), plan, track=True))
    assert (forced.verdict, forced.judged) == (Verdict.VIOLATES, "open")


def test_a_scene_without_inputs_cannot_be_tracked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "plan.csv").write_text("t,q,v\n0,1,0\n0.01,1,0\n", encoding="utf-8")
    code = run(["replay", str(tmp_path / "plan.csv"), "--scene", "bouncing_mass", "--track"])
    _, err = capsys.readouterr()
    assert (code, err.count("\n")) == (2, 1)
    assert not unsaid(err, "no inputs, so … nothing to feed back to")
