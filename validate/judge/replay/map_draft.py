"""A first map of an external FMU, filled with everything that the FMU declares.

draft = draft_map(read_package(Path("robot.fmu")))
draft.text  # MAP.toml: inputs, positions, velocities, contacts, and comments on the user's choices
draft.plan  # a plan that fits: times, and the inputs at their start values
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from validate.fmi.description import Package, experiment
from validate.judge.replay.map_schema import (
    CONTACT_UNITS,
    Dimensions,
    Named,
    is_input,
    is_parameter,
    is_startable,
    paired,
)

# Duration of the plan if the FMU declares none [s].
_DURATION = 1.0
# Steps of the plan if the FMU declares no step.
_STEPS = 100
# A plan of more rows is of no use as a first one.
_MOST_STEPS = 10_000
# Variables of one kind that are listed; further ones are counted.
_LISTED = 40
# Names of the time in a plan, which no other column may have.
_TIME = ("t", "time")


class MapDraft(NamedTuple):
    """The text of MAP.toml, the text of a plan that fits it, and the names of the plan's inputs."""

    text: str
    plan: str
    inputs: tuple[str, ...]


def draft_map(package: Package) -> MapDraft:
    """Return a map of everything that this FMU declares, and a plan that fits it.

    Raises FmuError for a start value or bound that is no number.
    """
    named = Named(package)
    usable = {name: variable for name, variable in named.by_name.items() if not named.refusal(name)}
    inputs = {name: item for name, item in usable.items() if is_input(item)}
    forces = {
        name.removeprefix("lam_"): item
        for name, item in usable.items()
        if name.startswith("lam_") and item.unit in (None, *CONTACT_UNITS["force"])
    }
    motion = _motion(package, usable, inputs, forces)
    start, stop = (
        experiment(package.description, name) or 0.0 for name in ("startTime", "stopTime")
    )
    duration = stop - start if stop > start else None
    writer = _Writer(Dimensions(package.description), _factors(package.description))
    text = writer.text(package, usable, inputs, motion, forces, duration)
    return MapDraft(text, _plan(package, inputs, start, duration), tuple(map(_column, inputs)))


class _Motion(NamedTuple):
    """Positions, the velocity of each that has one, and further outputs that are neither."""

    positions: list[str]
    velocities: dict[str, str]
    others: list[str]


def _motion(
    package: Package, usable: Mapping[str, Any], inputs: Iterable[str], forces: Iterable[str]
) -> _Motion:
    """Sort the states, or if none are declared the outputs, by their units and derivatives."""
    dimensions = Dimensions(package.description)
    outputs = [name for name, item in usable.items() if item.causality == "output"]
    owners = (getattr(item, "derivative", None) for item in usable.values())
    states = list(dict.fromkeys(item.name for item in owners if item is not None))
    states = [name for name in states if name in usable]
    contacts = {f"{of}{name}" for name in forces for of in ("lam_", "gap_")}
    skipped, seen, found = {*inputs, *contacts}, set(), []
    for name in states or outputs:
        reference = int(usable[name].valueReference)
        if name not in skipped and reference not in seen:
            seen.add(reference)
            found.append(name)
    rates = [name for name in found if _is_rate(usable, name, found, dimensions)]
    positions = [
        name
        for name in found
        if name not in rates and not dimensions.contradicts(usable[name].unit, "position", True)
    ][:_LISTED]
    velocities = paired(positions, rates, usable)
    taken = {*positions, *velocities.values(), *skipped}
    return _Motion(positions, velocities, [name for name in outputs if name not in taken])


def _is_rate(
    usable: Mapping[str, Any], name: str, states: Sequence[str], dimensions: Dimensions
) -> bool:
    """Return whether this is a velocity: by its unit, or as the derivative of another state."""
    item = usable[name]
    if item.unit:
        return dimensions.is_rate(item.unit) or item.unit.endswith("/s")
    same = [other for other in usable.values() if other.valueReference == item.valueReference]
    of = (getattr(other, "derivative", None) for other in same)
    return any(owner is not None and owner.name in states for owner in of)


def _factors(description: Any) -> dict[str, tuple[float, str]]:
    """Return the factor to the SI unit, and that unit, of each unit that the FMU defines."""
    # Keys are the exponents of kg, m, s and rad.
    names = {"0 1 0 0": "m", "0 1 -1 0": "m/s", "1 1 -2 0": "N", "1 2 -2 0": "N m"}
    names |= {"0 0 0 1": "rad", "0 0 -1 1": "rad/s"}
    found = {}
    for unit in description.unitDefinitions:
        base = unit.baseUnit
        if base is None or any(getattr(base, other) for other in ("A", "K", "mol", "cd")):
            continue
        powers = " ".join(str(int(getattr(base, name))) for name in ("kg", "m", "s", "rad"))
        if powers in names and not base.offset:
            found[unit.name] = (float(base.factor), names[powers])
    return found


def _column(name: str) -> str:
    """Return the plan's column of an input or position; the time has its name to itself."""
    return f"fmu_{name}" if name.lower() in _TIME else name


def _text(value: str) -> str:
    """Return a name in quotes, as TOML and JSON write it."""
    return json.dumps(value, ensure_ascii=False)


class _Writer:
    def __init__(self, dimensions: Dimensions, factors: Mapping[str, tuple[float, str]]) -> None:
        self._dimensions, self._factors = dimensions, factors

    def text(
        self,
        package: Package,
        usable: Mapping[str, Any],
        inputs: Mapping[str, Any],
        motion: _Motion,
        forces: Mapping[str, Any],
        duration: float | None,
    ) -> str:
        """Return MAP.toml."""
        states = [*motion.positions, *motion.velocities.values()]
        settable = [name for name in states if is_startable(usable[name])]
        ends = [_column(name) for name in motion.positions] + list(motion.velocities.values())
        lines = [
            f"# Map of {package.path.name} (FMI {package.version}): which column of a plan is which variable.",
            "# docs/replay.md describes every key. Lines with `#` are your choices.",
            "",
            "[plan]",
            'time = "t"           # name of the time column [s]',
            '# hold = "linear"    # inputs are lines between two rows; without it they are constant',
            "",
            "[task]               # choose: how long a plan of this task lasts [s]",
            f"{'# ' if duration is None else ''}duration = {duration or _DURATION!r}",
            "",
            "[inputs]             # FMU's value = scale * plan's; choose lower and upper, in the plan's unit",
            *(
                self._entry(_column(name), name, item, is_driven=True)
                for name, item in inputs.items()
            ),
            "",
            "[positions]          # plan's value = scale * FMU's; delete what is no position",
            *(self._entry(_column(name), name, usable[name]) for name in motion.positions),
            "",
            "[velocities]         # by the name of the position; column: of the plan",
            *(
                self._entry(_column(name), rate, usable[rate], column=rate)
                for name, rate in motion.velocities.items()
            ),
            "",
            *_contacts(forces, usable),
            "[start]              # of the task, in the FMU's units; without a line the FMU's own",
            *_comments(f"{_text(name)} = {_number(usable[name].start)!r}" for name in settable),
            "",
            "[parameters]         # set before the start; without a line the FMU's own",
            *_comments(
                f"{_text(name)} = {_number(item.start)!r}{_unit(item)}"
                for name, item in usable.items()
                if is_parameter(item) and item.start is not None
            ),
            "",
            "[goal]               # choose: where the plan shall end; without a goal only its motion is judged",
            *_comments(f"{_text(name)} = 0.0" for name in ends or ["POSITION"]),
            "",
            "[limits]             # choose: how near is near enough, in the plan's units; a goal needs one",
            '# replay_terminal_position_error = { value = 0.01, reason = "why this is near enough" }',
            '# replay_terminal_velocity_error = { value = 0.01, reason = "why this is slow enough" }',
            '# replay_error = { value = 0.01, reason = "how far the motion may leave the plan" }',
        ]
        if motion.others:
            lines += ["", "# Further outputs, which may be the force or the gap of a contact:"]
            lines += _comments(f"{name}{_unit(usable[name])}" for name in motion.others)
        return "\n".join(lines) + "\n"

    def _entry(
        self, key: str, name: str, item: Any, *, column: str = "", is_driven: bool = False
    ) -> str:
        """Return the line of an input, position or velocity.

        A defined unit is scaled to SI; a unit without a definition is left to the user.
        """
        parts, remark = [f"variable = {_text(name)}"], ""
        if column:
            parts.append(f"column = {_text(column)}")
        factor, unit = self._factors.get(item.unit, (1.0, ""))
        if unit:
            if factor != 1.0:
                parts.append(f"scale = {1.0 / factor if is_driven else factor!r}")
            parts.append(f"unit = {_text(unit)}")
        elif item.unit:
            remark = f"  # in {item.unit}, which the FMU does not define: choose scale and unit"
        if is_driven:
            ends = {"lower": item.min, "upper": item.max}
            parts += [
                f"{end} = {_number(value) * factor!r}"
                for end, value in ends.items()
                if value is not None and math.isfinite(float(value))
            ]
        return f"{_text(key)} = {{ {', '.join(parts)} }}{remark}"


def _unit(item: Any) -> str:
    return f"  # [{item.unit}]" if item.unit else ""


def _comments(lines: Iterable[str]) -> list[str]:
    """Return lines as comments; of more than a page the rest is counted."""
    every = list(lines)
    more = [f"# and {len(every) - _LISTED} more"] if len(every) > _LISTED else []
    return [*(f"# {line}" for line in every[:_LISTED]), *more]


def _contacts(forces: Mapping[str, Any], usable: Mapping[str, Any]) -> list[str]:
    """Return the contacts that the names lam_X and gap_X show, or one to fill in."""
    lines = []
    for name in forces:
        gap = usable.get(f"gap_{name}")
        lines += [f"[contacts.{_text(name)}]", f"force = {_text(f'lam_{name}')}"]
        if gap is not None and gap.unit in (None, *CONTACT_UNITS["gap"]):
            lines.append(f"gap = {_text(f'gap_{name}')}")
        lines += ["# depth = 0.01   # choose: where the model of this contact ends [m]", ""]
    return lines or [
        "# [contacts.NAME]    # choose: force in N, positive if it pushes; gap in m, negative in contact",
        '# force = "VARIABLE"',
        '# gap = "VARIABLE"',
        "# depth = 0.01       # where the model of this contact ends [m]",
        "",
    ]


def _plan(package: Package, inputs: Mapping[str, Any], start: float, duration: float | None) -> str:
    """Return a plan with the inputs at their start values, scaled as in the map."""
    factors = _factors(package.description)
    lasts, step = duration or _DURATION, experiment(package.description, "stepSize")
    steps = round(lasts / step) if step is not None else _STEPS
    steps = steps if 1 <= steps <= _MOST_STEPS else _STEPS
    values = [
        _number(item.start) * factors.get(item.unit, (1.0, ""))[0] for item in inputs.values()
    ]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["t", *map(_column, inputs)])
    for k in range(steps + 1):
        # Inputs are held to the next row, so that the last row needs none.
        cells = [repr(value) for value in values] if k < steps else [""] * len(values)
        rows.writerow([repr(round(start + lasts * k / steps, 12)), *cells])
    return text.getvalue()


def _number(text: Any) -> float:
    """Return the FMU's number, 0 if absent or not finite."""
    try:
        value = float(text)
    except (TypeError, ValueError):
        return 0.0
    return value if math.isfinite(value) else 0.0
