"""Scene -> the generated texts of its FMI 2.0 FMU: C configuration, modelDescription.xml, documentation.

The output depends on the scene alone: no date but SOURCE_DATE_EPOCH's, and a GUID that is a hash of everything else.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from models.dynamics import derive
from models.errors import SceneError, TouchstoneError
from models.fmu.rendering import render
from models.fmu.structure import Dependency, dependencies
from models.fmu.variables import Kind, Variable, variable_table
from models.scene import Scene
from models.units import base_exponents

# 1980-01-01, the earliest date a zip file can hold: the date of a build that was given none.
DEFAULT_EPOCH = 315532800
# Relative tolerance proposed to importers: the reference replay's, far below the error of any plan it judges.
TOLERANCE = 1e-8


def model_identifier(scene: Scene) -> str:
    """The name of the binary and the prefix of C symbols. Raises SceneError if the scene's name is no C identifier."""
    if not scene.name.isascii():
        raise SceneError(f"scene {scene.name}: an FMU needs a name of ASCII letters, digits and _; rename the scene and its file.")
    return scene.name


def source_epoch() -> int:
    """Seconds since 1970 of the generation date: SOURCE_DATE_EPOCH, or a fixed date."""
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if text is None:
        return DEFAULT_EPOCH
    if not text.isdigit() or int(text) < DEFAULT_EPOCH:
        raise TouchstoneError(
            f"SOURCE_DATE_EPOCH is {text!r}; it must be whole seconds since 1970, from {DEFAULT_EPOCH} (1980) on. Correct it or unset it."
        )
    return int(text)


@dataclass(frozen=True)
class Unknown:
    """A row of the ModelStructure: 1-based indices, as FMI 2.0 counts."""

    index: int
    dependencies: tuple[int, ...]
    kinds: tuple[str, ...]


def model_structure(scene: Scene) -> dict[str, list[Unknown]]:
    """Section of the ModelStructure -> its unknowns. Parameters are knowns during initialization only."""
    table = variable_table(scene)
    number = {variable.name: position for position, variable in enumerate(table, start=1)}
    parameters = {variable.name for variable in table if variable.kind is Kind.PARAMETER}
    depends = dependencies(scene)

    def running(variable: Variable) -> Unknown:
        rows = [(number[name], kind.value) for name, kind in depends[variable.name].items() if name not in parameters]
        return Unknown(number[variable.name], tuple(row[0] for row in rows), tuple(row[1] for row in rows))

    def initial(variable: Variable) -> Unknown:
        # A factor that is a fixed parameter is itself a known during initialization, hence plainly dependent.
        rows = [
            (number[name], kind.value if kind is Dependency.CONSTANT else Dependency.DEPENDENT.value)
            for name, kind in depends[variable.name].items()
        ]
        return Unknown(number[variable.name], tuple(row[0] for row in rows), tuple(row[1] for row in rows))

    outputs = [variable for variable in table if variable.causality == "output"]
    derivatives = [variable for variable in table if variable.kind in (Kind.POSITION_RATE, Kind.VELOCITY_RATE)]
    calculated = [variable for variable in table if variable.initial == "calculated"]
    return {
        "Outputs": [running(variable) for variable in outputs],
        "Derivatives": [running(variable) for variable in derivatives],
        "InitialUnknowns": [initial(variable) for variable in calculated],
    }


def unit_table(scene: Scene) -> dict[str, dict[str, int]]:
    """Every unit of the FMU -> exponents of its base units, sorted by name."""
    return {unit: base_exponents(unit) for unit in sorted({variable.unit for variable in variable_table(scene)})}


@dataclass(frozen=True)
class Description:
    """Generated texts that carry the GUID."""

    guid: str
    config: str
    xml: str
    documentation: str


def describe(scene: Scene, sources: Mapping[str, str]) -> Description:
    """The generated texts of the FMU made of these sources (file name -> text)."""
    table = variable_table(scene)
    identifier = model_identifier(scene)
    nominals = [coordinate.nominal for coordinate in scene.coordinates]
    numbers = {variable.name: position for position, variable in enumerate(table, start=1)}
    state_of = {
        variable.name: numbers[variable.name[4:-1]] for variable in table if variable.kind in (Kind.POSITION_RATE, Kind.VELOCITY_RATE)
    }

    def texts(guid: str) -> Description:
        config = render(
            "model_config.h.j2",
            identifier=identifier,
            guid=guid,
            table=table,
            state_nominals=[*nominals, *nominals],
            contact_nominals=[contact.nominal for contact in scene.contacts] or [1.0],
        )
        xml = render(
            "modelDescription_fmi2.xml.j2",
            scene=scene,
            identifier=identifier,
            guid=guid,
            date=datetime.fromtimestamp(source_epoch(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            source_files=sorted(name for name in sources if name.endswith(".c")),
            units=unit_table(scene),
            tolerance=TOLERANCE,
            table=table,
            state_of=state_of,
            structure=model_structure(scene),
        )
        documentation = render("index.html.j2", scene=scene, identifier=identifier, table=table, absent=derive(scene).absent)
        return Description(guid, config, xml, documentation)

    draft = texts("")
    content = hashlib.sha256()
    for name, text in sorted({**sources, "model_config.h": draft.config, "modelDescription.xml": draft.xml}.items()):
        content.update(f"{name}\0{text}\0".encode())
    return texts(content.hexdigest())
