"""The values that checks set: which of them the FMU refuses, found once, each in a fork of its own.

A value that is refused is one finding, with the FMU's own words. What is learnt goes into
`Subject.avoided`, so that no other check fails by it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from validate.fmi.instance import Misbehaviour, RefusedCall, TerminationRequested
from validate.fmi.surroundings import listed
from validate.fmu_check.check import Finding, Refusal, Scope, advice, check, failed, in_fork, passed
from validate.fmu_check.motion import run
from validate.fmu_check.subject import (
    NOTHING,
    Block,
    CheckedInstance,
    FmuVariable,
    Settings,
    Subject,
    in_words,
    one_each,
)

# How far a start value is moved, as a share of its size.
_MOVED = 0.01
# Variables are set one by one in a small FMU; in a large one, where each instance computes all its
# values, so many as compute this many in all, but for the least.
_ONE_BY_ONE = 2000
_COMPUTED = 40_000_000
LEAST = 100
# Seconds for one set of values: ten times what a run may take (subject.RUN_SECONDS).
_TRIAL_SECONDS = 20.0
# Seconds for the search among many variables: a third of a check's time limit. After that the
# others stay at their starts.
_SEARCH_SECONDS = 20.0

# Set some values in a new instance, and go on. Raises RefusedCall, Fault.
_Trial: TypeAlias = Callable[[Settings], None]


def movable(item: FmuVariable) -> bool:
    """Whether another value may be given to it.

    Another whole number may switch the model to something else.
    """
    changes = (
        item.variability != "constant"
        and item.causality != "structuralParameter"
        and not item.clocked
    )
    return changes and (item.is_float or (item.type == "Boolean" and item.causality == "input"))


def moved(block: Block) -> np.ndarray:
    """Other values than the starts, of floats and Booleans: the start itself where no other is accepted.

    Returns
    -------
    (entries,) [unit of each]. Raises nothing.
    """
    stays = block.refuses("below") | block.refuses("above")
    value = np.where(
        block.each(lambda item: item.is_float) > 0.0,
        block.near(_MOVED),
        np.where(stays, block.starts, 1.0 - block.starts),
    )
    single = block.each(lambda item: item.type == "Float32") > 0.0
    return np.where(single, value.astype(np.float32).astype(float), value)  # what it can hold


def drawn(count: int, size: int) -> list[int]:
    """Places of those of `count` that are looked at one by one in an FMU of this size: all of a small one, ever fewer of larger ones."""
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
        "avoided": search.subject.avoided.lists(),
        "reasons": search.reasons,
        "end": search.end,
    }
    if not wrong and not traps:
        inputs = len(search.subject.continuous_inputs)
        return passed(
            f"{starts} start values and {inputs} inputs were moved, and runs went on.",
            learnt=learnt,
        )
    return (failed if wrong else advice)(f"{listed([*wrong, *traps])}.", learnt=learnt)


@dataclass
class _Search:
    """The search of one FMI type.

    subject: the FMU, avoiding what was refused until now; refused: by variable and side ("below",
        "above", "start") why; wrong, traps: findings about runs, each a clause; reasons: of all
        refusals; end: when the FMU stops a run that sets nothing [s].
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
        """Move start values by a little; how many variables were moved."""
        every = [item for item in self.subject.exact if movable(item)]
        places = drawn(len(every), len(self.subject.values))
        names = {every[place].name for place in places}
        names |= {item.name for item in self.subject.varied[0]}
        for _ in range(2):  # what is refused on one side is tried on the other
            block = self._named(names)
            if not self._narrow(self._start, block, moved(block)):
                break
        self._set_starts(self._start, self._named(names))
        return len(names)

    def inputs(self) -> None:
        """Move inputs to both ends of the range in which checks move them."""
        for end in (1, 0):
            self._narrow(self._input, self.subject.continuous_inputs, self.subject.input_range[end])
        self._set_starts(self._input, self.subject.continuous_inputs)

    def runs(self) -> None:
        """Runs as checks make them: of the fresh FMU, and with other parameters and inputs."""
        refusal = self._refusal(self._run, NOTHING)
        if refusal is not None and not self._goes_on_with_held_inputs(NOTHING, refusal):
            self.wrong.append(f"{refusal}, with nothing set but inputs at their starts")
            self.end = self.subject.ends[self.kind] = refusal.time
        varied = self.subject.varied
        refusal = self._refusal(self._run, varied) if varied[0] else None
        if refusal is not None and not self._goes_on_with_held_inputs(varied, refusal):
            self.traps.append(f"with all parameters a little off their starts: {refusal}")
            self._avoid(unvaried=True)

    def findings(self) -> tuple[list[str], list[str]]:
        """What contradicts the description, and what it does not tell, clauses without full stop."""
        wrong, traps = list(self.wrong), []
        for name, sides in self.refused.items():
            item = self.subject.by_name[name]
            if "start" in sides:
                wrong.append(f"{name} cannot be set, not even to its start: {sides['start']}")
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

    # What is tried, each in a new instance

    def _start(self, settings: Settings) -> None:
        """Set before initialisation, and make a step."""
        with CheckedInstance(self.subject, self.kind).begin(before=settings) as instance:
            instance.live(self.subject.before_end(self.kind, 1))
            instance.observe()

    def _input(self, settings: Settings) -> None:
        """Set after initialisation, and make a step."""
        with CheckedInstance(self.subject, self.kind).begin() as instance:
            if self.kind == "ME":
                instance.fmu.enterEventMode()
            instance.set(*settings)
            if self.kind == "ME":
                instance.settle()
            instance.live(self.subject.before_end(self.kind, 1))
            instance.observe()

    def _run(self, settings: Settings) -> None:
        """The longest run of checks; with settings that of other inputs."""
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
        """Why these values cannot be had.

        None if they can, or if a run goes wrong otherwise, which other checks are about. Raises
        TerminationRequested where a run ends.
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
        except TerminationRequested as fault:
            if is_run:
                raise
            return Refusal(f"with {in_words(*settings)} {fault}", "the end")
        except Misbehaviour as fault:
            return None if is_run else Refusal(f"with {in_words(*settings)} {fault}")
        return None

    # What comes of it

    def _avoid(self, **changes: Any) -> None:
        self.subject = replace(self.subject, avoided=replace(self.subject.avoided, **changes))

    def _named(self, names: set[str]) -> Block:
        """Variables by their names, with the sides that are refused by now."""
        items = (*self.subject.exact, *self.subject.varied[0])
        return one_each(item for item in items if item.name in names)

    def _narrow(self, trial: _Trial, block: Block, values: np.ndarray) -> bool:
        """Find and avoid what is refused of these values (entries,) [unit of each]; whether anything is."""
        sides: dict[str, set[str]] = {"below": set(), "above": set()}
        for item, value, refusal in self._each_refused(trial, *_moving(block, values)):
            assert item.start is not None or item.causality == "input"
            start = 0.0 if item.start is None else item.start
            for side, goes in (("below", value < start), ("above", value > start)):
                if goes.any():
                    sides[side].add(item.name)
                    if refusal is not None:
                        self.refused.setdefault(item.name, {}).setdefault(side, refusal)
        avoided = self.subject.avoided
        self._avoid(below=avoided.below | sides["below"], above=avoided.above | sides["above"])
        return any(sides.values())

    def _set_starts(self, trial: _Trial, block: Block) -> None:
        """Set those that go to neither side to their starts: what refuses that is never set."""
        stuck = Block(item for item in block if len(item.refused) > 1)
        unset = set(self.subject.avoided.unset)
        for item, _, refusal in self._each_refused(trial, stuck, np.nan_to_num(stuck.starts)):
            unset.add(item.name)
            if refusal is not None:
                self.refused.setdefault(item.name, {})["start"] = refusal
        self._avoid(unset=frozenset(unset))

    def _each_refused(
        self, trial: _Trial, block: Block, values: np.ndarray
    ) -> Iterator[tuple[FmuVariable, np.ndarray, Refusal | None]]:
        """Variables that cannot be set to their values (entries,) [unit of each] by themselves, each with its values and why: halves of what is refused.

        Without a reason those that were not tried any more.
        """
        if not block:
            return
        if time.monotonic() > self.until:
            for item, (begin, end) in zip(block, pairwise(block.ends), strict=True):
                yield item, values[begin:end], None
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

    def _goes_on_with_held_inputs(self, settings: Settings, refusal: Refusal) -> bool:
        """Whether a run that was refused goes on with inputs at their starts, which is then kept."""
        before = self.subject
        if before.avoided.held or not before.continuous_inputs:
            return False
        self._avoid(held=True)
        if self._refusal(self._run, settings) is not None:
            self.subject = before
            return False
        lower, upper = before.input_range
        least, most = (in_words(before.continuous_inputs, end) for end in (lower, upper))
        self.traps.append(f"with inputs between {least} and {most}: {refusal}")
        return True


def _moving(block: Block, values: np.ndarray) -> Settings:
    """Those variables whose values (entries,) [unit of each] are not their starts."""
    moves = values != np.nan_to_num(block.starts)
    chosen = [
        (item, values[begin:end])
        for item, (begin, end) in zip(block, pairwise(block.ends), strict=True)
        if moves[begin:end].any()
    ]
    return Block(item for item, _ in chosen), np.concatenate(
        [np.empty(0), *(value for _, value in chosen)]
    )
