"""An FMU file opened for replay: unpacked, described, and its variables found by the scene's names.

with open_package(path) as package:
    variables = find_variables(package, scene, {"q1": "cart_1.s"})
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from models.dynamics import derive
from models.errors import MachineError, TouchstoneError
from models.scene import Scene

# The outputs a replay can use beside positions and velocities; what an FMU lacks is computed from the scene or left out.
ENERGIES = ("kinetic_energy", "potential_energy", "contact_energy")
POWERS = ("input_power", "dissipated_power")
INTERNAL_STEP = "internal_step"


class FmuError(TouchstoneError):
    """An FMU cannot be opened or does not offer what the scene needs."""


@dataclass(frozen=True, kw_only=True)
class Package:
    """An unpacked FMU: `description` is FMPy's model description, `folder` where it lies, `digest` the SHA-256 of the file."""

    path: Path
    folder: Path
    description: Any
    digest: str

    @property
    def exchange(self) -> Any | None:
        return self.description.modelExchange

    @property
    def cosimulation(self) -> Any | None:
        return self.description.coSimulation


@dataclass(frozen=True, kw_only=True)
class Variables:
    """Value references by the scene's names. lam and gap are empty where the FMU lacks one of them.

    energies, powers: those the FMU has, by name; zero: names of energies and powers that the scene does not have at all;
    parameters: (reference, value) of every parameter of the scene that the FMU has; internal_step: of the Co-Simulation.
    """

    q: tuple[int, ...]
    v: tuple[int, ...]
    u: tuple[int, ...]
    lam: tuple[int, ...]
    gap: tuple[int, ...]
    energies: Mapping[str, int]
    powers: Mapping[str, int]
    zero: frozenset[str]
    parameters: tuple[tuple[int, float], ...]
    internal_step: int | None

    @property
    def outputs(self) -> tuple[int, ...]:
        """Of all that is read at a point of the replay: q, v, lam, gap, energies."""
        return self.q + self.v + self.lam + self.gap + tuple(self.energies.values())

    @property
    def rates(self) -> tuple[int, ...]:
        """Of what is integrated beside the states: contact forces, powers."""
        return self.lam + tuple(self.powers.values())


@contextmanager
def open_package(path: Path) -> Iterator[Package]:
    """Unpack and describe an FMU 2.0; the folder is removed afterwards. Raises FmuError."""
    import fmpy  # 0.2 s to import

    if not path.is_file():
        raise FmuError(f"FMU {path}: there is no such file.")
    with tempfile.TemporaryDirectory(prefix="touchstone-replay-", ignore_cleanup_errors=True) as folder:
        try:
            description = fmpy.read_model_description(str(path), validate=False)
            fmpy.extract(str(path), unzipdir=folder)
        except OSError as error:
            raise MachineError(f"FMU {path}: it cannot be unpacked to {folder} ({error}).") from error
        except Exception as error:  # FMPy raises anything for a file that is no FMU; it is reported
            raise FmuError(f"FMU {path}: it cannot be read as an FMU ({type(error).__name__}: {error}).") from error
        if description.fmiVersion != "2.0":
            raise FmuError(f"FMU {path}: it is FMI {description.fmiVersion}, but replay reads FMI 2.0.")
        if description.modelExchange is None and description.coSimulation is None:
            raise FmuError(f"FMU {path}: it offers neither Model Exchange nor Co-Simulation.")
        yield Package(path=path, folder=Path(folder), description=description, digest=hashlib.sha256(path.read_bytes()).hexdigest())


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
        if variable is not None and variable.type != "Real":
            raise FmuError(f"FMU {package.path}: {variable.name} is of type {variable.type}, but must be Real.")
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
        "dissipated_power": not structure.dissipation,
    }

    def present(group: tuple[str, ...]) -> Mapping[str, int]:
        return {name: item for name in group if (item := reference(name)) is not None}

    return Variables(
        **found,
        energies=present(ENERGIES),
        powers=present(POWERS),
        zero=frozenset(name for name, is_absent in absent.items() if is_absent),
        parameters=tuple(parameters),
        internal_step=reference(INTERNAL_STEP),
    )
