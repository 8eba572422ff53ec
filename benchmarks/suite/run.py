"""Runs the suite: every measurement a child process, all cases of a size in turn, round after round."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measure import Sample, Size, sample
from benchmarks.records import SuiteRecord, SuiteRow
from benchmarks.suite.cases import CASES, FULL_SIZES, OURS, YARDSTICK, Case
from benchmarks.suite.figures import figures
from models.errors import TouchstoneError
from validate.plan.selection import matches
from validate.store.disk import temporary_folder

REPEATS = 5
QUICK_REPEATS = 2
_NO_SIZE = Size(0, 0)
# What takes minutes may take so many limits.
_SLOW_LIMITS = 6
Job = tuple[Case, Size]


class BenchError(TouchstoneError):
    """What was asked for cannot be measured."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """sizes; repeats: rounds; expression: as `-k` of `all`, over stages and peers.

    slow: also what takes minutes; campaign: a folder whose report is

    measured, or None; limit: wall seconds of one measurement; command: as it was typed.
    """

    sizes: tuple[Size, ...] = FULL_SIZES
    repeats: int = REPEATS
    expression: str = ""
    slow: bool = False
    quick: bool = False
    campaign: Path | None = None
    limit: float = 600.0
    command: str = ""


def plan(settings: Settings, cases: Sequence[Case] = CASES) -> tuple[list[Job], list[str]]:
    """What is measured, in order of size, and why the rest is not.

    Raises BenchError if nothing is left, SelectionError.
    """
    chosen = [
        case
        for case in cases
        if not settings.expression or matches(settings.expression, case.names)
    ]
    left_out: list[str] = []
    able: list[Case] = []
    slow: dict[str, bool] = {}
    for case in chosen:
        reason = case.missing()
        if case.slow and not settings.slow:
            slow[case.stage] = True
            continue
        if case.of_campaign and settings.campaign is None:
            reason = f"{case.stage} is not measured: there is no stored campaign in the folder; `python -m validate all` makes one."
        if reason:
            left_out.append(reason)
        else:
            able.append(case)
    if slow:
        left_out.append(
            f"{', '.join(slow)}: not measured, because it takes minutes; --slow measures it too."
        )
    yardstick = [case for case in cases if case.stage == YARDSTICK]
    if not [case for case in able if case.stage != YARDSTICK]:
        why = (
            " ".join(left_out)
            or f"stages and peers are {', '.join(dict.fromkeys(name for case in cases for name in case.names))}."
        )
        raise BenchError(f"nothing is selected by {settings.expression!r}: {why}")
    able = [*yardstick, *(case for case in able if case.stage != YARDSTICK)]
    jobs = [
        (case, size)
        for size in dict.fromkeys(settings.sizes)
        for case in able
        if case.sized and case.fits(size)
    ]
    for case in able:
        sizes = [size for size in settings.sizes if case.fits(size)]
        if case.sized and len(sizes) < len(settings.sizes):
            left_out.append(
                f"{case.stage} by {case.by} is measured at {len(sizes)} of {len(settings.sizes)} sizes: the others are not for it."
            )
    return [*jobs, *((case, _NO_SIZE) for case in able if not case.sized)], left_out


def run_suite(
    settings: Settings,
    narrate: Callable[[str], None] = lambda sentence: None,
    cases: Sequence[Case] = CASES,
) -> SuiteRecord:
    """Measure, and work out the figures. Raises BenchError, SelectionError, MachineError."""
    from validate.store.provenance import gather

    jobs, left_out = plan(settings, cases)
    before = _load()
    with temporary_folder("touchstone-bench-") as folder:
        if settings.campaign is not None:
            from benchmarks.suite.stages import copy_records

            copy_records(settings.campaign, folder)
        samples = _measured(jobs, settings, folder, narrate)
    after = _load()
    rows = tuple(_row(case, size, found) for (case, size), found in samples.items())
    return SuiteRecord(
        kind="suite",
        rows=rows,
        figures=figures(rows),
        repeats=settings.repeats,
        quick=settings.quick,
        load=None if before is None or after is None else (before, after),
        left_out=tuple(left_out),
        provenance=gather(settings.command),
    )


def _measured(
    jobs: Sequence[Job], settings: Settings, folder: Path, narrate: Callable[[str], None]
) -> dict[Job, list[Sample]]:
    samples: dict[Job, list[Sample]] = {job: [] for job in jobs}
    for size in dict.fromkeys(size for _, size in jobs):
        turn = [job for job in jobs if job[1] == size]
        for number in range(1, settings.repeats + 1):
            narrate(
                f"{size if size.n else 'what knows no size'}: round {number} of {settings.repeats}"
            )
            for job in turn:
                found = samples[job]
                if (found and found[-1].failed) or (job[0].slow and found):
                    continue
                found.append(
                    _sample(*job, settings.limit * (_SLOW_LIMITS if job[0].slow else 1), folder)
                )
                if found[-1].failed:
                    narrate(found[-1].failed)
    return samples


def _sample(case: Case, size: Size, limit: float, folder: Path) -> Sample:
    what = f"{case.stage} by {case.by}" + (f" at {size}" if size.n else "")
    return sample(case.function, size, folder, seconds=limit, what=what, once=case.once)


def _row(case: Case, size: Size, samples: Sequence[Sample]) -> SuiteRow:
    good = [sample for sample in samples if not sample.failed]
    failed = next((sample.failed for sample in samples if sample.failed), "")
    last = good[-1] if good else Sample(cpu_s=None)
    return SuiteRow(
        stage=case.stage,
        title=case.title,
        by=case.by,
        n=size.n,
        steps=size.steps,
        cpu_s=() if failed else tuple(sample.cpu_s for sample in good if sample.cpu_s is not None),
        memory_mib=()
        if failed
        else tuple(sample.memory_mib for sample in good if sample.memory_mib is not None),
        clock=case.clock,
        outcome=last.outcome,
        iterations=last.iterations,
        value=last.value,
        failed=failed,
    )


def failures(record: SuiteRecord) -> list[str]:
    """Why stages of ours gave no answer; a peer that fails is told in its row."""
    return [row.failed for row in record.rows if row.failed and row.by == OURS]


def _load() -> float | None:
    try:
        return os.getloadavg()[0]
    except (OSError, AttributeError):
        return None
