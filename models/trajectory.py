"""Plans: trajectories of a method or a user, and their CSV form.

    plan = read_csv("plan.csv", scene)
    plan.plot(scene)

A CSV has one row per node, with columns `t` and the scene's names (`q1 ... v1 ... u1 ...
lam_left`); the last row has no u and lam.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.errors import MachineError, TrajectoryError, did_you_mean, nearest
from models.plan_table import PlanTable, Table, lack_of, real_numbers
from models.schemes import Scheme

if TYPE_CHECKING:
    import pandas as pd

    from models.scene import Scene


class Hold(Enum):
    """Behaviour of an input within a step."""

    ZERO_ORDER = "zero_order"  # constant
    LINEAR = "linear"  # to the next step's value; in the last step to `u_end`


# Names of holds in CSV files and on the command line.
HOLDS = {"zero": Hold.ZERO_ORDER, "linear": Hold.LINEAR}
# Titles of the panels of a plot.
_TITLES = {"q": "position", "v": "velocity", "lam": "force", "u": "input"}
_INSTALL = "pip install matplotlib pandas"
# Groups that a plan may lack.
GROUPS = ("q", "v", "lam", "friction")
# Windows of a plan for averages: dither within a window does not count.
WINDOWS = 50


def as_scheme(value: Any, where: str = "plan") -> Scheme | None:
    """Return a scheme, given as such or by its text; None stays None.

    Raises TrajectoryError for another value.
    """
    if value is None or isinstance(value, Scheme):
        return value
    known = [item.value for item in Scheme]
    if value in known:
        return Scheme(value)
    what = f"there are {', '.join(known)}; without this line it declares none."
    raise TrajectoryError(
        f"{where}: the scheme {value!r} is unknown; {did_you_mean(value, known, what)}"
    )


def as_hold(value: Any, where: str = "plan") -> Hold:
    """Return a hold, given as such or by its text in `HOLDS`.

    Raises TrajectoryError for another value.
    """
    if isinstance(value, Hold):
        return value
    if isinstance(value, str) and value in HOLDS:
        return HOLDS[value]
    raise TrajectoryError(f"{where}: the hold {value!r} is unknown; it is {' or '.join(HOLDS)}.")


def _as_groups(value: Any) -> frozenset[str]:
    names = list(value) if isinstance(value, Iterable) and not isinstance(value, str) else [value]
    unknown = [name for name in names if not (isinstance(name, str) and name in GROUPS)]
    if unknown or isinstance(value, str):
        raise TrajectoryError(
            f"plan: missing is {value!r}, but must be a set of {', '.join(map(repr, GROUPS))}, or empty."
        )
    return frozenset(names)


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """A plan; nodes = steps + 1.

    t: (nodes,) increasing times [s]
    q, v: (nodes, nq) generalised positions [m, rad] and velocities
    u: (steps, nu) inputs within each step by `hold`
    lam: (steps, nl) contact forces, then friction forces [N]. With a scheme a contact force is that
        at the *start* of the step, lam[i] at phi(q[i]), a friction force that of the slip at its
        end; otherwise either end or the mean
    scheme: the time step (models.schemes), or None if unknown
    missing: groups without data, of "q", "v", "lam" (contact forces) and "friction"; the arrays
        then hold substitutes (see `read_csv`)
    u_end: (nu,) input at the last node, the end of a linear hold; None: constant

    Raises TrajectoryError for wrong shapes, NaN, or times that do not increase. hold and scheme may
    be given by their text.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    hold: Hold = Hold.ZERO_ORDER
    scheme: Scheme | None = None
    missing: frozenset[str] = frozenset()
    u_end: np.ndarray | None = None

    def __post_init__(self) -> None:
        for field in ("t", "q", "v", "u", "lam", *(() if self.u_end is None else ("u_end",))):
            array = real_numbers(field, getattr(self, field))
            if not np.isfinite(array).all():
                where = tuple(int(index) for index in np.argwhere(~np.isfinite(array))[0])
                raise TrajectoryError(
                    f"plan: {field}{list(where)} is {array[where]}; every value must be a finite number."
                )
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        object.__setattr__(self, "hold", as_hold(self.hold))
        object.__setattr__(self, "scheme", as_scheme(self.scheme))
        object.__setattr__(self, "missing", _as_groups(self.missing))
        nodes = self.t.size
        if self.t.ndim != 1 or nodes < 2:
            raise TrajectoryError(
                f"plan: t has shape {self.t.shape}; at least two times in one column are needed."
            )
        check_increasing(self.t, "plan")
        for field, rows in (("q", nodes), ("v", nodes), ("u", nodes - 1), ("lam", nodes - 1)):
            shape = getattr(self, field).shape
            if len(shape) != 2 or shape[0] != rows:
                raise TrajectoryError(
                    f"plan: {field} has shape {shape}; {rows} rows are needed ({nodes} nodes, {nodes - 1} steps)."
                )
        if self.scheme is not None and self.hold is not Hold.ZERO_ORDER:
            raise TrajectoryError(
                f"plan: scheme {self.scheme.value} holds its inputs over each step, but the plan's hold is linear; leave one of the two out."
            )
        if self.u_end is not None and self.u_end.shape != self.u.shape[1:]:
            raise TrajectoryError(
                f"plan: u_end has shape {self.u_end.shape}; one value for each of the {self.u.shape[1]} inputs is needed."
            )
        if self.q.shape != self.v.shape:
            raise TrajectoryError(
                f"plan: q has shape {self.q.shape} but v has {self.v.shape}; they must agree."
            )

    @property
    def steps(self) -> int:
        """Return the number of steps, one less than the nodes."""
        return self.t.size - 1

    @property
    def start(self) -> np.ndarray:
        """Return the state (2*nq,) at the first node [m, rad, m/s, rad/s]. Raises nothing."""
        return np.concatenate([self.q[0], self.v[0]])

    @property
    def end(self) -> np.ndarray:
        """Return the state (2*nq,) at the last node [m, rad, m/s, rad/s]. Raises nothing."""
        return np.concatenate([self.q[-1], self.v[-1]])

    def check_fits(self, scene: Scene) -> None:
        """Raise TrajectoryError if the columns or the scheme do not fit the scene."""
        if not hasattr(scene, "task"):
            raise TrajectoryError(
                f"scene: a {type(scene).__name__} is no scene; give a Scene, as touchstone.scene(name) does."
            )
        for field, count, expected, what in (
            ("q", self.q.shape[1], scene.nq, "positions"),
            ("u", self.u.shape[1], scene.nu, "inputs"),
            (
                "lam",
                self.lam.shape[1],
                scene.nl,
                "contacts and frictions" if scene.nf else "contacts",
            ),
        ):
            if count != expected:
                raise TrajectoryError(
                    f"plan: {field} has {count} columns, but scene {scene.name} has {expected} {what}."
                )
        if scene.nf and self.scheme not in (None, Scheme.SEMI_IMPLICIT_EULER):
            raise TrajectoryError(
                f"plan: it declares the scheme {self.scheme.value}, but the friction of scene {scene.name} is known to "
                f"{Scheme.SEMI_IMPLICIT_EULER.value} alone; leave the declaration out if another program's time step made it."
            )

    @property
    def duration(self) -> float:
        """Return the time from the first node to the last [s]."""
        return float(self.t[-1] - self.t[0])

    def from_zero(self, start: float = 0.0) -> Trajectory:
        """Return the plan with its first row at `start` [s].

        Integrators lose digits within a step at clock times such as 1.7e9 s.
        """
        if self.t[0] == start:
            return self
        # Digits that the clock resolves.
        digits = int(np.floor(-np.log10(np.spacing(np.abs(self.t).max()))))
        return replace(self, t=start + np.round(self.t - self.t[0], digits))

    @property
    def has_states(self) -> bool:
        """Return whether the plan has positions."""
        return "q" not in self.missing

    def with_inputs_in(self, scale: np.ndarray, offset: np.ndarray) -> Trajectory:
        """Return the plan with inputs scale * u + offset, in the units of an FMU.

        scale and offset are (nu,), in FMU units [per unit of the scene]. Raises ValueError for
        another number of inputs.
        """
        return replace(
            self,
            u=scale * self.u + offset,
            u_end=None if self.u_end is None else scale * self.u_end + offset,
        )

    def has_uniform_grid(self) -> bool:
        """Return whether all steps are equal up to rounding."""
        return bool(
            np.allclose(np.diff(self.t), (self.t[-1] - self.t[0]) / self.steps, rtol=1e-9, atol=0.0)
        )

    def __repr__(self) -> str:
        scheme = "no scheme declared" if self.scheme is None else self.scheme.value
        sizes = f"{self.q.shape[1]} positions, {self.u.shape[1]} inputs, {self.lam.shape[1]} contact forces"
        return f"Trajectory({self.steps} steps, {self.duration:g} s, {sizes}, {self.hold.value}, {scheme})"

    def to_dataframe(self, scene: Scene) -> pd.DataFrame:
        """Return a row per node, with columns as in a CSV (`column_names`).

        Inputs and forces of the last row are NaN. Raises MachineError without pandas,
        TrajectoryError for a plan of another scene.
        """
        self.check_fits(scene)
        names, last = column_names(scene), np.full((1, self.u.shape[1] + self.lam.shape[1]), np.nan)
        values = np.hstack(
            [self.t[:, None], self.q, self.v, np.vstack([np.hstack([self.u, self.lam]), last])]
        )
        return data_frame(
            dict(
                zip(
                    ["t", *names["q"], *names["v"], *names["u"], *names["lam"]],
                    values.T,
                    strict=True,
                )
            )
        )

    def plot(self, scene: Scene, motion: Any = None) -> np.ndarray:
        """Plot the available positions, velocities, forces and inputs over time with matplotlib.

        Parameters
        ----------
        motion
            A replay, or another object with t (n,) [s], q, v, lam and friction (n, ..); the plan is
            then dotted.

        Returns
        -------
        np.ndarray
            (panels,) matplotlib Axes [s, and the unit of each quantity].

        Raises
        ------
        MachineError : if matplotlib is not installed
        TrajectoryError : for a plan of another scene, or without data
        """
        self.check_fits(scene)
        names, units = column_names(scene), _units(scene)
        plan = {part: getattr(self, part) for part in _TITLES if part not in self.missing}
        replay = (
            {}
            if motion is None
            else {"q": motion.q, "v": motion.v, "lam": np.hstack([motion.lam, motion.friction])}
        )
        parts = [part for part in _TITLES if names[part] and (part in plan or part in replay)]
        if not parts:
            raise TrajectoryError(
                f"plan: it has only times of scene {scene.name}, so there is nothing to draw."
            )
        try:
            import matplotlib.pyplot as plt
        except ImportError as error:
            raise MachineError(
                f"a plot needs matplotlib, which is not installed; {_INSTALL}."
            ) from error
        figure, axes = plt.subplots(
            len(parts),
            sharex=True,
            squeeze=False,
            figsize=(8.0, 2.2 * len(parts)),
            layout="constrained",
        )
        for axis, part in zip(axes[:, 0], parts, strict=True):
            for index, name in enumerate(names[part]):
                color, replayed = f"C{index}", motion is not None and part in replay
                if part in plan:
                    values = plan[part][:, index]
                    # One value per step: constant, or a line to the end of the last step.
                    if len(values) < len(self.t):
                        values = np.append(
                            values,
                            values[-1]
                            if part == "lam" or self.u_end is None
                            else self.u_end[index],
                        )
                    held = part == "lam" or (part == "u" and self.hold is Hold.ZERO_ORDER)
                    style, label = (":", f"{name}, plan") if replayed else ("-", name)
                    axis.plot(
                        self.t,
                        values,
                        style,
                        color=color,
                        label=label,
                        drawstyle="steps-post" if held else "default",
                    )
                if motion is not None and replayed:
                    axis.plot(
                        motion.t, replay[part][:, index], color=color, label=f"{name}, replay"
                    )
            axis.set_ylabel(
                f"{_TITLES[part]} [{', '.join(dict.fromkeys(units[name] for name in names[part]))}]"
            )
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        axes[-1, 0].set_xlabel("time [s]")
        figure.suptitle(scene.name)
        return axes[:, 0]


def data_frame(columns: Mapping[str, Any]) -> pd.DataFrame:
    """Return a pandas DataFrame of columns by name. Raises MachineError without pandas."""
    try:
        import pandas as pd
    except ImportError as error:
        raise MachineError(
            f"a DataFrame needs pandas, which is not installed; {_INSTALL}."
        ) from error
    return pd.DataFrame(columns)


def uniform_grid(step: float, steps: int) -> np.ndarray:
    """Return times n*step (steps + 1,) [s] from 0, without accumulated rounding. Raises nothing."""
    return step * np.arange(steps + 1)


def columns_of(scene: Scene) -> dict[str, list[tuple[str, str, str]]]:
    """Return (name, unit, description) of the columns of q, v, u, lam in files."""
    return {
        "q": [(item.name, item.unit, item.description) for item in scene.coordinates],
        "v": [
            (item.velocity_name, item.velocity_unit, f"velocity of {item.name}")
            for item in scene.coordinates
        ],
        "u": [(item.name, item.unit, item.description) for item in scene.inputs],
        "lam": [
            (item.force_name, "N", f"{kind} force, {item.description or item.name}")
            for kind, items in (("contact", scene.contacts), ("friction", scene.frictions))
            for item in items
        ],
    }


def column_names(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the column names of q, v, u, lam in files and FMUs."""
    return {group: tuple(name for name, _, _ in rows) for group, rows in columns_of(scene).items()}


def grouped_names(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the column names of q, v, u, lam and friction, the groups of a plan."""
    names = column_names(scene)
    return {**names, "lam": names["lam"][: scene.nc], "friction": names["lam"][scene.nc :]}


def write_csv(path: Path, trajectory: Trajectory, scene: Scene) -> None:
    """Write a plan as CSV with 17 significant digits (exact), without missing groups."""
    trajectory.check_fits(scene)
    plan, names = trajectory, grouped_names(scene)
    held = next(word for word, hold in HOLDS.items() if hold is plan.hold)
    lines = [
        f"# hold: {held}",
        *([] if plan.scheme is None else [f"# scheme: {plan.scheme.value}"]),
    ]
    end = plan.u_end if plan.hold is Hold.LINEAR else None
    arrays = {"q": plan.q, "v": plan.v, "u": plan.u if end is None else np.vstack([plan.u, end])}
    arrays |= {"lam": plan.lam[:, : scene.nc], "friction": plan.lam[:, scene.nc :]}
    columns = {"t": plan.t}
    for group, values in arrays.items():
        columns |= {} if group in plan.missing else dict(zip(names[group], values.T, strict=True))
    lines.append(",".join(columns))
    for index in range(plan.steps + 1):
        lines.append(
            ",".join(
                repr(float(values[index])) if index < len(values) else ""
                for values in columns.values()
            )
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_csv(
    path: Path,
    scene: Scene,
    hold: Hold | str | None = None,
    scheme: Scheme | str | None = None,
    ignore: Sequence[str] = (),
) -> Trajectory:
    """Read a plan from a CSV file.

    Cells are separated by comma, semicolon (then 0,5 is a number) or tab; lines with # are
    comments. A column may state its unit, `q1 [m]`, which must be the scene's. Empty columns count
    as missing. `t` and the inputs are required; positions, velocities, contact forces and friction
    forces may be missing as whole groups. Substitutes are the task's start positions, zero forces,
    and central differences as velocities with the task's at the start. A plan of inputs only, with
    inputs in its last row, gets one more step if it then lasts as long as the task.

    Parameters
    ----------
    hold, scheme
        As declared by `# hold: ..` or `# scheme: ..`; None: as declared, else zero and none.
    ignore
        Names of columns to ignore.

    Returns
    -------
    Trajectory
        The plan; `missing` are the groups that the file lacks.

    Raises
    ------
    TrajectoryError
        Naming the file, the line and the column.
    """
    table = PlanTable(path, ignore)
    option = as_scheme(scheme)
    if option is not None and table.declared.setdefault("scheme", option.value) != option.value:
        raise TrajectoryError(
            f"{table.where}: it declares the scheme {table.declared['scheme']!r}, but {option.value!r} is requested; leave one of the two out."
        )
    return trajectory_from(table, scene, hold)


def trajectory_from(table: Table, scene: Scene, hold: Hold | str | None = None) -> Trajectory:
    """Return a plan of a scene from a table, as `read_csv`. Raises TrajectoryError."""
    where, header, names, groups = (
        table.where,
        table.names,
        column_names(scene),
        grouped_names(scene),
    )
    known = ["t", *(name for group in names.values() for name in group)]
    for column in header:
        if column not in known:
            hint = _meant(column, known)
            raise TrajectoryError(
                f"{where}: the column {column!r} is unknown; {hint}scene {scene.name} has {', '.join(known)}. Delete it, or ignore it (--ignore {column})."
            )
    for column in ("t", *names["u"]):
        if column not in table.given:
            raise TrajectoryError(
                f"{where}: {lack_of(table, column)}; it has {', '.join(table.given)}."
            )
    missing = missing_groups(table, groups)
    for column, unit in _units(scene).items():
        table.check_unit(column, unit)
    scheme, hold = declared_scheme(table), declared_hold(table, hold)
    expected = None if "q" not in missing else (scene.task.horizon, scene.task.step / 2.0)
    t, u, u_end = times_and_inputs(table, "t", names["u"], hold, expected)
    steps = len(t) - 1
    start = np.array(scene.task.start, dtype=float)
    if "q" in missing:
        q, v = (
            np.tile(start[: scene.nq], (steps + 1, 1)),
            np.tile(start[scene.nq :], (steps + 1, 1)),
        )
    else:
        q = np.column_stack([table.column(name, last_is_open=False) for name in names["q"]])
        if "v" not in missing:
            v = np.column_stack([table.column(name, last_is_open=False) for name in names["v"]])
        elif (np.diff(t) > 0).all():
            v = _velocities(t, q, scene)
        else:
            v = np.zeros_like(q)  # `Trajectory` refuses the times below
    forces = [
        table.column(name, last_is_open=steps < table.rows)
        if name in table.given
        else np.zeros(steps)
        for name in names["lam"]
    ]
    lam = np.column_stack(forces) if forces else np.zeros((steps, 0))
    try:
        plan = Trajectory(
            t=t, q=q, v=v, u=u, lam=lam, hold=hold, scheme=scheme, missing=missing, u_end=u_end
        )
        plan.check_fits(scene)
        return plan
    except TrajectoryError as error:
        raise TrajectoryError(f"{error} ({table.source})") from error


def missing_groups(table: Table, groups: Mapping[str, Sequence[str]]) -> frozenset[str]:
    """Return the groups q, v, lam, friction that are missing or empty in a table.

    Raises TrajectoryError for a partial group, and for velocities without positions.
    """
    where, header = table.where, table.given
    for columns in groups.values():
        present = [name for name in columns if name in header]
        if present and len(present) < len(columns):
            absent = next(name for name in columns if name not in header)
            raise TrajectoryError(
                f"{where}: {lack_of(table, absent)}, but {present[0]!r} is present; give {', '.join(columns)}, or none of them."
            )
    missing = frozenset(
        group for group, columns in groups.items() if columns and columns[0] not in header
    )
    if "q" in missing and groups.get("v") and "v" not in missing:
        raise TrajectoryError(
            f"{where}: it has velocities, but no positions; give {', '.join(groups['q'])} too, or neither."
        )
    return missing


def check_increasing(t: np.ndarray, where: str) -> None:
    """Raise TrajectoryError unless times (nodes,) [s] increase; `where` names their owner."""
    later = np.diff(t) > 0.0
    if later.all():
        return
    index = int(np.argmin(later))
    if t[index + 1] == t[index]:
        raise TrajectoryError(
            f"{where}: time must increase, but two rows have the time {t[index]:g} (t[{index}] and t[{index + 1}]). If that is a jump of held inputs, delete the first of "
            "the two: a row's inputs hold from its time on; if inputs are lines, let the second row follow a thousandth of a step later."
        )
    raise TrajectoryError(
        f"{where}: time must increase, but t[{index + 1}] = {t[index + 1]:g} follows t[{index}] = {t[index]:g}."
    )


def times_and_inputs(
    table: Table,
    time: str,
    columns: Sequence[str],
    hold: Hold,
    expected: tuple[float, float] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return times t (nodes,) [s], inputs u (steps, nu) [SI] and u_end (nu,) or None of a table.

    A plan of inputs only, with inputs in its last row, gets one more step if it then lasts as long
    as `expected` = (duration, tolerance) [s]; None adds no step. time and columns are names. Raises
    TrajectoryError for a cell that is no finite number.
    """
    t = table.column(time, last_is_open=False)
    check_increasing(t, table.where)
    ends = bool(columns) and all(table.has_last(name) for name in columns)
    if expected is not None and ends:
        t = _with_a_last_step(t, *expected)
    steps = len(t) - 1
    inputs = [table.column(name, last_is_open=steps < table.rows) for name in columns]
    u = np.column_stack(inputs) if inputs else np.zeros((steps, 0))
    if steps == table.rows or not ends:
        return t, u, None
    try:
        return t, u, np.array([table.column(name, last_is_open=False)[-1] for name in columns])
    except TrajectoryError:
        if hold is Hold.LINEAR:
            raise
        return t, u, None  # a constant input does not use it


def declared_scheme(table: Table) -> Scheme | None:
    """Return the declared scheme of a table. Raises TrajectoryError for an unknown one."""
    return as_scheme(table.declared.get("scheme"), table.where)


def declared_hold(table: Table, hold: Hold | str | None, who: str = "--hold") -> Hold:
    """Return the declared hold of a table, else zero.

    hold: requested by `who`, must not contradict. Raises TrajectoryError.
    """
    requested, declared = (
        None if value is None else as_hold(value, table.where)
        for value in (hold, table.declared.get("hold"))
    )
    if requested is not None and declared not in (None, requested):
        raise TrajectoryError(
            f"{table.where}: it declares the hold {table.declared['hold']!r}, but {who} requests another; leave one of the two out."
        )
    return declared or requested or Hold.ZERO_ORDER


def _with_a_last_step(t: np.ndarray, expected: float, near: float) -> np.ndarray:
    """Append the end of the last step if the plan then lasts as expected, within `near` [s]."""
    if not (np.diff(t) > 0).all():
        return t
    longer = np.append(t, 2.0 * t[-1] - t[-2])
    return longer if abs(t[-1] - t[0] - expected) > near >= abs(longer[-1] - t[0] - expected) else t


def _meant(column: str, known: list[str]) -> str:
    folded = {name.lower(): name for name in known}
    folded.setdefault("time", "t")
    # The name before a unit, `q1 (m)`.
    near = nearest(column.partition("(")[0].strip().lower(), folded)
    return "" if near is None else f"did you mean {folded[near]!r}? "


def _units(scene: Scene) -> dict[str, str]:
    columns = columns_of(scene)
    return {
        "t": "s",
        **{name: unit for group in ("q", "u", "v", "lam") for name, unit, _ in columns[group]},
    }


def _velocities(t: np.ndarray, q: np.ndarray, scene: Scene) -> np.ndarray:
    v = np.gradient(q, t, axis=0, edge_order=2 if len(t) > 2 else 1)
    v[0] = scene.task.start[scene.nq :]
    return v


def input_share(
    t: np.ndarray, added: np.ndarray, own: np.ndarray, scale: np.ndarray
) -> float | None:
    """Return the share of feedback in the inputs [-], by root mean squares of window averages.

    None if the plan's inputs are zero and the feedback is not.

    Parameters
    ----------
    t
        Times (steps + 1,) of the steps [s].
    added, own
        Means over each step (steps, nu) of the feedback and of the plan's inputs [N, N m].
    scale
        Half the range of each input (nu,) [N, N m].

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    edges = np.linspace(t[0], t[-1], WINDOWS + 1)
    sizes = []
    for values in (added, own):
        sums = np.vstack([np.zeros(len(scale)), np.cumsum(np.diff(t)[:, None] * values, axis=0)])
        means = [np.diff(np.interp(edges, t, column)) for column in sums.T]
        sizes.append(float(np.linalg.norm(np.array(means) / scale[:, None])))
    if sizes[1] > 0.0:
        return sizes[0] / sizes[1]
    return None if sizes[0] > 0.0 else 0.0
