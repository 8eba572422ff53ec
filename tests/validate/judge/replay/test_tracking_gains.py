"""Tracking gains against other people's Riccati solver and by hand, growth against closed forms, the law in other units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.linalg import solve_discrete_are

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact
from models.scene.parts import goal_limits
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay.tracking import (
    FlowDerivative,
    TrackingError,
    design_feedback,
    input_scale,
    largest_growth,
    lqr_gains,
    measure_growth,
)
from validate.judge.replay.wiring import Feedback, measure_effort


def test_far_from_the_end_the_gains_are_those_of_the_algebraic_riccati_equation():
    random = np.random.default_rng(5)
    A, B = random.normal(size=(4, 4)), random.normal(size=(4, 2))
    Q, R = random.uniform(0.5, 2.0, 4), random.uniform(0.5, 2.0, 2)
    K = lqr_gains(np.tile(A, (200, 1, 1)), np.tile(B, (200, 1, 1)), Q, R, 7.0 * Q)
    P = solve_discrete_are(A, B, np.diag(Q), np.diag(R))
    stationary = np.linalg.solve(np.diag(R) + B.T @ P @ B, B.T @ P @ A)
    assert np.abs(K[0] - stationary).max() < 1e-9 * np.abs(stationary).max()
    assert np.abs(np.linalg.eigvals(A - B @ K[0])).max() < 1.0 < np.abs(np.linalg.eigvals(A)).max()


def test_the_last_gain_is_the_least_squares_of_one_step():
    """min over u of R u^2 + |A x + B u|^2 in the end's weight: K = B' Q_T A / (R + B' Q_T B)."""
    A, B, end = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]), np.array([3.0, 5.0])
    K = lqr_gains(A[None], B[None], np.ones(2), np.array([2.0]), end)
    by_hand = (B.T * end) @ A / (2.0 + (B.T * end) @ B)
    assert K[0] == pytest.approx(by_hand, rel=1e-14)


def test_gains_that_overflow_are_refused():
    with pytest.raises(TrackingError, match="overflow"):
        lqr_gains(np.full((400, 1, 1), 1e6), np.zeros((400, 1, 1)), np.ones(1), np.ones(1), np.ones(1))


def test_gains_that_rounding_loses_are_refused():
    """Two inputs that do the same, on an end that weighs 1e40: their own weights are lost beside it, and the equations are singular."""
    with pytest.raises(TrackingError, match="lost to rounding at step 0"):
        lqr_gains(np.eye(2)[None], np.ones((1, 2, 2)), np.ones(2), np.ones(2), np.full(2, 1e40))


def test_a_scale_is_half_the_bounds_or_the_largest_value():
    u = np.array([[1.0, -3.0, 0.0], [2.0, 1.0, 0.0]])
    assert input_scale(np.array([-4.0, -np.inf, -np.inf]), np.array([6.0, np.inf, 1.0]), u).tolist() == [5.0, 3.0, 1.0]


def test_the_growth_of_a_constant_system_is_that_of_its_power():
    """x' = a^2 x about an unstable rest: the largest singular value of the whole transition, from the start to the end."""
    rate, h, steps = 3.0, 0.01, 100
    c, s = np.cosh(rate * h), np.sinh(rate * h)
    A = np.array([[c, s / rate], [rate * s, c]])
    growth = largest_growth(np.tile(A, (steps, 1, 1)), h * np.arange(steps + 1), np.ones(2))
    assert growth is not None
    assert growth.amplification == pytest.approx(np.linalg.norm(np.linalg.matrix_power(A, steps), 2), rel=1e-12)
    assert (growth.begin, growth.end) == (0.0, 1.0)
    assert np.exp(growth.rate * growth.duration) == pytest.approx(growth.amplification)
    assert rate < growth.rate < rate + 1.0  # of the norm, a little more than the exponent for a state in other units


def test_the_growth_does_not_depend_on_units():
    A = np.array([[1.1, 0.1], [0.3, 1.2]])
    S = np.array([1e3, 1e-2])
    steps, times = np.tile(A, (10, 1, 1)), np.arange(11.0)
    scaled = steps * (S[None, :, None] / S[None, None, :])
    one, other = largest_growth(steps, times, np.ones(2)), largest_growth(scaled, times, S)
    assert one is not None
    assert other is not None
    assert one.amplification == pytest.approx(other.amplification, rel=1e-10)


def _growth_at_rest(name: str) -> float:
    """[1/s] of a plan that only stands upright, without inputs."""
    scene = load_scene(name)
    steps = scene.task.steps
    still = np.zeros((steps + 1, scene.nq))
    plan = Trajectory(
        t=uniform_grid(scene.task.step, steps), q=still, v=still, u=np.zeros((steps, scene.nu)), lam=np.zeros((steps, scene.nl))
    )
    growth = measure_growth(load_kernel(scene), scene, plan)
    assert growth is not None
    return growth.rate


@pytest.mark.parametrize("name", ["cart_pole_walls", "acrobot_limits"])
def test_a_scene_that_balances_grows_at_its_known_rate(name: str):
    """About upright; the norm of the transition exceeds exp(rate T) by a factor that the horizon divides in its logarithm."""
    scene = load_scene(name)
    rate = max(answer.value for answer in scene.answers if "growth rate" in answer.quantity)
    found = _growth_at_rest(name)
    assert rate * 0.97 < found < rate + 2.0 / scene.task.horizon


def test_free_masses_do_not_grow():
    scene = load_scene("three_cart")
    q = np.tile([0.0, 5.0, 10.0], (501, 1))
    plan = Trajectory(t=uniform_grid(0.01, 500), q=q, v=0.0 * q, u=np.zeros((500, 2)), lam=np.zeros((500, 2)))
    growth = measure_growth(load_kernel(scene), scene, plan)
    assert growth is not None
    assert growth.amplification < 10.0


def poised() -> Scene:
    """A mass that a field drives from x = 0, at rest where it just touches a stiff wall: free, an error grows as exp(4 t), held, as the wall's frequency."""
    x, v, push = sp.symbols("x v push", real=True)
    k = sp.Symbol("k", positive=True)
    return Scene(
        name="poised",
        title="A mass on the edge of a wall",
        source="own",
        coordinates=(Coordinate(symbol=x, velocity=v, unit="m"),),
        inputs=(Input(symbol=push, unit="N", lower=-10.0, upper=10.0),),
        parameters=(Parameter(symbol=k, value=4e4, unit="N/m"),),
        kinetic_energy=v**2 / 2,
        potential_energy=-8 * x**2,
        forces=(push,),
        contacts=(
            Contact(name="wall", bodies=("mass", "wall"), depth=1.0, depth_reason="nothing here goes as deep", penetration=x, stiffness=k),
        ),
        task=Task(start=(0.0, 0.0), goal=(0.0, 0.0), running_cost=push**2, step=0.005, steps=400),
        limits=goal_limits(position=0.01, velocity=0.01, reason="this test"),
    )


def test_a_plan_on_an_edge_grows_as_the_side_that_rounding_says():
    """Two plans nobody can tell apart, one a hair inside the wall, where nothing grows but by its frequency, the other a hair outside: so growth
    explains a verdict, and decides none."""
    scene = poised()
    kernel = load_kernel(scene)
    states = np.zeros((401, 1))
    plan = Trajectory(t=uniform_grid(0.005, 400), q=states, v=states, u=np.zeros((400, 1)), lam=np.zeros((400, 1)))

    def amplification(depth: float) -> float:
        held = np.full((400, 1), (4e4 - 16.0) * depth if depth > 0 else -16.0 * depth)
        force = np.full((400, 1), max(0.0, 4e4 * depth))
        growth = measure_growth(kernel, scene, replace(plan, q=np.full((401, 1), depth), u=held, lam=force))
        assert growth is not None
        return growth.amplification

    assert amplification(-2e-9) > 1000.0  # exp(4 t) over two seconds
    for depth in (2e-9, 1e-3):
        assert 100.0 < amplification(depth) < 400.0  # a place times the frequency of 200 1/s is a speed


def test_steps_are_linearised_in_the_contact_that_is_closed():
    """Finite differences of the true motion, before, in and after contact."""
    scene = load_scene("wall_pendulum")
    kernel = load_kernel(scene)
    for state in ([0.05, 0.3], [0.2, -0.4], [0.0995, 0.9]):
        u = np.full((10, 1), 0.7)
        A, B = FlowDerivative(kernel, 10).at(np.array(state), u, 1e-3)

        def end(x: np.ndarray, w: float) -> np.ndarray:
            rollout = kernel.rollout(x, np.full((10, 1), w), 1e-3)
            return np.concatenate([rollout.q[-1], rollout.v[-1]])

        d = 1e-7
        for column, step in enumerate(np.eye(2) * d):
            assert A[:, column] == pytest.approx((end(state + step, 0.7) - end(state - step, 0.7)) / (2 * d), abs=1e-6)
        assert B[:, 0] == pytest.approx((end(np.array(state), 0.7 + d) - end(np.array(state), 0.7 - d)) / (2 * d), abs=1e-6)


def test_nothing_to_steer_with_is_refused():
    scene = load_scene("bouncing_mass")
    still = np.zeros((3, scene.nq))
    plan = Trajectory(t=uniform_grid(0.1, 2), q=still, v=still, u=np.zeros((2, 0)), lam=np.zeros((2, 1)))
    with pytest.raises(TrackingError, match="no inputs"):
        design_feedback(load_kernel(scene), scene, plan)


def _law() -> Feedback:
    random = np.random.default_rng(2)
    return Feedback(
        gains=random.normal(size=(3, 2, 4)), reference=random.normal(size=(4, 4)), u=random.normal(size=(3, 2)),
        lower=np.array([-1.0, -np.inf]), upper=np.array([0.5, np.inf]), scale=np.array([0.75, 3.0]),
    )  # fmt: skip


def test_the_law_is_the_same_in_other_units():
    law, random = _law(), np.random.default_rng(3)
    a, b, c, d = random.uniform(1e-3, 2.0, 4), random.normal(size=4), np.array([-1e-3, 2.0]), random.normal(size=2)
    other = law.in_units((a, b), (c, d))
    for step in range(3):
        state = random.normal(size=4)
        assert other.at(step, (state - b) / a) == pytest.approx(c * law.at(step, state) + d, rel=1e-12)


def test_the_effort_is_weighed_with_the_length_of_the_steps():
    law, t = _law(), np.array([0.0, 1.0, 4.0, 5.0])
    plan_u = np.zeros((3, 2))
    applied = np.array([[0.3, 0.0], [0.0, 3.0], [0.5, 0.0]])
    effort = measure_effort(plan_u, applied, t, law)
    assert effort.rms == pytest.approx((np.sqrt((0.09 + 0.25) / 5), np.sqrt(9.0 * 3 / 5)))
    assert effort.peak == (0.5, 3.0)
    assert effort.rms_share == pytest.approx(np.sqrt(27 / 5) / 3)
    assert effort.saturated == pytest.approx(1 / 3)  # 0.5 is a bound, and not what the plan asked for


def test_many_uneven_steps_are_taken_in_blocks():
    """Three thousand steps of a rotation with growth: the whole of it, at the cost of fifty products."""
    random = np.random.default_rng(9)
    h = random.uniform(0.5e-3, 1.5e-3, 3000)
    t = np.concatenate([[0.0], np.cumsum(h)])
    turn = np.array([[np.cos(5.0 * h), -np.sin(5.0 * h)], [np.sin(5.0 * h), np.cos(5.0 * h)]]).transpose(2, 0, 1)
    growth = largest_growth(np.exp(2.0 * h)[:, None, None] * turn, t, np.ones(2))
    assert growth is not None
    assert growth.amplification == pytest.approx(np.exp(2.0 * t[-1]), rel=1e-10)
    assert growth.rate == pytest.approx(2.0)
