"""The methods of Co-Simulation: measured orders, also through contact, and the plans' own time step."""

import numpy as np
import pytest

from models.codegen.kernel import load_kernel
from models.fmu.reference import Equations, Piece, true_motion
from models.fmu.variables import INTEGRATORS

NUMBER = {name: number for number, (name, _) in enumerate(INTEGRATORS, start=1)}
ORDERS = {"explicit_euler": 1, "semi_implicit_euler": 1, "heun": 2, "runge_kutta": 4}


def chosen(driver, name, **values):
    """Initialise with this integrator; FMI 2.0 and 3.0 set an enumeration by different calls."""
    (driver.fmu.setInteger if hasattr(driver.fmu, "setInteger") else driver.fmu.setInt64)(driver.vr(["integrator"]), [NUMBER[name]])
    return driver.initialise(**values)


# scene, start, inputs, end [s], and the coarsest internal step of the fourth order [s]
THROUGH_CONTACT = ("three_cart", (2.0, 3.0, 4.0, 0.0, 0.0, 0.0), [8.0, -5.0], 1.5, 0.03)  # two of them
SMOOTH = ("oscillator", (1.0, 0.0), [], 2.0, 0.03)
TURNING = ("two_link_arm", (1.4, -0.3, 0.0, 0.0), [3.0, -1.0], 0.3, 0.015)  # M depends on q
AT_A_WALL = ("two_link_arm", (1.0, -0.3, -0.5, 0.0), [3.0, -1.0], 0.5, 0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "motion"),
    [*((name, motion) for name in ORDERS for motion in (SMOOTH, THROUGH_CONTACT)), ("runge_kutta", TURNING), ("runge_kutta", AT_A_WALL)],
)
def test_order(scene_of, drive, name, motion):
    scene, start, u, end, coarsest = motion
    scene = scene_of(scene).with_task(start=start)
    want = true_motion(Equations(scene), [Piece(end, np.array(u))], np.array([end]))[0][0]
    steps = (1e-3 if ORDERS[name] == 1 else coarsest) / 2.0 ** np.arange(4)
    q, v = np.split(np.array(start), 2)
    errors = [
        np.abs(chosen(drive(scene, "cs"), name, q=q, v=v, u=u, internal_step=step).run(end, 5).state() - want).max() for step in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope - ORDERS[name]) < 0.25, (slope, errors)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    "name", ["three_cart", "bouncing_mass", "two_body_collision", "two_link_arm", "oscillator", "damped_arm", "damped_collision"]
)
def test_semi_implicit_euler_is_the_time_step_of_the_plans(scene_of, drive, name, version):
    """One internal step a plan step gives the kernel's rollout, contacts and dampers included."""
    scene = scene_of(name)
    step, count = scene.task.step, min(scene.task.steps, 600) if scene.damped else 150
    rng = np.random.default_rng(2)
    u = 6 * rng.standard_normal((count, scene.nu))
    want = load_kernel(scene).rollout(np.array(scene.task.start), u, step)
    cs = chosen(drive(scene, "cs", version), "semi_implicit_euler", internal_step=step)
    for n in range(count):
        cs.set_all(cs.names.u, u[n])
        cs.fmu.doStep(n * step, step)
        np.testing.assert_allclose(cs.state(), [*want.q[n + 1], *want.v[n + 1]], rtol=1e-12, atol=1e-12)


def test_integrator_is_checked(scene_of, drive):
    cs = drive(scene_of("three_cart"), "cs")
    reference = cs.vr(["integrator"])
    cs.refused(lambda: cs.fmu.setInteger(reference, [0]), "range [1, 4]", "integrator")
    cs.refused(lambda: cs.fmu.setInteger(reference, [5]), "range [1, 4]")
    cs.refused(lambda: cs.fmu.setInteger(cs.vr(["q1"]), [1]), "q1", "real")
    cs.refused(lambda: cs.fmu.setReal(reference, [1.0]), "enumeration")
    cs.initialise()
    assert cs.fmu.getInteger(reference) == [4]
    cs.fmu.setInteger(reference, [3])  # tunable: also between two steps
    cs.run(0.1, 1)
    assert cs.fmu.getInteger(reference) == [3]
