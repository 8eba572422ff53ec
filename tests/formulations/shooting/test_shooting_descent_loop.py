"""The compiled loop of gradient descent against the same written out in Python: equal bits, whatever the slices it runs in; and interrupts."""

import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from descent_in_python import descend_in_python

from formulations.shooting.compiled import CompiledLoss, DescentRun, Ending
from formulations.shooting.descent import Settings, descend
from formulations.shooting.ending import input_bounds
from formulations.shooting.errors import ShootingError
from formulations.shooting.objective import Objective, Weights
from formulations.shooting.smoothed import SmoothedObjective, noise
from models.catalog import load_scene, scene_names
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.scene import Scene

SCENES = Path(__file__).parents[2] / "scenes"
# The norm of a gradient is added up in another order than a BLAS does: 1000 squares of one sign.
NORM = 1e-14


def _scene(name: str) -> Scene:
    return load_scene(name if name in scene_names() else str(SCENES / f"{name}.py"))


def _run(objective: Objective, u0: np.ndarray, settings: Settings, slices: int) -> tuple[Ending, DescentRun]:
    lower, upper = input_bounds(objective.work.kernel.scene)
    run = DescentRun(
        CompiledLoss(objective),
        np.clip(u0, lower, upper),
        rate=settings.learning_rate,
        limit=settings.max_iterations if settings.iterations is None else settings.iterations,
        tolerance=settings.tolerance if settings.iterations is None else None,
        lower=lower,
        upper=upper,
    )
    while (ending := run.advance(slices)) is Ending.UNDER_WAY:
        pass
    return ending, run


# scene, law, eps, settings, size of the first inputs, how it ends
CASES = {
    "the paper's descent": ("three_cart", ContactLaw.SOFTPLUS, 1e-3, Settings(learning_rate=500.0, iterations=300), 0.0, "at limit"),
    "our own rule": ("three_cart", ContactLaw.RELU, None, Settings(learning_rate=500.0), 0.5, "settled"),
    "at the bounds": ("three_cart", ContactLaw.RELU, None, Settings(learning_rate=5e4, max_iterations=400), 12.0, "runaway"),
    "too long steps": ("three_cart", ContactLaw.SOFTPLUS, 1e-5, Settings(learning_rate=3e3, max_iterations=2000), 0.0, "runaway"),
    "a mass matrix that turns": ("two_link_arm", ContactLaw.RELU, None, Settings(learning_rate=1.0, iterations=60), 0.1, "at limit"),
    "a divergence": ("two_link_arm", ContactLaw.RELU, None, Settings(learning_rate=700.0, iterations=200), 0.0, "not finite"),
    "a free end": ("three_cart", ContactLaw.RELU, None, Settings(learning_rate=100.0, iterations=40), 0.3, "at limit"),
}


@pytest.mark.parametrize("case", CASES)
def test_bits_are_those_of_the_loop_in_python(case: str):
    name, law, eps, settings, size, expected = CASES[case]
    scene = _scene(name)
    goal = (None, *(scene.task.goal or ())[1:]) if case == "a free end" else None
    objective = Objective(load_kernel(scene), law=law, eps=eps, weights=Weights(terminal=1.5, running=1e-5), goal=goal)
    u0 = size * np.sin(np.arange(scene.task.steps * scene.nu, dtype=float)).reshape(scene.task.steps, scene.nu)
    told, last, best, rows = descend_in_python(objective, u0, settings)
    assert told == expected
    for slices in (1, 97, 10**6):
        ending, run = _run(objective, u0, settings, slices)
        assert ending.name.lower().replace("_", " ") == told
        assert (run.u == last).all()
        assert (run.best == best).all()
        assert run.evaluations == len(rows)
        assert (rows[:, :3] == run.columns[:3].T).all()
        assert run.columns[3] == pytest.approx(rows[:, 3], rel=NORM)


def test_an_interrupt_is_obeyed_in_the_middle():
    """The loop looks up every twentieth of a second, however many iterations were asked for."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    objective = Objective(load_kernel(_scene("three_cart")), law=ContactLaw.RELU)
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt):
            descend(objective, np.zeros((500, 2)), Settings(learning_rate=1e-9, iterations=10**9), 1e9)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_mean_over_random_inputs_is_that_of_single_evaluations():
    scene = _scene("three_cart")
    kernel, added = load_kernel(scene), noise(scene, deviation=0.2, unbounded=1.0, samples=8, pieces=5, seed=3)
    smoothed, single = SmoothedObjective(kernel, weights=Weights(), noise=added), Objective(kernel, law=ContactLaw.RELU)
    u = np.cos(np.arange(1000.0)).reshape(500, 2)
    losses, gradient = [], np.zeros_like(u)
    for sample in added:
        losses.append(single.value(u + sample))
        gradient += single.gradient()
    total = 0.0
    for loss in losses:
        total += loss
    assert smoothed.value(u) == total / len(added)
    assert (smoothed.gradient() == gradient / len(added)).all()
    assert single.value(u) > 0.0
    assert (smoothed.cost, smoothed.terminal_error) == (single.cost, single.terminal_error)
    assert smoothed.value(np.full_like(u, 1e308)) == np.inf


def test_a_loss_with_noise_is_not_descended_without_it():
    scene = _scene("three_cart")
    added = noise(scene, deviation=0.2, unbounded=1.0, samples=2, pieces=5, seed=3)
    objective = SmoothedObjective(load_kernel(scene), weights=Weights(), noise=added)
    with pytest.raises(ShootingError, match="without noise"):
        descend(objective, np.zeros((500, 2)), replace(Settings(learning_rate=1.0), iterations=1), 60.0)
