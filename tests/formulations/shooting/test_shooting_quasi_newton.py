"""L-BFGS and randomised smoothing: optima known in closed form, gradients against finite differences, bounds, endings in words."""

from dataclasses import replace

import numpy as np
import pytest
from example_scenes import example_scene, solve
from wording import unsaid

from formulations.shooting.objective import Objective, Weights, noise
from formulations.shooting.options import QuasiNewtonOptions
from formulations.shooting.quasi_newton import minimise
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw

HILL = example_scene("leaning_mass")
CARTS = load_scene("three_cart")
APART = CARTS.with_task(start=(0.0, 3.0, 6.0, 0.0, 0.0, 0.0), goal=(0.5, 3.5, 6.5, 0.0, 0.0, 0.0))


def test_the_goal_is_met_and_nothing_is_cheaper():
    """Held against multiple shooting, whose optimum is tested in closed form: two methods that share only the time step."""
    free = replace(HILL, inputs=(replace(HILL.inputs[0], lower=-np.inf, upper=np.inf),))
    solution = solve(free, "relu_lbfgs", input_weight=1e-2, tolerance=1e-9, goal_rounds=20)
    other = solve(free, "relu_multiple_shooting", tolerance=1e-10, goal_tolerance=1e-9)
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.residuals["terminal_error"] <= 1e-6
    assert solution.cost == pytest.approx(other.cost, rel=1e-5)


def test_without_rounds_it_is_the_minimum_of_the_loss_of_gradient_descent():
    kernel = load_kernel(CARTS)
    objective = Objective(kernel, law=ContactLaw.SOFTPLUS, eps=1e-3)
    found = minimise(objective, np.zeros((CARTS.task.steps, 2)), QuasiNewtonOptions(goal_rounds=0, tolerance=1e-8), 60.0)
    descent = solve(CARTS, "softplus_gd", 1e-3)
    assert found.u is not None
    assert objective.value(found.u) <= objective.value(descent.trajectory.u)
    assert objective.value(found.u) == pytest.approx(objective.value(descent.trajectory.u), rel=1e-3)


def test_the_goal_is_left_where_it_was():
    objective = Objective(load_kernel(HILL), law=ContactLaw.RELU, weights=Weights(running=1e-2))
    minimise(objective, np.zeros((HILL.task.steps, 1)), QuasiNewtonOptions(), 60.0)
    assert objective.goal.tolist() == [0.0, 0.0]
    assert objective.weights == Weights(running=1e-2)


def test_bounds_hold_exactly():
    tight = replace(HILL, inputs=(replace(HILL.inputs[0], lower=-2.2, upper=1.0),))
    plan = solve(tight, "relu_lbfgs", input_weight=1e-2).trajectory
    assert plan.u.min() == -2.2
    assert plan.u.max() <= 1.0


def test_dead_contact_is_told():
    solution = solve(APART, "relu_lbfgs")
    assert solution.outcome is Outcome.STALLED
    assert not unsaid(solution.message, "no contact is made anywhere")


def test_noise_comes_in_pairs_of_the_size_asked_for():
    w = noise(CARTS, deviation=0.1, unbounded=1.0, samples=4000, pieces=5, seed=0)
    assert w.shape == (4000, 500, 2)
    np.testing.assert_allclose(w.mean(axis=0), 0.0, atol=1e-12)
    assert w.std() == pytest.approx(1.0, rel=0.03), "a tenth of half the range of 20 N"
    assert len(np.unique(w[0, :, 0])) == 5


@pytest.mark.slow
def test_another_seed_is_other_noise_and_another_plan():
    drawn = [noise(CARTS, deviation=0.1, unbounded=1.0, samples=4, pieces=5, seed=seed) for seed in (0, 0, 1, 2)]
    assert np.array_equal(drawn[0], drawn[1])
    assert not any(np.isclose(drawn[0], other).any(axis=(1, 2)).any() for other in drawn[2:])
    costs = [solve(APART, "randomised_smoothing", 0.3, seed=seed).cost for seed in (0, 0, 1, 2)]
    assert costs[0] == costs[1]
    assert len(set(costs)) == 3


def test_noise_makes_contact_that_the_plan_itself_does_not():
    """From rest, with nothing in reach: gradient descent on ReLU is dead, noise finds the middle cart."""
    dead, alive = solve(APART, "relu_lbfgs"), solve(APART, "randomised_smoothing", 0.3)
    start = np.array(APART.task.start)
    assert dead.trajectory.q[-1, 1] == start[1]
    assert alive.trajectory.q[-1, 1] != start[1]


def test_a_loss_of_ones_own_is_made_small_without_displacing_its_goal():
    """Least inputs that end at rest: nothing to do, whatever the goal."""
    kernel = load_kernel(CARTS)
    objective = Objective(
        kernel, law=ContactLaw.RELU, loss=lambda plan, u: (u - 0.5).square().mean((-2, -1)) + plan.end[..., 3:].square().sum(-1)
    )
    found = minimise(objective, np.zeros((CARTS.task.steps, 2)), QuasiNewtonOptions(tolerance=1e-10), 60.0)
    assert found.u is not None
    assert found.history["loss"][-1] < found.history["loss"][0] / 2.0
    assert "displaced" not in found.message
