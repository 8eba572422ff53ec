"""The two scenes with fingers: their equations against formulas and rigid motions that share nothing with the scene files."""

from collections.abc import Callable

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.dynamics import derive
from models.scene import Scene

L = 0.1
W = 0.02
M_L = 0.1
R = 0.05
BASE = 0.13
NAMES = ("two_finger", "two_finger_lift")
# Central differences of step 1e-6 of quantities of order 1: 1e-10 of rounding and less of
# truncation.
STEP = 1e-6
CLOSE = 1e-8


def states(scene: Scene, count: int = 5) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(4)
    start = np.array(scene.task.start[: scene.nq])
    return [(start + 0.3 * rng.normal(size=7), rng.normal(size=7)) for _ in range(count)]


def tip(q: np.ndarray, side: int) -> tuple[np.ndarray, float]:
    """Tip of the left (-1) or right (1) finger and the angle of its second link against the x axis, from cosines of angles alone."""
    first, second = q[:2] if side < 0 else np.pi - q[2:4]
    return np.array(
        [
            side * BASE + L * np.cos(first) + L * np.cos(second),
            L * np.sin(first) + L * np.sin(second),
        ]
    ), float(second)


def double_pendulum_mass(elbow: float) -> np.ndarray:
    """The textbook's mass matrix of a planar two-link arm in relative joint angles, its links uniform bars of length L and width W."""
    inertia, half = M_L * (L**2 + W**2) / 12, L / 2
    inner = inertia + M_L * half**2
    coupling = inner + M_L * L * half * np.cos(elbow)
    whole = 2 * inertia + M_L * half**2 + M_L * (L**2 + half**2 + 2 * L * half * np.cos(elbow))
    return np.array([[whole, coupling], [coupling, inner]])


@pytest.mark.parametrize("name", NAMES)
def test_each_finger_is_the_double_pendulum_of_the_textbook(name: str) -> None:
    d = derive(load_scene(name))
    mass = d.function(d.mass_matrix, d.q)
    absolute = np.array(
        [[1.0, 0.0], [1.0, 1.0]]
    )  # of relative angles: the second link turns with the first
    for q, _ in states(d.scene):
        found = mass(q)
        for at in (0, 2):
            block = found[at : at + 2, at : at + 2]
            assert absolute.T @ block @ absolute == pytest.approx(
                double_pendulum_mass(q[at + 1] - q[at]), rel=1e-12
            )
        assert np.abs(found[:2, 2:]).max() == np.abs(found[2:4, 4:]).max() == 0.0
        disc = d.scene.parameter_values[
            next(item.symbol for item in d.scene.parameters if item.name == "m_d")
        ]
        assert np.diag(found)[4:] == pytest.approx([disc, disc, disc * R**2 / 2], rel=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_stretched_finger_turns_like_one_bar(name: str) -> None:
    scene = load_scene(name)
    d = derive(scene)
    both = np.array([1.0, 1.0])
    block = d.function(d.mass_matrix, d.q)(np.array([0.4, 0.4, 0.1, 0.2, 0.0, 0.3, 0.0]))[:2, :2]
    answer = next(answer for answer in scene.answers if "stretched" in answer.quantity)
    assert both @ block @ both == pytest.approx(answer.value, abs=answer.tolerance)


def surface_slip(q: np.ndarray, v: np.ndarray, side: int) -> float:
    """Rigid motions by finite differences: how fast the rim of the disc passes the surface of the tip at the point that divides the centres R : w/2."""
    centre, radius = q[4:6], W / 2

    def carried(
        point: np.ndarray, origin: Callable[[np.ndarray], tuple[np.ndarray, float]]
    ) -> np.ndarray:
        """Velocity of a point fixed to the body whose origin and angle are given."""
        (before, a), (after, b) = origin(q - STEP * v), origin(q + STEP * v)
        here, angle = origin(q)
        arm = point - here

        def turned(by: float) -> np.ndarray:
            return np.array(
                [
                    arm[0] * np.cos(by) - arm[1] * np.sin(by),
                    arm[0] * np.sin(by) + arm[1] * np.cos(by),
                ]
            )

        return (after + turned(b - angle) - before - turned(a - angle)) / (2 * STEP)

    here = tip(q, side)[0]
    along = (centre - here) / np.linalg.norm(centre - here)
    point = here + (centre - here) * radius / (R + radius)
    across = np.array([-along[1], along[0]])
    return float(
        across
        @ (carried(point, lambda at: (at[4:6], at[6])) - carried(point, lambda at: tip(at, side)))
    )


def test_slip_is_the_relative_velocity_of_the_surfaces() -> None:
    d = derive(load_scene("two_finger_lift"))
    slip = d.function(d.slip, d.q, d.v)
    for q, v in states(d.scene):
        assert slip(q, v).ravel() == pytest.approx(
            [surface_slip(q, v, side) for side in (-1, 1)], abs=CLOSE
        )


def test_tip_and_disc_push_and_rub_each_other_alike() -> None:
    """Momentum and angular momentum: what a contact does to the disc it does, reversed, to a finger that holds force and moment at its tip."""
    d = derive(load_scene("two_finger_lift"))
    J, S = d.function(d.gap_jacobian, d.q), d.function(d.slip_jacobian, d.q)
    for q, _ in states(d.scene):
        for index, (side, at) in enumerate(((-1, 0), (1, 2))):
            for row in (J(q)[index], S(q)[index]):
                force, moment, place = row[4:6], row[6], tip(q, side)[0]
                arm = q[4:6] - place
                at_tip = -moment - (arm[0] * force[1] - arm[1] * force[0])
                for joint in range(2):
                    nudge = STEP * np.eye(7)[at + joint]
                    (after, b), (before, a) = tip(q + nudge, side), tip(q - nudge, side)
                    expected = (-force @ (after - before) + at_tip * (b - a)) / (2 * STEP)
                    assert row[at + joint] == pytest.approx(expected, abs=CLOSE)


@pytest.mark.parametrize(("law", "eps"), [(ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-60)])
def test_the_adjoint_through_a_squeeze_that_sticks_and_slips(
    law: ContactLaw, eps: float | None
) -> None:
    """The direction of the slip depends on the position: its share of the adjoint, against finite differences."""
    scene = load_scene("two_finger_lift")
    kernel, h = load_kernel(scene), scene.task.step
    rng = np.random.default_rng(5)
    start, u = (
        np.array(scene.task.start),
        np.tile([0.2, 0.1, 0.2, 0.1], (60, 1)) + 0.02 * rng.normal(size=(60, 4)),
    )
    weight = rng.normal(size=(2, 61, 7))

    def loss(inputs: np.ndarray) -> float:
        plan = kernel.rollout(start, inputs, h, law, eps)
        return float((weight[0] * plan.q).sum() + (weight[1] * plan.v).sum())

    plan = kernel.rollout(start, u, h, law, eps)
    assert plan.lam[:, :2].max() > 0.5, "it squeezes"
    ratio = np.abs(plan.lam[:, 3:]) / np.maximum(plan.lam[:, :2], 1e-9)
    assert (ratio[plan.lam[:, :2] > 0.1] < 0.9).any(), "it sticks somewhere"
    gradient, _ = kernel.adjoint(plan, u, weight[0], weight[1])
    for _ in range(3):
        direction = rng.normal(size=u.shape)
        numeric = (loss(u + 1e-7 * direction) - loss(u - 1e-7 * direction)) / 2e-7
        assert (gradient * direction).sum() == pytest.approx(numeric, rel=1e-5)


def test_the_table_and_the_least_squeeze() -> None:
    """At rest on the table nothing accelerates.

    Held in the air by the least squeeze of the answer and full friction, neither does the disc.
    """
    scene = load_scene("two_finger_lift")
    d, kernel = derive(scene), load_kernel(scene)
    q, zero = np.array([scene.task.start[:7]]), np.zeros((1, 7))
    phi = kernel.penetration(q)[0]
    assert (phi[:2] < 0.0).all()
    lam = np.array([[0.0, 0.0, kernel.stiffness()[2] * phi[2], 0.0, 0.0]])
    assert kernel.acceleration(q, zero, np.zeros((1, 4)), lam)[0, 4:] == pytest.approx(
        0.0, abs=1e-12
    )
    least = next(answer for answer in scene.answers if "squeeze" in answer.quantity)
    mu = scene.parameter_values[next(item.symbol for item in scene.parameters if item.name == "mu")]
    S = d.function(d.slip_jacobian, d.q)(q[0])
    friction = mu * least.value * np.sign(S[:, 5])  # the way that lifts
    squeezed = np.array([[least.value, least.value, 0.0, *friction]])
    assert kernel.acceleration(q, zero, np.zeros((1, 4)), squeezed)[0, 4:6] == pytest.approx(
        0.0, abs=1e-8
    )  # BLUR: 1e-10 of g
    slack = np.array([[0.99 * least.value, 0.99 * least.value, 0.0, *(0.99 * friction)]])
    assert kernel.acceleration(q, zero, np.zeros((1, 4)), slack)[0, 5] == pytest.approx(
        -0.01 * 9.81, rel=1e-6
    )
