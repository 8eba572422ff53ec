"""Somebody's FMU in perturbed worlds, each in the child process that a replay uses: what ends the child there is a world in which the plan fails.

    with FmuArena.of(wired, limits) as arena:
        arena.trial(world).fails_by            # "crashed", where the FMU did

A world is tried by Co-Simulation where the FMU has it, and checked by Model Exchange, or else by half the smallest step; one with Model Exchange alone by
a looser and a tighter tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np

from validate.execution.isolated import IsolatedCalls
from validate.fmi.description import FmuError
from validate.judge.judgement import WiredFmu
from validate.judge.replay.job import Job
from validate.judge.replay.result import ReplayOutcome
from validate.judge.replay.run import FINENESS as JUDGED
from validate.judge.replay.run import OWN_STEP, foreign_job, in_plan_units
from validate.judge.replay.subject import Outputs
from validate.judge.replay.tracking import TrackingError, design_foreign
from validate.judge.replay.wiring import Feedback
from validate.judge.replay.world import World, WorldInputs
from validate.judge.robustness.trials import FINENESS, REFERENCE, RTOL, Arena, Asked

# In the place of a fineness: Model Exchange at this relative tolerance.
_LOOSELY, _LOOSE = 0, 1e-7
# How near half the smallest step must be: of a method of first order no step comes within a thousandth of the limits.
_NEAR = 1e-2


class FmuArena(Arena):
    """See the module docstring."""

    def __init__(self, wired: WiredFmu, asked: Asked, followed: bool) -> None:
        """Raises FmuError, TrajectoryError."""
        foreign, package, plan = wired.foreign, wired.package, wired.plan
        self._foreign, self._child = foreign, IsolatedCalls(wired.limits, f"FMU {package.path}")
        steps, exchange = package.cosimulation, package.exchange is not None and not wired.own_step
        # Uneven steps are not everybody's, and who is judged by its own step takes no other.
        uneven = steps is not None and not wired.own_step and steps.canHandleVariableCommunicationStepSize
        whole = not uneven and not exchange
        super().__init__(foreign.model, plan, asked, followed, None if whole else _feedback(wired))
        self.nominal = replace(self.nominal, whole=whole)
        self._job = replace(foreign_job(foreign, package, plan, wired.limits, wired.own_step), child=self._child, rolls_back=False)
        factor = max(self._job.fineness) // max(JUDGED)
        steady = JUDGED if foreign.variables.internal_step is None else FINENESS
        self.levels = OWN_STEP[1:] if wired.own_step else tuple(factor * fineness for fineness in steady) if whole or uneven else ()
        finest = OWN_STEP[0] if wired.own_step else 2 * max(self.levels, default=0)
        self.levels += (_LOOSELY,) if exchange else ()
        self._exact = {"tolerances": (RTOL,) if exchange else (), "fineness": () if exchange else (finest,)}
        if not exchange:
            self.by, self.near = f"with {'a quarter of the' if wired.own_step else 'half the smallest'} step", _NEAR

    @classmethod
    @contextmanager
    def of(cls, wired: WiredFmu, limits: Mapping[str, float], *, followed: bool = False) -> Iterator[Arena]:
        """An arena that is closed at the end. limits: what the judge held the plan to, by metric. Raises FmuError, MachineError, TrajectoryError."""
        with closing(cls(wired, Asked.of(wired.foreign.model, limits, wired.plan), followed)) as arena:
            yield arena.settle()

    def _run(self, world: World, fineness: int, feedback: Feedback | None) -> tuple[ReplayOutcome, np.ndarray, np.ndarray, np.ndarray]:
        foreign, inputs, nx = self._foreign, WorldInputs(self.plan, world, feedback), 2 * self.scene.nq
        level = {"tolerances": (_LOOSE,), "fineness": ()} if fineness == _LOOSELY else {"tolerances": (), "fineness": (fineness,)}
        try:
            job = replace(self._moved(world), **(self._exact if fineness == REFERENCE else level))
            simulated = in_plan_units(foreign, job.run(None if feedback is None else feedback.in_units(*foreign.units)))
        except FmuError:  # what it does in this world alone is no mistake of the user's
            return ReplayOutcome.FMU_FAILED, np.empty((0, nx)), np.empty((0, self.scene.nc)), inputs.commands
        self.seconds += simulated.seconds_reference + simulated.seconds_everyday
        run = simulated.judged
        found = Outputs(foreign.model, foreign.variables, run, run.knots)
        rows = inputs.rows[inputs.rows < len(found.q)]
        return run.outcome, np.hstack([found.q, found.v])[rows], found.gap[rows], inputs.commands

    def _moved(self, world: World) -> Job:
        """The job in a world, in the FMU's units; what is as the FMU has it is not set."""
        foreign, nominal = self._foreign, self.nominal
        (scale, offset), (times, plus) = foreign.units
        parameters, start = dict(foreign.variables.parameters), dict(zip(foreign.variables.start, foreign.start.tolist(), strict=True))
        for place in np.flatnonzero(world.parameters != nominal.parameters):
            parameters[foreign.parameters[place]] = float(world.parameters[place])
        states = (world.start[: len(scale)] - offset) / scale
        for place in np.flatnonzero(world.start != nominal.start):
            start[(foreign.variables.q + foreign.variables.v)[place]] = float(states[place])
        noise = times * world.noise + plus * (1.0 - world.gain)
        return replace(
            self._job, start=np.array(list(start.values())), world=replace(world, start=states, noise=noise),
            variables=replace(self._job.variables, parameters=tuple(parameters.items()), start=tuple(start)),
        )  # fmt: skip

    def close(self) -> None:
        """End the child."""
        self._child.close()


def _feedback(wired: WiredFmu) -> Feedback | None:
    """The judge's, where the FMU tells derivatives of its states."""
    foreign = wired.foreign
    try:
        return design_foreign(foreign.model, wired.package, foreign.variables, wired.plan, foreign.units, foreign.start, wired.limits)[0]
    except TrackingError:
        return None
