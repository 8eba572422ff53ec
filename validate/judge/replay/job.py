"""All simulations of a replay as one job, in this process or in a child process.

job = Job(package=package, variables=variables, plan=plan, start=start, limits=Limits(), ...)
job.run().judged.outputs
"""

from __future__ import annotations

import math
import tempfile
import time as clock
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import MachineError
from models.trajectory import Trajectory
from validate.fmi.archive import unpack
from validate.fmi.description import NOT_RUN, FmuError, Package, read_package, unpacked
from validate.fmi.instance import faults_of
from validate.fmi.loops import adopt, library_path
from validate.fmi.surroundings import changes, listed, surroundings
from validate.judge.replay.everyday import (
    everyday_refusal,
    require_some_method,
)
from validate.judge.replay.everyday import simulate as simulate_everyday
from validate.judge.replay.reference import PARTS, ExchangeModel, integrate
from validate.judge.replay.result import ReplayOutcome, Run
from validate.judge.replay.wiring import Feedback, HeldInputs, Variables, World, WorldInputs
from validate.processes.isolated import (
    Ending,
    IsolatedCalls,
    Limits,
    packed,
    run_isolated,
    unpacked_from,
)

_RECORDED = ("t", "outputs", "accumulated", "knots", "applied")
# Outcomes by the child's ending; other endings are errors of the user, the machine or ours.
_ENDED = {
    Ending.TIME_LIMIT: ReplayOutcome.TIME_LIMIT,
    Ending.MEMORY_LIMIT: ReplayOutcome.MEMORY_LIMIT,
    Ending.SIGNAL: ReplayOutcome.CRASHED,
    Ending.ABORT: ReplayOutcome.ABORTED,
    Ending.NO_RESULT: ReplayOutcome.NO_RESULT,
}


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """The runs of a replay, one per tolerance or step; empty if the FMU cannot.

    refusal: why there is no everyday run; seconds: CPU time.
    """

    reference: tuple[Run, ...]
    everyday: tuple[Run, ...]
    refusal: str | None
    seconds_reference: float
    seconds_everyday: float
    note: str = ""
    coarsest_first: bool = True

    @property
    def judged(self) -> Run:
        """Return the most accurate run: the last reference, else the last everyday run."""
        return (self.reference or self.everyday)[-1]


# Length of quoted output of an FMU [characters].
_QUOTED = 60


def simulate(
    request: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Run all simulations of a job in a child process.

    request: path of the FMU; loops, the compiled library; kept, whether this child is reused and
    keeps the FMU unpacked. arrays: Simulations and feedback, packed (n,) [-]. Returns JSON data of
    the runs, and their arrays. Raises FmuError if the FMU cannot be opened, or misbehaves.
    """
    before = None if request["kept"] else surroundings()
    package = _kept(request["path"]) if request["kept"] else read_package(Path(request["path"]))
    adopt(Path(request["loops"]))
    job, feedback = unpacked_from(arrays)
    done = _simulate(job, package, feedback, before)
    runs = [("reference", run) for run in done.reference] + [
        ("everyday", run) for run in done.everyday
    ]
    value = {
        "runs": [
            {
                "kind": kind,
                "outcome": run.outcome.name,
                "message": run.message,
                "events": run.events,
            }
            for kind, run in runs
        ],
        "refusal": done.refusal,
        "note": done.note,
        "seconds": [done.seconds_reference, done.seconds_everyday],
    }
    return value, {
        f"{number}_{name}": np.array(getattr(run, name))
        for number, (_, run) in enumerate(runs)
        for name in _RECORDED
    }


def _simulate(
    job: Simulations,
    package: Package,
    feedback: Feedback | None,
    before: dict[str, Any] | None = None,
) -> Simulated:
    """Run all simulations here. before: process state to report changes from."""
    inputs = (
        HeldInputs(job.plan, feedback)
        if job.world is None
        else WorldInputs(job.plan, job.world, feedback)
    )
    variables, start, note = job.variables, job.start, ""
    reference: list[Run] = []
    with unpacked(package) as package, faults_of(package.path):
        refusal = everyday_refusal(package, inputs)
        require_some_method(package, refusal)
        began = clock.process_time()
        for rtol in job.tolerances if package.exchange is not None else ():
            with closing(ExchangeModel(package, variables)) as model:
                reference.append(
                    integrate(
                        model,
                        start,
                        inputs,
                        rtol,
                        job.event_budget,
                        parts=job.parts,
                        max_step=job.max_step,
                    )
                )
        middle = clock.process_time()
        everyday = [
            simulate_everyday(package, variables, start, inputs, fineness)
            for fineness in (job.fineness if refusal is None else ())
        ]
        seconds = middle - began, clock.process_time() - middle
        if before is not None and (changed := changes(before, surroundings())):
            note = f"The FMU's code changed the process it runs in: {listed(changed)}."
    return Simulated(
        reference=tuple(reference), everyday=tuple(everyday), refusal=refusal,
        seconds_reference=seconds[0], seconds_everyday=seconds[1], note=note,
    )  # fmt: skip


@cache
def _kept(path: str) -> Package:
    """Return an FMU that stays unpacked for the lifetime of this process."""
    package = read_package(Path(path))
    folder = Path(tempfile.mkdtemp())
    unpack(package, folder, leave_out=NOT_RUN)
    return replace(package, folder=folder)


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulations:
    """Settings of the simulations of an FMU.

    - start: (n,) [unit of each variable], ordered as Variables.start.
    - tolerances: relative, the looser first.
    - fineness: internal steps per plan step, the coarser first.
    - parts, max_step: of `integrate`.
    - world: a perturbed one in the FMU's units.
    """

    variables: Variables
    plan: Trajectory
    start: np.ndarray
    tolerances: tuple[float, ...]
    fineness: tuple[int, ...]
    event_budget: int
    parts: int = PARTS
    max_step: float = math.inf
    world: World | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Job(Simulations):
    """The simulations of one FMU, and where they run.

    - limits: of the child, None: in this process.
    - ours: an FMU built by us.
    - child: shared by many jobs, None: one per job.
    """

    package: Package
    limits: Limits | None
    ours: bool = False
    child: IsolatedCalls | None = None

    def run(self, feedback: Feedback | None = None) -> Simulated:
        """Run all simulations; a crash of the child is an outcome.

        feedback: in the FMU's units. Raises FmuError if the FMU cannot be opened, or misbehaves,
        and MachineError if this machine cannot run it.
        """
        package, jobs = self.package, [self]
        if self.limits is None:
            return _simulate(self, package, feedback)
        if _only_once(package):  # so each run gets its own process
            jobs = [
                replace(self, tolerances=(rtol,), fineness=())
                for rtol in self.tolerances
                if package.exchange is not None
            ]
            jobs += [
                replace(
                    self,
                    tolerances=(),
                    fineness=(fineness,),
                )
                for fineness in self.fineness
                if package.cosimulation is not None
            ]
        return _together([job._in_child(feedback) for job in jobs])

    def _in_child(self, feedback: Feedback | None) -> Simulated:
        package = self.package
        child = None if _only_once(package) else self.child
        # Compiled here, outside the FMU's limits.
        request = {
            "path": str(package.path.resolve()),
            "loops": str(library_path()),
            "kept": child is not None,
        }
        call = child or partial(
            run_isolated, limits=self.limits, what=f"FMU {package.path}", ours=self.ours
        )

        settings = {field.name: getattr(self, field.name) for field in fields(Simulations)}
        arrays = packed(Simulations(**settings), feedback)
        done = call("validate.judge.replay.job:simulate", request, arrays=arrays)
        if done.ending in _ENDED:
            ended: tuple[Run, ...] = (Run(outcome=_ENDED[done.ending], message=done.sentence),)
            reference = ended if self.tolerances and package.exchange is not None else ()
            return Simulated(
                reference=reference,
                everyday=() if reference else ended,
                refusal=None,
                seconds_reference=done.cpu,
                seconds_everyday=0.0,
            )
        if done.ending is Ending.MACHINE:
            raise MachineError(done.sentence)
        if not done.ok:
            raise FmuError(done.sentence)
        strays = (
            ""
            if not done.strays
            else f"The FMU left {done.strays} process{'es' if done.strays > 1 else ''} behind, which we ended."
        )
        printed = (
            ""
            if self.ours or not done.output.strip()
            else f"The FMU prints: {' '.join(done.output.split())[:_QUOTED]!r}."
        )
        return _simulated(
            done.value, done.arrays, " ".join(text for text in (strays, printed) if text)
        )


def _only_once(package: Package) -> bool:
    kinds = (package.exchange, package.cosimulation)
    return any(kind is not None and kind.canBeInstantiatedOnlyOncePerProcess for kind in kinds)


def _together(parts: list[Simulated]) -> Simulated:
    return Simulated(
        reference=tuple(run for part in parts for run in part.reference),
        everyday=tuple(run for part in parts for run in part.everyday),
        refusal=next((part.refusal for part in parts if part.refusal is not None), None),
        seconds_reference=sum(part.seconds_reference for part in parts),
        seconds_everyday=sum(part.seconds_everyday for part in parts),
        note=" ".join(dict.fromkeys(part.note for part in parts if part.note)),
    )


def _simulated(value: Mapping[str, Any], arrays: Mapping[str, np.ndarray], note: str) -> Simulated:
    runs: dict[str, list[Run]] = {"reference": [], "everyday": []}
    for number, item in enumerate(value["runs"]):
        stored = {name: list(arrays[f"{number}_{name}"]) for name in _RECORDED}
        events = [(float(time), int(index), bool(closes)) for time, index, closes in item["events"]]
        run = Run(
            **stored, events=events, outcome=ReplayOutcome[item["outcome"]], message=item["message"]
        )
        runs[item["kind"]].append(run)
    return Simulated(
        reference=tuple(runs["reference"]),
        everyday=tuple(runs["everyday"]),
        refusal=value["refusal"],
        seconds_reference=value["seconds"][0],
        seconds_everyday=value["seconds"][1],
        note=" ".join(text for text in (value["note"], note) if text),
    )
