"""The loop of gradient descent against the same written out in numpy; the loss.

bounds, limits, interrupts; the stopping rule on sequences of losses whose right answer is known;
why a descent ended; and growth of a disturbance over the horizon.
"""

import itertools
import math
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from descent_in_python import descend_in_python
from descent_in_python import progress as written_out
from example_scenes import example_scene, solve
from wording import unsaid

from formulations.pipelines import solve_scene
from formulations.shooting.descent import Losses, Progress, descend, sensitivity, stable_rate
from formulations.shooting.objective import GoalLoss, Objective, Weights
from formulations.shooting.options import DescentOptions
from formulations.shooting.reference import reference_cost, reference_rollout
from formulations.shooting.rollout import RolloutTensors, ShootingError, rollout
from formulations.shooting.stage import GradientGrowth, measure_growth
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.scene import Scene

TOLD = {
    "at limit": Outcome.ITERATION_LIMIT, "runaway": Outcome.DIVERGED,
    "not finite": Outcome.DIVERGED,
}  # fmt: skip
SOFTPLUS = ContactLaw.SOFTPLUS
RELU = ContactLaw.RELU
# scene, law, eps, options, size of the first inputs, how it ends, and how many digits of a chaotic
# descent two orders of summation share
CASES = {
    "the paper's descent": (
        "three_cart",
        SOFTPLUS,
        1e-3,
        DescentOptions(learning_rate=500.0, iterations=300),
        0.0,
        "at limit",
        1e-9,
    ),
    "our own rule": (
        "three_cart",
        RELU,
        None,
        DescentOptions(learning_rate=500.0),
        0.5,
        "settled",
        1e-9,
    ),
    "at the bounds": (
        "three_cart",
        RELU,
        None,
        DescentOptions(learning_rate=5e4, max_iterations=400),
        12.0,
        "runaway",
        1e-3,
    ),
    "too long steps": (
        "three_cart",
        SOFTPLUS,
        1e-5,
        DescentOptions(learning_rate=3e3, max_iterations=2000),
        0.0,
        "runaway",
        1e-3,
    ),
    "a mass matrix that turns": (
        "two_link_arm",
        RELU,
        None,
        DescentOptions(learning_rate=1.0, iterations=60),
        0.1,
        "at limit",
        1e-6,
    ),
    "a divergence": (
        "two_link_arm",
        RELU,
        None,
        DescentOptions(learning_rate=700.0, iterations=200),
        0.0,
        "not finite",
        1e-3,
    ),
    "a free end": (
        "three_cart",
        RELU,
        None,
        DescentOptions(learning_rate=100.0, iterations=40),
        0.3,
        "at limit",
        1e-10,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_it_is_the_descent_written_out_in_numpy(case: str):
    name, law, eps, settings, size, expected, digits = CASES[case]
    scene = example_scene(name)
    kernel = load_kernel(scene)
    goal = np.array(scene.task.goal, dtype=float)
    goal[0] = np.nan if case == "a free end" else goal[0]
    u0 = size * np.sin(np.arange(scene.task.steps * scene.nu, dtype=float)).reshape(
        scene.task.steps, scene.nu
    )
    told, last, best, rows = descend_in_python(kernel, law, eps, goal, (1.5, 1e-5), u0, settings)
    objective = Objective(kernel, law=law, eps=eps)
    objective.aim(goal, Weights(terminal=1.5, running=1e-5))
    found = descend(objective, u0, settings, 60.0)
    assert told == expected
    assert found.outcome is TOLD.get(told, found.outcome)
    assert told != "settled" or found.outcome in (Outcome.SOLVED, Outcome.STALLED)
    if digits < 1e-3:
        assert len(found.history["loss"]) == len(rows)
    first = min(20, len(rows))  # before a chaotic descent has made its own of a rounding
    for column, expectation in zip(found.history.values(), rows.T, strict=True):
        np.testing.assert_allclose(column[:first], expectation[:first], rtol=max(digits, 1e-9))
        if digits < 1e-3:
            np.testing.assert_allclose(column, expectation, rtol=digits, atol=1e-15)
    if found.u is not None:
        plan = best if settings.iterations is None else last
        assert np.abs(found.u - plan).max() <= 10.0 * digits * max(1.0, np.abs(plan).max())


def test_an_interrupt_is_obeyed_in_the_middle():
    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    objective = Objective(load_kernel(load_scene("three_cart")), law=ContactLaw.RELU)
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt):
            descend(
                objective,
                np.zeros((500, 2)),
                DescentOptions(learning_rate=1e-9, iterations=10**9),
                1e9,
            )
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.slow
@pytest.mark.process
def test_a_descent_imports_no_compiler_that_an_interrupt_could_leave_half_imported():
    """An optimiser of PyTorch does, when it is made: 1 CPU s, and an interrupt in there leaves the process without optimisers."""
    code = """
import sys
import numpy as np
from formulations.shooting.descent import descend
from formulations.shooting.objective import Objective
from formulations.shooting.options import DescentOptions
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
objective = Objective(load_kernel(load_scene("three_cart")), law=ContactLaw.RELU)
found = descend(objective, np.zeros((500, 2)), DescentOptions(learning_rate=500.0, iterations=2), 60.0)
print(found.iterations, "torch" in sys.modules, "torch._dynamo" in sys.modules)
"""
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.stdout == "2 True False\n", run.stderr


def test_a_time_limit_ends_it_with_the_plan_so_far():
    objective = Objective(load_kernel(load_scene("three_cart")), law=ContactLaw.RELU)
    found = descend(
        objective, np.zeros((500, 2)), DescentOptions(learning_rate=1e-9, iterations=10**9), 0.1
    )
    assert found.outcome is Outcome.TIME_LIMIT
    assert found.u is not None
    assert not unsaid(found.message, f"after {found.iterations} iterations … limit of 0.1 s")


def test_a_loss_of_ones_own_is_descended():
    """Changes of the inputs cost, instead of the inputs: a smoother plan, and the loss falls to where its gradient is small."""
    scene = load_scene("three_cart")
    kernel, goal = load_kernel(scene), torch.tensor(scene.task.goal, dtype=torch.float64)

    def smooth(plan, u):
        return (plan.end - goal).square().mean(-1) + 1e-3 * u.diff(dim=-2).square().sum((-2, -1))

    u0 = np.where(np.arange(500)[:, None] % 2 == 0, 3.0, -3.0) * np.ones((1, 2))
    own = descend(
        Objective(kernel, law=ContactLaw.SOFTPLUS, eps=1e-3, loss=smooth),
        u0,
        DescentOptions(learning_rate=100.0, iterations=300),
        60.0,
    )
    papers = descend(
        Objective(kernel, law=ContactLaw.SOFTPLUS, eps=1e-3),
        u0,
        DescentOptions(learning_rate=100.0, iterations=300),
        60.0,
    )
    assert own.u is not None
    assert papers.u is not None
    assert own.history["loss"][-1] < 0.1 * own.history["loss"][0]
    assert np.abs(np.diff(own.u, axis=0)).max() < 0.1 * np.abs(np.diff(papers.u, axis=0)).max()


def _stops(losses, tolerance: float = 1e-4, limit: int = 100000) -> tuple[int, Progress]:
    """Iteration and verdict at which the rule stops on a sequence."""
    rule = Losses()
    for index, loss in enumerate(itertools.islice(losses, limit)):
        progress = rule.add(loss, tolerance)
        if index < 2000:
            assert progress.value == written_out(rule.values, tolerance)
        if progress is not Progress.DESCENDING:
            assert rule.best == min(rule.values)
            assert progress is Progress.RUNAWAY or rule.exhausted or rule.decrease() <= tolerance
            return index, progress
    return limit, Progress.DESCENDING


def _descent(rate: float, floor: float = 1.0):
    return (floor + math.exp(-rate * n) for n in itertools.count())


@pytest.mark.parametrize("rate", [0.1, 0.01, 0.001])
def test_stops_at_the_same_loss_whatever_the_learning_rate(rate: float):
    """Ten times smaller steps take ten times the iterations to the same place, and the rule waits for them."""
    index, progress = _stops(_descent(rate))
    assert progress is Progress.SETTLED
    assert math.exp(-rate * index) < 1e-3  # what is left to gain, relative to the floor


def test_it_depends_on_the_tolerance_and_not_on_the_scale_of_the_loss():
    small, large = ((factor * loss for loss in _descent(0.02)) for factor in (1e-9, 1e9))
    assert _stops(small) == _stops(large)
    assert _stops(_descent(0.01), tolerance=1e-8)[0] > _stops(_descent(0.01), tolerance=1e-3)[0]


@pytest.mark.parametrize(("loss", "progress", "earliest", "latest"), [
    (lambda n: math.exp(-0.1 * n), Progress.SETTLED, 368,
     553),  # to zero: it stops at 1e-20, when nothing is left
    (lambda n: 0.0, Progress.SETTLED, 0, 0),  # nothing to do
    (lambda n: 1.0 + 1.1**n, Progress.RUNAWAY, 0, 60),
    (lambda n: 1.0 + math.exp(-0.02 * n) + (1e3 if n in (40, 130) else 0.0), Progress.SETTLED, 131,
     100000),  # a bad step is forgiven
    # a fixed step across a kink of the loss never comes to rest, but gains nothing either
    (lambda n: 1.0 + math.exp(-0.05 * n) + 1e-3 * (n % 2), Progress.SETTLED, 0, 100000),
], ids=["to zero", "nothing to do", "climbing", "one bad step", "swinging"])  # fmt: skip
def test_where_it_stops(loss, progress: Progress, earliest: int, latest: int):
    index, found = _stops(map(loss, itertools.count()))
    assert found is progress
    assert earliest <= index <= latest


SCENE = load_scene("three_cart")
KERNEL = load_kernel(SCENE)
LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-5))


def _inputs(seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(500, 2))).requires_grad_()


def test_loss_at_rest_is_the_papers_formula():
    """No input, no contact: each position misses by 0.5, each velocity by nothing: mean = 3 * 0.25 / 6."""
    assert Objective(KERNEL, law=ContactLaw.RELU).value(np.zeros((500, 2))) == 0.125


@pytest.mark.parametrize(("law", "eps"), LAWS)
@pytest.mark.parametrize(
    "weights", [Weights(), Weights(terminal=3.0, running=1e-3), Weights(running=0.0)]
)
def test_loss_and_gradient_are_those_of_the_formula_in_plain_pytorch(
    law: ContactLaw, eps: float | None, weights: Weights
):
    """Written once more, on a rollout that shares nothing with the compiled one but the equations."""
    objective, u = Objective(KERNEL, law=law, eps=eps, weights=weights), _inputs()
    loss, gradient = objective.value(u.detach().numpy()), torch.from_numpy(objective.gradient())
    goal = torch.tensor(SCENE.task.goal, dtype=torch.float64)
    q, v, _ = reference_rollout(
        SCENE, u, torch.tensor(SCENE.task.start, dtype=torch.float64), law=law, eps=eps
    )
    error = torch.cat([q[-1], v[-1]]) - goal
    expected = weights.terminal * error.square().mean() + weights.running * reference_cost(
        SCENE, q, v, u
    )
    expected.backward()
    assert loss == pytest.approx(expected.item(), rel=1e-12)
    assert (gradient - u.grad).abs().max() <= 1e-11 * u.grad.abs().max()
    assert objective.cost == pytest.approx(u.square().sum().item(), rel=1e-13)
    assert objective.terminal_error == pytest.approx(error.norm().item(), rel=1e-10)


def test_free_components_of_the_goal_cost_nothing():
    objective, whole = (Objective(KERNEL, law=ContactLaw.RELU) for _ in range(2))
    objective.aim(np.array((np.nan, *SCENE.task.goal[1:])), Weights())
    u = _inputs().detach().numpy()
    whole.value(u)
    assert objective.value(u) == pytest.approx(
        whole.value(u) - whole.error[0] ** 2 / 6.0, rel=1e-12
    )
    assert objective.error[0] == 0.0
    assert np.isfinite(objective.gradient()).all()


def test_divergence_is_an_infinite_loss():
    objective = Objective(KERNEL, law=ContactLaw.RELU)
    assert objective.value(np.full((500, 2), 1e308)) == np.inf
    assert not objective.finite
    assert objective.finite_steps < 500
    assert np.isnan(objective.terminal_error)
    assert objective.value(np.zeros((500, 2))) == 0.125
    assert objective.finite
    assert objective.finite_steps == 500


def test_a_loss_of_ones_own_replaces_the_papers():
    def effort(plan: RolloutTensors, u: torch.Tensor) -> torch.Tensor:
        return u.square().sum((-2, -1)) + plan.v[..., -1, 0]

    objective, u = Objective(KERNEL, law=ContactLaw.RELU, loss=effort), _inputs()
    assert objective.value(u.detach().numpy()) == pytest.approx(
        (u.square().sum() + rollout(KERNEL, u).v[-1, 0]).item(), rel=1e-14
    )
    expected = torch.autograd.grad(effort(rollout(KERNEL, u), u), u)[0]
    assert np.abs(objective.gradient() - expected.numpy()).max() <= 1e-13
    before = objective.value(u.detach().numpy())
    objective.aim(objective.goal + 1.0, Weights(terminal=7.0))
    assert objective.value(u.detach().numpy()) == before


BAD = {
    "no tensor": (
        lambda plan, u: 1.0,
        "the loss returned a float, but must return a PyTorch tensor",
    ),
    "no scalar": (lambda plan, u: plan.q[-1], r"shape \(3,\), but a single number is needed"),
    "no gradient": (
        lambda plan, u: plan.cost.detach(),
        "has no gradient with respect to the inputs",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_loss_that_cannot_be_descended_is_refused_in_a_sentence(case: str):
    loss, words = BAD[case]
    with pytest.raises(ShootingError, match=words):
        Objective(KERNEL, law=ContactLaw.RELU, loss=loss).value(np.zeros((500, 2)))


def test_a_loss_on_another_float_type_and_in_batches():
    """As on a device: float32, without loss of its rows."""
    plan = rollout(KERNEL, _inputs().expand(4, 500, 2))
    loss = GoalLoss(SCENE.task.goal)
    narrow = RolloutTensors(*(tensor.float() for tensor in plan))
    assert loss(narrow, narrow.q).dtype == torch.float32
    assert loss(plan, plan.q).shape == (4,)
    assert torch.allclose(loss(narrow, narrow.q).double(), loss(plan, plan.q), rtol=1e-5)


APART = SCENE.with_task(start=(0.0, 3.0, 6.0, 0.0, 0.0, 0.0), goal=(0.5, 3.5, 6.5, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("options", [{}, {"iterations": 30}])
def test_dead_relu_is_told_with_its_numbers(options: dict[str, object]):
    solution = solve(APART, **options)
    assert solution.outcome is (Outcome.ITERATION_LIMIT if options else Outcome.STALLED)
    assert (solution.trajectory.lam == 0.0).all()
    assert not unsaid(solution.message, "no contact is made anywhere")
    assert not unsaid(
        solution.message,
        "no gradient towards moving q2 … misses its goal by 0.5 m; |d q2/d u| = 0)",
    )
    assert "start from a softplus stage" in solution.message
    gaps = re.search(
        r"smallest gap left ([\d.]+) m at t = ([\d.]+) s, right ([\d.]+) m", solution.message
    )
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
        SCENE, inputs=SCENE.inputs[:1],
        forces=tuple(force.subs(other, 0) for force in SCENE.forces), answers=(),
        task=replace(SCENE.task, running_cost=driven**2),
    )  # fmt: skip
    return row.with_task(
        start=(0.0, 5.0, 5.4, 0.0, 0.0, 0.0), goal=(0.5, 5.5, 6.0, 0.0, 0.0, 0.0), steps=200
    )


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
def test_a_learning_rate_that_is_too_large_is_named_and_a_good_one_is_given(
    name: str, eps: float | None
):
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
    rows, _ = sensitivity(objective, u)
    direction = np.random.default_rng(1).normal(size=u.shape)
    ends = []
    for sign in (1.0, -1.0):
        objective.value(u + sign * 1e-6 * direction)
        ends.append(objective.error.copy())
    assert rows @ direction.ravel() == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-6, abs=1e-8)


def test_growth_is_the_norm_of_the_transition_matrix():
    """Free carts: a velocity decays as (1 - c h)^n and leaves a displacement of sum h (1 - c h)^n behind it."""
    objective = Objective(load_kernel(APART), law=ContactLaw.RELU)
    _, rows = sensitivity(objective, np.zeros((500, 2)))
    decay = 0.98 ** np.arange(1, 501)
    single = np.array([[1.0, 0.01 * decay.sum()], [0.0, decay[-1]]])
    assert np.linalg.norm(rows, 2) == pytest.approx(np.linalg.norm(single, 2), rel=1e-10)


def test_stable_rate_is_two_over_the_largest_curvature():
    """Without contact the loss is quadratic, and its Hessian can be written out."""
    objective = Objective(load_kernel(APART), law=ContactLaw.RELU)
    u = np.zeros((500, 2))
    rows, _ = sensitivity(objective, u)
    hessian = 2.0 / 6.0 * rows.T @ rows + 2.0 * 5e-6 * np.eye(rows.shape[1])
    assert stable_rate(objective, u) == pytest.approx(
        2.0 / np.linalg.eigvalsh(hessian)[-1], rel=1e-4
    )


HILL = example_scene("leaning_mass")


def _growth(steps: int) -> GradientGrowth:
    found = measure_growth(
        load_steps(HILL.with_task(steps=steps)), np.zeros((steps + 1, 2)), np.zeros((steps, 1))
    )
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
    assert growth.factor == pytest.approx(np.linalg.norm(sensitivity(objective, u)[1], 2), rel=1e-9)


def test_what_does_not_grow_is_not_told():
    scene = load_scene("three_cart")
    solution = solve_scene(scene, "relu_gd", options={"iterations": 3}, time_limit=60.0)
    assert "grows" not in solution.message
    assert solution.residuals["gradient_growth"] < 2.0


def test_a_shooting_method_that_fails_of_growth_says_so():
    """Left alone for 5 s the acrobot is far beyond what a gradient can be carried over."""
    scene = load_scene("acrobot_limits").with_task(steps=5000)
    solution = solve_scene(scene, "relu_lbfgs", options={"max_iterations": 30}, time_limit=60.0)
    assert solution.outcome is not Outcome.SOLVED
    assert "The gradient grows by" in solution.message
    assert "over the 5 s" in solution.message
    assert "multiple shooting does not carry it" in solution.message
    assert solution.residuals["growth_rate"] > 0.5
