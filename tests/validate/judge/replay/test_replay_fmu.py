"""Replay through generated FMUs: closed forms, self-error, uneven grids, a start in contact."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.parts import goal_limits
from models.trajectory import Trajectory, uniform_grid
from tests.validate.judge.replay.test_tracking_gains import poised
from validate.judge.replay import Replay
from validate.judge.replay.run import replay

# Absolute error of a reference replay [m, m/s]: the looser tolerance is 1e-11 relative a step, over
# some thousand steps.
REFERENCE = 1e-9


def passive(scene: Scene) -> Trajectory:
    """A plan without inputs: only its grid and start matter to the replay."""
    steps, nq = scene.task.steps, scene.nq
    state = np.tile(np.array(scene.task.start), (steps + 1, 1))
    grid = uniform_grid(scene.task.step, steps)
    return Trajectory(
        t=grid,
        q=state[:, :nq],
        v=state[:, nq:],
        u=np.zeros((steps, scene.nu)),
        lam=np.zeros((steps, scene.nc)),
    )


def driven(scene: Scene, u: np.ndarray) -> Trajectory:
    """The scene's own time step under inputs u (steps, nu): a plan that is consistent with the true contact law."""
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
    return Trajectory(
        t=uniform_grid(scene.task.step, len(u)), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam
    )


def pushes(steps: int = 500) -> np.ndarray:
    """(steps, 2) inputs that bring three carts together twice, with a jump at every step."""
    t = np.arange(steps) * 0.01
    return np.column_stack([1.5 * np.sin(1.3 * t) + 0.6, -1.2 * np.cos(0.9 * t) * np.exp(-0.1 * t)])


def mass_on_a_line() -> Scene:
    """One mass, one input: a double integrator."""
    q, v, u, m = *sp.symbols("q v u", real=True), sp.Symbol("m", positive=True)
    return Scene(
        name="mass_on_a_line", title="One driven mass", source="made up for this test",
        coordinates=(Coordinate(symbol=q, velocity=v, unit="m"),),
        inputs=(Input(symbol=u, unit="N"),),
        parameters=(Parameter(symbol=m, value=2.0, unit="kg", lower=1e-6),),
        kinetic_energy=m * v**2 / 2, potential_energy=sp.Integer(0), forces=(u,), contacts=(),
        task=Task(start=(0.0, 0.0), goal=(1.0, 0.0), running_cost=u**2, step=0.2, steps=6),
        limits=goal_limits(position=0.01, velocity=0.01, reason="this test"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def carts() -> Scene:
    return load_scene("three_cart")


@pytest.fixture(scope="module")
def carts_replay(carts: Scene) -> Replay:
    return replay(carts, build_fmu(carts), driven(carts, pushes()))


def test_a_dropped_mass_meets_the_floor_as_the_closed_form_says():
    scene = load_scene("bouncing_mass")
    answers = {answer.quantity: answer.value for answer in scene.answers}
    result = replay(scene, build_fmu(scene), passive(scene))
    assert result.ok, result.message
    closing, opening = result.events[:2]
    assert (closing.contact, closing.closes, opening.closes) == ("floor", True, False)
    assert closing.time == pytest.approx(answers["time of the first contact [s]"], abs=REFERENCE)
    assert opening.time - closing.time == pytest.approx(answers["contact time [s]"], abs=REFERENCE)
    # The deepest point lies between two recorded points; the parabola through the three deepest
    # finds it.
    i = int(result.gap[:, 0].argmin())
    parabola = np.polyfit(result.t[i - 1 : i + 2] - result.t[i], -result.gap[i - 1 : i + 2, 0], 2)
    assert parabola[2] - parabola[1] ** 2 / (4 * parabola[0]) == pytest.approx(
        answers["largest depth [m]"], rel=1e-6
    )
    flight = result.t < closing.time
    assert result.q[flight, 0] == pytest.approx(
        scene.task.start[0] - 9.81 * result.t[flight] ** 2 / 2, abs=REFERENCE
    )
    assert result.energy == pytest.approx(result.energy[0], rel=1e-9)


def test_a_collision_keeps_momentum_and_energy_and_swaps_speeds():
    scene = load_scene("two_body_collision")
    answers = {answer.quantity: answer.value for answer in scene.answers}
    result = replay(scene, build_fmu(scene), passive(scene))
    assert result.ok, result.message
    assert [event.closes for event in result.events] == [True, False]
    assert result.events[1].time - result.events[0].time == pytest.approx(
        answers["contact time [s]"], abs=REFERENCE
    )
    after = [
        answers[f"velocity of the {which} disc afterwards [m/s]"] for which in ("left", "right")
    ]
    assert result.v[-1] == pytest.approx(np.array(after), abs=REFERENCE)
    assert result.v @ np.array([1.0, 3.0]) == pytest.approx(-1.0, abs=REFERENCE)
    assert result.contact_impulse[-1, 0] == pytest.approx(
        scene.task.start[2] - after[0], abs=REFERENCE
    )


def test_three_carts_replay_to_1e_8_by_two_tolerances(carts_replay: Replay):
    assert carts_replay.ok, carts_replay.message
    error = carts_replay.error
    assert error.estimate == error.tolerance
    assert 0 < error.tolerance.position <= 1e-8
    assert (
        error.everyday.position <= error.tolerance.position
    )  # an independent integrator agrees with the tighter run
    assert len(carts_replay.events) >= 3


def test_the_estimate_bounds_the_error_of_a_loose_replay(carts: Scene, carts_replay: Replay):
    loose = replay(carts, build_fmu(carts), driven(carts, pushes()), tolerances=(1e-6, 1e-8))
    true = np.abs(loose.q[loose.knots] - carts_replay.q[carts_replay.knots]).max()
    assert 1e-10 < true <= loose.error.estimate.position


def test_grid_holds_every_node_and_points_between(carts: Scene, carts_replay: Replay):
    assert carts_replay.t[carts_replay.knots].tolist() == uniform_grid(0.01, 500).tolist()
    assert len(carts_replay.t) == 3 * 500 + 1 + len(carts_replay.events)
    for event in carts_replay.events:
        row = carts_replay.t.tolist().index(event.time)
        contact = [item.name for item in carts.contacts].index(event.contact)
        assert abs(carts_replay.gap[row, contact]) < 1e-12
    assert carts_replay.lam == pytest.approx(30.0 * np.maximum(-carts_replay.gap, 0.0), abs=1e-9)


def test_a_grid_of_unequal_steps_is_followed():
    scene = mass_on_a_line()
    t = np.array([1.0, 1.3, 1.35, 2.0])
    u = np.array([[2.0], [-4.0], [1.0]])
    plan = Trajectory(t=t, q=np.zeros((4, 1)), v=np.zeros((4, 1)), u=u, lam=np.zeros((3, 0)))
    result = replay(scene, build_fmu(scene), plan)
    q = v = 0.0
    for h, force in zip(np.diff(t), u[:, 0], strict=True):
        q, v = q + h * v + force / 2 * h**2 / 2, v + force / 2 * h
    assert result.q[-1, 0] == pytest.approx(q, abs=1e-11)
    assert result.error.everyday.position < 1e-11


@pytest.mark.slow
def test_a_start_that_already_touches_is_in_contact_from_the_first_moment():
    """A mass pressed on a spring wall."""
    free = replace(poised(), potential_energy=sp.Integer(0)).with_parameters(k=100.0)
    scene = free.with_task(start=(0.02, 0.0), goal=(0.02, 0.0), step=0.1, steps=5)
    resting = replay(scene, build_fmu(scene), driven(scene, np.full((5, 1), 2.0)))
    assert resting.q[:, 0] == pytest.approx(0.02, abs=1e-12)
    assert resting.events == ()
    touching = scene.with_task(start=(0.0, 0.0))
    pushed = replay(touching, build_fmu(touching), driven(touching, np.full((5, 1), 1.0)))
    assert pushed.q[:, 0] == pytest.approx(0.01 * (1 - np.cos(10 * pushed.t)), abs=1e-10)
