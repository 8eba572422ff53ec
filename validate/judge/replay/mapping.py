"""Connect map, plan and external FMU; equal names replace a missing MAP.toml.

foreign, trajectory = wire(package, PlanTable(path), map_file, hold, where)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import TrajectoryError
from models.plan_table import Table, lack_of
from models.scene.parts import Limit
from models.trajectory import (
    Trajectory,
    declared_hold,
    declared_scheme,
    missing_groups,
    times_and_inputs,
)
from validate.fmi.description import REAL, Package, experiment
from validate.judge.printed import rounding
from validate.judge.replay import map_schema, subject
from validate.judge.replay.map_schema import (
    CONTACT_UNITS,
    FRICTION,
    QUANTITIES,
    Dimensions,
    InputSignal,
    MapError,
    MapFile,
    Named,
    Signal,
    is_input,
    is_parameter,
    is_startable,
    is_started,
)
from validate.judge.replay.result import Difference
from validate.judge.replay.wiring import INTERNAL_STEP, Variables, columns_or_zeros

# Steps of an external FMU's task.
_STEPS = 500
# Largest difference of the plan's first row from the FMU's start value, in nominals.
_SAME_START = 1e-6
# Largest spacing of a clock's numbers, as a fraction of a step. Events are located to a millionth
# of a step, which takes three more digits.
_TICK = 1e-9
# Largest relative excess of a bound over the FMU's own bound: rounding of units.
_ROUNDING = 1e-9


def wire(
    package: Package, table: Table, map_file: MapFile | None, hold: str | None, where: str
) -> tuple[subject.Foreign, Trajectory]:
    """Return the wired FMU and the plan; where: "map FILE" or "FMU FILE", for messages.

    Raises MapError, TrajectoryError.
    """
    named = Named(package)
    complete = map_file or map_schema.by_equal_names(named, table, Dimensions(package.description))
    wiring = _Wiring(package, named, table, complete, where)
    plan, start = wiring.trajectory(hold), wiring.counted_from
    wired = wiring.foreign(), plan if start is None else plan.from_zero(start)
    wiring.check_first_row()
    return wired


class _Wiring:
    def __init__(
        self, package: Package, named: Named, table: Table, given: MapFile, where: str
    ) -> None:
        self.map, self._table, self._package, self._named, self._where = (
            given,
            table,
            package,
            named,
            where,
        )
        self._by_name = named.by_name
        self._dimensions = Dimensions(package.description)
        # Path in the map, column and signal of each.
        self._positions: list[tuple[str, str, Signal]] = [
            (f"positions.{name}", name, signal) for name, signal in given.positions.items()
        ]
        self._velocities = [
            (f"velocities.{name}", self._velocity_column(name), signal)
            for name, signal in given.velocities.items()
        ]
        self._check_names()
        self._check_limits()
        self._check_columns()
        self.lacks = self.map.lacks()

    def _fail(self, path: str, text: str) -> MapError:
        return MapError(f"{self._where}: {path}: {text}")

    def _variable(self, path: str, name: str) -> Any:
        if refusal := self._named.refusal(name):
            raise self._fail(path, f"{refusal}.")
        return self._by_name[name]

    def _reference(self, path: str, name: str) -> int:
        return int(self._variable(path, name).valueReference)

    def _place(self, name: str) -> int:
        return int(self._by_name[name].valueReference)

    def _parameter(self, path: str, name: str, value: float | None = None) -> int:
        variable = self._named.alias(
            self._variable(path, name), lambda item: item.causality == "parameter"
        )
        if variable.causality != "parameter":
            raise self._fail(
                path, f"{name!r} is no parameter of the FMU, but {variable.causality}."
            )
        if value is not None:
            for sign, name_of, end in ((-1, "least", variable.min), (1, "most", variable.max)):
                if end is not None and sign * value > sign * float(end):
                    raise self._fail(
                        path,
                        f"{value:g} is not possible: the FMU allows at {name_of} {float(end):g}.",
                    )
        return int(variable.valueReference)

    def _startable(self, path: str, name: str) -> int:
        variable = self._named.alias(self._variable(path, name), is_startable)
        if not is_startable(variable):
            raise self._fail(
                path, f"{name!r} has no start value that can be set: the FMU calculates it."
            )
        return int(variable.valueReference)

    def _check_names(self) -> None:
        given = self.map
        driven: dict[int, str] = {}
        for name, signal in given.inputs.items():
            path = f"inputs.{name}"
            self._check_once(driven, path, signal.variable)
            variable = self._named.alias(self._variable(path, signal.variable), is_input)
            if not is_input(variable):
                raise self._fail(path, f"{signal.variable!r} is no input of the FMU.")
            self._check_unit(path, name, signal)
        for name in given.velocities:
            if name not in given.positions:
                raise self._fail(
                    f"velocities.{name}",
                    f"there is no position of that name{map_schema.hint(name, given.positions)}.",
                )
        read: dict[int, str] = {}
        for path, column, signal in self._positions + self._velocities:
            self._check_once(read, path, signal.variable)
            self._check_unit(path, column, signal)
        for path, column, signal in self._positions:
            self._check_quantity(path, "position", column, signal)
        for name, (path, column, signal) in zip(given.velocities, self._velocities, strict=True):
            self._check_rate(name)
            self._check_quantity(path, "velocity", column, signal)
        for name, entry in given.contacts.items():
            if entry.force is None and entry.gap is None:
                raise self._fail(f"contacts.{name}", "it names neither force nor gap.")
        gaps = {
            reference: path for reference, path in read.items() if not path.startswith("positions.")
        }  # a gap may be a position
        for what, taken in (("force", read), ("gap", gaps)):
            for name, entry in given.contacts.items():
                path, signal = f"contacts.{name}.{what}", getattr(entry, what)
                if signal is not None:
                    self._check_once(taken, path, signal.variable)
                    gaps[self._reference(path, signal.variable)] = path
                    self._check_contact_unit(path, what, signal)
                    self._check_quantity(path, what, "", signal)
        known = [column for _, column, _ in self._positions + self._velocities]
        for name in given.goal:
            if name not in known:
                near = map_schema.hint(name, known) or f"; there are {', '.join(known)}"
                raise self._fail(
                    f"goal.{name}", f"there is no position or velocity of that name{near}."
                )

    def _check_unit(self, path: str, column: str, signal: Signal) -> None:
        """Check a unit of the map or the plan's header against the FMU's; a scale may convert."""
        variable = self._variable(path, signal.variable)
        written = self._table.units.get(column)
        if signal.unit and written and signal.unit != written:
            raise self._fail(
                path,
                f"the plan's column {column!r} is in {written!r}, but the map says {signal.unit!r}.",
            )
        unit = signal.unit or written
        if (
            unit
            and variable.unit
            and not self._dimensions.is_same(unit, variable.unit)
            and signal.scale == 1.0
            and signal.offset == 0.0
        ):
            raise self._fail(
                path,
                f"the plan is in {unit!r}, but {signal.variable!r} is in {variable.unit!r}; give a scale.",
            )
        self._check_scale(path, signal)

    def _check_scale(self, path: str, signal: Signal) -> None:
        if signal.scale == 0.0:
            raise self._fail(path, "scale is 0; it must not be.")

    def _check_quantity(self, path: str, what: str, column: str, signal: Signal) -> None:
        """Check that signal and quantity have one dimension, which no scale can change."""
        fmu_unit, plan_unit = (
            self._variable(path, signal.variable).unit,
            self._table.units.get(column),
        )
        known = {
            repr(signal.variable): (fmu_unit, True),
            "it": (signal.unit, False),
            f"the plan's {column!r}": (plan_unit, False),
        }
        for source, (unit, of_fmu) in known.items():
            if self._dimensions.contradicts(unit, what, of_fmu):
                raise self._fail(
                    path,
                    f"{source} is in {unit!r}, which no scale makes a {what}, in {' or '.join(QUANTITIES[what])}.",
                )

    def _check_once(self, read: dict[int, str], path: str, variable: str) -> None:
        """Check that a variable is mapped once, by its reference: an FMU may have aliases."""
        reference = self._reference(path, variable)
        if reference in read:
            raise self._fail(path, f"{variable!r} is {read[reference]} already.")
        read[reference] = path

    def _check_rate(self, name: str) -> None:
        position, velocity = (
            self._unit(name, self.map.positions[name]),
            self._unit(self._velocity_column(name), self.map.velocities[name]),
        )
        if not self._dimensions.may_be_rate(position, velocity):
            raise self._fail(
                f"velocities.{name}",
                f"it is in {velocity!r}, but positions.{name} in {position!r}; it must be in '{position}/s'.",
            )

    def _check_contact_unit(self, path: str, what: str, signal: Signal) -> None:
        """Check force and gap units: N and m, or a scale (even `scale = 1.0`)."""
        known, fmu_unit = CONTACT_UNITS[what], self._variable(path, signal.variable).unit
        if signal.unit and signal.unit not in known:
            raise self._fail(
                path,
                f"it is in {signal.unit!r}, but a {what} must be in {known[0]!r} behind its scale, as in the plan.",
            )
        scaled = signal.model_fields_set & {"scale", "offset"}
        if fmu_unit and not self._dimensions.is_in(fmu_unit, known) and not scaled:
            raise self._fail(
                path,
                f"{signal.variable!r} is in {fmu_unit!r}, but a {what} must be in {known[0]!r}; give a scale.",
            )
        self._check_scale(path, signal)

    def _check_limits(self) -> None:
        given = self.map
        for part, columns in (
            ("position", given.positions),
            ("velocity", map(self._velocity_column, given.velocities)),
        ):
            metric = f"replay_terminal_{part}_error"
            goal_column = next((column for column in columns if column in given.goal), None)
            if goal_column is not None and metric not in given.limits:
                raise self._fail(
                    f"goal.{goal_column}",
                    f"no limit says how near is near enough; add {metric} = {{ value = .., reason = '..' }} to [limits].",
                )

    def _velocity_column(self, position: str) -> str:
        return self.map.velocities[position].column or f"v_{position}"

    @property
    def _time(self) -> str:
        """Return the column of times; a table names the column `time` t."""
        named = self.map.plan.time
        renamed = named not in self._table.names and named.lower() == "time"
        return "t" if renamed else named

    def _force_column(self, contact: str) -> str:
        return self.map.contacts[contact].column or f"lam_{contact}"

    def _check_columns(self) -> None:
        given, table = self.map, self._table
        self._check_roles()
        needed = [self._time, *given.inputs]
        for name in needed:
            if name not in table.given:
                free = [other for other in table.names if other not in needed]
                near = "" if name in table.names else map_schema.hint(name, free)
                raise TrajectoryError(
                    f"{table.where}: {lack_of(table, name)}{near}; it has {', '.join(table.given)}."
                )
        known = {
            *needed,
            *given.positions,
            *map(self._velocity_column, given.velocities),
            *map(self._force_column, given.contacts),
        }
        known |= {value for value in given.start.values() if isinstance(value, str)}
        self._frictions = [
            name for name in table.names if name.startswith(FRICTION) and name not in known
        ]
        for name in table.names:
            if name not in known and name not in self._frictions:
                raise TrajectoryError(
                    f"{table.where}: the column {name!r} is unknown{map_schema.hint(name, known)}; {self._where} names {', '.join(sorted(known))}. Delete it, or ignore it (--ignore {name})."
                )
        table.check_unit(self._time, "s")
        for name in given.contacts:
            table.check_unit(self._force_column(name), *CONTACT_UNITS["force"])

    def _check_roles(self) -> None:
        given, roles = self.map, {self._time: "the time (plan.time)"}
        claims = [
            (name, f"inputs.{name}", "call one of the two otherwise") for name in given.inputs
        ]
        claims += [
            (name, f"positions.{name}", "call one of the two otherwise") for name in given.positions
        ]
        claims += [
            (self._velocity_column(name), f"velocities.{name}", "give it another by column = '..'")
            for name in given.velocities
        ]
        claims += [
            (self._force_column(name), f"contacts.{name}", "give it another by column = '..'")
            for name in given.contacts
        ]
        for column, path, advice in claims:
            if column in roles:
                raise self._fail(
                    path, f"its column {column!r} is that of {roles[column]} already; {advice}."
                )
            roles[column] = path

    @cached_property
    def counted_from(self) -> float | None:
        """Return the FMU's start [s] if the plan has a clock's coarse times, else None."""
        times = self._table.column(self._time, last_is_open=False)
        start = experiment(self._package.description, "startTime") or 0.0
        coarse = np.spacing(np.abs([times[0], start])) > _TICK * np.abs(np.diff(times)).min()
        return start if coarse[0] and not coarse[1] else None

    def foreign(self) -> subject.Foreign:
        given, lacks = self.map, self.lacks
        read: dict[str, list[Signal]] = {
            "q": list(given.positions.values()),
            "v": [] if "v" in lacks else [given.velocities[name] for name in given.positions],
            "lam": []
            if "lam" in lacks
            else [entry.force for entry in given.contacts.values() if entry.force],
            "gap": []
            if "gap" in lacks
            else [entry.gap for entry in given.contacts.values() if entry.gap],
        }
        signals, driven = (
            [signal for group in read.values() for signal in group],
            list(given.inputs.values()),
        )
        references: dict[str, Any] = {
            group: tuple(self._place(signal.variable) for signal in items)
            for group, items in {**read, "u": driven}.items()
        }
        settings, internal = (
            self._settings(),
            given.internal_step or (INTERNAL_STEP if INTERNAL_STEP in self._by_name else None),
        )
        parameters, begin = (
            self._uncertain(internal),
            self._begin(dict(settings), [*read["q"], *read["v"]]),
        )
        return subject.Foreign(
            model=self._model(parameters, begin),
            parameters=tuple(self._place(item.name) for item in parameters),
            variables=Variables(
                **references,
                parameters=tuple(
                    (self._parameter(f"parameters.{name}", name, value), value)
                    for name, value in given.parameters.items()
                ),
                start=tuple(reference for reference, _ in settings),
                internal_step=None
                if internal is None
                else self._parameter("internal_step", internal),
            ),
            scale=np.array([signal.scale for signal in signals]),
            offset=np.array([signal.offset for signal in signals]),
            input_scale=np.array([signal.scale for signal in driven]),
            input_offset=np.array([signal.offset for signal in driven]),
            start=np.array([value for _, value in settings]),
        )

    def _settings(self) -> list[tuple[int, float]]:
        given, values = self.map, {}
        taken: dict[int, str] = {}
        for name in given.parameters:
            self._check_once(taken, f"parameters.{name}", name)
        taken |= {
            self._place(signal.variable): f"inputs.{name}" for name, signal in given.inputs.items()
        }
        for name, value in given.start.items():
            path = f"start.{name}"
            self._check_once(taken, path, name)
            if isinstance(value, str):
                if value not in self._table.given:
                    raise self._fail(
                        path,
                        f"{lack_of(self._table, value)} in the plan{map_schema.hint(value, self._table.names)}.",
                    )
                value = self._first(path, name, value)
            values[self._startable(path, name)] = float(value)
        return list(values.items())

    def _first(self, path: str, name: str, column: str) -> float:
        first = float(self._table.column(column, False)[0])
        for _, own_column, signal in self._positions + self._velocities:
            if own_column == column and signal.variable == name:
                return (first - signal.offset) / signal.scale
        unit, given = self._variable(path, name).unit, self._table.units.get(column)
        if unit and given and not self._dimensions.is_same(given, unit):
            self._table.check_unit(column, unit)
        return first

    def check_first_row(self) -> None:
        """Raise MapError if the plan's first row contradicts a start value missing in [start]."""
        named = {self._place(name) for name in self.map.start}
        for _, column, signal in self._positions + self._velocities:
            variable = self._named.alias(self._by_name[signal.variable], is_started)
            is_named = int(variable.valueReference) in named
            if column not in self._table.given or is_named or not is_started(variable):
                continue
            values = self._table.column(column, False)
            nominal = map_schema.positive(variable.nominal) * abs(signal.scale)
            start = signal.scale * float(variable.start) + signal.offset
            if abs(values[0] - start) > _SAME_START * nominal + rounding(values, nominal)[0]:
                raise self._fail(
                    "start",
                    f"the plan begins with {column} = {values[0]:g}, but the FMU starts at "
                    f"{start:g}; add '{signal.variable}' = '{column}' if the task starts there, "
                    "or correct the plan.",
                )

    def _uncertain(self, internal: str | None) -> tuple[subject.ForeignParameter, ...]:
        """Return the parameters with a value, without `internal`, the FMU's own step."""
        given, parameters = self.map, []
        taken: dict[int, str] = {}
        for name in given.uncertainty:
            self._parameter(f"uncertainty.{name}", name)
            self._check_once(taken, f"uncertainty.{name}", name)
        own_step = None if internal is None else self._place(internal)
        for reference, names in self._named.aliases.items():
            known = (self._by_name[name] for name in names if name not in self._named.twice)
            items = [item for item in known if is_parameter(item)]
            in_map = [name for name in names if name in {**given.uncertainty, **given.parameters}]
            values = [given.parameters[name] for name in in_map if name in given.parameters]
            values += [item.start for item in items if item.start is not None]
            if not items or not values or reference == own_step:
                continue
            item, value, name = items[0], values[0], (in_map or names)[0]
            lower = max(
                (float(item.min) for item in items if item.min is not None), default=-math.inf
            )
            upper = min(
                (float(item.max) for item in items if item.max is not None), default=math.inf
            )
            entry = next(
                (given.uncertainty[name] for name in in_map if name in given.uncertainty), None
            )
            size, reason = (None, "") if entry is None else (entry.value, entry.reason)
            for end in (float(value) - size, float(value) + size) if size else ():
                self._parameter(f"uncertainty.{name}", name, end)
            fields = {
                "unit": item.unit or "1",
                "lower": lower,
                "upper": upper,
                "uncertainty": size,
                "uncertainty_reason": reason,
                "aliases": tuple(other for other in names if other != name),
            }
            parameters.append(subject.ForeignParameter(name=name, value=float(value), **fields))
        return tuple(parameters)

    def _begin(self, settings: Mapping[int, float], signals: list[Signal]) -> dict[int, float]:
        """Return the settable start values in the plan's units, by place.

        settings: values by reference, from plan and map.
        """
        starts = {}
        for place, signal in enumerate(signals):
            variable = self._named.alias(self._by_name[signal.variable], is_started)
            if is_started(variable):
                starts[place] = (
                    signal.scale * settings.get(int(variable.valueReference), float(variable.start))
                    + signal.offset
                )
        return starts

    def _model(
        self, parameters: tuple[subject.ForeignParameter, ...], begin: Mapping[int, float]
    ) -> subject.ForeignModel:
        given = self.map
        coordinates = tuple(
            subject.ForeignCoordinate(
                name=name,
                velocity_name=self._velocity_column(name)
                if name in given.velocities
                else f"v_{name}",
                unit=self._unit(name, signal),
                velocity_unit=self._unit(self._velocity_column(name), given.velocities[name])
                if name in given.velocities
                else "1/s",
                nominal=map_schema.positive(self._by_name[signal.variable].nominal)
                * abs(signal.scale),
            )
            for name, signal in given.positions.items()
        )
        goal = [given.goal.get(item.name) for item in coordinates]
        goal += [
            given.goal.get(item.velocity_name) if item.name in given.velocities else None
            for item in coordinates
        ]
        times = self._table.column(self._time, False)
        return subject.ForeignModel(
            name=Path(self._package.path).stem,
            coordinates=coordinates,
            inputs=tuple(self._input(name, signal) for name, signal in given.inputs.items()),
            contacts=tuple(
                subject.ForeignContact(
                    name=name,
                    force_name=self._force_column(name),
                    gap_name=f"gap_{name}",
                    depth=entry.depth,
                    nominal_force=entry.nominal_force,
                )
                for name, entry in given.contacts.items()
            ),
            task=subject.ForeignTask(
                goal=tuple(goal),
                step=(float(np.ptp(times)) if given.task.duration is None else given.task.duration)
                / _STEPS,
                horizon=given.task.duration,
            ),
            limits=self._limits(),
            lacks=self.lacks,
            accuracy=self._accuracy(),
            not_asked=self._not_asked(),
            notes=self._notes(),
            parameters=parameters,
            begin=tuple(begin.get(place, 0.0) for place in range(2 * len(coordinates))),
            startable=tuple(begin),
        )

    def _limits(self) -> tuple[Limit, ...]:
        given = self.map.limits
        limits = [
            Limit(metric=name, value=entry.value, reason=entry.reason or "set in the map")
            for name, entry in given.items()
        ]
        return tuple(limits)

    def _accuracy(self) -> Difference | None:
        """Return the stated accuracy as a difference of two simulations; infinite if not stated."""
        stated, count = self.map.accuracy, len(self.map.positions)
        if stated.position is None and stated.velocity is None and stated.gap is None:
            return None
        position, velocity, gap = (
            math.inf if value is None else value
            for value in (stated.position, stated.velocity, stated.gap)
        )
        if "v" in self.lacks:
            velocity = 0.0  # no velocity can be wrong
        return Difference(
            position=position,
            state=math.sqrt(count) * math.hypot(position, velocity) if count else velocity,
            gap=gap,
        )

    def _not_asked(self) -> tuple[str, ...]:
        given, reasons = self.map, []
        if given.task.duration is None:
            reasons.append("duration_error: the map gives no [task] duration")
        for name, signal in given.inputs.items():
            bound = self._input(name, signal)
            ends = [
                word
                for word, end in (("lower", bound.lower), ("upper", bound.upper))
                if math.isinf(end)
            ]
            if ends:
                reasons.append(
                    f"bound_violation: input {name} has no {' and no '.join(ends)} bound, neither in the map ([inputs]) nor in the FMU"
                )
        if not given.goal:
            reasons.append(
                "replay_terminal_position_error, replay_terminal_velocity_error: the map gives no [goal]"
            )
        if "q" in self.lacks:
            reasons.append("replay_error: the map names no [positions]")
        for name, entry in given.contacts.items():
            if entry.gap is None:
                reasons.append(f"max_penetration: contact {name} has no gap in the map")
            elif entry.depth is None:
                reasons.append(
                    f"max_penetration: contact {name} has no depth in the map (depth = .., where its model ends)"
                )
        if not given.contacts:
            reasons.append(
                "max_penetration, ghost_impulse, missed_impulse: the map names no [contacts]"
            )
        elif "gap" in self.lacks or "lam" in self.lacks:
            reasons.append(
                "ghost_impulse, missed_impulse: not every contact has both force and gap in the map"
            )
        reasons.append(
            "contact_law_error, defect: an FMU keeps its equations to itself; only a scene has them"
        )
        return tuple(reasons)

    def _notes(self) -> tuple[str, ...]:
        notes, scheme = [], declared_scheme(self._table)
        if self.counted_from is not None:
            first = self._table.column(self._time, last_is_open=False)[0]
            notes.append(
                f"The plan's times are those of a clock: they are counted from its first row, {first:.10g} s, which is t = {self.counted_from:g} s of the FMU."
            )
        if scheme is not None:
            why = (
                "which is of a scene's equations; an FMU keeps its own, so nothing is asked of it."
            )
            notes.append(f"The plan declares the scheme {scheme.value}, {why}")
        if self._frictions:
            notes.append(
                f"Nothing is asked of the plan's friction forces ({', '.join(self._frictions)}): an FMU's own are not read."
            )
        driven = {self._place(signal.variable) for signal in self.map.inputs.values()}
        inputs: dict[tuple[str, int], str] = {}
        for name, item in self._by_name.items():
            if item.causality == "input" and item.type != "Clock":
                inputs.setdefault((item.type, self._place(name)), name)
        idle = [
            name
            for (kind, place), name in inputs.items()
            if kind not in REAL or place not in driven
        ]
        if idle:
            named = ", ".join(idle[:5]) + " .." * (len(idle) > 5)
            notes.append(
                f"Inputs of the FMU that the plan does not drive keep their start values: {named}."
            )
        return tuple(notes)

    def _unit(self, column: str, signal: Signal) -> str:
        own = (
            self._by_name[signal.variable].unit
            if signal.scale == 1.0 and signal.offset == 0.0
            else None
        )
        return signal.unit or self._table.units.get(column) or own or "1"

    def _input(self, name: str, signal: InputSignal) -> subject.ForeignInput:
        """Return an input with the map's bounds, which must lie within the FMU's, or the FMU's."""
        variable = self._named.alias(self._by_name[signal.variable], is_input)
        least, most = (
            -math.inf if variable.min is None else float(variable.min),
            math.inf if variable.max is None else float(variable.max),
        )
        lower, upper = sorted((end - signal.offset) / signal.scale for end in (least, most))
        for word, value, sign, end in (
            ("lower", signal.lower, -1.0, lower),
            ("upper", signal.upper, 1.0, upper),
        ):
            if value is not None and sign * (value - end) > _ROUNDING * abs(end):
                raise self._fail(
                    f"inputs.{name}.{word}",
                    f"{value:g} lies beyond the FMU's own bound, which is {end:g} in the plan's unit.",
                )
        lower, upper = (
            (lower if signal.lower is None else signal.lower),
            (upper if signal.upper is None else signal.upper),
        )
        if lower >= upper:
            raise self._fail(
                f"inputs.{name}",
                f"its lower bound is {lower:g}, its upper bound {upper:g}, in the plan's unit.",
            )
        return subject.ForeignInput(
            name=name, unit=self._unit(name, signal), lower=lower, upper=upper
        )

    def trajectory(self, hold: str | None) -> Trajectory:
        """Return the plan; absent groups are in `missing`, filled with zeros."""
        given, table = self.map, self._table
        # Velocities count only if every position has one.
        velocities = (
            [self._velocity_column(name) for name in given.positions]
            if "v" not in self.lacks
            else []
        )
        groups = {
            "q": list(given.positions),
            "v": velocities,
            "lam": [self._force_column(name) for name in given.contacts],
        }
        missing = missing_groups(table, groups) | {
            group for group in ("q", "v") if not groups[group]
        }
        where = "--hold" if hold else f"{self._where} (plan.hold)"
        held = declared_hold(table, hold or given.plan.hold, where)
        t, u, u_end = times_and_inputs(
            table, self._time, list(given.inputs), held, self._duration(missing)
        )
        nodes = len(t)

        def group(key: str, rows: int) -> np.ndarray:
            shape = (rows, len(given.contacts if key == "lam" else given.positions))
            return columns_or_zeros(
                table, () if key in missing else groups[key], shape, rows < nodes
            )

        try:
            return Trajectory(
                t=t,
                q=group("q", nodes),
                v=group("v", nodes),
                u=u,
                lam=group("lam", nodes - 1),
                hold=held,
                missing=missing,
                u_end=u_end,
            )
        except TrajectoryError as error:
            raise TrajectoryError(f"{error} ({table.source})") from error

    def _duration(self, missing: frozenset[str]) -> tuple[float, float] | None:
        """Return the duration of a plan of inputs alone, and its tolerance, half the last step."""
        duration, times = self.map.task.duration, self._table.column(self._time, False)
        if duration is None or "q" not in missing:
            return None
        return duration, float(times[-1] - times[-2]) / 2.0
