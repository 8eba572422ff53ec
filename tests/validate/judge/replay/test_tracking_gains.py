"""Tracking gains against other people's Riccati solver and by hand, growth against closed forms, the law in other units."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.linalg import expm, solve_discrete_are

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact
from models.scene.parts import goal_limits
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay import tracking as module
from validate.judge.replay.tracking import (
    TrackingError,
    design_feedback,
    input_scale,
    largest_growth,
    lqr_gains,
    measure_growth,
)
from validate.processes.isolated import unpacked_from


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
        lqr_gains(
            np.full((400, 1, 1), 1e6), np.zeros((400, 1, 1)), np.ones(1), np.ones(1), np.ones(1)
        )


def test_gains_that_rounding_loses_are_refused():
    """Two inputs that do the same, on an end that weighs 1e40: their own weights are lost beside it, and the equations are singular."""
    with pytest.raises(TrackingError, match="lost to rounding at step 0"):
        lqr_gains(np.eye(2)[None], np.ones((1, 2, 2)), np.ones(2), np.ones(2), np.full(2, 1e40))


def test_a_scale_is_half_the_bounds_or_the_largest_value():
    u = np.array([[1.0, -3.0, 0.0], [2.0, 1.0, 0.0]])
    assert input_scale(
        np.array([-4.0, -np.inf, -np.inf]), np.array([6.0, np.inf, 1.0]), u
    ).tolist() == [5.0, 3.0, 1.0]


def test_the_growth_of_a_constant_system_is_that_of_its_power():
    """x'' = a^2 x about an unstable rest: cosh(a t) of the whole transition, from the start to the end, whatever the unit of time."""
    rate, h, steps = 3.0, 0.01, 100
    c, s = np.cosh(rate * h), np.sinh(rate * h)
    A = np.array([[c, s / rate], [rate * s, c]])
    growth = largest_growth(np.tile(A, (steps, 1, 1)), h * np.arange(steps + 1), np.ones(2))
    assert growth.amplification == pytest.approx(np.cosh(rate), rel=1e-12)
    assert (growth.begin, growth.end) == (0.0, 1.0)
    assert np.exp(growth.rate * growth.duration) == pytest.approx(growth.amplification)
    assert rate - np.log(2.0) < growth.rate < rate  # half of an error of the position dies out


@pytest.mark.parametrize("frequency", [0.03, 3.0, 300.0])
def test_what_swings_does_not_grow_however_stiff_it_is(frequency: float):
    """A place becomes a speed, `frequency` times as much, and the place again."""
    h = 0.01
    c, s = np.cos(frequency * h), np.sin(frequency * h)
    swing = np.array([[c, s / frequency], [-frequency * s, c]])
    growth = largest_growth(np.tile(swing, (100, 1, 1)), h * np.arange(101), np.array([0.2, 0.2]))
    assert 0.9 < growth.amplification < 1.0 + 1e-9


def test_the_growth_does_not_depend_on_units():
    A = np.array([[1.1, 0.1], [0.3, 1.2]])
    S = np.array([1e3, 1e-2])
    steps, times = np.tile(A, (10, 1, 1)), np.arange(11.0)
    scaled = steps * (S[None, :, None] / S[None, None, :])
    one, other = largest_growth(steps, times, np.ones(2)), largest_growth(scaled, times, S)
    assert one.amplification == pytest.approx(other.amplification, rel=1e-10)


@pytest.mark.parametrize("name", ["cart_pole_walls", "acrobot_limits"])
def test_a_scene_that_balances_grows_at_its_known_rate(name: str):
    """About upright, without inputs.

    The gain from positions to positions is exp(rate T) but for a factor, whose logarithm the
    horizon divides.
    """
    scene = load_scene(name)
    rate = max(answer.value for answer in scene.answers if "growth rate" in answer.quantity)
    steps = scene.task.steps
    still, u, lam = (
        np.zeros((steps + 1, scene.nq)),
        np.zeros((steps, scene.nu)),
        np.zeros((steps, scene.nl)),
    )
    found = measure_growth(
        load_kernel(scene),
        scene,
        Trajectory(t=uniform_grid(scene.task.step, steps), q=still, v=still, u=u, lam=lam),
    )
    assert rate - 2.0 / scene.task.horizon < found.rate < rate + 2.0 / scene.task.horizon


def poised() -> Scene:
    """A mass that a field drives from x = 0, at rest where it just touches a stiff wall: free, an error grows as exp(4 t), held, it swings."""
    x, v, push = sp.symbols("x v push", real=True)
    k = sp.Symbol("k", positive=True)
    return Scene(
        name="poised", title="A mass on the edge of a wall", source="own",
        coordinates=(Coordinate(symbol=x, velocity=v, unit="m"),),
        inputs=(Input(symbol=push, unit="N", lower=-10.0, upper=10.0),),
        parameters=(Parameter(symbol=k, value=4e4, unit="N/m"),),
        kinetic_energy=v**2 / 2, potential_energy=-8 * x**2, forces=(push,),
        contacts=(Contact(name="wall", bodies=("mass", "wall"), depth=1.0,
                          depth_reason="nothing here goes as deep", penetration=x, stiffness=k),),
        task=Task(start=(0.0, 0.0), goal=(0.0, 0.0), running_cost=push**2, step=0.005, steps=400),
        limits=goal_limits(position=0.01, velocity=0.01, reason="this test"),
    )  # fmt: skip


def test_a_plan_on_an_edge_grows_as_the_side_that_rounding_says():
    """Two plans nobody can tell apart, one a hair inside the wall, where nothing grows, the other a hair outside: so growth
    explains a verdict, and decides none.
    """
    scene = poised()
    kernel = load_kernel(scene)
    states = np.zeros((401, 1))
    plan = Trajectory(
        t=uniform_grid(0.005, 400), q=states, v=states, u=np.zeros((400, 1)), lam=np.zeros((400, 1))
    )

    def amplification(depth: float) -> float:
        held = np.full((400, 1), (4e4 - 16.0) * depth if depth > 0 else -16.0 * depth)
        force = np.full((400, 1), max(0.0, 4e4 * depth))
        growth = measure_growth(
            kernel, scene, replace(plan, q=np.full((401, 1), depth), u=held, lam=force)
        )
        return growth.amplification

    assert amplification(-2e-9) > 1000.0  # exp(4 t) over two seconds
    for depth in (2e-9, 1e-3):
        assert (
            amplification(depth) < 2.0
        )  # it swings with 200 1/s, in steps of its whole period over six


@pytest.mark.parametrize("frequency", [500.0, 3e4])
def test_what_hits_a_stiff_wall_does_not_grow(frequency: float):
    """It comes back from a spring as it came, between two rows: an error of its place is as large as before. Steps of the plan are unstable in such contact."""
    push, k = sp.Symbol("push", real=True), sp.Symbol("k", positive=True)
    scene = replace(
        poised(), name="hit", potential_energy=sp.Integer(0),
        parameters=(Parameter(symbol=k, value=frequency**2, unit="N/m"),),
        task=Task(start=(-0.2615, 1.0), goal=(0.0, 0.0), running_cost=push**2, step=0.01, steps=50),
    )  # fmt: skip
    t = uniform_grid(0.01, 50)
    late = t - 0.2615 - np.pi / frequency
    place = np.where(
        t < 0.2615,
        t - 0.2615,
        np.where(late < 0.0, np.sin(frequency * (t - 0.2615)) / frequency, -late),
    )
    speed = np.where(t < 0.2615, 1.0, np.where(late < 0.0, np.cos(frequency * (t - 0.2615)), -1.0))
    plan = Trajectory(
        t=t, q=place[:, None], v=speed[:, None], u=np.zeros((50, 1)), lam=np.zeros((50, 1))
    )
    growth = measure_growth(load_kernel(scene), scene, plan)
    if frequency < 1e3:
        assert growth.amplification == pytest.approx(1.0, abs=0.2)
    else:
        assert growth is None or growth.amplification < 1.2, (
            "either it is measured, or nothing is claimed"
        )


def test_steps_are_linearised_in_the_contact_that_is_closed():
    """Finite differences of the true motion, before, in and after contact."""
    scene = load_scene("wall_pendulum")
    kernel = load_kernel(scene)
    for state in ([0.05, 0.3], [0.2, -0.4], [0.0995, 0.9]):
        u = np.full((10, 1), 0.7)
        A, B = kernel.end_derivatives(np.array(state), u, 1e-3)

        def end(x: np.ndarray, w: float) -> np.ndarray:
            rollout = kernel.rollout(x, np.full((10, 1), w), 1e-3)
            return np.concatenate([rollout.q[-1], rollout.v[-1]])

        d = 1e-7
        for column, step in enumerate(np.eye(2) * d):
            assert A[:, column] == pytest.approx(
                (end(state + step, 0.7) - end(state - step, 0.7)) / (2 * d), abs=1e-6
            )
        assert B[:, 0] == pytest.approx(
            (end(np.array(state), 0.7 + d) - end(np.array(state), 0.7 - d)) / (2 * d), abs=1e-6
        )


def test_nothing_to_steer_with_is_refused():
    scene = load_scene("bouncing_mass")
    still = np.zeros((3, scene.nq))
    plan = Trajectory(
        t=uniform_grid(0.1, 2), q=still, v=still, u=np.zeros((2, 0)), lam=np.zeros((2, 1))
    )
    with pytest.raises(TrackingError, match="no inputs"):
        design_feedback(load_kernel(scene), scene, plan)


def test_many_uneven_steps_are_taken_in_blocks():
    """Three thousand steps in which two positions turn and grow, and so do their velocities: the whole of it, at the cost of fifty products."""
    random = np.random.default_rng(9)
    h = random.uniform(0.5e-3, 1.5e-3, 3000)
    t = np.concatenate([[0.0], np.cumsum(h)])
    turn = np.array(
        [[np.cos(5.0 * h), -np.sin(5.0 * h)], [np.sin(5.0 * h), np.cos(5.0 * h)]]
    ).transpose(2, 0, 1)
    growth = largest_growth(
        np.exp(2.0 * h)[:, None, None] * np.kron(np.eye(2), turn), t, np.ones(4)
    )
    assert growth.amplification == pytest.approx(np.exp(2.0 * t[-1]), rel=1e-10)
    assert growth.rate == pytest.approx(2.0)


def subject(goal: tuple[float | None, ...]) -> Any:
    """Positions of 2 m and of 0.5 rad; one input within -3 and 5 N, one without bounds."""
    return SimpleNamespace(
        coordinates=[SimpleNamespace(nominal=2.0), SimpleNamespace(nominal=0.5)],
        task=SimpleNamespace(goal=goal),
        inputs=[SimpleNamespace(lower=-3.0, upper=5.0),
                SimpleNamespace(lower=-np.inf, upper=np.inf)],
    )  # fmt: skip


def test_weights_are_nominals_scales_and_at_the_end_all_steps_but_for_what_is_free(
    monkeypatch: pytest.MonkeyPatch,
):
    asked: list[Any] = []
    gains = np.full((3, 2, 4), 0.25)
    monkeypatch.setattr(
        module,
        "lqr_gains",
        lambda *given: asked.append([np.asarray(part).tolist() for part in given]) or gains,
    )
    states = np.arange(8.0).reshape(4, 2)
    plan = Trajectory(
        t=uniform_grid(0.1, 3),
        q=states,
        v=-states,
        u=np.array([[1.0, -7.0], [2.0, 3.0], [0.0, 0.0]]),
        lam=np.zeros((3, 0)),
    )
    law = module.feedback_from(
        subject((1.0, None, None, 0.0)), plan, np.ones((3, 4, 4)), np.ones((3, 4, 2))
    )
    weight = [0.25, 4.0, 0.25, 4.0]
    assert asked[0][2:] == [weight, [1 / 16, 1 / 49], [3 * 0.25, 4.0, 0.25, 3 * 4.0]]
    assert law.gains is gains
    assert (law.lower.tolist(), law.upper.tolist(), law.scale.tolist()) == (
        [-3.0, -np.inf],
        [5.0, np.inf],
        [4.0, 7.0],
    )
    assert law.reference[1].tolist() == [2.0, 3.0, -2.0, -3.0]
    assert law.u is plan.u


def test_an_fmu_is_linearised_in_its_units_and_told_in_the_plans(monkeypatch: pytest.MonkeyPatch):
    """x = 2 X + 1 and v = 4 V - 1; U = 10 u + 5: A of (v by x) times 4/2, B of x times 2 * 10."""
    asked: list[Any] = []
    A, B = np.array([[[1.0, 2.0], [3.0, 4.0]]]), np.array([[[5.0], [6.0]]])

    def linearised(
        package: Any, variables: Any, plan: Trajectory, start: Any, states: np.ndarray, limits: Any
    ) -> Any:
        asked.append((package, variables, plan.u.tolist(), start, states.tolist(), limits))
        return A, B

    monkeypatch.setattr(module, "linearised", linearised)
    monkeypatch.setattr(module, "feedback_from", lambda *given: given)
    monkeypatch.setattr(module, "largest_growth", lambda *given: given)
    plan = Trajectory(
        t=np.array([0.0, 0.5]),
        q=np.array([[3.0], [5.0]]),
        v=np.array([[7.0], [3.0]]),
        u=np.array([[2.0]]),
        lam=np.zeros((1, 0)),
    )
    model: Any = SimpleNamespace(coordinates=[SimpleNamespace(nominal=0.25)])
    units = (np.array([2.0, 4.0]), np.array([1.0, -1.0])), (np.array([10.0]), np.array([5.0]))
    foreign: Any = SimpleNamespace(model=model, variables="variables", units=units, start="start")
    (given_model, given_plan, a, b), (steps, t, sizes) = module.design_foreign(
        foreign, "package", plan, "limits"
    )
    assert asked == [
        ("package", "variables", [[25.0]], "start", [[1.0, 2.0], [2.0, 1.0]], "limits")
    ]
    assert (given_model, given_plan, a.tolist(), b.tolist()) == (
        model,
        plan,
        [[[1.0, 1.0], [6.0, 4.0]]],
        [[[100.0], [240.0]]],
    )
    assert (steps is a, t is plan.t, sizes.tolist()) == (True, True, [0.25, 0.25])
    with pytest.raises(TrackingError, match="does not say its positions"):
        module.design_foreign(
            foreign, "package", replace(plan, missing=frozenset({"q", "v"})), "limits"
        )


def test_a_step_of_an_fmu_is_the_exponential_of_the_mean_of_its_ends(
    monkeypatch: pytest.MonkeyPatch,
):
    """x' = v, v' = a x + b u with a from 1 to 3 within the step."""
    first, last = (
        np.array([[[0.0, 1.0, 0.0], [1.0, 0.0, 4.0]]]),
        np.array([[[0.0, 1.0, 0.0], [3.0, 0.0, 6.0]]]),
    )
    mean = np.array([[0.0, 1.0, 0.0], [2.0, 0.0, 5.0], [0.0, 0.0, 0.0]])
    plan = Trajectory(
        t=np.array([1.0, 1.25]),
        q=np.zeros((2, 1)),
        v=np.zeros((2, 1)),
        u=np.array([[7.0]]),
        lam=np.zeros((1, 0)),
    )
    variables: Any = "variables"
    fmu: Any = SimpleNamespace(path=Path("a.fmu"))
    states, asked = np.array([[1.0, 2.0], [3.0, 4.0]]), []
    monkeypatch.setattr(module, "tracking_refusal", lambda package, variables: None)

    def isolated(function: str, request: Any, given: Any, *, limits: Any, what: str) -> Any:
        asked.append((request, given))
        return SimpleNamespace(
            ok=function == "validate.judge.replay.tracking:jacobians"
            and limits == "limits"
            and what == "FMU a.fmu",
            arrays={"first": first, "last": last},
            sentence="it crashed.",
        )

    monkeypatch.setattr(module, "run_isolated", isolated)
    A, B = module.linearised(fmu, variables, plan, "start", states, "limits")  # type: ignore[arg-type]
    whole = expm(0.25 * mean)
    assert A[0] == pytest.approx(whole[:2, :2], rel=1e-12)
    assert B[0] == pytest.approx(whole[:2, 2:], rel=1e-12)
    for request, given in asked:
        assert (request, unpacked_from(given)) == (str(Path("a.fmu").resolve()), ("variables",))
        assert (
            given["t"] is plan.t,
            given["u"] is plan.u,
            given["start"],
            given["states"] is states,
        ) == (True, True, "start", True)
    with pytest.raises(TrackingError, match=r"it crashed\."):
        module.linearised(fmu, variables, plan, "start", states, "other")  # type: ignore[arg-type]
    last[0, 1, 0] = np.nan
    with pytest.raises(TrackingError, match="a directional derivative is not a finite number"):
        module.linearised(fmu, variables, plan, "start", states, "limits")  # type: ignore[arg-type]
    monkeypatch.setattr(module, "tracking_refusal", lambda package, variables: "it has no inputs")
    with pytest.raises(TrackingError, match=r"FMU a\.fmu: .*cannot be tracked.*no inputs\."):
        module.linearised(fmu, variables, plan, "start", states, "limits")  # type: ignore[arg-type]


def test_the_largest_growth_is_that_of_the_piece_where_it_is_largest():
    """1/2, 4, 3, 1/8 in a row: 12 from the second node to the fourth."""
    steps = np.array([0.5, 4.0, 3.0, 0.125])[:, None, None] * np.eye(2)
    growth = largest_growth(steps, np.array([1.0, 1.5, 2.5, 4.0, 8.0]), np.array([3.0, 0.1]))
    assert (growth.amplification, growth.begin, growth.end, growth.duration) == (
        pytest.approx(12.0),
        1.5,
        4.0,
        7.0,
    )
    assert growth.rate == pytest.approx(np.log(12.0) / 7.0)
    assert (
        largest_growth(
            steps * np.array([1.0, 1e200, 1e200, 1.0])[:, None, None], np.arange(5.0), np.ones(2)
        )
        is None
    )
    assert module._edges(120).tolist()[:3] == [0, 2, 5]
    assert (len(module._edges(120)), module._edges(120)[-1], module._edges(3).tolist()) == (
        51,
        120,
        [0, 1, 2, 3],
    )


@pytest.mark.parametrize(
    ("found", "expected", "asked", "stable"),
    [
        ([5.0, 2.0, 2.0], 2.0, [1, 8, 64], 1.0), ([1e3, 1e5, 1e2, 1e4], None, [1, 8, 64, 512], 1.0),
        ([9.0, 2.4, 2.0], 2.0, [1, 8, 64], 1.0), ([None, 2.0, 1.9], 1.9, [1, 8, 64], 1.0),
        ([0.5, 0.01], 0.01, [1, 8], 1.0), ([None] * 4, None, [1, 8, 64, 512], 1.0),
        ([3.0, 3.0], 3.0, [40, 320], 0.01), ([3.0, 30.0], None, [40, 320], 0.01),
    ],
)  # fmt: skip
def test_a_growth_counts_once_smaller_steps_give_the_same(
    found, expected, asked, stable, monkeypatch
):
    """Of a plan that declares no scheme; one that does is asked once."""
    rest, parts_asked = iter(found), []

    def growth(parts: int, kernel: Any, scene: Any, plan: Any) -> Any:
        parts_asked.append(parts)
        value = next(rest)
        return None if value is None else SimpleNamespace(amplification=value)

    monkeypatch.setattr(module, "_growth_in", growth)
    monkeypatch.setattr(
        module, "step_stability", lambda scene: SimpleNamespace(largest_step=stable)
    )
    monkeypatch.setattr(module, "_MOST", 2000)
    answer = measure_growth(
        None,
        None,
        SimpleNamespace(scheme=None, t=np.array([0.0, 0.1]), steps=1 if stable < 0.1 else 3),
    )
    assert (None if answer is None else answer.amplification, parts_asked) == (expected, asked)
    declared = iter([7.0])
    monkeypatch.setattr(module, "_growth_in", lambda parts, *given: (parts, next(declared)))
    assert measure_growth(None, None, SimpleNamespace(scheme="euler")) == (1, 7.0)  # type: ignore[arg-type,comparison-overlap]
