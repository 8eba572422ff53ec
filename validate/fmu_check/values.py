"""Values: every variable can be read, start values are those of the description and are obeyed, nothing becomes NaN."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator

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

# A start value may lose its last digits on its way through text.
_TEXT = 1e-9
# A Float32 holds seven digits.
_SINGLE = 1e-6
# How long a run from other starts may take [s].
_ELSEWHERE_SECONDS = 5.0


@check("variables can be read", Scope.EACH, clauses=("2.1.7", "2.2.7.2"))
def readable(subject: Subject, kind: str) -> Finding:
    """After initialisation each variable's value reference is accepted, but for clocked ones."""
    variables = [item for item in subject.values if not item.clocked]
    with CheckedInstance(subject, kind).begin() as instance:
        problems = [
            f"{item.name} (value reference {item.reference}, {item.type}) is refused{instance.quote()}"
            for kind in dict.fromkeys(item.type for item in variables)
            for item in itertools.islice(
                _refused(instance, Block(item for item in variables if item.type == kind)), LEAST
            )
        ]
        texts = dict(_texts(instance))
    problems += [f"{name} is {said}" for name, said in texts.items() if said]
    more = f", {len(texts)} of them strings or binaries" if texts else ""
    return unless(problems, f"{len(variables) + len(texts)} variables were read{more}.", end="")


def _texts(instance: CheckedInstance) -> Iterator[tuple[str, str]]:
    """Of each string and binary that is no array its name, and what is wrong with its value: it cannot be read, or one that nobody set is not its start."""
    for item in instance.subject.description.modelVariables:
        if (
            item.type not in ("String", "Binary")
            or getattr(item, "dimensions", None)
            or item.clocks
            or item.alias is not None
        ):
            continue
        said, start = "", "".join(item.start[:1]) if isinstance(item.start, list) else item.start
        try:
            value = getattr(instance.fmu, f"get{item.type}")([item.valueReference])[0]
            found = (
                value.hex()
                if item.type == "Binary"
                else (value if isinstance(value, str) else value.decode())
            )
            wanted = start.lower() if start is not None and item.type == "Binary" else start
            kept = item.causality == "input" or (
                item.initial == "exact" and item.variability in ("constant", "fixed", "tunable")
            )
            if kept and wanted is not None and found != wanted:
                said = f"{found[:40]!r} in the binary, {wanted[:40]!r} in the description"
        except FMICallException:
            said = f"refused, or no text{instance.quote()}"
        except (UnicodeDecodeError, AttributeError):
            said = "no text: it is missing, or not UTF-8"
        yield item.name, said


def _refused(instance: CheckedInstance, variables: Block) -> Iterator[FmuVariable]:
    """Those of one type that cannot be read: all at once, and halves of what is refused."""
    try:
        instance.get(variables)
    except FMICallException:
        if len(variables) == 1:
            yield variables[0]
            return
        for half in (variables[: len(variables) // 2], variables[len(variables) // 2 :]):
            yield from _refused(instance, Block(half))


@check("start values are the XML's", Scope.EACH, clauses=("2.2.7", "2.4.7.5"))
def starts(subject: Subject, kind: str) -> Finding:
    """In Initialization Mode variables have the start values of the description."""
    if not (variables := subject.exact):
        return not_offered("no variable has a start value that counts.")
    with CheckedInstance(subject, kind) as instance:
        instance.setup()
        instance.enter_initialisation()
        values = instance.get(variables)
    names, starts = variables.names, variables.starts
    share = variables.each(lambda item: _SINGLE if item.type == "Float32" else _TEXT)
    bad = ~(
        (values == starts)
        | (np.abs(values - starts) <= share * np.abs(starts))
        | (np.isnan(values) & np.isnan(starts))
    )
    wrong = [
        f"{names[at]} is {values[at]:.10g} in the binary, {starts[at]:.10g} in the description"
        for at in np.flatnonzero(bad)
    ]
    return unless(wrong, f"{len(variables)} start values agree to {_TEXT:g}.", end="")


@check("start values are obeyed", Scope.EACH, clauses=("2.1.7", "2.2.7.2"))
def obeyed(subject: Subject, kind: str) -> Finding:
    """A start value set before or in initialisation is the value from then on."""
    every = [item for item in subject.exact if movable(item)]
    blocks = [Block([every[place]]) for place in sorted(drawn(len(every), len(subject.values)))]
    others = {
        block: value for block in blocks if not np.array_equal(value := moved(block), block.starts)
    }
    if not others:
        return not_offered("no start value can be moved.")
    with CheckedInstance(subject, kind, "default").begin() as instance:
        default = {block: instance.get(block) for block in others}
    wrong, refused, tried = [], 0, 0
    for block, value, phase in (
        (block, value, phase) for block, value in others.items() for phase in ("before", "in")
    ):
        try:
            # of the library that is loaded: FMPy takes 2 ms to look through it
            instance.instantiate()
        except (
            Misbehaviour
        ):  # no more of them after others were freed: told by the check of freed instances
            break
        tried += 1
        with instance:
            try:
                instance.setup()
                if phase == "before":
                    instance.set(block, value)
                instance.enter_initialisation()
                if phase == "in":
                    instance.set(block, value)
                inside = instance.get(block)
            except FMICallException:
                if phase == "before":
                    raise  # a value that is refused is another check's finding
                wrong.append(f"{block[0].name} cannot be set in initialisation{instance.quote()}")
                continue
            try:
                if _is_kept(block[0]):
                    instance.finish_initialisation()
                else:  # its first event update may change it: it is read before that
                    instance.fmu.exitInitializationMode()
                after = instance.get(block)
            except FMICallException:
                refused += 1  # the model has no solution there, and says so
                continue
            wrong += _ignored(block[0], kind, phase, value, inside, after, default[block])
    more = f" {refused} of them make the model refuse to start." if refused else ""
    if tried < 2 * len(others):
        more += f" After {tried + 1} instances the FMU gave no other one for the {len(others) - tried // 2} that are left."
    of_all = "" if len(blocks) == len(every) else f", drawn from {len(every)}"
    return unless(
        wrong,
        f"{tried // 2} start values were moved, each before and in initialisation{of_all}.{more}",
        end="",
    )


def _is_kept(item: FmuVariable) -> bool:
    """Whether nothing but a call of ours changes it."""
    return item.causality in ("parameter", "input")


def _ignored(
    item: FmuVariable,
    kind: str,
    phase: str,
    value: np.ndarray,
    inside: np.ndarray,
    after: np.ndarray,
    default: np.ndarray,
) -> list[str]:
    """Why the value was not obeyed; nothing if it was.

    Co-Simulation makes its first event update as it leaves initialisation: that may compute anew
    what is discrete, and move a state, but not back to where it would be anyhow.
    """
    clause = f"{item.name} was set to {value[0]:.10g} {phase} initialisation"
    if not np.allclose(inside, value, rtol=_TEXT, atol=0.0):
        return [f"{clause}, but is {inside[0]:.10g} in Initialization Mode"]
    is_anew = kind == "CS" and item.variability == "discrete"
    may_move = not _is_kept(item) and (is_anew or not np.array_equal(after, default))
    kept = may_move or np.allclose(after, value, rtol=_TEXT, atol=0.0)
    return [] if kept else [f"{clause}, but is {after[0]:.10g} after it"]


@check("values stay finite", Scope.EACH)
def finite(subject: Subject, kind: str) -> Finding:
    """No variable becomes infinite or not a number in a run with moderate inputs."""
    steps = subject.long_steps(kind)
    rows = fresh_run(subject, kind, steps)
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        row, column = bad[0]
        return failed(
            f"{subject.observed.names[column]} is {rows[row, column]} at t = {subject.time(row):.6g} s."
        )
    return passed(f"{rows.shape[1]} values over {len(rows) - 1} steps of {subject.step:g} s.")


@check("variables move as their variability says", Scope.EACH, clauses=("2.2.7", "2.4.7.4"))
def still(subject: Subject, kind: str) -> Finding:
    """Constant, fixed, tunable and discrete variables do not move between events.

    Of Co-Simulation, where a discrete one may change in each step, the others.
    """
    bound = {"constant", "fixed", "tunable"} | ({"discrete"} if kind == "ME" else set())
    if not (count := sum(item.variability in bound for item in subject.observed)):
        return not_offered("there are none.")
    steps, states = (
        subject.long_steps(kind),
        Block(item for item in subject.exact if item.is_continuous and item.causality != "input"),
    )
    if moves := _moves(subject, kind, bound, steps):
        return failed(moves)
    # From elsewhere too, where other equations may hold. That a model cannot live there is no fault
    # of it.
    with contextlib.suppress(Fault):
        if moves := in_fork(
            lambda: _moves(subject, kind, bound, FEWEST_STEPS, (states, states.near(1.0))),
            _ELSEWHERE_SECONDS,
        ):
            return failed(moves)
    return passed(
        f"{count} variables in a run of at most {steps} steps, and in a few from other starts."
    )


def _moves(
    subject: Subject, kind: str, bound: set[str], steps: int, before: Settings = NOTHING
) -> str:
    """The first variable of a variability in `bound` that moves in a run, as a sentence.

    Empty without one. before: what is set before it. Raises as `run`.
    """
    record, events = Record(), [0]
    with CheckedInstance(subject, kind).begin(before) as instance:
        rows = run(
            instance, 0, steps, record=record, after=lambda _: events.append(len(record.events))
        )
    old, new = rows[:-1], rows[1:]
    moves = (
        (old != new)
        & ~(np.isnan(old) & np.isnan(new))
        & (subject.observed.each(lambda item: item.variability in bound) > 0.0)
    )
    if kind == "ME":  # inputs change by an event every HOLD steps
        moves &= np.array(
            [step % HOLD > 0 and events[step] == events[step + 1] for step in range(len(moves))],
            bool,
        )[:, np.newaxis]
    else:  # an event may be in a step, but not in each
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
    steps = min(subject.steps(kind), 20)
    observed, dice = subject.observed, np.random.default_rng(5)
    places = drawn(len(observed), len(observed))
    blocks = {place: Block([observed[place]]) for place in places}
    reference = fresh_run(subject, kind, steps, "all")
    other = []
    with CheckedInstance(subject, kind, "single") as instance:

        def shuffled() -> None:
            single = {
                place: instance.get(blocks[place])
                for place in (*dice.permutation(places), *dice.permutation(places))
            }
            values = instance.observe()
            for place, value in single.items():
                values[observed.ends[place] : observed.ends[place + 1]] = value
            other.append(values)

        instance.begin()
        shuffled()
        run(instance, 0, steps, after=lambda _: shuffled(), observe="end")
    last = fresh_run(subject, kind, steps, "last", observe="end")
    for rows, how in (
        (np.array(other), "read one by one in another order"),
        (last, "read only at the end"),
    ):
        require_equal(subject, reference[-len(rows) :], rows, how, len(reference) - len(rows))
    return passed(
        f"{len(places)} variables over {steps} steps: all at once, one by one in other orders, and at the end only: equal bits."
    )
