"""Model Exchange: contact modes are frozen between events, and CVODE with root finding meets the closed forms."""

import numpy as np
import pytest
from fmpy import simulate_fmu
from sksundae.cvode import CVODE

from models.fmu import build_fmu


def integrate(me, end, rtol=1e-10, atol=1e-12):
    """From t = 0 to `end`, restarted at every root of a gap; returns the final state and the times of the events."""
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
        x, t = (solution.y_events[-1], float(solution.t_events[-1])) if located else (solution.y[-1], end)
        me.fmu.setTime(t)
        me.states = x
        if located:
            events.append(t)
            me.event()
    return me.states, events


def test_bouncing_mass_meets_its_closed_forms(scene_of, drive, constants):
    exact = constants("bouncing_mass")
    me = drive(scene_of("bouncing_mass"), "me").continuous()
    period = 2 * exact.FALL_TIME + exact.CONTACT_TIME
    state, events = integrate(me, period + exact.FALL_TIME / 2)
    np.testing.assert_allclose(events, [exact.FALL_TIME, exact.FALL_TIME + exact.CONTACT_TIME], rtol=0, atol=1e-8)
    fall = exact.FALL_TIME / 2
    np.testing.assert_allclose(state, [exact.DROP - exact.GRAVITY * fall**2 / 2, -exact.GRAVITY * fall], rtol=0, atol=1e-7)


def test_two_bodies_collide_as_the_closed_form_says(scene_of, drive, constants):
    exact = constants("two_body_collision")
    state, events = integrate(drive(scene_of("two_body_collision"), "me").continuous(), 0.5)
    np.testing.assert_allclose(events, [exact.FIRST_CONTACT, exact.FIRST_CONTACT + exact.CONTACT_TIME], rtol=0, atol=1e-8)
    np.testing.assert_allclose(state[2:], [exact.V1_AFTER, exact.V2_AFTER], rtol=0, atol=1e-7)


def test_model_exchange_and_co_simulation_agree(any_scene, drive):
    end = min(any_scene.task.horizon, 1.0)
    u = np.linspace(8.0, -5.0, any_scene.nu)
    me, cs = drive(any_scene, "me").continuous(u=u), drive(any_scene, "cs").initialise(u=u).run(end, 10)
    state, _ = integrate(me, end)
    np.testing.assert_allclose(state, cs.state(), rtol=0, atol=1e-6)


def test_modes_change_in_event_mode_only(scene_of, drive):
    """Between events lam = k phi (closed) or 0 (open) on both sides of the boundary; the gap itself is never frozen."""
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
    options = {"stop_time": 2.0, "output_interval": 0.01, "input": signal, "relative_tolerance": 1e-9}
    rows = [simulate_fmu(path, fmi_type=kind, **options)[-1] for kind in ("ModelExchange", "CoSimulation")]
    assert rows[0]["time"] == rows[1]["time"] == 2.0
    np.testing.assert_allclose(list(rows[0]), list(rows[1]), rtol=0, atol=1e-5)
    assert rows[1]["q2"] != 3.0
