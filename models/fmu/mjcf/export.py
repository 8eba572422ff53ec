"""Build the FMU file of a robot from MuJoCo's library, the compiled model and our shell.

    build_robot(read_robot(Path("robot.xml")))  # .../a1b2....robot.fmu

The binary loads the library from its own folder ($ORIGIN). Equal robots give equal bytes.
"""

from __future__ import annotations

import hashlib
import sys
from importlib import metadata
from pathlib import Path

import numpy as np

from models.codegen.cache import cached
from models.codegen.compiler import find_compiler
from models.errors import MachineError
from models.fmu.description import (
    Standard,
    Unknown,
    find_standard,
    render,
    stamped,
    standard_headers,
)
from models.fmu.mjcf.robot import FARTHEST, INTEGRATORS, Robot, RobotError, mujoco
from models.fmu.package import belongs, binaries, find_platforms, pack
from models.fmu.variables import VariableKind

_HERE = Path(__file__).parent
_SHELL = _HERE.parent / "shell"
_OURS = ("equations.h", "integrator.h")
# Files of the shell that are for scenes only.
_OF_SCENES = (*_OURS, "model.h", "damping_modes.h", "friction_modes.h")
# Proposed duration of the experiment [s].
_STOP = 1.0
_TOLERANCE = 1e-6
_SETTINGS = (VariableKind.TUNABLE, VariableKind.INTERNAL_STEP, VariableKind.INTEGRATOR)


def build_robot(robot: Robot, version: str = "2.0") -> Path:
    """Return the FMU of a robot for this machine, from the cache or built.

    Raises UnknownNameError for an unknown FMI version, RobotError for colliding names, MachineError
    without a compiler, a library of MuJoCo or a writable cache.
    """
    standard, package = find_standard(version), mujoco()
    folder = Path(package.__file__).parent
    libraries = sorted(folder.glob("libmujoco.so.*"))
    if not sys.platform.startswith("linux") or len(libraries) != 1:
        raise MachineError(
            "an MJCF is exported on Linux alone, where the wheel of MuJoCo has a library that can be shipped with the FMU; do it there."
        )
    compiler, (platform,) = find_compiler(), find_platforms(())
    library, model = libraries[0].read_bytes(), _compiled(robot)
    texts, sources = _texts(
        robot, standard, {"resources/model.mjb": model, libraries[0].name: library}
    )
    flags = [
        "-isystem",
        str(folder / "include"),
        "-Wl,--no-as-needed",
        str(libraries[0]),
        "-Wl,-rpath,$ORIGIN",
    ]

    def build(path: Path) -> None:
        code = {f"sources/{name}": text for name, text in sources.items()}
        content = {name: text.encode() for name, text in texts.items()} | _licenses()
        content |= {
            "resources/model.mjb": model,
            f"binaries/{platform.folder(standard)}/{libraries[0].name}": library,
        }
        content |= binaries(
            code, standard, robot.identifier, {platform: compiler}, path.parent, flags
        )
        pack(path, content, first="modelDescription.xml")

    key = [
        compiler.version,
        platform.name,
        *flags,
        *(f"{name}\n{text}" for name, text in sorted({**texts, **sources}.items())),
    ]
    return cached("\n".join(key), f".{robot.identifier}.fmu", build)


def _compiled(robot: Robot) -> bytes:
    package = mujoco()
    try:
        buffer = np.zeros(package.mj_sizeModel(robot.model), dtype=np.uint8)
        package.mj_saveModel(robot.model, None, buffer)
    except (ValueError, TypeError, package.FatalError) as error:
        raise RobotError(f"{robot.path}: MuJoCo cannot write it as a binary ({error}).") from error
    return buffer.tobytes()


def _licenses() -> dict[str, bytes]:
    licenses = {}
    for name in ("mujoco-core", "mujoco"):
        try:
            files = metadata.files(name) or []
        except metadata.PackageNotFoundError:
            continue
        licenses |= {
            f"documentation/licenses/mujoco/{file.name}": file.read_binary()
            for file in files
            if file.name.startswith("LICENSE")
        }
    return licenses


def _texts(
    robot: Robot, standard: Standard, shipped: dict[str, bytes]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return the text files of the FMU, and the sources of its binary.

    shipped: further content of the GUID
    """
    package, model, table = mujoco(), robot.model, robot.table
    sources = {
        path.name: path.read_text(encoding="utf-8")
        for path in [*sorted(_SHELL.iterdir()), *(_HERE / name for name in _OURS)]
        if belongs(path, standard) and (path.parent == _HERE or path.name not in _OF_SCENES)
    }
    sources |= {
        f"{standard.header_folder}{name}": text for name, text in standard_headers(standard).items()
    }
    shared = {
        "identifier": robot.identifier,
        "title": f"{robot.path.name} in MuJoCo {package.__version__}", "integrators": INTEGRATORS,
        "exchange": robot.no_exchange is None, "events": False, "table": table,
    }  # fmt: skip
    of_robot = {
        "robot": robot,
        "model": model,
        "mujoco": package.__version__,
        "farthest": FARTHEST,
        "rest": int(package.mj_stateSize(model, package.mjtState.mjSTATE_INTEGRATION))
        - 1
        - model.nq
        - model.nv
        - model.na,
        "settings": sum(variable.kind in _SETTINGS for variable in table),
    }

    decided = {name: hashlib.sha256(content).hexdigest() for name, content in shipped.items()}
    header, xml = stamped(
        sources | decided, standard,
        lambda guid: render("mjcf/robot_config.h.j2", guid=guid, **of_robot, **shared),
        license="MIT AND Apache-2.0", stop=_STOP, step=float(model.opt.timestep),
        tolerance=_TOLERANCE,
        source_files=[], structure=_structure(robot, standard), **shared,
    )  # fmt: skip
    texts = {
        "modelDescription.xml": xml,
        "documentation/index.html": render("mjcf/robot.html.j2", **of_robot, **shared),
        "documentation/licenses/license.txt": render(
            "licenses.txt.j2", header_names=standard.headers
        )
        + f"\nbinaries/*/libmujoco.so.* is MuJoCo {package.__version__}, under the licenses in mujoco/.\nresources/model.mjb is {robot.path.name}, whose license is its author's.\n",
    }
    return texts, sources | {"model_config.h": header}


def _structure(robot: Robot, standard: Standard) -> dict[str, list[Unknown]]:
    """Return the ModelStructure with all possible dependencies.

    Model Exchange lists them, because CasADi does not read a structure without.
    """

    def places(*wanted: VariableKind) -> list[int]:
        return [
            place
            for place, variable in enumerate(robot.table, standard.first_index)
            if variable.kind in wanted
        ]

    kinds, exchange = VariableKind, robot.no_exchange is None
    states, calculated = places(kinds.POSITION, kinds.VELOCITY), places(kinds.OUTPUT)
    rates = places(kinds.POSITION_RATE, kinds.VELOCITY_RATE) if exchange else []
    known, settings = [*states, *places(kinds.INPUT)], places(*_SETTINGS)

    def unknowns(which: list[int], knowns: list[int]) -> list[Unknown]:
        return [
            Unknown(place, tuple(knowns), ("dependent",) * len(knowns))
            if exchange
            else Unknown(place)
            for place in which
        ]

    # FMI 3.0 counts parameters always.
    always = [*known, *settings] if standard.version != "2.0" else known
    moved = [
        Unknown(place, (place,), ("constant",)) if exchange else Unknown(place, (), ())
        for place in states
    ]
    return {
        "outputs": [*moved, *unknowns(calculated, always)],
        "derivatives": unknowns(rates, always),
        "initial": unknowns([*rates, *calculated], [*known, *settings]),
        "indicators": [],
    }
