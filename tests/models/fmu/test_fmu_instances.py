"""Instances: saved states, reset, independence, and calls that come at the wrong time or with wrong arguments."""

import ctypes
import math

import numpy as np
import pytest
from fmpy.fmi2 import fmi2FMUstate


def everything(driver):
    """The bytes of the whole state."""
    state = driver.fmu.getFMUstate()
    data = driver.fmu.serializeFMUstate(state)
    driver.fmu.freeFMUstate(state)
    return data


def drive_on(driver, start, steps=30, step=0.01):
    """Run with changing inputs; returns the trace of all outputs."""
    rows = []
    for n in range(steps):
        if driver.names.u:
            driver.set_all(driver.names.u, 6.0 * np.cos(n + np.arange(len(driver.names.u))))
        driver.fmu.doStep(start + n * step, step)
        rows.append(driver.get(*driver.names.q, *driver.names.v, *driver.names.lam, driver.names.kinetic_energy))
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
    other.refused(lambda: other.fmu.deSerializeFMUstate(b"x" * len(data)), "not a state of this model")
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
    cs.refused(lambda: fmu.setupExperiment(startTime=2.0, stopTime=1.0), "stop time 1 s", "start time 2 s")
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
    me, cs = drive(scene_of("three_cart"), "me").initialise(), drive(scene_of("three_cart"), "cs").initialise()
    me.fmu.dll.fmi2DoStep.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
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
    cs.refused(lambda: cs.fmu.fmi2GetStatus(cs.fmu.component, 0, ctypes.byref(flag)), "fmi2GetStatus", "synchronous")


def test_log_categories(scene_of, drive):
    me = drive(scene_of("three_cart"), "me").continuous()
    me.fmu.setDebugLogging(True, ["logEvents"])
    me.refused(lambda: me.fmu.setDebugLogging(True, ["nonsense"]), "logEvents")
    me.states = np.array([2.6, 3.0, 4.0, 0.0, 0.0, 0.0])
    me.fmu.setTime(0.5)
    me.event()
    assert me.log[-1] == (0, "logEvents", "at t = 0.5 s a contact opened or closed.")
