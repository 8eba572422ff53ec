"""The values that checks set: a search for those that the FMU refuses, each in a fork of its own.

A refused value is one finding, with the variable, the value and the FMU's own words. The result
becomes `Subject.avoided`, so that no other check fails because of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import TypeAlias

import numpy as np

from validate.fmi.instance import Misbehaviour, RefusedCall, TerminationRequested
from validate.fmi.surroundings import listed
from validate.fmu_check.check import Finding, Refusal, Scope, advice, check, failed, in_fork, passed
from validate.fmu_check.motion import run
from validate.fmu_check.subject import (
    MOVED,
    NOTHING,
    Block,
    CheckedInstance,
    FmuVariable,
    Settings,
    Subject,
    in_words,
    one_each,
)

# Most variables that are set one by one.
_ONE_BY_ONE = 2000
# Values that all instances together may compute, some 10 s. In a large FMU, in which an instance
# computes all values, fewer variables are set one by one.
_COMPUTED = 40_000_000
# Least number of variables that are set one by one.
LEAST = 100
# Time for one set of values [s]: ten times that of a run (subject.RUN_SECONDS).
_TRIAL_SECONDS = 20.0
# Time for the search among many variables [s]: a third of a check's time limit. The variables that
# are left then stay at their starts.
_SEARCH_SECONDS = 20.0

# Fields of `Avoided` with names of variables.
_SIDES = ("below", "above", "unset")

# Sets some values in a new instance and makes steps. Raises RefusedCall, Fault.
_Trial: TypeAlias = Callable[[Settings], None]


def movable(item: FmuVariable) -> bool:
    """Return whether checks move a variable: floats, and Boolean inputs.

    Another integer may switch the model to another one.
    """
    is_free = item.variability != "constant" and item.causality != "structuralParameter"
    is_switch = item.type == "Boolean" and item.causality == "input"
    return is_free and not item.clocked and (item.is_float or is_switch)


def moved(block: Block) -> np.ndarray:
    """Return other values than the starts, of floats and Booleans.

    Returns
    -------
    np.ndarray
        (entries,) [unit of each]; the start if no other value is accepted.

    Raises
    ------
    Nothing.
    """
    stays = block.refuses("below") | block.refuses("above")
    value = np.where(
        block.each(lambda item: item.is_float) > 0.0,
        block.near(MOVED),
        np.where(stays, block.starts, 1.0 - block.starts),
    )
    single = block.each(lambda item: item.type == "Float32") > 0.0
    return np.where(single, value.astype(np.float32).astype(float), value)


def drawn(count: int, size: int) -> list[int]:
    """Draw which of `count` variables of an FMU with `size` values are looked at one by one."""
    most = min(_ONE_BY_ONE, max(LEAST, _COMPUTED // max(size, 1)))
    return np.random.default_rng(5).permutation(count)[:most].tolist()


@check("values are accepted", Scope.EACH, clauses=("2.1.7", "2.2.7.2"))
def accepted(subject: Subject, kind: str) -> Finding:
    """Values near the starts and within the declared ranges are accepted, and runs with them go on."""
    search = _Search(subject, kind)
    starts = search.starts()
    search.inputs()
    search.runs()
    wrong, traps = search.findings()
    learnt = {
        "avoided": asdict(search.subject.avoided),
        "reasons": search.reasons,
        "end": search.end,
    }
    if wrong or traps:
        return (failed if wrong else advice)(f"{listed([*wrong, *traps])}.", learnt=learnt)
    inputs = len(search.subject.continuous_inputs)
    sentence = f"{starts} start values and {inputs} inputs were moved, and runs went on."
    return passed(sentence, learnt=learnt)


@dataclass
class _Search:
    """The search of one type of FMI.

    - subject: avoids the values refused so far.
    - refused: by variable and field of `Avoided`, the refusal.
    - wrong, traps: clauses about runs.
    - reasons: of all refusals.
    - end: time [s] at which the FMU stops a run that sets nothing.
    """

    subject: Subject
    kind: str
    refused: dict[str, dict[str, Refusal]] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    traps: list[str] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    end: float | None = None
    until: float = field(default_factory=lambda: time.monotonic() + _SEARCH_SECONDS)

    def starts(self) -> int:
        """Move start values a little; return how many variables were moved."""
        every = [item for item in self.subject.exact if movable(item)]
        names = {every[place].name for place in drawn(len(every), len(self.subject.values))}
        names |= {item.name for item in self.subject.varied[0]}
        for _ in range(2):  # a value that is refused on one side is tried on the other
            block = self._named(names)
            if not self._avoid(self._start, *_moving(block, moved(block))):
                break
        self._set_starts(self._start, self._named(names))
        return len(names)

    def inputs(self) -> None:
        """Move inputs to both ends of the range in which checks move them."""
        for end in (1, 0):
            inputs, values = self.subject.continuous_inputs, self.subject.input_range[end]
            self._avoid(self._input, *_moving(inputs, values))
        self._set_starts(self._input, self.subject.continuous_inputs)

    def runs(self) -> None:
        """Make runs as checks do: of the fresh FMU, and with other parameters and inputs."""
        refusal = self._refusal(self._run, NOTHING)
        if refusal is not None and not self._held_inputs_help(NOTHING, refusal):
            self.wrong.append(f"{refusal}, with nothing set but inputs at their starts")
            self.end = self.subject.ends[self.kind] = refusal.time
        varied = self.subject.varied
        refusal = self._refusal(self._run, varied) if varied[0] else None
        if refusal is not None and not self._held_inputs_help(varied, refusal):
            self.traps.append(f"with all parameters a little off their starts: {refusal}")
            self.subject = self.subject.avoiding(unvaried=True)

    def findings(self) -> tuple[list[str], list[str]]:
        """Return clauses about contradictions of the description, and about its gaps."""
        wrong, traps = list(self.wrong), []
        for name, sides in self.refused.items():
            item = self.subject.by_name[name]
            if "unset" in sides:
                wrong.append(f"{name} cannot be set, not even to its start: {sides['unset']}")
                continue
            for side, refusal in sides.items():
                bound, word = (item.upper, "max") if side == "above" else (item.lower, "min")
                if not refusal.reason:  # it crashed or hung
                    wrong.append(str(refusal))
                elif np.isfinite(bound):
                    wrong.append(f"{refusal}, though its {word} is {bound:g}")
                elif item.is_float and item.start is not None:
                    start = f"its start, {item.start[0]:g}, is accepted"
                    traps.append(f"{refusal}; declare its {word} ({start})")
                else:
                    traps.append(str(refusal))
        return wrong, traps + self.traps

    def _start(self, settings: Settings) -> None:
        """Set values before initialisation, and make a step."""
        with CheckedInstance(self.subject, self.kind).begin(before=settings) as instance:
            self._step(instance)

    def _input(self, settings: Settings) -> None:
        """Set values after initialisation, and make a step."""
        with CheckedInstance(self.subject, self.kind).begin() as instance:
            if self.kind == "ME":
                instance.fmu.enterEventMode()
            instance.set(*settings)
            if self.kind == "ME":
                instance.settle()
            self._step(instance)

    def _step(self, instance: CheckedInstance) -> None:
        instance.live(self.subject.before_end(self.kind, 1))
        instance.observe()

    def _run(self, settings: Settings) -> None:
        """Make the longest run of checks; with settings, the run with other inputs."""
        subject, kind, seed = self.subject, self.kind, int(bool(settings[0]))
        steps = subject.steps(kind) if seed else subject.long_steps(kind)
        with CheckedInstance(subject, kind).begin(before=settings) as instance:
            try:
                run(instance, 0, steps, seed=seed, observe="end")
            except RefusedCall as refusal:
                refusal.setting = f"the run at t = {instance.time:.6g} s"
                refusal.time = instance.time + subject.step * (kind == "CS")
                raise

    def _refusal(self, trial: _Trial, settings: Settings) -> Refusal | None:
        """Return why a trial with these values is refused; None if it is not.

        Other faults of a run are left to other checks. Raises TerminationRequested if a run ends.
        """

        def attempt() -> None:
            try:
                trial(settings)
            except RefusedCall as refusal:
                refusal.setting = refusal.setting or in_words(*settings)
                raise

        is_run = trial == self._run
        try:
            in_fork(attempt, _TRIAL_SECONDS)
        except Refusal as refusal:
            if refusal.reason not in self.reasons:
                self.reasons.append(refusal.reason)
            return refusal
        except (TerminationRequested, Misbehaviour) as fault:
            if not is_run:
                reason = "the end" if isinstance(fault, TerminationRequested) else ""
                return Refusal(f"with {in_words(*settings)} {fault}", reason, np.nan)
            if isinstance(fault, TerminationRequested):
                raise
        return None

    def _named(self, names: set[str]) -> Block:
        """Return variables by their names, with the sides refused so far."""
        items = (*self.subject.exact, *self.subject.varied[0])
        return one_each(item for item in items if item.name in names)

    def _avoid(self, trial: _Trial, block: Block, values: np.ndarray) -> bool:
        """Avoid the refused ones of these values (entries,) [unit of each]: a side or the variable.

        Returns whether any is refused. Raises as `_refusal`.
        """
        names = {side: set(getattr(self.subject.avoided, side)) for side in _SIDES}
        is_any = False
        for item, value, refusal in self._each_refused(trial, block, values):
            is_any = True
            start = 0.0 if item.start is None else item.start
            below, above = bool((value < start).any()), bool((value > start).any())
            for side, is_refused in zip(_SIDES, (below, above, not (below or above)), strict=True):
                if is_refused:
                    names[side].add(item.name)
                    if refusal is not None:
                        self.refused.setdefault(item.name, {}).setdefault(side, refusal)
        self.subject = self.subject.avoiding(**{side: sorted(names[side]) for side in _SIDES})
        return is_any

    def _set_starts(self, trial: _Trial, block: Block) -> None:
        """Set variables that move to neither side to their starts; avoid those that refuse it."""
        stuck = Block(item for item in block if len(item.refused) > 1)
        self._avoid(trial, stuck, np.nan_to_num(stuck.starts))

    def _each_refused(
        self, trial: _Trial, block: Block, values: np.ndarray
    ) -> Iterator[tuple[FmuVariable, np.ndarray, Refusal | None]]:
        """Find variables that refuse their values (entries,) [unit of each], by bisection.

        Yields the variable, its values and the refusal, None if there was no time left to try.
        """
        if not block:
            return
        if time.monotonic() > self.until:
            for item, value in block.split(values):
                yield item, value, None
            return
        refusal = self._refusal(trial, (block, values))
        if refusal is None:
            return
        if len(block) == 1:
            yield block[0], values, refusal
            return
        half = len(block) // 2
        place = block.ends[half]
        yield from self._each_refused(trial, Block(block[:half]), values[:place])
        yield from self._each_refused(trial, Block(block[half:]), values[place:])

    def _held_inputs_help(self, settings: Settings, refusal: Refusal) -> bool:
        """Return whether a refused run goes on with inputs at their starts.

        If so, the inputs are kept there.
        """
        before = self.subject
        if before.avoided.held or not before.continuous_inputs:
            return False
        self.subject = before.avoiding(held=True)
        if self._refusal(self._run, settings) is not None:
            self.subject = before
            return False
        least, most = (in_words(before.continuous_inputs, end) for end in before.input_range)
        self.traps.append(f"with inputs between {least} and {most}: {refusal}")
        return True


def _moving(block: Block, values: np.ndarray) -> Settings:
    """Return the variables whose values (entries,) [unit of each] are not their starts."""
    starts = np.nan_to_num(block.starts)
    pairs = [
        (item, value)
        for (item, value), (_, start) in zip(block.split(values), block.split(starts), strict=True)
        if (value != start).any()
    ]
    found = np.concatenate([np.empty(0), *(value for _, value in pairs)])
    return Block(item for item, _ in pairs), found
