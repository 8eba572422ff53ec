"""Values: all can be read, starts are those of the description and are obeyed, none becomes NaN."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.instance import Fault, Misbehaviour
from validate.fmu_check.accepted import LEAST, drawn, movable, moved
from validate.fmu_check.check import (
    Finding,
    Scope,
    check,
    failed,
    in_fork,
    not_offered,
    passed,
    unless,
)
from validate.fmu_check.motion import Record, fresh_run, require_equal, run
from validate.fmu_check.subject import (
    FEWEST_STEPS,
    HOLD,
    NOTHING,
    Block,
    CheckedInstance,
    FmuVariable,
    Settings,
    Subject,
)

# Relative error of a start value that is written as text: exporters print at least nine digits.
_TEXT = 1e-9
# A Float32 holds seven digits.
_SINGLE = 1e-6
# Time of a run from other starts [s]: more than twice that of other runs.
_ELSEWHERE_SECONDS = 5.0


@check("variables can be read", Scope.EACH, clauses=("2.1.7", "2.2.7.2"))
def readable(subject: Subject, kind: str) -> Finding:
    """After initialisation each variable's value reference is accepted, but for clocked ones."""
    variables = subject.observed
    with CheckedInstance(subject, kind).begin() as instance:
        problems = [
            f"{item.name} (value reference {item.reference}, {item.type}) is refused{instance.quote()}"
            for item in itertools.islice(_refused(instance, variables), LEAST)
        ]
        texts = [
            item
            for item in subject.description.modelVariables
            if item.type in ("String", "Binary")
            and item.alias is None
            and not (getattr(item, "dimensions", None) or item.clocks)
        ]
        problems += filter(None, (_wrong_text(instance, item) for item in texts))
    more = f", {len(texts)} of them strings or binaries" if texts else ""
    return unless(problems, f"{len(variables) + len(texts)} variables were read{more}.")


def _wrong_text(instance: CheckedInstance, item: Any) -> str:
    """Return a clause about an unreadable string or binary, or one that is not its start, or ""."""
    start = "".join(item.start[:1]) if isinstance(item.start, list) else item.start
    is_binary = item.type == "Binary"
    try:
        value = getattr(instance.fmu, f"get{item.type}")([item.valueReference])[0]
        text = value.hex() if is_binary else value if isinstance(value, str) else value.decode()
    except FMICallException:
        return f"{item.name} is refused, or no text{instance.quote()}"
    except (UnicodeDecodeError, AttributeError):
        return f"{item.name} is no text: it is missing, or not UTF-8"
    is_fixed = item.initial == "exact" and item.variability in ("constant", "fixed", "tunable")
    expected = start.lower() if start is not None and is_binary else start
    if expected in (None, text) or not (is_fixed or item.causality == "input"):
        return ""
    return f"{item.name} is {text[:40]!r} in the binary, {expected[:40]!r} in the description"


def _refused(instance: CheckedInstance, variables: Block) -> Iterator[FmuVariable]:
    """Find variables that cannot be read, by bisection."""
    try:
        instance.get(variables)
    except FMICallException:
        if len(variables) == 1:
            yield variables[0]
            return
        half = len(variables) // 2
        for part in (variables[:half], variables[half:]):
            yield from _refused(instance, Block(part))


@check("start values are the XML's", Scope.EACH, clauses=("2.2.7", "2.4.7.5"))
def starts(subject: Subject, kind: str) -> Finding:
    """In Initialization Mode variables have the start values of the description."""
    if not (variables := subject.exact):
        return not_offered("no variable has a start value that counts.")
    with CheckedInstance(subject, kind) as instance:
        values = instance.initialising().get(variables)
    starts = variables.starts
    share = variables.each(lambda item: _SINGLE if item.type == "Float32" else _TEXT)
    same = (values == starts) | (np.isnan(values) & np.isnan(starts))
    wrong = [
        f"{variables.names[at]} is {values[at]:.10g} in the binary, {starts[at]:.10g} in the description"
        for at in np.flatnonzero(~(same | (np.abs(values - starts) <= share * np.abs(starts))))
    ]
    return unless(wrong, f"{len(variables)} start values agree to {_TEXT:g}.")


@check("start values are obeyed", Scope.EACH, clauses=("2.1.7", "2.2.7.2"))
def obeyed(subject: Subject, kind: str) -> Finding:
    """A start value set before or in initialisation is the value from then on."""
    every = [item for item in subject.exact if movable(item)]
    items = [every[place] for place in sorted(drawn(len(every), len(subject.values)))]
    others = [(Block([item]), moved(Block([item]))) for item in items]
    others = [(block, value) for block, value in others if (value != block.starts).any()]
    if not others:
        return not_offered("no start value can be moved.")
    with CheckedInstance(subject, kind, "default").begin() as instance:
        defaults = {block: instance.get(block) for block, _ in others}
    wrong, refused, tried = [], 0, 0
    for (block, value), phase in itertools.product(others, ("before", "in")):
        try:
            instance.instantiate()  # of the loaded library: FMPy takes 2 ms to look through it
        except Misbehaviour:  # reported by the check of freed instances
            break
        tried += 1
        with instance:
            instance.initialising((block, value) if phase == "before" else NOTHING)
            try:
                if phase == "in":
                    instance.set(block, value)
            except FMICallException:
                wrong.append(f"{block[0].name} cannot be set in initialisation{instance.quote()}")
                continue
            inside = instance.get(block)
            try:
                if _is_kept(block[0]):
                    instance.finish_initialisation()
                else:  # the first event update may change it
                    instance.fmu.exitInitializationMode()
                after = instance.get(block)
            except FMICallException:
                refused += 1  # the model has no solution there
                continue
            may_move = not _is_kept(block[0]) and (
                (kind == "CS" and block[0].variability == "discrete")
                or not np.array_equal(after, defaults[block])
            )
            where = f"{block[0].name} was set to {value[0]:.10g} {phase} initialisation, but is"
            if not np.allclose(inside, value, rtol=_TEXT, atol=0.0):
                wrong.append(f"{where} {inside[0]:.10g} in Initialization Mode")
            elif not (may_move or np.allclose(after, value, rtol=_TEXT, atol=0.0)):
                wrong.append(f"{where} {after[0]:.10g} after it")
    moves = (
        f"{tried // 2} of {len(every)} start values were moved, each before and in initialisation"
    )
    return unless(wrong, f"{moves}; {refused} times the model then refuses to start.")


def _is_kept(item: FmuVariable) -> bool:
    """Return whether a value stays until it is set again.

    Co-Simulation may make its first event update as it leaves initialisation. This update may
    compute discrete variables again, and move a state, but not back to its default.
    """
    return item.causality in ("parameter", "input")


@check("values stay finite", Scope.EACH)
def finite(subject: Subject, kind: str) -> Finding:
    """No variable becomes infinite or not a number in a run with moderate inputs."""
    rows = fresh_run(subject, kind, subject.long_steps(kind))
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        row, column = bad[0]
        name, time = subject.observed.names[column], subject.time(row)
        return failed(f"{name} is {rows[row, column]} at t = {time:.6g} s.")
    return passed(f"{rows.shape[1]} values over {len(rows) - 1} steps of {subject.step:g} s.")


@check("variables move as their variability says", Scope.EACH, clauses=("2.2.7", "2.4.7.4"))
def still(subject: Subject, kind: str) -> Finding:
    """Constant, fixed, tunable and, in Model Exchange, discrete variables do not move between events."""
    bound = {"constant", "fixed", "tunable"} | ({"discrete"} if kind == "ME" else set())
    if not (count := sum(item.variability in bound for item in subject.observed)):
        return not_offered("there are none.")
    steps = subject.long_steps(kind)
    if moves := _moves(subject, kind, bound, steps):
        return failed(moves)
    # Other equations may hold elsewhere. A model that cannot live there is no defect.
    states = Block(
        item for item in subject.exact if item.is_continuous and item.causality != "input"
    )
    elsewhere = (states, states.near(1.0))
    with contextlib.suppress(Fault):
        if moves := in_fork(
            lambda: _moves(subject, kind, bound, FEWEST_STEPS, elsewhere), _ELSEWHERE_SECONDS
        ):
            return failed(moves)
    return passed(
        f"{count} variables in a run of at most {steps} steps, and in a few from other starts."
    )


def _moves(
    subject: Subject, kind: str, bound: set[str], steps: int, before: Settings = NOTHING
) -> str:
    """Return a sentence about the first variable of a variability in `bound` that moves in a run.

    before: values set before the run. Raises as `run`.
    """
    record, events = Record(), [0]
    with CheckedInstance(subject, kind).begin(before) as instance:
        rows = run(
            instance, 0, steps, record=record, after=lambda _: events.append(len(record.events))
        )
    old, new = rows[:-1], rows[1:]
    moves = (old != new) & ~(np.isnan(old) & np.isnan(new))
    moves &= subject.observed.each(lambda item: item.variability in bound) > 0.0
    if kind == "ME":  # the inputs change in an event every HOLD steps
        is_quiet = np.diff(events[: len(moves) + 1]) == 0
        moves &= (is_quiet & (np.arange(len(moves)) % HOLD > 0))[:, None]
    else:  # a step may contain an event, but three steps in a row do not all contain one
        moves = moves[:-2] & moves[1:-1] & moves[2:]
    if not moves.any():
        return ""
    step, place = np.argwhere(moves)[0]
    name = subject.observed.names[place]
    when = f"t = {subject.time(step):.6g} s to {new[step, place]:.10g} at t = {subject.time(step + 1):.6g} s"
    how = "without an event between" if kind == "ME" else "and on in the next two steps"
    return f"{name} is {subject.by_name[name].variability}, but moves from {old[step, place]:.10g} at {when}, {how}."


@check("order of reading does not matter", Scope.EACH)
def get_order(subject: Subject, kind: str) -> Finding:
    """Values do not depend on which variables were read before, how often and in which order."""
    steps = min(subject.steps(kind), 2 * HOLD)
    observed, dice = subject.observed, np.random.default_rng(5)
    places = drawn(len(observed), len(observed))
    blocks = {place: Block([observed[place]]) for place in places}
    reference = fresh_run(subject, kind, steps, "all")
    shuffled = []
    with CheckedInstance(subject, kind, "single").begin() as instance:

        def read(_step: int) -> None:
            order = (*dice.permutation(places), *dice.permutation(places))
            single = {place: instance.get(blocks[place]) for place in order}
            values = instance.observe()
            for place, value in single.items():
                values[observed.ends[place] : observed.ends[place + 1]] = value
            shuffled.append(values)

        read(0)
        run(instance, 0, steps, after=read, observe="end")
    last = fresh_run(subject, kind, steps, "last", observe="end")
    other_order = "read one by one in another order"
    require_equal(subject, reference[-len(shuffled) :], np.array(shuffled), other_order)
    require_equal(subject, reference[-1:], last, "read only at the end", len(reference) - 1)
    return passed(
        f"{len(places)} variables over {steps} steps: all at once, one by one in other orders, "
        "and at the end only: equal bits."
    )
