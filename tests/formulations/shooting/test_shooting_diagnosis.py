"""Why a descent ended: dead contacts, divergence and its numbers; growth of a disturbance over the horizon: against eigenvalues, against the adjoint, and in words where a method fails of it."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from example_scenes import example_scene, solve
from wording import unsaid

from formulations.pipelines import load_method
from formulations.shooting.descent import sensitivity, stable_rate
from formulations.shooting.objective import Objective
from formulations.shooting.stage import GradientGrowth, measure_growth
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.scene import Scene

SCENE = load_scene("three_cart")
APART = SCENE.with_task(start=(0.0, 3.0, 6.0, 0.0, 0.0, 0.0), goal=(0.5, 3.5, 6.5, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("options", [{}, {"iterations": 30}])
def test_dead_relu_is_told_with_its_numbers(options: dict[str, object]):
    solution = solve(APART, **options)
    assert solution.outcome is (Outcome.ITERATION_LIMIT if options else Outcome.STALLED)
    assert (solution.trajectory.lam == 0.0).all()
    assert not unsaid(solution.message, "no contact is made anywhere")
    assert not unsaid(solution.message, "no gradient towards moving q2 … misses its goal by 0.5 m; |d q2/d u| = 0)")
    assert "start from a softplus stage" in solution.message
    gaps = re.search(r"smallest gap left ([\d.]+) m at t = ([\d.]+) s, right ([\d.]+) m", solution.message)
    phi = load_kernel(APART).penetration(solution.trajectory.q[:-1])
    assert float(gaps[1]) == pytest.approx(-phi[:, 0].max(), rel=5e-3)
    assert float(gaps[3]) == pytest.approx(-phi[:, 1].max(), rel=5e-3)


def test_faint_softplus_is_told_too():
    solution = solve(APART, "softplus_gd", 1e-7)
    assert solution.outcome is Outcome.STALLED
    assert "the relaxed contact is too faint" in solution.message
    assert "start from a larger eps" in solution.message


def _row_of_three() -> Scene:
    """A driven cart far from two passive ones, which overlap and push each other apart."""
    driven, other = (item.symbol for item in SCENE.inputs)
    row = replace(
        SCENE, inputs=SCENE.inputs[:1], forces=tuple(force.subs(other, 0) for force in SCENE.forces), answers=(),
        task=replace(SCENE.task, running_cost=driven**2),
    )  # fmt: skip
    return row.with_task(start=(0.0, 5.0, 5.4, 0.0, 0.0, 0.0), goal=(0.5, 5.5, 6.0, 0.0, 0.0, 0.0), steps=200)


def test_the_one_contact_that_is_never_made_is_named():
    solution = solve(_row_of_three(), learning_rate=50.0)
    assert solution.outcome is Outcome.STALLED
    assert not unsaid(solution.message, "contact left is never made (smallest gap")
    assert "towards moving q2 (it misses" in solution.message
    assert " and q3 (it misses" in solution.message


def test_no_diagnosis_where_nothing_is_missed():
    """No contact is made here either, but the middle cart is where it should be."""
    solution = solve(APART.with_task(goal=(0.5, 3.0, 5.5, 0.0, 0.0, 0.0)))
    assert solution.outcome is Outcome.SOLVED
    assert "no contact" not in solution.message


@pytest.mark.parametrize(("name", "eps"), [("relu_gd", None), ("softplus_gd", 1e-3)])
def test_a_learning_rate_that_is_too_large_is_named_and_a_good_one_is_given(name: str, eps: float | None):
    """Twice the horizon has more than twice the curvature: the paper's rate overshoots, and the rate of the message does not."""
    scene = SCENE.with_task(steps=1000)
    solution = solve(scene, name, eps)
    assert solution.outcome is Outcome.DIVERGED
    assert solution.trajectory is None
    assert "learning rate 500" in solution.message
    assert "grows by a factor of" in solution.message
    rate = re.search(r"a learning rate below ([\d.e-]+) would not overshoot", solution.message)
    again = solve(scene, name, eps, learning_rate=0.75 * float(rate[1]), iterations=60)
    assert again.history["loss"][-1] == min(again.history["loss"]) < 0.2 * again.history["loss"][0]


@pytest.mark.slow
def test_divergence_of_an_unstable_scene_is_an_outcome_and_no_warning():
    """The arm's gradients grow over the horizon, and far too large a step makes the rollout itself overflow."""
    solution = solve(example_scene("two_link_arm"), learning_rate=500.0, iterations=200)
    assert solution.outcome is Outcome.DIVERGED
    assert "learning rate 500" in solution.message
    assert all(np.isfinite(column).all() for column in solution.history.values())


@pytest.mark.slow
@pytest.mark.parametrize("reference", ["three_cart", "two_link_arm"])
def test_sensitivity_rows_are_finite_differences(reference: str):
    scene = example_scene(reference).with_task(steps=40)
    objective = Objective(load_kernel(scene), law=ContactLaw.SOFTPLUS, eps=1e-3)
    u = np.random.default_rng(0).normal(size=(40, scene.nu))
    rows = sensitivity(objective, u)
    direction = np.random.default_rng(1).normal(size=u.shape)
    ends = []
    for sign in (1.0, -1.0):
        objective.value(u + sign * 1e-6 * direction)
        ends.append(objective.error.copy())
    assert rows.to_inputs @ direction.ravel() == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-6, abs=1e-8)


def test_growth_is_the_norm_of_the_transition_matrix():
    """Free carts: a velocity decays as (1 - c h)^n and leaves a displacement of sum h (1 - c h)^n behind it."""
    objective = Objective(load_kernel(APART), law=ContactLaw.RELU)
    rows = sensitivity(objective, np.zeros((500, 2)))
    decay = 0.98 ** np.arange(1, 501)
    single = np.array([[1.0, 0.01 * decay.sum()], [0.0, decay[-1]]])
    assert rows.growth == pytest.approx(np.linalg.norm(single, 2), rel=1e-10)


def test_stable_rate_is_two_over_the_largest_curvature():
    """Without contact the loss is quadratic, and its Hessian can be written out."""
    objective = Objective(load_kernel(APART), law=ContactLaw.RELU)
    u = np.zeros((500, 2))
    rows = sensitivity(objective, u).to_inputs
    hessian = 2.0 / 6.0 * rows.T @ rows + 2.0 * 5e-6 * np.eye(rows.shape[1])
    assert stable_rate(objective, u) == pytest.approx(2.0 / np.linalg.eigvalsh(hessian)[-1], rel=1e-4)


HILL = example_scene("leaning_mass")


def _growth(steps: int) -> GradientGrowth:
    found = measure_growth(load_steps(HILL.with_task(steps=steps)), np.zeros((steps + 1, 2)), np.zeros((steps, 1)))
    assert found is not None
    return found


@pytest.mark.parametrize("steps", [200, 20000])
def test_the_rate_is_the_larger_root_of_the_step(steps: int):
    """z^2 - (2 + 4 h^2) z + 1 = 0; also where the factor is beyond all floats (e^800)."""
    h = HILL.task.step
    trace = 2.0 + 4.0 * h * h
    root = math.log((trace + math.sqrt(trace * trace - 4.0)) / 2.0) / h
    growth = _growth(steps)
    assert growth.rate == pytest.approx(root, rel=2e-2 if steps == 200 else 1e-3)
    assert growth.exponents[-1] == 0.0
    assert math.isfinite(growth.factor)
    assert f"over the {h * steps:g} s" in growth.sentence()


def test_the_factor_is_that_of_the_adjoint():
    scene = load_scene("acrobot_limits")
    u = np.random.default_rng(0).normal(size=(scene.task.steps, 1))
    objective = Objective(load_kernel(scene), law=ContactLaw.RELU)
    plan = load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
    growth = measure_growth(load_steps(scene), np.hstack([plan.q, plan.v]), u)
    assert growth.factor == pytest.approx(sensitivity(objective, u).growth, rel=1e-9)


def test_what_does_not_grow_is_not_told():
    scene = load_scene("three_cart")
    with load_method("relu_gd").open(scene, {"iterations": 3}) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=60.0)
    assert "grows" not in solution.message
    assert solution.residuals["gradient_growth"] < 2.0


def test_a_shooting_method_that_fails_of_growth_says_so():
    """Left alone for 5 s the acrobot is far beyond what a gradient can be carried over."""
    scene = load_scene("acrobot_limits").with_task(steps=5000)
    with load_method("relu_lbfgs").open(scene, {"max_iterations": 30}) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=60.0)
    assert solution.outcome is not Outcome.SOLVED
    assert "The gradient grows by" in solution.message
    assert "over the 5 s" in solution.message
    assert "multiple shooting does not carry it" in solution.message
    assert solution.residuals["growth_rate"] > 0.5
