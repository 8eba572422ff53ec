"""Several worlds as one scene: its parts by hand, which numbers harm most, and a plan that misses by less where they are otherwise."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from formulations.methods.robust import ensemble, harmful
from formulations.pipelines import load_method
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.trajectory import Trajectory

SCENE = load_scene("three_cart").with_task(steps=100, step=0.05)


def test_worlds_are_copies_of_the_scene_with_other_numbers():
    # m, c, k, d, gains of u1 and u3, start of q1..q3 and v1..v3.
    point = np.array([1.0, 0.0, 0.0, -2.0, 0.5, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    whole = ensemble(SCENE, point[None], 7.0)
    assert [item.name for item in whole.coordinates] == ["q1", "q2", "q3", "q1_1", "q2_1", "q3_1"]
    assert [item.name for item in whole.contacts] == ["left", "right", "left_1", "right_1"]
    assert whole.inputs == SCENE.inputs
    q, v = (sp.Symbol(f"{name}_1", real=True) for name in ("q3", "v3"))
    values = SCENE.parameter_values
    mass, damping = (next(symbol for symbol in values if symbol.name == name) for name in ("m", "c"))
    kinetic = whole.kinetic_energy.coeff(v, 2)
    assert float(kinetic) == pytest.approx(values[mass] * 1.05 / 2.0)
    u1 = SCENE.inputs[0].symbol
    assert float(whole.forces[3].coeff(u1)) == pytest.approx(1.01), "half of 2 % more"
    assert float(whole.forces[5].coeff(v)) == pytest.approx(-values[damping])
    length = next(value for symbol, value in values.items() if symbol.name == "d")
    apart = {item.symbol: 0.0 for item in whole.coordinates}
    assert float(whole.contacts[2].penetration.subs(apart)) == pytest.approx(0.9 * length)
    assert whole.task.start[3:6] == pytest.approx((*SCENE.task.start[:2], SCENE.task.start[2] + 0.03 * SCENE.coordinates[2].nominal))
    assert whole.task.goal[:3] == SCENE.task.goal[:3]
    assert whole.task.goal[3:6] == (None,) * 3
    at = {item.symbol: 0.0 for item in whole.coordinates} | {item.velocity: 0.0 for item in whole.coordinates}
    goal = SCENE.task.goal
    ends = dict(zip([item.symbol for item in whole.coordinates[3:]], goal[:3], strict=True)) | {q: goal[2] + 0.12}  # type: ignore[operator]
    assert float(whole.task.final_cost.subs(at | ends)) == pytest.approx(7.0 * (0.12 / 0.06) ** 2 / 2.0), (
        "a mean over two worlds, in squares of the limit"
    )
    assert sp.simplify(whole.task.running_cost - SCENE.task.running_cost) == 0


def miss(scene: Scene, plan: Trajectory, **values: float) -> float:
    """How far the plan's inputs end from the goal where parameters are otherwise, by the scene's own time step [m]."""
    moved = load_kernel(scene.with_parameters(**values)).rollout(np.array(scene.task.start), plan.u, scene.task.step)
    return float(np.linalg.norm(moved.q[-1] - np.array(scene.task.goal[:3], dtype=float)))


@pytest.mark.slow
def test_a_robust_plan_ends_nearer_where_what_harms_most_is_otherwise_and_costs_more():
    with load_method("mpcc").open(SCENE, {}) as session:
        alone = session.solve(eps=None, warm_start=None, time_limit=1e4)
    with load_method("robust").open(SCENE, {"pairs": 1, "weight": 2.0}) as session:
        found = session.solve(eps=None, warm_start=None, time_limit=1e4)
    plan = found.trajectory
    assert alone.trajectory is not None
    assert alone.cost is not None
    assert plan is not None
    plan.check_fits(SCENE)
    (more, less) = harmful(SCENE, alone.trajectory, 1)
    assert (more + less == 0.0).all()
    assert np.flatnonzero(more).tolist() == [1], "the damping"
    assert found.cost == pytest.approx(load_kernel(SCENE).cost(plan.q, plan.v, plan.u))
    assert found.cost is not None
    assert found.cost > alone.cost
    assert miss(SCENE, plan) < 1e-6
    c = SCENE.parameter_values[next(symbol for symbol in SCENE.parameter_values if symbol.name == "c")]
    before, after = (max(miss(SCENE, one, c=share * c) for share in (0.95, 1.05)) for one in (alone.trajectory, plan))
    assert after < 0.9 * before


@pytest.mark.slow
def test_where_no_plan_is_found_for_all_worlds_that_for_the_scene_alone_is_kept_and_not_called_solved():
    with load_method("robust").open(SCENE, {"max_iterations": 1}) as session:
        found = session.solve(eps=None, warm_start=None, time_limit=1e4)
    assert found.trajectory is not None
    assert found.outcome.name != "SOLVED"
    assert [part for part in ("4 worlds", "for the scene alone") if part not in found.message] == []


def test_scenes_that_need_feedback_whatever_their_plan_are_refused():
    assert "needs feedback" in str(load_method("robust").accepts(load_scene("cart_pole_walls")))
    assert load_method("robust").accepts(SCENE) is None
