"""What the FMU computes, against numpy at probe points, directional derivatives against finite differences; FMI 3.0: the same numbers, adjoints that are transposes, and what is not offered. The model structure: what is read back is what the equations say."""

import ctypes
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
import sympy as sp
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import fmi3Float32, fmi3FMUState

from models.catalog import load_scene
from models.fmu import structure
from models.fmu.structure import Dependency, dependencies, derived_dependencies

# The C and the numpy expressions differ by the order of their sums and by libm; a few units in the
# last place of terms up to ~30.
CLOSE = 1e-12
# Central differences with step h: truncation h^2 |f'''|/6 and rounding 1e-16 |f|/h are both below
# 1e-8 for values up to ~100.
STEP = 1e-5
DIFFERENCE = 2e-8


def calculated(names):
    energies = (
        names.kinetic_energy,
        names.potential_energy,
        names.contact_energy,
        names.input_power,
        names.dissipated_power,
    )
    return (
        *names.der_q,
        *names.der_v,
        *names.lam,
        *names.gap,
        *(name for name in energies if name),
    )


@pytest.mark.slow
def test_derivatives_outputs_and_indicators_equal_numpy(any_scene, drive, reference, probe_points):
    truth = reference(any_scene)
    for q, v, u in probe_points(any_scene):
        me, cs = (
            drive(any_scene, "me").continuous(q, v, u),
            drive(any_scene, "cs").initialise(q, v, u),
        )
        lam, phi = truth.force(q), truth.penetration(q)
        a = truth.acceleration(q, v, u, lam)
        np.testing.assert_allclose(me.derivatives, [*v, *a], rtol=CLOSE, atol=CLOSE)
        np.testing.assert_allclose(me.indicators, -phi, rtol=CLOSE, atol=CLOSE)
        np.testing.assert_array_equal(me.states, [*q, *v])
        for driver in (me, cs):
            names = driver.names
            expected = {
                **dict(zip(names.der_q, v, strict=True)), **dict(zip(names.der_v, a, strict=True)),
                **dict(zip(names.lam, lam, strict=True)),
                **dict(zip(names.gap, -phi, strict=True)),
                names.kinetic_energy: truth.value("kinetic_energy", "q", "v")(q, v).item(),
                names.potential_energy: truth.value("potential_energy", "q")(q).item(),
                names.contact_energy: np.sum(lam * phi) / 2,
                names.input_power: truth.value("input_power", "q", "v", "u")(q, v, u).item(),
                names.dissipated_power: truth.value("dissipated_power", "q", "v")(q, v).item(),
            }  # fmt: skip
            absent = expected.pop(None, 0.0)
            assert absent == 0.0  # what the FMU leaves out is zero in the equations
            assert set(expected) == set(calculated(names))
            np.testing.assert_allclose(
                driver.get(*expected), list(expected.values()), rtol=CLOSE, atol=CLOSE
            )
            np.testing.assert_array_equal(driver.get(*names.q, *names.v, *names.u), [*q, *v, *u])


@pytest.mark.parametrize("closed", [False, True])
def test_directional_derivatives_in_either_contact_mode(any_scene, drive, probe_points, closed):
    """Modes are frozen, so that f is smooth: J d = (f(x + h d) - f(x - h d))/2h, on whichever side of the boundary x lies."""
    if closed and not any_scene.nc:
        pytest.skip("no contacts")
    rng = np.random.default_rng(11)
    for q, v, u in probe_points(any_scene)[4:]:
        me = drive(any_scene, "me").continuous(
            _in_contact(any_scene) if closed else _apart(any_scene), v, u
        )
        names = me.names
        unknowns = (*calculated(names), *names.q, *names.v)
        knowns = (*names.q, *names.v, *names.u)
        x = np.concatenate([q, v, u])
        seed = rng.standard_normal(x.size)

        def values(point, me=me, names=names, unknowns=unknowns):
            me.states = point[: 2 * len(names.q)]
            me.set_all(names.u, point[2 * len(names.q) :])
            return me.get(*unknowns)

        slope = (values(x + STEP * seed) - values(x - STEP * seed)) / (2 * STEP)
        values(x)
        got = me.directional(unknowns, knowns, seed)
        assert np.abs(got).max() > 0.1
        scale = np.maximum(1.0, np.abs(slope))
        np.testing.assert_allclose(got / scale, slope / scale, rtol=0, atol=DIFFERENCE)


def _apart(scene):
    """Positions without contact."""
    return {
        "three_cart": [0.0, 1.0, 2.0],
        "bouncing_mass": [1.0],
        "two_body_collision": [0.0, 1.0],
        "two_link_arm": [1.57, 0.0],
    }.get(scene.name, [0.3])


def _in_contact(scene):
    """Positions with every contact closed."""
    return {
        "three_cart": [0.0, 0.4, 0.8],
        "bouncing_mass": [-0.1],
        "two_body_collision": [0.0, 0.1],
        "two_link_arm": [0.1, 0.1],
    }[scene.name]


def test_directional_derivatives_by_parameters_during_initialization(any_scene, drive):
    if not any_scene.parameters:
        pytest.skip("no parameters")
    for q in (_apart(any_scene), _in_contact(any_scene)):
        driver = drive(any_scene, "cs")
        driver.fmu.setupExperiment()
        driver.fmu.enterInitializationMode()
        names = driver.names
        driver.set_all(names.q, q)
        driver.set_all(names.v, np.linspace(0.4, 0.9, any_scene.nq))
        unknowns = calculated(names)
        value = np.array([parameter.value for parameter in any_scene.parameters])
        for index, name in enumerate(names.parameters):
            seed = np.zeros(value.size)
            seed[index] = 1.0
            step = STEP * value[index]
            driver.set(**{name: value[index] + step})
            above = driver.get(*unknowns)
            driver.set(**{name: value[index] - step})
            below = driver.get(*unknowns)
            driver.set(**{name: value[index]})
            slope = (above - below) / (2 * step)
            scale = np.maximum(1.0, np.abs(slope))
            got = driver.directional(unknowns, names.parameters, seed)
            np.testing.assert_allclose(
                got / scale, slope / scale, rtol=0, atol=DIFFERENCE, err_msg=name
            )


def test_declared_dependencies_are_those_of_the_equations(any_scene, drive):
    """A known that is not declared must have no influence.

    One that is declared must have some at a random point.
    """
    rng = np.random.default_rng(3)
    seen = None
    for _ in range(4):
        for place in places(any_scene):
            q = place + 0.01 * rng.standard_normal(any_scene.nq)
            me = drive(any_scene, "me").continuous(
                q, rng.standard_normal(any_scene.nq), rng.standard_normal(any_scene.nu)
            )
            names = me.names
            unknowns, knowns = (
                (*calculated(names), *names.q, *names.v),
                (*names.q, *names.v, *names.u),
            )
            jacobian = np.column_stack(
                [me.directional(unknowns, knowns, row) for row in np.eye(len(knowns))]
            )
            seen = (jacobian != 0) if seen is None else seen | (jacobian != 0)
    declared = {
        row.variable.name: {known.name for known in row.dependencies}
        for row in me.description.outputs + me.description.derivatives
    }
    assert set(declared) == set(unknowns)
    for row, unknown in enumerate(unknowns):
        influences = {known for column, known in enumerate(knowns) if seen[row, column]}
        assert influences == declared[unknown], unknown


# A sum of up to a few hundred products of numbers up to ~100, in another order.
ROUNDING = 1e-11


def test_description_says_what_the_binary_offers(any_scene, drive, unpacked):
    me = drive(any_scene, "me", "3.0")
    description, names = me.description, me.names
    xml = ElementTree.parse(Path(unpacked(any_scene, "3.0")) / "modelDescription.xml").getroot()
    both = {
        "canGetAndSetFMUState",
        "canSerializeFMUState",
        "providesDirectionalDerivatives",
        "providesAdjointDerivatives",
    }
    offered = {
        kind: {name for name, value in xml.find(kind).attrib.items() if value == "true"}
        for kind in ("ModelExchange", "CoSimulation")
    }
    assert offered["ModelExchange"] == both | {"needsCompletedIntegratorStep"}
    assert offered["CoSimulation"] == both | {
        "canHandleVariableCommunicationStepSize", "providesIntermediateUpdate",
        "mightReturnEarlyFromDoStep",
        "canReturnEarlyAfterIntermediateUpdate", "hasEventMode",
    }  # fmt: skip
    assert xml.find("ScheduledExecution") is None
    assert [row.variable.name for row in description.eventIndicators] == list(names.gap)
    assert [row.variable.name for row in description.derivatives] == [*names.der_q, *names.der_v]
    variables = list(xml.find("ModelVariables"))
    within = {
        variable.get("name")
        for variable in variables
        if variable.get("intermediateUpdate") == "true"
    }
    assert within == {
        variable.get("name")
        for variable in variables
        if variable.get("causality") in ("input", "output")
    }
    assert me.fmu.getNumberOfEventIndicators() == any_scene.nc
    assert me.fmu.getNumberOfContinuousStates() == 2 * any_scene.nq
    assert me.fmu.getVersion() == description.fmiVersion == "3.0"


def test_model_exchange_gives_the_bits_of_fmi_2(any_scene, drive, probe_points):
    for q, v, u in probe_points(any_scene):
        two, three = (
            drive(any_scene, "me", version).continuous(q, v, u) for version in ("2.0", "3.0")
        )
        every = (*calculated(two.names), *two.names.q, *two.names.v, *two.names.u)
        np.testing.assert_array_equal(three.get(*every), two.get(*every))
        for what in ("states", "derivatives", "indicators", "nominals"):
            np.testing.assert_array_equal(getattr(three, what), getattr(two, what))


def test_co_simulation_gives_the_bits_of_fmi_2(any_scene, drive):
    end, u = min(any_scene.task.horizon, 1.5), np.linspace(8.0, -5.0, any_scene.nu)
    two, three = (
        drive(any_scene, "cs", version).initialise(u=u).run(end, 15) for version in ("2.0", "3.0")
    )
    every = (*calculated(two.names), *two.names.q, *two.names.v)
    np.testing.assert_array_equal(three.get(*every), two.get(*every))


def places(scene):
    """Positions with contacts open, and closed if there are any."""
    return [np.array(_apart(scene)), *([np.array(_in_contact(scene))] if scene.nc else [])]


@pytest.mark.slow
def test_adjoint_is_the_transpose_of_the_directional_derivative(any_scene, drive):
    """w .

    (J d) = (J' w) . d for states, inputs and parameters, in either contact mode, while running.
    """
    rng = np.random.default_rng(5)
    for q in places(any_scene):
        for kind in ("me", "cs"):
            driver = drive(any_scene, kind, "3.0")
            start = {"v": rng.standard_normal(any_scene.nq), "u": rng.standard_normal(any_scene.nu)}
            driver.continuous(q, **start) if kind == "me" else driver.initialise(q, **start)
            names = driver.names
            unknowns, knowns = (
                (*calculated(names), *names.q, *names.v),
                (*names.q, *names.v, *names.u, *names.parameters),
            )
            d, w = rng.standard_normal(len(knowns)), rng.standard_normal(len(unknowns))
            forward, backward = (
                driver.directional(unknowns, knowns, d),
                driver.adjoint(unknowns, knowns, w),
            )
            scale = np.abs(w * forward).sum() + np.abs(backward * d).sum()
            assert abs(w @ forward - backward @ d) < 1e-13 * scale
            # and entry by entry, so that two errors cannot cancel in the sum
            jacobian = np.column_stack(
                [driver.directional(unknowns, knowns, row) for row in np.eye(len(knowns))]
            )
            rows = np.array(
                [driver.adjoint(unknowns, knowns, row) for row in np.eye(len(unknowns))]
            )
            np.testing.assert_allclose(
                rows, jacobian, rtol=ROUNDING, atol=ROUNDING * np.abs(jacobian).max()
            )


def test_derivatives_by_parameters_while_running_equal_differences(any_scene, drive):
    """A parameter is fixed once the simulation runs, so the differences are of instances that started with other values."""
    if not any_scene.parameters:
        pytest.skip("no parameters")
    for q in places(any_scene):
        for index, parameter in enumerate(any_scene.parameters):
            step = 1e-5 * max(abs(parameter.value), 1e-3)
            values = []
            for value in (parameter.value + step, parameter.value - step):
                cs = drive(any_scene, "cs", "3.0").initialise(
                    q, np.linspace(0.4, 0.9, any_scene.nq), **{parameter.name: value}
                )
                values.append(cs.get(*calculated(cs.names)))
            slope = (values[0] - values[1]) / (2 * step)
            cs = drive(any_scene, "cs", "3.0").initialise(q, np.linspace(0.4, 0.9, any_scene.nq))
            got = cs.directional(
                calculated(cs.names), cs.names.parameters, np.eye(len(any_scene.parameters))[index]
            )
            np.testing.assert_allclose(
                got,
                slope,
                rtol=2e-7,
                atol=2e-7 * max(1.0, np.abs(slope).max()),
                err_msg=parameter.name,
            )


def test_functions_not_offered_are_refused_with_a_reason(scene_of, drive, unpacked):
    cs = drive(scene_of("three_cart"), "cs", "3.0").initialise()
    fmu = cs.fmu
    cs.refused(lambda: fmu.getFloat32([0]), "fmi3GetFloat32", "no variables of type Float32")
    cs.refused(lambda: fmu.setInt32([0], [1]), "fmi3SetInt32", "Int32")
    cs.refused(lambda: fmu.setString([0], ["x"]), "String")
    cs.refused(lambda: fmu.getBinary([0]), "Binary")
    cs.refused(lambda: fmu.getClock([0]), "Clock")
    cs.refused(
        lambda: fmu.fmi3GetNumberOfVariableDependencies(fmu.component, 1, None),
        "modelDescription.xml",
    )
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
        assert (
            cs.fmu.fmi3InstantiateCoSimulation(b"x", token, *arguments, cs.fmu.logMessage, nothing)
            is None
        )
        assert "instantiation token" in cs.log[-1][2]
        assert cs.fmu.fmi3InstantiateCoSimulation(b"x", token, *arguments, silent, nothing) is None


@pytest.mark.parametrize("name", ["three_cart", "cart_pole_walls", "transport", "damped_collision"])
def test_cached_structure_equals_derived_structure(name, monkeypatch):
    scene = load_scene(name)
    derived = derived_dependencies(scene)
    assert derived, "a scene has states"
    first = dependencies(scene)
    monkeypatch.setattr(
        structure, "derived_dependencies", lambda _scene: pytest.fail("kept already")
    )
    for found in (first, dependencies(scene)):
        assert found == derived
        assert [(known, list(knowns)) for known, knowns in found.items()] == [
            (known, list(knowns)) for known, knowns in derived.items()
        ]


def test_another_equation_is_another_structure():
    """The key is of the equations: a scene that differs there never reads the other's."""
    with_walls, without = load_scene("cart_pole_walls"), load_scene("wall_pendulum")
    assert dependencies(with_walls) != dependencies(without)


@pytest.mark.parametrize("name", ["three_cart", "acrobot_limits", "two_discs", "two_finger"])
def test_dependence_at_two_points_equals_expansion(name, monkeypatch):
    scene = load_scene(name)
    found = derived_dependencies(scene)
    assert Dependency.DEPENDENT in {kind for knowns in found.values() for kind in knowns.values()}
    monkeypatch.setattr(structure, "_seen_to_vary", lambda *_: set())
    assert found == derived_dependencies(scene)


def test_cancelling_terms_are_not_dependencies():
    x, y, m = sp.symbols("x y m")
    slopes = {
        x: (1 + y) * m - y * m,
        y: sp.sin(x) ** 2 + sp.cos(x) ** 2 + m,
        m: x * y,
        sp.Symbol("f"): sp.Function("unknown")(x),
    }
    assert structure._seen_to_vary(slopes, {m}) == set(), (
        "a function that Python has not: nothing is said of any"
    )
    slopes.popitem()
    assert structure._seen_to_vary(slopes, {m}) == {m}


def test_a_power_that_is_complex_at_a_point_is_not_seen_to_vary():
    """(x - 5)^(3/2) is real for some x, but at neither of the points."""
    x, y = sp.symbols("x y", real=True)
    assert structure._seen_to_vary({x: (x - 5) ** sp.Rational(3, 2), y: x * y}, set()) == {y}
