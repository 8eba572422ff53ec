"""Scene -> the generated texts of its FMU: C configuration, modelDescription.xml, build description, documentation.

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
from models.fmu.kinds import INTEGRATORS, Kind, Variable
from models.fmu.rendering import render
from models.fmu.standards import Standard
from models.fmu.structure import Dependency, dependencies
from models.fmu.variables import friction_nominals, variable_table
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
    """A row of the ModelStructure: numbers of variables as the standard counts them."""

    index: int
    dependencies: tuple[int, ...]
    kinds: tuple[str, ...]


def model_structure(scene: Scene, standard: Standard) -> dict[str, list[Unknown]]:
    """Section of the ModelStructure -> its unknowns.

    Parameters are knowns during initialization; in FMI 3.0 always.
    """
    table = variable_table(scene)
    number = {variable.name: position for position, variable in enumerate(table, start=standard.first_index)}
    parameters = {variable.name for variable in table if variable.kind is Kind.PARAMETER}
    left_out = parameters if standard.version == "2.0" else set[str]()
    depends = dependencies(scene)

    def running(variable: Variable) -> Unknown:
        rows = [(number[name], kind.value) for name, kind in depends[variable.name].items() if name not in left_out]
        return Unknown(number[variable.name], tuple(row[0] for row in rows), tuple(row[1] for row in rows))

    def initial(variable: Variable) -> Unknown:
        # A factor that is a fixed parameter is itself a known during initialization, hence plainly dependent.
        rows = [
            (number[name], kind.value if kind is Dependency.CONSTANT else Dependency.DEPENDENT.value)
            for name, kind in depends[variable.name].items()
        ]
        return Unknown(number[variable.name], tuple(row[0] for row in rows), tuple(row[1] for row in rows))

    derivatives = [variable for variable in table if variable.kind in (Kind.POSITION_RATE, Kind.VELOCITY_RATE)]
    return {
        "outputs": [running(variable) for variable in table if variable.causality == "output"],
        "derivatives": [running(variable) for variable in derivatives],
        "initial": [initial(variable) for variable in table if variable.initial == "calculated"],
        "indicators": [running(variable) for variable in table if variable.kind in (Kind.GAP, Kind.RESERVE, Kind.PRESSING)],
    }


def unit_table(scene: Scene) -> dict[str, dict[str, int]]:
    """Every unit of the FMU -> exponents of its base units, sorted by name."""
    return {unit: base_exponents(unit) for unit in sorted({variable.unit for variable in variable_table(scene) if variable.unit})}


@dataclass(frozen=True)
class Description:
    """Generated texts; the first two carry the GUID."""

    guid: str
    config: str
    xml: str
    build: str
    documentation: str


def describe(scene: Scene, sources: Mapping[str, str], standard: Standard) -> Description:
    """The generated texts of the FMU made of these sources (file name -> text)."""
    table = variable_table(scene)
    identifier = model_identifier(scene)
    nominals = [coordinate.nominal for coordinate in scene.coordinates]
    numbers = {variable.name: position for position, variable in enumerate(table, start=standard.first_index)}
    state_of = {
        variable.name: numbers[variable.name[4:-1]] for variable in table if variable.kind in (Kind.POSITION_RATE, Kind.VELOCITY_RATE)
    }
    source_files = sorted(name for name in sources if name.endswith(".c"))

    def marked(guid: str) -> tuple[str, str]:
        config = render(
            "model_config.h.j2",
            identifier=identifier,
            guid=guid,
            table=table,
            state_nominals=[*nominals, *nominals],
            contact_nominals=[contact.nominal for contact in scene.contacts] or [1.0],
            friction_nominals=friction_nominals(scene),
        )
        xml = render(
            f"modelDescription_{standard.prefix}.xml.j2",
            scene=scene,
            identifier=identifier,
            guid=guid,
            date=datetime.fromtimestamp(source_epoch(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            source_files=source_files,
            units=unit_table(scene),
            integrators=INTEGRATORS,
            tolerance=TOLERANCE,
            table=table,
            state_of=state_of,
            structure=model_structure(scene, standard),
        )
        return config, xml

    config, xml = marked("")
    content = hashlib.sha256()
    for name, text in sorted({**sources, "model_config.h": config, "modelDescription.xml": xml}.items()):
        content.update(f"{name}\0{text}\0".encode())
    guid = content.hexdigest()
    config, xml = marked(guid)
    shared = {"identifier": identifier, "standard": standard}
    return Description(
        guid=guid,
        config=config,
        xml=xml,
        build=render("buildDescription.xml.j2", source_files=source_files, **shared),
        documentation=render("index.html.j2", scene=scene, table=table, absent=derive(scene).absent, integrators=INTEGRATORS, **shared),
    )
