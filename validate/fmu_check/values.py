"""Values: every variable can be read, start values are those of the description and are obeyed, nothing becomes NaN."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from fmpy.fmi1 import FMICallException

from validate.fmi.instance import Misbehaviour
from validate.fmi.surroundings import listed
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed
from validate.fmu_check.motion import fresh_run, require_equal, run
from validate.fmu_check.subject import CheckedInstance, FmuVariable, Subject, entry_names

# A start value may lose its last digits on its way through text.
_TEXT = 1e-9
# A Float32 holds seven digits.
_SINGLE = 1e-6
# So many variables are read one by one, and of a large FMU as many as read so many values in all where each reading computes all of them, but for the least.
_ONE_BY_ONE, _COMPUTED, _LEAST = 2000, 40_000_000, 100
# How far a start value is moved to see whether it is obeyed.
_MOVED = 0.01


@check("variables can be read", Scope.EACH, clauses=("2.1.7", "2.2.7.2"))
def readable(subject: Subject, kind: str) -> Finding:
    """After initialisation each variable's value reference is accepted."""
    with CheckedInstance(subject, kind) as instance:
        instance.begin()
        problems = [
            f"{item.name} (value reference {item.reference}, {item.type}) is refused{instance.quote()}"
            for kind in dict.fromkeys(item.type for item in subject.variables)
            for item in _refused(instance, [item for item in subject.variables if item.type == kind])
        ]
        texts = dict(_texts(instance))
    problems += [f"{name} is {said}" for name, said in texts.items() if said]
    if problems:
        return failed(listed(problems))
    more = f", {len(texts)} of them strings or binaries" if texts else ""
    return passed(f"{len(subject.variables) + len(texts)} variables were read{more}.")


def _texts(instance: CheckedInstance) -> Iterator[tuple[str, str]]:
    """Of each string and binary that is no array its name, and what is wrong with its value: it cannot be read, or one that nobody set is not its start."""
    for item in instance.subject.description.modelVariables:
        if item.type not in ("String", "Binary") or getattr(item, "dimensions", None):
            continue
        said, start = "", "".join(item.start[:1]) if isinstance(item.start, list) else item.start
        try:
            value = getattr(instance.fmu, f"get{item.type}")([item.valueReference])[0]
            found = value.hex() if item.type == "Binary" else (value if isinstance(value, str) else value.decode())
            wanted = start.lower() if start is not None and item.type == "Binary" else start
            kept = item.causality == "input" or (item.initial == "exact" and item.variability in ("constant", "fixed", "tunable"))
            if kept and wanted is not None and found != wanted:
                said = f"{found[:40]!r} in the binary, {wanted[:40]!r} in the description"
        except (FMICallException, UnicodeDecodeError, AttributeError) as error:
            said = (
                f"refused, or no text{instance.quote()}" if isinstance(error, FMICallException) else "no text: it is missing, or not UTF-8"
            )
        yield item.name, said


def _refused(instance: CheckedInstance, variables: list[FmuVariable]) -> Iterator[FmuVariable]:
    """Those of one type that cannot be read: all at once, and halves of what is refused."""
    try:
        instance.get(variables)
    except FMICallException:
        if len(variables) == 1:
            yield variables[0]
            return
        for half in (variables[: len(variables) // 2], variables[len(variables) // 2 :]):
            yield from _refused(instance, half)


def _exact(subject: Subject) -> list[FmuVariable]:
    """Variables whose start is their value in initialisation."""
    return [item for item in subject.variables if item.start is not None and (item.initial == "exact" or item.causality == "input")]


@check("start values are the XML's", Scope.EACH, clauses=("2.2.7", "2.4.7.5"))
def starts(subject: Subject, kind: str) -> Finding:
    """In Initialization Mode variables have the start values of the description."""
    variables = _exact(subject)
    if not variables:
        return not_offered("no variable has a start value that counts.")
    with CheckedInstance(subject, kind) as instance:
        instance.setup()
        instance.enter_initialisation()
        values = instance.get(variables)
    starts = np.concatenate([item.start for item in variables if item.start is not None])
    share = np.concatenate([np.full(item.size, _SINGLE if item.type == "Float32" else _TEXT) for item in variables])
    bad = ~((values == starts) | (np.abs(values - starts) <= share * np.abs(starts)) | (np.isnan(values) & np.isnan(starts)))
    names = entry_names(variables) if bad.any() else []
    wrong = [f"{names[at]} is {values[at]:.10g} in the binary, {starts[at]:.10g} in the description" for at in np.flatnonzero(bad)]
    if wrong:
        return failed(listed(wrong))
    return passed(f"{len(variables)} start values agree to {_TEXT:g}.")


def _moved(item: FmuVariable) -> np.ndarray | None:
    """Another value that may be given to it; None if there is none that is surely legal."""
    if item.start is None or item.variability == "constant" or item.causality == "structuralParameter":
        return None
    if item.is_float:
        value = item.near(item.start, _MOVED)
        if item.type == "Float32":  # what it can hold
            value = value.astype(np.float32).astype(float)
    elif item.type == "Boolean" and item.causality == "input":
        value = 1.0 - item.start
    else:
        return None  # another whole number may switch the model to something else
    return None if np.array_equal(value, item.start) else value


@check("start values are obeyed", Scope.EACH, clauses=("2.1.7", "2.2.7.2"))
def obeyed(subject: Subject, kind: str) -> Finding:
    """A start value set before or in initialisation is the value from then on."""
    moved = {item: value for item in _exact(subject) if (value := _moved(item)) is not None}
    if not moved:
        return not_offered("no start value can be moved.")
    every = list(moved)
    moved = {every[place]: moved[every[place]] for place in sorted(_drawn(len(every), len(subject.variables)))}
    with CheckedInstance(subject, kind, "default") as instance:
        instance.begin()
        default = {item: instance.get([item]) for item in moved}
    wrong, refused, tried = [], 0, 0
    for item, value, phase in ((item, value, phase) for item, value in moved.items() for phase in ("before", "in")):
        instance = _another(subject, kind)
        if instance is None:
            break
        tried += 1
        with instance:
            given = {item: value}
            try:
                instance.setup()
                if phase == "before":
                    instance.set_all(given)
                instance.enter_initialisation()
                if phase == "in":
                    instance.set_all(given)
                inside = instance.get([item])
            except FMICallException:
                wrong.append(f"{item.name} cannot be set {phase} initialisation{instance.quote()}")
                continue
            try:
                after = instance.finish_initialisation().get([item])
            except FMICallException:
                refused += 1  # the model has no solution there, and says so
                continue
            wrong += _ignored(item, phase, value, inside, after, default[item])
    if wrong:
        return failed(listed(wrong))
    more = f" {refused} of them make the model refuse to start." if refused else ""
    more += (
        ""
        if tried == 2 * len(moved)
        else f" After {tried + 1} instances the FMU gave no other one for the {len(moved) - tried // 2} that are left."
    )
    of_all = "" if len(moved) == len(every) else f", drawn from {len(every)}"
    return passed(f"{tried // 2} start values were moved, each before and in initialisation{of_all}.{more}")


def _another(subject: Subject, kind: str) -> CheckedInstance | None:
    """A new instance after others were freed; None if the FMU gives no more: that is told by the check of freed instances."""
    try:
        return CheckedInstance(subject, kind)
    except Misbehaviour:
        return None


def _drawn(count: int, size: int) -> list[int]:
    """Places of those of `count` that are looked at one by one in an FMU of this size: all of a small one, ever fewer of larger ones."""
    return np.random.default_rng(5).permutation(count)[: min(_ONE_BY_ONE, max(_LEAST, _COMPUTED // max(size, 1)))].tolist()


def _ignored(item: FmuVariable, phase: str, value: np.ndarray, inside: np.ndarray, after: np.ndarray, default: np.ndarray) -> list[str]:
    """Why the value was not obeyed; nothing if it was. The first event may move a state, but not back to where it would be anyhow."""
    clause = f"{item.name} was set to {value[0]:.10g} {phase} initialisation"
    if not np.allclose(inside, value, rtol=_TEXT, atol=0.0):
        return [f"{clause}, but is {inside[0]:.10g} in Initialization Mode"]
    kept = np.allclose(after, value, rtol=_TEXT, atol=0.0)
    free = item.causality not in ("parameter", "input")
    if not kept and (not free or np.array_equal(after, default)):
        return [f"{clause}, but is {after[0]:.10g} after it"]
    return []


@check("values stay finite", Scope.EACH)
def finite(subject: Subject, kind: str) -> Finding:
    """No variable becomes infinite or not a number in a run with moderate inputs."""
    steps = subject.long_steps(kind)
    rows = fresh_run(subject, kind, steps)
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        names = entry_names(subject.observed)
        row, column = bad[0]
        return failed(f"{names[column]} is {rows[row, column]} at t = {subject.time(row):.6g} s.")
    return passed(f"{rows.shape[1]} values over {len(rows) - 1} steps of {subject.step:g} s.")


@check("order of reading does not matter", Scope.EACH)
def get_order(subject: Subject, kind: str) -> Finding:
    """Values do not depend on which variables were read before, how often and in which order."""
    steps = min(subject.steps(kind), 20)
    observed, dice = subject.observed, np.random.default_rng(5)
    drawn = _drawn(len(observed), len(observed))
    first = np.cumsum([0, *(item.size for item in observed)])
    reference = fresh_run(subject, kind, steps, "all")
    other = []
    with CheckedInstance(subject, kind, "single") as instance:

        def shuffled() -> None:
            single = {place: instance.get([observed[place]]) for place in (*dice.permutation(drawn), *dice.permutation(drawn))}
            values = instance.observe()
            for place, value in single.items():
                values[first[place] : first[place + 1]] = value
            other.append(values)

        instance.begin()
        shuffled()
        run(instance, 0, steps, after=lambda _: shuffled(), observe="end")
    last = fresh_run(subject, kind, steps, "last", observe="end")
    for rows, how in ((np.array(other), "read one by one in another order"), (last, "read only at the end")):
        require_equal(subject, reference[-len(rows) :], rows, how, len(reference) - len(rows))
    return passed(f"{len(drawn)} variables over {steps} steps: all at once, one by one in other orders, and at the end only: equal bits.")
