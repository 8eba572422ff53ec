"""Several starts of one scene, numbered, so that some of them can be run here and the others elsewhere; the cheapest plan is kept.

| number | start |
|---|---|
| 0 | the plan given, or the paper's first guess |
| 1 | the modes of a softplus chain, eps = 1e-3, 1e-5, 1e-7 |
| 2 | the modes of a softplus shooting solution, same eps |
| 3, 4 | both in the mirror of the scene, if it has one |
| others | seeded random inputs, in turn as start of a homotopy and, steered to the goal, as source of modes |

The homotopy forgets where it began, modes do not: hence both.

Where the end is free, and the best of these plans touches nothing although the last state has a cost, throws are tried (`throws`).
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, process_time
from typing import TYPE_CHECKING

import numpy as np

from formulations.solution import Attempt
from formulations.transcription.workbench import Account
from formulations.windows.finder import Finder, Search
from formulations.windows.moves import windows_of
from formulations.windows.starts import descended_plan, mirrored, random_plan
from formulations.windows.structures import Structures
from formulations.windows.throws import Throws
from models.codegen.kernel import Kernel
from models.scene import Scene
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.methods.mpcc import MpccOptions

_CHAIN = tuple(float(-np.log(eps)) for eps in (1e-3, 1e-5, 1e-7))  # b L = |ln eps|


@dataclass(frozen=True, kw_only=True)
class _Start:
    words: str
    plan: Trajectory | None
    for_modes: bool  # whether the plan's own modes are tried first


class MultiStart:
    """The starts of one scene."""

    def __init__(
        self,
        scene: Scene,
        kernel: Kernel,
        finder: Finder,
        options: MpccOptions,
        structures: Structures | None = None,
    ) -> None:
        self._scene, self._kernel, self._finder, self._options = scene, kernel, finder, options
        self._structures = structures or Structures(scene, kernel)
        self._throws = Throws(scene, kernel, finder, options, self._structures)

    def run(self, account: Account, numbers: range, warm_start: Trajectory | None) -> tuple[Search, tuple[Attempt, ...]]:
        """The best of the starts of these numbers, and what became of each. Starts for which there is no time are not among them.

        A start may do half of the work that is left, the last one all of it: better some starts that come to their end than none.
        """
        best: Search | None = None
        attempts: list[Attempt] = []
        most = account.most_work
        for place, number in enumerate(numbers):
            account.most_work = account.work + (most - account.work) / min(2, len(numbers) - place)
            if best is not None and account.is_over:
                break
            began = process_time()
            start = self._start(account, number, warm_start)
            found = self._finder.find(account, start.plan if start.for_modes else None, start.plan)
            attempts.append(self._attempt(number, start, found, process_time() - began))
            if best is None or _cost(found) < _cost(best):
                best = found
        if best is None:
            raise ValueError("a range of starts is never empty: the options see to that.")
        began = process_time()
        thrown = self._throws.instead_of(best, account, (self._options.seed, numbers[0]))
        if thrown is not best:
            place = min(range(len(attempts)), key=lambda place: (attempts[place].cost is None, attempts[place].cost or 0.0))
            start = _Start(words=f"{attempts[place].start}, then throws", plan=None, for_modes=False)
            attempts[place] = self._attempt(attempts[place].number, start, thrown, attempts[place].seconds + process_time() - began)
        return thrown, tuple(attempts)

    def _start(self, account: Account, number: int, warm_start: Trajectory | None) -> _Start:
        if number == 0:
            words = "the paper's first guess" if warm_start is None else "the plan given"
            return _Start(words=words, plan=warm_start, for_modes=warm_start is not None)
        plan, words = self._special(account, number)
        if plan is not None:
            return _Start(words=words, plan=plan, for_modes=True)
        plan = random_plan(self._scene, self._kernel, (self._options.seed, number))
        for_modes = number % 2 == 0 and plan is not None
        return _Start(words="random inputs, steered to the goal" if for_modes else "random inputs", plan=plan, for_modes=for_modes)

    def _special(self, account: Account, number: int) -> tuple[Trajectory | None, str]:
        source = {1: self._chain, 2: self._descended, 3: self._chain, 4: self._descended}.get(number)
        if source is None:
            return None, ""
        plan, words = source(account)
        if number <= 2 or plan is None:
            return plan, words
        return mirrored(self._scene, self._kernel, plan), f"{words}, mirrored"

    def _chain(self, account: Account) -> tuple[Trajectory | None, str]:
        stages: list[Trajectory] = []
        begin = perf_counter()
        homotopy = self._structures.homotopy(self._options.goal_tolerance, _CHAIN)
        account.build += perf_counter() - begin
        ipopt = {"tol": self._options.homotopy_tolerance, "max_iter": self._options.max_iterations}
        homotopy.run(account, ipopt, None, stages.append)
        return (stages[-1] if stages else None), "softplus chain"

    def _descended(self, _account: Account) -> tuple[Trajectory | None, str]:
        return descended_plan(self._scene, self._kernel), "softplus gradient descent"

    def _attempt(self, number: int, start: _Start, found: Search, seconds: float) -> Attempt:
        if found.answer is None:
            return Attempt(number=number, start=start.words, outcome=found.outcome, seconds=seconds)
        return Attempt(
            number=number,
            start=start.words,
            outcome=found.outcome,
            cost=float(found.answer.cost),
            windows=named_windows(self._scene, found.answer.closed),
            seconds=seconds,
        )


def named_windows(scene: Scene, closed: np.ndarray) -> tuple[tuple[str, int, int], ...]:
    """(contact, first step, last step) of each time a contact is closed; closed (steps, nc)."""
    names = [contact.name for contact in scene.contacts]
    return tuple((name, first, stop - 1) for name, row in zip(names, windows_of(closed), strict=True) for first, stop in row)


def _cost(search: Search) -> float:
    return float("inf") if search.answer is None else search.answer.cost
