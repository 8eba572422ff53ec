"""Dry friction and damped contacts in the FMU: true stiction, located stick-slip and releases, against closed forms, SymPy and an independent integration."""

import math
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import fmpy
import numpy as np
import pytest
import sympy as sp
from fmpy.validation import validate_fmu

from models.catalog import load_scene
from models.fmu import build_fmu
from models.scene import Coordinate, Input, Scene, Task
from models.scene.contacts import Contact, Friction
from models.scene.parts import goal_limits
from tests.models.fmu.scene_outputs import scene_outputs
from tests.models.test_friction import (
    g,
    k,
    m,
    mu,
    push,
    two_coupled_frictions,
    w1,
    w2,
    wz,
    x1,
    x2,
    z,
)
from validate.truth.exact_motion import Equations, Piece, true_motion

PARAMETERS = two_coupled_frictions().parameters


def block(**changes: object) -> Scene:
    """A block of 2 kg on a table; friction holds it with up to 6 N."""
    fields: dict = {
        "name": "block_on_a_table", "title": "A block on a table", "source": "own",
        "coordinates": (Coordinate(symbol=x1, velocity=w1, unit="m"),),
        "inputs": (Input(symbol=push, unit="N"),),
        "parameters": PARAMETERS[:3], "kinetic_energy": m * w1**2 / 2,
        "potential_energy": sp.Integer(0), "forces": (push,), "contacts": (),
        "frictions": (Friction(name="table", slip=w1, coefficient=mu, normal_force=m * g),),
        "task": Task(start=(0.0, 0.9), goal=(0.0, 0.0), running_cost=push**2, step=0.01, steps=100),
        "limits": goal_limits(position=0.01, velocity=0.01, reason="this test"),
    }  # fmt: skip
    return Scene(**(fields | changes))


def mass_on_a_belt() -> Scene:
    """A mass on a spring, carried by a heavy belt of equal mass at 1 m/s: it sticks until the spring pulls too hard."""
    return block(
        name="mass_on_a_belt", inputs=(), parameters=PARAMETERS, potential_energy=k * x1**2 / 2,
        forces=(sp.Integer(0), sp.Integer(0)),
        coordinates=(Coordinate(symbol=x1, velocity=w1, unit="m"),
                     Coordinate(symbol=x2, velocity=w2, unit="m")),
        kinetic_energy=m * w1**2 / 2 + m * w2**2 / 2,
        frictions=(Friction(name="table", slip=w1 - w2, coefficient=mu, normal_force=m * g),),
        task=Task(start=(0.0, 0.0, 1.0, 1.0), goal=(0.0,) * 4, running_cost=sp.Integer(0),
                  step=0.01, steps=100),
    )  # fmt: skip


def sledge(*frictions: Friction) -> Scene:
    """A sledge that bounces on two runners of unequal stiffness, with these frictions."""
    springs = (("front", k), ("rear", 3 * k))
    return block(
        name="sledge",
        parameters=PARAMETERS,
        coordinates=(
            Coordinate(symbol=x1, velocity=w1, unit="m"),
            Coordinate(symbol=z, velocity=wz, unit="m"),
        ),
        kinetic_energy=m * (w1**2 + wz**2) / 2,
        potential_energy=m * g * z,
        forces=(push, sp.Integer(0)),
        contacts=tuple(
            Contact(name=name, bodies=("sledge", "ground"), depth=1.0,
                    depth_reason="nothing here goes as deep", penetration=-z, stiffness=stiffness)
            for name, stiffness in springs
        ),
        frictions=frictions,
        task=Task(start=(0.0, -0.02, 0.9, 0.0), goal=(0.0,) * 4, running_cost=push**2, step=0.01,
                  steps=100),
    )  # fmt: skip


RUNNERS = sledge(
    *(Friction(name=name, slip=w1, coefficient=mu, contact=name) for name in ("front", "rear"))
)
SOLE = sledge(Friction(name="sole", slip=w1, coefficient=mu, contact=("front", "rear")))
SCENES = [block(), mass_on_a_belt(), two_coupled_frictions()]
SHARES = (9.0, -25.0, 0.0, 13.0)


def pieces(scene: Scene) -> list[Piece]:
    quarter = scene.task.horizon / 4
    return [
        Piece(quarter * (index + 1), np.full(scene.nu, force)) for index, force in enumerate(SHARES)
    ]


def signal(scene: Scene, parts: list[Piece]) -> np.ndarray | None:
    """Inputs as FMPy takes them."""
    spans = pairwise([0.0, *(part.end for part in parts)])
    rows = [(time, *part.u) for span, part in zip(spans, parts, strict=True) for time in span]
    return (
        np.array(rows, dtype=[("time", float), *((item.name, float) for item in scene.inputs)])
        if scene.nu
        else None
    )


def simulate(
    scene: Scene,
    outputs: list[str],
    *,
    version: str = "2.0",
    kind: str = "CoSimulation",
    **options: object,
) -> dict[str, np.ndarray]:
    settings: dict = {
        "stop_time": scene.task.horizon,
        "output_interval": 0.01,
        "input": signal(scene, pieces(scene)),
    } | options
    result = fmpy.simulate_fmu(
        str(build_fmu(scene, version)), fmi_type=kind, output=outputs, **settings
    )
    return {name: result[name] for name in ("time", *outputs)}


def states(scene: Scene) -> list[str]:
    return [item.name for item in scene.coordinates] + [
        item.velocity_name for item in scene.coordinates
    ]


def errors_of(
    scene: Scene, parts: list[Piece], times: np.ndarray, steps: tuple[float, ...]
) -> list[float]:
    """The largest difference of a state from the true motion with each internal step."""
    truth = true_motion(Equations(scene), parts, times)
    how = {"stop_time": times[-1], "output_interval": times[1], "input": signal(scene, parts)}
    found = [
        simulate(scene, states(scene), start_values={"internal_step": step}, **how)
        for step in steps
    ]
    return [
        np.abs(np.column_stack([rows[name] for name in states(scene)]) - truth).max()
        for rows in found
    ]


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_order_four_through_stick_and_slip(scene: Scene) -> None:
    errors = errors_of(scene, pieces(scene), np.arange(101) * 0.01, (1e-2, 5e-3, 1e-3))
    assert errors[-1] < 2e-9
    assert errors[0] < 1e-11 or math.log2(errors[0] / errors[1]) > 3.5


@pytest.mark.slow
def test_block_comes_to_rest_where_the_closed_form_says_and_stays() -> None:
    scene = block(
        inputs=(),
        forces=(sp.Integer(0),),
        task=Task(start=(0.0, 0.9), goal=(0.0, 0.0), running_cost=sp.S.Zero, step=0.1, steps=1000),
    )
    found = simulate(
        scene,
        ["x1", "w1", "friction_table"],
        output_interval=0.1,
        stop_time=100.0,
        start_values={"internal_step": 0.05},
    )
    assert found["x1"][-1] == pytest.approx(0.9**2 / (2 * 3.0), abs=1e-12)
    assert np.ptp(found["x1"][4:]) < 1e-12  # 99.6 s of rest
    assert np.abs(found["w1"][4:]).max() < 1e-13
    assert np.abs(found["friction_table"][4:]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("force", "slips"), [(5.999, False), (6.001, True), (-5.999, False), (-6.001, True)]
)
def test_block_at_rest_sticks_up_to_mu_m_g(force: float, slips: bool) -> None:
    scene = block(
        task=Task(start=(0.0, 0.0), goal=(0.0, 0.0), running_cost=push**2, step=0.01, steps=100)
    )
    held = np.array([(0.0, force), (1.0, force)], dtype=[("time", float), ("push", float)])
    for kind in ("CoSimulation", "ModelExchange"):
        found = simulate(scene, ["x1", "friction_table"], kind=kind, input=held)
        expected = math.copysign(0.5 * (abs(force) - 6.0) / 2.0, force) if slips else 0.0
        assert found["x1"][-1] == pytest.approx(
            expected, abs=1e-12 if kind == "CoSimulation" else 1e-6
        )
        assert found["friction_table"][-1] == pytest.approx(
            -math.copysign(min(abs(force), 6.0), force), abs=1e-9
        )


def test_mass_on_a_belt_slips_when_the_spring_asks_for_more_than_mu_m_g() -> None:
    both, alone = (
        math.sqrt(200.0 / 4.0),
        math.sqrt(200.0 / 2.0),
    )  # carried together, friction is half of the spring's force
    leaves = math.asin(both * (2 * 6.0 / 200.0) / 1.0) / both
    found = simulate(
        mass_on_a_belt(),
        ["x1", "slip_table", "friction_table"],
        output_interval=1e-3,
        start_values={"internal_step": 1e-4},
    )
    time = found["time"]
    sticks = time < leaves
    assert np.abs(found["slip_table"][sticks]).max() < 1e-13
    assert np.allclose(found["x1"][sticks], np.sin(both * time[sticks]) / both, rtol=0, atol=1e-12)
    assert np.allclose(
        found["friction_table"][sticks], 100.0 * found["x1"][sticks], rtol=0, atol=1e-9
    )
    x, v, mean = 0.06, math.cos(both * leaves), 6.0 / 200.0
    after = (time > leaves) & (time < leaves + 0.02)
    angle = alone * (time[after] - leaves)
    assert np.allclose(
        found["x1"][after],
        mean + (x - mean) * np.cos(angle) + v / alone * np.sin(angle),
        rtol=0,
        atol=1e-11,
    )
    assert (found["slip_table"][after] < 0).all()


def test_energy_balance_closes_through_stick_and_slip() -> None:
    scene = two_coupled_frictions()
    names = [
        "kinetic_energy",
        "potential_energy",
        "contact_energy",
        "input_power",
        "dissipated_power",
    ]
    found = simulate(scene, names, output_interval=2.5e-4)
    energy = found["kinetic_energy"] + found["potential_energy"] + found["contact_energy"]
    power = found["input_power"] - found["dissipated_power"]
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(found["time"]))])
    jumps = (
        4 * 25.0 * np.abs(found["input_power"]).max() * 2.5e-4 / 25.0
    )  # the trapezoid rule across four jumps of the input
    assert np.abs(energy - energy[0] - work).max() < jumps
    assert found["dissipated_power"].min() >= 0.0


@pytest.mark.slow
def test_sources_hold_friction_only_where_the_scene_has_it(tmp_path: Path) -> None:
    frictionless = block(frictions=(), name="sliding_block")
    with zipfile.ZipFile(build_fmu(frictionless)) as archive:
        assert not {"sources/friction.h", "sources/friction_modes.h"} & set(archive.namelist())
    with zipfile.ZipFile(build_fmu(block())) as archive:
        assert {"sources/friction.h", "sources/friction_modes.h"} <= set(archive.namelist())


def flying_block(speed: float) -> Scene:
    """A block thrown along a soft floor from 0.5 m above it: it lands after 0.316 s."""
    return block(
        name="flying_block",
        coordinates=(Coordinate(symbol=x1, velocity=w1, unit="m"),
                     Coordinate(symbol=z, velocity=wz, unit="m")),
        parameters=PARAMETERS, kinetic_energy=m * (w1**2 + wz**2) / 2, potential_energy=m * g * z,
        forces=(push, sp.Integer(0)),
        contacts=(Contact(name="floor", bodies=("block", "ground"), depth=1.0,
                          depth_reason="nothing here goes as deep", penetration=-z, stiffness=k),),
        frictions=(Friction(name="floor", slip=w1, coefficient=mu, contact="floor"),),
        task=Task(start=(0.0, 0.5, speed, 0.0), goal=(0.0,) * 4, running_cost=push**2, step=0.01,
                  steps=30),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_a_slip_that_passes_zero_in_flight_is_no_sticking(kind: str) -> None:
    """Pulled back by 2 m/s^2 it turns around after 0.25 s, with nothing that presses it."""
    scene = flying_block(0.5)
    held = np.array([(0.0, -4.0), (0.3, -4.0)], dtype=[("time", float), ("push", float)])
    found = simulate(
        scene, ["x1", "w1", "friction_floor"], kind=kind, input=held, output_interval=0.3
    )
    assert found["x1"][-1] == pytest.approx(
        0.5 * 0.3 - 0.3**2, abs=1e-12 if kind == "CoSimulation" else 1e-6
    )
    assert found["friction_floor"][-1] == 0.0
    truth = true_motion(Equations(scene), [Piece(0.3, np.array([-4.0]))], np.array([0.3]))
    assert truth[0, :1] == pytest.approx([0.5 * 0.3 - 0.3**2], abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_a_block_dropped_straight_down_stays_on_its_line(kind: str) -> None:
    """Neither in flight nor when it lands is there any slip, so friction has nothing to push against."""
    scene = flying_block(0.0).with_task(steps=100)
    still = np.array([(0.0, 0.0), (1.0, 0.0)], dtype=[("time", float), ("push", float)])
    found = simulate(scene, ["x1", "z", "friction_floor"], kind=kind, input=still)
    assert found["z"].min() < -0.2
    assert np.abs(found["x1"]).max() < 1e-8
    assert np.abs(found["friction_floor"]).max() < 1e-6


ARM = load_scene(str(Path(__file__).parents[2] / "scenes" / "damped_arm.py"))
COLLISION = load_scene("damped_collision")
# Away from all boundaries: foot and hand press; the hand is released while it touches; foot and
# bumper are released or open.
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
    count = (
        description.numberOfEventIndicators
        if version == "2.0"
        else len(description.eventIndicators)
    )
    assert count == scene.nc + scene.nf + 2
    units = {variable.name: variable.unit for variable in description.modelVariables}
    assert [units[scene.contacts[index].pressing_name] for index in scene.damped] == ["1", "1"]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_outputs_and_accelerations_are_those_of_the_equations(
    drive: Callable, version: str
) -> None:
    equations, released = Equations(ARM), 0
    for q, v in POINTS:
        model = drive(ARM, "me", version).continuous(q, v, U)
        x = np.array([*q, *v])
        expected = scene_outputs(equations, x, U)
        found = model.get(*expected)
        assert found == pytest.approx(list(expected.values()), rel=1e-11, abs=1e-11), (q, v)
        assert model.derivatives[3:] == pytest.approx(
            equations.motion(x, U, equations.modes(x, U))[0], rel=1e-10
        )
        released += sum(
            expected[f"gap_{name}"] < 0 and expected[f"lam_{name}"] == 0
            for name in ("foot", "hand")
        )
        assert expected["dissipated_power"] >= 0
    assert released >= 2


def test_directional_and_adjoint_derivatives_are_exact(drive: Callable) -> None:
    names = drive(ARM, "me", "3.0").names
    knowns = (*names.q, *names.v, *names.u)
    unknowns = (
        *names.der_v,
        *names.lam,
        *names.friction,
        "pressing_foot",
        "pressing_hand",
        "contact_energy",
        "dissipated_power",
    )
    for q, v in POINTS:
        model = drive(ARM, "me", "3.0").continuous(q, v, U)
        exact = np.array(
            [model.directional(unknowns, knowns, seed) for seed in np.eye(len(knowns))]
        ).T
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
            assert exact[:, column] == pytest.approx(
                (values[0] - values[1]) / (2 * h), rel=2e-6, abs=2e-5
            ), (q, v, knowns[column])
        model.states = x[:6]
        model.set_all(names.u, U)


@pytest.mark.slow
def test_derivatives_by_parameters_are_exact(drive: Callable) -> None:
    names = drive(ARM, "me", "3.0").names
    unknowns = (
        *names.der_v,
        *names.lam,
        "pressing_foot",
        "pressing_hand",
        "contact_energy",
        "dissipated_power",
    )
    for q, v in POINTS:
        model = drive(ARM, "me", "3.0").continuous(q, v, U)
        exact = np.array(
            [
                model.directional(unknowns, names.parameters, seed)
                for seed in np.eye(len(names.parameters))
            ]
        ).T
        for column, parameter in enumerate(ARM.parameters):
            h, values = 1e-6 * parameter.value, []
            for sign in (1.0, -1.0):
                other = drive(ARM, "me", "3.0").initialise(
                    q, v, U, **{parameter.name: parameter.value + sign * h}
                )
                other.update_modes()
                values.append(other.get(*unknowns))
                other.close()
            assert exact[:, column] == pytest.approx(
                (values[0] - values[1]) / (2 * h), rel=5e-6, abs=2e-5
            ), (q, v, parameter.name)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [ARM, COLLISION], ids=lambda scene: scene.name)
def test_order_four_through_touch_and_release(scene: Scene) -> None:
    end = scene.task.horizon
    parts = [
        Piece(end / 2, np.array([12.0, 3.0])[: scene.nu]),
        Piece(end, np.array([-20.0, 1.0])[: scene.nu]),
    ]
    errors = errors_of(scene, parts, np.linspace(0.0, end, 61), (end / 240, end / 480, end / 9600))
    assert errors[-1] < 1e-8
    assert np.log2(errors[0] / errors[1]) > 3.3


def test_frictions_of_one_slip_move_as_one_that_both_contacts_press() -> None:
    """They share the force as their limits are, and stick and slip at the same times."""
    shares = ["friction_front", "friction_rear"]
    gentle = signal(SOLE, [Piece(part.end, 0.4 * part.u) for part in pieces(SOLE)])
    how: dict = {"output_interval": 0.001, "input": gentle}
    both = simulate(RUNNERS, [*states(RUNNERS), *shares], **how)
    one = simulate(SOLE, states(SOLE), **how)
    for name in states(SOLE):
        assert both[name] == pytest.approx(one[name], rel=0, abs=1e-9), name
    assert both[shares[1]] == pytest.approx(3.0 * both[shares[0]], rel=1e-9, abs=1e-12)
    assert 0.1 < np.mean(np.abs(both["w1"]) < 1e-12) < 0.9


def test_derivatives_of_shared_sticking_forces_are_exact(drive: Callable) -> None:
    names = drive(RUNNERS, "me", "3.0").names
    knowns, unknowns = (*names.q, *names.v, *names.u), (*names.der_v, *names.friction)
    model = drive(RUNNERS, "me", "3.0").continuous([0.1, -0.02], [0.0, 0.3], np.array([1.5]))
    exact = np.array([model.directional(unknowns, knowns, seed) for seed in np.eye(len(knowns))]).T
    back = np.array([model.adjoint(unknowns, knowns, seed) for seed in np.eye(len(unknowns))])
    assert exact[names.der_v.index("der(w1)")] == pytest.approx(0.0, abs=1e-12)
    assert exact[-2:, knowns.index("push")] == pytest.approx([-0.25, -0.75])
    assert back == pytest.approx(exact, rel=1e-12, abs=1e-12)
