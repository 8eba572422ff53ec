"""Engines: found by their files, run in a child, each way to fail a row.

MuJoCo is told what the scene says and nothing else.
"""

import importlib.util
import math
import os
from dataclasses import replace

import numpy as np
import pytest
from wording import unsaid

from models.catalog import load_scene
from models.errors import MachineError, UnknownNameError
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.judge.engines import simulator
from validate.judge.engines.adapters._mechanism import mechanism_of
from validate.judge.engines.simulator import (
    Came,
    CannotExpressError,
    Drive,
    describe_engine,
    engine_names,
    load_engine,
    named_engines,
    run_engine,
)
from validate.judge.replay.wiring import Feedback
from validate.processes.isolated import Limits
from validate.truth.problems import ground

# Scenes that MuJoCo is told whole, and how near it comes to our replay at a fiftieth of the task's
# step [m, rad]: the tip of a cart-pole meets a constraint.
EXPRESSED = {
    "three_cart": 1e-7, "two_discs": 1e-5, "bouncing_mass": 1e-7, "two_body_collision": 1e-7,
    "transport": 1e-6,
    "hopper": 1e-5, "wall_pendulum": 1e-7, "acrobot_limits": 1e-7, "cart_pole_walls": 1e-3,
}  # fmt: skip


def drive(name: str, parts: int = 50) -> Drive:
    """A scene under inputs that wander, the same each time, and that press its bodies together."""
    scene = load_scene(name)
    steps = scene.task.steps
    u = np.cumsum(np.random.default_rng(0).standard_normal((steps, scene.nu)), axis=0) * 0.2
    if name == "three_cart":
        u[:] = 6.0, -6.0
    if name == "two_discs":
        u[:] = np.where(np.arange(steps) < 200, 20.0, 0.0)[:, None] * [0.01, 1.0]
    nothing = np.zeros((steps + 1, 0))
    plan = Trajectory(
        t=uniform_grid(scene.task.step, steps), q=nothing, v=nothing, u=u, lam=nothing[1:]
    )
    return Drive(
        scene=scene,
        plan=plan,
        start=np.array(scene.task.start, dtype=float),
        parts=parts,
        tolerance=1e-13,
    )


def test_engines_are_found_by_their_files_ours_first_and_described_without_being_imported():
    assert engine_names()[:2] == ("fmu", "fmu_everyday")
    assert "mujoco" in engine_names()
    assert describe_engine("fmu").adaptive
    assert describe_engine("mujoco").package == "mujoco"
    with pytest.raises(UnknownNameError, match="no engine 'mujuco'; did you mean mujoco"):
        describe_engine("mujuco")


def test_a_package_that_is_missing_is_said(monkeypatch):
    monkeypatch.setattr(simulator.importlib.util, "find_spec", lambda name: None)
    answer = run_engine("mujoco", [drive("wall_pendulum")])
    assert answer.came is Came.MISSING
    assert not unsaid(answer.why, "engine mujoco: … not installed; pip install -e '.[engines]'")
    with pytest.raises(MachineError, match="not installed"):
        named_engines("mujoco")


def test_what_a_mechanism_is_told_comes_from_the_scene():
    scene = load_scene("hopper").with_parameters(m_b=2.5, k=400.0)
    found = mechanism_of(scene)
    assert found.touches[0].stiffness == 400.0
    assert (
        '<joint name="z" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="2.5"'
        in found.bodies
    )
    stretched, at_rest = (
        np.array(found.smooth()(length, 0.0, 0.0, 0.0, 3.0)) for length in (0.2, 0.1)
    )
    np.testing.assert_allclose(stretched - at_rest, [-10.0, 10.0], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "words"),
    [("push_box", "gap of contact rim"),
     ("acrobot_limits_of_another_name", "mass matrix is no constant diagonal")],
)  # fmt: skip
def test_what_no_mechanism_expresses_is_said_in_a_sentence(name: str, words: str):
    with pytest.raises(CannotExpressError, match=words):
        mechanism_of(replace(load_scene(name.removesuffix("_of_another_name")), name=name))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EXPRESSED))
def test_mujoco_makes_the_motion_of_our_reference(name: str):
    pytest.importorskip("mujoco")
    asked = drive(name)
    true, other = (load_engine(engine)(asked) for engine in ("fmu", "mujoco"))
    assert np.ptp(true.q, axis=0).max() > 1e-3
    assert np.abs(true.q - other.q).max() <= EXPRESSED[name]
    if (
        EXPRESSED[name] > 1e-7 and not asked.scene.nf and name.startswith("two_discs")
    ):  # half the step, and what begins within a step costs less than asked
        assert np.abs(true.q - load_engine("mujoco")(replace(asked, parts=100)).q).max() <= 1e-7
    half = load_engine("mujoco")(
        replace(asked, start=asked.start * np.where(asked.start == 0.0, 1.0, 1.001))
    )
    assert np.abs(true.q - half.q).max() > EXPRESSED[name], "a start a thousandth off must show"


def test_mujoco_holds_a_line_by_its_value_in_the_middle_of_each_step():
    """Carts apart: steps that push with the mean of a line over them give the exact velocity, v = v(0) + (slope t^2/2)/m without damping."""
    pytest.importorskip("mujoco")
    scene = (
        load_scene("three_cart")
        .with_parameters(c=0.0)
        .with_task(start=(0.0, 9.0, 18.0, 0.0, 0.0, 0.0), steps=10)
    )
    t = uniform_grid(0.01, 10)
    u = 30.0 * np.column_stack([t, np.zeros(11)])
    plan = Trajectory(
        t=t, q=np.zeros((11, 3)), v=np.zeros((11, 3)), u=u[:-1], lam=np.zeros((10, 2)),
        hold=Hold.LINEAR, u_end=u[-1]
    )  # fmt: skip
    motion = load_engine("mujoco")(
        Drive(scene=scene, plan=plan, start=np.array(scene.task.start), parts=5)
    )
    mass = next(item.value for item in scene.parameters if item.symbol.name == "m")
    assert motion.v[:, 0] == pytest.approx(15.0 * t**2 / mass, abs=1e-12)


@pytest.mark.peer
def test_a_stop_on_a_joint_acts_in_drake_too():
    pytest.importorskip("pydrake")
    asked = drive("acrobot_limits", 1)
    true, other = (
        load_engine(name)(replace(asked, tolerance=1e-11)) for name in ("fmu", "drake_continuous")
    )
    assert np.abs(true.q - other.q).max() <= 1e-7
    without = replace(
        asked,
        scene=replace(
            asked.scene,
            contacts=tuple(
                replace(item, stiffness=item.stiffness / 2) for item in asked.scene.contacts
            ),
        ),
    )
    assert np.abs(true.q - load_engine("drake_continuous")(without).q).max() > 1e-3


@pytest.mark.slow
def test_friction_on_a_band_follows_what_presses_it():
    pytest.importorskip("mujoco")
    scene = ground(math.atan(1.05 * 0.8), 0.8)
    nothing = np.zeros((101, 0))
    slides = Drive(
        scene=scene,
        plan=Trajectory(
            t=uniform_grid(0.01, 100), q=nothing, v=nothing, u=nothing[1:], lam=nothing[1:]
        ),
        start=np.array(scene.task.start),
    )
    true, other = (load_engine(name)(slides) for name in ("fmu", "mujoco"))
    assert true.q[-1, 0] > 0.1
    np.testing.assert_allclose(other.q, true.q, rtol=0.0, atol=1e-12)
    # Lifted by 0.01 mm it swings, and friction with it: mu 1e-5 m of the way, which friction under
    # its weight alone would not have. Of order 4.
    swings = replace(slides, start=slides.start + np.array([0.0, 1e-5, 0.0, 0.0]))
    true = load_engine("fmu")(replace(swings, tolerance=1e-11))
    coarse, fine = (
        np.abs(true.q - load_engine("mujoco")(replace(swings, parts=parts)).q).max()
        for parts in (4, 8)
    )
    assert coarse < 1e-7
    assert fine < coarse / 10.0


def test_a_motion_that_diverges_is_told_as_such():
    pytest.importorskip("mujoco")
    asked = drive("bouncing_mass", 1)
    stiff = replace(asked, scene=asked.scene.with_parameters(k=1e12))
    assert (
        not load_engine("mujoco")(stiff).finite
        or np.abs(load_engine("mujoco")(stiff).q).max() > 1e3
    )


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize(
    ("body", "words"),
    [("import os; os.abort()", "it aborted"), ("import time; time.sleep(60)", "time limit of 5 s"),
     ("raise ValueError('no')", "ValueError: no")],
)  # fmt: skip
def test_an_engine_that_crashes_hangs_or_raises_is_a_row(
    monkeypatch, tmp_path, body: str, words: str
):
    (tmp_path / "broken_engine.py").write_text(
        f"from validate.judge.engines import simulator\ndef simulate(drive):\n    {body}\nsimulator.load_engine = lambda name: simulate\nanswer = simulator.answer\n"
    )
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    )
    in_child = simulator.run_isolated
    monkeypatch.setattr(
        simulator,
        "run_isolated",
        lambda function, *given, **settings: in_child("broken_engine:answer", *given, **settings),
    )
    answer = run_engine("fmu", [drive("wall_pendulum", 1)], limits=Limits(seconds=5.0))
    assert answer.came is Came.FAILED
    assert not unsaid(answer.why, words)


@pytest.mark.slow
@pytest.mark.peer
@pytest.mark.skipif(importlib.util.find_spec("pydrake") is None, reason="pydrake is not installed")
@pytest.mark.parametrize(
    ("engine", "least", "most"),
    [("drake_sap", 0.0, 1e-4), ("drake_cenic", 0.0, 1e-4), ("drake_continuous", 5e-4, 1e-2)],
)
def test_balls_rub_where_they_meet(engine: str, least: float, most: float):
    """Two fingers close on a disc, and rub on it: where they meet divides the depth by their radii.

    Drake's continuous plant rubs in the middle, whatever it is told.
    """
    given = drive("two_finger_lift")
    u = np.tile([0.4, 0.15], (20, 2))
    nothing = np.zeros((21, 0))
    plan = Trajectory(
        t=uniform_grid(given.scene.task.step, 20), q=nothing, v=nothing, u=u, lam=nothing[1:]
    )
    asked = replace(
        given, plan=plan, parts=256, tolerance=1e-8 if engine == "drake_cenic" else 1e-11
    )
    ours, theirs = (run_engine(name, [asked]).motions[0].q for name in ("fmu", engine))
    assert (ours[:, :4] != ours[0, :4]).any()
    assert least <= np.abs(theirs - ours).max() <= most


def test_feedback_acts_at_the_nodes_of_the_plan_however_many_rows_are_given_back():
    """Two steps of 0.5 s in two rows each: the input of a step is that of the state at its start."""
    plan = Trajectory(
        t=uniform_grid(0.5, 2),
        q=np.zeros((3, 1)),
        v=np.zeros((3, 1)),
        u=np.zeros((2, 1)),
        lam=np.zeros((2, 1)),
    )
    feedback = Feedback(
        gains=np.full((2, 1, 2), [1.0, 0.0]), reference=np.zeros((3, 2)), u=plan.u,
        lower=np.full(1, -9.0), upper=np.full(1, 9.0), scale=np.ones(1),
    )  # fmt: skip
    given: list[float] = []

    def advance(
        u: np.ndarray, slope: np.ndarray, count: int, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        given.append(float(u[0]))
        return np.array([1.0 + len(given)]), np.zeros(1)

    drive = Drive(
        scene=load_scene("wall_pendulum"),
        plan=plan,
        start=np.array([1.0, 0.0]),
        parts=2,
        rows=2,
        feedback=feedback,
    )
    motion = simulator.stepped(drive, advance)
    assert given == [-1.0, -1.0, -3.0, -3.0]
    assert motion.applied.tolist() == [[-1.0], [-3.0]]
    assert motion.q[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
