"""The quadratic program of fixed modes against Ipopt on the Pyomo model of the same modes: two roads that share no line. Its banded LU, its models that are used again, and the signs of multipliers against costs: a negative one names the mode that is cheaper."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from example_scenes import example_scene

import formulations.transcription.compiled
from formulations.contact_modes.dual_active_set import interior_point_active_set
from formulations.contact_modes.linear import BandedLU, is_linear, linear_scene
from formulations.contact_modes.nonlinear import NonlinearModes
from formulations.contact_modes.quadratic import ModesProblem, stationarity_of
from formulations.contact_modes.search import closed_steps
from formulations.contact_modes.session import MpccSession
from formulations.pipelines import load_method
from formulations.transcription.method import SolveBudget
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene

SCENE = load_scene("three_cart")
ARM = example_scene("two_link_arm")
BEST = closed_steps((((131, 179),), ((276, 307),)), 500)


def random_scene(seed: int, bound: float) -> tuple[Scene, np.ndarray]:
    """Three carts pressed together by random inputs, and the modes of that rollout.

    Its end is the goal: these modes have a plan.
    """
    random = np.random.default_rng(seed)
    scene = SCENE.with_parameters(k=random.uniform(20.0, 80.0), c=random.uniform(0.5, 2.0))
    inputs = tuple(replace(item, lower=-bound, upper=bound) for item in scene.inputs)
    scene = replace(scene, inputs=inputs).with_task(
        start=(0.0, 0.53, 1.07, 0.0, 0.0, 0.0), steps=120, step=0.02
    )
    u = bound * np.repeat(random.uniform(-0.4, 1.0, (12, 2)) * np.array([1.0, -1.0]), 10, axis=0)
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
    return scene.with_task(goal=(*rollout.q[-1], *rollout.v[-1])), rollout.lam > 0


def by_ipopt(scene: Scene, closed: np.ndarray):
    modes = NonlinearModes(scene, load_kernel(scene))
    return modes.begin(SolveBudget(600.0), {"tol": 1e-10, "max_iter": 3000}).solve(closed)


def test_the_known_optimum() -> None:
    answer = ModesProblem(linear_scene(SCENE)).solve(BEST)
    assert answer.cost == pytest.approx(490.5495305, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("bound", [10.0, 1.6])
def test_it_agrees_with_ipopt_on_random_problems(seed: int, bound: float) -> None:
    scene, closed = random_scene(seed, bound)
    ours, theirs = ModesProblem(linear_scene(scene)).solve(closed), by_ipopt(scene, closed)
    assert closed.any()
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-6)
    np.testing.assert_allclose(ours.u, theirs.u, atol=1e-3)
    np.testing.assert_allclose(ours.phi, theirs.phi, atol=1e-5)


def test_some_of_these_problems_have_active_bounds_and_signs() -> None:
    """Otherwise the comparison above would say little."""
    held, touching = 0, 0
    for seed in range(4):
        scene, closed = random_scene(seed, 1.6)
        answer = ModesProblem(linear_scene(scene)).solve(closed)
        held, touching = (
            held + int((answer.active.side != 0).sum()),
            touching + int(answer.active.touching.sum()),
        )
    assert held > 0
    assert touching > 0


def test_optimality_conditions_hold() -> None:
    """Recomputed from the scene's matrices: time step, signs of penetrations and of multipliers, slope of free inputs."""
    scene, closed = random_scene(1, 1.6)
    linear = linear_scene(scene)
    problem = ModesProblem(linear)
    answer = problem.solve(closed)
    z, u, y = answer.point.z, answer.point.u, answer.point.y
    lam = np.where(answer.closed, linear.k * answer.phi, 0.0)
    np.testing.assert_allclose(
        z[1:], z[:-1] @ linear.A.T + u @ linear.B.T + linear.c + lam @ linear.E.T, atol=1e-11
    )
    assert (np.where(answer.closed, answer.phi, -answer.phi)[1:] >= -1e-11).all()
    slope = 2 * u + y @ linear.B  # the running cost is |u|^2
    assert np.abs(slope[answer.active.side == 0]).max() <= 1e-8
    assert (answer.active.side != 0).any()
    assert (slope[answer.active.side < 0] >= -1e-8).all()
    assert (slope[answer.active.side > 0] <= 1e-8).all()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("softness", [0.0, 1e-3])
def test_the_interior_point_names_the_conditions_that_are_active(
    seed: int, softness: float
) -> None:
    scene, closed = random_scene(seed, 1.6)
    linear = linear_scene(scene)
    problem = ModesProblem(linear)
    problem.softness = softness
    answer = problem.solve(closed)
    named = interior_point_active_set(linear, closed, softness)
    assert named is not None
    held = problem._rounds(closed, named, most=2)
    assert held is not None, (
        "two rounds, so that a condition whose multiplier is zero may be named or not"
    )
    assert held.cost == pytest.approx(answer.cost, rel=1e-11)


def test_the_interior_point_finds_nothing_where_there_is_no_plan() -> None:
    linear, nobody = linear_scene(SCENE), np.zeros((500, 2), dtype=bool)
    assert interior_point_active_set(linear, nobody) is None
    assert interior_point_active_set(linear, nobody, softness=1e-3) is not None, (
        "whatever the modes, some inputs come nearest"
    )


def test_modes_without_a_plan_have_no_answer() -> None:
    problem = ModesProblem(linear_scene(SCENE))
    assert problem.solve(np.zeros((500, 2), dtype=bool)) is None, "nobody pushes the middle cart"
    assert problem.solve(closed_steps((((0, 3),), ((276, 307),)), 500)) is None, (
        "the left cart cannot be there that early"
    )


def test_a_ceiling_only_hides_what_costs_more() -> None:
    problem = ModesProblem(linear_scene(SCENE))
    worse = closed_steps((((140, 190),), ((270, 300),)), 500)
    free = problem.solve(worse)
    assert problem.solve(worse, below=free.cost * 0.999) is None
    found = problem.solve(worse, below=free.cost * 1.001)
    assert found.cost == pytest.approx(free.cost, rel=1e-12)


def test_the_numbers_of_a_linear_scene_are_those_of_the_compiled_step() -> None:
    linear, kernel = linear_scene(SCENE), load_kernel(SCENE)
    random = np.random.default_rng(3)
    u = random.uniform(-10, 10, (200, 2)) + np.array([5.0, -5.0])
    rollout = kernel.rollout(np.array([0.0, 0.52, 1.04, 0.0, 0.0, 0.0]), u, SCENE.task.step)
    z = np.hstack([rollout.q, rollout.v])
    assert (rollout.lam > 0).any()
    np.testing.assert_allclose(
        z[1:],
        z[:-1] @ linear.A.T + u @ linear.B.T + linear.c + rollout.lam @ linear.E.T,
        atol=1e-12,
    )
    np.testing.assert_allclose(linear.penetration(z), kernel.penetration(rollout.q), atol=1e-14)
    assert linear.cost(z[:-1], u) == pytest.approx((u**2).sum(), rel=1e-13)


def test_is_linear_only_convex_quadratic_programs() -> None:
    assert is_linear(SCENE)
    assert not is_linear(ARM)
    u1, u3 = (item.symbol for item in SCENE.inputs)
    assert not is_linear(SCENE.with_task(running_cost=u1**2 - u3**2))
    assert not is_linear(SCENE.with_task(running_cost=u1**4 + u3**2))
    assert not is_linear(SCENE.with_task(final_cost=SCENE.coordinates[0].symbol ** 2))


def test_what_modes_cost_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked for less than they were found to cost, nothing is solved.

    Asked for more, or with a softer goal, they are.
    """
    problem = ModesProblem(linear_scene(SCENE))
    factored: list[None] = []
    factor = problem.kkt.factor
    monkeypatch.setattr(
        problem.kkt,
        "factor",
        lambda *given, **named: (factored.append(None), factor(*given, **named))[1],
    )
    answer = problem.solve(BEST)
    once = len(factored)
    assert problem.solve(BEST, near=answer, below=answer.cost) is None
    assert problem.solve(BEST, below=0.9 * answer.cost) is None
    assert len(factored) == once
    assert problem.solves == 3, "it counts as tried all the same"
    again = problem.solve(BEST, near=answer, below=1.1 * answer.cost)
    assert again.cost == pytest.approx(answer.cost, rel=1e-12)
    problem.softness = 1e-3
    nearer = problem.solve(BEST, below=answer.cost)
    assert nearer.cost < answer.cost
    assert len(factored) > once


def random_band(seed: int, size: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(dense, band): half of the band is zero, and so is most of the diagonal, as in an optimality system."""
    random = np.random.default_rng(seed)
    dense = random.normal(size=(size, size)) * (random.uniform(size=(size, size)) < 0.5)
    np.fill_diagonal(
        dense, np.where(random.uniform(size=size) < 0.8, 0.0, random.normal(size=size))
    )
    band = np.zeros((2 * width + 1, size), order="F")
    for i in range(size):
        for j in range(size):
            if abs(i - j) <= width:
                band[width + i - j, j] = dense[i, j]
            else:
                dense[i, j] = 0.0
    return dense, band


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("size", "width"), [(1, 0), (3, 2), (40, 1), (60, 7), (9, 8)])
def test_it_solves_and_multiplies_as_numpy_does(seed: int, size: int, width: int) -> None:
    dense, band = random_band(seed, size, width)
    lu, random = BandedLU(size, width), np.random.default_rng(seed)
    is_regular = abs(np.linalg.det(dense)) > 0.0
    if lu.factor(band):
        right = random.normal(size=size)
        np.testing.assert_allclose(
            lu.product(right), dense @ right, atol=1e-12 * max(1.0, np.abs(dense).max() * size)
        )
        if np.linalg.cond(dense) < 1e8:
            np.testing.assert_allclose(
                lu.solve(right), np.linalg.solve(dense, right), rtol=1e-7, atol=1e-7
            )
    else:
        assert not is_regular or np.linalg.cond(dense) > 1e8


def test_a_matrix_with_an_empty_column_is_singular() -> None:
    band = np.zeros((3, 5), order="F")
    band[1] = 1.0
    lu = BandedLU(5, 1)
    assert lu.factor(band)
    band = band.copy(order="F")
    band[1, 3] = 0.0
    assert not lu.factor(band)
    assert lu.factor(
        np.asfortranarray(np.where(np.arange(3)[:, None] == 1, 2.0, 0.0) * np.ones(5))
    ), "nothing of the failure is left"
    np.testing.assert_allclose(lu.solve(np.ones(5)), 0.5)


def opened(**options: object) -> MpccSession:
    return cast(MpccSession, load_method("mpcc").open(ARM, {"search": False, **options}))


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The models that were translated."""
    models: list[object] = []
    compile_model = formulations.transcription.compiled.compile_model
    monkeypatch.setattr(
        formulations.transcription.compiled,
        "compile_model",
        lambda model: (models.append(model), compile_model(model))[1],
    )
    return models


@pytest.mark.slow
def test_models_used_before_give_the_same_starts(compiled: list[object]) -> None:
    session = opened(starts=5)
    first, again = (session.solve(eps=None, warm_start=None, time_limit=600.0) for _ in range(2))
    assert len(compiled) == 3, "two schedules of softplus, and the problem with modes fixed"
    assert again.starts == first.starts
    assert first.cost == min(start.cost for start in first.starts if start.cost is not None)


@pytest.mark.parametrize(("pairs", "strong", "least", "words"), [
    ([(1.0, 2.0), (0.0, 3.0)], True, 0.0, "S-stationary: 2 pairs touch"),
    ([(1.0, 2.0), (0.0, -3.0)], False, -3.0, "Not S-stationary: 2 pairs touch"),
    ([(-1.0, 2.0)], False, -1.0, "Not S-stationary: 1 pair touches"),
    ([(-4e-5, 2.0)], True, -4e-5, "S-stationary: 1 pair touches"),
    ([], True, 0.0, "S-stationary: no contact touches"),
])  # fmt: skip
def test_stationarity_of_pairs_is_decided_by_signs(
    pairs: list[tuple[float, float]], strong: bool, least: float, words: str
) -> None:
    force, separation = (
        np.full((8, 1), 50.0),
        np.full((8, 1), -50.0),
    )  # of pairs that are not biactive: they do not count
    biactive = np.zeros((8, 1), dtype=bool)
    for t, (of_force, of_separation) in enumerate(pairs):
        force[t], separation[t], biactive[t] = of_force, of_separation, True
    found = stationarity_of(force, separation, biactive)
    assert (found.strong, found.biactive, found.least) == (strong, len(pairs), least)
    assert found.sentence.startswith(words)


@pytest.mark.parametrize(("contact", "shift"), [(0, -2), (0, 2), (1, -2), (1, 2)])
def test_a_negative_multiplier_names_a_cheaper_mode(contact: int, shift: int) -> None:
    """Intervals that begin wrongly: where the pair that touches has a negative multiplier, the other mode there is cheaper."""
    intervals = [[131, 179], [276, 307]]
    intervals[contact][0] += shift
    problem = ModesProblem(linear_scene(SCENE))
    answer = problem.solve(closed_steps(tuple(((first, stop),) for first, stop in intervals), 500))
    assert answer.cost > 490.5495306
    negative = [
        (t, c)
        for t, c in zip(*np.nonzero(answer.active.touching), strict=True)
        if (answer.of_force if not answer.closed[t, c] else answer.of_separation)[t, c] < -1e-6
    ]
    costs = []
    for t, c in negative:
        closed = answer.closed.copy()
        closed[t, c] = not closed[t, c]
        other = problem.solve(closed)
        costs.append(np.inf if other is None else other.cost)
    assert negative
    assert min(costs) < answer.cost
