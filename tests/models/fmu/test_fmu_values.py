"""What the FMU computes, against numpy at probe points; directional derivatives against finite differences."""

import numpy as np
import pytest

# The C and the numpy expressions differ by the order of their sums and by libm; a few units in the last place of terms up to ~30.
CLOSE = 1e-12
# Central differences with step h: truncation h^2 |f'''|/6 and rounding 1e-16 |f|/h are both below 1e-8 for values up to ~100.
STEP, DIFFERENCE = 1e-5, 2e-8


def calculated(names):
    energies = (names.kinetic_energy, names.potential_energy, names.contact_energy, names.input_power, names.dissipated_power)
    return (*names.der_q, *names.der_v, *names.lam, *names.gap, *(name for name in energies if name))


@pytest.mark.slow
def test_derivatives_outputs_and_indicators_equal_numpy(any_scene, drive, reference, probe_points):
    truth = reference(any_scene)
    for q, v, u in probe_points(any_scene):
        me, cs = drive(any_scene, "me").continuous(q, v, u), drive(any_scene, "cs").initialise(q, v, u)
        lam, phi = truth.force(q), truth.penetration(q)
        a = truth.acceleration(q, v, u, lam)
        np.testing.assert_allclose(me.derivatives, [*v, *a], rtol=CLOSE, atol=CLOSE)
        np.testing.assert_allclose(me.indicators, -phi, rtol=CLOSE, atol=CLOSE)
        np.testing.assert_array_equal(me.states, [*q, *v])
        for driver in (me, cs):
            names = driver.names
            expected = {
                **dict(zip(names.der_q, v, strict=True)),
                **dict(zip(names.der_v, a, strict=True)),
                **dict(zip(names.lam, lam, strict=True)),
                **dict(zip(names.gap, -phi, strict=True)),
                names.kinetic_energy: truth.value("kinetic_energy", "q", "v")(q, v).item(),
                names.potential_energy: truth.value("potential_energy", "q")(q).item(),
                names.contact_energy: np.sum(lam * phi) / 2,
                names.input_power: truth.value("input_power", "q", "v", "u")(q, v, u).item(),
                names.dissipated_power: truth.value("dissipated_power", "q", "v")(q, v).item(),
            }
            absent = expected.pop(None, 0.0)
            assert absent == 0.0  # what the FMU leaves out is zero in the equations
            assert set(expected) == set(calculated(names))
            np.testing.assert_allclose(driver.get(*expected), list(expected.values()), rtol=CLOSE, atol=CLOSE)
            np.testing.assert_array_equal(driver.get(*names.q, *names.v, *names.u), [*q, *v, *u])


@pytest.mark.parametrize("closed", [False, True])
def test_directional_derivatives_in_either_contact_mode(any_scene, drive, probe_points, closed):
    """Modes are frozen, so that f is smooth: J d = (f(x + h d) - f(x - h d))/2h, on whichever side of the boundary x lies."""
    if closed and not any_scene.nc:
        pytest.skip("no contacts")
    rng = np.random.default_rng(11)
    for q, v, u in probe_points(any_scene)[4:]:
        me = drive(any_scene, "me").continuous(_in_contact(any_scene) if closed else _apart(any_scene), v, u)
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
    return {"three_cart": [0.0, 1.0, 2.0], "bouncing_mass": [1.0], "two_body_collision": [0.0, 1.0], "two_link_arm": [1.57, 0.0]}.get(
        scene.name, [0.3]
    )


def _in_contact(scene):
    """Positions with every contact closed."""
    return {"three_cart": [0.0, 0.4, 0.8], "bouncing_mass": [-0.1], "two_body_collision": [0.0, 0.1], "two_link_arm": [0.1, 0.1]}[
        scene.name
    ]


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
            np.testing.assert_allclose(got / scale, slope / scale, rtol=0, atol=DIFFERENCE, err_msg=name)


def test_declared_dependencies_are_those_of_the_equations(any_scene, drive):
    """A known that is not declared must have no influence; one that is declared must have some at a random point."""
    rng = np.random.default_rng(3)
    seen = None
    for _ in range(4):
        for start in [_apart(any_scene)] + ([_in_contact(any_scene)] if any_scene.nc else []):
            q = np.array(start) + 0.01 * rng.standard_normal(any_scene.nq)
            me = drive(any_scene, "me").continuous(q, rng.standard_normal(any_scene.nq), rng.standard_normal(any_scene.nu))
            names = me.names
            unknowns, knowns = (*calculated(names), *names.q, *names.v), (*names.q, *names.v, *names.u)
            jacobian = np.column_stack([me.directional(unknowns, knowns, row) for row in np.eye(len(knowns))])
            seen = (jacobian != 0) if seen is None else seen | (jacobian != 0)
    declared = {
        row.variable.name: {known.name for known in row.dependencies} for row in me.description.outputs + me.description.derivatives
    }
    assert set(declared) == set(unknowns)
    for row, unknown in enumerate(unknowns):
        influences = {known for column, known in enumerate(knowns) if seen[row, column]}
        assert influences == declared[unknown], unknown
