"""A campaign: which cells, which of them are stored, the others run, and everything written that is told of them.

    outcome = run_campaign(CampaignSettings(out=Path("runs/all"), quick=True), narrator)
    outcome.exit_code, outcome.records, outcome.report

Cells are content-addressed: a stored one is used again, unless it crashed, or ran out of a shorter time limit than it would have now.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from validate.execution.engine import LOCAL, Engine, ExecutionContext, Running, check_engine, new_token, open_local
from validate.execution.process import interrupts_wait
from validate.execution.worker import Job
from validate.plan.runs import CampaignError, CampaignSettings, PlannedCheck, PlannedRun, select, with_stored
from validate.store.disk import write_durably
from validate.store.results import write_examinations, write_results, write_sweeps
from validate.store.store import Store
from validate.store.stored import CAMPAIGN, campaign_text, earlier_schema, of_content, only_last_failed, stored_campaign
from validate.tasks.leg import PlannedLeg, forget, must_wait
from validate.tasks.plugins import load_tools
from validate.tasks.run import RunTask

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import CampaignRecord, ProvenanceRecord, RunRecord, TimeStepRecord, ViolationPoint
    from validate.execution.worker import Job

__all__ = ["CampaignError", "CampaignResult", "CampaignSettings", "Narrator", "run_campaign", "select", "stored_campaign", "with_stored"]

TITLE = "Plans through contact, replayed and scored"
# Pause between two looks at what is not a cell's end [s]; a cell that ends is seen at once.
_LOOK = 0.2
# How soon it is asked why no cell has begun [s].
_SILENCE = 5.0
RESULTS, EXAMINATIONS, VIOLATION = "results.csv", "examinations.csv", "violation.csv"


@dataclass(frozen=True)
class CampaignResult:
    """What came of a campaign. findings: what the replay found that fails nothing (reports.rule); report: None where it was not written."""

    records: tuple[RunRecord, ...]
    examinations: tuple[ExaminationRecord, ...]
    failures: tuple[str, ...]
    findings: tuple[str, ...]
    left_out: tuple[str, ...]
    report: Path | None

    @property
    def exit_code(self) -> int:
        return 1 if self.failures else 0


class Narrator(Protocol):
    """Who is told how it goes (validate.cli.narrator)."""

    def begins(self, total: int, stored: int, anew: int) -> None: ...
    def warns(self, sentence: str) -> None: ...
    def runs(self, workers: Sequence[Running]) -> None: ...
    def finished(self, record: RunRecord | ExaminationRecord) -> None: ...
    def ends(self) -> None: ...


def run_campaign(settings: CampaignSettings, narrator: Narrator) -> CampaignResult:
    """Run what is not stored and write campaign.json, results.csv, examinations.csv, violation.csv, starts.csv, front.csv and the report.

    Raises TouchstoneError for what the user can mend; KeyboardInterrupt passes through when children are stopped and what finished is written.
    """
    from models.codegen.compiler import find_compiler
    from reports.collected import collected
    from reports.records.check_record import divided
    from reports.rule import fails, failures, findings
    from validate.plan.warnings import doubts
    from validate.store.provenance import gather
    from validate.tasks.paper import write_violation

    check_engine(settings.engine)
    entries, left_out = select(settings)
    find_compiler()  # the compiled time step and the FMU need one: better said now than by every cell
    store = Store(settings.out)
    store.prepare()
    entries = with_stored(entries, store, settings)
    if settings.last_failed:
        entries = only_last_failed(entries, store)
    for name, text in settings.files.items():
        write_durably(settings.out / name, text)
    provenance = gather(settings.command)
    violation = _violation(entries)
    steps = _time_steps(entries, settings.out)
    records = {entry.cell.key: entry.stored for entry in entries if entry.stored is not None}

    def campaign() -> CampaignRecord:
        from reports.records.record import CampaignRecord

        return CampaignRecord(
            title=settings.title or TITLE,
            command=settings.command,
            started=provenance.started,
            quick=settings.quick,
            left_out=left_out,
            keys=tuple(entry.cell.key for entry in entries),
            violation=violation,
            time_steps=steps,
            provenance=provenance,
        )

    def write() -> tuple[tuple[RunRecord, ...], tuple[ExaminationRecord, ...]]:
        done, examinations = divided(records[entry.cell.key] for entry in entries if entry.cell.key in records)
        text = campaign().model_dump_json(indent=1)
        if ran or not before or of_content(text) != before:  # else it says as before when and how these results were made
            write_durably(settings.out / CAMPAIGN, text)
        told = collected(done)
        write_results(settings.out / RESULTS, told)
        write_examinations(settings.out / EXAMINATIONS, examinations)
        write_violation(settings.out / VIOLATION, violation)
        write_sweeps(settings.out, told)
        return told, examinations

    before, ran, earlier = campaign_text(settings.out), len(records) < len(entries), earlier_schema(settings.out)
    waiting = [entry.cell.key for entry in entries if entry.stored is None]
    anew = store.due(waiting) if settings.fresh or settings.last_failed else [key for key in waiting if store.is_due(key)]
    if ran:  # before the first cell ends: what is stored can be told of while the others run, and if they never end
        write_durably(settings.out / CAMPAIGN, campaign().model_dump_json(indent=1))
    narrator.begins(len(entries), len(records), len(anew))
    for sentence in (
        *filter(None, [earlier]),
        *(item.warning for item in steps if item.warning),
        *doubts(entry.scene for entry in entries if isinstance(entry, PlannedRun)),
    ):
        narrator.warns(sentence)
    try:
        with closing(_run([entry for entry in entries if entry.stored is None], store, provenance, settings, narrator)) as finished:
            for record in finished:
                records[record.key] = record
                narrator.finished(record)
                if settings.stop_early and fails(record):
                    store.spare(key for key in anew if key not in records)
                    break
    finally:
        with interrupts_wait():
            for record in _untold([entry.cell.key for entry in entries if entry.cell.key not in records], store, provenance):
                records[record.key] = record
                narrator.finished(record)
            narrator.ends()
            done, examinations = write()
    report = load_tools(settings.tools).write_report(settings.out)
    return CampaignResult(
        records=done,
        examinations=examinations,
        failures=failures(done, examinations),
        findings=findings(done),
        left_out=left_out,
        report=report,
    )


def _untold(keys: Sequence[str], store: Store, provenance: ProvenanceRecord) -> Iterator[RunRecord | ExaminationRecord]:
    """What this campaign stored and nobody was told of: it was stopped at that moment."""
    for record in filter(None, map(store.read, keys)):
        if record.provenance.started == provenance.started:
            yield record


def _violation(entries: Sequence[PlannedRun | PlannedCheck]) -> tuple[ViolationPoint, ...]:
    """What relaxations do to contact physics, on the first scene that has contacts; nothing where no scene is planned for."""
    from validate.tasks.paper import measure

    scenes = [entry.scene for entry in entries if isinstance(entry, PlannedRun)]
    return tuple(measure(next((scene for scene in scenes if scene.nc), scenes[0]))) if scenes else ()


def _time_steps(entries: Sequence[PlannedRun | PlannedCheck], out: Path) -> tuple[TimeStepRecord, ...]:
    """Whether the step of each scene is stable in contact; what an earlier campaign of this folder said is used again."""
    from validate.plan.warnings import time_steps

    scenes = {entry.scene.name: entry.scene for entry in entries if isinstance(entry, PlannedRun)}
    return time_steps(scenes.values(), out / CAMPAIGN)


def _run(
    entries: Sequence[PlannedRun | PlannedCheck],
    store: Store,
    provenance: ProvenanceRecord,
    settings: CampaignSettings,
    narrator: Narrator,
) -> Generator[RunRecord | ExaminationRecord, None, None]:
    if not entries:
        return
    if settings.fresh:
        forget((_path(entry.cell) for entry in entries), store.legs)
    by_key = {entry.cell.key: entry for entry in entries}
    crashes: Counter[str] = Counter()

    def again(record: RunRecord | ExaminationRecord) -> bool:
        if record.outcome != "crashed" or crashes[record.key] >= settings.retries:
            return False
        crashes[record.key] += 1
        narrator.warns(f"{by_key[record.key].cell.title} crashed and will be tried again: {record.message}")
        return True

    def waits(cell: Job, running: Sequence[Job]) -> bool:
        return must_wait(_path(cell), map(_path, running), store.legs, cell.time_limit)

    site = ExecutionContext(store=store, provenance=provenance, lost=lambda cell: by_key[cell.key].lost(provenance), token=new_token())
    with _open_engine(settings, site, len(entries)) as engine:
        yield from run_cells([entry.cell for entry in entries], engine, site, waits, again, narrator)


def _open_engine(settings: CampaignSettings, context: ExecutionContext, cells: int) -> AbstractContextManager[Engine]:
    if settings.engine == LOCAL:
        return open_local(settings.jobs, context, cells)
    from validate.execution.dask import open_dask  # an extra

    return open_dask(settings.engine.partition(":")[2], settings.jobs, context, cells)


def run_cells(
    cells: Sequence[Job],
    engine: Engine,
    site: ExecutionContext,
    waits: Callable[[Job, Sequence[Job]], bool],
    again: Callable[[RunRecord | ExaminationRecord], bool],
    narrator: Narrator,
) -> Generator[RunRecord | ExaminationRecord, None, None]:
    """Run all cells and yield the record of each when it has finished. waits: whether a cell is to be left for later while others run; again:
    whether one with this record is to be run once more. Raises MachineError."""
    waiting = deque(cells)
    running: dict[Future[RunRecord | ExaminationRecord | None], Job] = {}
    silent_since: float | None = time.monotonic()  # None once a cell has begun, or its silence was told of
    while waiting or running:
        for cell in _startable(waiting, list(running.values()), engine.jobs, waits):
            running[engine.submit(cell)] = cell
        begun = _begun(running.values(), site)
        narrator.runs(begun)
        if begun:
            silent_since = None
        elif silent_since is not None and time.monotonic() - silent_since > _SILENCE:
            silent_since = None
            if why := engine.why_idle(len(running)):
                narrator.warns(why)
        for future in wait(running, timeout=_LOOK, return_when=FIRST_COMPLETED).done:
            cell = running[future]
            record = engine.result(cell, future)
            del running[future]
            if record is None:
                running[engine.submit(cell)] = cell
            elif again(record):
                waiting.appendleft(cell)
            else:
                yield record


def _startable(waiting: deque[Job], running: list[Job], jobs: int | None, waits: Callable[[Job, Sequence[Job]], bool]) -> Iterator[Job]:
    """The cells that may run beside those that do, taken out of what waits. jobs: at most so many at a time."""
    for cell in tuple(waiting):
        if jobs is not None and len(running) >= jobs:
            return
        if not running or not waits(cell, running):
            waiting.remove(cell)
            running.append(cell)
            yield cell


def _begun(cells: Iterable[Job], site: ExecutionContext) -> list[Running]:
    """Those of the cells that have an unfinished folder, wherever they run."""
    folders = {path.name.split("-")[1]: path for path in site.unfinished()}
    return [Running(cell=cell, folder=folders[cell.key[:12]]) for cell in cells if cell.key[:12] in folders]


def _path(job: Job) -> tuple[PlannedLeg, ...]:
    """The legs of a run; an examination has none."""
    return job.legs if isinstance(job, RunTask) else ()
