"""The FMU of one contact: algebraic, FMI 2.0 for Co-Simulation; generated functions inside the hand-written `contact.c`.

path = build_contact(part)      inputs q and v of the coordinates it touches; outputs lam, gap, energy, power and a force a coordinate
"""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from pathlib import Path

import sympy as sp

from models.codegen.c_function import Vector, c_function
from models.codegen.cache import cached
from models.errors import SceneError
from models.fmu.coupled.parts import ContactPart, force_unit
from models.fmu.description import find_standard, source_epoch, standard_headers
from models.fmu.package import binaries, icons, pack
from models.fmu.platforms import find_platforms, platform_compiler
from models.fmu.rendering import render
from models.fmu.variables import Variable, VariableKind, parameter_variables
from models.scene.units import base_exponents

_HERE = Path(__file__).parent


def contact_table(part: ContactPart) -> tuple[Variable, ...]:
    """Every variable of the contact's FMU; the position in the table is the value reference: time, inputs, parameters, outputs."""
    return (
        Variable(name="time", kind=VariableKind.TIME, unit="s", description="time"),
        *_inputs(part),
        *parameter_variables(part.parameters),
        *_outputs(part),
    )


def build_contact(part: ContactPart) -> Path:
    """The FMU file, found in the cache or built there. Raises SceneError for names an FMU cannot carry, MachineError without a compiler."""
    if not part.name.isascii():
        raise SceneError(f"contact {part.name}: an FMU needs a name of ASCII letters, digits and _; rename the scene or the contact.")
    compilers = {platform: platform_compiler(platform) for platform in find_platforms(())}
    standard = find_standard("2.0")
    texts = contact_texts(part)
    key = "\n".join([*(item.describe() for item in compilers.values()), *(f"{name}\0{text}" for name, text in sorted(texts.items()))])

    def build(path: Path) -> None:
        content = {name: text.encode() for name, text in texts.items()}
        pack(path, content | icons(standard) | binaries(texts, standard, part.name, compilers, path.parent), first="modelDescription.xml")

    return cached(key, f".{part.name}.fmu", build)


def contact_texts(part: ContactPart) -> dict[str, str]:
    """Every text file of the FMU, by its path inside."""
    standard = find_standard("2.0")
    table = contact_table(part)
    shared = {
        "identifier": part.name,
        "title": f"Contact {part.contact.description or part.contact.name}",
        "table": table,
        "units": {unit: base_exponents(unit) for unit in sorted({variable.unit for variable in table})},
        "unknowns": _unknowns(part, table),
        "date": datetime.fromtimestamp(source_epoch(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "step": part.step,
        "horizon": part.horizon,
        "inputs": _inputs(part),
        "parameters": parameter_variables(part.parameters),
        "outputs": _outputs(part),
        "functions": _functions(part),
        "penetration": str(part.contact.penetration),
        "stiffness": str(part.contact.stiffness),
    }
    code = (_HERE / "contact.c").read_text(encoding="utf-8")

    def marked(guid: str) -> dict[str, str]:
        return {
            "modelDescription.xml": render("contact_modelDescription.xml.j2", guid=guid, **shared),
            "sources/contact_model.h": render("contact_model.h.j2", guid=guid, **shared),
        }

    content = hashlib.sha256()
    for text in (code, *marked("").values()):
        content.update(f"{text}\0".encode())
    return marked(content.hexdigest()) | {
        "sources/contact.c": code,
        "sources/buildDescription.xml": render(
            "buildDescription.xml.j2", identifier=part.name, source_files=["contact.c"], standard=standard
        ),
        "documentation/index.html": render("contact_index.html.j2", **shared),
        "documentation/licenses/license.txt": render("licenses.txt.j2", header_names=standard.headers),
        **{f"sources/{name}": text for name, text in standard_headers(standard).items()},
    }


def _inputs(part: ContactPart) -> list[Variable]:
    count = len(part.coordinates)
    positions = [
        Variable(
            name=item.name,
            kind=VariableKind.INPUT,
            unit=item.unit,
            start=part.start[i],
            description=item.description or f"coordinate {item.name}",
        )
        for i, item in enumerate(part.coordinates)
    ]
    velocities = [
        Variable(
            name=item.velocity_name,
            kind=VariableKind.INPUT,
            unit=item.velocity_unit,
            start=part.start[count + i],
            description=f"velocity of {item.name}",
        )
        for i, item in enumerate(part.coordinates)
    ]
    return [*positions, *velocities]


def _outputs(part: ContactPart) -> list[Variable]:
    contact = part.contact
    stiffness = float(contact.stiffness.subs({item.symbol: item.value for item in part.parameters}))
    size = stiffness * contact.nominal
    rows = [
        (contact.force_name, VariableKind.FORCE, "N", size, "contact force"),
        (contact.gap_name, VariableKind.GAP, "m", contact.nominal, "gap, negative in contact"),
        ("contact_energy", VariableKind.CONTACT_ENERGY, "J", size * contact.nominal, "energy stored in the contact, k/2 max(phi, 0)^2"),
        ("contact_power", VariableKind.INPUT_POWER, "W", size, "power that the contact hands to the bodies"),
    ]
    rows += [
        (part.force_name(item), VariableKind.FORCE, force_unit(item), size, f"generalised force of the contact on {item.name}")
        for item in part.coordinates
    ]
    return [Variable(name=name, kind=kind, unit=unit, nominal=nominal, description=text) for name, kind, unit, nominal, text in rows]


def _expressions(part: ContactPart, mode: sp.Expr) -> sp.Matrix:
    """The outputs, in the order of the table; mode: 1 in contact, 0 else."""
    phi = part.contact.penetration
    force = mode * part.contact.stiffness * phi
    power = force * sum((slope * item.velocity for slope, item in zip(part.gradient, part.coordinates, strict=True)), sp.S.Zero)
    return sp.Matrix([force, -phi, force * phi / 2, power, *(slope * force for slope in part.gradient)])


def _symbols(part: ContactPart) -> list[sp.Symbol]:
    """x: positions, velocities, parameters."""
    return [
        *(item.symbol for item in part.coordinates),
        *(item.velocity for item in part.coordinates),
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
            c_function("double", "contact_penetration", (x,), None, sp.Matrix([part.contact.penetration.xreplace(local)])),
            c_function("void", "contact_outputs", (x, mode), "y", y),
            c_function("void", "contact_tangent", (x, mode, dx), "d_y", y.jacobian(x.column) * dx.column),
        ]
    )


def _unknowns(part: ContactPart, table: tuple[Variable, ...]) -> dict[str, list[dict[str, object]]]:
    """Sections of the ModelStructure: parameters are knowns during initialization only."""
    symbols, y = _symbols(part), _expressions(part, sp.S.One)
    inputs = 2 * len(part.coordinates)
    first = len(table) - len(y)

    def rows(knowns: list[sp.Symbol]) -> list[dict[str, object]]:
        return [
            {"index": first + place + 1, "dependencies": [i + 2 for i, symbol in enumerate(knowns) if symbol in y[place].free_symbols]}
            for place in range(len(y))
        ]

    return {"Outputs": rows(symbols[:inputs]), "InitialUnknowns": rows(symbols)}
