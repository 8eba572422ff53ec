"""The judge on friction: transport planned exactly, with more force than mu N, and with creep.

Replayed with true stiction.
"""

import dataclasses

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.fmu import build_fmu
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay.result import Replay
from validate.judge.replay.run import replay
from validate.judge.score import Question, Score, score

STEPS = 100


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("transport").with_task(steps=STEPS, goal=(None,) * 4)


def rolled(scene: Scene, law: ContactLaw = ContactLaw.RELU, eps: float | None = None) -> Trajectory:
    """Pushes and pulls under which the cargo sticks, slips both ways and sticks again, through the plan's own time step."""
    times = np.arange(STEPS) * 0.02
    u = np.select([times < 0.4, times < 0.8, times < 1.2], [4.0, 12.0, -12.0], 1.0)[:, None]
    result = load_kernel(scene).rollout(np.array(scene.task.start), u, 0.02, law, eps)
    return Trajectory(
        t=uniform_grid(0.02, STEPS),
        q=result.q,
        v=result.v,
        u=u,
        lam=result.lam,
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )


@pytest.fixture(scope="module")
def plan(scene: Scene) -> Trajectory:
    return rolled(scene)


@pytest.fixture(scope="module")
def replayed(scene: Scene, plan: Trajectory) -> Replay:
    return replay(scene, build_fmu(scene), plan)


def value(result: Score, name: str) -> float:
    found = result.metric(name)
    assert found.value is not None, found.reason
    return found.value


@pytest.mark.slow
def test_the_plan_of_the_true_time_step_has_no_violation(
    scene: Scene, plan: Trajectory, replayed: Replay
) -> None:
    result = score(scene, plan, replayed)
    assert value(result, "friction_violation") == 0.0
    assert value(result, "friction_dissipation_error") < 1e-12
    assert value(result, "defect") < 1e-12
    assert value(result, "law_error") == 0.0
    assert value(result, "energy_residual_relative") < 1e-9
    bare = score(scene, dataclasses.replace(plan, scheme=None), replayed)
    # Four changes of mode, each a step of 0.02 s and 2 mu N apart at most.
    assert value(bare, "friction_impulse_error") < 0.1


def test_the_replay_sticks_without_creep_and_its_modes_are_events(
    scene: Scene, replayed: Replay
) -> None:
    slip = replayed.v[:, 0] - replayed.v[:, 1]
    sticks = np.abs(replayed.friction[:, 0]) < 0.99 * 0.2 * 9.81
    assert sticks.sum() > 50
    assert np.abs(slip[sticks]).max() < 1e-9
    assert np.abs(replayed.friction).max() <= 0.2 * 9.81 * (1 + 1e-9)
    assert {event.contact for event in replayed.events} == {"friction_belt"}
    assert (
        len(replayed.events) == 2
    )  # slips come to zero; where it starts to slip the input jumps, which needs no event to be found
    assert replayed.error.estimate.position < 1e-7


def test_force_beyond_mu_n_and_creep_are_found(
    scene: Scene, plan: Trajectory, replayed: Replay
) -> None:
    lam = np.array(plan.lam)
    lam[3, 2] += 5.0
    beyond = score(scene, dataclasses.replace(plan, lam=lam), replayed)
    assert value(beyond, "friction_violation") == pytest.approx(
        abs(lam[3, 2]) - 0.2 * 9.81, rel=1e-12
    )
    assert value(beyond, "defect") > 1e-2
    creeping = score(scene, rolled(scene, ContactLaw.SOFTPLUS, 1e-3), None)
    assert value(creeping, "friction_dissipation_error") > 10 * 2e-5  # the limit of the scene
    assert value(creeping, "friction_violation") == 0.0
    for wrong, name in ((beyond, "friction_violation"), (creeping, "friction_dissipation_error")):
        metric = wrong.metric(name)
        assert metric.ok is False
        assert dict(wrong.questions)[Question.FORCES] == "no"


def test_an_undeclared_plan_is_asked_the_friction_law_too_at_either_end_of_its_steps(
    scene: Scene, plan: Trajectory
) -> None:
    """Sliding against all of mu N is that wherever in a step one looks.

    A force that helps the slip is none of friction.
    """
    undeclared = dataclasses.replace(plan, scheme=None)
    metric = score(scene, undeclared, None).metric("friction_dissipation_error")
    assert metric.ok is True
    helping = dataclasses.replace(undeclared, lam=plan.lam * np.array([1.0, 1.0, -1.0]))
    metric = score(scene, helping, None).metric("friction_dissipation_error")
    assert metric.ok is False
    stick = np.abs(plan.v[1:, 0] - plan.v[1:, 1]) < 1e-9
    other = plan.lam.copy()
    other[stick & np.roll(stick, 1) & np.roll(stick, -1), 2] *= (
        0.5  # where it sticks a force is not unique: the law allows any up to mu N
    )
    metric = score(scene, dataclasses.replace(undeclared, lam=other), None).metric(
        "friction_dissipation_error"
    )
    assert metric.ok is True
