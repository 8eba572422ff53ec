"""Every scene of the bank, and its factories at several sizes: one set of equations in every language, no more than it needs, as symmetric as it is. `push_box` and `hopper_planar`: what physics keeps, and the quasi-static step that is no approximation."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pyomo.environ as pyo
import pytest
import sympy as sp
import torch
from example_scenes import example_scene
from scipy.integrate import dblquad, simpson
from scipy.optimize import minimize, minimize_scalar

from formulations.shooting.reference import _acceleration, reference_rollout
from formulations.transcription.contact import SceneExpressions
from models.catalog import load_scene, scene_names
from models.codegen.emit import emit_model
from models.codegen.kernel import Kernel, load_kernel
from models.dynamics import derive
from models.errors import SceneError
from models.fmu import build_fmu
from models.scene import Scene
from models.scenes.cart_chain import cart_chain
from models.scenes.push_box import mean_distance
from models.scenes.two_discs import (
    RADIUS,
    RIGID_HIT,
    RIGID_HIT_WALL,
    RIGID_OPTIMUM,
    RIGID_OPTIMUM_WALL,
    STEP,
    STEPS,
    WEIGHT,
    two_discs,
)
from tests.formulations.transcription.rollouts import rolled_out
from tests.models.test_fingers import tip
from validate.judge.replay.run import replay

# Of which it stands below what their code holds.
PLAIN = (
    "acrobot_limits", "bouncing_mass", "cart_pole_walls", "hopper", "three_cart",
    "two_body_collision", "two_discs", "two_finger", "two_finger_lift",
)  # fmt: skip
BANK: dict[str, Callable[[], Scene]] = {
    **{name: (lambda name=name: load_scene(name)) for name in scene_names()},
    **{f"cart_chain({n})": (lambda n=n: cart_chain(n)) for n in (2, 3, 5, 20)},
    "two_discs(wall)": lambda: two_discs(wall=True),
}


@cache
def scene_of(name: str) -> Scene:
    return BANK[name]() if name in BANK else example_scene(name)


@cache
def kernel_of(name: str) -> Kernel:
    return load_kernel(scene_of(name))


def points(scene: Scene) -> tuple[np.ndarray, ...]:
    """Rows (q, v, u, lam with friction): zeros, ones, 0101, 0123 and two random ones."""
    sizes = np.cumsum([scene.nq, scene.nq, scene.nu, scene.nl])
    count = np.arange(int(sizes[-1]), dtype=float)
    random = np.random.default_rng(7).normal(size=(2, len(count)))
    rows = np.array([np.zeros_like(count), np.ones_like(count), count % 2, count, *random])
    return tuple(np.split(rows, sizes, axis=1)[:4])


@pytest.mark.slow
@pytest.mark.parametrize("name", [*BANK, "two_link_arm", "oscillator"])
def test_c_sympy_and_pyomo_agree_at_probe_points(name: str):
    """SymPy by numpy is the reference.

    The C kernel and the functions that write the Pyomo model, given numbers, give the same.
    """
    scene, kernel, d = scene_of(name), kernel_of(name), derive(scene_of(name))
    mass, force = (
        d.function(d.mass_matrix, d.q),
        d.function(d.generalised_force, d.q, d.v, d.u, (*d.lam, *d.f)),
    )
    phi, slip = d.function(d.penetration, d.q), d.function(d.slip, d.q, d.v)
    cost, end = d.function([d.running_cost], d.q, d.v, d.u), d.function([d.final_cost], d.q, d.v)
    written, p = SceneExpressions(d), [parameter.value for parameter in scene.parameters]
    for q, v, u, lam in zip(*points(scene), strict=True):
        close = {"rel": 1e-11, "abs": 1e-11}
        expected = np.linalg.solve(mass(q), force(q, v, u, lam).ravel())
        assert np.isfinite(expected).all()
        assert kernel.acceleration(q[None], v[None], u[None], lam[None])[0] == pytest.approx(
            expected, **close
        )
        assert kernel.penetration(q[None])[0] == pytest.approx(phi(q).ravel(), **close)
        assert kernel.slip(q[None], v[None])[0] == pytest.approx(slip(q, v).ravel(), **close)
        pairs = np.array([q, q]), np.array([v, v])
        assert kernel.cost(*pairs, u[None]) == pytest.approx(
            cost(q, v, u).item() + end(q, v).item(), **close
        )
        numbers = [[float(pyo.value(entry)) for entry in entries] for entries in (
            written.mass(q, p), written.force(q, v, u, lam, p), written.penetration(q, p),
            written.running_cost(q, v, u, p),
            written.final_cost(q, v, p) or [0.0], written.slip(q, v, p),
        )]  # fmt: skip
        references = (mass(q), force(q, v, u, lam), phi(q), cost(q, v, u), end(q, v), slip(q, v))
        for found, reference in zip(numbers, references, strict=True):
            assert found == pytest.approx(reference.ravel(), **close)


@pytest.mark.parametrize("name", BANK)
def test_torch_takes_the_same_steps(name: str):
    scene, kernel = scene_of(name), kernel_of(name)
    # the rollout in plain PyTorch solves no friction; given its forces, it has the same
    # accelerations
    if scene.nf:
        d, arguments = (
            derive(scene),
            [torch.from_numpy(np.ascontiguousarray(rows)) for rows in points(scene)],
        )
        accelerations = _acceleration(scene, (d.q, d.v, d.u, (*d.lam, *d.f)), torch.float64)
        found = np.array(
            [
                accelerations(*(rows[point] for rows in arguments)).numpy()
                for point in range(len(arguments[0]))
            ]
        )
        assert found == pytest.approx(kernel.acceleration(*points(scene)), rel=1e-11, abs=1e-11)
        return
    u = np.random.default_rng(3).normal(size=(8, scene.nu))
    start = np.array(scene.task.start)
    found = reference_rollout(scene, torch.from_numpy(u), torch.from_numpy(start))
    plan = kernel.rollout(start, u, scene.task.step)
    for left, right in zip(found, (plan.q, plan.v, plan.lam), strict=True):
        assert np.abs(left.numpy() - right).max(initial=0.0) < 1e-11


# Fingers swap, the disc's x and angle change sign; friction is measured along the line of centres
# turned left, which a mirror turns right.
_FINGERS = np.block(
    [[np.eye(4)[[2, 3, 0, 1]], np.zeros((4, 3))], [np.zeros((3, 4)), np.diag([-1.0, 1.0, -1.0])]]
)
_PAIR = np.eye(2)[::-1]


def _reversed(nq: int) -> np.ndarray:
    return -np.eye(nq)[::-1]


# Name -> (of positions and velocities, of inputs, of contact forces): the scene seen in a mirror.
MIRRORS = {
    "three_cart": (_reversed(3), _reversed(2), np.eye(2)[::-1]),
    "cart_chain(2)": (_reversed(2), _reversed(2), np.eye(1)),
    "cart_chain(5)": (_reversed(5), _reversed(2), np.eye(4)[::-1]),
    "cart_chain(20)": (_reversed(20), _reversed(2), np.eye(19)[::-1]),
    "cart_pole_walls": (-np.eye(2), -np.eye(1), np.eye(2)[::-1]),
    "acrobot_limits": (-np.eye(2), -np.eye(1), np.eye(2)[::-1]),
    "two_finger": (_FINGERS, np.eye(4)[[2, 3, 0, 1]], _PAIR),
    "two_finger_lift": (_FINGERS, np.eye(4)[[2, 3, 0, 1]],
                        np.block([[_PAIR, np.zeros((2, 3))],
                                  [np.zeros((1, 2)), np.ones((1, 1)), np.zeros((1, 2))],
                                  [np.zeros((2, 3)), -_PAIR]])),
    "two_discs": (np.diag([-1.0, 1.0, -1.0, 1.0]), np.diag([-1.0, 1.0]), np.eye(1)),
    "push_box": (np.diag([-1.0, 1.0, -1.0, -1.0, 1.0]), np.diag([-1.0, 1.0]), np.diag([1.0, -1.0])),
    "hopper_planar": (np.diag([-1.0, 1.0, -1.0, -1.0, 1.0]), np.diag([1.0, -1.0]),
                      np.diag([1.0, -1.0])),
}  # fmt: skip


@pytest.mark.parametrize("name", MIRRORS)
def test_a_mirrored_state_has_the_mirrored_motion(name: str):
    kernel, (state, inputs, contacts) = kernel_of(name), MIRRORS[name]
    q, v, u, lam = points(scene_of(name))
    nc = scene_of(name).nc
    mirrored = kernel.acceleration(q @ state.T, v @ state.T, u @ inputs.T, lam @ contacts.T)
    expected = kernel.acceleration(q, v, u, lam) @ state.T
    assert mirrored == pytest.approx(expected, rel=1e-11, abs=1e-11)
    assert kernel.penetration(q @ state.T) == pytest.approx(
        kernel.penetration(q) @ contacts[:nc, :nc].T, rel=1e-11, abs=1e-11
    )


@pytest.mark.parametrize(
    "name", ["two_discs", "two_discs(wall)", "two_body_collision", "three_cart", "cart_chain(20)"]
)
def test_a_pair_of_bodies_pushes_itself_nowhere(name: str):
    """Momentum: contact between bodies is an inner force. Contacts with a wall are not pairs."""
    d = derive(scene_of(name))
    q = points(scene_of(name))[0][-1]
    J = d.function(d.gap_jacobian, d.q)(q)
    pairs = [
        row
        for row, contact in zip(J, d.scene.contacts, strict=True)
        if not contact.name.startswith("wall")
    ]
    axes = 2 if name.startswith("two_discs") else 1
    for row in pairs:
        assert np.abs(row.reshape(-1, axes).sum(axis=0)).max() < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PLAIN, *(name for name in BANK if name not in scene_names())])
def test_the_generated_code_holds_what_the_scene_needs_and_nothing_else(name: str):
    """No functions of angles, no factorisation, no final cost where there is none."""
    scene = scene_of(name)
    text, structure = emit_model(scene), derive(scene).structure
    curved = {"cart_pole_walls", "acrobot_limits", "two_finger", "two_finger_lift"}
    assert ("sin(" in text) == (name in curved)
    assert ("sqrt(" in text) == (not structure.constant_mass or name.startswith("two_discs"))
    assert structure.linear == (name not in curved | {"two_discs", "two_discs(wall)"})
    assert ("FINAL_COST" in text) == (scene.task.final_cost != 0)


def test_three_carts_of_the_chain_are_the_papers_bit_for_bit():
    chain, paper = replace(cart_chain(3), name="three_cart"), load_scene("three_cart")
    assert emit_model(chain) == emit_model(paper)
    u = np.random.default_rng(2).uniform(-10.0, 10.0, size=(500, 2))
    one, other = (
        load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
        for scene in (chain, paper)
    )
    assert one.lam.max() > 0.0
    for field in ("q", "v", "lam"):
        assert np.array_equal(getattr(one, field), getattr(other, field)), field
    assert (chain.task, chain.contacts[0].stiffness) == (paper.task, paper.contacts[0].stiffness)


@pytest.mark.parametrize("n", [1, 21, 2.5, True, "3"])
def test_a_chain_of_no_such_length_is_refused(n: object):
    with pytest.raises(SceneError, match="from 2 to 20"):
        cart_chain(n)  # pyright: ignore[reportArgumentType] - the mistake under test


@pytest.mark.parametrize(
    ("name", "force"),
    [("two_discs", 5000.0 * 0.4), ("two_finger", 100.0 * 0.06), ("two_finger_lift", 100.0 * 0.06)],
)
def test_coincident_centres_have_a_defined_normal(name: str, force: float):
    """No direction is better than another: no force between discs, nor of a tip in the middle of one, and finite derivatives (stress case 11)."""
    kernel, state = kernel_of(name), np.array(scene_of(name).task.start)
    if name == "two_discs":
        state[:] = 0.3, -0.2, 0.3, -0.2, 0.0, 0.0, 0.0, 0.0
    else:
        state[4:6] = tip(state, -1)[0]
    u = np.full((5, scene_of(name).nu), 0.05)
    plan = kernel.rollout(state, u, 1e-3)
    assert not plan.diverged
    assert plan.lam[0, 0] == pytest.approx(force, rel=1e-4)
    gradient, _ = kernel.adjoint(plan, u, plan.q, plan.v, cost_bar=1.0)
    assert np.isfinite(gradient).all()


def rigid_cost(
    direction: float, time: float, speed: float, start: tuple[float, ...], goal: tuple[float, float]
) -> float:
    """Return the cost of a throw of rigid discs, by the closed form in the docstring of the scene.

    Disc 2 is hit at `time` [s], along the angle `direction` [rad], with `speed` [m/s] > 0 along it.
    start: (4,) centres of disc 1 and 2 [m]; goal: place that disc 2 glides towards [m].
    """
    nx, ny = math.cos(direction), math.sin(direction)
    dx, dy = start[2] - 2 * RADIUS * nx - start[0], start[3] - 2 * RADIUS * ny - start[1]
    along, across = dx * nx + dy * ny, dy * nx - dx * ny
    work = (
        12 * along**2 / time**3
        - 12 * along * speed / time**2
        + 4 * speed**2 / time
        + 3 * across**2 / time**3
    )
    glide = speed * (STEPS * STEP - time)
    return (
        (start[2] + glide * nx - goal[0]) ** 2
        + (start[3] + glide * ny - goal[1]) ** 2
        + WEIGHT * work
    )


def rigid_hit_cost(time: float, start: tuple[float, ...], goal: tuple[float, float]) -> float:
    """Return the cost of a hit at `time` [s] after which disc 2 glides exactly onto its goal."""
    dx, dy = goal[0] - start[2], goal[1] - start[3]
    speed = math.hypot(dx, dy) / (STEPS * STEP - time)
    return rigid_cost(math.atan2(dy, dx), time, speed, start, goal)


@pytest.mark.parametrize(
    ("start", "goal", "optimum", "printed", "hit"),
    [
        ((-1.0, -2.0, -1.0, -1.0), (0.0, 0.0), RIGID_OPTIMUM, 0.3115, RIGID_HIT),
        ((0.25, -0.3, -0.5, 0.6), (0.0, 1.6), RIGID_OPTIMUM_WALL, 0.3737, RIGID_HIT_WALL),
    ],
)  # fmt: skip
def test_the_rigid_optimum_of_the_discs_and_their_limit(
    start: tuple[float, ...], goal: tuple[float, float], optimum: float, printed: float, hit: float
):
    """The closed form's minimum; the numbers from a grid are slightly high.

    The limit is the cheapest throw onto the goal.
    """

    def cost(x: np.ndarray) -> float:
        return (
            rigid_cost(x[0], x[1], x[2], start, goal)
            if 0.05 < x[1] < 1.0 and x[2] > 0.0
            else math.inf
        )

    starts = [(angle, time, 2.0) for angle in np.linspace(-3.0, 3.0, 9) for time in (0.4, 0.6)]
    options = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    best = min(minimize(cost, point, method="Nelder-Mead", options=options).fun for point in starts)
    assert best == pytest.approx(optimum, abs=1e-7)
    assert 0.0 < printed - best < 2e-4
    found = minimize_scalar(
        lambda time: rigid_hit_cost(time, start, goal),
        bounds=(0.05, 0.95),
        method="bounded",
        options={"xatol": 1e-9},
    )
    assert found.fun == pytest.approx(hit, abs=1e-7)
    idle = start[2] ** 2 + start[3] ** 2
    assert optimum < hit < idle, "the optimum holds, doing nothing does not"


@pytest.mark.parametrize("name", scene_names())
def test_contacts_say_between_whom_and_how_deep(name: str):
    """Deeper than the start is deep, and the bodies are what is drawn."""
    scene = load_scene(name)
    drawn = {shape.name for shape in scene.shapes} | {"ground", "wall", "joint"}
    positions = np.array(scene.task.start[: scene.nq])
    depths = derive(scene).function(derive(scene).penetration, derive(scene).q)(positions).ravel()
    for contact, depth, start in zip(scene.contacts, scene.depths, depths, strict=True):
        assert set(contact.bodies) <= drawn
        assert depth > max(0.0, start), contact.name
        assert depth > contact.nominal, "a typical penetration is within the model"
        assert len(contact.depth_reason.split()) > 3


@pytest.mark.parametrize("name", scene_names())
def test_every_limit_of_the_bank_has_a_reason_and_the_plan_the_tighter_one(name: str):
    scene = load_scene(name)
    assert all(limit.reason for limit in scene.limits)
    for part in ("position", "velocity"):
        plan, replayed, own = (
            scene.limit(f"{of}terminal_{part}_error") for of in ("", "replay_", "discrete_")
        )
        if plan is not None and replayed is not None and own is not None:
            assert (plan.value or 0.0) == own.value
            assert (plan.value or 0.0) <= (replayed.value or 0.0)


@pytest.mark.slow
def test_doing_nothing_in_the_wall_pendulum_costs_more_than_its_limit():
    """And the proved optimum less."""
    scene = load_scene("wall_pendulum")
    steps = scene.task.steps
    idle = rolled_out(scene, np.zeros((steps, 1)))
    limit = scene.limit("replay_cost")
    assert scene.answers[0].value < limit.value < load_kernel(scene).cost(idle.q, idle.v, idle.u)
    motion = replay(scene, build_fmu(scene), idle)
    rate = (motion.q**2 + motion.v**2)[:, 0] / scene.task.step
    assert 0.0 < simpson(rate, x=motion.t) - limit.value < 1e-3


@pytest.mark.parametrize("name", ["cart_pole_walls", "acrobot_limits"])
def test_growth_rates_are_those_of_the_derived_equations(name: str):
    d, zero = derive(scene_of(name)), np.zeros(2)
    slope = d.function(d.tau.jacobian(d.q), d.q, d.v, d.u)(zero, zero, np.zeros(1))
    squares = np.linalg.eigvals(np.linalg.solve(d.function(d.mass_matrix, d.q)(zero), slope))
    rates = sorted(np.sqrt(squares[squares > 1e-9]), reverse=True)
    answers = [answer for answer in scene_of(name).answers if "growth rate" in answer.quantity]
    assert rates == pytest.approx([answer.value for answer in answers], abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["acrobot_limits", "hopper", "two_body_collision"])
def test_the_fine_integrator_keeps_the_energy_of_the_unforced_motion(name: str):
    scene = scene_of(name).with_task(steps=round(0.6 / scene_of(name).task.step))
    result = replay(
        scene, build_fmu(scene), rolled_out(scene, np.zeros((scene.task.steps, scene.nu)))
    )
    assert result.ok, result.message
    energy = result.kinetic_energy + result.potential_energy + result.contact_energy
    assert result.kinetic_energy.max() > 0.1 * abs(energy[0]), "it moves"
    assert result.lam.max() > 0.0, "it touches"
    assert np.abs(energy - energy[0]).max() < 1e-9 * abs(energy[0])


def test_the_hoppers_plans_get_their_impulse_from_the_floor():
    """Momentum from rest to rest: any inputs that do it.

    Here the identity itself, on the plan's own time step.
    """
    scene = scene_of("hopper")
    u = np.random.default_rng(0).uniform(-5.0, 5.0, size=(200, 1))
    plan = kernel_of("hopper").rollout(np.array(scene.task.start), u, scene.task.step)
    masses = np.array([1.0, 0.2])
    gained = plan.v[-1] @ masses - plan.v[0] @ masses
    assert plan.lam.sum() * scene.task.step == pytest.approx(
        scene.answers[0].value + gained, rel=1e-12
    )


CLOSE = {"rel": 1e-10, "abs": 1e-10}


def test_the_leg_changes_neither_momentum_nor_angular_momentum() -> None:
    """About the origin, clockwise positive as the pitch: weight, floor and friction are all that acts on the whole."""
    scene, kernel = scene_of("hopper_planar"), kernel_of("hopper_planar")
    p = {parameter.name: parameter.value for parameter in scene.parameters}
    masses = np.array([p["m"], p["m_f"]])
    q, v, u, forces = points(scene)
    a = kernel.acceleration(q, v, u, forces)
    lam, friction = forces.T
    assert a[:, [0, 3]] @ masses == pytest.approx(friction, **CLOSE)
    assert a[:, [1, 4]] @ masses == pytest.approx(lam - p["g"] * masses.sum(), **CLOSE)
    turning = (
        p["inertia"] * a[:, 2]
        + (q[:, [1, 4]] * a[:, [0, 3]] - q[:, [0, 3]] * a[:, [1, 4]]) @ masses
    )
    weight = p["g"] * q[:, [0, 3]] @ masses
    assert turning == pytest.approx(weight + q[:, 4] * friction - q[:, 3] * lam, rel=1e-9, abs=1e-9)


def test_the_time_step_of_the_box_is_the_quasi_static_law() -> None:
    """v' = D^-1 F exactly, whatever the velocity was."""
    scene, kernel, d = scene_of("push_box"), kernel_of("push_box"), derive(scene_of("push_box"))
    values = scene.parameter_values
    drag = np.array(
        [
            float(sp.sympify(-force).diff(item.velocity).subs(values))
            for force, item in zip(scene.forces, scene.coordinates, strict=True)
        ]
    )
    force = d.function(d.generalised_force, d.q, d.v, d.u, (*d.lam, *d.f))
    for q, v, u, forces in zip(*points(scene), strict=True):
        after = (
            v + scene.task.step * kernel.acceleration(q[None], v[None], u[None], forces[None])[0]
        )
        assert after == pytest.approx(
            force(q, np.zeros(scene.nq), u, forces).ravel() / drag, rel=1e-12, abs=1e-12
        )


def test_the_rim_is_exact_along_the_faces_and_the_cone_that_of_its_normal() -> None:
    scene, d = scene_of("push_box"), derive(scene_of("push_box"))
    phi, jacobian, slip = (
        d.function(d.penetration, d.q),
        d.function(d.gap_jacobian, d.q),
        d.function(d.slip_jacobian, d.q),
    )
    for along, across in ((-0.53, 0.0), (0.52, 0.1), (0.1, -0.24), (-0.2, 0.25), (0.5, 0.25)):
        distances = np.array([abs(along) - 0.5, abs(across) - 0.25])
        others = (
            math.log1p(
                2 * math.exp(-20.0 * abs(distances[0] - distances[1])) + math.exp(-20.0 * 0.4)
            )
            / 20.0
        )
        outside = -phi(np.array([0.0, 0.0, 0.0, along, across])).item()
        assert 0.0 <= outside - distances.max() <= others
    q = np.array([0.1, 0.2, 0.4, -0.35, -0.1])
    normal, tangent = jacobian(q).ravel(), slip(q).ravel()
    assert normal[3:] @ tangent[3:] == pytest.approx(0.0, abs=1e-14)
    assert np.linalg.norm(normal[3:]) == pytest.approx(np.linalg.norm(tangent[3:]), rel=1e-12)
    for row in (normal, tangent):  # action and reaction, and no torque on the pair about the finger
        assert row[:2] + row[3:] == pytest.approx([0.0, 0.0], abs=1e-14)
        arm = q[3:] - q[:2]
        assert row[2] == pytest.approx(arm[0] * row[1] - arm[1] * row[0], abs=1e-12)
    assert scene.task.goal[2] == 0.0


def test_the_mean_distance_of_a_footprint() -> None:
    integral, _ = dblquad(lambda y, x: math.hypot(x, y), 0.0, 0.5, 0.0, 0.25)
    assert mean_distance(0.5, 0.25) == pytest.approx(integral / 0.125, rel=1e-8)


def test_one_face_alone_has_to_turn_the_box() -> None:
    """Pushed on its left face for a while each at random places and angles within the cone, no box that turns less comes as far aside."""
    scene = scene_of("push_box")
    (answer,) = scene.answers
    mu, d, c = (
        next(item.value for item in scene.parameters if item.name == name)
        for name in ("mu", "d", "c")
    )
    random = np.random.default_rng(5)
    x = y = theta = turned = np.zeros(2000)
    for _ in range(60):
        normal, arm, share = (
            random.uniform(0.0, 4.0, 2000),
            random.uniform(-0.25, 0.25, 2000),
            random.uniform(-1.0, 1.0, 2000),
        )
        tangential = mu * normal * share
        x = x + 0.02 / d * (np.cos(theta) * normal - np.sin(theta) * tangential)
        y = y + 0.02 / d * (np.sin(theta) * normal + np.cos(theta) * tangential)
        theta = theta + 0.02 / (d * c**2) * (-0.5 * tangential - arm * normal)
        turned = np.maximum(turned, np.abs(theta))
    aside = np.arctan2(np.abs(y), x) - math.atan(mu)
    assert (aside <= turned + 1e-12).all()
    assert answer.value == pytest.approx(math.radians(13.2405), abs=1e-5)


@pytest.mark.slow
def test_each_has_only_what_it_needs() -> None:
    assert set(derive(scene_of("push_box")).absent) == {
        "a mass matrix that depends on q",
        "inertial coupling",
        "a potential",
    }
    assert set(derive(scene_of("hopper_planar")).absent) == {
        "a mass matrix that depends on q",
        "inertial coupling",
    }
    assert "sqrt(" not in emit_model(scene_of("push_box"))
    assert "sin(" not in emit_model(scene_of("hopper_planar"))
