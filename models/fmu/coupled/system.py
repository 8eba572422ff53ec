"""All parts of a scene in one .ssp (System Structure and Parameterization 1.0): the FMUs, and how they are connected.

SystemStructure.ssd also leads the scene's inputs and outputs to the border of the system. PartsOnly.ssd leaves that out, for masters that know
connections between components only (libcosim refuses any other).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from models.codegen.cache import cached
from models.fmu.coupled.contact import build_contact, contact_table
from models.fmu.coupled.parts import ContactPart, Parts, split
from models.fmu.description import source_epoch
from models.fmu.package import build_fmu, pack
from models.fmu.rendering import render
from models.fmu.variables import Variable, variable_table
from models.scene import Scene
from models.scene.units import base_exponents

STRUCTURE, PARTS_ONLY = "SystemStructure.ssd", "PartsOnly.ssd"


@dataclass(frozen=True)
class _Component:
    """A part and the variables of its FMU that others can be connected to."""

    name: str
    connectors: tuple[Variable, ...]


def build_part(part: Scene | ContactPart) -> Path:
    """The FMU of a body or of a contact (FMI 2.0). Raises as build_fmu."""
    return build_contact(part) if isinstance(part, ContactPart) else build_fmu(part)


def build_ssp(scene: Scene) -> Path:
    """The scene as coupled FMUs in one file, found in the cache or built there. Raises SceneError as `split` and MachineError as build_fmu."""
    parts = split(scene)
    content = {f"resources/{part.name}.fmu": build_part(part).read_bytes() for part in (*parts.bodies, *parts.contacts)}
    content |= {STRUCTURE: system_structure(parts).encode(), PARTS_ONLY: system_structure(parts, border=False).encode()}
    key = "\n".join(f"{name}\0{data.hex()}" for name, data in sorted(content.items()))
    return cached(key, f".{scene.name}.ssp", lambda path: pack(path, content, first=STRUCTURE))


def system_structure(parts: Parts, border: bool = True) -> str:
    """The text of an .ssd. border: the system takes the scene's inputs and gives its positions, velocities, contact forces and gaps."""
    components = [_Component(part.name, _connectors(variable_table(part))) for part in parts.bodies]
    components += [_Component(part.name, _connectors(contact_table(part))) for part in parts.contacts]
    system = _connectors(variable_table(parts.scene))
    inside = [(item.source, item.output, item.target, item.input) for item in parts.connections]
    inputs = [("", name, body, name) for name, body in parts.external]
    homes = {variable.name: item.name for item in components for variable in item.connectors if variable.causality == "output"}
    # Energies are sums over the parts: what the system gives is what one part has under the same name.
    given = [variable for variable in system if variable.causality == "input" or (variable.name in homes and "energy" not in variable.name)]
    given = [variable for variable in given if "power" not in variable.name]
    outputs = [(homes[variable.name], variable.name, "", variable.name) for variable in given if variable.causality == "output"]
    return render(
        "SystemStructure.xml.j2",
        scene=parts.scene,
        date=datetime.fromtimestamp(source_epoch(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        connectors=given if border else [],
        components=components,
        connections=[*inputs, *inside, *outputs] if border else inside,
        units={unit: base_exponents(unit) for unit in sorted({v.unit for item in components for v in item.connectors})},
    )


def _connectors(table: Sequence[Variable]) -> tuple[Variable, ...]:
    return tuple(variable for variable in table if variable.causality in ("input", "output"))
