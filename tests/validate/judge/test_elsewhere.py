"""The verdict matrix: the same ladder for every engine, and each class of disagreement found where it is planted."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from wording import unsaid

from models.catalog import load_scene
from models.errors import SceneError
from models.scene import Limit, Scene
from models.trajectory import Trajectory, uniform_grid
from validate.judge import elsewhere as room
from validate.judge.elsewhere import EngineVerdict, Otherwise, elsewhere
from validate.judge.judgement import Judgement, judge
from validate.judge.simulator import (
    Came,
    Drive,
    EngineAnswer,
    describe_engine,
    engine_names,
    load_engine,
)
from validate.truth.problems import ground


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


def otherwise(judgement: Judgement, engine: str = "fmu_everyday") -> EngineVerdict:
    """The row of an engine that disagrees."""
    (row,) = elsewhere(judgement, (engine,))
    assert row.agrees is False, row.levels
    return row


@pytest.mark.slow
def test_our_everyday_fmu_says_what_the_reference_says(thrown: Judgement, planted):
    ours, other = elsewhere(thrown, ("fmu", "fmu_everyday"))
    assert thrown.verdict.value == "consistent"
    assert ours.score is thrown.score
    assert other.agrees
    assert other.kind is Otherwise.NONE
    assert [level.verdict for level in other.levels] == ["consistent"] * 3
    assert other.levels[-1].distance < 1e-9
    assert [level.step for level in other.levels] == pytest.approx([0.01 / 4, 0.01 / 16, 0.01 / 64])
    assert json.loads(json.dumps(other.as_json()))["levels"][-1]["verdict"] == "consistent"


def test_what_goes_away_with_the_step_is_a_step_error(thrown: Judgement, planted):
    planted[0] = lambda drive: replace(drive, start=drive.start + np.array([0.0, 8.0 * drive.step]))
    row = otherwise(thrown)
    assert row.kind is Otherwise.STEP
    assert row.levels[0].verdict == "undecided"
    assert not unsaid(row.sentence, "undecided, undecided … from ours … at a step of 0.0025")


def of_contacts(drive: Drive, **change) -> Drive:
    """A drive whose contacts are others: each field by a function of the contact."""
    contacts = tuple(
        replace(item, **{name: of(item) for name, of in change.items()})
        for item in drive.scene.contacts
    )
    return replace(drive, scene=replace(drive.scene, contacts=contacts))


@pytest.mark.slow
def test_another_law_is_told_from_another_place_of_the_wall(thrown: Judgement, planted):
    planted[0] = lambda drive: of_contacts(drive, stiffness=lambda item: item.stiffness / 2)
    softer = otherwise(thrown)
    assert softer.kind is Otherwise.LAW, softer.sentence
    assert "8 times as stiff" in softer.sentence
    planted[0] = lambda drive: of_contacts(drive, penetration=lambda item: item.penetration + 0.05)
    nearer = otherwise(thrown)
    assert nearer.kind is Otherwise.GEOMETRY, nearer.sentence


@pytest.mark.slow
def test_what_instability_makes_of_a_hair_is_told_as_such(planted):
    pole = left_alone(load_scene("cart_pole_walls").with_task(start=(0.0, 1e-3, 0.0, 0.0)), 0.05)
    planted[0] = lambda drive: replace(drive, start=drive.start + np.array([0.0, 2e-4, 0.0, 0.0]))
    row = otherwise(pole)
    assert row.kind is Otherwise.UNSTABLE, row.sentence
    assert "an error grows" in row.sentence


@pytest.mark.peer
def test_a_block_that_creeps_in_drake_is_its_friction(planted):
    pytest.importorskip("pydrake")
    rests = left_alone(ground(math.atan(0.95 * 0.8), 0.8), 1e-5)
    row = otherwise(rests, "drake_continuous")
    assert row.kind is Otherwise.FRICTION, row.sentence


def test_a_motion_that_leaves_every_bound_is_a_row(thrown: Judgement, planted, monkeypatch):
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
    row = otherwise(thrown)
    assert row.verdict == "violates"
    assert row.as_json()["levels"][0]["distance"] is None


def test_feedback_that_has_no_end_is_a_row_and_no_verdict_without_it(
    thrown: Judgement, planted, monkeypatch
):
    planted[0] = lambda drive: replace(drive, start=drive.start + np.array([0.0, 8.0 * drive.step]))
    given = room.run_engine

    def late(name, drives, *, limits=None):
        return (
            EngineAnswer(came=Came.FAILED, why="it was ended")
            if drives[0].feedback is not None
            else given(name, drives)
        )

    monkeypatch.setattr(room, "run_engine", late)
    (row,) = elsewhere(thrown, ("fmu_everyday",))
    assert (row.verdict, row.agrees, row.sentence) == ("failed", None, "it was ended")


@pytest.mark.slow
@pytest.mark.process
def test_what_an_engine_cannot_express_is_a_row_with_the_reason():
    pytest.importorskip("mujoco")
    collides = left_alone(load_scene("damped_collision"), 0.01)
    (row,) = elsewhere(collides, ("mujoco",))
    assert row.verdict == "cannot express it"
    assert "no damping that grows with the depth" in row.sentence
    assert row.agrees is None


def test_only_a_replay_on_a_scene_has_a_matrix(thrown: Judgement):
    with pytest.raises(SceneError, match="engines: they step scenes"):
        elsewhere(replace(thrown, replay=None), ("fmu",))


def test_every_engine_says_how_it_makes_contact():
    engines = {name: describe_engine(name) for name in engine_names()}
    assert all(about.law for about in engines.values())
    assert {name: engines[name].adaptive for name in ("mujoco", "drake_continuous", "drake_sap",
        "drake_cenic")} == {
        "mujoco": False, "drake_continuous": True, "drake_sap": False, "drake_cenic": True,
    }  # fmt: skip
