"""Dry friction in the direct transcription: regularised, relaxed and exact, against closed forms and the compiled time step; damped contacts: the model's equations are met by the compiled rollout and by nothing that misses the law."""

from dataclasses import replace

import numpy as np
import pyomo.environ as pyo
import pytest
import sympy as sp

from formulations import ContactFormulation, build_model, load_plan, read_plan
from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from formulations.transcription.contact import pairs
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw as ForceLaw
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact, DampingLaw, Friction
from models.scene.parts import goal_limits
from models.trajectory import Trajectory, uniform_grid
from tests.formulations.test_methods_length import damped
from tests.formulations.transcription.rollouts import rolled_out

cargo, cart, height, vx, wx, vz, push, press = sp.symbols(
    "cargo cart height vx wx vz push press", real=True
)
m, M, mu, g, k = sp.symbols("m M mu g k", positive=True)
STEP = 0.02
STEPS = 60


def conveyor(goal: tuple[float, float] = (0.3, 0.45), *, steps: int = STEPS) -> Scene:
    """Cargo of 1 kg on a driven cart of 2 kg.

    Nothing but friction, at most 2 N, moves the cargo.
    """
    return Scene(
        name="conveyor", title="Cargo on a driven cart", source="own",
        coordinates=(Coordinate(symbol=cargo, velocity=vx, unit="m"),
                     Coordinate(symbol=cart, velocity=wx, unit="m")),
        inputs=(Input(symbol=push, unit="N", lower=-20.0, upper=20.0),),
        parameters=(
            Parameter(symbol=m, value=1.0, unit="kg"), Parameter(symbol=M, value=2.0, unit="kg"),
            Parameter(symbol=mu, value=0.2, unit="1"),
            Parameter(symbol=g, value=10.0, unit="m/s^2"),
        ),
        kinetic_energy=m * vx**2 / 2 + M * wx**2 / 2, potential_energy=sp.Integer(0),
        forces=(sp.Integer(0), push), contacts=(),
        frictions=(Friction(name="belt", slip=vx - wx, coefficient=mu, normal_force=m * g),),
        task=Task(start=(0.0,) * 4, goal=(*goal, 0.0, 0.0), running_cost=push**2, step=STEP,
                  steps=steps),
        limits=goal_limits(position=0.01, velocity=0.01, reason="this test"),
    )  # fmt: skip


def dragged_block() -> Scene:
    """A block on a soft floor, pressed down and dragged by two inputs: friction is pressed by a contact."""
    return Scene(
        name="dragged_block", title="A block dragged over a soft floor", source="own",
        coordinates=(Coordinate(symbol=cargo, velocity=vx, unit="m"),
                     Coordinate(symbol=height, velocity=vz, unit="m")),
        inputs=(Input(symbol=push, unit="N", lower=-20.0, upper=20.0),
                Input(symbol=press, unit="N", lower=-20.0, upper=20.0)),
        parameters=(
            Parameter(symbol=m, value=1.0, unit="kg"), Parameter(symbol=mu, value=0.4, unit="1"),
            Parameter(symbol=g, value=10.0, unit="m/s^2"),
            Parameter(symbol=k, value=500.0, unit="N/m"),
        ),
        kinetic_energy=m * (vx**2 + vz**2) / 2, potential_energy=m * g * height,
        forces=(push, -press),
        contacts=(
            Contact(name="floor", bodies=("block", "ground"), depth=1.0,
                    depth_reason="nothing here goes as deep", penetration=-height, stiffness=k),
        ),
        frictions=(Friction(name="floor", slip=vx, coefficient=mu, contact="floor"),),
        task=Task(start=(0.0, -0.02, 0.0, 0.0), goal=(0.2, -0.02, 0.0, 0.0),
                  running_cost=push**2 + press**2, step=STEP, steps=40),
        limits=goal_limits(position=0.01, velocity=0.01, reason="this test"),
    )  # fmt: skip


def solve(
    name: str, scene: Scene, *schedule: float | None, start: Trajectory | None = None
) -> list[Solution]:
    solutions: list[Solution] = []
    with load_method(name).open(scene) as session:
        for eps in schedule:
            warm = solutions[-1].trajectory if solutions else start
            solutions.append(session.solve(eps=eps, warm_start=warm, time_limit=120.0))
    return solutions


@pytest.mark.parametrize("scene", [conveyor(), dragged_block()], ids=lambda scene: scene.name)
def test_strict_plan_obeys_coulomb_and_the_compiled_time_step(scene: Scene) -> None:
    (solution,) = solve("strict_lcp", scene, None)
    assert solution.outcome is Outcome.SOLVED, solution.message
    plan = solution.trajectory
    rolled = load_kernel(scene).rollout(np.array(scene.task.start), plan.u, STEP)
    assert np.abs(rolled.q - plan.q).max() < 1e-8
    assert np.abs(rolled.lam - plan.lam).max() < 1e-6
    assert solution.residuals["friction_law"] < 1e-8
    slip, force, limit = PlanResiduals(scene).friction(plan)
    assert (np.abs(force) < 0.99 * limit).any()  # it sticks somewhere
    assert (np.abs(slip) > 1e-3).any()  # and slips somewhere


def test_relaxed_costs_rise_to_the_exact_one_as_the_bound_tightens() -> None:
    scene = conveyor()
    relaxed = solve("relaxed_lcp", scene, 1e-1, 1e-3, 1e-5)
    (exact,) = solve("strict_lcp", scene, None, start=relaxed[-1].trajectory)
    costs = [solution.cost or 0.0 for solution in relaxed]
    assert all(solution.outcome is Outcome.SOLVED for solution in (*relaxed, exact))
    assert costs == sorted(costs)  # a tighter bound allows less
    assert costs[0] < 0.9 * exact.cost
    assert costs[-1] == pytest.approx(exact.cost, rel=1e-2)


def test_regularised_plan_is_that_of_the_compiled_regularised_step() -> None:
    scene = dragged_block()
    first, last = solve("softplus_dc", scene, 1e-2, 1e-4)
    for eps, solution in ((1e-2, first), (1e-4, last)):
        assert solution.outcome is Outcome.SOLVED, solution.message
        plan = solution.trajectory
        rolled = load_kernel(scene).rollout(
            np.array(scene.task.start), plan.u, STEP, ForceLaw.SOFTPLUS, eps
        )
        assert np.abs(rolled.q - plan.q).max() < 1e-7
        assert np.abs(rolled.lam - plan.lam).max() < 1e-6
        assert solution.residuals["regularised_friction"] < 1e-7


def test_cargo_cannot_be_brought_further_than_friction_allows() -> None:
    # from rest to rest in T at no more than mu g: (mu g) T^2 / 4, and one step of semi-implicit
    # Euler more than the continuous motion
    steps, reach = 20, 2.0 * (20 * STEP) ** 2 / 4
    (near,) = solve("strict_lcp", conveyor((0.9 * reach, 0.9 * reach), steps=steps), None)
    (far,) = solve("strict_lcp", conveyor((1.2 * reach, 1.2 * reach), steps=steps), None)
    assert near.outcome is Outcome.SOLVED
    assert far.outcome in {Outcome.INFEASIBLE, Outcome.STALLED}
    assert far.outcome is Outcome.INFEASIBLE or far.residuals["terminal_error"] > 1e-3


def test_plan_goes_in_and_comes_out() -> None:
    scene = dragged_block()
    rng, steps = np.random.default_rng(1), scene.task.steps
    plan = Trajectory(
        t=uniform_grid(STEP, steps), q=rng.normal(size=(steps + 1, 2)),
        v=rng.normal(size=(steps + 1, 2)), u=rng.normal(size=(steps, 2)),
        lam=rng.normal(size=(steps, 2)),
    )  # fmt: skip
    model = build_model(scene, ContactFormulation.COMPLEMENTARITY, eps=1.0)
    load_plan(model, plan)
    assert all(
        np.array_equal(getattr(read_plan(model), name), getattr(plan, name))
        for name in ("q", "v", "u", "lam")
    )
    slip = np.array(
        [
            [model.variable_slip[t, "floor", way].value for way in ("forward", "backward")]
            for t in range(steps)
        ]
    )
    assert np.allclose(slip[:, 0] - slip[:, 1], plan.v[1:, 0])
    assert slip.min() == 0.0
    assert np.abs(slip.prod(axis=1)).max() == 0.0


def test_contact_windows_refuse_friction_with_a_reason() -> None:
    reason = load_method("mpcc").accepts(conveyor())
    assert "friction" in reason
    assert "strict_lcp" in reason


KELVIN_VOIGT = DampingLaw.KELVIN_VOIGT
HUNT_CROSSLEY = DampingLaw.HUNT_CROSSLEY


def pushed(law: DampingLaw, steps: int = 60) -> Scene:
    return replace(damped(law), length=1.0).with_task(steps=steps)


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
            pair.v.set_value(
                max(0.0, pyo.value(pair.v) - pyo.value(pair.ve.body)), skip_validation=True
            )
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
def test_without_damping_nothing_of_it_is_in_the_model(
    law: DampingLaw, contact: ContactFormulation
):
    scene = pushed(law, steps=7)
    without = replace(scene, contacts=(replace(scene.contacts[0], damping=sp.S.Zero),))
    names = {
        component.name for component in build_model(without, contact, eps=1e-2).component_objects()
    }
    assert not {name for name in names if "spring" in name or "touch" in name or "damped" in name}


@pytest.mark.parametrize("law", DampingLaw)
def test_a_plan_with_strict_complementarity_holds_under_the_true_law(law: DampingLaw):
    scene = pushed(law, steps=30)
    relaxed = (
        load_method("softplus_dc").open(scene).solve(eps=1e-8, warm_start=None, time_limit=120.0)
    )
    assert relaxed.outcome is Outcome.SOLVED, relaxed.message
    strict = (
        load_method("strict_lcp")
        .open(scene)
        .solve(eps=None, warm_start=relaxed.trajectory, time_limit=120.0)
    )
    assert strict.outcome is Outcome.SOLVED, strict.message
    plan = strict.trajectory
    assert plan.lam.max() > 1.0
    true = load_kernel(scene).rollout(np.array(scene.task.start), plan.u, scene.task.step)
    assert true.q[-1, 1] == pytest.approx(0.6, abs=1e-5)
    assert true.lam == pytest.approx(plan.lam, abs=1e-4)


def test_mpcc_refuses_damped_contacts():
    assert "damped contacts" in load_method("mpcc").accepts(pushed(KELVIN_VOIGT, steps=10))
