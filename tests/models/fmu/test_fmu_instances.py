"""Instances: saved states, reset, independence, calls that come at the wrong time or with wrong arguments. FMI 3.0 Co-Simulation: early return and event mode at contacts, intermediate update."""

import ctypes
import math

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import fmi2FMUstate


def everything(driver):
    """The bytes of the whole state."""
    state = driver.fmu.getFMUstate()
    data = driver.fmu.serializeFMUstate(state)
    driver.fmu.freeFMUstate(state)
    return data


def drive_on(driver, start):
    """Thirty steps with changing inputs; returns the trace of all outputs."""
    rows = []
    for n in range(30):
        if driver.names.u:
            driver.set_all(driver.names.u, 6.0 * np.cos(n + np.arange(len(driver.names.u))))
        driver.fmu.doStep(start + n * 0.01, 0.01)
        rows.append(
            driver.get(
                *driver.names.q, *driver.names.v, *driver.names.lam, driver.names.kinetic_energy
            )
        )
    return np.array(rows)


def test_serialised_state_carries_over_to_another_instance(any_scene, drive):
    one, other = drive(any_scene, "cs").initialise(), drive(any_scene, "cs")
    drive_on(one, 0.0)
    data = everything(one)
    state = other.fmu.deSerializeFMUstate(data)
    other.fmu.setFMUstate(state)
    assert everything(other) == data
    np.testing.assert_array_equal(drive_on(other, 0.3), drive_on(one, 0.3))
    other.refused(lambda: other.fmu.deSerializeFMUstate(data[:-1]), "not a state of this model")
    other.refused(
        lambda: other.fmu.deSerializeFMUstate(b"x" * len(data)), "not a state of this model"
    )
    assert everything(other) == everything(one)
    other.fmu.freeFMUstate(state)


def test_state_of_one_fmu_type_is_refused_by_the_other(scene_of, drive):
    scene = scene_of("three_cart")
    cs, me = drive(scene, "cs").initialise(), drive(scene, "me").continuous()
    state = me.fmu.deSerializeFMUstate(everything(cs))
    me.refused(lambda: me.fmu.setFMUstate(state), "other FMU type")
    me.fmu.freeFMUstate(state)
    state = cs.fmu.deSerializeFMUstate(everything(me))
    cs.refused(lambda: cs.fmu.setFMUstate(state), "other FMU type")
    cs.refused(lambda: cs.fmu.setFMUstate(fmi2FMUstate()), "missing")


def test_wrong_guid_name_or_callbacks_give_no_instance(scene_of, drive, unpacked):
    scene = scene_of("three_cart")
    with pytest.raises(Exception, match="Failed to instantiate"):
        drive(scene, "cs", guid="{0000}")
    good = drive(scene, "cs")
    fmu, guid, callbacks = good.fmu, good.description.guid.encode(), ctypes.byref(good._callbacks)
    for name, kind, given, functions, words in (
        (b"x", 1, b"{0000}", callbacks, "GUID"),
        (b"x", 1, None, callbacks, "GUID"),
        (b"", 1, guid, callbacks, "instance name"),
        (None, 1, guid, callbacks, "instance name"),
        (b"x", 7, guid, callbacks, "FMU type 7"),
        (b"x", 1, guid, None, None),
    ):
        count = len(good.log)
        assert fmu.fmi2Instantiate(name, kind, given, b"", functions, 0, 0) is None
        assert len(good.log) == count + (words is not None)
        assert words is None or words in good.log[-1][2]


def test_calls_in_the_wrong_state_are_refused_in_words(scene_of, drive):
    scene = scene_of("three_cart")
    cs = drive(scene, "cs")
    fmu = cs.fmu
    cs.refused(lambda: cs.get("q1"), "fmi2GetReal", "'instantiated'")
    cs.refused(lambda: fmu.doStep(0.0, 0.1), "fmi2DoStep", "'instantiated'")
    cs.refused(fmu.exitInitializationMode, "fmi2ExitInitializationMode")
    cs.refused(fmu.terminate, "fmi2Terminate")
    cs.refused(lambda: fmu.setupExperiment(startTime=math.nan), "start time")
    cs.refused(
        lambda: fmu.setupExperiment(startTime=2.0, stopTime=1.0), "stop time 1 s", "start time 2 s"
    )
    cs.initialise()
    cs.refused(lambda: fmu.setupExperiment(), "'step complete'")
    cs.refused(fmu.enterInitializationMode, "'step complete'")
    cs.refused(fmu.cancelStep, "fmi2CancelStep")
    fmu.terminate()
    cs.refused(lambda: fmu.doStep(0.0, 0.1), "'terminated'")
    cs.refused(lambda: cs.set(u1=1.0), "'terminated'")
    assert cs.get("q1")[0] == 2.0

    me = drive(scene, "me").initialise()
    me.refused(me.fmu.completedIntegratorStep, "'event mode'")
    me.fmu.newDiscreteStates()
    me.fmu.enterContinuousTimeMode()
    me.refused(me.fmu.newDiscreteStates, "'continuous-time mode'")
    me.refused(me.fmu.enterContinuousTimeMode, "'continuous-time mode'")
    me.refused(lambda: me.fmu.setTime(math.inf), "finite")
    me.refused(lambda: setattr(me, "states", np.full(6, math.nan)), "state 0", "finite")
    me.refused(lambda: setattr(me, "states", np.zeros(5)), "6 numbers", "5")


def test_functions_of_the_other_fmu_type_are_refused(scene_of, drive):
    me, cs = (
        drive(scene_of("three_cart"), "me").initialise(),
        drive(scene_of("three_cart"), "cs").initialise(),
    )
    me.fmu.dll.fmi2DoStep.argtypes = [
        ctypes.c_void_p,
        ctypes.c_double,
        ctypes.c_double,
        ctypes.c_int,
    ]
    assert me.fmu.dll.fmi2DoStep(me.fmu.component, 0.0, 0.1, 0) == 3
    assert "belongs to Co-Simulation" in me.log[-1][2]
    cs.fmu.dll.fmi2EnterEventMode.argtypes = [ctypes.c_void_p]
    assert cs.fmu.dll.fmi2EnterEventMode(cs.fmu.component) == 3
    assert "belongs to Model Exchange" in cs.log[-1][2]


def test_values_that_cannot_be_set_are_refused_and_nothing_is_changed(scene_of, drive):
    cs = drive(scene_of("three_cart"), "cs")
    cs.fmu.setupExperiment()
    cs.fmu.enterInitializationMode()
    before = everything(cs)
    cs.refused(lambda: cs.set(u1=1.0, gap_left=0.0), "gap_left", "calculated")
    cs.refused(lambda: cs.set(u1=1.0, m=-1.0), "-1", "range", "m.")
    cs.refused(lambda: cs.set(u1=1.0, q1=math.nan), "q1", "finite")
    cs.refused(lambda: cs.set(internal_step=0.0), "internal_step")
    cs.refused(lambda: cs.fmu.setReal([9999], [1.0]), "9999")
    cs.refused(lambda: cs.fmu.getReal([9999]), "9999")
    cs.refused(lambda: cs.fmu.getInteger([0]), "Integer")
    cs.refused(lambda: cs.fmu.setBoolean([0], [True]), "Boolean")
    cs.refused(lambda: cs.fmu.setString([0], ["x"]), "String")
    assert cs.fmu.getInteger([]) == []
    cs.fmu.exitInitializationMode()
    cs.refused(lambda: cs.set(q1=1.0), "q1", "'step complete'")
    cs.refused(lambda: cs.set(m=2.0), "m ", "'step complete'")
    cs.refused(lambda: cs.directional(("der(v1)",), ("m",), np.ones(1)), "m ", "not a known")
    cs.refused(lambda: cs.directional(("m",), ("u1",), np.ones(1)), "m ", "not an unknown")
    cs.set(internal_step=1e-3, u1=3.0)
    assert len(before) == len(everything(cs))


def test_status_queries_answer_or_say_why_not(scene_of, drive):
    cs = drive(scene_of("three_cart"), "cs").initialise().run(0.25, 1)
    value = ctypes.c_double()
    cs.fmu.fmi2GetRealStatus(cs.fmu.component, 2, ctypes.byref(value))
    assert value.value == 0.25
    flag = ctypes.c_int(7)
    cs.fmu.fmi2GetBooleanStatus(cs.fmu.component, 3, ctypes.byref(flag))
    assert flag.value == 0
    cs.refused(
        lambda: cs.fmu.fmi2GetStatus(cs.fmu.component, 0, ctypes.byref(flag)),
        "fmi2GetStatus",
        "synchronous",
    )


def test_log_categories(scene_of, drive):
    me = drive(scene_of("three_cart"), "me").continuous()
    me.fmu.setDebugLogging(True, ["logEvents"])
    me.refused(lambda: me.fmu.setDebugLogging(True, ["nonsense"]), "logEvents")
    me.states = np.array([2.6, 3.0, 4.0, 0.0, 0.0, 0.0])
    me.fmu.setTime(0.5)
    me.event()
    assert me.log[-1] == (0, "logEvents", "at t = 0.5 s a contact opened or closed.")


EXACT = {"atol": 1e-12, "rtol": 0}


def run_with_events(cs, end, step):
    """Step to `end`, entering event mode where the FMU asks for it.

    Returns the times at which it did.
    """
    t, events, grid = 0.0, [], 1
    while t < end - 1e-12:
        goal = min(grid * step, end)
        event, terminate, early, reached = cs.fmu.doStep(t, goal - t)
        assert not terminate
        assert early == (reached < goal)
        assert cs.get("time")[0] == reached
        t = reached
        if event:
            events.append(t)
            cs.fmu.enterEventMode()
            assert cs.fmu.updateDiscreteStates() == (False, False, False, False, False, 0.0)
            cs.fmu.enterStepMode()
        if not early:
            grid += 1
    return events


def with_event_mode(drive, scene):
    cs = drive(scene, "cs", "3.0", eventModeUsed=True, earlyReturnAllowed=True).initialise()
    cs.fmu.updateDiscreteStates()
    cs.fmu.enterStepMode()
    return cs


def test_early_return_is_at_the_closed_form_of_contact(scene_of, drive, constants):
    exact = constants("bouncing_mass")
    cs = with_event_mode(drive, scene_of("bouncing_mass"))
    step = (
        exact.FALL_TIME + exact.CONTACT_TIME / 3
    )  # the contact closes within the first step and opens within the second
    events = run_with_events(cs, 2 * step, step)
    np.testing.assert_allclose(
        events, [exact.FALL_TIME, exact.FALL_TIME + exact.CONTACT_TIME], rtol=0, atol=1e-9
    )


def test_contact_changes_in_event_mode_only(scene_of, drive):
    """At the early return the gap is closed to 1e-13 of its nominal, but the force follows the gap only after event mode."""
    cs = with_event_mode(drive, scene_of("bouncing_mass"))
    event, _, early, reached = cs.fmu.doStep(0.0, 1.0)
    assert (event, early) == (True, True)
    assert abs(cs.get("gap_floor")[0]) < 1e-12
    assert cs.get("v")[0] < 0
    slope = cs.directional(("lam_floor",), ("q",), np.ones(1))
    assert slope == [0.0]
    cs.fmu.enterEventMode()
    cs.fmu.updateDiscreteStates()
    assert cs.directional(("lam_floor",), ("q",), np.ones(1)) == [-1000.0]
    cs.refused(lambda: cs.fmu.doStep(reached, 0.1), "'event mode'")
    cs.fmu.enterStepMode()
    cs.refused(cs.fmu.enterStepMode, "'step complete'")
    cs.refused(cs.fmu.updateDiscreteStates, "'step complete'")
    # an importer that forgets event mode is told again, at the same instant, and nothing moves
    other = with_event_mode(drive, scene_of("bouncing_mass"))
    other.fmu.doStep(0.0, 1.0)
    assert other.fmu.doStep(reached, 0.1) == (True, False, True, reached)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["early return", "event mode", "event mode without early return"])
def test_motion_is_the_same_however_events_are_handled(any_scene, drive, mode):
    end = min(any_scene.task.horizon, 1.5)
    u = np.linspace(8.0, -5.0, any_scene.nu)
    plain = drive(any_scene, "cs", "3.0").initialise(u=u).run(end, 30).state()
    options = {"eventModeUsed": mode != "early return", "earlyReturnAllowed": "without" not in mode}
    cs = drive(any_scene, "cs", "3.0", **options).initialise(u=u)
    if mode != "early return":
        cs.fmu.updateDiscreteStates()
        cs.fmu.enterStepMode()
    events = run_with_events(cs, end, end / 30)
    assert not events or mode == "event mode"
    # another division of the step where a contact changes: the fourth order's own error, not more
    np.testing.assert_allclose(cs.state(), plain, rtol=0, atol=1e-7)


def observed(drive, scene, update, required=("u1",), **options):
    names = {
        variable.name: variable.valueReference
        for variable in drive(scene, "cs", "3.0").description.modelVariables
    }
    return drive(
        scene, "cs", "3.0", intermediateUpdate=update,
        requiredIntermediateVariables=[names[name] for name in required], **options,
    )  # fmt: skip


def sine_driven(scene, drive, steps):
    """State after 1 s under u1 = 3 sin(7 t), set in intermediate update."""

    def force(t):
        return 3 * math.sin(7 * t)

    def update(environment, time, may_set, may_get, finished, can_return, early, when):
        assert may_set != may_get
        assert finished == may_get
        if may_set:
            cs.set(u1=force(time))

    cs = observed(drive, scene, update).initialise(internal_step=1.0 / steps)
    cs.set(u1=force(0.0))
    cs.fmu.doStep(0.0, 1.0)
    return cs


@pytest.mark.slow
def test_inputs_that_vary_keep_the_order(scene_of, drive):
    """A free cart without damping: v = 3/7 (1 - cos 7t), q = 2 + 3/7 (t - sin(7 t)/7)."""
    scene = scene_of("three_cart").with_parameters(c=0.0)
    want = [2 + 3 / 7 * (1 - math.sin(7) / 7), 3 / 7 * (1 - math.cos(7))]
    counts = 10 * 2 ** np.arange(4)
    errors = [
        np.abs(sine_driven(scene, drive, count).get("q1", "v1") - want).max() for count in counts
    ]
    slope = np.polyfit(np.log(1.0 / counts), np.log(errors), 1)[0]
    assert abs(slope - 4) < 0.25, (slope, errors)


def test_a_linear_input_equals_the_input_derivative_of_fmi_2(scene_of, drive):
    scene, a, b = scene_of("three_cart"), 9.0, -3.0

    def update(environment, time, may_set, *_):
        if may_set:
            three.set(u1=a + b * time)

    two = drive(scene, "cs").initialise(u=[a, 0.0])
    two.fmu.setRealInputDerivatives(two.vr(["u1"]), [1], [b])
    two.fmu.doStep(0.0, 1.0)
    assert two.get("lam_left")[0] > 0.01  # through contact
    three = observed(drive, scene, update).initialise(u=[a, 0.0])
    three.fmu.doStep(0.0, 1.0)
    np.testing.assert_allclose(
        three.get("u1", *three.names.q, *three.names.v),
        two.get("u1", *two.names.q, *two.names.v),
        **EXACT,
    )


def test_intermediate_update_tells_the_state_in_order_of_time(scene_of, drive):
    scene, seen = scene_of("three_cart"), []

    def update(environment, time, may_set, may_get, finished, can_return, early, when):
        assert (may_set, may_get, finished, can_return) == (False, True, True, False)
        seen.append((time, *cs.get("time", "q1", "v1")))
        with pytest.raises(Exception, match="status 3"):
            cs.set(u1=1.0)
        with pytest.raises(Exception, match="status 3"):
            cs.fmu.doStep(time, 0.1)

    cs = observed(drive, scene, update, required=("q1",)).initialise(
        u=[1.0, 0.0], c=0.0, internal_step=0.1
    )
    cs.fmu.doStep(0.0, 1.0)
    times = np.array(seen)[:, 0]
    np.testing.assert_allclose(times, np.arange(1, 11) / 10, **EXACT)
    np.testing.assert_allclose(
        np.array(seen)[:, 1:], np.column_stack([times, 2 + times**2 / 2, times]), **EXACT
    )


@pytest.mark.parametrize(("wish", "reached"), [(0.32, 0.32), (0.0, 0.3), (5.0, 1.0)])
def test_importer_may_ask_for_an_early_return(scene_of, drive, wish, reached):
    def update(environment, time, may_set, may_get, finished, can_return, early, when):
        assert can_return == finished
        if finished and time > 0.29:
            early[0], when[0] = True, wish

    cs = observed(drive, scene_of("three_cart"), update, earlyReturnAllowed=True).initialise(
        u=[1.0, 0.0], c=0.0, internal_step=0.1
    )
    event, _, early, last = cs.fmu.doStep(0.0, 1.0)
    assert (event, early) == (False, reached < 1.0)
    assert last == pytest.approx(reached, abs=1e-12)
    np.testing.assert_allclose(cs.get("v1", "time"), [reached, reached], **EXACT)
    cs.fmu.doStep(last, 0.1)


def test_input_parabola_is_used_up_to_an_early_return_at_contact(scene_of, drive):
    """The input at the event is that of its time, not that of the end of the internal step."""
    scene = scene_of("three_cart")

    def update(environment, time, may_set, *_):
        if may_set:
            cs.set(u1=9.0 - 3.0 * time)

    cs = observed(drive, scene, update, earlyReturnAllowed=True).initialise(
        u=[9.0, 0.0], internal_step=0.05
    )
    _, _, early, reached = cs.fmu.doStep(0.0, 2.0)
    assert early
    assert cs.get("u1")[0] == pytest.approx(9.0 - 3.0 * reached, abs=1e-12)
    assert abs(cs.get("gap_left")[0]) < 1e-12


def test_state_of_event_mode_is_refused_without_it(scene_of, drive):
    scene = scene_of("three_cart")
    one = with_event_mode(drive, scene)
    other = drive(scene, "cs", "3.0").initialise()
    state = one.fmu.getFMUState()
    other.refused(lambda: other.fmu.setFMUState(state), "with event mode")
    one.fmu.setFMUState(state)
    one.fmu.freeFMUState(state)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"early_return_allowed": True},
        {"use_event_mode": True},
        {"early_return_allowed": True, "use_event_mode": True},
    ],
)
def test_stock_importer_simulates_fmi_3(scene_of, unpacked, options):
    samples = [(0.0, 8.0, -5.0), (1.0, 8.0, -5.0), (1.0, -2.0, 0.0), (2.0, -2.0, 0.0)]
    signal = np.array(samples, dtype=[("time", float), ("u1", float), ("u3", float)])
    scene = scene_of("three_cart")
    common = {
        "fmi_type": "CoSimulation",
        "stop_time": 2.0,
        "output_interval": 0.01,
        "input": signal,
    }
    want = fmpy.simulate_fmu(unpacked(scene), **common)
    got = fmpy.simulate_fmu(unpacked(scene, "3.0"), **common, **options)
    np.testing.assert_allclose(list(got[-1]), list(want[-1]), **EXACT)
