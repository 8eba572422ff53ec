"""Generate the texts of a scene's FMU: C configuration, modelDescription.xml, documentation.

The output depends on scene and FMI version only; the date is SOURCE_DATE_EPOCH, the GUID a hash of
the rest. An undefined name in a template stops the build; numbers read back bit for bit.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.dynamics import derive
from models.errors import MachineError, TouchstoneError, UnknownNameError
from models.fmu.structure import Dependency, dependencies
from models.fmu.variables import (
    INTEGRATORS,
    Variable,
    VariableKind,
    friction_nominals,
    variable_table,
)
from models.scene import Scene
from models.scene.values import base_exponents

if TYPE_CHECKING:
    import jinja2


_HERE = Path(__file__).parent


def number(value: float) -> str:
    """Return the shortest text of a double; C's HUGE_VAL for infinity."""
    if math.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


@lru_cache(maxsize=1)
def _engine() -> jinja2.Environment:
    import jinja2  # not needed for cached FMUs

    engine = jinja2.Environment(
        loader=jinja2.FileSystemLoader([_HERE / "templates", _HERE]),
        undefined=jinja2.StrictUndefined,
        autoescape=lambda name: name is not None and name.endswith((".xml.j2", ".html.j2")),
        keep_trailing_newline=True,
    )
    engine.filters["number"] = number
    engine.filters["isfinite"] = math.isfinite
    return engine


def render(template: str, block: str = "", **context: Any) -> str:
    """Return the text of a template, or of one of its blocks.

    template: name of a file in `templates`, or `FOLDER/FILE` beside it.

    Raises jinja2.UndefinedError for an undefined name.
    """
    source = _engine().get_template(template)
    return (
        "".join(source.blocks[block](source.new_context(context)))
        if block
        else source.render(**context)
    )


@dataclass(frozen=True)
class Standard:
    """One version of FMI.

    prefix: of its functions and of the shell's files
    headers: names of the standard's files
    header_folder: within `sources`, "" or with a final slash
    first_index: number of the first variable in the ModelStructure
    """

    version: str
    prefix: str
    headers: tuple[str, ...]
    header_folder: str
    first_index: int


# In FMI 3.0 importers provide the headers; our copies are in a folder that importers may ignore.
STANDARDS = {
    standard.version: standard
    for standard in (
        Standard(
            "2.0", "fmi2", ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"), "", 1
        ),
        Standard(
            "3.0",
            "fmi3",
            ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
            "standard/",
            0,
        ),
    )
}


def find_standard(version: str) -> Standard:
    """Return the standard of version "2.0" or "3.0"; raise UnknownNameError for another one."""
    if version not in STANDARDS:
        raise UnknownNameError(
            f"FMI version {version!r} is not offered; choose {' or '.join(STANDARDS)}."
        )
    return STANDARDS[version]


def standard_headers(standard: Standard) -> dict[str, str]:
    """Return the headers of the FMI standard from FMPy; raise MachineError without it."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise MachineError(
            "the headers of the FMI standard are missing: they come with FMPy; install it with: pip install fmpy"
        )
    folder = Path(spec.origin).parent / "c-code"
    try:
        return {name: (folder / name).read_text(encoding="utf-8") for name in standard.headers}
    except OSError as error:
        raise MachineError(
            f"the headers of the FMI standard cannot be read from FMPy ({error}); reinstall it with: pip install --force-reinstall fmpy"
        ) from error


# 1980-01-01, the earliest date in a zip file.
DEFAULT_EPOCH = 315532800
# Proposed relative tolerance, that of the reference replay: far below the error of a plan.
TOLERANCE = 1e-8
_RATES = (VariableKind.POSITION_RATE, VariableKind.VELOCITY_RATE)


def source_epoch() -> int:
    """Return the generation date in seconds since 1970: SOURCE_DATE_EPOCH, or a fixed date."""
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if text is None:
        return DEFAULT_EPOCH
    if not text.isdigit() or int(text) < DEFAULT_EPOCH:
        raise TouchstoneError(
            f"SOURCE_DATE_EPOCH is {text!r}; it must be whole seconds since 1970, from {DEFAULT_EPOCH} (1980) on. Correct it or unset it."
        )
    return int(text)


def generation_date() -> str:
    """Return the generation date in FMI's format."""
    return datetime.fromtimestamp(source_epoch(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True)
class Unknown:
    """A row of the ModelStructure, with the standard's numbers of variables.

    Without dependencies it may depend on every known.
    """

    index: int
    dependencies: tuple[int, ...] | None = None
    kinds: tuple[str, ...] = ()


def model_structure(scene: Scene, standard: Standard) -> dict[str, list[Unknown]]:
    """Return section of the ModelStructure -> its unknowns.

    Parameters are known during initialization, in FMI 3.0 always.
    """
    table = variable_table(scene)
    number = {
        variable.name: position
        for position, variable in enumerate(table, start=standard.first_index)
    }
    parameters = {variable.name for variable in table if variable.kind is VariableKind.PARAMETER}
    left_out = parameters if standard.version == "2.0" else set[str]()
    depends = dependencies(scene)

    def unknown(variable: Variable, *, initially: bool = False) -> Unknown:
        rows = {
            number[name]: kind
            for name, kind in depends[variable.name].items()
            if initially or name not in left_out
        }
        # A fixed parameter is a known during initialization, hence its factor is a dependency.
        kinds = [
            Dependency.DEPENDENT if initially and kind is Dependency.FIXED else kind
            for kind in rows.values()
        ]
        return Unknown(number[variable.name], tuple(rows), tuple(kinds))

    indicators = (VariableKind.GAP, VariableKind.RESERVE, VariableKind.PRESSING)
    return {
        "outputs": [unknown(variable) for variable in table if variable.causality == "output"],
        "derivatives": [unknown(variable) for variable in table if variable.kind in _RATES],
        "initial": [
            unknown(variable, initially=True)
            for variable in table
            if variable.initial == "calculated"
        ],
        "indicators": [unknown(variable) for variable in table if variable.kind in indicators],
    }


def unit_table(variables: Iterable[Variable]) -> dict[str, dict[str, int]]:
    """Return unit -> exponents of its base units, sorted by name."""
    return {
        unit: base_exponents(unit)
        for unit in sorted({variable.unit for variable in variables if variable.unit})
    }


def stamped(
    content: Mapping[str, str],
    standard: Standard,
    config: Callable[[str], str],
    *,
    table: Sequence[Variable],
    **shared: Any,
) -> tuple[str, str]:
    """Return C configuration and model description with the GUID, a hash of all content.

    content: all other texts by name
    config: GUID -> C configuration
    shared: further context of the model description
    exchange: whether there is Model Exchange
    events: whether there are events, adjoint derivatives and sloped inputs
    """
    numbers = {
        variable.name: position
        for position, variable in enumerate(table, start=standard.first_index)
    }
    state_of = {
        variable.name: numbers[variable.name[4:-1]] for variable in table if variable.kind in _RATES
    }
    context = {
        **shared,
        "table": table,
        "state_of": state_of,
        "units": unit_table(table),
        "date": generation_date(),
    }

    def marked(guid: str) -> tuple[str, str]:
        return config(guid), render(
            f"modelDescription_{standard.prefix}.xml.j2", guid=guid, **context
        )

    digest, texts = (
        hashlib.sha256(),
        dict(zip(("model_config.h", "modelDescription.xml"), marked(""), strict=True)),
    )
    for name, text in sorted({**content, **texts}.items()):
        digest.update(f"{name}\0{text}\0".encode())
    return marked(digest.hexdigest())


def describe(scene: Scene, sources: Mapping[str, str], standard: Standard) -> dict[str, str]:
    """Return the generated texts of the FMU with these sources (name -> text), by path."""
    table, nominals = (
        variable_table(scene),
        [coordinate.nominal for coordinate in scene.coordinates],
    )
    shared = {
        "identifier": scene.name, "table": table, "integrators": INTEGRATORS,
        "source_files": sorted(name for name in sources if name.endswith(".c")),
    }  # fmt: skip
    of_config = {
        "state_nominals": [*nominals, *nominals],
        "contact_nominals": [contact.nominal for contact in scene.contacts] or [1.0],
        "friction_nominals": friction_nominals(scene),
    }  # fmt: skip
    header, xml = stamped(
        sources, standard,
        lambda guid: render("model_config.h.j2", guid=guid, **of_config, **shared),
        title=scene.title, license="MIT",
        exchange=True, events=True, stop=scene.task.horizon, step=scene.task.step,
        tolerance=TOLERANCE, structure=model_structure(scene, standard), **shared,
    )  # fmt: skip
    return {
        "modelDescription.xml": xml,
        "documentation/index.html": render(
            "index.html.j2", scene=scene, absent=derive(scene).absent, standard=standard, **shared
        ),
        "sources/model_config.h": header,
        "sources/buildDescription.xml": render(
            "buildDescription.xml.j2", standard=standard, **shared
        ),
    }
