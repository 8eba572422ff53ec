"""Equations of motion: by hand where that is short, by energy and momentum everywhere.

The stability limit of the time step: closed forms, the step's Jacobian against differences, and
motions that are unstable by themselves. Collocation steps against closed forms: order, energy, the
kink of a contact.
"""

import math
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene, scene_names
from models.codegen.kernel import KernelError, load_kernel
from models.collocation import advance, defect, rollout, switch_error
from models.dynamics import derive
from models.scene import Scene
from models.scenes.cart_chain import cart_chain
from models.schemes import Scheme, tableau
from models.stability import spectral_radius, step_stability
from models.trajectory import Trajectory, uniform_grid
from models.trajectory_netcdf import read_netcdf, write_netcdf

TEST_SCENES = sorted(str(path) for path in (Path(__file__).parents[1] / "scenes").glob("*.py"))
ALL_SCENES = [*scene_names(), *TEST_SCENES]
# Rounding of a few dozen operations on numbers of order 1 to 100.
ROUNDING = 1e-11


@pytest.fixture(params=ALL_SCENES, ids=lambda name: Path(name).stem)
def scene(request) -> Scene:
    return load_scene(request.param)


def probe(scene: Scene, seed: int = 0):
    """A random state near the start, inputs and contact forces of order 1."""
    rng = np.random.default_rng(seed)
    q = np.array(scene.task.start[: scene.nq]) + 0.3 * rng.standard_normal(scene.nq)
    return (
        q,
        rng.standard_normal(scene.nq),
        rng.standard_normal(scene.nu),
        rng.uniform(0.0, 2.0, scene.nc),
    )


def test_three_cart_as_the_paper_prints_it():
    d = derive(load_scene("three_cart"))
    v1, v2, v3, u1, u3, c, m, lam1, lam3 = (*d.v, *d.u, d.p[1], d.p[0], *d.lam)
    expected = sp.Matrix(
        [(u1 - c * v1 - lam1) / m, (lam1 - lam3 - c * v2) / m, (u3 - c * v3 + lam3) / m]
    )
    assert sp.simplify(d.acceleration - expected) == sp.zeros(3, 1)
    assert d.structure.linear
    assert d.structure.constant_mass
    assert "friction" in d.absent
    assert "inputs" not in d.absent


@pytest.mark.slow
def test_mass_matrix_is_symmetric_positive_definite(scene: Scene):
    d = derive(scene)
    for seed in range(20):
        M = d.function(d.mass_matrix, d.q)(probe(scene, seed)[0])
        assert np.array_equal(M, M.T) or np.allclose(M, M.T, rtol=0, atol=ROUNDING)
        assert np.linalg.eigvalsh(M).min() > 0


@pytest.mark.slow
def test_gap_jacobian_is_the_derivative_of_the_gap(scene: Scene):
    d = derive(scene)
    if not scene.nc:
        assert d.gap_jacobian.shape == (0, scene.nq)
        return
    gap, J = d.function(-d.penetration, d.q), d.function(d.gap_jacobian, d.q)
    q, step = probe(scene)[0], 1e-6
    numeric = np.column_stack(
        [(gap(q + step * e) - gap(q - step * e)) / (2 * step) for e in np.eye(scene.nq)]
    )
    assert np.allclose(
        J(q), numeric, rtol=0, atol=1e-8
    )  # central differences of step 1e-6: about 1e-10 of rounding, 1e-12 of truncation


@pytest.mark.slow
def test_power_balance(scene: Scene):
    """d/dt (T + V) = power of the inputs - dissipated power + power of contact and friction forces, at random states."""
    d = derive(scene)
    energy = sp.Matrix([d.kinetic_energy + d.potential_energy])
    slope_q, slope_v = (
        d.function(energy.jacobian(d.q), d.q, d.v),
        d.function(energy.jacobian(d.v), d.q, d.v),
    )
    M, f = (
        d.function(d.mass_matrix, d.q),
        d.function(d.generalised_force, d.q, d.v, d.u, (*d.lam, *d.f)),
    )
    slip = d.function(d.slip, d.q, d.v) if scene.nf else None
    J = d.function(d.gap_jacobian, d.q) if scene.nc else None
    power_in = d.function([d.input_power], d.q, d.v, d.u)
    power_out = d.function([d.dissipated_power], d.q, d.v)
    for seed in range(20):
        q, v, u, lam = probe(scene, seed)
        friction = np.random.default_rng(seed).normal(size=scene.nf)
        a = np.linalg.solve(M(q), f(q, v, u, np.concatenate([lam, friction]))).ravel()
        rate = (slope_q(q, v) @ v + slope_v(q, v) @ a).item()
        contact = float(lam @ (J(q) @ v)) if J is not None else 0.0
        contact += float(friction @ slip(q, v).ravel()) if slip is not None else 0.0
        assert rate == pytest.approx(
            power_in(q, v, u).item() - power_out(q, v).item() + contact, abs=1e-9, rel=1e-9
        )


@pytest.mark.slow
def test_contact_forces_push_apart(scene: Scene):
    """A contact force accelerates its gap open: J M^-1 J' has a positive diagonal."""
    if not scene.nc:
        return
    d = derive(scene)
    for seed in range(5):
        q = probe(scene, seed)[0]
        J, M = d.function(d.gap_jacobian, d.q)(q), d.function(d.mass_matrix, d.q)(q)
        assert (np.diag(J @ np.linalg.solve(M, J.T)) > 0).all()


def test_derivation_is_cached_with_the_scene():
    scene = load_scene("three_cart")
    assert derive(scene) is derive(scene)


@pytest.mark.parametrize(("h", "c"), [(0.01, 2.0), (0.02, 2.0), (0.01, 0.0), (0.001, 50.0)])
def test_three_carts_have_the_limit_of_the_closed_form(h: float, c: float):
    """h^2 w^2 + 2 h c < 4 with w^2 = 3 k: both contacts closed, the middle cart against the outer two; k < 13200 N/m of the paper's carts."""
    limit = (4.0 - 2.0 * h * c) / (3.0 * h**2)
    scene = load_scene("three_cart").with_task(step=h)
    below = step_stability(scene.with_parameters(k=0.9999 * limit, c=c))
    above = step_stability(scene.with_parameters(k=1.0001 * limit, c=c))
    assert below.is_stable
    assert below.sentence == ""
    assert not above.is_stable
    assert above.radius > 1.0
    assert above.contacts == ("left", "right")
    assert "left and right closed" in above.sentence
    # the step it advises is the root of the same form in h
    w2 = 3.0 * 1.0001 * limit
    root = (-2.0 * c + math.sqrt(4.0 * c**2 + 16.0 * w2)) / (2.0 * w2)
    assert above.largest_step == pytest.approx(root, rel=1e-6)


@pytest.mark.slow
def test_a_free_pair_and_a_long_chain():
    pair = load_scene("two_body_collision")
    w = math.sqrt(2000.0 / 0.75)
    assert step_stability(pair).largest_step == pytest.approx(2.0 / w, rel=1e-6)
    n = 20  # all contacts closed is a chain of springs, free at its ends
    chain = cart_chain(n)
    w2 = 4.0 * 30.0 * math.sin(math.pi * (n - 1) / (2 * n)) ** 2
    root = (-4.0 + math.sqrt(16.0 + 16.0 * w2)) / (2.0 * w2)
    assert step_stability(chain).largest_step == pytest.approx(root, rel=1e-5)


def test_contacts_that_exclude_each_other_are_not_closed_together():
    """The two walls are 2 m apart: both closed would be twice as stiff."""
    found = step_stability(load_scene("cart_pole_walls").with_parameters(k=2e5))
    assert len(found.contacts) == 1


@pytest.mark.parametrize("name", ["cart_pole_walls", "acrobot_limits"])
def test_a_motion_that_is_unstable_by_itself_is_not_the_steps_fault(name: str):
    found = step_stability(load_scene(name))
    assert found.is_stable
    assert found.radius > 1.001  # it does grow
    assert found.growth > 3.0


@pytest.mark.parametrize("name", ["three_cart", "cart_pole_walls", "two_discs"])
def test_the_jacobian_of_the_step_against_differences(name: str):
    scene = load_scene(name)
    kernel, task = load_kernel(scene), scene.task
    state = np.array(task.start) + np.random.default_rng(5).normal(scale=0.1, size=2 * scene.nq)
    u = np.full((1, scene.nu), 0.5)

    def after(x: np.ndarray) -> np.ndarray:
        plan = kernel.rollout(x, u, task.step)
        return np.concatenate([plan.q[-1], plan.v[-1]])

    columns = [(after(state + d) - after(state - d)) / 2e-6 for d in 1e-6 * np.eye(len(state))]
    assert kernel.end_derivatives(state, u, task.step)[0] == pytest.approx(
        np.array(columns).T, abs=1e-8
    )


def test_past_the_limit_the_step_does_blow_up():
    """What the warning promises: contact that is closed once throws the carts out of every bound.

    Below the limit it does not.
    """
    scene = load_scene("three_cart")
    start = np.array([2.5, 2.99, 3.48, 0.0, 0.0, 0.0])
    speeds = []
    for k in (13000.0, 15000.0):
        pressed = scene.with_parameters(k=k)
        speeds.append(
            spectral_radius(
                load_kernel(pressed).end_derivatives(start, np.zeros((1, 2)), scene.task.step)[0]
            )
        )
    assert speeds[0] <= 1.0 + 1e-9
    assert speeds[1] > 1.5


def test_friction_does_not_limit_the_step():
    """The same stops without the belt, which the step treats implicitly."""
    scene = load_scene("transport")
    w2 = 1000.0 * (1.0 + 0.5)
    assert step_stability(scene).largest_step == pytest.approx(2.0 / math.sqrt(w2), rel=1e-6)


OSCILLATOR = load_scene(str(Path(__file__).parents[1] / "scenes" / "oscillator.py"))
ORDERS = {Scheme.IMPLICIT_MIDPOINT: 2, Scheme.RADAU_IIA_2: 3}


@pytest.mark.parametrize("scheme", ORDERS)
def test_the_tableau_integrates_what_its_order_promises(scheme: Scheme) -> None:
    """B(order): sum b_i c_i^(p-1) = 1/p; C(stages): sum_j a_ij c_j^(p-1) = c_i^p/p."""
    table, order = tableau(scheme), ORDERS[scheme]
    for p in range(1, order + 1):
        assert table.b @ table.c ** (p - 1) == pytest.approx(1.0 / p, abs=1e-14)
    assert abs(table.b @ table.c**order - 1.0 / (order + 1)) > 1e-4
    for p in range(1, table.stages + 1):
        np.testing.assert_allclose(table.a @ table.c ** (p - 1), table.c**p / p, atol=1e-14)
    assert table.is_stiffly_accurate == (scheme is not Scheme.IMPLICIT_MIDPOINT)


@pytest.mark.parametrize("scheme", ORDERS)
def test_the_switch_constant_is_the_largest_error_of_a_kink(scheme: Scheme) -> None:
    table = tableau(scheme)
    z = np.linspace(0.0, 1.0, 20_001)
    error = np.abs((1.0 - z) ** 2 / 2.0 - np.maximum(table.c - z[:, None], 0.0) @ table.b)
    assert table.switch_constant >= error.max() - 1e-15
    assert table.switch_constant == pytest.approx(error.max(), rel=1e-3)


@pytest.mark.parametrize("scheme", ORDERS)
def test_the_order_on_a_free_oscillator(scheme: Scheme) -> None:
    """q = cos t: the slope of log error over log step."""
    kernel, errors = load_kernel(OSCILLATOR), []
    for steps in (8, 16):
        q, v, made = rollout(
            kernel, scheme, np.array([1.0, 0.0]), np.zeros((steps, 0)), 2.0 / steps
        )
        assert made == steps
        errors.append(np.hypot(q[-1, 0] - np.cos(2.0), v[-1, 0] + np.sin(2.0)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(ORDERS[scheme], abs=0.1)


def test_the_midpoint_keeps_the_energy_and_radau_loses_some() -> None:
    kernel, lost = load_kernel(OSCILLATOR), {}
    for scheme in ORDERS:
        q, v, _ = rollout(kernel, scheme, np.array([1.0, 0.0]), np.zeros((200, 0)), 0.5)
        lost[scheme] = float(np.abs(q**2 + v**2 - 1.0).max())
    assert lost[Scheme.IMPLICIT_MIDPOINT] < 1e-13
    assert lost[Scheme.RADAU_IIA_2] > 0.1


@pytest.mark.parametrize("scheme", ORDERS)
def test_a_step_across_a_kink_is_wrong_by_no_more_than_its_bound(scheme: Scheme) -> None:
    """Two free discs meet after a part of the step.

    From then on their closing speed is c cos w (t - t_0), w^2 = k (1/m1 + 1/m2).
    """
    scene = load_scene("two_body_collision")
    kernel, nothing = load_kernel(scene), np.zeros((1, 0))
    q, v = np.array([scene.task.start[:2]]), np.array([scene.task.start[2:]])
    gap, closing = -float(kernel.penetration(q)[0, 0]), float(v[0, 0] - v[0, 1])
    response = kernel.acceleration(q, v, nothing, kernel.stiffness()[None]) - kernel.acceleration(
        q, v, nothing, np.zeros((1, 1))
    )
    w = float(np.sqrt(response[0, 1] - response[0, 0]))
    share = (
        -float(response[0, 0]) / w**2
    )  # of a change of the closing speed that is the left disc's
    h = 0.02 / w
    bound = tableau(scheme).switch_constant * h**2 * closing * float(np.abs(response).max())
    errors = []
    for part in np.linspace(0.02, 0.98, 49):
        start = q + v * (gap / closing - part * h)  # they touch after this part of the step
        end, after = advance(kernel, scheme, start, v, nothing, h)
        exact = v[0, 0] - share * closing * (1.0 - np.cos(w * (1.0 - part) * h))
        errors.append(abs(float(after[0, 0]) - exact))
        plan = Trajectory(
            t=np.array([0.0, h]),
            q=np.vstack([start, end]),
            v=np.vstack([v, after]),
            u=nothing,
            lam=np.zeros((1, 1)),
            scheme=scheme,
        )
        assert switch_error(kernel, plan) == pytest.approx(bound, rel=1e-3)
    assert 0.9 * bound < max(errors) < 1.01 * bound


@pytest.mark.parametrize("far", [1e20, 1e60, 1e100, 1e150, 1e160])
@pytest.mark.parametrize("scheme", ORDERS)
def test_a_step_without_a_solution_is_no_number_and_leaves_the_others_alone(
    scheme: Scheme, far: float
) -> None:
    """Of a diverging motion differences are lost in its size, or its squares have no number: once a singular matrix, or a mass matrix of nothing."""
    kernel, u = load_kernel(load_scene("cart_pole_walls")), np.zeros((2, 1))
    q, v = np.array([[0.0, 0.1], [far, 1.0]]), np.array([[0.0, 0.0], [far, far]])
    both, alone = (
        advance(kernel, scheme, q, v, u, 0.2),
        advance(kernel, scheme, q[:1], v[:1], u[:1], 0.2),
    )
    for found, own in zip(both, alone, strict=True):
        assert found[0].tobytes() == own[0].tobytes()
        assert np.isnan(found[1]).all()


@pytest.mark.parametrize("scheme", ORDERS)
def test_a_step_is_the_same_alone_and_beside_others(scheme: Scheme) -> None:
    """Rows that take longer, or have no solution, leave one that is found where it was: once it moved on, and some ended as no number."""
    kernel, random = load_kernel(load_scene("cart_pole_walls")), np.random.default_rng(5)
    q, v, u = (
        random.normal(size=(12, 2)),
        10.0 ** random.uniform(0, 6, size=(12, 1)) * random.normal(size=(12, 2)),
        random.normal(size=(12, 1)),
    )
    together = advance(kernel, scheme, q, v, u, 0.1)
    alone = [
        advance(kernel, scheme, *row, 0.1)
        for row in zip(q[:, None], v[:, None], u[:, None], strict=True)
    ]
    np.testing.assert_array_equal(together, np.concatenate(alone, axis=1))


def test_the_defect_is_that_of_the_plans_own_step() -> None:
    scene = load_scene("three_cart")
    kernel = load_kernel(scene)
    u = 8.0 * np.stack(
        [np.sin(np.linspace(0.0, 6.0, 50)), -np.sin(np.linspace(0.0, 6.0, 50))], axis=1
    )
    q, v, made = rollout(kernel, Scheme.RADAU_IIA_2, np.array(scene.task.start), u, 0.1)
    assert made == 50
    lam = kernel.contact_force(q[:-1])
    assert lam.max() > 1.0
    plan = Trajectory(t=uniform_grid(0.1, 50), q=q, v=v, u=u, lam=lam, scheme=Scheme.RADAU_IIA_2)
    assert defect(kernel, plan).max() < 1e-12
    other = Trajectory(t=plan.t, q=q, v=v, u=u, lam=lam, scheme=Scheme.IMPLICIT_MIDPOINT)
    assert defect(kernel, other).max() > 1e-4
    shifted = q.copy()
    shifted[20, 1] += 1e-5
    assert (
        defect(kernel, Trajectory(t=plan.t, q=shifted, v=v, u=u, lam=lam, scheme=plan.scheme)).max()
        >= 1e-5
    )


def test_friction_is_refused() -> None:
    scene = load_scene("transport")
    q, v = np.array([scene.task.start[: scene.nq]]), np.array([scene.task.start[scene.nq :]])
    with pytest.raises(KernelError, match="friction"):
        advance(load_kernel(scene), Scheme.RADAU_IIA_2, q, v, np.zeros((1, scene.nu)), 0.01)


def test_a_file_keeps_the_scheme(tmp_path: Path) -> None:
    plan = Trajectory(
        t=uniform_grid(0.5, 2),
        q=np.zeros((3, 1)),
        v=np.ones((3, 1)),
        u=np.zeros((2, 0)),
        lam=np.zeros((2, 0)),
        scheme=Scheme.RADAU_IIA_2,
    )
    write_netcdf(tmp_path / "plan.nc", plan, OSCILLATOR)
    assert read_netcdf(tmp_path / "plan.nc", OSCILLATOR).scheme is Scheme.RADAU_IIA_2
