"""The verdicts of engines on one plan: the same ladder for all, with the error of their steps."""

import json
from dataclasses import replace

import numpy as np
import pytest

from models.catalog import load_scene
from models.errors import SceneError
from models.scene import Limit, Scene
from models.trajectory import Trajectory, uniform_grid
from validate.judge.engines import elsewhere as room
from validate.judge.engines.elsewhere import elsewhere
from validate.judge.engines.simulator import (
    Came,
    Drive,
    EngineAnswer,
    describe_engine,
    engine_names,
    load_engine,
)
from validate.judge.judgement import Judgement, judge


def left_alone(scene: Scene, limit: float) -> Judgement:
    """The scene without inputs, as its own true motion, of which nothing is asked but that its replay is within a limit [m or rad] of it."""
    known = {item.metric for item in scene.limits} | {
        f"{of}terminal_{what}_error" for of in ("", "replay_") for what in ("position", "velocity")
    }
    asked = Limit(metric="replay_error", value=limit, reason="of this test")
    waived = tuple(
        Limit(metric=name, value=None, reason="of this test")
        for name in sorted(known - {"replay_error"})
    )
    scene = replace(scene, limits=(asked, *waived))
    t, nothing = (
        uniform_grid(scene.task.step, scene.task.steps),
        np.zeros((scene.task.steps + 1, 0)),
    )
    u = np.zeros((scene.task.steps, scene.nu))
    plan = Trajectory(t=t, q=nothing, v=nothing, u=u, lam=nothing[1:])
    true = load_engine("fmu")(
        Drive(
            scene=scene, plan=plan, start=np.array(scene.task.start, dtype=float), tolerance=1e-12
        )
    )
    forces = np.zeros((len(u), scene.nc + scene.nf))
    return judge(
        scene,
        Trajectory(
            t=t, q=true.q, v=true.v, u=u, lam=forces, missing=frozenset({"lam", "friction"})
        ),
    )


@pytest.fixture(scope="module")
def thrown() -> Judgement:
    return left_alone(load_scene("wall_pendulum"), 5e-4)


@pytest.fixture
def planted(monkeypatch):
    """Engines run in this process; planted[0] changes what all but the reference are told."""
    spoil = [lambda drive: drive]

    def here(name, drives, *, limits=None):
        return EngineAnswer(
            came=Came.DONE,
            motions=tuple(
                load_engine(name)(drive if name == "fmu" else spoil[0](drive)) for drive in drives
            ),
        )

    monkeypatch.setattr(room, "run_engine", here)
    return spoil


@pytest.mark.slow
def test_elsewhere_everyday_fmu_agrees_with_the_reference(thrown: Judgement, planted):
    ours, other = elsewhere(thrown, ("fmu", "fmu_everyday"))
    assert thrown.verdict.value == "consistent"
    assert ours.score is thrown.score
    assert (ours.agrees, other.agrees) == (True, True)
    assert other.verdict == "consistent"
    assert other.distance < 1e-9
    assert other.step == pytest.approx(0.01 / 64)
    row = json.loads(json.dumps(other.as_json()))
    assert (row["engine"], row["verdict"], row["agrees"]) == ("fmu_everyday", "consistent", True)


@pytest.mark.slow
def test_elsewhere_other_stiffness_disagrees(thrown: Judgement, planted):
    def softer(drive: Drive) -> Drive:
        contacts = tuple(
            replace(item, stiffness=item.stiffness / 2) for item in drive.scene.contacts
        )
        return replace(drive, scene=replace(drive.scene, contacts=contacts))

    planted[0] = softer
    (row,) = elsewhere(thrown, ("fmu_everyday",))
    assert row.agrees is False
    assert row.distance > 1e-3


def test_elsewhere_step_error_beyond_the_limit_undecided(thrown: Judgement, planted):
    """The start is off in proportion to the step: the motions at two steps differ by more than the limit."""
    planted[0] = lambda drive: replace(drive, start=drive.start + np.array([0.0, 8.0 * drive.step]))
    (row,) = elsewhere(thrown, ("fmu_everyday",))
    assert (row.verdict, row.agrees) == ("undecided", False)


def test_elsewhere_diverged_motion_violates(thrown: Judgement, planted, monkeypatch):
    given = room.run_engine

    def lost(name, drives, *, limits=None):
        answer = given(name, drives)
        return replace(
            answer,
            motions=tuple(
                replace(item, q=np.where(np.arange(len(item.q))[:, None] < 9, item.q, np.nan))
                for item in answer.motions
            ),
        )

    monkeypatch.setattr(room, "run_engine", lost)
    (row,) = elsewhere(thrown, ("fmu_everyday",))
    assert row.verdict == "violates"
    assert row.as_json()["distance"] is None


def test_elsewhere_feedback_without_an_end_failed(thrown: Judgement, planted, monkeypatch):
    """The motion at the finer step misses what only feedback can mend; the engine that follows is ended."""
    planted[0] = lambda drive: replace(drive, start=drive.start + np.array([0.0, 8.0 * drive.step]))
    given = room.run_engine

    def late(name, drives, *, limits=None):
        return (
            EngineAnswer(came=Came.FAILED, why="it was ended.")
            if drives[0].feedback is not None
            else given(name, drives)
        )

    monkeypatch.setattr(room, "run_engine", late)
    (row,) = elsewhere(thrown, ("fmu_everyday",))
    assert (row.verdict, row.agrees, row.why) == ("failed", None, "it was ended")


@pytest.mark.slow
@pytest.mark.process
def test_elsewhere_inexpressible_scene_gives_the_reason():
    pytest.importorskip("mujoco")
    collides = left_alone(load_scene("damped_collision"), 0.01)
    (row,) = elsewhere(collides, ("mujoco",))
    assert row.verdict == "cannot express it"
    assert "no damping that grows with the depth" in row.why
    assert row.agrees is None


def test_elsewhere_without_a_replay_refused(thrown: Judgement):
    with pytest.raises(SceneError, match="engines: they need a scene"):
        elsewhere(replace(thrown, replay=None), ("fmu",))


def test_every_engine_says_how_it_makes_contact():
    engines = {name: describe_engine(name) for name in engine_names()}
    assert all(about.law for about in engines.values())
    assert {name: engines[name].adaptive for name in ("mujoco", "drake_continuous", "drake_sap",
        "drake_cenic")} == {
        "mujoco": False, "drake_continuous": True, "drake_sap": False, "drake_cenic": True,
    }  # fmt: skip
