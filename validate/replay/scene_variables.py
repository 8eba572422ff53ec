"""Which variables of an FMU are those of a scene. It needs the scene's equations, so it is apart from `package`, which who runs the FMU reads."""

from __future__ import annotations

from collections.abc import Mapping

from models.dynamics import derive
from models.scene import Scene
from validate.isolation.intake import FmuError
from validate.replay.package import REAL, Package
from validate.replay.wiring import ENERGIES, INTERNAL_STEP, POWERS, Variables


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
