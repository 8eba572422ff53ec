"""A scene as the report shows it: each quantity with its own words, each equation as it is written by hand."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen.emit import step_operations
from models.dynamics import derive
from models.scene import Limit
from reports.pages.scene import safe_mathml
from reports.records.record import ContactRecord, QuantityRecord
from validate.tasks import scene_record as module
from validate.tasks.scene_record import equations, presentation, scene_record

EQUATIONS = {
    # Kelvin-Voigt and Hunt-Crossley, no input, no cost.
    "damped_collision": """
        motion of q1: Eq(m1*Derivative(v1, t), lambda_bumper - lambda_pair)
        motion of q2: Eq(m2*Derivative(v2, t), lambda_pair)
        penetration of contact pair (its gap is the negative): Eq(phi_pair, q1 - q2 + 2*r)
        rate of penetration of contact pair: Eq(Derivative(phi_pair, t), v1 - v2)
        force of contact pair, Kelvin-Voigt without adhesion, where its penetration is positive; elsewhere 0: Eq(lambda_pair, Max(0, c*Derivative(phi_pair, t) + k*phi_pair))
        penetration of contact bumper (its gap is the negative): Eq(phi_bumper, -q1 + r - 1/2)
        rate of penetration of contact bumper: Eq(Derivative(phi_bumper, t), -v1)
        force of contact bumper, Hunt-Crossley: Eq(lambda_bumper, b*Max(0, phi_bumper)*Max(0, d*Derivative(phi_bumper, t) + 1))
        time step of v1, contact forces at its start: Eq(m1*(-v1 + v1__t+1), h*(lambda_bumper - lambda_pair))
        time step of v2, contact forces at its start: Eq(m2*(-v2 + v2__t+1), h*lambda_pair)
        time step of q1: Eq(q1__t+1, h*v1__t+1 + q1)
        time step of q2: Eq(q2__t+1, h*v2__t+1 + q2)
        cost, summed over the steps: Eq(J, Sum(0, (t, 0, T - 1)))""",
    "transport": """
        motion of cargo: Eq(m*Derivative(v_cargo, t), friction_belt - lambda_front + lambda_rear)
        motion of cart: Eq(m_c*Derivative(v_cart, t), -friction_belt + lambda_front - lambda_rear + u)
        penetration of contact front (its gap is the negative): Eq(phi_front, cargo - cart - half)
        force of contact front: Eq(lambda_front, k*Max(0, phi_front))
        penetration of contact rear (its gap is the negative): Eq(phi_rear, -cargo + cart - half)
        force of contact rear: Eq(lambda_rear, k*Max(0, phi_rear))
        slip speed of friction belt: Eq(slip_belt, v_cargo - v_cart)
        largest force of friction belt: Abs(friction_belt) <= g*m*mu
        force of friction belt where it slips; where it sticks, the slip is zero: Eq(friction_belt, -g*m*mu*sign(slip_belt))
        time step of v_cargo, contact forces at its start, friction to the slip at its end: Eq(m*(-v_cargo + v_cargo__t+1), h*(friction_belt - lambda_front + lambda_rear))
        time step of v_cart, contact forces at its start, friction to the slip at its end: Eq(m_c*(-v_cart + v_cart__t+1), h*(-friction_belt + lambda_front - lambda_rear + u))
        time step of cargo: Eq(cargo__t+1, cargo + h*v_cargo__t+1)
        time step of cart: Eq(cart__t+1, cart + h*v_cart__t+1)
        cost, summed over the steps: Eq(J, Sum(0.0001*u**2, (t, 0, T - 1)))""",
}


@pytest.mark.parametrize("name", EQUATIONS)
def test_each_equation_stands_in_its_place(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "presentation", str)
    found = [f"{item.caption}: {item.mathml}" for item in equations(derive(load_scene(name)))]
    assert found == [line.strip() for line in EQUATIONS[name].strip().splitlines()]


def test_the_cost_of_the_last_state_is_added_to_the_sum(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "presentation", str)
    last = equations(derive(load_scene("two_discs")))[-1]
    assert (last.caption, last.mathml) == ("cost of the last state, added to that sum", "Eq(J_T, x2**2 + y2**2)")


def test_what_friction_is_limited_by_is_named_as_the_forces_are(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "presentation", str)
    limits = [item.mathml for item in equations(derive(load_scene("push_box"))) if "friction" in item.caption]
    assert any("lambda_" in text for text in limits)
    assert not any("lam_" in text for text in limits)


def test_a_force_is_greek_by_the_beginning_of_its_name_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "presentation", str)
    scene = load_scene("transport")
    first, *others = scene.contacts
    found = " ".join(item.mathml for item in equations(derive(replace(scene, contacts=(replace(first, name="slam_wall"), *others)))))
    assert "lambda_slam_wall" in found
    assert "slambda" not in found


def test_equations_are_mathml_the_report_accepts():
    for equation in scene_record(load_scene("three_cart")).equations:
        assert safe_mathml(equation.mathml) is not None
        assert ElementTree.fromstring(equation.mathml).tag.endswith("math")


def test_mathml_is_a_block_whose_signs_any_parser_reads():
    x, lam = sp.symbols("x lambda")
    text = presentation(sp.Lt(x, lam))
    assert "&lt;" in text
    assert safe_mathml(text) is not None
    root = ElementTree.fromstring(text)
    assert root.get("display") == "block"
    assert [item.text for item in root.iter() if item.text] == ["x", "<", "λ"]


@pytest.mark.parametrize("name", ["three_cart", "two_finger", "transport"])
def test_a_scene_record_says_each_quantity_with_its_own_words(name: str):
    scene = load_scene(name)
    record, values = scene_record(scene), scene.parameter_values

    def said(items):
        return tuple(QuantityRecord(name=item.name, unit=item.unit, description=item.description) for item in items)

    assert (record.name, record.title, record.source, record.unstable) == (scene.name, scene.title, scene.source, scene.unstable)
    assert record.coordinates == said(scene.coordinates)
    assert record.inputs == said(scene.inputs)
    assert record.velocities == tuple(
        QuantityRecord(name=item.velocity_name, unit=item.velocity_unit, description=f"velocity of {item.description}")
        for item in scene.coordinates
    )
    assert record.parameters == tuple(
        QuantityRecord(name=item.name, unit=item.unit, description=item.description, value=item.value) for item in scene.parameters
    )
    assert record.contacts == tuple(
        ContactRecord(
            name=item.name,
            unit="N/m",
            description=item.description,
            bodies=item.bodies,
            value=float(sp.sympify(item.stiffness).subs(values)),
        )
        for item in scene.contacts
    )
    assert record.frictions == tuple(
        QuantityRecord(name=item.force_name, unit="1", description=item.description, value=float(sp.sympify(item.coefficient).subs(values)))
        for item in scene.frictions
    )
    assert record.answers == tuple(
        QuantityRecord(name=item.quantity, unit="", description=item.source, value=item.value) for item in scene.answers
    )
    assert [(item.name, item.kind, item.size) for item in record.shapes] == [
        (item.name, item.kind, tuple(float(sp.sympify(size).subs(values)) for size in item.size)) for item in scene.shapes
    ]
    assert (record.start, record.goal, record.step, record.steps) == (scene.task.start, scene.task.goal, scene.task.step, scene.task.steps)
    assert record.operations == vars(step_operations(scene))
    assert record.absent == derive(scene).absent


def test_three_carts_by_hand():
    record = scene_record(load_scene("three_cart"))
    assert "friction" in record.absent
    assert [(shape.name, shape.size) for shape in record.shapes] == [(name, (0.5, 0.5)) for name in ("left", "middle", "right")]
    assert [(contact.value, contact.bodies) for contact in record.contacts] == [(30.0, ("left", "middle")), (30.0, ("middle", "right"))]


def test_what_has_no_words_is_called_by_its_name():
    scene = load_scene("transport")
    silent = replace(
        scene,
        coordinates=tuple(replace(item, description="") for item in scene.coordinates),
        frictions=tuple(replace(item, description="") for item in scene.frictions),
    )
    record = scene_record(silent)
    assert [item.description for item in record.velocities] == ["velocity of cargo", "velocity of cart"]
    assert [item.description for item in record.frictions] == ["belt"]


def test_limits_that_are_waived_stand_with_their_reasons():
    scene = load_scene("wall_pendulum")
    waived = Limit(metric="ghost_impulse", value=None, reason="the first reason")
    kept = Limit(metric="missed_impulse", value=0.5, reason="the second reason")
    asked = replace(scene, limits=(waived, kept))
    assert scene_record(asked).waived == ("ghost_impulse: the first reason",)


def test_a_body_whose_place_the_goal_leaves_open_or_that_never_moves_has_no_goal():
    goals = {shape.name: shape.goal for shape in scene_record(load_scene("hopper_planar")).shapes}
    assert goals == {"body": (2.0, 1.0, 0.0), "leg": None, "foot": None, "floor": None}
    assert [shape.goal for shape in scene_record(load_scene("three_cart")).shapes] == [(x, 0.25, 0.0) for x in (2.5, 3.5, 4.5)]
