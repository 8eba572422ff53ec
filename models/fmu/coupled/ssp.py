"""Export a scene as coupled FMUs, one per body and contact, with their connections (SSP).

    parts = split(load_scene("three_cart"))
    [body.name for body in parts.bodies]  # three_cart_q1, three_cart_q2, ..: each a Scene
    path = build_ssp(scene)  # all in one .ssp (System Structure and Parameterization 1.0)

A body is a minimal set of coordinates that neither mass matrix nor forces couple to the rest;
contact forces `lam_left_q1` = J[left, q1] lam_left are its inputs. A contact is algebraic
(`coupled.c`); its velocities are for power bonds (ECCO). docs/cosimulation.md states the cost.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import sympy as sp

from models.codegen.c_function import Vector, c_function
from models.codegen.cache import cached
from models.dynamics import Dynamics, derive
from models.errors import SceneError
from models.fmu.description import (
    Unknown,
    find_standard,
    generation_date,
    render,
    standard_headers,
    unit_table,
)
from models.fmu.package import binaries, build_fmu, find_platforms, icons, pack, platform_compiler
from models.fmu.variables import (
    Variable,
    VariableKind,
    numbered,
    parameter_variables,
    variable_table,
)
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact


@dataclass(frozen=True, kw_only=True)
class ContactPart:
    """A contact as a model of its own.

    gradient: derivative of the gap by each coordinate
    start: positions of the coordinates, then velocities
    """

    name: str
    contact: Contact
    coordinates: tuple[Coordinate, ...]
    start: tuple[float, ...]
    gradient: tuple[sp.Expr, ...]
    parameters: tuple[Parameter, ...]
    task: Task

    def force_name(self, coordinate: Coordinate) -> str:
        """Return the name of this contact's force on a coordinate, such as `lam_left_q1`."""
        return f"{self.contact.force_name}_{coordinate.name}"


class Connection(NamedTuple):
    """An output of one part that is an input of another."""

    source: str
    output: str
    target: str
    input: str


@dataclass(frozen=True, kw_only=True)
class Parts:
    """bodies: scenes without contacts; connections: between parts."""

    scene: Scene
    bodies: tuple[Scene, ...]
    contacts: tuple[ContactPart, ...]
    connections: tuple[Connection, ...]


def force_unit(coordinate: Coordinate) -> str:
    """Return the unit of a generalised force [J per unit of the coordinate]."""
    return {"m": "N", "rad": "N m"}.get(coordinate.unit, f"J/{coordinate.unit}")


def split(scene: Scene) -> Parts:
    """Split a scene into parts, in continuous time.

    Raises SceneError for a scene with friction, with damped contacts or without contacts.
    """
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
        raise SceneError(
            f"scene {scene.name}: it has no contacts, so there is nothing to split; export it as one FMU."
        )
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
    )


def _blocks(d: Dynamics) -> list[list[int]]:
    used = [sp.Matrix([*d.mass_matrix[i, :], d.tau[i]]).free_symbols for i in range(d.scene.nq)]
    joined = sp.Matrix(
        d.scene.nq,
        d.scene.nq,
        lambda i, j: int(d.mass_matrix[i, j] != 0 or bool(used[i] & {d.q[j], d.v[j]})),
    )
    return sorted(map(sorted, joined.connected_components()))


def _used(scene: Scene, expressions: Iterable[sp.Expr]) -> tuple[Parameter, ...]:
    symbols: set[sp.Basic] = set().union(
        *(expression.free_symbols for expression in expressions), set()
    )
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
        task=scene.task,
    )


def _body(d: Dynamics, block: list[int], contacts: tuple[ContactPart, ...]) -> Scene:
    scene = d.scene
    coordinates = tuple(scene.coordinates[i] for i in block)
    own = {d.q[i] for i in block}
    foreign = {d.v[i]: 0 for i in range(scene.nq) if i not in block}
    kinetic = scene.kinetic_energy.subs(foreign)
    potential = sp.Add(
        *(
            term
            for term in sp.Add.make_args(sp.expand(scene.potential_energy))
            if term.free_symbols & own
        )
    )
    inputs = tuple(
        item
        for item in scene.inputs
        if any(item.symbol in scene.forces[i].free_symbols for i in block)
    )
    forces, pushes = [scene.forces[i] for i in block], []
    for part in contacts:
        for place, coordinate in enumerate(coordinates):
            if coordinate in part.coordinates:
                push = sp.Symbol(part.force_name(coordinate), real=True)
                forces[place] += push
                words = f"force of the contact {part.contact.name} on {coordinate.name}"
                pushes.append(Input(symbol=push, unit=force_unit(coordinate), description=words))
    start = tuple(scene.task.start[i] for i in block) + tuple(
        scene.task.start[scene.nq + i] for i in block
    )
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
        task=Task(
            start=start,
            goal=(None,) * len(start),
            running_cost=sp.S.Zero,
            step=scene.task.step,
            steps=scene.task.steps,
        ),
    )


def _connections(
    bodies: tuple[Scene, ...], contacts: tuple[ContactPart, ...]
) -> Iterable[Connection]:
    home = {coordinate: body.name for body in bodies for coordinate in body.coordinates}
    for part in contacts:
        for coordinate in part.coordinates:
            body = home[coordinate]
            for name in (coordinate.name, coordinate.velocity_name):
                yield Connection(body, name, part.name, name)
            push = part.force_name(coordinate)
            yield Connection(part.name, push, body, push)


def contact_table(part: ContactPart) -> tuple[Variable, ...]:
    """Return the variables of the contact's FMU: time, inputs, parameters, outputs.

    The position in the table is the value reference.
    """
    return (
        Variable(name="time", kind=VariableKind.TIME, unit="s", description="time"),
        *_inputs(part),
        *parameter_variables(part.parameters),
        *_outputs(part),
    )


def build_part(part: Scene | ContactPart) -> Path:
    """Return the FMU (2.0) of a body or of a contact from the cache, or build it.

    Raises as build_fmu.
    """
    if isinstance(part, Scene):
        return build_fmu(part)
    if not part.name.isascii():
        raise SceneError(
            f"contact {part.name}: an FMU needs a name of ASCII letters, digits and _; rename the scene or the contact."
        )
    compilers = {platform: platform_compiler(platform) for platform in find_platforms(())}
    standard = find_standard("2.0")
    texts = contact_texts(part)
    key = "\n".join(
        [
            *(item.version for item in compilers.values()),
            *(f"{name}\0{text}" for name, text in sorted(texts.items())),
        ]
    )

    def build(path: Path) -> None:
        content = {name: text.encode() for name, text in texts.items()}
        pack(
            path,
            content
            | icons(standard)
            | binaries(texts, standard, part.name, compilers, path.parent),
            first="modelDescription.xml",
        )

    return cached(key, f".{part.name}.fmu", build)


def contact_texts(part: ContactPart) -> dict[str, str]:
    """Return the text files of the FMU, by path."""
    standard = find_standard("2.0")
    table = contact_table(part)
    shared = {
        "part": part,
        "title": f"Contact {part.contact.description or part.contact.name}",
        "table": table,
        "units": unit_table(table),
        "unknowns": _unknowns(part, table),
        "date": generation_date(),
        "given": [variable for variable in table if variable.causality in ("input", "parameter")],
        "functions": _functions(part),
    }
    code = Path(__file__).with_name("coupled.c").read_text(encoding="utf-8")

    def marked(guid: str) -> dict[str, str]:
        return {
            "modelDescription.xml": render(
                "coupled/contact.xml.j2", "description", guid=guid, **shared
            ),
            "sources/contact_model.h": render("coupled/contact_model.h.j2", guid=guid, **shared),
        }

    content = hashlib.sha256()
    for text in (code, *marked("").values()):
        content.update(f"{text}\0".encode())
    return marked(content.hexdigest()) | {
        "sources/contact.c": code,
        "sources/buildDescription.xml": render(
            "buildDescription.xml.j2",
            identifier=part.name,
            source_files=["contact.c"],
            standard=standard,
        ),
        "documentation/index.html": render("coupled/contact.xml.j2", "page", **shared),
        "documentation/licenses/license.txt": render(
            "licenses.txt.j2", header_names=standard.headers
        ),
        **{f"sources/{name}": text for name, text in standard_headers(standard).items()},
    }


def _inputs(part: ContactPart) -> list[Variable]:
    rows = [
        (item.name, item.unit, item.description or f"coordinate {item.name}")
        for item in part.coordinates
    ]
    rows += [
        (item.velocity_name, item.velocity_unit, f"velocity of {item.name}")
        for item in part.coordinates
    ]
    return numbered(
        VariableKind.INPUT, [(*row, start) for row, start in zip(rows, part.start, strict=True)]
    )


def _outputs(part: ContactPart) -> list[Variable]:
    contact = part.contact
    stiffness = float(contact.stiffness.subs({item.symbol: item.value for item in part.parameters}))
    size = stiffness * contact.nominal
    rows = [
        (contact.force_name, VariableKind.FORCE, "N", size, "contact force"),
        (contact.gap_name, VariableKind.GAP, "m", contact.nominal, "gap, negative in contact"),
        (
            "contact_energy",
            VariableKind.CONTACT_ENERGY,
            "J",
            size * contact.nominal,
            "energy stored in the contact, k/2 max(phi, 0)^2",
        ),
        (
            "contact_power",
            VariableKind.INPUT_POWER,
            "W",
            size,
            "power that the contact hands to the bodies",
        ),
    ]
    rows += [
        (
            part.force_name(item),
            VariableKind.FORCE,
            force_unit(item),
            size,
            f"generalised force of the contact on {item.name}",
        )
        for item in part.coordinates
    ]
    return [
        Variable(name=name, kind=kind, unit=unit, nominal=nominal, description=text)
        for name, kind, unit, nominal, text in rows
    ]


def _expressions(part: ContactPart, mode: sp.Expr) -> sp.Matrix:
    phi = part.contact.penetration
    force = mode * part.contact.stiffness * phi
    power = force * sum(
        (
            slope * item.velocity
            for slope, item in zip(part.gradient, part.coordinates, strict=True)
        ),
        sp.S.Zero,
    )
    return sp.Matrix(
        [force, -phi, force * phi / 2, power, *(slope * force for slope in part.gradient)]
    )


def _symbols(part: ContactPart) -> list[sp.Symbol]:
    moving = part.coordinates
    return [
        *(item.symbol for item in moving),
        *(item.velocity for item in moving),
        *(item.symbol for item in part.parameters),
    ]


def _functions(part: ContactPart) -> str:
    symbols = _symbols(part)
    x = Vector.of("x", [symbol.name for symbol in symbols])
    mode, dx = Vector.of("mode", ["closed"]), x.like("dx")
    local = dict(zip(symbols, x.symbols, strict=True))
    y = _expressions(part, mode.symbols[0]).xreplace(local)
    return "\n".join(
        [
            c_function(
                "double",
                "contact_penetration",
                (x,),
                None,
                sp.Matrix([part.contact.penetration.xreplace(local)]),
            ),
            c_function("void", "contact_outputs", (x, mode), "y", y),
            c_function(
                "void", "contact_tangent", (x, mode, dx), "d_y", y.jacobian(x.column) * dx.column
            ),
        ]
    )


def _unknowns(part: ContactPart, table: tuple[Variable, ...]) -> dict[str, list[Unknown]]:
    """Return the ModelStructure's sections; parameters are known only during initialization."""
    symbols, y = _symbols(part), _expressions(part, sp.S.One)

    def rows(knowns: list[sp.Symbol]) -> list[Unknown]:
        used = (
            tuple(place for place, symbol in enumerate(knowns, 2) if symbol in entry.free_symbols)
            for entry in y
        )
        return [
            Unknown(place, places) for place, places in enumerate(used, len(table) - len(y) + 1)
        ]

    return {"Outputs": rows(symbols[: 2 * len(part.coordinates)]), "InitialUnknowns": rows(symbols)}


STRUCTURE = "SystemStructure.ssd"
PARTS_ONLY = "PartsOnly.ssd"


def build_ssp(scene: Scene) -> Path:
    """Return the scene as coupled FMUs in one file, from the cache or built.

    SystemStructure.ssd exposes the scene's inputs and outputs; PartsOnly.ssd does not, for masters
    without system connectors (libcosim). Raises SceneError as `split` and MachineError as
    build_fmu.
    """
    parts = split(scene)
    content = {
        f"resources/{part.name}.fmu": build_part(part).read_bytes()
        for part in (*parts.bodies, *parts.contacts)
    }
    content |= {
        STRUCTURE: system_structure(parts).encode(),
        PARTS_ONLY: system_structure(parts, border=False).encode(),
    }
    key = "\n".join(f"{name}\0{data.hex()}" for name, data in sorted(content.items()))
    return cached(key, f".{scene.name}.ssp", lambda path: pack(path, content, first=STRUCTURE))


def system_structure(parts: Parts, border: bool = True) -> str:
    """Return the text of an .ssd; `border` exposes inputs, positions, velocities, forces, gaps."""
    components = {part.name: _connectors(variable_table(part)) for part in parts.bodies}
    components |= {part.name: _connectors(contact_table(part)) for part in parts.contacts}
    system = _connectors(variable_table(parts.scene))
    inputs = [
        ("", item.name, body.name, item.name)
        for item in parts.scene.inputs
        for body in parts.bodies
        if item in body.inputs
    ]
    homes = {
        variable.name: name
        for name, connectors in components.items()
        for variable in connectors
        if variable.causality == "output"
    }
    # Energies are sums over the parts, so no part can provide them.
    exposed = [
        variable
        for variable in system
        if variable.causality == "input"
        or (variable.name in homes and "energy" not in variable.name)
    ]
    exposed = [variable for variable in exposed if "power" not in variable.name]
    outputs = [
        (homes[variable.name], variable.name, "", variable.name)
        for variable in exposed
        if variable.causality == "output"
    ]
    return render(
        "coupled/SystemStructure.xml.j2",
        scene=parts.scene,
        date=generation_date(),
        connectors=exposed if border else [],
        components=components,
        connections=[*inputs, *parts.connections, *outputs] if border else parts.connections,
        units=unit_table(variable for connectors in components.values() for variable in connectors),
    )


def _connectors(table: Sequence[Variable]) -> tuple[Variable, ...]:
    return tuple(variable for variable in table if variable.causality in ("input", "output"))
