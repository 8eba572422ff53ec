"""Scene -> its bodies and its contacts as separate parts, and the connections between them.

    parts = split(load_scene("three_cart"))
    [body.name for body in parts.bodies]        three_cart_q1, three_cart_q2, three_cart_q3: each a Scene
    [part.name for part in parts.contacts]      three_cart_left, three_cart_right

A body is a smallest set of coordinates that neither the mass matrix nor the forces couple to the others. It gets the generalised
force of each contact on each of its coordinates as an input, `lam_left_q1` = J[left, q1] lam_left. A contact takes the positions and
velocities of the coordinates its gap depends on, and gives those forces: the velocities for the power that it hands over, which
masters that watch the energy (ECCO) connect as a power bond.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import sympy as sp

from models.dynamics import Dynamics, derive
from models.errors import SceneError
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact


@dataclass(frozen=True, kw_only=True)
class ContactPart:
    """A contact as a model of its own. gradient: the gap's derivative along each of `coordinates`; start: their positions, then velocities."""

    name: str
    contact: Contact
    coordinates: tuple[Coordinate, ...]
    start: tuple[float, ...]
    gradient: tuple[sp.Expr, ...]
    parameters: tuple[Parameter, ...]
    step: float
    horizon: float

    def force_name(self, coordinate: Coordinate) -> str:
        """Name of the generalised force of this contact on a coordinate, as `lam_left_q1`."""
        return f"{self.contact.force_name}_{coordinate.name}"


@dataclass(frozen=True)
class Connection:
    """An output of one part that is an input of another, by their names."""

    source: str
    output: str
    target: str
    input: str


@dataclass(frozen=True, kw_only=True)
class Parts:
    """bodies: scenes without contacts; connections: between parts; external: (input of the scene, part that takes it)."""

    scene: Scene
    bodies: tuple[Scene, ...]
    contacts: tuple[ContactPart, ...]
    connections: tuple[Connection, ...]
    external: tuple[tuple[str, str], ...]


def force_unit(coordinate: Coordinate) -> str:
    """The unit of a generalised force [J per unit of the coordinate]."""
    return {"m": "N", "rad": "N m"}.get(coordinate.unit, f"J/{coordinate.unit}")


def split(scene: Scene) -> Parts:
    """The parts of a scene, in continuous time. Raises SceneError for a scene with friction, with damped contacts or without contacts."""
    scene = scene.continuous()
    if scene.frictions:
        raise SceneError(
            f"scene {scene.name}: it has friction, whose sticking ties bodies together within a step; only scenes without it can be split into parts."
        )
    if scene.damped:
        names = ", ".join(scene.contacts[index].name for index in scene.damped)
        raise SceneError(
            f"scene {scene.name}: it has damped contacts ({names}), and its parts would exchange forces of springs only; export it as one FMU."
        )
    if not scene.contacts:
        raise SceneError(f"scene {scene.name}: it has no contacts, so there is nothing to split; export it as one FMU.")
    d = derive(scene)
    contacts = tuple(_contact(d, index) for index in range(scene.nc))
    bodies = tuple(_body(d, block, contacts) for block in _blocks(d))
    names = [part.name for part in (*bodies, *contacts)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise SceneError(
            f"scene {scene.name}: a body and a contact would both be called {twice}; rename the contact, which has the name of a coordinate."
        )
    return Parts(
        scene=scene,
        bodies=bodies,
        contacts=contacts,
        connections=tuple(_connections(bodies, contacts)),
        external=tuple((item.name, body.name) for item in scene.inputs for body in bodies if item in body.inputs),
    )


def _blocks(d: Dynamics) -> list[tuple[int, ...]]:
    """Indices of the coordinates of each body."""
    count, group = d.scene.nq, list(range(d.scene.nq))
    for i in range(count):
        row = sp.Matrix([*d.mass_matrix[i, :], d.tau[i]])
        used = row.free_symbols
        for j in range(count):
            if d.mass_matrix[i, j] != 0 or used & {d.q[j], d.v[j]}:
                joined, other = group[i], group[j]
                group = [joined if name == other else name for name in group]
    return [tuple(i for i in range(count) if group[i] == name) for name in dict.fromkeys(group)]


def _used(scene: Scene, expressions: Iterable[sp.Expr]) -> tuple[Parameter, ...]:
    symbols: set[sp.Basic] = set().union(*(expression.free_symbols for expression in expressions), set())
    return tuple(parameter for parameter in scene.parameters if parameter.symbol in symbols)


def _contact(d: Dynamics, index: int) -> ContactPart:
    scene, contact = d.scene, d.scene.contacts[index]
    moved = [i for i in range(scene.nq) if d.gap_jacobian[index, i] != 0]
    start = scene.task.start
    return ContactPart(
        name=f"{scene.name}_{contact.name}",
        contact=contact,
        coordinates=tuple(scene.coordinates[i] for i in moved),
        start=(*(start[i] for i in moved), *(start[scene.nq + i] for i in moved)),
        gradient=tuple(d.gap_jacobian[index, i] for i in moved),
        parameters=_used(scene, [contact.penetration, contact.stiffness]),
        step=scene.task.step,
        horizon=scene.task.horizon,
    )


def _body(d: Dynamics, block: tuple[int, ...], contacts: tuple[ContactPart, ...]) -> Scene:
    scene = d.scene
    coordinates = tuple(scene.coordinates[i] for i in block)
    own = {d.q[i] for i in block}
    others = {d.v[i]: 0 for i in range(scene.nq) if i not in block}
    kinetic = scene.kinetic_energy.subs(others)
    potential = sp.Add(*(term for term in sp.Add.make_args(sp.expand(scene.potential_energy)) if term.free_symbols & own))
    inputs = tuple(item for item in scene.inputs if any(item.symbol in scene.forces[i].free_symbols for i in block))
    forces, pushes = [scene.forces[i] for i in block], []
    for part in contacts:
        for place, coordinate in enumerate(coordinates):
            if coordinate in part.coordinates:
                push = sp.Symbol(part.force_name(coordinate), real=True)
                forces[place] += push
                words = f"force of the contact {part.contact.name} on {coordinate.name}"
                pushes.append(Input(symbol=push, unit=force_unit(coordinate), description=words))
    start = tuple(scene.task.start[i] for i in block) + tuple(scene.task.start[scene.nq + i] for i in block)
    what = ", ".join(coordinate.description or coordinate.name for coordinate in coordinates)
    return Scene(
        name=f"{scene.name}_{'_'.join(coordinate.name for coordinate in coordinates)}",
        title=f"{scene.title}: {what}",
        source=scene.source,
        coordinates=coordinates,
        inputs=(*inputs, *pushes),
        parameters=_used(scene, [kinetic, potential, *forces]),
        kinetic_energy=kinetic,
        potential_energy=potential,
        forces=tuple(forces),
        contacts=(),
        task=Task(start=start, goal=(None,) * len(start), running_cost=sp.S.Zero, step=scene.task.step, steps=scene.task.steps),
    )


def _connections(bodies: tuple[Scene, ...], contacts: tuple[ContactPart, ...]) -> Iterable[Connection]:
    home = {coordinate: body.name for body in bodies for coordinate in body.coordinates}
    for part in contacts:
        for coordinate in part.coordinates:
            body = home[coordinate]
            for name in (coordinate.name, coordinate.velocity_name):
                yield Connection(body, name, part.name, name)
            push = part.force_name(coordinate)
            yield Connection(part.name, push, body, push)
