"""Map, plan and FMU brought together: MAP.toml (or equal names) -> a ForeignModel, its wiring, and the plan as a Trajectory.

foreign, trajectory = wire(package, PlanTable(path), map_file, hold)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import TrajectoryError
from models.plan_table import PlanTable
from models.scene_annotations import Limit
from models.trajectory import Hold, Trajectory
from validate.replay.equal_names import by_equal_names, hint
from validate.replay.map_schema import MapError, MapFile, Signal
from validate.replay.package import REAL, Package
from validate.replay.run import Foreign
from validate.replay.subject import ForeignContact, ForeignCoordinate, ForeignInput, ForeignModel, ForeignTask
from validate.replay.wiring import INTERNAL_STEP, Variables

_HOLDS = {"zero": Hold.ZERO_ORDER, "linear": Hold.LINEAR}


def wire(package: Package, table: PlanTable, given: MapFile | None, hold: str | None, where: str) -> tuple[Foreign, Trajectory]:
    """where: what a mistake is said about, "map FILE" or "FMU FILE". Raises MapError, TrajectoryError."""
    table.check_form()
    wiring = _Wiring(package, table, given or by_equal_names(package, table), where)
    return wiring.foreign(), wiring.trajectory(_HOLDS[hold or wiring.map.plan.hold])


class _Wiring:
    def __init__(self, package: Package, table: PlanTable, given: MapFile, where: str) -> None:
        self.map, self._table, self._package, self._where = given, table, package, where
        self._by_name = {variable.name: variable for variable in package.description.modelVariables}
        self._check_names()
        self._velocities = [given.velocities[name] for name in given.positions if name in given.velocities]
        self._check_columns()
        self.lacks = self._lacks()

    # Names

    def _fail(self, path: str, text: str) -> MapError:
        return MapError(f"{self._where}: {path}: {text}")

    def _variable(self, path: str, name: str) -> Any:
        variable = self._by_name.get(name)
        if variable is None:
            known = [item for item, value in self._by_name.items() if value.type in REAL]
            raise self._fail(path, f"the FMU has no variable {name!r}{hint(name, known)}.")
        if variable.type not in REAL or getattr(variable, "dimensions", None):
            raise self._fail(
                path, f"{name!r} is of type {variable.type}{' (an array)' if variable.type in REAL else ''}, but must be one number."
            )
        return variable

    def _reference(self, path: str, name: str) -> int:
        return int(self._variable(path, name).valueReference)

    def _parameter(self, path: str, name: str, value: float | None = None) -> int:
        variable = self._variable(path, name)
        if variable.causality != "parameter":
            raise self._fail(path, f"{name!r} is no parameter of the FMU, but {variable.causality}.")
        if value is not None:
            for sign, name_of, end in ((-1, "least", variable.min), (1, "most", variable.max)):
                if end is not None and sign * value > sign * float(end):
                    raise self._fail(path, f"{value:g} is not possible: the FMU allows at {name_of} {float(end):g}.")
        return int(variable.valueReference)

    def _startable(self, path: str, name: str) -> int:
        variable = self._variable(path, name)
        if variable.causality not in ("parameter", "input") and variable.initial not in ("exact", "approx"):
            raise self._fail(path, f"{name!r} has no start value that can be set: the FMU calculates it.")
        return int(variable.valueReference)

    def _check_names(self) -> None:
        given = self.map
        driven: dict[str, str] = {}
        for name, signal in given.inputs.items():
            path = f"inputs.{name}"
            if signal.variable in driven:
                raise self._fail(path, f"{signal.variable!r} is driven by the column {driven[signal.variable]!r} already.")
            driven[signal.variable] = name
            if self._variable(path, signal.variable).causality != "input":
                raise self._fail(path, f"{signal.variable!r} is no input of the FMU.")
            self._check_unit(path, name, signal)
        for name, signal in given.positions.items():
            self._check_unit(f"positions.{name}", name, signal)
        for name, signal in given.velocities.items():
            if name not in given.positions:
                raise self._fail(f"velocities.{name}", f"there is no position of that name{hint(name, given.positions)}.")
            self._check_unit(f"velocities.{name}", self._velocity_column(name), signal)
        for name, entry in given.contacts.items():
            if entry.force is None and entry.gap is None:
                raise self._fail(f"contacts.{name}", "it names neither force nor gap.")
        known = [*given.positions, *(self._velocity_column(name) for name in given.velocities)]
        for name in given.goal:
            if name not in known:
                near = hint(name, known) or f"; there are {', '.join(known)}"
                raise self._fail(f"goal.{name}", f"there is no position or velocity of that name{near}.")

    def _check_unit(self, path: str, column: str, signal: Signal) -> None:
        """A unit that the map or the plan's header says, against the FMU's; where they differ, a scale must say how."""
        variable = self._variable(path, signal.variable)
        written = self._table.units.get(column)
        if signal.unit and written and signal.unit != written:
            raise self._fail(path, f"the plan's column {column!r} is in {written!r}, but the map says {signal.unit!r}.")
        unit = signal.unit or written
        if unit and variable.unit and unit != variable.unit and signal.scale == 1.0 and signal.offset == 0.0:
            raise self._fail(path, f"the plan is in {unit!r}, but {signal.variable!r} is in {variable.unit!r}; give a scale.")
        if signal.scale == 0.0:
            raise self._fail(path, "scale is 0; it must not be.")

    def _velocity_column(self, position: str) -> str:
        return self.map.velocities[position].column or f"v_{position}"

    def _force_column(self, contact: str) -> str:
        return self.map.contacts[contact].column or f"lam_{contact}"

    def _check_columns(self) -> None:
        given, table = self.map, self._table
        needed = [given.plan.time, *given.inputs]
        for name in needed:
            if name not in table.names:
                raise TrajectoryError(
                    f"plan {table.path}: the column {name!r} is missing{hint(name, table.names)}; it has {', '.join(table.names)}."
                )
        known = {*needed, *given.positions, *map(self._velocity_column, given.velocities), *map(self._force_column, given.contacts)}
        for name in table.names:
            if name not in known:
                raise TrajectoryError(
                    f"plan {table.path}: the column {name!r} is unknown{hint(name, known)}; {self._where} names {', '.join(sorted(known))}."
                )
        if given.plan.time in table.units:
            table.check_unit(given.plan.time, "s")

    def _lacks(self) -> Mapping[str, str]:
        """What cannot be shown, and why."""
        given, names = self.map, self._table.names
        contacts = given.contacts.values()
        lacks = {}
        driven = {signal.variable for signal in given.inputs.values()}
        idle = [
            name
            for name, variable in self._by_name.items()
            if variable.causality == "input" and variable.type in REAL and name not in driven
        ]
        if idle:
            lacks["inputs"] = (
                f"the plan says nothing of inputs of the FMU, which keep their start values: {', '.join(idle[:5])}{' ...' * (len(idle) > 5)}"
            )
        if not given.positions:
            lacks["q"] = "no positions are named"
        elif not any(name in names for name in given.positions):
            lacks["plan q"] = "the plan has no positions"
        if len(self._velocities) < len(given.positions):
            lacks["v"] = "not every position has a velocity named"
        if any(entry.gap is None for entry in contacts):
            lacks["gap"] = "not every contact has a gap named"
        if any(entry.force is None for entry in contacts):
            lacks["lam"] = "not every contact has a force named"
        if not contacts:
            lacks["contacts"] = "no contacts are named: ghost and missed impulse and penetration cannot be shown"
        return lacks

    # What comes of it

    def foreign(self) -> Foreign:
        given, lacks = self.map, self.lacks
        has_v, has_lam, has_gap = "v" not in lacks, "lam" not in lacks, "gap" not in lacks
        outputs: list[tuple[str, Signal]] = [(f"positions.{name}", signal) for name, signal in given.positions.items()]
        count_q = len(outputs)
        outputs += [(f"velocities.{name}", given.velocities[name]) for name in given.positions if has_v]
        count_v = len(outputs) - count_q
        forces = [(f"contacts.{name}.force", entry.force) for name, entry in given.contacts.items() if has_lam and entry.force]
        gaps = [(f"contacts.{name}.gap", entry.gap) for name, entry in given.contacts.items() if has_gap and entry.gap]
        outputs += [*forces, *gaps]
        references = tuple(self._reference(path, signal.variable) for path, signal in outputs)
        at_lam, at_gap = count_q + count_v, count_q + count_v + len(forces)
        settings = self._settings()
        internal = given.internal_step
        if internal is None and INTERNAL_STEP in self._by_name:
            internal = INTERNAL_STEP
        return Foreign(
            model=self._model(),
            variables=Variables(
                q=references[:count_q],
                v=references[count_q:at_lam],
                lam=references[at_lam:at_gap],
                gap=references[at_gap:],
                u=tuple(self._reference(f"inputs.{name}", signal.variable) for name, signal in given.inputs.items()),
                energies={},
                powers={},
                zero=frozenset(),
                parameters=tuple((self._parameter(f"parameters.{name}", name, value), value) for name, value in given.parameters.items()),
                start=tuple(reference for reference, _ in settings),
                internal_step=None if internal is None else self._parameter("internal_step", internal),
            ),
            scale=np.array([signal.scale for _, signal in outputs]),
            offset=np.array([signal.offset for _, signal in outputs]),
            input_scale=np.array([signal.scale for signal in given.inputs.values()]),
            input_offset=np.array([signal.offset for signal in given.inputs.values()]),
            start=np.array([value for _, value in settings]),
        )

    def _settings(self) -> list[tuple[int, float]]:
        """Start variables and their values: those of the map, and positions and velocities of the plan's first row that can be set."""
        given, found = self.map, {}
        for name, value in given.start.items():
            path = f"start.{name}"
            if isinstance(value, str):
                if value not in self._table.names:
                    raise self._fail(path, f"the plan has no column {value!r}{hint(value, self._table.names)}.")
                value = float(self._column(value, False)[0])
            found[self._startable(path, name)] = float(value)
        signals: list[tuple[str, Signal]] = [
            *given.positions.items(),
            *((self._velocity_column(name), signal) for name, signal in given.velocities.items()),
        ]
        for column, signal in signals:
            variable = self._by_name[signal.variable]
            if column in self._table.names and variable.initial in ("exact", "approx") and variable.start is not None:
                first = float(self._column(column, False)[0])
                found.setdefault(int(variable.valueReference), (first - signal.offset) / signal.scale)
        return list(found.items())

    def _model(self) -> ForeignModel:
        given = self.map
        coordinates = tuple(
            ForeignCoordinate(
                name=name,
                velocity_name=self._velocity_column(name) if name in given.velocities else f"v_{name}",
                unit=self._unit(name, signal),
                velocity_unit=self._unit(self._velocity_column(name), given.velocities[name]) if name in given.velocities else "1/s",
                nominal=_positive(self._by_name[signal.variable].nominal) * abs(signal.scale),
            )
            for name, signal in given.positions.items()
        )
        goal = [given.goal.get(item.name) for item in coordinates] + [given.goal.get(item.velocity_name) for item in coordinates]
        times = self._column(given.plan.time, False)
        return ForeignModel(
            name=Path(self._package.path).stem,
            coordinates=coordinates,
            inputs=tuple(self._input(name, signal) for name, signal in given.inputs.items()),
            contacts=tuple(
                ForeignContact(name=name, force_name=self._force_column(name), gap_name=f"gap_{name}") for name in given.contacts
            ),
            task=ForeignTask(start=(), goal=tuple(goal), step=float(np.diff(times).min(initial=math.inf))),
            limits=tuple(Limit(figure=name, value=entry.value, reason=entry.reason) for name, entry in given.limits.items()),
            lacks=self.lacks,
        )

    def _unit(self, column: str, signal: Signal) -> str:
        own = self._by_name[signal.variable].unit if signal.scale == 1.0 and signal.offset == 0.0 else None
        return signal.unit or self._table.units.get(column) or own or "1"

    def _input(self, name: str, signal: Signal) -> ForeignInput:
        """Bounds are those the FMU declares, in the plan's unit."""
        variable = self._by_name[signal.variable]
        ends = [
            (-math.inf if variable.min is None else (float(variable.min) - signal.offset) / signal.scale),
            (math.inf if variable.max is None else (float(variable.max) - signal.offset) / signal.scale),
        ]
        return ForeignInput(name=name, unit=self._unit(name, signal), lower=min(ends), upper=max(ends))

    def _column(self, name: str, last_is_open: bool) -> np.ndarray:
        return self._table.column(name, last_is_open)

    def trajectory(self, hold: Hold) -> Trajectory:
        """The plan; what it does not say is in `missing`, with zeros in its place."""
        given, table = self.map, self._table
        t = self._column(given.plan.time, False)
        nodes, steps = len(t), len(t) - 1
        missing = set()

        def group(key: str, columns: list[str], rows: int) -> np.ndarray:
            if not all(column in table.names for column in columns):
                missing.add(key)
                return np.zeros((rows, len(columns)))
            stacked = [self._column(column, rows < nodes) for column in columns]
            return np.column_stack(stacked) if stacked else np.zeros((rows, 0))

        q = group("q", list(given.positions), nodes)
        velocities = [self._velocity_column(name) if name in given.velocities else "" for name in given.positions]
        v = group("v", velocities, nodes)
        u = group("u", list(given.inputs), steps)
        lam = group("lam", [self._force_column(name) for name in given.contacts], steps)
        try:
            return Trajectory(t=t, q=q, v=v, u=u, lam=lam, hold=hold, missing=frozenset(missing))
        except TrajectoryError as error:
            raise TrajectoryError(f"{error} (file {table.path})") from error


def _positive(value: Any) -> float:
    return float(value) if value is not None and float(value) > 0 else 1.0
