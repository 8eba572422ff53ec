"""Units that cannot be right are found when a scene is made, and nobody is accused who leaves units out of numbers and variables."""

from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import pytest
import sympy as sp
from wording import unsaid

from models.catalog import load_scene, scene_names
from models.errors import SceneError
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.checks import check_expressions
from models.scene.contacts import Contact, DampingLaw, Friction
from models.scene.dimensions import dimension_problem
from models.scene.scene import named_expressions

q, v, theta, omega, u = sp.symbols("q v theta omega u", real=True)
m, c, k, g, l, mu, inertia = sp.symbols("m c k g l mu inertia", positive=True)  # noqa: E741 - l is the field's name for a length
UNITS = {m: "kg", c: "N s/m", k: "N/m", g: "m/s^2", l: "m", mu: "1", inertia: "kg m^2"}
HALF = sp.Rational(1, 2)


def contact(**changes: Any) -> Contact:
    fields: dict = {
        "name": "wall", "bodies": ("wall", "joint"), "penetration": q - 2, "stiffness": k,
        "depth": 1.0,
        "depth_reason": "the length of the spring",
    }  # fmt: skip
    return Contact(**(fields | changes))


def scene(units: dict[sp.Symbol, str] | None = None, push: str = "N", **changes: Any) -> Scene:
    """A cart with a pole, in which parts are changed; units: of parameters, push: of the input."""
    fields: dict = {
        "name": "own", "title": "a cart with a pole", "source": "this test",
        "coordinates": (Coordinate(symbol=q, velocity=v, unit="m"),
                        Coordinate(symbol=theta, velocity=omega, unit="rad")),
        "inputs": (Input(symbol=u, unit=push),),
        "parameters": tuple(Parameter(symbol=symbol, value=1.0, unit=unit) for symbol,
                            unit in (UNITS | (units or {})).items()),
        "kinetic_energy": m * v**2 / 2 + inertia * omega**2 / 2,
        "potential_energy": m * g * l * sp.cos(theta),
        "forces": (u - c * v, sp.Integer(0)), "contacts": (contact(),),
        "task": Task(start=(0.0,) * 4, goal=(None,) * 4, running_cost=u**2 + q + theta * v,
                     step=0.01, steps=10),
    }  # fmt: skip
    return Scene(**(fields | changes))


def wrong(**given: Any) -> str:
    with pytest.raises(SceneError) as caught:
        check_expressions(scene(**given))
    text = str(caught.value)
    assert text.startswith("scene own: ")
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"units": {m: "N"}, "potential_energy": sp.Integer(0)},
            [
                "scene own: kinetic_energy: m*v**2/2 is in kg m^3/s^4 … J; … parameter m ('N') right? 'kg' would be."
            ],
        ),
        (
            {"units": {inertia: "kg"}},
            ["kinetic_energy", "parameter inertia ('kg')", "'kg m^2' would be"],
        ),
        (
            {"units": {g: "m/s"}},
            [
                "potential_energy",
                "in N m s",
                "g ('m/s') right? 'm/s^2' would be … l ('m') right? 'm/s' would be",
            ],
        ),
        ({"units": {c: "N/m"}}, ["forces[q]: -c*v is in", "N s/m", "parameter c ('N/m')"]),
        (
            {"units": {k: "N"}},
            ["contact wall: stiffness: k is in N … must be in N/m", "parameter k"],
        ),
        (
            {"push": "N m"},
            ["forces[q]: u is in N m … must be in N", "input u ('N m')", "'N' would be"],
        ),
        ({"forces": (-c * v, u)}, ["forces[theta]: u is in N, … must be in N m"]),
        (
            {"kinetic_energy": m * (v**2 + omega**2) / 2},
            ["kinetic_energy: omega**2 is in 1/s^2 and v**2 in m^2/s^2", "an arm of 1 m"],
        ),
        (
            {"potential_energy": m * g * sp.cos(theta)},
            ["potential_energy", "is in N, but an energy", "must be a parameter"],
        ),
        (
            {"potential_energy": m * 9.81 * q + k * sp.sin(k * q) * l**2},
            ["potential_energy: sin … k*q is in N"],
        ),
        ({"potential_energy": k * l**2 * sp.exp(-g * q)}, ["exp takes a pure number", "m^2/s^2"]),
        ({"potential_energy": k * l**2 * 2 ** (q * l)}, ["an exponent … l*q is in m^2"]),
        ({"potential_energy": k * (q - l - g) ** 2 / 2}, ["-g is in m/s^2 and -l in m", "added"]),
        (
            {"contacts": (contact(penetration=l * q - 2),)},
            ["contact wall: penetration: l*q is in m^2 … in m"],
        ),
        (
            {"contacts": (contact(penetration=q - l**2),)},
            ["contact wall: penetration: -l**2 is in m^2"],
        ),
        ({"contacts": (contact(damping=k),)}, ["contact wall: damping: k is in N/m … in N s/m"]),
        (
            {"contacts": (contact(damping=c, damping_law=DampingLaw.HUNT_CROSSLEY),)},
            ["contact wall: damping: c is in N s/m … in s/m"],
        ),
        ({"contacts": (contact(depth=l**2),)}, ["contact wall: depth: l**2 is in m^2 … in m"]),
        (
            {"frictions": (Friction(name="f", slip=l * v, coefficient=mu, contact="wall"),)},
            ["friction f: slip: l*v is in m^2/s"],
        ),
        (
            {"frictions": (Friction(name="f", slip=omega - v, coefficient=mu, contact="wall"),)},
            ["friction f: slip: omega is in 1/s … in m/s"],
        ),
        (
            {"contacts": (contact(penetration=q**2),)},
            ["contact wall: penetration: q**2 is in m^2 … in m"],
        ),
        (
            {"frictions": (Friction(name="f", slip=v, coefficient=k, contact="wall"),)},
            ["friction f: coefficient: k is in N/m", "must be in 1"],
        ),
        (
            {"frictions": (Friction(name="f", slip=v, coefficient=mu, normal_force=m),)},
            ["friction f: normal_force: m is in kg … in N"],
        ),
    ],
)
def test_unit_mismatch_names_the_term(given: dict, words: list[str]):
    text = wrong(**given)
    assert not unsaid(text, *words)


class Hill(sp.Function):
    """Somebody's own: nobody knows its unit."""

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.cos(self.args[0])

    def _ccode(self, printer) -> str:
        return f"sin({printer._print(self.args[0])})"

    def _eval_evalf(self, prec: int) -> sp.Expr:
        return sp.sin(self.args[0]).evalf()


@pytest.mark.parametrize("changes", [
    {}, {"kinetic_energy": v**2 / 2 + omega**2 / 2},
    {"kinetic_energy": 0.5 * m * v**2 + inertia * omega**2 / 24},
    {"potential_energy": m * 9.81 * q},
    {"potential_energy": -2 * q**2 + sp.cos(theta)}, {"potential_energy": 7.5},
    {"potential_energy": k * (q - 2) ** 2 / 2 + k * (q - 1.5) ** 2 / 2},
    {"potential_energy": k * sp.sqrt(q**2 + 1e-6) * l + m * g * (q + sp.sqrt(2) / 3)},
    {"potential_energy": m * g * Hill(k * q)},
    {"potential_energy": k * l**2 * sp.log(sp.cosh(q / l)) + k * l ** sp.Rational(3,
        2) * sp.sqrt(l + sp.exp(q / l) * l)},
    {"forces": (u * (1 - q) - 3 * v, sp.Integer(0))},
    {"forces": (u - m * g * sp.tanh(v / 0.01) - m * g * sp.tanh(100 * v), sp.Integer(0))},
    {"forces": (-c * v - sp.tanh(v) * q**2, u * l * sp.atan2(l, q))},
    {"forces": (u - m * g * sp.erf((v * c / k) / 0.1), -0.03 * omega)},
    {"contacts": (contact(penetration=l * (theta - HALF), stiffness=k / 2, damping=3),)},
    {"contacts": (contact(penetration=1.0 * sp.sin(theta) + q - 1, stiffness=40, depth=sp.Max(l, 2 * l)),
                  )},
    {"contacts": (contact(damping=HALF / 3, damping_law=DampingLaw.HUNT_CROSSLEY),)},
    {"frictions": (Friction(name="f", slip=v + omega / 5, coefficient=mu * 2,
                            normal_force=m * g * (1 + q**2 / 10)),)},
    {"frictions": (Friction(name="f", slip=v * sp.cos(theta) - l * omega, coefficient=0.4,
                            normal_force=12),)},
    {"task": Task(start=(0.0,) * 4, goal=(None,) * 4, running_cost=u**2 + m * k * q + omega,
                  step=0.01, steps=10, final_cost=m + q)},
])  # fmt: skip
def test_numbers_and_variables_may_hide_units(changes: dict):
    assert dimension_problem(scene(**changes)) is None


def test_a_number_that_is_1_hides_no_unit_of_a_parameter():
    """Beside a variable it may be a pure number.

    Beside a parameter it has that parameter's unit.
    """
    assert dimension_problem(scene(forces=(u * (1 + mu), sp.Integer(0)))) is None
    assert "forces[q]" in wrong(forces=(u * (1 + l), sp.Integer(0)))


def test_a_throttle_of_no_unit_needs_the_force_it_stands_for():
    assert dimension_problem(scene(push="1", forces=(30 * u, sp.Integer(0)))) is None
    assert "input u ('1') right? 'N' would be" in wrong(push="1", forces=(u, sp.Integer(0)))


@pytest.mark.parametrize("name", scene_names())
def test_the_bank_fits_and_is_read_at_once(name: str):
    """Alone it takes 2 ms at most; CPU seconds, which other processes do not cost."""
    known = load_scene(name)
    began = process_time()
    assert dimension_problem(known) is None
    assert process_time() - began < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted((Path(__file__).parents[1] / "scenes").glob("*.py")), ids=lambda path: path.stem
)
def test_the_scenes_of_the_tests_fit(path: Path):
    assert dimension_problem(load_scene(str(path))) is None


@pytest.mark.parametrize("name", scene_names())
def test_any_parameter_of_another_unit_is_noticed(name: str):
    """Each parameter in a unit that no formula of it has, of all scenes."""
    known = load_scene(name)
    asked = sp.Add(
        *(
            sp.Dummy() * sp.sympify(item.expression)
            for item in named_expressions(known)
            if item.unit is not None
        )
    ).free_symbols
    for index, parameter in enumerate(known.parameters):
        if (
            parameter.symbol in asked and index != known.relaxation_index
        ):  # whose unit is given by the scene itself
            odd = replace(parameter, unit=f"kg^3 s^7 {parameter.unit}")
            assert dimension_problem(
                replace(
                    known,
                    parameters=(*known.parameters[:index], odd, *known.parameters[index + 1 :]),
                )
            ), parameter


@pytest.mark.slow
@pytest.mark.parametrize("odd", [False, True])
@pytest.mark.parametrize("combined", [sp.Add, sp.Mul])
def test_a_huge_expression_is_read_at_once(combined: type, odd: bool):
    """Three thousand terms or factors, and one of them wrong: 0.1 s, which grows with their number alone."""
    energy = (
        m * g * l * combined(*((q / l + number) ** 2 for number in range(3000)), evaluate=False)
    )
    made = scene(potential_energy=energy, units={l: "m^2"} if odd else {})
    began = process_time()
    problem = dimension_problem(made)
    assert process_time() - began < 5.0
    assert (problem is not None) == odd
    assert problem is None or len(problem) < 500


def test_a_deep_expression_is_read():
    energy = theta
    for _ in range(150):
        energy = sp.sin(energy)
    assert dimension_problem(scene(potential_energy=m * g * l * energy)) is None
    assert "exp" not in (dimension_problem(scene(potential_energy=m * g * energy)) or "exp")
