"""Multiple shooting: the subproblem against dense linear algebra, optima known in closed form, and unstable scenes from a cold start."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from example_scenes import example_scene

from formulations.multiple_shooting.solver import Costs, Stages
from formulations.pipelines import MULTIPLE_SHOOTING_EPS, load_method, solve_scene
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.dynamics import derive
from models.scene import Scene

HILL = example_scene("leaning_mass")
FREE = HILL.with_task(goal=(None, None))


def least_cost(scene: Scene) -> tuple[float, np.ndarray]:
    """Least cost and inputs of a linear scene without contacts and bounds, by one dense system (cost quadratic, goal an equality)."""
    task = scene.task
    n, nx = task.steps, 2 * scene.nq
    linear = load_steps(scene).linearise(np.zeros((1, nx)), np.zeros((1, scene.nu)), task.step)
    assert linear is not None
    big = np.zeros((n + 1, nx, n * scene.nu))  # x = free + big u
    free = np.zeros((n + 1, nx))
    free[0] = task.start
    for t in range(n):
        free[t + 1] = linear.A[0] @ free[t]
        big[t + 1] = linear.A[0] @ big[t]
        big[t + 1][:, t * scene.nu : (t + 1) * scene.nu] += linear.B[0]
    d = derive(scene)
    symbols = [*d.q, *d.v, *d.u]
    hessian = np.array(sp.hessian(d.running_cost, symbols).tolist(), dtype=float)
    maps = [
        np.vstack([big[t], np.eye(n * scene.nu)[t * scene.nu : (t + 1) * scene.nu]])
        for t in range(n)
    ]
    quadratic = sum(m.T @ hessian @ m for m in maps)
    linear_part = sum(
        m.T @ hessian @ np.concatenate([free[t], np.zeros(scene.nu)]) for t, m in enumerate(maps)
    )
    if task.has_goal:
        system = np.block([[quadratic, big[n].T], [big[n], np.zeros((nx, nx))]])
        u = np.linalg.solve(system, np.concatenate([-linear_part, np.array(task.goal) - free[n]]))[
            : n * scene.nu
        ]
    else:
        u = np.linalg.solve(quadratic, -linear_part)
    u = u.reshape(n, scene.nu)
    run = load_kernel(scene).rollout(np.array(task.start), u, task.step)
    return load_kernel(scene).cost(run.q, run.v, u), u


def solved(scene: Scene, name: str = "relu_multiple_shooting", **options: object) -> Solution:
    return solve_scene(
        scene, name, eps=1e-3 if "softplus" in name else None, options=options, time_limit=60.0
    )


def test_the_sweep_is_the_riccati_recursion_of_lqr():
    random = np.random.default_rng(0)
    n, nx, nu = 7, 3, 2
    stages = Stages(n, nx, nu)
    stages.A[:], stages.B[:] = random.normal(size=(n, nx, nx)), random.normal(size=(n, nx, nu))
    stages.lxx[:], stages.luu[:], stages.pxx[:] = np.eye(nx), 2.0 * np.eye(nu), 3.0 * np.eye(nx)
    assert stages.backward(np.zeros((n, nu)), np.full(nu, -np.inf), np.full(nu, np.inf), 0.0)
    value = stages.pxx
    for t in range(n - 1, -1, -1):
        a, b = stages.A[t], stages.B[t]
        gain = -np.linalg.solve(2.0 * np.eye(nu) + b.T @ value @ b, b.T @ value @ a)
        np.testing.assert_allclose(stages.K[t], gain, rtol=1e-9, atol=1e-12)
        value = np.eye(nx) + a.T @ value @ (a + b @ gain)


def test_bounds_of_a_stage_are_met_where_its_program_is_least():
    """Against every choice of inputs held at a bound, for coupled inputs."""
    random = np.random.default_rng(5)
    for _ in range(20):
        root = random.normal(size=(3, 3))
        hessian, slope = root @ root.T + 0.1 * np.eye(3), 3.0 * random.normal(size=3)
        stages = Stages(1, 1, 3)
        stages.luu[0], stages.lu[0] = hessian, slope
        lower, upper = np.full(3, -0.5), np.full(3, 0.7)
        assert stages.backward(np.zeros((1, 3)), lower, upper, 0.0)
        best = min(
            _candidates(hessian, slope, lower, upper),
            key=lambda x: 0.5 * x @ hessian @ x + slope @ x,
        )
        np.testing.assert_allclose(stages.k[0], best, atol=1e-9)


def _candidates(
    hessian: np.ndarray, slope: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> list[np.ndarray]:
    found = []
    for choice in np.ndindex(3, 3, 3):
        x = np.where(np.array(choice) == 1, lower, np.where(np.array(choice) == 2, upper, 0.0))
        free = np.array(choice) == 0
        if free.any():
            x[free] = np.linalg.solve(hessian[np.ix_(free, free)], -(slope + hessian @ x)[free])
        if (x >= lower - 1e-12).all() and (x <= upper + 1e-12).all():
            found.append(x)
    return found


def test_slopes_and_hessians_of_the_cost_are_finite_differences():
    scene = load_scene("cart_pole_walls")
    u = sp.Symbol("u", real=True)
    theta = scene.coordinates[1].symbol
    scene = scene.with_task(running_cost=u**2 + sp.sin(theta) ** 2 * u + theta**4)
    costs, random = Costs(scene), np.random.default_rng(2)
    x, inputs = 0.1 * random.normal(size=(1, 4)), np.array([[0.3]])
    slope, hessian = costs.running(x, inputs)
    point, delta = np.hstack([x, inputs])[0], 1e-5
    for i, side in enumerate(delta * np.eye(5)):
        ends = [
            costs.value(np.vstack([p[:4], 0 * p[:4]]), p[None, 4:])
            for p in (point + side, point - side)
        ]
        assert slope[0, i] == pytest.approx((ends[0] - ends[1]) / (2 * delta), abs=1e-8)
        slopes = [
            costs.running(p[None, :4], p[None, 4:])[0][0] for p in (point + side, point - side)
        ]
        difference = (slopes[0] - slopes[1]) / (2 * delta)
        if np.linalg.eigvalsh(hessian[0]).min() > 1e-9:
            np.testing.assert_allclose(hessian[0, i], difference, atol=1e-7)
    assert np.linalg.eigvalsh(hessian[0]).min() >= -1e-12
    final_slope, final_hessian = costs.final(x[0])
    np.testing.assert_allclose(final_slope, 200.0 * x[0], rtol=1e-12)
    np.testing.assert_allclose(final_hessian, 200.0 * np.eye(4), rtol=1e-12)


@pytest.mark.parametrize("scene", [HILL, FREE], ids=["goal", "free end"])
def test_a_linear_scene_is_solved_to_its_closed_form(scene: Scene):
    free = replace(scene, inputs=(replace(scene.inputs[0], lower=-np.inf, upper=np.inf),))
    cost, u = least_cost(free)
    solution = solved(free, tolerance=1e-12, goal_tolerance=1e-9)
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.cost == pytest.approx(cost, rel=1e-7)
    np.testing.assert_allclose(solution.trajectory.u, u, atol=1e-5 * np.abs(u).max())
    if not scene.task.has_goal:
        assert solution.iterations <= 2, "one linear-quadratic subproblem is the whole problem"


def test_bounds_of_the_inputs_hold_and_nothing_is_cheaper():
    """Held against L-BFGS-B, which knows nothing of stages."""
    tight = replace(FREE, inputs=(replace(FREE.inputs[0], lower=-0.5, upper=0.5),))
    plan, other = (
        solved(tight, tolerance=1e-10),
        solved(tight, "relu_lbfgs", input_weight=1.0, tolerance=1e-10),
    )
    assert np.abs(plan.trajectory.u).max() == 0.5
    assert plan.cost == pytest.approx(other.cost, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cart_pole_walls", "acrobot_limits"])
def test_unstable_scenes_are_solved_from_a_cold_start(name: str):
    scene, plan = load_scene(name), None
    for method, schedule in (
        ("softplus_multiple_shooting", MULTIPLE_SHOOTING_EPS),
        ("relu_multiple_shooting", (None,)),
    ):
        with load_method(method).open(scene) as session:
            for eps in schedule:
                solution = session.solve(eps=eps, warm_start=plan, time_limit=60.0)
                plan = solution.trajectory
    assert solution.outcome is Outcome.SOLVED, solution.message
    run = load_kernel(scene).rollout(np.array(scene.task.start), plan.u, scene.task.step)
    end = np.concatenate([run.q[-1], run.v[-1]])
    assert np.linalg.norm(end - np.array(scene.task.goal)) < 1e-4, (
        "without feedback, on the plan's own grid"
    )
    assert run.lam.max() > 0.0
    assert solution.residuals["gap"] <= 1e-9
    assert solution.residuals["gradient_growth"] > 1e3


def test_a_goal_out_of_reach_is_not_called_solved():
    scene = HILL.with_task(goal=(50.0, 0.0))
    solution = solved(scene)
    assert solution.outcome in {Outcome.STALLED, Outcome.ITERATION_LIMIT}
    assert "goal" in solution.message
    assert solution.residuals["terminal_error"] > 1.0
