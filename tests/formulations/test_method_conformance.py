"""What every method must do, run over the catalog: a new file in formulations/methods is tested by existing."""

import re
from dataclasses import asdict, fields
from functools import cache

import numpy as np
import pytest
from example_scenes import example_scene

from formulations.method import Kind, Method, OptionError
from formulations.pipelines import load_method, method_names
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.errors import TrajectoryError
from models.scene import Scene
from models.trajectory import Trajectory

# What plans: every method but the free motion, which is for scenes that leave nothing to plan (test_methods_free_motion.py).
ALL = tuple(name for name in method_names() if name != "free_motion")
BARE = example_scene("oscillator")
SCENE = load_scene("three_cart").with_task(start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=100)
# The same for a method that says why SCENE is too much for it.
LITTLE = SCENE.with_task(steps=6, step=0.15)

# What a method may be begun with: a plan of each kind, of each mathematics behind it.
PLANS = ("softplus_dc", "relaxed_lcp", "strict_lcp", "relu_gd")

# Options that make little work of a method, where it has them: what is tested here holds for few iterations as for many.
FEW = {"iterations": 5, "tolerances": (0.0, 0.05), "worlds": 2}


def scene_for(*names: str) -> Scene:
    """The scene that all these methods accept."""
    return SCENE if all(load_method(name).accepts(SCENE) is None for name in names) else LITTLE


def solved(method: Method, scene: Scene, warm_start: Trajectory | None = None) -> Solution:
    few = {item.name: FEW[item.name] for item in fields(method.options) if item.name in FEW}
    with method.open(scene, few) as session:
        return session.solve(eps=1e-2 if method.needs_eps else None, warm_start=warm_start, time_limit=600.0)


@cache
def first(name: str, scene: Scene) -> Solution:
    """What it finds from a cold start; it is looked at by several tests."""
    found = solved(load_method(name), scene)
    assert found.trajectory is not None
    return found


def test_there_are_methods() -> None:
    assert {"softplus_dc", "relaxed_lcp", "strict_lcp"} <= set(ALL)


@pytest.mark.parametrize("name", ALL)
def test_it_says_what_it_is(name: str) -> None:
    method = load_method(name)
    assert method.name == name
    assert re.fullmatch(r"[a-z][a-z0-9_]*", name)
    assert method.title
    assert isinstance(method.kind, Kind)
    assert isinstance(method.needs_eps, bool)
    for item in fields(method.options):
        assert item.metadata["description"], item.name
    assert method.read_options({}) == method.options()


@pytest.mark.parametrize("name", ALL)
def test_it_refuses_a_scene_without_inputs_with_a_reason(name: str) -> None:
    method = load_method(name)
    assert method.accepts(scene_for(name)) is None
    reason = method.accepts(BARE)
    assert isinstance(reason, str)
    assert "input" in reason
    with pytest.raises(OptionError, match="input"):
        method.open(BARE)


@pytest.mark.parametrize("name", ALL)
def test_it_refuses_options_it_does_not_know(name: str) -> None:
    with pytest.raises(OptionError, match="colour"):
        load_method(name).open(scene_for(name), {"colour": "red"})


@pytest.mark.parametrize("name", ALL)
def test_it_checks_eps(name: str) -> None:
    method = load_method(name)
    wrong = 0.0 if method.needs_eps else 1e-2
    with method.open(scene_for(name)) as session, pytest.raises(OptionError, match="eps"):
        session.solve(eps=wrong, warm_start=None, time_limit=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_its_answer_is_whole(name: str) -> None:
    scene = scene_for(name)
    solution = first(name, scene)
    assert isinstance(solution, Solution)
    assert solution.method == name
    assert isinstance(solution.outcome, Outcome)
    assert solution.outcome.has_answer, solution.message
    plan = solution.trajectory
    plan.check_fits(scene)
    assert plan.steps == scene.task.steps
    assert plan.has_uniform_grid()
    for array in (plan.t, plan.q, plan.v, plan.u, plan.lam):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(plan.start, scene.task.start, rtol=0, atol=1e-9)
    assert solution.cost == pytest.approx(float((plan.u**2).sum()), rel=1e-12)
    assert solution.iterations >= 0
    assert set(solution.options) == set(asdict(load_method(name).options()))
    assert solution.residuals
    assert all(np.isfinite(value) for value in solution.residuals.values())
    assert "terminal_error" in solution.residuals
    assert len({len(column) for column in solution.history.values()}) <= 1, "columns of a history, if there is one, are equally long"
    assert all(np.isfinite(column).all() for column in solution.history.values())
    seconds = solution.seconds
    assert min(seconds.build, seconds.translate, seconds.evaluate, seconds.linear_algebra) >= 0
    assert seconds.wall > 0
    assert seconds.build + seconds.translate + seconds.solve <= seconds.wall * 1.001 + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_it_repeats_itself_bit_for_bit(name: str) -> None:
    scene = scene_for(name)
    one, two = first(name, scene), solved(load_method(name), scene)
    assert (one.outcome, one.iterations, one.residuals, one.history) == (two.outcome, two.iterations, two.residuals, two.history)
    for field in ("t", "q", "v", "u", "lam"):
        assert np.array_equal(getattr(one.trajectory, field), getattr(two.trajectory, field)), field


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_it_starts_from_the_plan_of_any_other(name: str) -> None:
    for other in PLANS:
        scene = scene_for(name, other)
        assert solved(load_method(name), scene, first(other, scene).trajectory).trajectory is not None, other


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_it_refuses_a_plan_that_does_not_fit(name: str) -> None:
    scene = scene_for(name)
    plan = first(name, scene).trajectory
    shorter = Trajectory(t=plan.t[:-1], q=plan.q[:-1], v=plan.v[:-1], u=plan.u[:-1], lam=plan.lam[:-1])
    with pytest.raises(TrajectoryError, match="steps"):
        solved(load_method(name), scene, shorter)
