"""Damped contacts in Pyomo: the model's equations are met by the compiled rollout and by nothing that misses the law; plans; refusals."""

from dataclasses import replace

import numpy as np
import pyomo.environ as pyo
import pytest
import sympy as sp

from formulations.pipelines import load_method
from formulations.solution import Outcome
from formulations.transcription.build import build_model, load_plan
from formulations.transcription.contact import ContactFormulation, pairs
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw as ForceLaw
from models.errors import SceneError
from models.fmu.coupled import split
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.trajectory import Trajectory
from tests.formulations.test_methods_length import damped
from tests.formulations.transcription.rollouts import rolled_out

KELVIN_VOIGT, HUNT_CROSSLEY = DampingLaw.KELVIN_VOIGT, DampingLaw.HUNT_CROSSLEY


def pushed(law: DampingLaw, steps: int = 60) -> Scene:
    return damped(law).with_task(steps=steps)


def rollout(scene: Scene, law: ForceLaw, eps: float | None) -> Trajectory:
    """Pushes, and pulls back so fast that the contact is released while it touches."""
    u = np.full((scene.task.steps, scene.nu), 30.0)
    u[18:] = -60.0
    return rolled_out(scene, u, law, eps)


def violation(model: pyo.ConcreteModel) -> float:
    for end in ("position", "velocity"):
        goal = model.component(f"constraint_goal_{end}")
        if goal is not None:
            goal.deactivate()
    rows = [0.0]
    for row in model.component_data_objects(pyo.Constraint, active=True):
        body = pyo.value(row.body)
        rows += [pyo.value(row.lower) - body] if row.lower is not None else []
        rows += [body - pyo.value(row.upper)] if row.upper is not None else []
    return max(rows)


@pytest.mark.parametrize("law", DampingLaw)
def test_the_true_rollout_meets_the_complementarity_model(law: DampingLaw):
    scene = pushed(law)
    plan = rollout(scene, ForceLaw.RELU, None)
    touches = load_kernel(scene).penetration(plan.q[:-1])[:, 0] > 0
    assert (touches & (plan.lam[:, 0] == 0)).any()  # released
    assert (touches & (plan.lam[:, 0] > 1)).any()
    model = build_model(scene, ContactFormulation.COMPLEMENTARITY, eps=0.0)
    load_plan(model, plan)
    assert violation(model) < 1e-12
    residuals = PlanResiduals(scene).of(plan)
    assert residuals["physics"] < 1e-10
    assert residuals["force_sign"] < 1e-12
    # a force that misses the law by 1 N is no solution, whatever springs and switches are
    for t in (5, int(np.flatnonzero(touches & (plan.lam[:, 0] > 1))[0])):
        model.variable_lam[t, "pad"].set_value(plan.lam[t, 0] + 1.0)
        for _, pair in pairs(model):
            pair.v.set_value(max(0.0, pyo.value(pair.v) - pyo.value(pair.ve.body)), skip_validation=True)
        assert violation(model) > 1e-2
        model.variable_lam[t, "pad"].set_value(plan.lam[t, 0])


@pytest.mark.parametrize("law", DampingLaw)
def test_the_smoothed_rollout_meets_the_softplus_model(law: DampingLaw):
    scene = pushed(law)
    plan = rollout(scene, ForceLaw.SOFTPLUS, 1e-6)
    model = build_model(scene, ContactFormulation.SOFTPLUS, eps=1e-6)
    load_plan(model, plan)
    assert violation(model) < 1e-12
    assert PlanResiduals(scene).of(plan, ForceLaw.SOFTPLUS, 1e-6)["contact_law"] < 1e-12


@pytest.mark.parametrize("law", DampingLaw)
@pytest.mark.parametrize("contact", ContactFormulation)
def test_without_damping_nothing_of_it_is_in_the_model(law: DampingLaw, contact: ContactFormulation):
    scene = pushed(law, steps=7)
    without = replace(scene, contacts=(replace(scene.contacts[0], damping=sp.S.Zero),))
    names = {component.name for component in build_model(without, contact, eps=1e-2).component_objects()}
    assert not {name for name in names if "spring" in name or "touch" in name or "damped" in name}


@pytest.mark.parametrize("law", DampingLaw)
def test_a_plan_with_strict_complementarity_holds_under_the_true_law(law: DampingLaw):
    scene = pushed(law, steps=30)
    relaxed = load_method("softplus_dc").open(scene).solve(eps=1e-8, warm_start=None, time_limit=120.0)
    assert relaxed.outcome is Outcome.SOLVED, relaxed.message
    strict = load_method("strict_lcp").open(scene).solve(eps=None, warm_start=relaxed.trajectory, time_limit=120.0)
    assert strict.outcome is Outcome.SOLVED, strict.message
    plan = strict.trajectory
    assert plan.lam.max() > 1.0
    true = load_kernel(scene).rollout(np.array(scene.task.start), plan.u, scene.task.step)
    assert true.q[-1, 1] == pytest.approx(0.6, abs=1e-5)
    assert true.lam == pytest.approx(plan.lam, abs=1e-4)


@pytest.mark.parametrize("name", ["mpcc", "mpcc_front", "global"])
def test_methods_by_contact_modes_refuse_damping(name: str):
    assert "damped contacts" in load_method(name).accepts(pushed(KELVIN_VOIGT, steps=10))


def test_parts_refuse_damping():
    with pytest.raises(SceneError, match=r"damped contacts \(pad\)"):
        split(pushed(HUNT_CROSSLEY))
