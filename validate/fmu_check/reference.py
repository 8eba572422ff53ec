"""Reference solutions: an FMU's motion with an error bar for each variable and time, and whether results that others stored keep what they claim.

Model Exchange is integrated by CVODE at three tolerances, Co-Simulation stepped with h, h/2, h/4
and h/8, all through the same inputs. The bar of the finest run is how far the second finest is from
it nearby, times a factor for what both share; where runs do not come nearer to each other it is how
far all of them are apart. What neither a step nor a tolerance changes has no bar that could be
known, and is refused.
"""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException

from models.errors import did_you_mean
from validate.execution.isolated import Limits, run_isolated
from validate.fmi.archive import FmuError
from validate.fmi.cvode import ADAMS
from validate.fmi.description import read_description
from validate.fmi.instance import Fault, TerminationRequested
from validate.fmi.references import (
    LS_REF,
    StoredResult,
    Table,
    missing_attributes,
    read_settings,
    read_table,
    read_text,
    stored_results,
)
from validate.fmi.surroundings import listed
from validate.fmu_check.check import Finding, Scope, advice, check, failed, not_offered, passed
from validate.fmu_check.motion import Crowded, Exchange, Record, by_adams_or_bdf
from validate.fmu_check.subject import RUN_SECONDS, Block, CheckedInstance, FmuVariable, Subject

# Tolerances of CVODE, and into how many parts communication steps are divided: the finest last.
_RTOLS = (1e-6, 1e-8, 1e-10)
_PARTS = (1, 2, 4, 8)
_TOLERANCES = (1e-4, 1e-6, 1e-8)
# A bar is this many times what two runs are apart, within so many rows of a number; and so many
# units in its last place.
_SAFETY = 4.0
_NEARBY = 3
_ULPS = 64.0
# Points of an experiment that names no step.
POINTS = 500
# Events of one run, before they are called endless.
_EVENTS = 1_000_000
# A text holds so many digits: what a stored number may be off for that [-].
_TEXT = 5e-6
# Of this share of a value's size and more, nothing of a result is reproduced [-].
_ANOTHER = 0.1


@dataclass(frozen=True)
class Signals:
    """Inputs over time: floating-point ones on straight lines between the times, others as they were last. values: (rows, entries) [its unit]."""

    times: np.ndarray
    variables: Block
    values: np.ndarray

    def at(self, time: float, *, early: bool = False) -> np.ndarray:
        """(entries,) [unit of each variable], at a time where a value jumps the later one, or the `early` one. Raises nothing."""
        last = max(int(self.times.searchsorted(time, side="left" if early else "right")) - 1, 0)
        after = min(last + 1, len(self.times) - 1)
        length = self.times[after] - self.times[last]
        share = (
            (time - self.times[last]) / length if length > 0.0 and time > self.times[last] else 0.0
        )
        begin = self.values[last]
        return np.where(
            self.variables.continuous, begin + share * (self.values[after] - begin), begin
        )

    def lines(self) -> Signals:
        """Those alone that move between the times. Raises nothing."""
        return Signals(
            self.times,
            Block(item for item in self.variables if item.is_continuous),
            self.values[:, self.variables.continuous],
        )

    def jumps(self) -> np.ndarray:
        """(n,) times [s] at which a value jumps: there twice, or of a variable that does not move between. Raises nothing."""
        jumps = (np.diff(self.times) == 0.0) | (
            np.diff(self.values[:, ~self.variables.continuous], axis=0) != 0.0
        ).any(axis=1)
        return np.unique(self.times[1:][jumps])


@dataclass(frozen=True)
class ErrorBounded:
    """values, bars: (rows, entries) of the watched variables [unit of each].

    before: the same where an input jumps, just before that; events: times [s].

    how: by what it was found, in words.
    """

    values: np.ndarray
    before: np.ndarray
    bars: np.ndarray
    events: np.ndarray
    how: str


def signals_of(subject: Subject, where: str, table: Table | None) -> Signals:
    """Inputs from a table. Raises FmuError for what is no input, or has another size."""
    if table is None:
        return Signals(np.zeros(1), Block(), np.empty((1, 0)))
    variables = Block(named(subject, where, name, column) for name, column in table.columns.items())
    for item in variables:
        if item.causality != "input":
            raise FmuError(
                f"{where}: {item.name!r} is no input, but {item.causality}; leave the column out."
            )
    return Signals(
        table.times,
        variables,
        np.hstack([np.empty((len(table.times), 0)), *table.columns.values()]),
    )


def no_variable(subject: Subject, where: str, name: str) -> FmuError:
    """The refusal of a column that is no variable."""
    hint = did_you_mean(name, subject.by_name, f"it has {', '.join(list(subject.by_name)[:6])}, ..")
    return FmuError(f"{where}: the FMU has no variable {name!r}; {hint}")


def named(subject: Subject, where: str, name: str, column: np.ndarray) -> FmuVariable:
    """The variable of a column (rows, entries) [its unit]. Raises FmuError."""
    if (item := subject.by_name.get(name)) is None:
        raise no_variable(subject, where, name)
    if column.shape[1] != item.size:
        raise FmuError(
            f"{where}: {name!r} has {column.shape[1]} numbers a time; the variable has {item.size}."
        )
    return item


def solve(
    subject: Subject, kind: str, times: np.ndarray, signals: Signals, watched: Block
) -> ErrorBounded:
    """Values and error bars at some times.

    Parameters
    ----------
    kind : "ME" or "CS".
    times : (rows,) [s], the first not before the subject's start time.
    signals : inputs; others stay at their starts.
    watched : what is looked at.

    Returns
    -------
    ErrorBounded. Source: the comparison of two tolerances or steps (Hairer, Norsett, Wanner,
        Solving Ordinary Differential Equations I, II.4).

    Raises
    ------
    FmuError : if the FMU refuses or misbehaves, or where nothing tells how large the error is.
    """
    runs: list[_Run]
    if kind == "ME":
        method, runs = by_adams_or_bdf(
            lambda by: (
                by,
                [_exchanged(subject, times, signals, watched, rtol, by) for rtol in _RTOLS],
            )
        )
        how = f"CVODE ({'Adams' if method is ADAMS else 'BDF'}) at the tolerances {', '.join(f'{rtol:g}' for rtol in _RTOLS)}"
    else:
        parts = (
            _PARTS if subject.can(kind, "canHandleVariableCommunicationStepSize") else _PARTS[:1]
        )
        runs = [_stepped(subject, times, signals, watched, number, None) for number in parts]
        how = f"communication steps h/1 .. h/{parts[-1]}, h = {subject.step:g} s"
        if _same([run.rows for run in runs]):
            runs = [
                _stepped(subject, times, signals, watched, 1, tolerance)
                for tolerance in _TOLERANCES
            ]
            how = f"the FMU's own tolerances {', '.join(f'{value:g}' for value in _TOLERANCES)}"
        if _same([run.rows for run in runs]):
            if ((np.ptp(runs[-1].rows, axis=0) != 0.0) & watched.continuous).any():
                raise FmuError(
                    "neither the communication step nor the tolerance changes a bit of its Co-Simulation, so nothing tells how exact that is; "
                    f"{'simulate its Model Exchange' if 'ME' in subject.types else 'Model Exchange, or another step inside, would'}."
                )
            how = "steps and tolerances alike, as nothing continuous moves"
    for rows in (rows for run in runs for rows in (run.before, run.rows)):
        for row, column in np.argwhere(~np.isfinite(rows))[
            :1
        ]:  # it is no reference, and no bar can be told of it
            raise FmuError(
                f"{watched.names[column]} is {rows[row, column]:g} at t = {times[row]:.6g} s, which is no number to hold others against; "
                "end the experiment before that."
            )
    return ErrorBounded(
        runs[-1].rows, runs[-1].before, bars([run.rows for run in runs]), runs[-1].events, how
    )


class _Run(NamedTuple):
    """rows, before: (rows, entries) [unit of each]; events: times [s]."""

    rows: np.ndarray
    before: np.ndarray
    events: np.ndarray


def _same(runs: Sequence[np.ndarray]) -> bool:
    return all(np.array_equal(runs[0], other, equal_nan=True) for other in runs[1:])


def bars(runs: Sequence[np.ndarray]) -> np.ndarray:
    """Error bars of the last of some runs that should come nearer to each other.

    Parameters
    ----------
    runs : (rows, entries) each, the most exact one last [unit of each entry].

    Returns
    -------
    (rows, entries) [unit of each entry].

    Raises
    ------
    IndexError : without runs.
    """
    finest = runs[-1]
    rounding = _ULPS * np.finfo(float).eps * np.abs(finest).max(axis=0)
    if len(runs) == 1:
        return np.broadcast_to(rounding, finest.shape)
    near = _nearby(np.abs(finest - runs[-2]))
    before = _nearby(np.abs(runs[-2] - runs[-3])) if len(runs) > 2 else near
    stalls = near.max(axis=0) > 0.7 * before.max(
        axis=0
    )  # what does not shrink tells nothing about the limit
    return _SAFETY * np.where(stalls, np.maximum(near, before), near) + rounding


def _nearby(rows: np.ndarray) -> np.ndarray:
    """The largest within some rows: where a difference passes through zero the error does not."""
    padded = np.pad(rows, ((_NEARBY, _NEARBY), (0, 0)), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEARBY + 1, axis=0).max(axis=-1)


def _exchanged(
    subject: Subject,
    times: np.ndarray,
    signals: Signals,
    watched: Block,
    rtol: float,
    method: tuple[int, int],
) -> _Run:
    """By CVODE."""
    with CheckedInstance(subject, "ME", "reference") as instance:
        lines = signals.lines()
        begun = [subject.start_time]  # times at which inputs have jumped

        def drive(time: float) -> None:
            instance.set(lines.variables, lines.at(time, early=time > begun[-1]))

        instance.begin(during=(signals.variables, signals.values[0]))
        mover = Exchange(
            instance,
            rtol,
            method,
            drive=drive if lines.variables else None,
            record=Record(most=_EVENTS),
        )

        def jump(time: float) -> None:
            instance.fmu.enterEventMode()
            instance.set(signals.variables, signals.at(time))
            instance.settle()
            begun.append(time)
            mover.renew(time)

        jumps, rows, before = signals.jumps(), [], []
        try:
            mover.renew(subject.start_time)
            for time in times:
                for at in [*jumps[(jumps > mover.time) & (jumps < time)]]:
                    mover.advance(float(at))
                    jump(float(at))
                mover.advance(float(time))
                before.append(instance.get(watched))
                if time in jumps and time > subject.start_time:
                    jump(float(time))
                rows.append(instance.get(watched))
        except Crowded:
            raise FmuError(
                f"its events follow each other without end from t = {mover.time:.6g} s on; end the experiment before that."
            ) from None
        finally:
            mover.close()
        return _Run(
            np.array(rows), np.array(before), np.array([event[0] for event in mover.record.events])
        )


def _stepped(
    subject: Subject,
    times: np.ndarray,
    signals: Signals,
    watched: Block,
    parts: int,
    tolerance: float | None,
) -> _Run:
    """By communication steps: the inputs of the middle of each during it, those of its end after it."""
    with CheckedInstance(subject, "CS", "reference") as instance:
        instance.tolerance = tolerance
        instance.begin(during=(signals.variables, signals.values[0]))
        time, rows, before = subject.start_time, [], []
        for goal in times:
            count = max(1, round((goal - time) / subject.step)) * parts if goal > time else 0
            begin = time
            for part in range(1, count + 1):
                end = begin + (goal - begin) * part / count
                instance.set(signals.variables, signals.at(0.5 * (time + end)))
                instance.do_step(time, end - time)
                time = end
            if time > subject.start_time:
                instance.set(signals.variables, signals.at(time, early=True))
            before.append(instance.get(watched))
            instance.set(signals.variables, signals.at(time))
            rows.append(instance.get(watched))
        return _Run(np.array(rows), np.array(before), np.empty(0))


@contextlib.contextmanager
def _in_words() -> Iterator[None]:
    """What an FMU did, as an FmuError."""
    try:
        yield
    except FMICallException as error:
        raise FmuError(
            f"it refuses a call that must be possible ({str(error).rstrip('.')})."
        ) from error
    except TerminationRequested as end:
        raise FmuError(
            f"it asks for the end of the simulation at t = {end.time:.6g} s; end the experiment before that."
        ) from end
    except Fault as fault:
        raise FmuError(f"{fault}.") from fault


def run_reference(
    request: dict[str, Any], arrays: dict[str, np.ndarray]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """In the isolated child: request and answer of `reference_solution`, arrays (rows, entries) [unit of each]. Raises FmuError."""
    folder = Path(request["folder"])
    subject = Subject(Path(request["path"]), folder, read_description(folder))
    times = arrays.pop("times")
    subject.start_time = float(times[0])
    columns = {name: arrays[f"input {place}"] for place, name in enumerate(request["inputs"])}
    signals = signals_of(
        subject, request["input_file"], Table(arrays["input_times"], columns) if columns else None
    )
    watched = Block(dict.fromkeys([*subject.outputs, *subject.states]))
    if not watched:
        raise FmuError(
            "it has neither outputs nor states that are numbers: there is nothing to write."
        )
    with _in_words():
        found = solve(subject, request["type"], times, signals, watched)
    names, sizes = [item.name for item in watched], [item.size for item in watched]
    value = {"names": names, "sizes": sizes, "how": found.how, "events": len(found.events)}
    return value, {"values": found.values, "bars": found.bars}


def reference_solution(
    request: dict[str, Any], arrays: dict[str, np.ndarray], seconds: float
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """`run_reference` in a process of its own, for at most so many seconds.

    Arrays (rows, entries) [unit of each]. Raises FmuError, MachineError.
    """
    function, limits = "validate.fmu_check.reference:run_reference", Limits(seconds=seconds)
    done = run_isolated(function, request, arrays, limits=limits, what="the reference solution")
    if not done.ok:
        raise FmuError(f"FMU {request['name']}: {done.sentence}")
    return done.value, dict(done.arrays)


@check("stored results hold", Scope.FILE)
def stored(subject: Subject) -> Finding:
    """Reference results that come with the FMU, in its LS-REF folder or beside it, are as exact as they claim."""
    told: dict[Callable[[str], Finding], list[str]] = {
        failed: [],
        advice: [],
        passed: [],
        not_offered: [],
    }
    try:
        results = list(stored_results(subject.folder, subject.path))
        if missing := missing_attributes(subject.folder):
            told[advice].append(f"the manifest of {LS_REF} has no {' and no '.join(missing)}")
    except FmuError as error:
        return failed(f"{str(error).rstrip('.')}.")
    for result in results if subject.types else ():
        try:
            outcome, sentence = (
                (advice, str(result))
                if isinstance(result, FmuError)
                else _of_result(subject, result)
            )
        except FmuError as error:
            outcome, sentence = failed, str(error)
        told[outcome].append(sentence.rstrip("."))
    for outcome, sentences in told.items():
        if sentences:
            return outcome(f"{listed(sentences)}.")
    return not_offered("the FMU has no result in an LS-REF folder, and none lies beside it.")


def _of_result(subject: Subject, result: StoredResult) -> tuple[Callable[[str], Finding], str]:
    """Outcome and clause of one stored result. Raises FmuError for what cannot be read."""
    where = result.where
    others = {item.name for item in subject.description.modelVariables} - set(subject.by_name)
    text = read_text(result.result)
    for name in next(csv.reader(text.splitlines()), [])[1:]:
        if name.strip() not in others and name.strip() not in subject.by_name:
            raise no_variable(subject, where, name.strip())
    table = read_table(where, text, others)
    watched = Block(named(subject, where, name, column) for name, column in table.columns.items())
    settings = (
        read_settings(result.settings.name, read_text(result.settings))
        if result.settings
        else result.experiment
    )
    claims, driven = (
        read_table(path.name, read_text(path)) if path else None
        for path in (result.error, result.inputs)
    )
    inputs = signals_of(subject, result.inputs.name if result.inputs else "", driven)
    if claims is not None and (
        [*claims.columns] != [*table.columns] or not np.array_equal(claims.times, table.times)
    ):
        raise FmuError(f"{where}: its error bars have other columns or times than it")
    subject = Subject(
        subject.path, subject.folder, subject.description, dict(subject.pace), dict(subject.ends)
    )
    subject.start_time = (
        settings["StartTime"] if settings else min(subject.start_time, float(table.times[0]))
    )
    kind = subject.types[0]
    rows = _affordable(subject, kind, table.times)
    if rows < 2:
        return (
            not_offered,
            f"{where}: a step of the FMU takes {subject.pace[kind]:.1g} s, too long to try",
        )
    try:
        with _in_words():
            found = solve(subject, kind, table.times[:rows], inputs, watched)
    except FmuError as error:
        return not_offered, f"{where}: it cannot be tried: {error}"
    theirs = np.hstack(list(table.columns.values()))[:rows]
    size = np.maximum(np.abs(found.values).max(axis=0), 1e-3 * watched.scales)
    apart = _apart(watched, theirs, found, table.times[:rows])
    stated = (
        np.hstack(list(claims.columns.values()))[:rows]
        if claims
        else (settings["RelTol"] if settings else subject.tolerance) * size
    )
    excess = (
        apart
        - stated
        - found.bars
        - _TEXT * np.minimum(size, np.abs(theirs)) * (claims is None and settings is None)
    )
    row, column = np.unravel_index(
        int(np.argmax(np.where(np.isfinite(excess), excess / size, np.inf))), excess.shape
    )
    names, worst = watched.names, apart / size
    shown = f"{where}: {len(names)} values at {rows} times, off by up to {np.nanmax(worst):.2g} of their size"
    claim = (
        "its error bars"
        if claims
        else f"the tolerance {settings['RelTol'] if settings else subject.tolerance:g}"
    )
    if not excess[row, column] > 0.0 and np.isfinite(excess[row, column]):
        return passed, f"{shown}, within {claim}; by {found.how}"
    clause = f"{where}: {names[column]} is {theirs[row, column]:.9g} at t = {table.times[row]:.6g} s, by {found.how} {found.values[row, column]:.9g} +- {found.bars[row, column]:.1g}"
    if claims or settings:
        allowed = f"{claim} allow{'' if claims else 's'} {np.broadcast_to(stated, apart.shape)[row, column]:.2g}"
        return failed, f"{clause}: {apart[row, column]:.2g} off, where {allowed}"
    if not worst[row, column] <= _ANOTHER and (
        again := _again(subject, watched, table.times[:rows], inputs, theirs, size)
    ):
        return failed, f"{clause}; {again}"
    return (
        advice,
        f"{clause}: {worst[row, column]:.1g} of its size off, and it does not say how exact it is",
    )


def _affordable(subject: Subject, kind: str, times: np.ndarray) -> int:
    """How many of the times are reached within some seconds, by all runs together."""
    runs = len(_RTOLS) if kind == "ME" else sum(_PARTS)
    pace = (
        subject.pace.get(kind, 0.0)
        * runs
        * max(1.0, float(times[-1] - times[0]) / (max(len(times) - 1, 1) * subject.step))
    )
    most = len(times) if pace <= 0.0 else min(len(times), int(5.0 * RUN_SECONDS / pace))
    return int(np.searchsorted(times[:most], subject.ends.get(kind, np.inf)))


def _apart(
    watched: Block, theirs: np.ndarray, found: ErrorBounded, times: np.ndarray
) -> np.ndarray:
    """(rows, entries) how far stored values are off [unit of each].

    At an event either value counts, and those between; of what is not continuous, the neighbours'.
    """
    apart = np.abs(theirs - found.values)
    discrete = ~watched.continuous
    for row in range(len(times)):
        first, last = max(row - 1, 0), min(row + 1, len(times) - 1)
        eventful = ((found.events >= times[first]) & (found.events <= times[last])).any()
        either = discrete | eventful
        near = np.vstack([found.values[first : last + 1], found.before[row]])
        outside = np.maximum(
            np.maximum(near.min(axis=0) - theirs[row], theirs[row] - near.max(axis=0)), 0.0
        )
        apart[row] = np.where(
            either, outside, np.minimum(apart[row], np.abs(theirs[row] - found.before[row]))
        )
    return apart


def _again(
    subject: Subject,
    watched: Block,
    times: np.ndarray,
    inputs: Signals,
    theirs: np.ndarray,
    size: np.ndarray,
) -> str:
    """Why a result that is far off is wrong: plain Co-Simulation does not give it either.

    Empty if it does.
    """
    with contextlib.suppress(FmuError):
        if "CS" in subject.types:
            with _in_words():
                plain = _stepped(subject, times, inputs, watched, 1, None).rows
            off = float((np.abs(plain - theirs) / size).max())
            return (
                f"plain Co-Simulation is {off:.2g} of its size off as well"
                if not off <= _ANOTHER
                else ""
            )
    return "nothing of it is what the FMU gives"
