"""Dry friction: what a scene may say of it, Coulomb's law in the time step, and its exact adjoint."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from models.codegen.kernel import Kernel, Rollout, load_kernel
from models.contact_law import ContactLaw, sharpness
from models.dynamics import derive
from models.errors import TrajectoryError
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact, Friction
from models.scene.parts import goal_limits
from models.trajectory import Trajectory

x1, x2, z, w1, w2, wz, push = sp.symbols("x1 x2 z w1 w2 wz push", real=True)
m, mu, g, k = sp.symbols("m mu g k", positive=True)
STEP = 0.01
STEPS = 100
LAWS = [(ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3)]


def block_on_a_cart(**friction: object) -> Scene:
    """A block rides on a driven cart; nothing but friction moves it."""
    fields: dict = {
        "name": "belt",
        "slip": w2 - w1,
        "coefficient": mu,
        "normal_force": m * g,
    } | friction
    return Scene(
        name="block_on_a_cart", title="A block rides on a cart", source="own",
        coordinates=tuple(Coordinate(symbol=q, velocity=v, unit="m") for q,
                          v in ((x1, w1), (x2, w2), (z, wz))),
        inputs=(Input(symbol=push, unit="N"),),
        parameters=(
            Parameter(symbol=m, value=2.0, unit="kg"), Parameter(symbol=mu, value=0.3, unit="1"),
            Parameter(symbol=g, value=10.0, unit="m/s^2"),
            Parameter(symbol=k, value=200.0, unit="N/m"),
        ),
        kinetic_energy=m * (w1**2 + w2**2 + wz**2) / 2, potential_energy=m * g * z,
        forces=(push, sp.Integer(0), sp.Integer(0)),
        contacts=(
            Contact(name="floor", bodies=("block", "ground"), depth=1.0,
                    depth_reason="nothing here goes as deep", penetration=-z, stiffness=k),
        ),
        frictions=(Friction(**fields),),
        task=Task(start=(0.0,) * 6, goal=(0.0,) * 6, running_cost=push**2, step=STEP, steps=STEPS),
        limits=goal_limits(position=0.01, velocity=0.01, reason="this test"),
    )  # fmt: skip


def two_coupled_frictions() -> Scene:
    """A mass matrix, a slip direction and pressing forces that all depend on the position, and frictions that act on each other."""
    rest = block_on_a_cart()
    fields = {
        name: getattr(rest, name)
        for name in ("title", "source", "coordinates", "inputs", "parameters", "potential_energy")
    }
    return Scene(
        name="two_coupled_frictions", **fields,
        kinetic_energy=m * (w1**2 + w2**2 + wz**2 * (1 + sp.sin(x1) ** 2 / 4)) / 2,
        forces=(push, sp.Integer(0), sp.Integer(0)), contacts=rest.contacts,
        frictions=(
            Friction(name="belt", slip=w2 - w1, coefficient=mu,
                     normal_force=m * g * (1 + x1**2 / 10)),
            Friction(name="foot", slip=w1 * sp.cos(x2) + w2 + wz / 5, coefficient=mu / 2,
                     contact="floor"),
        ),
        task=Task(start=(0.0, 0.1, -0.03, 0.0, 0.2, 0.0), goal=(0.0,) * 6, running_cost=push**2,
                  step=STEP, steps=STEPS),
        limits=goal_limits(position=0.01, velocity=0.01, reason="this test"),
    )  # fmt: skip


# Shares of one coefficient that two frictions of the same slip have.
PAIR = {"left": sp.Rational(1, 4), "right": sp.Rational(3, 4)}


def roll(
    kernel: Kernel,
    scene: Scene,
    u: np.ndarray,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
) -> Rollout:
    return kernel.rollout(np.array(scene.task.start), u, STEP, law, eps)


@pytest.mark.parametrize("acceleration", [1.0, 2.999, 3.001, 6.0])
def test_block_sticks_up_to_mu_g_and_then_slips_with_it(acceleration: float) -> None:
    scene = block_on_a_cart()
    kernel = load_kernel(scene)
    friction = 2.0 * min(
        acceleration / 2, 3.0
    )  # both masses 2 kg: while it sticks the push is shared
    result = roll(kernel, scene, np.full((STEPS, 1), 2.0 * acceleration))
    assert np.allclose(result.lam[:, 1], friction, rtol=0, atol=1e-13)
    slip = kernel.slip(result.q[:-1], result.v[1:])
    if acceleration / 2 < 3.0:
        assert np.abs(slip).max() < 1e-15
    assert result.v[-1, 1] == pytest.approx(friction / 2.0 * STEP * STEPS, rel=1e-13)


def test_block_comes_to_rest_and_stays() -> None:
    scene = block_on_a_cart(slip=w2, normal_force=m * g)
    start = np.array(
        [0.0, 0.0, 0.0, 0.0, 0.9, 0.0]
    )  # stops after v / (mu g) = 0.3 s, without creep ever after
    result = load_kernel(scene).rollout(start, np.zeros((STEPS, 1)), STEP)
    assert np.array_equal(result.v[31:, 1], np.zeros(STEPS - 30))
    assert result.q[-1, 1] == pytest.approx(
        0.9**2 / 6 - 0.9 * STEP / 2, abs=1e-12
    )  # v^2 / (2 mu g), less half a step: semi-implicit Euler


@pytest.mark.parametrize(
    "scene", [block_on_a_cart(), two_coupled_frictions()], ids=lambda scene: scene.name
)
def test_coulomb_friction_dissipates_most_within_its_cone(scene: Scene) -> None:
    kernel = load_kernel(scene)
    u = 16.0 * np.random.default_rng(3).normal(size=(STEPS, 1))
    result = roll(kernel, scene, u)
    force, limit = result.lam[:, scene.nc :], kernel.friction_limit(result.q[:-1], result.lam)
    slip = kernel.slip(result.q[:-1], result.v[1:])
    assert (np.abs(force) <= limit * (1 + 1e-15)).all()
    sticks = np.abs(force) < limit * (1 - 1e-12)
    assert 0.05 < sticks.mean() < 0.95
    assert np.abs(slip[sticks]).max() < 1e-14
    assert np.allclose(
        (force * slip)[~sticks], -(limit * np.abs(slip))[~sticks], rtol=0, atol=1e-13
    )


def test_regularised_friction_is_the_logistic_function_of_the_slip() -> None:
    scene = two_coupled_frictions()
    kernel = load_kernel(scene)
    result = roll(
        kernel,
        scene,
        16.0 * np.random.default_rng(3).normal(size=(STEPS, 1)),
        ContactLaw.SOFTPLUS,
        1e-3,
    )
    slip, limit = (
        kernel.slip(result.q[:-1], result.v[1:]),
        kernel.friction_limit(result.q[:-1], result.lam),
    )
    assert np.allclose(
        result.lam[:, 1:], -limit * np.tanh(sharpness(1e-3) * slip / (2 * 0.1)), rtol=0, atol=1e-13
    )


@pytest.mark.parametrize("eps", [1e-1, 1e-3, 1e-7, 1e-24])
def test_regularised_friction_is_found_from_stick_to_slip(eps: float) -> None:
    """Densely where sticking turns into slipping: there Newton's method on tanh goes round in circles for one speed in a thousand."""
    scene = block_on_a_cart(slip=w2, normal_force=m * g)
    kernel, c = load_kernel(scene), sharpness(eps) / (2 * 0.1)
    limit, grip = (
        0.3 * 2.0 * 10.0,
        STEP * 0.3 * 10.0,
    )  # mu m g; the speed that it takes away within a step
    for speed in np.concatenate(
        [
            np.linspace(0.0, 3.0 * grip, 2000),
            grip * (1.0 + np.linspace(-1.0, 1.0, 2000) / (1.0 + c * grip)),
        ]
    ):
        result = kernel.rollout(
            np.array([0.0, 0.0, 0.0, 0.0, speed, 0.0]),
            np.zeros((1, 1)),
            STEP,
            ContactLaw.SOFTPLUS,
            eps,
        )
        force, slip = result.lam[0, 1], result.v[1, 1]
        # the slip is a difference, of which c makes something of the size of the force
        assert abs(force + limit * np.tanh(c * slip)) <= 1e-14 * limit * (1.0 + c * grip)


@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_adjoint_is_the_derivative(law: ContactLaw, eps: float | None) -> None:
    scene = two_coupled_frictions()
    kernel, rng = load_kernel(scene), np.random.default_rng(0)
    u, start = 8.0 * rng.normal(size=(STEPS, 1)), np.array(scene.task.start)
    result = roll(kernel, scene, u, law, eps)
    q_bar, v_bar = rng.normal(size=result.q.shape), rng.normal(size=result.v.shape)
    u_bar, start_bar = kernel.adjoint(result, u, q_bar, v_bar)
    along_u, along_start = rng.normal(size=u.shape), rng.normal(size=start.shape)

    def loss(size: float) -> float:
        moved = kernel.rollout(start + size * along_start, u + size * along_u, STEP, law, eps)
        return float((moved.q * q_bar).sum() + (moved.v * v_bar).sum())

    expected = (loss(1e-6) - loss(-1e-6)) / 2e-6
    assert float((u_bar * along_u).sum() + start_bar @ along_start) == pytest.approx(
        expected, rel=1e-6
    )


def test_adjoint_of_frictions_with_one_slip_is_the_derivative() -> None:
    """The equations of two sticking frictions with one slip are dependent."""
    scene = two_coupled_frictions()
    belt = scene.frictions[0]
    belts = tuple(replace(belt, name=name, coefficient=mu * share) for name, share in PAIR.items())
    double = replace(scene, frictions=(*belts, scene.frictions[1]))
    rng = np.random.default_rng(2)
    u = 8.0 * rng.normal(size=(STEPS, 1))
    found = []
    for one in (scene, double):
        kernel = load_kernel(one)
        result = roll(kernel, one, u)
        found.append((result.v, *kernel.adjoint(result, u, 1 + result.q, result.v)))
    for single, pair in zip(*found, strict=True):
        assert pair == pytest.approx(single, rel=1e-9, abs=1e-10)


def test_friction_is_in_the_equations_and_in_the_plan() -> None:
    scene = two_coupled_frictions()
    d = derive(scene)
    assert "friction" not in d.absent
    assert d.slip_jacobian[1, 0] == sp.cos(x2)
    assert d.generalised_force[1] == d.f[0] + d.f[1]
    assert scene.force_names == ("lam_floor", "friction_belt", "friction_foot")
    plan = {
        "t": np.arange(3) * STEP,
        "q": np.zeros((3, 3)),
        "v": np.zeros((3, 3)),
        "u": np.zeros((2, 1)),
    }
    Trajectory(**plan, lam=np.zeros((2, 3))).check_fits(scene)
    with pytest.raises(TrajectoryError, match=r"lam has 1 columns, but .* has 3"):
        Trajectory(**plan, lam=np.zeros((2, 1))).check_fits(scene)
