"""Co-Simulation: closed forms, order of convergence (also through contact), inputs, steps that are refused."""

import math

import numpy as np
import pytest


def test_bouncing_mass_meets_its_closed_forms(scene_of, drive, constants):
    scene, exact = scene_of("bouncing_mass"), constants("bouncing_mass")
    deepest = exact.FALL_TIME + exact.CONTACT_TIME / 2
    for time, height, speed in (
        (exact.FALL_TIME, 0.0, -exact.SPEED),
        (deepest, -exact.DEPTH, 0.0),
        (exact.FALL_TIME + exact.CONTACT_TIME, 0.0, exact.SPEED),
        (2 * exact.FALL_TIME + exact.CONTACT_TIME, exact.DROP, 0.0),
    ):
        cs = drive(scene, "cs").initialise().run(time, 7)
        np.testing.assert_allclose(cs.state(), [height, speed], rtol=0, atol=1e-9)


def test_two_bodies_exchange_momentum_as_the_closed_form_says(scene_of, drive, constants):
    scene, exact = scene_of("two_body_collision"), constants("two_body_collision")
    cs = drive(scene, "cs").initialise()
    cs.run(exact.FIRST_CONTACT + exact.CONTACT_TIME / 2, 3)
    assert -cs.get("gap_pair")[0] == pytest.approx(exact.COMPRESSION, abs=1e-9)
    v1, v2 = cs.get("v1", "v2")
    assert v1 == pytest.approx(v2, abs=1e-8)
    cs.run(0.5, 3, start=exact.FIRST_CONTACT + exact.CONTACT_TIME / 2)
    v1, v2 = cs.get("v1", "v2")
    assert (v1, v2) == (pytest.approx(exact.V1_AFTER, abs=1e-9), pytest.approx(exact.V2_AFTER, abs=1e-9))
    assert exact.MASS_1 * v1 + exact.MASS_2 * v2 == pytest.approx(exact.MASS_1 * exact.START[2] + exact.MASS_2 * exact.START[3], abs=1e-12)
    assert cs.get("lam_pair", "contact_energy").tolist() == [0.0, 0.0]


def test_energy_is_kept_while_bouncing(scene_of, drive):
    cs = drive(scene_of("bouncing_mass"), "cs").initialise()
    names = (cs.names.kinetic_energy, cs.names.potential_energy, cs.names.contact_energy)
    first = cs.get(*names).sum()
    for n in range(300):
        cs.fmu.doStep(n * 0.01, 0.01)
        assert cs.get(*names).sum() == pytest.approx(first, rel=1e-9)


@pytest.mark.parametrize(("place", "speed"), [(2.49, 0.3), (2.5, 0.1)])
def test_contact_that_opens_and_closes_within_one_internal_step_is_found(scene_of, drive, place, speed):
    """A cart is pulled back as it touches the next one, for a third of an internal step: the gap is open at both ends of it. Or it touches at t = 0."""
    scene = scene_of("three_cart")
    start = {"q": [place, 3.0, 4.0], "v": [speed, 0.0, 0.0], "u": [-4.0, 0.0], "c": 0.0}
    once, often = (drive(scene, "cs").initialise(**start, internal_step=step).run(0.15, 1) for step in (0.15, 1e-4))
    assert often.get("gap_left")[0] > 0
    assert often.get("v2")[0] > 5e-4
    assert once.get("v2")[0] == pytest.approx(often.get("v2")[0], rel=0.02)


def test_far_from_the_origin_rounding_does_not_trap_the_switch_location(scene_of, drive):
    """At 1e7 m a gap is known to 2e-9 m only, far more than the hysteresis: the motion is right to that rounding."""
    scene = scene_of("three_cart")
    near, far = (drive(scene, "cs").initialise(q=np.array([2.0, 3.0, 4.0]) + x, u=[8.0, -5.0]) for x in (0.0, 1e7))
    for n in range(300):
        near.fmu.doStep(n * 0.01, 0.01)
        far.fmu.doStep(n * 0.01, 0.01)
        np.testing.assert_allclose(
            far.get("gap_left", "gap_right", "v1", "v2"), near.get("gap_left", "gap_right", "v1", "v2"), rtol=0, atol=2e-5
        )


def test_symmetric_carts_stay_symmetric(scene_of, drive):
    cs = drive(scene_of("three_cart"), "cs").initialise(u=[5.0, -5.0])
    for n in range(200):
        cs.fmu.doStep(n * 0.01, 0.01)
        q1, q2, q3, v1, v2, v3 = cs.state()
        np.testing.assert_allclose([q1 + q3 - 6, q2 - 3, v1 + v3, v2], 0.0, rtol=0, atol=1e-12)


def test_communication_step_does_not_change_the_motion(scene_of, drive):
    """With internal steps that fit, 5 or 50 communication steps are the same integration to rounding."""
    scene = scene_of("three_cart")
    states = [drive(scene, "cs").initialise(u=[8.0, -5.0]).run(1.5, steps).state() for steps in (5, 15, 150)]
    np.testing.assert_allclose(states[1:], [states[0]] * 2, rtol=0, atol=1e-11)


def test_input_derivatives_are_followed_within_the_step_and_end_with_it(scene_of, drive):
    """A free cart under u = a + b t: v = a t + b t^2/2, q = a t^2/2 + b t^3/6."""
    scene = scene_of("three_cart")
    a, b, dt = 2.0, -3.0, 0.25
    cs = drive(scene, "cs").initialise(u=[a, 0.0], c=0.0)
    cs.fmu.setRealInputDerivatives(cs.vr(["u1"]), [1], [b])
    cs.fmu.doStep(0.0, dt)
    speed = a * dt + b * dt**2 / 2
    np.testing.assert_allclose(cs.get("q1", "v1", "u1"), [2 + a * dt**2 / 2 + b * dt**3 / 6, speed, a + b * dt], rtol=0, atol=1e-13)
    cs.set(u1=0.0)
    cs.fmu.doStep(dt, dt)
    assert cs.get("v1")[0] == pytest.approx(speed, abs=1e-13)
    cs.refused(lambda: cs.fmu.setRealInputDerivatives(cs.vr(["u1"]), [2], [b]), "order 2", "u1")
    cs.refused(lambda: cs.fmu.setRealInputDerivatives(cs.vr(["q1"]), [1], [b]), "q1", "not an input")


def test_output_derivatives_are_rates(any_scene, drive):
    rng = np.random.default_rng(5)
    cs = drive(any_scene, "cs").initialise(v=rng.standard_normal(any_scene.nq), u=rng.standard_normal(any_scene.nu))
    names = (*cs.names.q, *cs.names.v, cs.names.kinetic_energy)
    rates = np.array(cs.fmu.getRealOutputDerivatives(cs.vr(names), [1] * len(names)))
    before = cs.get(*names)
    step = 1e-6
    cs.fmu.doStep(0.0, step)
    np.testing.assert_allclose((cs.get(*names) - before) / step, rates, rtol=1e-4, atol=1e-4)
    assert rates[: any_scene.nq].tolist() == before[any_scene.nq : 2 * any_scene.nq].tolist()


def test_steps_that_cannot_be_meant_are_refused(scene_of, drive):
    cs = drive(scene_of("three_cart"), "cs").initialise(stop=1.0)
    step = cs.fmu.doStep
    before = cs.state()
    cs.refused(lambda: step(0.0, -0.1), "negative")
    cs.refused(lambda: step(0.0, math.nan), "finite")
    cs.refused(lambda: step(math.nan, 0.1), "finite")
    cs.refused(lambda: step(0.5, 0.1), "0.5 s", "0 s")
    cs.refused(lambda: step(0.0, 1.5), "stop time", "1.5")
    np.testing.assert_array_equal(cs.state(), before)
    step(0.0, 0.0)
    step(0.0, 1.0)
    assert cs.get("time")[0] == 1.0
    cs.refused(lambda: step(1.0, 0.1), "stop time")
    cs.set(internal_step=1e-9)
    long = drive(scene_of("three_cart"), "cs").initialise(internal_step=1e-9)
    long.refused(lambda: long.fmu.doStep(0.0, 2.0), "internal_step")


def test_divergence_is_an_error_that_keeps_the_last_good_state(scene_of, drive):
    """Internal steps far beyond the stability limit: the stiff contact blows up, which is told, not passed on as NaN."""
    cs = drive(scene_of("three_cart"), "cs").initialise(q=[2.6, 3.0, 4.0], internal_step=1e90)
    cs.refused(lambda: cs.fmu.doStep(0.0, 1e90), "internal_step too large")
    np.testing.assert_array_equal(cs.get("time", "q1"), [0.0, 2.6])
    cs.refused(lambda: cs.fmu.doStep(0.0, 0.01), "'error'")
    cs.fmu.reset()
    cs.initialise().run(1.0, 100)
    assert np.isfinite(cs.state()).all()
