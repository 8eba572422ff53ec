"""FMI 3.0: the same numbers as FMI 2.0, adjoints that are transposes, named event indicators, and what is not offered."""

import ctypes
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import fmi3Float32, fmi3FMUState

# A sum of up to a few hundred products of numbers up to ~100, in another order.
ROUNDING = 1e-11


def calculated(names):
    energies = (names.kinetic_energy, names.potential_energy, names.contact_energy, names.input_power, names.dissipated_power)
    return (*names.der_q, *names.der_v, *names.lam, *names.gap, *(name for name in energies if name))


def test_description_says_what_the_binary_offers(any_scene, drive, unpacked):
    me = drive(any_scene, "me", "3.0")
    description, names = me.description, me.names
    xml = ElementTree.parse(Path(unpacked(any_scene, "3.0")) / "modelDescription.xml").getroot()
    both = {"canGetAndSetFMUState", "canSerializeFMUState", "providesDirectionalDerivatives", "providesAdjointDerivatives"}
    offered = {
        kind: {name for name, value in xml.find(kind).attrib.items() if value == "true"} for kind in ("ModelExchange", "CoSimulation")
    }
    assert offered["ModelExchange"] == both | {"needsCompletedIntegratorStep"}
    assert offered["CoSimulation"] == both | {
        "canHandleVariableCommunicationStepSize",
        "providesIntermediateUpdate",
        "mightReturnEarlyFromDoStep",
        "canReturnEarlyAfterIntermediateUpdate",
        "hasEventMode",
    }
    assert xml.find("ScheduledExecution") is None
    assert [row.variable.name for row in description.eventIndicators] == list(names.gap)
    assert [row.variable.name for row in description.derivatives] == [*names.der_q, *names.der_v]
    variables = list(xml.find("ModelVariables"))
    within = {variable.get("name") for variable in variables if variable.get("intermediateUpdate") == "true"}
    assert within == {variable.get("name") for variable in variables if variable.get("causality") in ("input", "output")}
    assert me.fmu.getNumberOfEventIndicators() == any_scene.nc
    assert me.fmu.getNumberOfContinuousStates() == 2 * any_scene.nq
    assert me.fmu.getVersion() == description.fmiVersion == "3.0"


def test_model_exchange_gives_the_bits_of_fmi_2(any_scene, drive, probe_points):
    for q, v, u in probe_points(any_scene):
        two, three = (drive(any_scene, "me", version).continuous(q, v, u) for version in ("2.0", "3.0"))
        every = (*calculated(two.names), *two.names.q, *two.names.v, *two.names.u)
        np.testing.assert_array_equal(three.get(*every), two.get(*every))
        for what in ("states", "derivatives", "indicators", "nominals"):
            np.testing.assert_array_equal(getattr(three, what), getattr(two, what))


def test_co_simulation_gives_the_bits_of_fmi_2(any_scene, drive):
    end, u = min(any_scene.task.horizon, 1.5), np.linspace(8.0, -5.0, any_scene.nu)
    two, three = (drive(any_scene, "cs", version).initialise(u=u).run(end, 15) for version in ("2.0", "3.0"))
    every = (*calculated(two.names), *two.names.q, *two.names.v)
    np.testing.assert_array_equal(three.get(*every), two.get(*every))


def points(scene):
    """Positions with contacts open, and closed if there are any."""
    start = np.array(scene.task.start[: scene.nq])
    closed = {"three_cart": [0.0, 0.4, 0.8], "bouncing_mass": [-0.1], "two_body_collision": [0.0, 0.1], "two_link_arm": [0.1, 0.1]}
    return [start + 0.01, *([np.array(closed[scene.name])] if scene.nc else [])]


@pytest.mark.slow
def test_adjoint_is_the_transpose_of_the_directional_derivative(any_scene, drive):
    """w . (J d) = (J' w) . d for states, inputs and parameters, in either contact mode, while running."""
    rng = np.random.default_rng(5)
    for q in points(any_scene):
        for kind in ("me", "cs"):
            driver = drive(any_scene, kind, "3.0")
            start = {"v": rng.standard_normal(any_scene.nq), "u": rng.standard_normal(any_scene.nu)}
            driver.continuous(q, **start) if kind == "me" else driver.initialise(q, **start)
            names = driver.names
            unknowns, knowns = (*calculated(names), *names.q, *names.v), (*names.q, *names.v, *names.u, *names.parameters)
            d, w = rng.standard_normal(len(knowns)), rng.standard_normal(len(unknowns))
            forward, backward = driver.directional(unknowns, knowns, d), driver.adjoint(unknowns, knowns, w)
            scale = np.abs(w * forward).sum() + np.abs(backward * d).sum()
            assert abs(w @ forward - backward @ d) < 1e-13 * scale
            # and entry by entry, so that two errors cannot cancel in the sum
            jacobian = np.column_stack([driver.directional(unknowns, knowns, row) for row in np.eye(len(knowns))])
            rows = np.array([driver.adjoint(unknowns, knowns, row) for row in np.eye(len(unknowns))])
            np.testing.assert_allclose(rows, jacobian, rtol=ROUNDING, atol=ROUNDING * np.abs(jacobian).max())


def test_derivatives_by_parameters_while_running_equal_differences(any_scene, drive):
    """A parameter is fixed once the simulation runs, so the differences are of instances that started with other values."""
    if not any_scene.parameters:
        pytest.skip("no parameters")
    for q in points(any_scene):
        for index, parameter in enumerate(any_scene.parameters):
            step = 1e-5 * max(abs(parameter.value), 1e-3)
            values = []
            for value in (parameter.value + step, parameter.value - step):
                cs = drive(any_scene, "cs", "3.0").initialise(q, np.linspace(0.4, 0.9, any_scene.nq), **{parameter.name: value})
                values.append(cs.get(*calculated(cs.names)))
            slope = (values[0] - values[1]) / (2 * step)
            cs = drive(any_scene, "cs", "3.0").initialise(q, np.linspace(0.4, 0.9, any_scene.nq))
            got = cs.directional(calculated(cs.names), cs.names.parameters, np.eye(len(any_scene.parameters))[index])
            np.testing.assert_allclose(got, slope, rtol=2e-7, atol=2e-7 * max(1.0, np.abs(slope).max()), err_msg=parameter.name)


def test_functions_not_offered_are_refused_with_a_reason(scene_of, drive, unpacked):
    cs = drive(scene_of("three_cart"), "cs", "3.0").initialise()
    fmu = cs.fmu
    cs.refused(lambda: fmu.getFloat32([0]), "fmi3GetFloat32", "no variables of type Float32")
    cs.refused(lambda: fmu.setInt32([0], [1]), "fmi3SetInt32", "Int32")
    cs.refused(lambda: fmu.setString([0], ["x"]), "String")
    cs.refused(lambda: fmu.getBinary([0]), "Binary")
    cs.refused(lambda: fmu.getClock([0]), "Clock")
    cs.refused(lambda: fmu.fmi3GetNumberOfVariableDependencies(fmu.component, 1, None), "modelDescription.xml")
    cs.refused(lambda: fmu.fmi3GetIntervalDecimal(fmu.component, None, 0, None, None), "no clocks")
    cs.refused(fmu.enterConfigurationMode, "no structural parameters")
    cs.refused(lambda: fmu.fmi3EvaluateDiscreteStates(fmu.component), "fmi3UpdateDiscreteStates")
    cs.refused(fmu.enterEventMode, "without event mode")
    cs.refused(lambda: fmu.setFMUState(fmi3FMUState()), "missing")
    cs.refused(lambda: cs.get("integrator"), "integrator", "enumeration")
    cs.refused(lambda: fmu.getInt64(cs.vr(["q1"])), "q1", "real")
    cs.refused(lambda: fmu.getFloat64(cs.vr(["q1"]), nValues=2), "as many values")
    assert fmu.getFloat32([]) == []
    values = (fmi3Float32 * 1)()
    with pytest.raises(FMICallException):
        fmu.fmi3GetFloat32(None, (ctypes.c_uint * 1)(0), 1, values, 1)
    scheduled = fmpy.fmi3.FMU3ScheduledExecution(
        guid=cs.description.instantiationToken,
        unzipDirectory=unpacked(scene_of("three_cart"), "3.0"),
        modelIdentifier="three_cart",
        instanceName="x",
    )
    with pytest.raises(Exception, match="Failed to instantiate"):
        scheduled.instantiate(logMessage=lambda *_: None)


def test_wrong_token_is_refused_and_no_logger_is_no_crash(scene_of, drive):
    cs = drive(scene_of("three_cart"), "cs", "3.0")
    arguments = (b"", False, False, False, False, None, 0, None)
    silent = ctypes.cast(None, fmpy.fmi3.fmi3LogMessageCallback)
    nothing = ctypes.cast(None, fmpy.fmi3.fmi3IntermediateUpdateCallback)
    for token in (b"wrong", None):
        assert cs.fmu.fmi3InstantiateCoSimulation(b"x", token, *arguments, cs.fmu.logMessage, nothing) is None
        assert "instantiation token" in cs.log[-1][2]
        assert cs.fmu.fmi3InstantiateCoSimulation(b"x", token, *arguments, silent, nothing) is None
