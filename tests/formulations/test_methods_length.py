"""eps is counted in the length of the scene: the paper's carts in units of ten metres, where that length is 0.1, have the same plans and forces."""

from dataclasses import replace

import numpy as np
import pyomo.environ as pyo
import pytest
import sympy as sp
import torch

from formulations.contact_modes import collocation as stage_modes
from formulations.contact_modes.goal import correct_end_by_softplus
from formulations.contact_modes.nonlinear import SoftplusHomotopy
from formulations.pipelines import solve_scene
from formulations.shooting.reference import reference_rollout
from formulations.solution import Outcome
from formulations.transcription.build import build_model, load_plan
from formulations.transcription.contact import ContactFormulation, set_relaxation
from formulations.transcription.residuals import PlanResiduals
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw as ForceLaw
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact, DampingLaw
from models.scene.parts import goal_limits
from models.trajectory import Trajectory, uniform_grid

SIZE = 0.1
EPS = 1e-3
x, y, vx, vy, push = sp.symbols("x y vx vy push", real=True)
m, b, c, k, d = sp.symbols("m b c k d", positive=True)


def damped(law: DampingLaw) -> Scene:
    """A driven cart pushes a free one through a damped contact, and is pulled away from it."""
    return Scene(
        name=f"pad_{law.name.lower()}", title="A cart pushes another", source="own",
        coordinates=(Coordinate(symbol=x, velocity=vx, unit="m"),
                     Coordinate(symbol=y, velocity=vy, unit="m")),
        inputs=(Input(symbol=push, unit="N", lower=-60.0, upper=60.0),),
        parameters=(
            Parameter(symbol=m, value=1.0, unit="kg"), Parameter(symbol=k, value=120.0, unit="N/m"),
            Parameter(symbol=c, value=4.0 if law is DampingLaw.KELVIN_VOIGT else 0.5,
                      unit=law.unit), Parameter(symbol=d, value=0.1, unit="m"),
            Parameter(symbol=b, value=1.0, unit="N s/m"),
        ),
        kinetic_energy=m * (vx**2 + 2 * vy**2) / 2, potential_energy=sp.S.Zero,
        forces=(push - b * vx, sp.S.Zero),
        contacts=(
            Contact(
                name="pad", bodies=("pusher", "cart"), depth=d, depth_reason="the length of a cart",
                penetration=d + x - y, stiffness=k, damping=c,
                damping_law=law, nominal=0.05,
            ),
        ),
        task=Task(start=(-0.2, 0.1, 0.0, 0.0), goal=(None, 0.6, None, None), running_cost=push**2,
                  step=0.03, steps=60),
        limits=goal_limits(position=0.01, reason="this test"), length=1.0,
    )  # fmt: skip


def carts() -> Scene:
    return load_scene("three_cart").with_task(steps=100, step=0.05)


def shrunk(scene: Scene) -> Scene:
    """Lengths a tenth, masses, stiffness and damping ten times: the same forces, in units of ten metres."""
    values = {
        parameter.name: parameter.value * (SIZE if parameter.unit == "m" else 1 / SIZE)
        for parameter in scene.parameters
    }
    task, contacts = (
        scene.task,
        tuple(replace(contact, nominal=contact.nominal * SIZE) for contact in scene.contacts),
    )
    goal = tuple(None if value is None else value * SIZE for value in task.goal)
    scaled = replace(
        scene.with_parameters(**values), contacts=contacts, length=SIZE * scene.length, answers=()
    )
    return scaled.with_task(start=tuple(value * SIZE for value in task.start), goal=goal)


def inputs(scene: Scene) -> np.ndarray:
    u = np.random.default_rng(7).uniform(-4.0, 4.0, size=(scene.task.steps, scene.nu)) + 2.0
    u[scene.task.steps // 3 :, 0] -= 4.0 if scene.nu == 2 else 20.0
    u[: scene.task.steps // 3, 0] += 20.0 if scene.nu == 1 else 4.0
    return u


@pytest.mark.parametrize(
    "scene",
    [carts(), damped(DampingLaw.KELVIN_VOIGT), damped(DampingLaw.HUNT_CROSSLEY)],
    ids=lambda scene: scene.name,
)
def test_compiled_torch_numpy_and_pyomo_have_the_same_forces_at_a_tenth_of_the_size(scene: Scene):
    small, u, h = shrunk(scene), inputs(scene), scene.task.step
    rolled = [
        load_kernel(one).rollout(np.array(one.task.start), u, h, ForceLaw.SOFTPLUS, EPS)
        for one in (scene, small)
    ]
    np.testing.assert_allclose(rolled[1].lam, rolled[0].lam, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(rolled[1].q, SIZE * rolled[0].q, rtol=1e-10, atol=1e-12)
    assert rolled[0].lam.max() > 1.0
    assert (
        np.abs(
            rolled[0].lam - load_kernel(scene).contact_force(rolled[0].q[:-1], v=rolled[0].v[:-1])
        ).max()
        > 0.1
    ), "softplus is not the true law"
    start = torch.tensor(small.task.start, dtype=torch.float64)
    by_torch = reference_rollout(small, torch.tensor(u), start, law=ForceLaw.SOFTPLUS, eps=EPS)[2]
    np.testing.assert_allclose(by_torch.numpy(), rolled[1].lam, rtol=1e-9, atol=1e-10)
    states = np.hstack([rolled[1].q, rolled[1].v])[:-1]
    linear = load_steps(small).linearise(states, u, h, ForceLaw.SOFTPLUS, EPS)
    np.testing.assert_allclose(linear.lam, rolled[1].lam, rtol=1e-12, atol=1e-13)
    plan = Trajectory(
        t=uniform_grid(h, len(u)), q=rolled[1].q, v=rolled[1].v, u=u, lam=rolled[1].lam
    )
    assert PlanResiduals(small).of(plan, ForceLaw.SOFTPLUS, EPS)["contact_law"] < 1e-10
    model = build_model(small, ContactFormulation.SOFTPLUS, eps=0.5)
    set_relaxation(model, EPS)
    load_plan(model, plan)
    rows = model.component("constraint_contact_softplus").values()
    assert max(abs(pyo.value(row.body) - pyo.value(row.upper)) for row in rows) < 1e-10


def test_a_homotopy_goes_through_the_same_stages():
    scene = carts()
    small = shrunk(scene)
    schedule = (7.0, 14.0, 448.0)
    stages = [SoftplusHomotopy(one, schedule)._stages for one in (scene, small)]
    np.testing.assert_allclose(stages[1], stages[0], rtol=1e-12)
    stiff = [
        SoftplusHomotopy(one, schedule)._stages
        for one in (scene.with_parameters(k=3000.0), shrunk(scene.with_parameters(k=3000.0)))
    ]
    np.testing.assert_allclose(stiff[1], stiff[0], rtol=1e-12)
    assert stiff[0][0][1] < 1.0, "so stiff a contact begins softer"


def test_inputs_are_corrected_the_same_way():
    """A correction stops where the miss is 1e-7 m in either unit: inputs agree to parts of a hundredth, and not with those of contact ten times as sharp."""
    scene = carts()

    def corrected(one: Scene, sharpness: float) -> np.ndarray:
        return correct_end_by_softplus(one, load_kernel(one), np.zeros((100, 2)), sharpness)[1]

    large, small, sharper = (
        corrected(scene, 7.0),
        corrected(shrunk(scene), 7.0),
        corrected(scene, 70.0),
    )
    size = np.abs(large).max()
    assert size > 1.0
    assert np.abs(small - large).max() < 0.01 * size
    assert np.abs(sharper - large).max() > 0.1 * size


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "step"), [(50, 0.1), (80, 0.06), (150, 0.05)])
def test_exact_plans_cost_the_same(steps: int, step: float):
    """On grids whose homotopy needs some tens of iterations a stage: where it needs hundreds, the last digit decides which optimum it ends in."""
    scene = load_scene("three_cart").with_task(steps=steps, step=step)
    costs = []
    for one in (scene, shrunk(scene)):
        found = solve_scene(one, "mpcc", options={"search": False}, time_limit=300.0)
        assert found.outcome is Outcome.SOLVED, found.message
        costs.append(found.cost)
    assert costs[1] == pytest.approx(costs[0], rel=1e-7)


def test_the_nearest_plan_is_asked_for_at_the_first_sharpness(monkeypatch):
    """Of stages of a higher order, where the homotopy has no plan: b, not b L."""
    asked = []

    class OutOfReach:
        is_out_of_reach = True
        words = "q2 by 0.1 m"

    def nearest(scene, budget, most, sharpest):
        asked.append(sharpest)
        return OutOfReach()

    monkeypatch.setattr(stage_modes, "nearest", nearest)
    monkeypatch.setattr(SoftplusHomotopy, "run", lambda *_, **__: (Outcome.INFEASIBLE, "nothing"))
    assert (
        solve_scene(shrunk(carts()).with_task(steps=5), "collocation", time_limit=60.0).outcome
        is Outcome.INFEASIBLE
    )
    assert asked == [pytest.approx(7.0 / SIZE)]
