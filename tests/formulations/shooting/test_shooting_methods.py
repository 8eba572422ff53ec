"""softplus_gd and relu_gd through the method protocol: options, refusals, limits, bounds, other scenes, starts, steps and horizons; the paper's gradient rows, by the methods themselves. L-BFGS: optima known in closed form, gradients against finite differences, endings in words."""

from dataclasses import replace

import numpy as np
import pytest
from example_scenes import example_scene, solve
from wording import unsaid

from formulations.method import Kind, OptionError
from formulations.pipelines import load_method
from formulations.shooting.method import QuasiNewtonMethod
from formulations.shooting.objective import Objective, Weights
from formulations.shooting.options import QuasiNewtonOptions
from formulations.shooting.quasi_newton import minimise
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.errors import TrajectoryError
from models.scene import Scene
from models.trajectory import Trajectory

SCENE = load_scene("three_cart")
METHODS = (("relu_gd", None), ("softplus_gd", 1e-3))


def test_what_they_are():
    relu, softplus = load_method("relu_gd"), load_method("softplus_gd")
    assert (relu.kind, relu.needs_eps) == (Kind.DIRECT, False)
    assert (softplus.kind, softplus.needs_eps) == (Kind.INDIRECT, True)


@pytest.mark.parametrize(("options", "words"), [
    ({"learning_rate": 0.0}, "learning_rate is 0.0"),
    ({"learning_rate": float("nan")}, "learning_rate is nan"),
    ({"iterations": 0}, "iterations is 0"), ({"input_weight": -1.0}, "input_weight is -1.0"),
])  # fmt: skip
def test_impossible_options_are_named(options: dict[str, object], words: str):
    with pytest.raises(OptionError, match=words):
        load_method("relu_gd").open(SCENE, options)


def test_history_and_figures_belong_together():
    solution = solve(SCENE, iterations=25)
    plan = solution.trajectory
    assert {len(column) for column in solution.history.values()} == {26}
    assert solution.cost == solution.history["cost"][-1]
    assert solution.residuals["terminal_error"] == pytest.approx(
        solution.history["terminal_error"][-1], rel=1e-14
    )
    assert solution.residuals["gradient_norm"] == pytest.approx(
        solution.history["gradient_norm"][-1], rel=1e-14
    )
    assert np.linalg.norm(plan.end - np.array(SCENE.task.goal)) == pytest.approx(
        solution.residuals["terminal_error"], rel=1e-14
    )
    loss = solution.residuals["terminal_error"] ** 2 / 6 + 5e-6 * (plan.u**2).sum()
    assert solution.history["loss"][-1] == pytest.approx(loss, rel=1e-12)
    assert solution.options["iterations"] == 25
    assert 0.0 < solution.seconds.evaluate < solution.seconds.wall
    assert solution.seconds.build > 0.0


def test_the_plan_is_a_rollout_of_the_methods_own_law():
    kernel = load_kernel(SCENE)
    for name, eps, law in (
        ("relu_gd", None, ContactLaw.RELU),
        ("softplus_gd", 1e-3, ContactLaw.SOFTPLUS),
    ):
        plan = solve(SCENE, name, eps, iterations=5).trajectory
        assert (plan.lam == kernel.contact_force(plan.q[:-1], law, eps)).all()


def test_time_limit_is_kept_and_leaves_a_plan():
    with load_method("relu_gd").open(SCENE, {"tolerance": 0.0}) as session:
        solution = session.solve(eps=None, warm_start=None, time_limit=0.05)
        assert solution.outcome is Outcome.TIME_LIMIT
        assert solution.trajectory is not None
        assert "time limit of 0.05 s" in solution.message


def test_iteration_limit_of_our_own_rule_says_how_much_was_still_moving():
    solution = solve(SCENE, max_iterations=120)
    assert solution.outcome is Outcome.ITERATION_LIMIT
    assert "max_iterations = 120" in solution.message
    assert "still fell by" in solution.message


def test_a_converged_plan_is_recognised_when_it_starts_there():
    first = solve(SCENE, "softplus_gd", 1e-3)
    again = solve(SCENE, "softplus_gd", 1e-3, first.trajectory)
    assert first.outcome is again.outcome is Outcome.SOLVED
    assert again.iterations < first.iterations / 4
    assert again.cost == pytest.approx(first.cost, rel=1e-3)


def test_warm_start_on_another_grid_is_refused():
    plan = solve(SCENE.with_task(steps=250), iterations=1).trajectory
    with pytest.raises(TrajectoryError, match=r"250 steps over 2\.5 s.*500 steps of 0\.01 s"):
        solve(SCENE, plan=plan)
    finer = solve(SCENE.with_task(step=0.005), iterations=1).trajectory
    with pytest.raises(TrajectoryError, match="resample"):
        solve(SCENE, plan=finer)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "eps", "changes", "rate"), [
    *((name, eps, {"steps": 400}, 500.0) for name, eps in METHODS),
    ("softplus_gd", 1e-3, {"steps": 250, "step": 0.02}, 150.0),
    ("softplus_gd", 1e-3, {"goal": (1.5, 2.5, 3.5, 0.0, 0.0, 0.0)}, 500.0),
    ("softplus_gd", 1e-3, {"start": (2.0, 2.6, 4.0, 0.5, 0.0, -0.5)}, 300.0),
])  # fmt: skip
def test_other_tasks_end_at_rest_and_nearer_to_the_goal(
    name: str, eps: float | None, changes: dict, rate: float
):
    solution = solve(SCENE.with_task(**changes), name, eps, learning_rate=rate, tolerance=1e-3)
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.history["terminal_error"][-1] < 0.15 * solution.history["terminal_error"][0]
    assert (
        np.linalg.norm(solution.history["gradient_norm"][-1])
        < 1e-2 * solution.history["gradient_norm"][0]
    )


@pytest.mark.slow
def test_jumping_across_a_kink_is_not_called_solved():
    """Ten times stiffer contact, the same step: the loss settles above its minimum, and a smaller step gets further down."""
    stiff = SCENE.with_parameters(k=300.0)
    solution = solve(stiff)
    assert solution.outcome is Outcome.STALLED
    assert not unsaid(solution.message, "to and fro; use a smaller learning rate")
    smaller = solve(stiff, plan=solution.trajectory, learning_rate=100.0, max_iterations=2000)
    assert min(smaller.history["loss"]) < 0.999 * min(solution.history["loss"])


@pytest.mark.slow
def test_bounds_of_the_inputs_are_kept_where_the_descent_would_leave_them():
    """In one second the carts cannot get there within the bounds: the descent wants to push harder than it may."""
    inputs = SCENE.inputs
    task = SCENE.with_task(steps=100)
    free = solve(task, "softplus_gd", 1e-7)
    assert np.abs(free.trajectory.u).max() == inputs[0].upper
    assert free.residuals["input_bound_excess"] == 0.0
    assert "inputs are held at their bound" in free.message


def test_a_start_that_cannot_be_simulated_is_an_evaluation_error():
    scene = SCENE.with_parameters(c=1e308)
    solution = solve(scene.with_task(start=(2.0, 3.0, 4.0, 1e10, 0.0, 0.0)))
    assert solution.outcome is Outcome.EVALUATION_ERROR
    assert solution.trajectory is None
    assert "no longer finite beyond step 0" in solution.message


@pytest.mark.slow
def test_who_converges_away_from_the_goal_has_not_solved_the_task():
    solved = solve(SCENE)
    assert solved.outcome is Outcome.SOLVED
    cheap = solve(
        SCENE, input_weight=5e-5
    )  # ten times the paper's: staying where it is costs less than arriving
    assert cheap.outcome is Outcome.STALLED
    assert "converged away from the goal" in cheap.message
    assert cheap.residuals["terminal_position_error"] > SCENE.limit("terminal_position_error").value
    free = solve(SCENE.with_task(goal=(None,) * 6), input_weight=5e-5)
    assert free.outcome is Outcome.SOLVED


TOLERANCE = 0.02
CHAIN = (
    # method, eps, iterations, cost, paper, position error after replay in true contact (the paper's
    # "stability")
    ("softplus_gd", 1e-3, 15, 149.1749, 149.18, 0.411),
    ("softplus_gd", 1e-5, 14, 166.4536, 166.45, 0.273),
    ("softplus_gd", 1e-7, 11, 215.1410, 215.14, 0.196),
    ("relu_gd", None, 10, 309.4187, 309.42, 0.047),
)


@pytest.fixture(scope="module")
def chain() -> list[Solution]:
    solutions: list[Solution] = []
    for method, eps, iterations, *_ in CHAIN:
        solutions.append(
            solve(
                SCENE,
                method,
                eps,
                solutions[-1].trajectory if solutions else None,
                iterations=iterations,
            )
        )
    return solutions


@pytest.mark.parametrize("row", range(len(CHAIN)))
def test_costs_and_stability_of_the_softplus_chain(chain: list[Solution], row: int):
    _, _, iterations, cost, paper, stability = CHAIN[row]
    solution = chain[row]
    assert solution.outcome is Outcome.ITERATION_LIMIT
    assert solution.outcome.has_answer
    assert solution.message.startswith(f"stopped after the {iterations} requested iterations")
    assert solution.iterations == iterations
    assert solution.cost == pytest.approx(cost, abs=1e-3)
    assert solution.cost == pytest.approx(paper, abs=TOLERANCE)
    replayed = load_kernel(SCENE).rollout(
        np.array(SCENE.task.start), solution.trajectory.u, SCENE.task.step
    )
    assert np.linalg.norm(replayed.q[-1] - np.array(SCENE.task.goal[:3])) == pytest.approx(
        stability, abs=5e-4
    )


@pytest.fixture(scope="module")
def cold() -> Solution:
    return solve(SCENE, iterations=200)


def test_cold_relu_row(cold: Solution):
    assert cold.cost == pytest.approx(542.56, abs=TOLERANCE)
    assert cold.residuals["terminal_position_error"] == pytest.approx(0.040, abs=5e-4)
    assert (
        "no contact" not in cold.message
    )  # it gets into contact by overshooting, after some iterations


@pytest.mark.slow
def test_relu_row_after_softplus_collocation():
    """The warm start is softplus collocation at 1e-3, 1e-5, 1e-7, each from the one before."""
    plan = None
    with load_method("softplus_dc").open(SCENE) as session:
        for eps in (1e-3, 1e-5, 1e-7):
            plan = session.solve(eps=eps, warm_start=plan, time_limit=60.0).trajectory
    assert plan is not None
    solution = solve(SCENE, plan=plan, iterations=6)
    assert solution.cost == pytest.approx(360.31, abs=TOLERANCE)
    assert solution.residuals["terminal_position_error"] == pytest.approx(0.047, abs=5e-4)


def test_relu_rows_have_no_physics_residual_at_all(chain: list[Solution], cold: Solution):
    kernel = load_kernel(SCENE)
    for plan in (chain[-1].trajectory, cold.trajectory):
        assert plan.lam.max() > 0.0
        assert (
            np.abs(plan.lam * (plan.lam - kernel.stiffness() * kernel.penetration(plan.q[:-1])))
            == 0.0
        ).all()


def test_the_bounds_of_the_inputs_do_not_touch_the_papers_rows(chain: list[Solution]):
    """The paper's descent ignores |u| <= 10 and stays inside."""
    assert all(
        np.abs(solution.trajectory.u).max() < 10.0
        for solution in chain
        if solution.trajectory is not None
    )
    assert all("held at their bound" not in solution.message for solution in chain)


@pytest.mark.slow
def test_our_own_rule_reaches_the_bottom_that_a_long_descent_shows():
    """200 000 plain iterations by an independent numpy loop end at these losses.

    The rule may leave 0.1 % of the loss.
    """
    for method, eps, loss in (("softplus_gd", 1e-3, 9.039952e-4), ("relu_gd", None, 1.838244e-3)):
        solution = solve(SCENE, method, eps)
        assert solution.outcome is Outcome.SOLVED
        assert min(solution.history["loss"]) == pytest.approx(loss, rel=1e-3)
        assert min(solution.history["loss"]) >= loss * (1 - 1e-6)


HILL = example_scene("leaning_mass")
APART = SCENE.with_task(start=(0.0, 3.0, 6.0, 0.0, 0.0, 0.0), goal=(0.5, 3.5, 6.5, 0.0, 0.0, 0.0))


def test_the_goal_is_met_and_nothing_is_cheaper():
    """Held against multiple shooting, whose optimum is tested in closed form: two methods that share only the time step."""
    free = replace(HILL, inputs=(replace(HILL.inputs[0], lower=-np.inf, upper=np.inf),))
    solution = solve(free, "relu_lbfgs", input_weight=1e-2, tolerance=1e-9, goal_rounds=20)
    other = solve(free, "relu_multiple_shooting", tolerance=1e-10, goal_tolerance=1e-9)
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.residuals["terminal_error"] <= 1e-6
    assert solution.cost == pytest.approx(other.cost, rel=1e-5)


def test_without_rounds_it_is_the_minimum_of_the_loss_of_gradient_descent():
    kernel = load_kernel(SCENE)
    objective = Objective(kernel, law=ContactLaw.SOFTPLUS, eps=1e-3)
    found = minimise(
        objective,
        np.zeros((SCENE.task.steps, 2)),
        QuasiNewtonOptions(goal_rounds=0, tolerance=1e-8),
        60.0,
    )
    descent = solve(SCENE, "softplus_gd", 1e-3)
    assert found.u is not None
    assert objective.value(found.u) <= objective.value(descent.trajectory.u)
    assert objective.value(found.u) == pytest.approx(
        objective.value(descent.trajectory.u), rel=1e-3
    )


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


def test_a_loss_of_ones_own_is_made_small_without_displacing_its_goal():
    """Least inputs that end at rest: nothing to do, whatever the goal."""
    kernel = load_kernel(SCENE)
    objective = Objective(
        kernel,
        law=ContactLaw.RELU,
        loss=lambda plan, u: (u - 0.5).square().mean((-2, -1)) + plan.end[..., 3:].square().sum(-1),
    )
    found = minimise(
        objective, np.zeros((SCENE.task.steps, 2)), QuasiNewtonOptions(tolerance=1e-10), 60.0
    )
    assert found.u is not None
    assert found.history["loss"][-1] < found.history["loss"][0] / 2.0
    assert "displaced" not in found.message


def test_a_loss_of_ones_own_may_be_a_number_where_the_motion_has_none():
    """Steps of 5 s: the motion of these inputs is finite for 107 of them."""

    class Own(QuasiNewtonMethod):
        name = "own"
        title = "Own"
        kind = Kind.DIRECT
        needs_eps = False
        law = ContactLaw.RELU

        def loss(self, scene: Scene):
            return lambda plan, u: u.square().sum((-1, -2)) + 1e-9 * plan.q[..., 0, 0]

    scene, none = SCENE.with_task(step=5.0, steps=300), np.zeros((301, 3))
    start = Trajectory(
        t=5.0 * np.arange(301), q=none, v=none, u=np.full((300, 2), 0.5), lam=np.zeros((300, 2))
    )
    with Own().open(scene, {"max_iterations": 2}) as session:
        found = session.solve(eps=None, warm_start=start, time_limit=60.0)
    assert (found.outcome, found.trajectory) == (Outcome.EVALUATION_ERROR, None)
    assert not unsaid(found.message, "could not be simulated")
