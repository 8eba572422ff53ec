"""Scenes without inertia: plans are made of v' = D^-1 F, and judged by D v = F in continuous time, whatever their grid.

The first-order model is written here once more by hand (`rates`). Its friction is that which stops
the slip, or all of mu N: v is then a continuous function of q, and an explicit method of order 8
follows it through sticking, slipping and contact.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pyomo.environ as pyo
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from formulations.transcription.build import build_model
from formulations.transcription.contact import ContactFormulation as ExactLaw
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.errors import SceneError
from models.fmu import build_fmu
from models.fmu.variables import variable_table
from models.scene import Parameter, Scene
from models.scene.quasi_static import LAG
from models.scenes.push_box import mean_distance
from models.stability import step_stability
from models.trajectory import Trajectory
from validate.judge.replay import Replay
from validate.judge.replay.run import replay

A = 0.5
B = 0.25
D = 10.0
BETA = 20.0
K = 150.0
MU = 0.5
DRAG = D * np.array([1.0, 1.0, mean_distance(A, B) ** 2, 1.0, 1.0])


@cache
def scene() -> Scene:
    return load_scene("push_box")


def with_a_mass(step: float) -> Scene:
    """As the scene was: a mass m = h d beside the drag."""
    now = scene().with_task(step=step)
    m, symbol = sp.Symbol("m", positive=True), {item.name: item.symbol for item in now.parameters}
    others = tuple(item for item in now.parameters if item.symbol != now.relaxation_time)
    parameters = (*others[:4], Parameter(symbol=m, value=step * D, unit="kg"), *others[4:])
    energy = sp.expand(now.kinetic_energy / (now.relaxation_time * symbol["d"])) * m
    return replace(now, relaxation_time=None, kinetic_energy=energy, parameters=parameters)


def pushing(steps: int = 100) -> np.ndarray:
    """(steps, 2) inputs [N] over 2 s: to the left face, along it sticking and slipping, off again, and against the face below."""
    t = (np.arange(steps) + 0.5) * 2.0 / steps
    u = np.zeros((steps, 2))
    u[t < 0.3] = (5.0, 12.0)
    u[(t >= 0.3) & (t < 0.9)] = (5.0, 1.0)
    u[(t >= 0.9) & (t < 1.3)] = (4.0, -3.5)
    u[(t >= 1.3) & (t < 1.6)] = (-4.0, -8.0)
    u[t >= 1.6] = (9.0, 7.0)
    return u


def plan_of(u: np.ndarray, step: float) -> Trajectory:
    run = load_kernel(scene()).rollout(np.array(scene().task.start), u, step)
    return Trajectory(t=np.arange(len(u) + 1) * step, q=run.q, v=run.v, u=u, lam=run.lam)


@cache
def replayed(steps: int, lag: float = LAG, task_step: float = 0.02) -> Replay:
    of = scene().with_task(step=task_step, steps=round(2.0 / task_step))
    u = np.repeat(pushing(), steps // 100, axis=0)
    return replay(of.continuous(lag), build_fmu(of), plan_of(u, 2.0 / steps), track=False)


def rates(q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float, float]:
    """v = D^-1 (F + J' lam + S' f), lam and f."""
    x, y, theta, p_x, p_y = q
    c, s = math.cos(theta), math.sin(theta)
    turn, arm = np.array([[c, -s], [s, c]]), np.array([p_x - x, p_y - y])
    along, across = turn.T @ arm
    exponents = BETA * np.array([along - A, -along - A, across - B, -across - B])
    weights = np.exp(exponents - exponents.max())
    gap = (exponents.max() + math.log(weights.sum())) / BETA
    weights /= weights.sum()
    normal = np.array([weights[0] - weights[1], weights[2] - weights[3]])

    def on_the_finger(force: np.ndarray) -> np.ndarray:
        """Generalised force of one on the finger, given in the frame of the box, and its reaction."""
        f = turn @ force
        return np.array([-f[0], -f[1], -(arm[0] * f[1] - arm[1] * f[0]), f[0], f[1]])

    lam = K * max(-gap, 0.0)
    pushes, rubs = on_the_finger(normal), on_the_finger(np.array([-normal[1], normal[0]]))
    force = np.array([0.0, 0.0, 0.0, *u]) + lam * pushes
    f = (
        float(np.clip(-(rubs @ (force / DRAG)) / (rubs @ (rubs / DRAG)), -MU * lam, MU * lam))
        if lam > 0
        else 0.0
    )
    return (force + f * rubs) / DRAG, lam, f


@cache
def by_hand() -> tuple[np.ndarray, frozenset[str]]:
    """(101, 5) positions under `pushing`, and what happened on the way."""
    q, seen = [np.array(scene().task.start[:5])], set()
    for u in pushing():
        found = solve_ivp(
            lambda _, y, u=u: rates(y, u)[0],
            (0.0, 0.02),
            q[-1],
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
            max_step=2e-3,
        )
        q.append(found.y[:, -1])
        _, lam, f = rates(q[-1], u)
        seen.add("apart" if lam == 0 else "slips" if abs(f) >= MU * lam * (1 - 1e-9) else "sticks")
    return np.array(q), frozenset(seen)


@pytest.mark.slow
def test_plans_are_those_of_a_mass_made_of_the_time_step() -> None:
    """Kernel, its derivatives and single steps to the last bit, at the task's step and at another.

    Pyomo's equations to rounding.
    """
    u = np.random.default_rng(0).uniform(-5.0, 20.0, size=(100, 2))
    start = np.array(scene().task.start)
    for step in (0.02, 0.005):
        before, now = load_kernel(with_a_mass(step)), load_kernel(scene())
        for law, eps in ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3)):
            runs = [kernel.rollout(start, u, step, law, eps) for kernel in (before, now)]
            assert runs[0].lam.max() > 1.0
            for name in ("q", "v", "lam"):
                assert np.array_equal(getattr(runs[0], name), getattr(runs[1], name))
            gradients = [
                kernel.adjoint(run, u, run.q, run.v)
                for kernel, run in zip((before, now), runs, strict=True)
            ]
            for one, other in zip(*gradients, strict=True):
                assert one == pytest.approx(other, rel=1e-12, abs=1e-12 * np.abs(one).max())
        states = np.hstack([runs[0].q[:-1], runs[0].v[:-1]])
        lines = [load_steps(of).linearise(states, u, step) for of in (with_a_mass(step), scene())]
        assert np.array_equal(lines[0].next, lines[1].next)
        assert pytest.approx(lines[1].A, rel=1e-12, abs=1e-12) == lines[0].A


@pytest.mark.slow
def test_the_pyomo_model_is_that_of_a_mass_made_of_the_time_step() -> None:
    values: list[list[float]] = []
    for of in (with_a_mass(0.02), scene()):
        model = build_model(of, ExactLaw.COMPLEMENTARITY)
        random = np.random.default_rng(3)
        for variable in model.component_data_objects(pyo.Var, descend_into=True):
            variable.set_value(float(random.normal(scale=0.1)), skip_validation=True)
        values.append(
            [
                float(pyo.value(row.body))
                for row in model.component_data_objects(
                    pyo.Constraint, active=True, descend_into=True
                )
            ]
        )
    assert len(values[0]) > 1000
    assert values[0] == pytest.approx(values[1], rel=1e-12, abs=1e-12)


@pytest.mark.slow
def test_the_judged_motion_is_that_of_the_first_order_model_within_the_claimed_error() -> None:
    expected, seen = by_hand()
    assert seen == {"apart", "slips", "sticks"}
    errors = []
    for lag in (LAG, 10.0 * LAG):
        found = replayed(100, lag)
        assert found.ok
        errors.append(float(np.abs(found.q[found.knots] - expected).max()))
        assert errors[-1] <= 1.1 * found.error.estimate.position
        assert errors[-1] == pytest.approx(found.error.lag.position, rel=0.1)
    assert errors[0] < 3e-4
    assert errors[1] / errors[0] == pytest.approx(
        10.0, rel=0.1
    )  # of first order in the lag, and of nothing else


@pytest.mark.slow
def test_everyday_and_reference_agree_far_below_the_error_of_the_lag() -> None:
    error = replayed(100).error
    assert error.everyday.position < 1e-3 * error.lag.position
    assert error.tolerance.position < 1e-4 * error.lag.position


@pytest.mark.slow
def test_the_grid_of_a_plan_and_the_step_of_the_task_change_nothing_that_is_judged() -> None:
    plain = replayed(100)
    for other in (replayed(200), replayed(100, task_step=0.01)):
        each = (len(other.knots) - 1) // 100
        assert np.abs(other.q[other.knots[::each]] - plain.q[plain.knots]).max() < 1e-9
        assert other.error.lag.position == pytest.approx(plain.error.lag.position, rel=1e-3)


@pytest.mark.slow
def test_all_work_goes_into_drag_friction_and_the_spring() -> None:
    found = replayed(100)
    balance = found.energy - found.energy[0] - found.input_work + found.dissipated_work
    assert np.abs(balance).max() < 1e-9 * found.input_work[-1]
    assert found.kinetic_energy.max() < LAG * D * 3.0**2  # tau/2 v' D v, the finger below 2 m/s
    assert (np.diff(found.dissipated_work) >= -1e-12).all()


def test_a_free_finger_moves_with_its_force_over_the_drag() -> None:
    """q' = q + T u/d - tau u/d: the lag, and nothing else."""
    u = np.tile([-10.0, 5.0], (20, 1))
    found = replay(scene(), build_fmu(scene()), plan_of(u, 0.02), track=False)
    v = u[0] / D
    assert found.q[-1, 3:] == pytest.approx(np.array([-0.7, -0.4]) + v * (0.4 - LAG), abs=1e-9)
    assert found.q[-1, :3] == pytest.approx(np.zeros(3), abs=1e-12)
    assert found.error.lag.position == pytest.approx(LAG, rel=1e-6)


def test_the_fmu_has_the_short_time_as_a_parameter_and_steps_that_are_stable_with_it() -> None:
    table = {item.name: item for item in variable_table(scene().continuous())}
    assert table["tau"].start == LAG
    assert table["tau"].unit == "s"
    assert table["internal_step"].start == LAG
    assert build_fmu(scene()) == build_fmu(scene().continuous())
    assert {item.name: item.start for item in variable_table(scene())}[
        "tau"
    ] == 0.02  # of the grid, which no FMU is made of


def test_the_relaxation_time_follows_the_step_and_is_nobody_elses_to_set() -> None:
    assert scene().with_task(step=0.005).parameters[-1].value == 0.005
    assert scene().continuous().with_task(step=0.005).parameters[-1].value == LAG
    assert scene().continuous().continuous() == scene().continuous()
    with pytest.raises(SceneError, match="tau is the relaxation time"):
        scene().with_parameters(tau=0.1)
    assert load_scene("three_cart").continuous() is load_scene("three_cart")


WRONG: dict[str, tuple[Callable[[Scene], Scene], str]] = {
    "a mass beside the drag": (
        lambda of: replace(of, kinetic_energy=of.kinetic_energy + of.coordinates[0].velocity ** 2),
        "vanishes",
    ),
    "a drag that turns": (
        lambda of: replace(
            of, kinetic_energy=of.kinetic_energy * (2 + sp.cos(of.coordinates[2].symbol))
        ),
        "vanishes",
    ),
    "a drag that is not that of the energy": (
        lambda of: replace(of, kinetic_energy=2 * of.kinetic_energy),
        "must resist with the drag",
    ),
    "a lag without a time": (lambda of: replace(with_a_mass(0.02), lag=1e-4), "names none"),
    "no symbol": (lambda of: replace(of, relaxation_time=0.02), "must be a SymPy Symbol"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_scene_whose_time_step_would_not_be_the_quasi_static_law_is_refused(name: str) -> None:
    change, words = WRONG[name]
    with pytest.raises(SceneError, match=words):
        change(scene())


def test_errors_grow_as_in_the_first_order_model_on_any_grid() -> None:
    """The derivative of the end by the start over a step of 0.02 s in twenty parts, against finite differences of the motion by hand."""
    q, u = by_hand()[0][40], pushing()[40]
    matrix, _ = load_kernel(scene().continuous()).end_derivatives(
        np.concatenate([q, np.zeros(5)]), np.tile(u, (2000, 1)), 1e-5
    )

    def end(start: np.ndarray) -> np.ndarray:
        return solve_ivp(
            lambda _, y: rates(y, u)[0], (0.0, 0.02), start, method="DOP853", rtol=1e-12, atol=1e-14
        ).y[:, -1]

    expected = np.column_stack(
        [(end(q + 1e-6 * row) - end(q - 1e-6 * row)) / 2e-6 for row in np.eye(5)]
    )
    assert matrix[:5, :5] == pytest.approx(expected, abs=1e-3)
    assert np.abs(matrix[:, 5:]).max() < 1e-12  # what the velocity was is forgotten


def test_the_stability_of_the_step_is_that_of_the_explicit_quasi_static_one() -> None:
    """x' = x - h k/d (..) x: the largest step does not depend on the step it is asked at."""
    largest = step_stability(scene()).largest_step
    assert 2.0 / (K / D * (2.0 + (A / mean_distance(A, B)) ** 2)) < largest < math.inf
    assert step_stability(scene().with_task(step=0.005)).largest_step == pytest.approx(
        largest, rel=1e-6
    )
