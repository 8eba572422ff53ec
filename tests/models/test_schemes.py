"""Collocation steps against closed forms: order, energy, the kink of a contact, and what a plan made of them is judged by."""

from pathlib import Path

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import KernelError, load_kernel
from models.collocation import advance, defect, rollout, switch_error
from models.errors import TrajectoryError
from models.schemes import Scheme, tableau
from models.trajectory import Hold, Trajectory, uniform_grid
from models.trajectory_netcdf import read_netcdf, write_netcdf

OSCILLATOR = load_scene(str(Path(__file__).parents[1] / "scenes" / "oscillator.py"))
COLLOCATIONS = (Scheme.IMPLICIT_MIDPOINT, Scheme.RADAU_IIA_2, Scheme.RADAU_IIA_3)
NOTHING = np.zeros((1, 0))


@pytest.mark.parametrize("scheme", COLLOCATIONS)
def test_the_tableau_integrates_what_its_order_promises(scheme: Scheme) -> None:
    """B(order): sum b_i c_i^(p-1) = 1/p; C(stages): sum_j a_ij c_j^(p-1) = c_i^p/p."""
    table = tableau(scheme)
    for p in range(1, table.order + 1):
        assert table.b @ table.c ** (p - 1) == pytest.approx(1.0 / p, abs=1e-14)
    assert abs(table.b @ table.c**table.order - 1.0 / (table.order + 1)) > 1e-4
    for p in range(1, table.stages + 1):
        np.testing.assert_allclose(table.a @ table.c ** (p - 1), table.c**p / p, atol=1e-14)
    assert table.is_stiffly_accurate == (scheme is not Scheme.IMPLICIT_MIDPOINT)


@pytest.mark.parametrize("scheme", COLLOCATIONS)
def test_the_switch_constant_is_the_largest_error_of_a_kink(scheme: Scheme) -> None:
    table = tableau(scheme)
    z = np.linspace(0.0, 1.0, 20_001)
    error = np.abs((1.0 - z) ** 2 / 2.0 - np.maximum(table.c - z[:, None], 0.0) @ table.b)
    assert table.switch_constant >= error.max() - 1e-15
    assert table.switch_constant == pytest.approx(error.max(), rel=1e-3)


@pytest.mark.parametrize("scheme", COLLOCATIONS)
def test_the_order_on_a_free_oscillator(scheme: Scheme) -> None:
    """q = cos t: the slope of log error over log step."""
    kernel, errors = load_kernel(OSCILLATOR), []
    for steps in (8, 16):
        q, v, made = rollout(kernel, scheme, np.array([1.0, 0.0]), np.zeros((steps, 0)), 2.0 / steps)
        assert made == steps
        errors.append(np.hypot(q[-1, 0] - np.cos(2.0), v[-1, 0] + np.sin(2.0)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(tableau(scheme).order, abs=0.1)


def test_the_midpoint_keeps_the_energy_and_radau_loses_some() -> None:
    kernel, lost = load_kernel(OSCILLATOR), {}
    for scheme in COLLOCATIONS:
        q, v, _ = rollout(kernel, scheme, np.array([1.0, 0.0]), np.zeros((200, 0)), 0.5)
        lost[scheme] = float(np.abs(q**2 + v**2 - 1.0).max())
    assert lost[Scheme.IMPLICIT_MIDPOINT] < 1e-13
    assert lost[Scheme.RADAU_IIA_2] > 0.1


@pytest.mark.parametrize("scheme", COLLOCATIONS)
def test_a_step_across_a_kink_is_wrong_by_no_more_than_its_bound(scheme: Scheme) -> None:
    """Two free discs meet after a part of the step; from then on their closing speed is c cos w (t - t_0), w^2 = k (1/m1 + 1/m2)."""
    scene = load_scene("two_body_collision")
    kernel, nothing = load_kernel(scene), np.zeros((1, 0))
    q, v = np.array([scene.task.start[:2]]), np.array([scene.task.start[2:]])
    gap, closing = -float(kernel.penetration(q)[0, 0]), float(v[0, 0] - v[0, 1])
    response = kernel.acceleration(q, v, nothing, kernel.stiffness()[None]) - kernel.acceleration(q, v, nothing, np.zeros((1, 1)))
    w = float(np.sqrt(response[0, 1] - response[0, 0]))
    share = -float(response[0, 0]) / w**2  # of a change of the closing speed that is the left disc's
    h = 0.02 / w
    bound = tableau(scheme).switch_constant * h**2 * closing * float(np.abs(response).max())
    errors = []
    for part in np.linspace(0.02, 0.98, 49):
        start = q + v * (gap / closing - part * h)  # they touch after this part of the step
        end, after = advance(kernel, scheme, start, v, nothing, h)
        exact = v[0, 0] - share * closing * (1.0 - np.cos(w * (1.0 - part) * h))
        errors.append(abs(float(after[0, 0]) - exact))
        plan = Trajectory(
            t=np.array([0.0, h]), q=np.vstack([start, end]), v=np.vstack([v, after]), u=nothing, lam=np.zeros((1, 1)), scheme=scheme
        )
        assert switch_error(kernel, plan) == pytest.approx(bound, rel=1e-3)
    assert 0.9 * bound < max(errors) < 1.01 * bound


def test_the_defect_is_that_of_the_plans_own_step() -> None:
    scene = load_scene("three_cart")
    kernel = load_kernel(scene)
    u = 8.0 * np.stack([np.sin(np.linspace(0.0, 6.0, 50)), -np.sin(np.linspace(0.0, 6.0, 50))], axis=1)
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
    assert defect(kernel, Trajectory(t=plan.t, q=shifted, v=v, u=u, lam=lam, scheme=plan.scheme)).max() >= 1e-5


def test_friction_is_refused_and_so_is_a_hold_that_a_step_does_not_have() -> None:
    scene = load_scene("transport")
    q, v = np.array([scene.task.start[: scene.nq]]), np.array([scene.task.start[scene.nq :]])
    with pytest.raises(KernelError, match="friction"):
        advance(load_kernel(scene), Scheme.RADAU_IIA_2, q, v, np.zeros((1, scene.nu)), 0.01)
    with pytest.raises(TrajectoryError, match=r"holds its inputs.*hold is linear"):
        Trajectory(
            t=np.array([0.0, 1.0]), q=np.zeros((2, 1)), v=np.zeros((2, 1)), u=NOTHING, lam=NOTHING, hold=Hold.LINEAR,
            scheme=Scheme.RADAU_IIA_3,
        )  # fmt: skip


def test_a_file_keeps_the_scheme(tmp_path: Path) -> None:
    plan = Trajectory(
        t=uniform_grid(0.5, 2), q=np.zeros((3, 1)), v=np.ones((3, 1)), u=np.zeros((2, 0)), lam=np.zeros((2, 0)), scheme=Scheme.RADAU_IIA_3
    )
    write_netcdf(tmp_path / "plan.nc", plan, OSCILLATOR)
    assert read_netcdf(tmp_path / "plan.nc", OSCILLATOR).scheme is Scheme.RADAU_IIA_3
