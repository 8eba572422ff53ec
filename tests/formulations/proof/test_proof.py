"""Proofs: against all modes tried one by one, bounds that no exact plan leaves, plans that do not count, refusals."""

import importlib.util
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from formulations.contact_modes.linear import linear_scene
from formulations.contact_modes.quadratic import ModesProblem
from formulations.method import OptionError
from formulations.pipelines import load_method, solve_scene
from formulations.proof import ProofStatus, pair_bounds, prove, relaxed_bound
from formulations.proof.bounds import energy_bound, physical_bounds
from formulations.proof.prove import GAP, is_exact
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import MachineError, SceneError
from models.scene import Scene
from models.scene.parts import goal_limits
from tests.formulations.transcription.rollouts import rolled_out

PENDULUM = load_scene("wall_pendulum")
CARTS = load_scene("three_cart")
LITTLE = CARTS.with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.1, 2.7, 3.3, 0.0, 0.0, 0.0), steps=6, step=0.15
)
SHORT = PENDULUM.with_task(start=(0.07, 0.8), steps=9)
# Of a goal is asked how near is near enough.
ASKED = replace(SHORT, limits=(*SHORT.limits, *goal_limits(position=0.01, reason="this test")))


@cache
def cheapest_of_all_modes(scene: Scene) -> float:
    """Every choice of modes by the banded quadratic program, which knows nothing of SCIP, Clarabel and big-M."""
    problem, T, nc = ModesProblem(linear_scene(scene)), scene.task.steps, scene.nc
    best = np.inf
    for modes in product((False, True), repeat=(T - 1) * nc):
        answer = problem.solve(
            np.vstack([np.zeros((1, nc), dtype=bool), np.reshape(modes, (T - 1, nc))]), below=best
        )
        best = best if answer is None else min(best, answer.cost)
    return best


@pytest.mark.slow
@pytest.mark.parametrize("scene", [LITTLE, SHORT], ids=["three_cart", "wall_pendulum"])
def test_the_proved_optimum_is_the_best_of_all_modes(scene: Scene):
    proof = prove(
        scene, time_limit=60.0
    )  # of which a tenth goes to a first plan, all of it on the pendulum
    assert proof.status is ProofStatus.OPTIMAL
    best = cheapest_of_all_modes(scene)
    assert proof.cost == pytest.approx(best, rel=1e-9)
    assert best * (1.0 - GAP) <= proof.bound <= best * (1.0 + 1e-9)
    assert proof.plan is not None
    assert is_exact(scene, proof.plan)
    assert proof.pairs == (scene.task.steps - 1) * scene.nc


@pytest.mark.slow
def test_seconds_are_those_of_opening_and_of_the_proof():
    with load_method("global").open(LITTLE) as session:
        first, second = (
            session.solve(eps=None, warm_start=None, time_limit=60.0).seconds for _ in range(2)
        )
    assert first.build > 0.0
    assert second.build == 0.0, "opened once"
    for found in (first, second):
        assert found.wall == found.build + found.linear_algebra
        assert found.cpu > 0.0


def test_the_pendulum_against_its_wall_is_proved():
    local = solve_scene(PENDULUM, "mpcc", time_limit=60.0)
    with load_method("global").open(PENDULUM) as session:
        solution = session.solve(eps=None, warm_start=local.trajectory, time_limit=300.0)
    assert solution.outcome is Outcome.SOLVED, solution.message
    assert solution.bound.proved
    assert solution.cost == pytest.approx(local.cost, rel=1e-9)
    assert solution.cost == pytest.approx(PENDULUM.answers[0].value, rel=1e-9)
    assert solution.bound.value <= PENDULUM.answers[0].value * (1.0 + 1e-12)
    assert solution.bound.decisions == 19


# The same with a cost whose optimum is nowhere near nought: it has a linear part and a constant.
_u, _theta, _omega = (
    next(item for item in PENDULUM.task.running_cost.free_symbols if item.name == name)
    for name in ("u", "theta", "omega")
)
AWAY = PENDULUM.with_task(running_cost=(_theta - 1) ** 2 + (_omega + 2) ** 2 + (_u - 3) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [PENDULUM, AWAY], ids=["as it is", "with a linear cost"])
def test_no_exact_plan_leaves_the_bounds(scene: Scene):
    """Random inputs: whatever costs no more than the ceiling keeps every bound, else the big-M would cut it off."""
    linear, random = linear_scene(scene), np.random.default_rng(0)
    plans = [
        rolled_out(scene, random.uniform(-1.5, 1.5, 1) + random.uniform(-0.7, 0.7, (20, 1)))
        for _ in range(300)
    ]
    costs = [load_kernel(scene).cost(plan.q, plan.v, plan.u) for plan in plans]
    ceiling = float(np.median(costs))
    bounds = pair_bounds(scene, linear, ceiling)
    kept = [plan for plan, cost in zip(plans, costs, strict=True) if cost <= ceiling]
    phi = np.stack([load_kernel(scene).penetration(plan.q[:-1]) for plan in kept])
    assert len(kept) >= 100
    assert not bounds.is_empty
    assert (phi >= bounds.lower - 1e-12).all()
    assert (phi <= bounds.upper + 1e-12).all()
    dearer = np.stack([load_kernel(scene).penetration(plan.q[:-1]) for plan in plans])
    assert ((dearer > bounds.upper) | (dearer < bounds.lower)).any(), (
        "the ceiling was meant to cut something off"
    )


@pytest.mark.slow
def test_cheap_plans_have_little_energy():
    random = np.random.default_rng(1)
    for _ in range(40):
        close = CARTS.with_task(
            start=(2.0, 2.0 + random.uniform(0.45, 0.6), 3.1, *random.uniform(-0.5, 0.5, 3))
        )
        plan = rolled_out(
            close,
            random.uniform(-10, 10, (1, 2))
            * np.sin(random.uniform(0, 0.1, (1, 2)) * np.arange(500)[:, None]),
        )
        found = energy_bound(close, float((plan.u**2).sum()))
        phi = load_kernel(close).penetration(plan.q)
        assert (phi <= found.penetration).all()
        assert (np.abs(np.diff(phi, axis=0)) <= found.approach * 0.01).all()
    assert energy_bound(PENDULUM, 1.0) is None, "gravity does work"
    assert energy_bound(CARTS.with_task(step=0.25), 1.0) is None, (
        "so long a step makes energy of its own"
    )


def test_the_relaxation_bounds_the_known_optimum():
    linear, known = linear_scene(CARTS), CARTS.answers[0].value
    bounds = physical_bounds(CARTS, linear, known)
    bound = relaxed_bound(linear, bounds.lower, bounds.upper, known)
    assert 100.0 < bound < known


def test_a_plan_that_cheats_does_not_count():
    honest = rolled_out(SHORT, np.zeros((9, 1)))
    assert is_exact(SHORT, honest)
    for name, change in (("lam", 1e-4), ("v", 1e-6), ("q", 1e-6), ("u", 1e-3)):
        array = np.array(getattr(honest, name))
        array[5, 0] += change
        assert not is_exact(SHORT, replace(honest, **{name: array})), name
    assert not is_exact(ASKED.with_task(goal=(0.0, None)), honest)


@pytest.mark.slow
def test_a_lie_is_no_incumbent():
    honest = rolled_out(LITTLE, np.zeros((LITTLE.task.steps, LITTLE.nu)))
    lie = replace(honest, q=np.zeros_like(honest.q), lam=np.zeros_like(honest.lam))
    assert prove(LITTLE, incumbent=lie, time_limit=300.0).cost == pytest.approx(
        cheapest_of_all_modes(LITTLE), rel=1e-9
    )


# 38 decisions of which bounds alone leave most open, with a gap of 0.38 after four seconds.
LONG = CARTS.with_task(
    start=(2.0, 2.6, 3.2, 0.0, 0.0, 0.0), goal=(2.3, 2.9, 3.5, 0.0, 0.0, 0.0), steps=20, step=0.1
)


@pytest.mark.slow
def test_a_proof_that_is_cut_off_by_time_is_none():
    """Although the plan that it knows is, as far as anybody knows, the best."""
    known = solve_scene(LONG, "mpcc", time_limit=60.0)
    proof = prove(LONG, incumbent=known.trajectory, time_limit=3.0)
    assert proof.status is ProofStatus.BOUND
    assert proof.cost <= known.cost * (1.0 + 1e-9)
    assert proof.bound < 0.99 * known.cost, (
        "the bound is SCIP's, not that of the ceiling under which it searched"
    )
    assert "Not proved in the time given" in proof.sentence
    with load_method("global").open(LONG) as session:
        told = session.solve(eps=None, warm_start=known.trajectory, time_limit=3.0)
    assert told.outcome is Outcome.TIME_LIMIT
    assert told.bound is None or (
        told.bound.proved,
        told.bound.decisions,
        told.bound.value < 0.99 * known.cost,
    ) == (False, 38, True)


@pytest.mark.parametrize("seconds", [1e-3, 0.03, 0.3, 1.0, 3.0])
def test_no_bound_is_above_the_optimum_whenever_it_is_cut_off(seconds: float):
    known = PENDULUM.answers[0].value
    proof = prove(PENDULUM, incumbent=rolled_out(PENDULUM, np.zeros((20, 1))), time_limit=seconds)
    assert proof.bound <= known * (1.0 + 1e-9)
    assert proof.cost is None or proof.cost >= known * (1.0 - 1e-9)
    proved = proof.cost is not None and proof.cost <= known * (1.0 + 2 * GAP)
    assert proof.status is not ProofStatus.INFEASIBLE
    assert proved or proof.status is not ProofStatus.OPTIMAL


def test_no_plan_at_all_is_proved_too():
    proof = prove(ASKED.with_task(goal=(-0.5, None)), time_limit=60.0)
    assert proof.status is ProofStatus.INFEASIBLE
    assert (proof.plan, proof.bound, proof.gap) == (None, np.inf, None)


@pytest.mark.slow
def test_refusals(monkeypatch):
    method = load_method("global")
    assert "998 contact decisions" in str(method.accepts(CARTS))
    arm = load_scene(str(Path(__file__).parents[2] / "scenes" / "two_link_arm.py")).with_task(
        steps=20
    )
    assert "not linear" in str(method.accepts(arm))
    with pytest.raises(SceneError, match="not linear"):
        prove(arm)
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *rest: None if name == "pyscipopt" else find(name, *rest),
    )
    assert "pip install pyscipopt" in str(method.accepts(PENDULUM))
    with pytest.raises(OptionError, match="SCIP"):
        method.open(PENDULUM)
    with pytest.raises(MachineError, match="pyscipopt"):
        prove(PENDULUM)
