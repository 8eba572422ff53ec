"""Run a campaign: select tasks, run those that are not stored, write the tables and the report.

    outcome = run_campaign(CampaignSettings(out=Path("runs/all"), quick=True), narrator)
    outcome.exit_code, outcome.records, outcome.report

Tasks are content-addressed. A stored record is used again, unless the task crashed or exceeded a
time limit below the current one.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from models.codegen.compiler import find_compiler
from models.results.check import CheckRecord, divided
from models.results.run import CampaignRecord, RunRecord, TimeStepRecord
from models.results.stored import to_json
from models.scene import Scene
from models.scene.text import scene_text
from models.stability import step_stability
from reports.findings import three_findings
from reports.load import CAMPAIGN
from reports.pages.section import PAGES, REPORT
from reports.paper import SCENE
from reports.rule import fails, failures, findings
from validate.campaign.engine import ExecutionContext, check_engine, open_engine
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
    CampaignError,
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
from validate.tasks.plugins import load_plugin, no_survey
from validate.tasks.task import RunTask, Task, TaskRecord, path_of, task_to_json

TITLE = "Plans through contact, replayed and scored"


class Narrator(Protocol):
    """Prints the progress of a campaign (validate.cli.narrator)."""

    def begins(self, total: int, stored: int) -> None:
        """Print the start, before the first task.

        stored: number of tasks whose records are used.
        """

    def notes(self, sentence: str) -> None:
        """Print a fact."""

    def warns(self, sentence: str) -> None:
        """Print a warning."""

    def runs(self, folders: Mapping[str, Path]) -> None:
        """Print the running tasks; called several times a second.

        folders: title of each running task -> its unfinished folder.
        """

    def finished(self, record: TaskRecord) -> None:
        """Print the record of a task that has ended."""

    def found(self, runs: Sequence[RunRecord]) -> None:
        """Print all runs of a scene after the last has ended."""

    def ends(self) -> None:
        """End the output, after the last task or an interruption."""


@dataclass(frozen=True)
class CampaignResult:
    """The outcome of a campaign.

    - records, checks, failures: of the selected tasks
    - findings: facts from the replays of these tasks that are no failures (reports.rule)
    - conclusions: three sentences on all runs of the folder's campaign
    - report: None if not written
    """

    records: tuple[RunRecord, ...]
    checks: tuple[CheckRecord, ...]
    failures: tuple[str, ...]
    findings: tuple[str, ...]
    conclusions: tuple[str, ...]
    left_out: tuple[str, ...]
    report: Path | None
    refused: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """Return 0, 1 if a task failed, or 2 if instances of foreign plans were refused."""
        return 2 if self.refused else 1 if self.failures else 0


def run_campaign(settings: CampaignSettings, narrator: Narrator) -> CampaignResult:
    """Run the tasks that are not stored; write campaign.json, the tables and the report.

    Raises TouchstoneError for mistakes of the user. KeyboardInterrupt is raised again after the
    children are stopped and the finished tasks are written.
    """
    return _Campaign(settings, narrator).run()


class _Campaign:
    def __init__(self, settings: CampaignSettings, narrator: Narrator) -> None:
        self._settings = settings
        self._narrator = narrator
        entries, self._left_out = checked_selection(settings)
        # The compiled time step and the FMU need a compiler: one error instead of one for each task.
        find_compiler()
        self._store = Store(settings.out)
        self._store.prepare()
        self._entries = with_stored(entries, self._store, settings)
        self._plugin = load_plugin(settings.plugin)
        self._provenance = gather(settings.command)
        # Records of the selected tasks, by key.
        self._records = {
            entry.task.key: entry.stored for entry in self._entries if entry.stored is not None
        }
        self._selected = [entry.task.key for entry in self._entries]
        self._before = found_campaign(settings.out)
        # Keys of all tasks of the folder's campaign, in order.
        self._keys = self._keys_in_folder()
        # Records of the tasks of the folder that are not selected.
        self._others = {
            key: record
            for key in set(self._keys).difference(self._selected)
            if (record := self._store.read(key)) is not None
        }
        self._campaign = self._campaign_record()

    def _keys_in_folder(self) -> tuple[str, ...]:
        named = {identity(task_to_json(entry.task)): entry.task.key for entry in self._entries}
        if self._settings.is_part and self._before is not None:
            return with_others(self._store, self._before, named)
        return tuple(named.values())

    def _campaign_record(self) -> CampaignRecord:
        scenes = scenes_of(self._entries)
        known = () if self._before is None else self._before.time_steps
        steps = time_steps(scenes.values(), known)
        earlier = self._before if self._others else None
        title, command = self._settings.title or TITLE, self._settings.command
        quick, violation = self._settings.quick, ()
        if earlier is not None:
            title = self._settings.title or earlier.title
            quick, violation = quick and earlier.quick, earlier.violation
            if set(self._selected) <= set(earlier.keys):
                command = earlier.command
            named = {item.scene for item in steps}
            steps = (*(item for item in earlier.time_steps if item.scene not in named), *steps)
        if SCENE in scenes and not violation:
            violation = measure(scenes[SCENE])
        return CampaignRecord(
            title=title,
            command=command,
            quick=quick,
            left_out=self._left_out if quick == self._settings.quick else (),
            violation=violation,
            time_steps=steps,
            started=self._provenance.started,
            keys=self._keys,
            provenance=self._provenance,
        )

    def run(self) -> CampaignResult:
        for name, text in self._settings.files.items():
            write_durably(self._settings.out / name, text)
        tasks = [entry.task for entry in self._entries if entry.stored is None]
        # campaign.json is written before the first task ends, so that a killed campaign can be
        # shown. If no task runs, the old file keeps the date and command of the results.
        if tasks or self._before is None or not same_campaign(self._campaign, self._before):
            content = to_json(self._campaign, 1)
            write_durably(self._settings.out / CAMPAIGN, content)
        self._announce()
        try:
            self._run_tasks(tasks)
            if len(self._records) == len(self._entries):
                self._try_worlds()
        finally:
            with interrupts_wait():
                self._collect()
                self._narrator.ends()
                runs = self._write_tables()
        report = self._plugin.write_report(self._settings.out)
        done, checks = divided(self._records[key] for key in self._selected if key in self._records)
        return CampaignResult(
            records=done,
            checks=checks,
            failures=failures(done, checks, runs),
            findings=findings(done),
            conclusions=three_findings(runs),
            left_out=self._left_out,
            report=report,
            refused=self._settings.refused,
        )

    def _announce(self) -> None:
        self._narrator.begins(len(self._entries), len(self._records))
        if self._others:
            self._narrator.notes(
                f"{len(self._others)} other runs and checks of the campaign in "
                f"{self._settings.out} stay in its tables and report"
            )
        scenes = scenes_of(self._entries)
        unstable = [
            item.sentence
            for item in self._campaign.time_steps
            if not item.is_stable and item.scene in scenes
        ]
        for sentence in (*self._settings.refused, *unstable, *warnings_of(scenes.values())):
            self._narrator.warns(sentence)

    def _run_tasks(self, tasks: Sequence[Task]) -> None:
        """Run tasks; the tables and the report grow with each scene that ends."""
        if self._settings.fresh and tasks:
            self._store.discard(task.key for task in tasks)
            forget(map(path_of, tasks), self._store.legs)
            shutil.rmtree(self._store.surveys, ignore_errors=True)
        write = partial(self._plugin.write_report, self._settings.out)

        def first(path: Path) -> None:
            self._narrator.notes(f"report:  {path} (grows with each scene)")

        with (
            closing(GrowingReport(write, first)) as report,
            closing(self._finished(tasks)) as finished,
        ):
            for record in finished:
                self._records[record.key] = record
                self._narrator.finished(record)
                if isinstance(record, RunRecord) and self._scene_ended(record.scene.name):
                    self._write_tables()
                    report.update()
                if self._settings.stop_early and fails(record):
                    break

    def _finished(self, tasks: Sequence[Task]) -> Generator[TaskRecord, None, None]:
        if not tasks:
            return
        settings = self._settings
        loaded = {
            entry.task.key: entry.loaded for entry in self._entries if entry.loaded is not None
        }
        context = ExecutionContext(store=self._store, provenance=self._provenance, loaded=loaded)
        with open_engine(settings.engine, settings.jobs, context, len(tasks)) as engine:
            yield from run_tasks(tasks, engine, context, settings.retries, self._narrator)

    def _scene_ended(self, scene: str) -> bool:
        """Return whether all runs of a scene have ended, and if so print the scene's summary."""
        keys = [
            entry.task.key
            for entry in self._entries
            if isinstance(entry.task, RunTask) and entry.task.scene_name == scene
        ]
        if any(key not in self._records for key in keys):
            return False
        ended = divided(self._records[key] for key in keys)[0]
        if not all(run.instance for run in ended):  # foreign plans are counted at the end
            self._narrator.found(ended)
        return True

    def _try_worlds(self) -> None:
        worlds = False if self._plugin.survey is no_survey else self._settings.worlds
        tasks = worlds_tasks(self._entries, self._in_folder(), worlds)
        if not tasks:
            return
        count = f"{len(tasks)} runs" if len(tasks) > 1 else tasks[0].title
        self._narrator.notes(f"in perturbed worlds: the plans of {count}")
        with closing(self._finished(tasks)) as finished:
            for record in finished:
                self._records[record.key] = record

    def _collect(self) -> None:
        """Read records that were stored but not received before an interruption."""
        missing = [key for key in self._selected if key not in self._records]
        for record in filter(None, map(self._store.read, missing)):
            if record.provenance.started == self._provenance.started:
                self._records[record.key] = record
                self._narrator.finished(record)

    def _in_folder(self) -> dict[str, TaskRecord]:
        """Return the records of all tasks of the folder, in the campaign's order."""
        records = {**self._others, **self._records}
        return {key: records[key] for key in self._keys if key in records}

    def _write_tables(self) -> tuple[RunRecord, ...]:
        done, checks = divided(self._in_folder().values())
        write_tables(self._settings.out, done, checks, self._campaign.violation)
        return done


def checked_selection(settings: CampaignSettings) -> tuple[list[PlannedTask], tuple[str, ...]]:
    """Check engine and folder, and return the result of `select`. Nothing is written.

    Raises TouchstoneError.
    """
    check_engine(settings.engine)
    if settings.worlds and load_plugin(settings.plugin).survey is no_survey:
        raise CampaignError(
            "--worlds: no function of this installation tries plans in perturbed worlds; drop --worlds."
        )
    entries, left_out = select(settings)
    check_folder(settings.out, (*TABLES, REPORT, PAGES, *settings.files))
    if settings.last_failed:
        campaign_of(settings.out)
    return entries, left_out


def time_steps(
    scenes: Iterable[Scene], earlier: Iterable[TimeStepRecord] = ()
) -> tuple[TimeStepRecord, ...]:
    """Return the stability of the time step of each scene while contacts are closed.

    earlier: results of an earlier campaign, used again for unchanged scenes.

    Raises MachineError without a compiler.
    """
    known = {(item.scene, item.digest): item for item in earlier}
    found = []
    for scene in scenes:
        digest = hashlib.sha256(scene_text(scene).encode()).hexdigest()
        if (scene.name, digest) in known:
            found.append(known[scene.name, digest])
            continue
        found.append(TimeStepRecord(**asdict(step_stability(scene)), digest=digest))
    return tuple(found)
