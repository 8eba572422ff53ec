"""Scene -> the generated texts of its FMU: C configuration, modelDescription.xml, build description, documentation.

The output depends on the scene and the version of FMI alone: no date but SOURCE_DATE_EPOCH's, and a
GUID that is a hash of everything else.

Templates are strict: an undefined name stops the build, numbers are written so that they read back
bit for bit.
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


_TEMPLATES = Path(__file__).parent / "templates"


def number(value: float) -> str:
    """The shortest text that reads back as the same double; C's HUGE_VAL for an infinite one."""
    if math.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


@lru_cache(maxsize=1)
def _engine() -> jinja2.Environment:
    import jinja2  # only where an FMU is built, not where it is found

    engine = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        undefined=jinja2.StrictUndefined,
        autoescape=lambda name: name is not None and name.endswith((".xml.j2", ".html.j2")),
        keep_trailing_newline=True,
    )
    engine.filters["number"] = number
    engine.filters["isfinite"] = math.isfinite
    return engine


def render(template: str, block: str = "", **context: Any) -> str:
    """The text of `templates/<template>`, or of a block of it.

    Raises jinja2.UndefinedError if the template names something not given.
    """
    found = _engine().get_template(template)
    return (
        "".join(found.blocks[block](found.new_context(context)))
        if block
        else found.render(**context)
    )


@dataclass(frozen=True)
class Standard:
    """One version of FMI and how its files differ.

    prefix: of its functions and of the shell's files; headers: names of the standard's files;
        header_folder: where they lie
    within `sources` ("" or with a slash at its end); first_index: number of the first variable in
        the ModelStructure.
    """

    version: str
    prefix: str
    headers: tuple[str, ...]
    header_folder: str
    first_index: int


# FMI 3.0 wants its headers from the importer: ours stay in a folder of their own, which an importer
# may leave out.
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
    """The standard of a version, "2.0" or "3.0". Raises UnknownNameError for another one."""
    if version not in STANDARDS:
        raise UnknownNameError(
            f"FMI version {version!r} is not offered; choose {' or '.join(STANDARDS)}."
        )
    return STANDARDS[version]


def standard_headers(standard: Standard) -> dict[str, str]:
    """The headers of the FMI standard, taken from the FMPy package.

    Raises MachineError if it is not installed.
    """
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


# 1980-01-01, the earliest date a zip file can hold: the date of a build that was given none.
DEFAULT_EPOCH = 315532800
# Relative tolerance proposed to importers: the reference replay's, far below the error of any plan
# it judges.
TOLERANCE = 1e-8
_RATES = (VariableKind.POSITION_RATE, VariableKind.VELOCITY_RATE)


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


def generation_date() -> str:
    """The same as FMI writes it."""
    return datetime.fromtimestamp(source_epoch(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True)
class Unknown:
    """A row of the ModelStructure: numbers of variables as the standard counts them.

    Without dependencies it may depend on every known.
    """

    index: int
    dependencies: tuple[int, ...] | None = None
    kinds: tuple[str, ...] = ()


def model_structure(scene: Scene, standard: Standard) -> dict[str, list[Unknown]]:
    """Section of the ModelStructure -> its unknowns.

    Parameters are knowns during initialization; in FMI 3.0 always.
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
        # A factor that is a fixed parameter is itself a known during initialization, hence plainly
        # dependent.
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
    """Every unit of the variables -> exponents of its base units, sorted by name."""
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
    """C configuration and model description, which carry the GUID, a hash of all content.

    content: all other texts by their names; config: GUID -> C configuration; shared: what else the
        template of the model description needs, exchange: whether
    there is Model Exchange, and events: whether there are events, adjoint derivatives and inputs
        that slope.
    """
    numbers = {
        variable.name: position
        for position, variable in enumerate(table, start=standard.first_index)
    }
    state_of = {
        variable.name: numbers[variable.name[4:-1]] for variable in table if variable.kind in _RATES
    }
    given = {
        **shared,
        "table": table,
        "state_of": state_of,
        "units": unit_table(table),
        "date": generation_date(),
    }

    def marked(guid: str) -> tuple[str, str]:
        return config(guid), render(
            f"modelDescription_{standard.prefix}.xml.j2", guid=guid, **given
        )

    found, texts = (
        hashlib.sha256(),
        dict(zip(("model_config.h", "modelDescription.xml"), marked(""), strict=True)),
    )
    for name, text in sorted({**content, **texts}.items()):
        found.update(f"{name}\0{text}\0".encode())
    return marked(found.hexdigest())


def describe(scene: Scene, sources: Mapping[str, str], standard: Standard) -> dict[str, str]:
    """The generated texts of the FMU made of these sources (file name -> text), by their paths inside."""
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
