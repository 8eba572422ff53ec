"""The compiled functions and their derivatives, of damped contacts too: against the scene's own SymPy equations, evaluated by numpy, the rollout against a loop over them, finite differences, and physics."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
import torch
from example_scenes import example_scene

from formulations.shooting.reference import reference_rollout
from formulations.transcription.residuals import rows_of
from models.catalog import load_scene
from models.codegen.kernel import Kernel, KernelError, Rollout, load_kernel
from models.contact_law import ContactLaw, RelaxationError, contact_force
from models.dynamics import derive
from models.scene import Coordinate, Input, Parameter, Scene, Task
from tests.models.test_scene_bank import points

NAMES = ("three_cart", "two_link_arm", "two_body_collision", "bouncing_mass", "oscillator")
LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3), (ContactLaw.SOFTPLUS, 1e-7))


@cache
def kernel_of(name: str) -> Kernel:
    return load_kernel(example_scene(name))


@pytest.mark.parametrize("name", NAMES)
def test_stiffness_energy_power_and_cost_are_those_of_the_scene(name: str):
    """At the points where test_scene_bank.py looks at accelerations and penetrations."""
    d, kernel = derive(example_scene(name)), kernel_of(name)
    assert kernel.stiffness() == pytest.approx(d.function(d.stiffness)().ravel(), rel=1e-15)
    q, v, u, _ = points(example_scene(name))
    groups = (d.q, d.v, d.u)
    for found, expression in zip(
        (*kernel.energy(q, v), *kernel.power(q, v, u)),
        (d.kinetic_energy, d.potential_energy, d.input_power, d.dissipated_power),
        strict=True,
    ):
        function = d.function([expression], *groups)
        assert found == pytest.approx(
            np.array([function(*row).item() for row in zip(q, v, u, strict=True)]),
            rel=1e-12,
            abs=1e-12,
        )
    cost, end = d.function([d.running_cost], *groups), d.function([d.final_cost], d.q, d.v)
    expected = (
        sum(cost(*row).item() for row in zip(q[:-1], v[:-1], u[:-1], strict=True))
        + end(q[-1], v[-1]).item()
    )
    assert kernel.cost(q, v, u[:-1]) == pytest.approx(expected, rel=1e-13)


_X, _RATE, _PUSH = sp.symbols("x rate push", real=True)
# Each constant and each function that a scene may contain, of a coordinate near 0.4.
_TERMS = (
    *(_X * constant for constant in (sp.pi, sp.E, sp.EulerGamma, sp.GoldenRatio, sp.Catalan)),
    *(_X * constant for constant in (sp.TribonacciConstant, sp.sqrt(2), sp.log(2), 2 / sp.pi)),
    *(_X * constant for constant in (sp.log(10), sp.sin(1), sp.Integer(10) ** 30)),
    *(_X * constant for constant in (sp.Rational(10**20, 10**15 + 1), sp.Float("1e-200"))),
    *(function(_X) for function in (sp.sin, sp.cos, sp.tan, sp.asin, sp.acos, sp.atan)),
    *(function(_X) for function in (sp.sinh, sp.cosh, sp.tanh, sp.asinh, sp.atanh, sp.exp)),
    *(sp.acosh(_X + 2), sp.log(_X + 2, 2), sp.atan2(_X, 2), sp.cbrt(_X), 2**_X, (_X + 1) ** _X),
)


def test_every_constant_and_function_has_its_value_in_c():
    """Each term is scaled to 1 J. Warnings are errors: a macro that C99 lacks does not compile."""
    weights = sp.symbols(f"w:{len(_TERMS)}", positive=True)
    values = [float(term.subs(_X, 0.4)) for term in _TERMS]
    potential = sp.Add(*(weight * term for weight, term in zip(weights, _TERMS, strict=True)))
    scene = Scene(
        name="terms",
        title="terms",
        source="this test",
        coordinates=(Coordinate(symbol=_X, velocity=_RATE, unit="rad"),),
        inputs=(Input(symbol=_PUSH, unit="N m"),),
        parameters=tuple(
            Parameter(symbol=weight, value=1 / value, unit="J")
            for weight, value in zip(weights, values, strict=True)
        ),
        kinetic_energy=_RATE**2 / 2,
        potential_energy=potential,
        forces=(_PUSH,),
        contacts=(),
        task=Task(start=(0.4, 0.0), goal=(None, None), running_cost=_PUSH**2, step=0.01, steps=2),
    )
    kernel, at, none = load_kernel(scene), np.array([[0.4]]), np.zeros((1, 0))
    assert kernel.energy(at, 0 * at)[1].item() == pytest.approx(len(_TERMS), rel=1e-13)
    slope = sum(
        float(term.diff(_X).subs(_X, 0.4)) / value
        for term, value in zip(_TERMS, values, strict=True)
    )
    torque = -kernel.acceleration(at, 0 * at, 0 * at, none).item()
    assert torque == pytest.approx(slope, rel=1e-12)
    start, push = torch.tensor([0.4, 0.0]).double(), torch.zeros((2, 1)).double()
    _, v, _ = reference_rollout(scene, push, start)
    assert v.numpy() == pytest.approx(
        kernel.rollout(start.numpy(), push.numpy(), 0.01).v, rel=1e-12
    )
    assert rows_of([term / value for term, value in zip(_TERMS, values, strict=True)], [_X])(
        at
    ) == pytest.approx(1.0, rel=1e-13)


@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_contact_force_is_the_law_of_the_penetration_even_far_away(
    law: ContactLaw, eps: float | None
):
    """Also at |b phi| of thousands, where a careless log(1 + exp(b phi)) is infinite."""
    kernel = kernel_of("three_cart")
    q = np.array(
        [
            [0.0, 0.5, 1.0],
            [2.0, 3.0, 4.0],
            [0.0, -300.0, 200.0],
            [0.0, 1e3, -1e3],
            [0.0, 0.4999, 1.0001],
        ]
    )
    expected = contact_force(kernel.penetration(q), kernel.stiffness(), law, eps)
    assert kernel.contact_force(q, law, eps) == pytest.approx(expected, rel=1e-13, abs=1e-300)


# At eps = 1e-300 the sharpness is 691, so that exp(b phi) of 1e4 m would be e^(6.9e6).
DEPTHS = np.array([-1e4, -10.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 10.0, 1e4])


def left_contact_at(depths: np.ndarray) -> np.ndarray:
    """Positions of the three carts with these depths of the left contact, phi = d - (q2 - q1)."""
    return np.column_stack([depths - 0.5, np.zeros_like(depths), np.full_like(depths, 2e4)])


@pytest.mark.parametrize("eps", [1e-300, 1e-16, 1e-3, 0.999])
def test_softplus_with_extreme_eps_is_finite(eps: float):
    """Forces over 20 km of depth, a rollout and its adjoint."""
    kernel = kernel_of("three_cart")
    force = kernel.contact_force(left_contact_at(DEPTHS), ContactLaw.SOFTPLUS, eps)[:, 0]
    assert force == pytest.approx(
        contact_force(DEPTHS, 30.0, ContactLaw.SOFTPLUS, eps), rel=1e-13, abs=1e-43
    )
    assert (force >= 0.0).all()
    assert (np.diff(force) >= 0.0).all()
    u = np.tile([5.0, -5.0], (200, 1))
    plan = kernel.rollout(np.array(kernel.scene.task.start), u, 0.01, ContactLaw.SOFTPLUS, eps)
    assert not plan.diverged
    for gradient in kernel.adjoint(
        plan, np.zeros((200, 2)), np.ones_like(plan.q), np.ones_like(plan.v)
    ):
        assert np.isfinite(gradient).all()


@pytest.mark.parametrize("eps", [1.0, 1.5, 0.0, -1e-3, math.nan, math.inf])
def test_softplus_with_meaningless_eps_is_refused(eps: float):
    with pytest.raises(RelaxationError, match="eps"):
        kernel_of("three_cart").contact_force(left_contact_at(DEPTHS), ContactLaw.SOFTPLUS, eps)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_rollout_is_semi_implicit_euler_with_the_forces_of_the_start_of_each_step(
    name: str, law: ContactLaw, eps: float | None
):
    scene, kernel = example_scene(name), kernel_of(name)
    u = np.random.default_rng(1).normal(size=(40, scene.nu))
    h = 0.003
    found = kernel.rollout(np.array(scene.task.start), u, h, law, eps)
    q, v = np.array(scene.task.start).reshape(2, 1, scene.nq)
    for step in range(40):
        lam = kernel.contact_force(q, law, eps)
        assert (found.q[step], found.v[step], found.lam[step]) == (
            pytest.approx(q[0]),
            pytest.approx(v[0]),
            pytest.approx(lam[0]),
        )
        v = v + h * kernel.acceleration(q, v, u[step : step + 1], lam)
        q = q + h * v
    assert not found.diverged
    assert (found.q[-1], found.v[-1]) == (pytest.approx(q[0]), pytest.approx(v[0]))


def test_true_contact_forces_of_a_rollout_have_no_physics_residual_at_all():
    """The score multiplies lam by lam - k*phi: with the kernel on both sides the product is zero to the last bit."""
    kernel = kernel_of("three_cart")
    u = np.tile([3.0, -3.0], (500, 1))
    plan = kernel.rollout(np.array(kernel.scene.task.start), u, 0.01)
    assert plan.lam.max() > 0.1
    assert (plan.lam == kernel.stiffness() * np.maximum(kernel.penetration(plan.q[:-1]), 0.0)).all()


def test_rollout_that_stops_being_finite_says_where():
    kernel = kernel_of("three_cart")
    u = np.zeros((20, 2))
    u[7, 0] = np.inf
    plan = kernel.rollout(np.array(kernel.scene.task.start), u, 0.01)
    assert plan.diverged
    assert plan.finite_steps == 7
    assert np.isfinite(plan.q[:8]).all()
    assert np.isnan(plan.q[8:]).all()
    assert np.isnan(plan.lam[8:]).all()


@pytest.mark.parametrize(("law", "eps"), LAWS)
@pytest.mark.parametrize("name", ["three_cart", "two_link_arm"])
def test_derivatives_of_the_last_state_may_be_given_alone(
    name: str, law: ContactLaw, eps: float | None
):
    scene, kernel = example_scene(name), kernel_of(name)
    u = np.random.default_rng(0).normal(size=(60, scene.nu))
    plan = kernel.rollout(np.array(scene.task.start), u, 0.01, law, eps)
    end_bar = np.arange(1.0, 2 * scene.nq + 1)
    q_bar, v_bar = np.zeros_like(plan.q), np.zeros_like(plan.v)
    q_bar[-1], v_bar[-1] = end_bar[: scene.nq], end_bar[scene.nq :]
    whole, alone = (
        kernel.adjoint(plan, u, q_bar, v_bar, cost_bar=0.1),
        kernel.adjoint(plan, u, cost_bar=0.1, end_bar=end_bar),
    )
    both = kernel.adjoint(plan, u, q_bar, v_bar, cost_bar=0.2, end_bar=end_bar)
    for found, other, twice in zip(whole, alone, both, strict=True):
        assert (found == other).all()
        assert twice == pytest.approx(2.0 * found, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("name", ["three_cart", "two_link_arm"])
def test_rows_are_rollouts_alone(name: str):
    scene, kernel = example_scene(name), kernel_of(name)
    random = np.random.default_rng(1)
    start, u = (
        np.array(scene.task.start) + 0.05 * random.normal(size=(4, 2 * scene.nq)),
        random.normal(size=(4, 30, scene.nu)),
    )
    u[2] = 1e200
    lam, ends = kernel.rollouts(start, u, 0.01)
    for row in range(4):
        alone = kernel.rollout(start[row], u[row], 0.01)
        np.testing.assert_array_equal(lam[row], alone.lam)
        np.testing.assert_array_equal(ends[row], np.concatenate([alone.q[-1], alone.v[-1]]))
    assert np.isnan(ends[2]).all() == (name == "two_link_arm")


def test_arrays_that_do_not_fit_are_refused_in_words():
    kernel = kernel_of("three_cart")
    start = np.array(kernel.scene.task.start)
    with pytest.raises(KernelError, match=r"u has shape \(5, 3\), but \(n, 2\) is needed"):
        kernel.rollout(start, np.zeros((5, 3)), 0.01)
    with pytest.raises(KernelError, match="start has shape"):
        kernel.rollout(start[:5], np.zeros((5, 2)), 0.01)
    with pytest.raises(KernelError, match="end_bar has shape"):
        kernel.adjoint(
            kernel.rollout(start, np.zeros((5, 2)), 0.01), np.zeros((5, 2)), end_bar=np.zeros(5)
        )
    with pytest.raises(KernelError, match="start has shape"):
        kernel.rollouts(np.zeros((3, 6)), np.zeros((2, 5, 2)), 0.01)
    plan = kernel.rollout(start, np.zeros((5, 2)), 0.01)
    with pytest.raises(KernelError, match="q_bar has shape"):
        kernel.adjoint(plan, np.zeros((5, 2)), np.zeros((5, 3)), np.zeros((6, 3)))
    with pytest.raises(KernelError, match="u has shape"):
        kernel.adjoint(plan, np.zeros((4, 2)), np.zeros((6, 3)), np.zeros((6, 3)))


def test_mass_matrix_that_is_not_positive_definite_is_said_with_the_place():
    scene = example_scene("two_link_arm")
    kernel = Kernel(scene, load_kernel(scene).path)
    kernel.parameters_of(0.01)[
        :2
    ] = -1.0  # no scene can be made with negative masses, so the kernel is told directly
    with pytest.raises(KernelError, match="not positive definite at q"):
        kernel.acceleration(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 1)))
    assert kernel.rollout(np.zeros(4), np.zeros((3, 2)), 0.01).finite_steps == 0


SCENES = Path(__file__).parents[2] / "scenes"


def test_semi_implicit_euler_converges_with_order_one():
    """q'' = -q against (cos t, -sin t): the slope of log error over log step is 1."""
    scene = load_scene(str(SCENES / "oscillator.py"))
    kernel = load_kernel(scene)
    horizon, steps = 2.0, np.array([100, 200, 400, 800, 1600])
    errors = []
    for count in steps:
        plan = kernel.rollout(np.array(scene.task.start), np.zeros((count, 0)), horizon / count)
        errors.append(np.hypot(plan.q[-1, 0] - np.cos(horizon), plan.v[-1, 0] + np.sin(horizon)))
    slope = np.polyfit(np.log(horizon / steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.02)


def moved(name: str) -> tuple[Kernel, Rollout, dict[str, float]]:
    """The kernel of a scene without inputs, its motion on a fine grid, and the scene's answers."""
    kernel = kernel_of(name)
    answers = {answer.quantity: answer.value for answer in kernel.scene.answers}
    return (
        kernel,
        kernel.rollout(np.array(kernel.scene.task.start), np.zeros((60000, 0)), 1e-5),
        answers,
    )


@pytest.fixture(scope="module")
def collision():
    return moved("two_body_collision")


def test_collision_keeps_momentum_to_rounding(collision):
    kernel, plan, _ = collision
    values = {parameter.name: parameter.value for parameter in kernel.scene.parameters}
    masses = np.array([values["m1"], values["m2"]])
    momentum = plan.v @ masses
    assert plan.lam.max() > 0.0
    assert np.abs(momentum - momentum[0]).max() < 1e-9 * np.abs(plan.v * masses).max()


def test_collision_keeps_energy_but_for_the_grid(collision):
    """Kinetic energy is back after the contact; in between the spring holds it.

    What is missing is of the order of the step.
    """
    kernel, plan, _ = collision
    kinetic, potential = kernel.energy(plan.q, plan.v)
    stored = 0.5 * kernel.stiffness() * np.maximum(kernel.penetration(plan.q), 0.0) ** 2
    total = kinetic + potential + stored.sum(axis=1)
    assert kinetic.min() < 0.5 * kinetic[0]
    assert np.abs(total - total[0]).max() < 1e-3 * total[0]
    assert kinetic[-1] == pytest.approx(kinetic[0], rel=1e-3)


def test_collision_has_the_closed_forms_of_the_scene(collision):
    kernel, plan, answers = collision
    assert kernel.penetration(plan.q).max() == pytest.approx(
        answers["largest compression [m]"], rel=1e-3
    )
    assert (plan.lam > 0.0).sum() * plan.step == pytest.approx(
        answers["contact time [s]"], rel=1e-3
    )
    assert plan.v[-1] == pytest.approx(
        np.array(
            [
                answers[f"velocity of the {which} disc afterwards [m/s]"]
                for which in ("left", "right")
            ]
        ),
        rel=1e-3,
    )


def test_bouncing_mass_meets_the_floor_when_it_should():
    kernel, plan, answers = moved("bouncing_mass")
    touches = np.argmax(plan.lam[:, 0] > 0.0) * plan.step
    assert touches == pytest.approx(answers["time of the first contact [s]"], abs=5 * plan.step)
    assert kernel.penetration(plan.q).max() == pytest.approx(answers["largest depth [m]"], rel=1e-3)


# A start in contact, away from the kink of the ReLU, for each scene.
STARTS = {
    "three_cart": (2.0, 2.4, 2.8, 0.3, -0.2, 0.1), "two_link_arm": (0.3, 0.4, -0.5, 0.7),
    "two_body_collision": (0.0, 0.15, 1.0, -1.0),
    "bouncing_mass": (-0.05, 0.3), "oscillator": (1.0, 0.2),
}  # fmt: skip


def _loss(
    kernel: Kernel,
    start: np.ndarray,
    u: np.ndarray,
    h: float,
    law: ContactLaw,
    eps: float | None,
    bars: tuple,
) -> float:
    plan = kernel.rollout(start, u, h, law, eps)
    q_bar, v_bar, lam_bar, cost_bar = bars
    cost = kernel.cost(plan.q, plan.v, u)
    return float(
        (q_bar * plan.q).sum()
        + (v_bar * plan.v).sum()
        + (lam_bar * plan.lam).sum()
        + cost_bar * cost
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("law", "eps"), LAWS[:2])
def test_adjoint_is_the_finite_difference_of_a_loss_of_everything(
    name: str, law: ContactLaw, eps: float | None
):
    """Every entry of u and start; the loss weighs every entry of q, v, lam and the running cost."""
    kernel = kernel_of(name)
    scene, steps, h = kernel.scene, 12, 0.002
    random = np.random.default_rng(4)
    u, start = random.normal(size=(steps, scene.nu)), np.array(STARTS[name])
    plan = kernel.rollout(start, u, h, law, eps)
    assert not scene.nc or plan.lam.max() > 0.0
    bars = (*(random.normal(size=rows.shape) for rows in (plan.q, plan.v, plan.lam)), 0.7)
    u_bar, start_bar = kernel.adjoint(plan, u, *bars)

    delta = 1e-6  # central differences: error delta^2 of the curvature, rounding 1e-16/delta
    for gradient, point in ((u_bar, u), (start_bar, start)):
        for index in np.ndindex(point.shape):
            values = []
            for sign in (1.0, -1.0):
                moved = point.copy()
                moved[index] += sign * delta
                values.append(
                    _loss(
                        kernel, *((start, moved) if point is u else (moved, u)), h, law, eps, bars
                    )
                )
            assert gradient[index] == pytest.approx(
                (values[0] - values[1]) / (2 * delta), rel=2e-6, abs=2e-6
            )


def test_adjoint_without_contact_force_derivatives_is_the_one_with_zeros():
    kernel = kernel_of("three_cart")
    u = np.ones((10, 2))
    plan = kernel.rollout(np.array(STARTS["three_cart"]), u, 0.01)
    bar = np.ones((11, 3))
    for left, right in zip(
        kernel.adjoint(plan, u, bar, bar),
        kernel.adjoint(plan, u, bar, bar, np.zeros((10, 2))),
        strict=True,
    ):
        assert (left == right).all()


def test_slope_of_both_laws_at_a_penetration_of_exactly_zero():
    """ReLU: 0, as in the plan's own model before it touches; softplus: half the stiffness."""
    kernel = kernel_of("bouncing_mass")
    plan_start, u, h = np.zeros(2), np.zeros((1, 0)), 0.1
    v_bar = np.array([[0.0], [1.0]])
    for law, eps, slope in ((ContactLaw.RELU, None, 0.0), (ContactLaw.SOFTPLUS, 1e-3, 0.5)):
        plan = kernel.rollout(plan_start, u, h, law, eps)
        _, start_bar = kernel.adjoint(plan, u, np.zeros((2, 1)), v_bar)
        assert start_bar[0] == pytest.approx(-h * slope * kernel.stiffness()[0], rel=1e-14)


ARM = load_scene(str(Path(__file__).parents[2] / "scenes" / "damped_arm.py"))


def states(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    rows = [np.zeros(scene.nq), np.ones(scene.nq), np.arange(scene.nq) % 2, np.arange(scene.nq)]
    q = np.vstack([*rows, random.normal(scale=0.5, size=(200, scene.nq))])
    return q, np.vstack([*rows[::-1], random.normal(scale=3.0, size=(200, scene.nq))])


def true_force(scene: Scene, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    d = derive(scene)
    push, phi = d.function(d.push, d.q, d.v), d.function(d.penetration, d.q)
    return np.array(
        [
            np.where(phi(x).ravel() > 0, np.maximum(push(x, y).ravel(), 0), 0)
            for x, y in zip(q, v, strict=True)
        ]
    )


@pytest.mark.parametrize(
    "scene", [ARM, load_scene("damped_collision")], ids=lambda scene: scene.name
)
def test_forces_are_those_of_the_law(scene: Scene):
    kernel, (q, v) = load_kernel(scene), states(scene)
    lam = kernel.contact_force(q, v=v)
    assert lam == pytest.approx(true_force(scene, q, v), rel=1e-12, abs=1e-12)
    damped = list(scene.damped)
    closed = kernel.penetration(q)[:, damped] > 0
    assert (lam[:, damped][closed] == 0).any()  # a released contact is among them
    assert (lam[:, damped][closed] > 0).any()
    push = kernel.contact_push(q, v)
    assert np.maximum(push, 0) == pytest.approx(lam)  # what the score holds a plan's forces against
    assert push[kernel.penetration(q) <= 0] == pytest.approx(
        (kernel.stiffness() * kernel.penetration(q))[kernel.penetration(q) <= 0]
    )


def test_the_smoothed_law_is_that_of_the_springs_at_rest_and_the_true_one_in_the_limit():
    kernel, (q, v) = load_kernel(ARM), states(ARM)
    phi, k = kernel.penetration(q), kernel.stiffness()
    b = -np.log(1e-3)
    assert kernel.contact_force(q, ContactLaw.SOFTPLUS, 1e-3) == pytest.approx(
        k / b * np.logaddexp(0, b * phi), rel=1e-12
    )
    assert (kernel.contact_force(q, ContactLaw.SOFTPLUS, 1e-3, v=v) >= 0).all()
    away = np.abs(phi).min(axis=1) > 0.05
    sharp = kernel.contact_force(q[away], ContactLaw.SOFTPLUS, 1e-300, v=v[away])
    assert sharp == pytest.approx(true_force(ARM, q[away], v[away]), abs=0.5)  # k ln2 / b = 0.3 N


@pytest.mark.parametrize(("law", "eps"), LAWS[:2])
def test_the_adjoint_is_the_derivative(law: ContactLaw, eps: float | None):
    kernel, task = load_kernel(ARM), ARM.task
    random = np.random.default_rng(5)
    u = random.normal(scale=[15.0, 4.0], size=(task.steps, 2))
    start = np.array(task.start)
    found = kernel.rollout(start, u, task.step, law, eps)
    assert not found.diverged
    assert (found.lam.max(axis=0)[:3] > 0.1).all()  # every contact takes part
    bars = (*(random.normal(size=rows.shape) for rows in (found.q, found.v, found.lam)), 0.0)
    u_bar, start_bar = kernel.adjoint(found, u, *bars)
    for _ in range(3):
        ds, du, h = random.normal(size=start.shape), random.normal(size=u.shape), 1e-7
        ahead, behind = (
            _loss(kernel, start + way * ds, u + way * du, task.step, law, eps, bars)
            for way in (h, -h)
        )
        difference = (ahead - behind) / (2 * h)
        assert float(start_bar @ ds + (u_bar * du).sum()) == pytest.approx(difference, rel=2e-5)


def test_momentum_is_kept_and_energy_only_lost():
    scene = load_scene("damped_collision").with_task(steps=20_000, step=2e-5)
    kernel = load_kernel(scene)
    motion = kernel.rollout(np.array(scene.task.start), np.zeros((20_000, 0)), 2e-5)
    m = np.array([parameter.value for parameter in scene.parameters[:2]])
    assert (motion.v @ m)[-1] == pytest.approx((motion.v @ m)[0], abs=1e-12)
    kinetic, _ = kernel.energy(motion.q, motion.v)
    spring = (kernel.stiffness() * np.maximum(kernel.penetration(motion.q), 0) ** 2).sum(axis=1) / 2
    assert (
        np.diff(kinetic + spring).max() < 2e-5
    )  # a time step may gain what it is wrong by: h c s^2 / mu h
    assert kinetic[-1] < 0.6 * kinetic[0]
