"""Damped contacts in the FMU: outputs and derivatives against SymPy and finite differences, located releases against an independent integration."""

from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from models.catalog import load_scene
from models.fmu import build_fmu
from models.fmu.reference import Equations, Piece, true_motion
from models.scene import Scene

ARM = load_scene(str(Path(__file__).parents[2] / "scenes" / "damped_arm.py"))
COLLISION = load_scene("damped_collision")
# Away from all boundaries: foot and hand press; the hand is released while it touches; foot and bumper are released or open.
POINTS = [
    ([0.2, 0.5, -0.05], [0.4, 0.2, -0.3]),
    ([0.2, 0.5, -0.05], [-1.0, -1.2, 0.4]),
    ([-0.3, 0.9, -0.02], [0.3, 0.1, 1.5]),
    ([0.1, 0.6, 0.3], [-2.0, 0.5, 0.1]),
]
U = np.array([7.0, -2.0])


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("scene", [ARM, COLLISION], ids=lambda scene: scene.name)
def test_package_is_valid_and_has_an_indicator_for_each_release(scene: Scene, version: str) -> None:
    path = str(build_fmu(scene, version))
    assert validate_fmu(path) == []
    description = fmpy.read_model_description(path)
    count = description.numberOfEventIndicators if version == "2.0" else len(description.eventIndicators)
    assert count == scene.nc + scene.nf + 2
    units = {variable.name: variable.unit for variable in description.modelVariables}
    assert [units[scene.contacts[index].pressing_name] for index in scene.damped] == ["1", "1"]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_outputs_and_accelerations_are_those_of_the_equations(drive: Callable, version: str) -> None:
    equations, released = Equations(ARM), 0
    for q, v in POINTS:
        model = drive(ARM, "me", version).continuous(q, v, U)
        x = np.array([*q, *v])
        expected = equations.outputs(x, U)
        found = model.get(*expected)
        assert found == pytest.approx(list(expected.values()), rel=1e-11, abs=1e-11), (q, v)
        assert model.derivatives[3:] == pytest.approx(equations.motion(x, U, equations.modes(x, U))[0], rel=1e-10)
        released += sum(expected[f"gap_{name}"] < 0 and expected[f"lam_{name}"] == 0 for name in ("foot", "hand"))
        assert expected["dissipated_power"] >= 0
    assert released >= 2


def test_directional_and_adjoint_derivatives_are_exact(drive: Callable) -> None:
    names = drive(ARM, "me", "3.0").names
    knowns = (*names.q, *names.v, *names.u)
    unknowns = (*names.der_v, *names.lam, *names.friction, "pressing_foot", "pressing_hand", "contact_energy", "dissipated_power")
    for q, v in POINTS:
        model = drive(ARM, "me", "3.0").continuous(q, v, U)
        exact = np.array([model.directional(unknowns, knowns, seed) for seed in np.eye(len(knowns))]).T
        back = np.array([model.adjoint(unknowns, knowns, seed) for seed in np.eye(len(unknowns))])
        assert back == pytest.approx(exact, rel=1e-12, abs=1e-12)
        x, h = np.array([*q, *v, *U]), 1e-6
        for column in range(len(knowns)):
            values = []
            for sign in (1.0, -1.0):
                moved = x + sign * h * np.eye(len(knowns))[column]
                model.states = moved[:6]
                model.set_all(names.u, moved[6:])
                values.append(model.get(*unknowns))
            assert exact[:, column] == pytest.approx((values[0] - values[1]) / (2 * h), rel=2e-6, abs=2e-5), (q, v, knowns[column])
        model.states = x[:6]
        model.set_all(names.u, U)


@pytest.mark.slow
def test_derivatives_by_parameters_are_exact(drive: Callable) -> None:
    names = drive(ARM, "me", "3.0").names
    unknowns = (*names.der_v, *names.lam, "pressing_foot", "pressing_hand", "contact_energy", "dissipated_power")
    for q, v in POINTS:
        model = drive(ARM, "me", "3.0").continuous(q, v, U)
        exact = np.array([model.directional(unknowns, names.parameters, seed) for seed in np.eye(len(names.parameters))]).T
        for column, parameter in enumerate(ARM.parameters):
            h, values = 1e-6 * parameter.value, []
            for sign in (1.0, -1.0):
                other = drive(ARM, "me", "3.0").initialise(q, v, U, **{parameter.name: parameter.value + sign * h})
                other.update_modes()
                values.append(other.get(*unknowns))
                other.close()
            assert exact[:, column] == pytest.approx((values[0] - values[1]) / (2 * h), rel=5e-6, abs=2e-5), (q, v, parameter.name)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [ARM, COLLISION], ids=lambda scene: scene.name)
def test_order_four_through_touch_and_release(scene: Scene) -> None:
    end = scene.task.horizon
    parts = [Piece(end / 2, np.array([12.0, 3.0])[: scene.nu]), Piece(end, np.array([-20.0, 1.0])[: scene.nu])]
    times = np.linspace(0.0, end, 61)
    truth, _ = true_motion(Equations(scene), parts, times)
    states = [item.name for item in scene.coordinates] + [item.velocity_name for item in scene.coordinates]
    inputs = None
    if scene.nu:
        rows = [(begin, *part.u) for index, part in enumerate(parts) for begin in (parts[index - 1].end if index else 0.0, part.end)]
        inputs = np.array(rows, dtype=[("time", float), *((item.name, float) for item in scene.inputs)])
    errors = []
    for step in (end / 240, end / 480, end / 9600):
        found = fmpy.simulate_fmu(
            str(build_fmu(scene)), fmi_type="CoSimulation", output=states, stop_time=end, output_interval=end / 60, input=inputs,
            start_values={"internal_step": step},
        )  # fmt: skip
        errors.append(np.abs(np.column_stack([found[name] for name in states]) - truth).max())
    assert errors[-1] < 1e-8
    assert np.log2(errors[0] / errors[1]) > 3.3
