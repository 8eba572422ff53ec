"""An FMU file opened for replay: examined, described, unpacked, and its variables found by the scene's names.

package = read_package(path)
variables = find_variables(package, scene, {"q1": "cart_1.s"})
with unpacked(package) as package: ...
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from models.dynamics import derive
from models.scene import Scene
from validate.disk import temporary_folder
from validate.isolation.intake import FmuError, Intake, examine, unpack
from validate.replay.wiring import ENERGIES, INTERNAL_STEP, POWERS, Variables

# The types of a number in FMI 2.0 and 3.0.
REAL = ("Real", "Float64")
# What is of no use to an FMU that runs: it is told where its resources lie, and nothing else.
_NOT_RUN = ("documentation/", "sources/", "terminalsAndIcons/")


@dataclass(frozen=True, kw_only=True)
class Package:
    """An FMU that was let in: `description` is FMPy's model description, `intake` what was examined, `folder` where it lies unpacked, if it does."""

    path: Path
    description: Any
    intake: Intake
    folder: Path | None = None

    @property
    def digest(self) -> str:
        return self.intake.digest

    @property
    def is_three(self) -> bool:
        return self.intake.version.startswith("3.")

    @property
    def exchange(self) -> Any | None:
        return self.description.modelExchange if "ModelExchange" in self.intake.kinds else None

    @property
    def cosimulation(self) -> Any | None:
        return self.description.coSimulation if "CoSimulation" in self.intake.kinds else None


def read_package(path: Path) -> Package:
    """Examine and describe an FMU, without unpacking it. Raises IntakeError, FmuError, MachineError."""
    import fmpy  # 0.2 s to import

    intake = examine(path)
    collects = gc.isenabled()
    gc.disable()  # objects that all stay: looking for garbage among them took a third of the time of 400,000 variables
    try:
        description = fmpy.read_model_description(str(path), validate=False)
    except Exception as error:  # FMPy raises anything for a description it does not understand; it is reported
        raise FmuError(f"FMU {path}: its modelDescription.xml cannot be understood ({type(error).__name__}: {error}).") from error
    finally:
        if collects:
            gc.enable()
    package = Package(path=path, description=description, intake=intake)
    if package.exchange is None and package.cosimulation is None:
        raise FmuError(f"FMU {path}: it offers neither Model Exchange nor Co-Simulation.")
    return package


@contextmanager
def unpacked(package: Package) -> Iterator[Package]:
    """The package unpacked, as far as an FMU that runs may look into it; the folder is removed afterwards. One that lies unpacked is given as it is."""
    if package.folder is not None:
        yield package
        return
    with temporary_folder("touchstone-replay-") as folder:
        unpack(package.intake, folder, leave_out=_NOT_RUN)
        yield replace(package, folder=folder)


def find_variables(package: Package, scene: Scene, names: Mapping[str, str] | None = None) -> Variables:
    """The scene's variables in the FMU; `names` maps names of the scene to names in the FMU where they differ.

    Positions, velocities and inputs must be there; the rest may be missing. Raises FmuError naming the variable.
    """
    names = dict(names or {})
    groups = {
        "q": tuple(item.name for item in scene.coordinates),
        "v": tuple(item.velocity_name for item in scene.coordinates),
        "u": tuple(item.name for item in scene.inputs),
        "lam": tuple(item.force_name for item in scene.contacts),
        "gap": tuple(item.gap_name for item in scene.contacts),
        "friction": tuple(item.force_name for item in scene.frictions),
    }
    known = (
        {name for group in groups.values() for name in group}
        | {item.name for item in scene.parameters}
        | {*ENERGIES, *POWERS, INTERNAL_STEP}
    )
    for name in names:
        if name not in known:
            raise FmuError(
                f"FMU {package.path}: the map names {name!r}, which scene {scene.name} does not have; it has {', '.join(sorted(known))}."
            )
    by_name = {variable.name: variable for variable in package.description.modelVariables}

    def reference(name: str) -> int | None:
        variable = by_name.get(names.get(name, name))
        if variable is None and name in names:
            raise FmuError(f"FMU {package.path}: the map gives {names[name]!r} for {name!r}, but the FMU has no such variable.")
        if variable is not None and variable.type not in REAL:
            raise FmuError(f"FMU {package.path}: {variable.name} is of type {variable.type}, but must be {' or '.join(REAL)}.")
        return None if variable is None else int(variable.valueReference)

    found: dict[str, tuple[int, ...]] = {}
    for field, group in groups.items():
        references = [reference(name) for name in group]
        missing = [name for name, item in zip(group, references, strict=True) if item is None]
        if missing and field in ("q", "v", "u"):
            raise FmuError(
                f"FMU {package.path}: it has no variable {missing[0]!r} of scene {scene.name}; give its name in the FMU by a map."
            )
        found[field] = () if missing else tuple(item for item in references if item is not None)
    for name, item in zip(groups["u"], found["u"], strict=True):
        if by_name[names.get(name, name)].causality != "input":
            raise FmuError(f"FMU {package.path}: {names.get(name, name)} (value reference {item}) is no input, but the plan drives {name}.")

    parameters = []
    for parameter in scene.parameters:
        item = reference(parameter.name)
        if item is not None and by_name[names.get(parameter.name, parameter.name)].causality == "parameter":
            parameters.append((item, parameter.value))
    structure = derive(scene).structure
    absent = {
        "potential_energy": not structure.conservative_forces,
        "contact_energy": not structure.contacts,
        "input_power": not structure.inputs,
        "dissipated_power": not (structure.dissipation or structure.friction or structure.contact_damping),
    }

    def present(group: tuple[str, ...]) -> Mapping[str, int]:
        return {name: item for name in group if (item := reference(name)) is not None}

    return Variables(
        **found,
        energies=present(ENERGIES),
        powers=present(POWERS),
        zero=frozenset(name for name, is_absent in absent.items() if is_absent),
        parameters=tuple(parameters),
        start=found["q"] + found["v"],
        choices=(),
        internal_step=reference(INTERNAL_STEP),
    )
