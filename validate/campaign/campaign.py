"""A campaign: which tasks, which of them are stored, the others run, and everything written about all of them.

    outcome = run_campaign(CampaignSettings(out=Path("runs/all"), quick=True), narrator)
    outcome.exit_code, outcome.records, outcome.report

Tasks are content-addressed: a stored one is used again, unless it crashed, or ran out of a shorter
time limit than it would have now.
"""

from __future__ import annotations

import hashlib
import math
import shutil
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from models.codegen.compiler import find_compiler
from models.scene import Scene
from models.scene.text import scene_text
from models.stability import step_stability
from reports.findings import three_findings
from reports.pages.section import PAGES, REPORT
from reports.paper import SCENE
from reports.records.check_record import CheckRecord, divided
from reports.records.load import CAMPAIGN
from reports.records.record import CampaignRecord, ProvenanceRecord, RunRecord, TimeStepRecord
from reports.rule import fails, failures, findings
from validate.campaign.dask import open_dask
from validate.campaign.engine import LOCAL, ExecutionContext, check_engine, open_local
from validate.campaign.growing_report import GrowingReport
from validate.campaign.results import TABLES, write_tables
from validate.campaign.runs import (
    CampaignSettings,
    PlannedTask,
    scenes_of,
    select,
    with_stored,
    worlds_tasks,
)
from validate.campaign.scheduler import run_tasks
from validate.campaign.stored import (
    campaign_of,
    check_folder,
    found_campaign,
    identity,
    same_campaign,
    with_others,
)
from validate.campaign.warnings import warnings_of
from validate.processes.disk import write_durably
from validate.processes.process import interrupts_wait
from validate.store.provenance import gather
from validate.store.store import Store
from validate.tasks.leg import forget
from validate.tasks.paper import measure
from validate.tasks.plugins import load_plugin
from validate.tasks.task import RunTask, Task, TaskRecord, path_of, task_to_json

TITLE = "Plans through contact, replayed and scored"


class Narrator(Protocol):
    """Prints the progress of a campaign (validate.cli.narrator)."""

    def begins(self, total: int, stored: int) -> None:
        """Before the first task. stored: tasks whose records are used."""

    def notes(self, sentence: str) -> None:
        """Print a fact."""

    def warns(self, sentence: str) -> None:
        """Print a warning."""

    def runs(self, folders: Mapping[str, Path]) -> None:
        """Called several times a second. folders: title of each running task -> its unfinished folder."""

    def finished(self, record: TaskRecord) -> None:
        """A task has ended."""

    def found(self, runs: Sequence[RunRecord]) -> None:
        """All runs of a scene have ended."""

    def ends(self) -> None:
        """After the last task, or after an interruption."""


@dataclass(frozen=True)
class CampaignResult:
    """What came of a campaign.

    records, checks, failures, findings: of what was selected; findings are what the replay found
        that fails nothing (reports.rule). conclusions:
    three sentences on all runs that the folder's campaign holds; report: None where it was not
        written.
    """

    records: tuple[RunRecord, ...]
    checks: tuple[CheckRecord, ...]
    failures: tuple[str, ...]
    findings: tuple[str, ...]
    conclusions: tuple[str, ...]
    left_out: tuple[str, ...]
    report: Path | None

    @property
    def exit_code(self) -> int:
        """0, or 1 where something failed."""
        return 1 if self.failures else 0


def run_campaign(settings: CampaignSettings, narrator: Narrator) -> CampaignResult:
    """Run what is not stored and write campaign.json, results.csv, checks.csv, violation.csv and the report.

    Raises TouchstoneError for what the user can mend; KeyboardInterrupt passes through when
    children are stopped and what finished is written.
    """
    entries, left_out = checked_selection(settings)
    # the compiled time step and the FMU need one: better said now than by every task
    find_compiler()
    store = Store(settings.out)
    store.prepare()
    entries = with_stored(entries, store, settings)
    for name, text in settings.files.items():
        write_durably(settings.out / name, text)
    provenance = gather(settings.command)
    selected, scenes = [entry.task.key for entry in entries], scenes_of(entries)
    named = {identity(task_to_json(entry.task)): entry.task.key for entry in entries}
    before = found_campaign(settings.out)
    # The keys of the folder's campaign from now on, in order.
    keys = (
        with_others(store, before, named)
        if settings.is_part and before is not None
        else tuple(named.values())
    )
    records = {entry.task.key: entry.stored for entry in entries if entry.stored is not None}
    others = {
        key: record
        for key in set(keys).difference(selected)
        if (record := store.read(key)) is not None
    }
    steps = time_steps(scenes.values(), () if before is None else before.time_steps)
    campaign = _campaign(
        settings, entries, left_out, steps, before if others else None, keys, provenance
    )

    def write() -> tuple[RunRecord, ...]:
        """Write the tables and return the runs of the folder."""
        done, checks = divided(
            {**others, **records}[key] for key in keys if key in others or key in records
        )
        write_tables(settings.out, done, checks, campaign.violation)
        return done

    waiting = [entry.task.key for entry in entries if entry.stored is None]
    # campaign.json is written before the first task ends, so that a killed campaign can be shown.
    # If nothing runs, the old file keeps the date and command that made the results.
    if waiting or before is None or not same_campaign(campaign, before):
        write_durably(settings.out / CAMPAIGN, campaign.model_dump_json(indent=1))
    narrator.begins(len(entries), len(records))
    if others:
        narrator.notes(
            f"{len(others)} other runs and checks of the campaign in {settings.out} stay in its tables and report"
        )
    unstable = [
        item.warning for item in campaign.time_steps if item.warning and item.scene in scenes
    ]
    for sentence in (*unstable, *warnings_of(scenes.values())):
        narrator.warns(sentence)
    try:
        to_run = [entry.task for entry in entries if entry.stored is None]
        if settings.fresh and to_run:
            store.discard(waiting)
            forget(map(path_of, to_run), store.legs)
            shutil.rmtree(store.surveys, ignore_errors=True)
        loaded = {entry.task.key: entry.loaded for entry in entries if entry.loaded is not None}
        context = ExecutionContext(store=store, provenance=provenance, loaded=loaded)
        plugin = load_plugin(settings.plugin)
        with (
            closing(GrowingReport(partial(plugin.write_report, settings.out))) as growing,
            closing(_run(to_run, context, settings, narrator)) as finished,
        ):
            for record in finished:
                records[record.key] = record
                narrator.finished(record)
                if _note_scene(record, entries, records, narrator):
                    write()
                    growing.update()
                if settings.stop_early and fails(record):
                    break
        if len(records) == len(entries):
            for record in _tried(entries, records, others, context, settings, narrator):
                records[record.key] = record
    finally:
        with interrupts_wait():
            # What this campaign stored and nobody heard of: it was stopped at that moment.
            for record in filter(None, [store.read(key) for key in selected if key not in records]):
                if record.provenance.started == provenance.started:
                    records[record.key] = record
                    narrator.finished(record)
            narrator.ends()
            told = write()
    report = load_plugin(settings.plugin).write_report(settings.out)
    done, checks = divided(records[key] for key in selected if key in records)
    return CampaignResult(
        records=done,
        checks=checks,
        failures=failures(done, checks, told),
        findings=findings(done),
        conclusions=three_findings(told),
        left_out=left_out,
        report=report,
    )


def checked_selection(settings: CampaignSettings) -> tuple[list[PlannedTask], tuple[str, ...]]:
    """Check engine and folder, and return the result of `select`. Nothing is written.

    Raises TouchstoneError.
    """
    check_engine(settings.engine)
    entries, left_out = select(settings)
    check_folder(settings.out, (*TABLES, REPORT, PAGES, *settings.files))
    if settings.last_failed:
        campaign_of(settings.out)
    return entries, left_out


def _campaign(
    settings: CampaignSettings,
    entries: Sequence[PlannedTask],
    left_out: tuple[str, ...],
    steps: tuple[TimeStepRecord, ...],
    earlier: CampaignRecord | None,
    keys: tuple[str, ...],
    provenance: ProvenanceRecord,
) -> CampaignRecord:
    """What campaign.json says. earlier: the campaign of the folder whose other runs stay, if there are any; keys: of all runs and checks from now on."""
    title, command, quick, violation = settings.title or TITLE, settings.command, settings.quick, ()
    if earlier is not None:
        title, quick, violation = (
            settings.title or earlier.title,
            quick and earlier.quick,
            earlier.violation,
        )
        command = (
            earlier.command
            if {entry.task.key for entry in entries} <= set(earlier.keys)
            else command
        )
        named = {item.scene for item in steps}
        steps = (*(item for item in earlier.time_steps if item.scene not in named), *steps)
    papers = scenes_of(entries).get(SCENE)
    if papers is not None and not violation:
        violation = measure(papers)
    return CampaignRecord(
        title=title,
        command=command,
        quick=quick,
        left_out=left_out if quick == settings.quick else (),
        violation=violation,
        time_steps=steps,
        started=provenance.started,
        keys=keys,
        provenance=provenance,
    )


def time_steps(
    scenes: Iterable[Scene], earlier: Iterable[TimeStepRecord] = ()
) -> tuple[TimeStepRecord, ...]:
    """Whether the time step of each scene is stable while contacts are closed, looked at before anything runs.

    earlier: what an earlier campaign found, used again where the scene is the same. Raises
        MachineError without a compiler.
    """
    known = {(item.scene, item.digest): item for item in earlier}
    found = []
    for scene in scenes:
        digest = hashlib.sha256(scene_text(scene).encode()).hexdigest()
        if (scene.name, digest) in known:
            found.append(known[scene.name, digest])
            continue
        stability = step_stability(scene)
        largest = stability.largest_step if math.isfinite(stability.largest_step) else None
        found.append(
            TimeStepRecord(
                **{
                    **asdict(stability),
                    "largest_step": largest,
                    "digest": digest,
                    "warning": stability.sentence,
                }
            )
        )
    return tuple(found)


def _note_scene(
    record: TaskRecord,
    entries: Sequence[PlannedTask],
    records: Mapping[str, TaskRecord],
    narrator: Narrator,
) -> bool:
    """Print the summary of a scene and return True if the last of its runs has ended."""
    if isinstance(record, RunRecord):
        keys = [
            entry.task.key
            for entry in entries
            if isinstance(entry.task, RunTask) and entry.task.scene_name == record.scene.name
        ]
        if all(key in records for key in keys):
            narrator.found(divided(records[key] for key in keys)[0])
            return True
    return False


def _tried(
    entries: Sequence[PlannedTask],
    records: Mapping[str, TaskRecord],
    others: Mapping[str, TaskRecord],
    context: ExecutionContext,
    settings: CampaignSettings,
    narrator: Narrator,
) -> list[TaskRecord]:
    """Try the plans that `settings.worlds` selects in perturbed worlds; return the amended records."""
    tasks = worlds_tasks(entries, records, others, settings.worlds)
    if not tasks:
        return []
    count = f"{len(tasks)} runs" if len(tasks) > 1 else tasks[0].title
    narrator.notes(f"in perturbed worlds: the plans of {count}")
    with closing(_run(tasks, context, settings, narrator)) as finished:
        return list(finished)


def _run(
    tasks: Sequence[Task],
    context: ExecutionContext,
    settings: CampaignSettings,
    narrator: Narrator,
) -> Generator[TaskRecord, None, None]:
    if not tasks:
        return
    where = settings.engine.partition(":")[2]
    opened = open_local if settings.engine == LOCAL else partial(open_dask, where)
    with opened(settings.jobs, context, len(tasks)) as engine:
        yield from run_tasks(tasks, engine, context, settings.retries, narrator)
