"""Plans in and out of a model, and the residuals a plan is certified with."""

import numpy as np
import pytest

from formulations import ContactFormulation, PlanResiduals, build_model, load_plan, read_plan
from formulations.transcription.build import load_first_guess
from formulations.transcription.contact import hold_modes, release_modes
from models.catalog import load_scene
from models.contact_law import ContactLaw as ForceLaw
from models.errors import TrajectoryError
from models.trajectory import Trajectory
from tests.formulations.transcription.rollouts import rolled_out

SCENE = load_scene("three_cart").with_task(start=(2.0, 2.48, 3.0, 0.3, 0.0, -0.2), steps=40)


def plan_of(law: ForceLaw = ForceLaw.RELU, eps: float | None = None) -> Trajectory:
    return rolled_out(SCENE, np.random.default_rng(3).normal(size=(40, 2)), law, eps)


def changed(plan: Trajectory, field: str, where: tuple[int, int], by: float) -> Trajectory:
    arrays = {name: np.array(getattr(plan, name)) for name in ("t", "q", "v", "u", "lam")}
    arrays[field][where] += by
    return Trajectory(**arrays)


def test_a_rollout_has_no_residuals() -> None:
    residuals = PlanResiduals(SCENE).of(plan_of())
    assert (
        max(residuals[name] for name in ("dynamics_defect", "start_error", "input_bound_excess", "force_sign", "complementarity")) < 1e-13
    )
    assert residuals["terminal_error"] > 0.1
    soft = PlanResiduals(SCENE).of(plan_of(ForceLaw.SOFTPLUS, 1e-3), ForceLaw.SOFTPLUS, 1e-3)
    assert soft["contact_law"] < 1e-13
    assert soft["physics"] > 1.0


@pytest.mark.parametrize(
    ("field", "where", "by", "figure", "least"),
    [
        ("q", (40, 0), 1e-3, "dynamics_defect", 9e-4), ("v", (40, 2), 1e-3, "dynamics_defect", 9e-4), ("q", (0, 1), 1e-3, "start_error", 9e-4),
        ("u", (7, 0), 20.0, "input_bound_excess", 5.0), ("lam", (39, 1), -50.0, "force_sign", 10.0), ("lam", (0, 0), 1.0, "complementarity", 0.5),
    ],
)  # fmt: skip
def test_each_residual_sees_its_own_fault(field, where, by, figure, least) -> None:
    functions = PlanResiduals(SCENE)
    assert functions.of(plan_of())[figure] < 1e-13
    assert functions.of(changed(plan_of(), field, where, by))[figure] > least


def test_plans_that_do_not_fit_are_refused() -> None:
    model = build_model(SCENE, ContactFormulation.SOFTPLUS, eps=1e-3)
    with pytest.raises(TrajectoryError, match="resample"):
        load_plan(build_model(SCENE, ContactFormulation.SOFTPLUS, eps=1e-3, steps=39), plan_of())
    with pytest.raises(TrajectoryError, match="resample"):
        load_plan(build_model(SCENE, ContactFormulation.SOFTPLUS, eps=1e-3, step=0.02), plan_of())
    plan = plan_of()
    with pytest.raises(TrajectoryError, match="u has 1 columns"):
        load_plan(model, Trajectory(t=plan.t, q=plan.q, v=plan.v, u=plan.u[:, :1], lam=plan.lam))
    with pytest.raises(TrajectoryError, match="lam has 0 columns"):
        load_plan(model, Trajectory(t=plan.t, q=plan.q, v=plan.v, u=plan.u, lam=plan.lam[:, :0]))


def test_the_first_guess_is_that_of_the_paper() -> None:
    model = build_model(SCENE, ContactFormulation.COMPLEMENTARITY, eps=1e-2)
    fresh = read_plan(model)
    load_plan(model, plan_of())
    load_first_guess(model)
    again = read_plan(model)
    for plan in (fresh, again):
        assert np.array_equal(plan.q, np.tile(SCENE.task.start[:3], (41, 1)))
        assert np.array_equal(plan.v, np.tile(SCENE.task.start[3:], (41, 1)))
        assert not plan.u.any()
        assert not plan.lam.any()


def test_held_modes_decide_every_pair_and_are_released_again() -> None:
    model = build_model(SCENE, ContactFormulation.COMPLEMENTARITY, eps=1e-2)
    closed = PlanResiduals(SCENE).modes(plan_of())
    assert closed.any()
    assert not closed.all()
    hold_modes(model, closed)
    for (t, name), pair in model.complementarity_contact.items():
        column = 0 if name == "left" else 1
        assert (pair.v.ub, model.variable_lam[t, name].ub) == ((0.0, None) if closed[t, column] else (None, 0.0))
        assert not pair.ccon.active
    release_modes(model)
    assert all(pair.ccon.active and pair.v.ub is None for pair in model.complementarity_contact.values())
    assert all(lam.ub is None for lam in model.variable_lam.values())
