"""A scene as the report shows it: names, units, start and goal, and its equations as presentation MathML.

Thin copies of plans and replays for plots: at most 1500 points, with the poses of the shapes at the same times.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np
import sympy as sp
from sympy.printing.mathml import mathml

from models.codegen.operations import step_operations
from models.dynamics import Dynamics, derive
from models.scene import Scene
from models.scene.contacts import Contact, DampingLaw
from models.trajectory import Trajectory
from reports.records.record import ContactRecord, EquationRecord, Pose, QuantityRecord, SceneRecord, ShapeRecord, TraceRecord

if TYPE_CHECKING:
    from validate.judge.replay.result import Replay

LONGEST = 1500


def thin(points: int, longest: int = LONGEST) -> np.ndarray:
    """Indices of at most `longest` of `points` points, evenly spread, with the first and the last."""
    return np.unique(np.linspace(0, points - 1, min(points, longest)).round().astype(int))


def plan_trace(scene: Scene, trajectory: Trajectory) -> TraceRecord:
    """q, v, u, lam, friction and gap of a plan; quantities of steps have one value less."""
    keep = thin(len(trajectory.t))
    steps = keep[keep < trajectory.steps]
    q = trajectory.q[keep]
    lam, friction = np.split(trajectory.lam[steps], [scene.nc], axis=1)
    columns = _columns(scene, q=q, v=trajectory.v[keep], u=trajectory.u[steps], lam=lam, friction=friction, gap=_gap(scene, q))
    return TraceRecord(t=_numbers(trajectory.t[keep]), columns=columns, poses=poses(scene, q))


def replay_trace(scene: Scene, trajectory: Trajectory, replay: Replay) -> TraceRecord:
    """q, v, lam, friction, gap of a replay, and `position_error`: the largest difference of a coordinate to the plan; of a tracked one also u as applied
    (at the start of the step that a point lies in)."""
    keep = thin(len(replay.t))
    q = np.asarray(replay.q)[keep]
    lam = np.asarray(replay.lam)[keep]
    friction = np.asarray(replay.friction)[keep] if scene.nf else np.zeros((len(keep), 0))
    columns = _columns(scene, q=q, v=np.asarray(replay.v)[keep], lam=lam, friction=friction, gap=_gap(scene, q))
    knots = np.asarray(replay.knots)
    if len(knots) == 0:
        return TraceRecord(t=_numbers(replay.t[keep]), columns=columns, poses=poses(scene, q))
    applied = getattr(replay, "applied", None)
    if applied is not None and len(applied):
        step = np.clip(np.searchsorted(knots, keep, side="right") - 1, 0, len(applied) - 1)
        columns |= _columns(scene, u=np.asarray(applied)[step])
    difference = np.abs(np.asarray(replay.q)[knots] - trajectory.q[: len(knots)]).max(axis=1)
    # The plan is known at its nodes only: between them its error is drawn as a line.
    columns["position_error"] = _numbers(np.interp(replay.t[keep], replay.t[knots], difference))
    return TraceRecord(t=_numbers(replay.t[keep]), columns=columns, poses=poses(scene, q))


def poses(scene: Scene, q: np.ndarray) -> dict[str, tuple[Pose, ...]]:
    """(x, y, angle) of every shape at positions q (n, nq) [m, m, rad]."""
    found: dict[str, tuple[Pose, ...]] = {}
    for shape in scene.shapes:
        values = _function(scene, [shape.x, shape.y, shape.angle])(q)
        found[shape.name] = tuple((x, y, angle) for x, y, angle in values.tolist())
    return found


def _gap(scene: Scene, q: np.ndarray) -> np.ndarray:
    """(n, nc) gaps -phi(q) [m]."""
    return -_function(scene, list(derive(scene).penetration))(q)


def _function(scene: Scene, expressions: list[sp.Expr]) -> Callable[[np.ndarray], np.ndarray]:
    """A function of q (n, nq) that gives (n, len(expressions)); constants are repeated."""
    symbols = [coordinate.symbol for coordinate in scene.coordinates]
    numbers = [sp.sympify(expression).subs(scene.parameter_values) for expression in expressions]
    compiled = sp.lambdify(symbols, numbers, modules="numpy", cse=True)

    def evaluate(q: np.ndarray) -> np.ndarray:
        values = compiled(*q.T)
        return np.column_stack([np.broadcast_to(value, len(q)) for value in values]) if values else np.zeros((len(q), 0))

    return evaluate


def _columns(scene: Scene, **groups: np.ndarray) -> dict[str, tuple[float, ...]]:
    names = {
        "q": [item.name for item in scene.coordinates],
        "v": [item.velocity_name for item in scene.coordinates],
        "u": [item.name for item in scene.inputs],
        "lam": [item.force_name for item in scene.contacts],
        "friction": [item.force_name for item in scene.frictions],
        "gap": [item.gap_name for item in scene.contacts],
    }
    return {name: _numbers(array[:, index]) for group, array in groups.items() for index, name in enumerate(names[group])}


def _numbers(array: np.ndarray) -> tuple[float, ...]:
    return tuple(array.tolist())


_ENTITY = re.compile(r"&([A-Za-z]+);")
# The only names XML itself knows; everything else SymPy writes by name is an HTML entity, which a strict parser refuses.
_XML_NAMES = frozenset({"lt", "gt", "amp", "quot", "apos"})


def scene_record(scene: Scene) -> SceneRecord:
    """The record of a scene; deriving its equations is what costs (some 10 ms)."""
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
        coordinates=tuple(QuantityRecord(name=item.name, unit=item.unit, description=item.description) for item in scene.coordinates),
        velocities=tuple(
            QuantityRecord(name=item.velocity_name, unit=item.velocity_unit, description=f"velocity of {item.description or item.name}")
            for item in scene.coordinates
        ),
        inputs=tuple(QuantityRecord(name=item.name, unit=item.unit, description=item.description) for item in scene.inputs),
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
        parameters=tuple(
            QuantityRecord(name=item.name, unit=item.unit, description=item.description, value=item.value) for item in scene.parameters
        ),
        start=tuple(float(value) for value in scene.task.start),
        goal=scene.task.goal,
        step=scene.task.step,
        steps=scene.task.steps,
        equations=equations(dynamics),
        absent=dynamics.absent,
        answers=tuple(
            QuantityRecord(name=answer.quantity, unit="", description=answer.source, value=float(answer.value)) for answer in scene.answers
        ),
        shapes=tuple(
            ShapeRecord(
                name=shape.name, kind=shape.kind, size=tuple(float(sp.sympify(size).subs(scene.parameter_values)) for size in shape.size)
            )
            for shape in scene.shapes
        ),
        waived=tuple(f"{limit.metric}: {limit.reason}" for limit in scene.limits if limit.value is None),
        unstable=scene.unstable,
        operations=asdict(step_operations(scene)),
    )


def equations(dynamics: Dynamics) -> tuple[EquationRecord, ...]:
    """Equations of motion, gaps, contact law, time step and cost of a scene, in this order."""
    found: list[tuple[str, sp.Basic]] = []
    time, step = sp.Symbol("t", real=True), sp.Symbol("h", positive=True)
    greek = {lam: sp.Symbol(lam.name.replace("lam_", "lambda_", 1), real=True) for lam in dynamics.lam}
    force = dynamics.generalised_force.subs(greek)
    rate = sp.Matrix([sp.Derivative(velocity, time, evaluate=False) for velocity in dynamics.v])
    inertia = dynamics.mass_matrix * rate
    for row, coordinate in enumerate(dynamics.scene.coordinates):
        found.append((f"motion of {coordinate.name}", _equation(inertia[row], force[row])))
    for contact, phi, k, lam in zip(dynamics.scene.contacts, dynamics.penetration, dynamics.stiffness, greek.values(), strict=True):
        depth = sp.Symbol(f"phi_{contact.name}", real=True)
        found.append((f"penetration of contact {contact.name} (its gap is the negative)", _equation(depth, phi)))
        if contact.is_damped:
            found += _damped_force(dynamics, contact, depth, lam)
        else:
            found.append((f"force of contact {contact.name}", _equation(lam, sp.Mul(k, sp.Max(depth, 0), evaluate=False))))
    found += _friction_equations(dynamics)
    belongs = ", friction to the slip at its end" if dynamics.f else ""
    after = [sp.Symbol(f"{velocity.name}__t+1", real=True) for velocity in dynamics.v]
    gain = dynamics.mass_matrix * sp.Matrix([new - old for new, old in zip(after, dynamics.v, strict=True)])
    for row, coordinate in enumerate(dynamics.scene.coordinates):
        found.append(
            (f"time step of {coordinate.velocity_name}, contact forces at its start{belongs}", _equation(gain[row], step * force[row]))
        )
    for coordinate, velocity in zip(dynamics.scene.coordinates, after, strict=True):
        new = sp.Symbol(f"{coordinate.name}__t+1", real=True)
        found.append((f"time step of {coordinate.name}", _equation(new, coordinate.symbol + step * velocity)))
    cost = sp.Symbol("J")
    found.append(("cost, summed over the steps", _equation(cost, sp.Sum(dynamics.running_cost, (time, 0, sp.Symbol("T") - 1)))))
    if dynamics.final_cost != 0:
        found.append(("cost of the last state, added to that sum", _equation(sp.Symbol("J_T"), dynamics.final_cost)))
    return tuple(EquationRecord(caption=caption, mathml=presentation(equation)) for caption, equation in found)


def _damped_force(dynamics: Dynamics, contact: Contact, depth: sp.Symbol, lam: sp.Symbol) -> list[tuple[str, sp.Basic]]:
    """The rate of penetration and the force that follows from it."""
    rate, k, c = sp.Derivative(depth, sp.Symbol("t", real=True), evaluate=False), contact.stiffness, contact.damping
    row = [item.name for item in dynamics.scene.contacts].index(contact.name)
    if contact.damping_law is DampingLaw.KELVIN_VOIGT:
        law, words = sp.Max(k * depth + c * rate, 0), "Kelvin-Voigt without adhesion, where its penetration is positive; elsewhere 0"
    else:
        law, words = sp.Mul(k, sp.Max(depth, 0), sp.Max(1 + c * rate, 0), evaluate=False), "Hunt-Crossley"
    return [
        (f"rate of penetration of contact {contact.name}", _equation(rate, -(dynamics.gap_jacobian[row, :] * sp.Matrix(dynamics.v))[0])),
        (f"force of contact {contact.name}, {words}", _equation(lam, law)),
    ]


def _friction_equations(dynamics: Dynamics) -> list[tuple[str, sp.Basic]]:
    found: list[tuple[str, sp.Basic]] = []
    names = {lam: sp.Symbol(lam.name.replace("lam_", "lambda_", 1), real=True) for lam in dynamics.lam}
    for friction, slip, limit, force in zip(dynamics.scene.frictions, dynamics.slip, dynamics.friction_limit, dynamics.f, strict=True):
        speed = sp.Symbol(friction.slip_name, real=True)
        found.append((f"slip speed of friction {friction.name}", _equation(speed, slip)))
        found.append((f"largest force of friction {friction.name}", sp.Le(sp.Abs(force), limit.subs(names), evaluate=False)))
        held = _equation(force, sp.Mul(-1, limit.subs(names), sp.sign(speed), evaluate=False))
        found.append((f"force of friction {friction.name} where it slips; where it sticks, the slip is zero", held))
    return found


def _equation(left: sp.Basic, right: sp.Basic) -> sp.Basic:
    return sp.Eq(left, right, evaluate=False)


def presentation(expression: sp.Basic) -> str:
    """Presentation MathML that any XML parser reads: a `math` element, entities as characters."""
    inside = mathml(expression, printer="presentation").replace("<mo><</mo>", "<mo>&lt;</mo>")  # SymPy leaves it unescaped
    plain = _ENTITY.sub(lambda match: match.group(0) if match.group(1) in _XML_NAMES else html.unescape(match.group(0)), inside)
    return f'<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">{plain}</math>'
