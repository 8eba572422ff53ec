"""Record of a scene for the report: names, units, start, goal, and equations as MathML."""

from __future__ import annotations

import hashlib
import html
import json
import re
from collections.abc import Mapping
from pathlib import Path

import sympy as sp
from sympy.printing.mathml import mathml

from models.codegen.emit import step_operations
from models.codegen.text_cache import cached_text
from models.dynamics import Dynamics, derive
from models.kinematics import goal_poses, shape_places
from models.results.run import (
    FINAL_COST,
    ContactRecord,
    EquationRecord,
    QuantityRecord,
    SceneRecord,
    ShapeRecord,
)
from models.scene import Coordinate, Input, Parameter, Scene
from models.scene.contacts import Contact, DampingLaw

_ENTITY = re.compile(r"&([A-Za-z]+);")
# XML's own names; SymPy's other entities are HTML's, which strict parsers refuse.
_XML_NAMES = frozenset({"lt", "gt", "amp", "quot", "apos"})
# Key of cached equations: this file's text.
_WRITER = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:12]


def scene_record(scene: Scene) -> SceneRecord:
    """Return the record of a scene; equations are cached (0.3 to 1.5 CPU s)."""
    dynamics = derive(scene)
    contacts = [
        ContactRecord(
            name=contact.name,
            unit="N/m",
            description=contact.description,
            value=float(sp.sympify(stiffness).subs(scene.parameter_values)),
            bodies=contact.bodies,
        )
        for contact, stiffness in zip(scene.contacts, dynamics.stiffness, strict=True)
    ]
    return SceneRecord(
        name=scene.name,
        title=scene.title,
        source=scene.source,
        coordinates=tuple(map(_quantity, scene.coordinates)),
        velocities=tuple(
            QuantityRecord(
                name=item.velocity_name,
                unit=item.velocity_unit,
                description=f"velocity of {item.description or item.name}",
            )
            for item in scene.coordinates
        ),
        inputs=tuple(map(_quantity, scene.inputs)),
        contacts=tuple(contacts),
        frictions=tuple(
            QuantityRecord(
                name=item.force_name,
                unit="1",
                description=item.description or item.name,
                value=float(item.coefficient.subs(scene.parameter_values)),
            )
            for item in scene.frictions
        ),
        parameters=tuple(_quantity(item, item.value) for item in scene.parameters),
        start=tuple(float(value) for value in scene.task.start),
        goal=scene.task.goal,
        step=scene.task.step,
        steps=scene.task.steps,
        equations=_cached_equations(scene, dynamics),
        absent=dynamics.absent,
        answers=tuple(
            QuantityRecord(
                name=answer.quantity, unit="", description=answer.source, value=float(answer.value)
            )
            for answer in scene.answers
        ),
        shapes=tuple(
            ShapeRecord(
                name=shape.name,
                kind=shape.kind,
                size=tuple(
                    float(sp.sympify(size).subs(scene.parameter_values)) for size in shape.size
                ),
                place=place,
                goal=goal,
            )
            for shape, place, goal in zip(
                scene.shapes, shape_places(scene), goal_poses(scene), strict=True
            )
        ),
        waived=tuple(
            f"{limit.metric}: {limit.reason}" for limit in scene.limits if limit.value is None
        ),
        unstable=scene.unstable,
        operations=step_operations(scene),
    )


def _quantity(item: Coordinate | Input | Parameter, value: float | None = None) -> QuantityRecord:
    return QuantityRecord(name=item.name, unit=item.unit, description=item.description, value=value)


def _cached_equations(scene: Scene, dynamics: Dynamics) -> tuple[EquationRecord, ...]:
    def made() -> str:
        return json.dumps([[item.caption, item.mathml] for item in equations(dynamics)])

    pairs = json.loads(cached_text(scene, f"equations-{_WRITER}.json", made))
    return tuple(EquationRecord(caption=caption, mathml=text) for caption, text in pairs)


def equations(dynamics: Dynamics) -> tuple[EquationRecord, ...]:
    """Return equations of motion, gaps, contact law, time step and cost of a scene, in order."""
    captioned: list[tuple[str, sp.Basic]] = []
    time, step = sp.Symbol("t", real=True), sp.Symbol("h", positive=True)
    # Contact forces as printed: lambda_left for lam_left.
    greek = {
        lam: sp.Symbol(f"lambda_{lam.name.removeprefix('lam_')}", real=True) for lam in dynamics.lam
    }
    force = dynamics.generalised_force.subs(greek)
    rate = sp.Matrix([sp.Derivative(velocity, time, evaluate=False) for velocity in dynamics.v])
    inertia = dynamics.mass_matrix * rate
    for row, coordinate in enumerate(dynamics.scene.coordinates):
        captioned.append((f"motion of {coordinate.name}", _equation(inertia[row], force[row])))
    for contact, phi, k, lam in zip(
        dynamics.scene.contacts,
        dynamics.penetration,
        dynamics.stiffness,
        greek.values(),
        strict=True,
    ):
        depth = sp.Symbol(f"phi_{contact.name}", real=True)
        captioned.append(
            (
                f"penetration of contact {contact.name} (its gap is the negative)",
                _equation(depth, phi),
            )
        )
        if contact.is_damped:
            captioned += _damped_force(dynamics, contact, depth, lam)
        else:
            captioned.append(
                (
                    f"force of contact {contact.name}",
                    _equation(lam, sp.Mul(k, sp.Max(depth, 0), evaluate=False)),
                )
            )
    captioned += _friction_equations(dynamics, greek)
    belongs = ", friction to the slip at its end" if dynamics.f else ""
    after = [sp.Symbol(f"{velocity.name}__t+1", real=True) for velocity in dynamics.v]
    gain = dynamics.mass_matrix * sp.Matrix(
        [new - old for new, old in zip(after, dynamics.v, strict=True)]
    )
    for row, coordinate in enumerate(dynamics.scene.coordinates):
        captioned.append(
            (
                f"time step of {coordinate.velocity_name}, contact forces at its start{belongs}",
                _equation(gain[row], step * force[row]),
            )
        )
    for coordinate, velocity in zip(dynamics.scene.coordinates, after, strict=True):
        new = sp.Symbol(f"{coordinate.name}__t+1", real=True)
        captioned.append(
            (f"time step of {coordinate.name}", _equation(new, coordinate.symbol + step * velocity))
        )
    cost = sp.Symbol("J")
    captioned.append(
        (
            "cost, summed over the steps",
            _equation(cost, sp.Sum(dynamics.running_cost, (time, 0, sp.Symbol("T") - 1))),
        )
    )
    if dynamics.final_cost != 0:
        captioned.append((FINAL_COST, _equation(sp.Symbol("J_T"), dynamics.final_cost)))
    return tuple(
        EquationRecord(caption=caption, mathml=presentation(equation))
        for caption, equation in captioned
    )


def _damped_force(
    dynamics: Dynamics, contact: Contact, depth: sp.Symbol, lam: sp.Symbol
) -> list[tuple[str, sp.Basic]]:
    """Return the rate of penetration and the force by it."""
    rate, k, c = (
        sp.Derivative(depth, sp.Symbol("t", real=True), evaluate=False),
        contact.stiffness,
        contact.damping,
    )
    row = [item.name for item in dynamics.scene.contacts].index(contact.name)
    if contact.damping_law is DampingLaw.KELVIN_VOIGT:
        law, words = (
            sp.Max(k * depth + c * rate, 0),
            "Kelvin-Voigt without adhesion, where its penetration is positive; elsewhere 0",
        )
    else:
        law, words = (
            sp.Mul(k, sp.Max(depth, 0), sp.Max(1 + c * rate, 0), evaluate=False),
            "Hunt-Crossley",
        )
    return [
        (
            f"rate of penetration of contact {contact.name}",
            _equation(rate, -(dynamics.gap_jacobian[row, :] * sp.Matrix(dynamics.v))[0]),
        ),
        (f"force of contact {contact.name}, {words}", _equation(lam, law)),
    ]


def _friction_equations(
    dynamics: Dynamics, names: Mapping[sp.Symbol, sp.Symbol]
) -> list[tuple[str, sp.Basic]]:
    captioned: list[tuple[str, sp.Basic]] = []
    for friction, slip, limit, force in zip(
        dynamics.scene.frictions, dynamics.slip, dynamics.friction_limit, dynamics.f, strict=True
    ):
        speed = sp.Symbol(friction.slip_name, real=True)
        captioned.append((f"slip speed of friction {friction.name}", _equation(speed, slip)))
        captioned.append(
            (
                f"largest force of friction {friction.name}",
                sp.Le(sp.Abs(force), limit.subs(names), evaluate=False),
            )
        )
        held = _equation(force, sp.Mul(-1, limit.subs(names), sp.sign(speed), evaluate=False))
        captioned.append(
            (
                f"force of friction {friction.name} where it slips; where it sticks, the slip is zero",
                held,
            )
        )
    return captioned


def _equation(left: sp.Basic, right: sp.Basic) -> sp.Basic:
    return sp.Eq(left, right, evaluate=False)


def _with_minus_inside(expression: sp.Basic) -> sp.Basic:
    """Return the expression without a - (b + c), which SymPy prints without parentheses."""
    return expression.replace(
        lambda part: part.is_Mul and (-part).is_Add,
        lambda part: sp.Add(*(-term for term in (-part).args)),
    )


def presentation(expression: sp.Basic) -> str:
    """Return presentation MathML as XML: a `math` element, entities as characters."""
    inside = mathml(_with_minus_inside(expression), printer="presentation").replace(
        "<mo><</mo>", "<mo>&lt;</mo>"
    )  # not escaped by SymPy
    plain = _ENTITY.sub(
        lambda match: (
            match.group(0) if match.group(1) in _XML_NAMES else html.unescape(match.group(0))
        ),
        inside,
    )
    return f'<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">{plain}</math>'
