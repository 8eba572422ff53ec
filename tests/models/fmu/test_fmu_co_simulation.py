"""Co-Simulation and Model Exchange: closed forms, measured orders, also through contact, the plans' own time step, inputs, modes that are frozen between events, steps that are refused."""

import math

import numpy as np
import pytest
from fmpy import simulate_fmu
from sksundae.cvode import CVODE

from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.fmu.variables import INTEGRATORS
from validate.truth.exact_motion import Equations, Piece, true_motion


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
    assert (v1, v2) == (
        pytest.approx(exact.V1_AFTER, abs=1e-9),
        pytest.approx(exact.V2_AFTER, abs=1e-9),
    )
    assert exact.MASS_1 * v1 + exact.MASS_2 * v2 == pytest.approx(
        exact.MASS_1 * exact.START[2] + exact.MASS_2 * exact.START[3], abs=1e-12
    )
    assert cs.get("lam_pair", "contact_energy").tolist() == [0.0, 0.0]


def test_energy_is_kept_while_bouncing(scene_of, drive):
    cs = drive(scene_of("bouncing_mass"), "cs").initialise()
    names = (cs.names.kinetic_energy, cs.names.potential_energy, cs.names.contact_energy)
    first = cs.get(*names).sum()
    for n in range(300):
        cs.fmu.doStep(n * 0.01, 0.01)
        assert cs.get(*names).sum() == pytest.approx(first, rel=1e-9)


@pytest.mark.parametrize(("place", "speed"), [(2.49, 0.3), (2.5, 0.1)])
def test_contact_that_opens_and_closes_within_one_internal_step_is_found(
    scene_of, drive, place, speed
):
    """A cart is pulled back as it touches the next one, for a third of an internal step: the gap is open at both ends of it. Or it touches at t = 0."""
    scene = scene_of("three_cart")
    start = {"q": [place, 3.0, 4.0], "v": [speed, 0.0, 0.0], "u": [-4.0, 0.0], "c": 0.0}
    once, often = (
        drive(scene, "cs").initialise(**start, internal_step=step).run(0.15, 1)
        for step in (0.15, 1e-4)
    )
    assert often.get("gap_left")[0] > 0
    assert often.get("v2")[0] > 5e-4
    assert once.get("v2")[0] == pytest.approx(often.get("v2")[0], rel=0.02)


def test_far_from_the_origin_rounding_does_not_trap_the_switch_location(scene_of, drive):
    """At 1e7 m a gap is known to 2e-9 m only, far more than the hysteresis: the motion is right to that rounding."""
    scene = scene_of("three_cart")
    near, far = (
        drive(scene, "cs").initialise(q=np.array([2.0, 3.0, 4.0]) + x, u=[8.0, -5.0])
        for x in (0.0, 1e7)
    )
    for n in range(300):
        near.fmu.doStep(n * 0.01, 0.01)
        far.fmu.doStep(n * 0.01, 0.01)
        np.testing.assert_allclose(
            far.get("gap_left", "gap_right", "v1", "v2"),
            near.get("gap_left", "gap_right", "v1", "v2"),
            rtol=0,
            atol=2e-5,
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
    states = [
        drive(scene, "cs").initialise(u=[8.0, -5.0]).run(1.5, steps).state()
        for steps in (5, 15, 150)
    ]
    np.testing.assert_allclose(states[1:], [states[0]] * 2, rtol=0, atol=1e-11)


def test_input_derivatives_are_followed_within_the_step_and_end_with_it(scene_of, drive):
    """A free cart under u = a + b t: v = a t + b t^2/2, q = a t^2/2 + b t^3/6."""
    scene = scene_of("three_cart")
    a, b, dt = 2.0, -3.0, 0.25
    cs = drive(scene, "cs").initialise(u=[a, 0.0], c=0.0)
    cs.fmu.setRealInputDerivatives(cs.vr(["u1"]), [1], [b])
    cs.fmu.doStep(0.0, dt)
    speed = a * dt + b * dt**2 / 2
    np.testing.assert_allclose(
        cs.get("q1", "v1", "u1"),
        [2 + a * dt**2 / 2 + b * dt**3 / 6, speed, a + b * dt],
        rtol=0,
        atol=1e-13,
    )
    cs.set(u1=0.0)
    cs.fmu.doStep(dt, dt)
    assert cs.get("v1")[0] == pytest.approx(speed, abs=1e-13)
    cs.refused(lambda: cs.fmu.setRealInputDerivatives(cs.vr(["u1"]), [2], [b]), "order 2", "u1")
    cs.refused(
        lambda: cs.fmu.setRealInputDerivatives(cs.vr(["q1"]), [1], [b]), "q1", "not an input"
    )


def test_output_derivatives_are_rates(any_scene, drive):
    rng = np.random.default_rng(5)
    cs = drive(any_scene, "cs").initialise(
        v=rng.standard_normal(any_scene.nq), u=rng.standard_normal(any_scene.nu)
    )
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


def integrate(me, end, rtol=1e-10, atol=1e-12):
    """From t = 0 to `end`, restarted at every root of a gap.

    Returns the final state and the times of the events.
    """
    me.fmu.setTime(0.0)
    t, events = 0.0, []

    def rate(t, x, dx):
        me.fmu.setTime(t)
        me.states = x
        dx[:] = me.derivatives

    def gaps(t, x, out):
        me.states = x
        out[:] = me.indicators

    if me.scene.nc:
        gaps.terminal = [True] * me.scene.nc
        gaps.direction = [0] * me.scene.nc
    options = {"eventsfn": gaps, "num_events": me.scene.nc} if me.scene.nc else {}
    while t < end:
        solver = CVODE(rate, rtol=rtol, atol=atol, **options)
        solution = solver.solve(np.array([t, end]), me.states)
        located = solution.t_events is not None and len(solution.t_events) > 0
        x, t = (
            (solution.y_events[-1], float(solution.t_events[-1]))
            if located
            else (solution.y[-1], end)
        )
        me.fmu.setTime(t)
        me.states = x
        if located:
            events.append(t)
            me.event()
    return me.states, events


def test_bouncing_mass_meets_its_closed_forms_exchange(scene_of, drive, constants):
    exact = constants("bouncing_mass")
    me = drive(scene_of("bouncing_mass"), "me").continuous()
    period = 2 * exact.FALL_TIME + exact.CONTACT_TIME
    state, events = integrate(me, period + exact.FALL_TIME / 2)
    np.testing.assert_allclose(
        events, [exact.FALL_TIME, exact.FALL_TIME + exact.CONTACT_TIME], rtol=0, atol=1e-8
    )
    fall = exact.FALL_TIME / 2
    np.testing.assert_allclose(
        state, [exact.DROP - exact.GRAVITY * fall**2 / 2, -exact.GRAVITY * fall], rtol=0, atol=1e-7
    )


def test_two_bodies_collide_as_the_closed_form_says(scene_of, drive, constants):
    exact = constants("two_body_collision")
    state, events = integrate(drive(scene_of("two_body_collision"), "me").continuous(), 0.5)
    np.testing.assert_allclose(
        events, [exact.FIRST_CONTACT, exact.FIRST_CONTACT + exact.CONTACT_TIME], rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(state[2:], [exact.V1_AFTER, exact.V2_AFTER], rtol=0, atol=1e-7)


def test_model_exchange_and_co_simulation_agree(any_scene, drive):
    end = min(any_scene.task.horizon, 1.0)
    u = np.linspace(8.0, -5.0, any_scene.nu)
    me, cs = (
        drive(any_scene, "me").continuous(u=u),
        drive(any_scene, "cs").initialise(u=u).run(end, 10),
    )
    state, _ = integrate(me, end)
    np.testing.assert_allclose(state, cs.state(), rtol=0, atol=1e-6)


def test_modes_change_in_event_mode_only(scene_of, drive):
    """Between events lam = k phi (closed) or 0 (open) on both sides of the boundary.

    The gap itself is never frozen.
    """
    me = drive(scene_of("bouncing_mass"), "me").continuous(q=[0.1])
    assert me.get("lam_floor")[0] == 0.0
    me.states = np.array([-0.02, -1.0])
    assert me.get("lam_floor", "contact_energy").tolist() == [0.0, 0.0]
    assert me.indicators.tolist() == [-0.02]
    assert me.derivatives[1] == pytest.approx(-9.81)
    me.event()
    assert me.get("lam_floor", "contact_energy") == pytest.approx([20.0, 0.2])
    me.states = np.array([0.01, 1.0])
    assert me.get("lam_floor")[0] == pytest.approx(-10.0)
    assert me.directional(("der(v)",), ("q",), np.ones(1))[0] == pytest.approx(-1000.0)
    me.event()
    assert me.get("lam_floor")[0] == 0.0
    assert me.directional(("der(v)",), ("q",), np.ones(1))[0] == 0.0


@pytest.mark.parametrize(("before", "gap", "speed", "after"), [
    ("open", 1e-15, -1.0, True),  # located a hair before the boundary, closing
    ("open", -1e-15, -1.0, True),
    ("closed", -1e-15, 1.0, False),  # located a hair before the boundary, opening
    ("closed", 1e-15, 1.0, False),
    ("open", -1e-15, 0.0, False),  # at rest on the boundary: as it was
    ("closed", 1e-15, 0.0, True),
    ("open", -1e-6, 1.0, True),  # clearly inside: the true law, whatever the direction
    ("closed", 1e-6, -1.0, False),
])  # fmt: skip
def test_hysteresis_at_the_boundary_follows_the_motion(scene_of, drive, before, gap, speed, after):
    me = drive(scene_of("bouncing_mass"), "me").continuous(q=[0.1 if before == "open" else -0.1])
    me.states = np.array([gap, speed])
    me.event()
    slope = me.directional(("lam_floor",), ("q",), np.ones(1))[0]
    assert (slope != 0) == after


def test_importer_that_locates_no_roots_still_gets_the_modes(scene_of, drive):
    """completedIntegratorStep asks for event mode once a contact is on the wrong side of its mode."""
    me = drive(scene_of("bouncing_mass"), "me").continuous(q=[0.1])
    assert me.fmu.completedIntegratorStep() == (False, False)
    me.states = np.array([-0.02, -1.0])
    assert me.fmu.completedIntegratorStep() == (True, False)
    me.event()
    assert me.fmu.completedIntegratorStep() == (False, False)


def test_event_information_promises_nothing(scene_of, drive):
    me = drive(scene_of("three_cart"), "me").initialise()
    assert me.fmu.newDiscreteStates() == (False, False, False, False, False, 0.0)


def test_stock_importer_simulates_both_types(scene_of):
    """FMPy's own simulation, with inputs that are constant between doubled time samples."""
    path = str(build_fmu(scene_of("three_cart")))
    samples = [(0.0, 8.0, -5.0), (1.0, 8.0, -5.0), (1.0, -2.0, 0.0), (2.0, -2.0, 0.0)]
    signal = np.array(samples, dtype=[("time", float), ("u1", float), ("u3", float)])
    options = {
        "stop_time": 2.0,
        "output_interval": 0.01,
        "input": signal,
        "relative_tolerance": 1e-9,
    }
    rows = [
        simulate_fmu(path, fmi_type=kind, **options)[-1]
        for kind in ("ModelExchange", "CoSimulation")
    ]
    assert rows[0]["time"] == rows[1]["time"] == 2.0
    np.testing.assert_allclose(list(rows[0]), list(rows[1]), rtol=0, atol=1e-5)
    assert rows[1]["q2"] != 3.0


NUMBER = {name: number for number, (name, _) in enumerate(INTEGRATORS, start=1)}
ORDERS = {"explicit_euler": 1, "semi_implicit_euler": 1, "heun": 2, "runge_kutta": 4}


def chosen(driver, name, **values):
    """Initialise with this integrator; FMI 2.0 and 3.0 set an enumeration by different calls."""
    (driver.fmu.setInteger if hasattr(driver.fmu, "setInteger") else driver.fmu.setInt64)(
        driver.vr(["integrator"]), [NUMBER[name]]
    )
    return driver.initialise(**values)


# scene, start, inputs, end [s], and the coarsest internal step of the fourth order [s]
THROUGH_CONTACT = (
    "three_cart",
    (2.0, 3.0, 4.0, 0.0, 0.0, 0.0),
    [8.0, -5.0],
    1.5,
    0.03,
)  # two of them
SMOOTH = ("oscillator", (1.0, 0.0), [], 2.0, 0.03)
TURNING = ("two_link_arm", (1.4, -0.3, 0.0, 0.0), [3.0, -1.0], 0.3, 0.015)  # M depends on q
AT_A_WALL = ("two_link_arm", (1.0, -0.3, -0.5, 0.0), [3.0, -1.0], 0.5, 0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "motion"),
    [
        *((name, motion) for name in ORDERS for motion in (SMOOTH, THROUGH_CONTACT)),
        ("runge_kutta", TURNING),
        ("runge_kutta", AT_A_WALL),
    ],
)
def test_order(scene_of, drive, name, motion):
    scene, start, u, end, coarsest = motion
    scene = scene_of(scene).with_task(start=start)
    want = true_motion(Equations(scene), [Piece(end, np.array(u))], np.array([end]))[0]
    steps = (1e-3 if ORDERS[name] == 1 else coarsest) / 2.0 ** np.arange(4)
    q, v = np.split(np.array(start), 2)
    errors = [
        np.abs(
            chosen(drive(scene, "cs"), name, q=q, v=v, u=u, internal_step=step).run(end, 5).state()
            - want
        ).max()
        for step in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope - ORDERS[name]) < 0.25, (slope, errors)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    "name",
    [
        "three_cart",
        "bouncing_mass",
        "two_body_collision",
        "two_link_arm",
        "oscillator",
        "damped_arm",
        "damped_collision",
    ],
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
        np.testing.assert_allclose(
            cs.state(), [*want.q[n + 1], *want.v[n + 1]], rtol=1e-12, atol=1e-12
        )


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
