"""A campaign: which cells, which of them are stored, the others run, and everything written that is told of them.

    outcome = run_campaign(Settings(out=Path("runs/all"), quick=True), narrator)
    outcome.exit_code, outcome.records, outcome.report

Cells are content-addressed: a stored one is used again, unless it crashed, or ran out of a shorter time limit than it would have now.
"""

from __future__ import annotations

import difflib
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from formulations.pipeline import cells_of
from models.catalog import load_scene, scene_names
from models.errors import TouchstoneError
from validate.cell import Cell
from validate.engine import LocalEngine
from validate.results import write_results
from validate.selection import matches
from validate.store import Store, write_durably
from validate.sweeps import write_sweeps
from validate.tools import DEFAULT_TOOLS, Tools, load_tools, tools_source

if TYPE_CHECKING:
    from models.scene import Scene
    from reports.record import CampaignRecord, ProvenanceRecord, RunRecord
    from validate.records import Planned
    from validate.worker import Worker

TITLE = "Plans through contact, replayed and scored"
CAMPAIGN, RESULTS, VIOLATION = "campaign.json", "results.csv", "violation.csv"


class CampaignError(TouchstoneError):
    """Nothing selected, or a folder that holds no campaign."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What the user asked for. scenes: names or paths; empty for all of the catalog."""

    out: Path
    scenes: tuple[str, ...] = ()
    quick: bool = False
    expression: str = ""
    jobs: int = 1
    fresh: bool = False
    time_limit: float = 120.0
    tools: str = DEFAULT_TOOLS
    command: str = ""


@dataclass(frozen=True)
class Entry:
    """A cell with what the parent knows of it: its scene, its stages, and its stored record if that can be used."""

    cell: Cell
    scene: Scene
    plan: tuple[Planned, ...]
    stored: RunRecord | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of a campaign. report: None where it was not written."""

    records: tuple[RunRecord, ...]
    failures: tuple[str, ...]
    left_out: tuple[str, ...]
    report: Path | None

    @property
    def exit_code(self) -> int:
        return 1 if self.failures else 0


class Narrator(Protocol):
    """Who is told how it goes (validate.cli.narrator)."""

    def begins(self, total: int, stored: int) -> None: ...
    def runs(self, workers: Sequence[Worker]) -> None: ...
    def finished(self, record: RunRecord) -> None: ...
    def ends(self) -> None: ...


def select(settings: Settings) -> tuple[list[Entry], tuple[str, ...]]:
    """The cells asked for, in order, and what a quick campaign leaves out, in words. Raises TouchstoneError."""
    from validate.score import check_limits

    tools = load_tools(settings.tools)
    entries: list[Entry] = []
    seen: list[str] = []
    left_out: list[tuple[str, str]] = []
    references = list(dict.fromkeys(settings.scenes or scene_names()))
    for reference in references:
        scene = load_scene(reference)
        check_limits(scene)
        if any(entry.scene.name == scene.name and entry.scene is not scene for entry in entries):
            raise CampaignError(f"--scene {reference}: another scene of this campaign is named {scene.name!r} too; rename one of them.")
        where = str(Path(reference).resolve()) if reference.endswith(".py") else reference
        for pipeline in tools.pipelines_for(scene):
            methods = dict.fromkeys(leg.method for leg in pipeline.legs)
            seen += [scene.name, pipeline.name, *methods]
            if not settings.expression or matches(settings.expression, (scene.name, pipeline.name, *methods)):
                if settings.quick and pipeline.name not in tools.quick_names():
                    left_out.append((scene.name, pipeline.name))
                else:
                    for part in cells_of(pipeline):
                        cell = Cell(
                            key="", scene=where, scene_name=scene.name, pipeline=part, tools=settings.tools, time_limit=settings.time_limit
                        )
                        entries.append(_entry(cell, scene, tools))
    told = _in_words(left_out, len(references))
    if not entries:
        raise _nothing(settings, seen, told)
    return entries, told


def _in_words(cells: Sequence[tuple[str, str]], scenes: int) -> tuple[str, ...]:
    """(scene, pipeline) -> `scene x pipeline`; a pipeline of all of several scenes once, as `every scene x pipeline`."""
    times = Counter(pipeline for _, pipeline in cells)
    return tuple(dict.fromkeys(f"{'every scene' if times[pipeline] == scenes > 1 else scene} x {pipeline}" for scene, pipeline in cells))


def _entry(cell: Cell, scene: Scene, tools: Tools) -> Entry:
    from validate.provenance import content_key
    from validate.records import planned_stages

    methods = {leg.method: tools.load_method(leg.method) for leg in cell.pipeline.legs}
    plan = planned_stages(cell.pipeline, methods)
    stages = [(planned.name, planned.eps, {name: repr(value) for name, value in planned.options.items()}) for planned in plan]
    key = content_key(scene, [cell.pipeline.name, cell.pipeline.title, stages], methods, tools_source(cell.tools))
    return Entry(cell=replace(cell, key=key), scene=scene, plan=plan)


def _nothing(settings: Settings, seen: list[str], left_out: tuple[str, ...]) -> CampaignError:
    if left_out:
        return CampaignError(
            f"nothing to run: --quick leaves out all that -k {settings.expression!r} selects ({', '.join(left_out)}); drop --quick."
        )
    names = list(dict.fromkeys(seen))
    close = difflib.get_close_matches(settings.expression, names, n=1)
    hint = f"did you mean {close[0]}?" if close else f"the names are {', '.join(names)}."
    return CampaignError(f"nothing to run: -k {settings.expression!r} selects no cell; {hint}")


def with_stored(entries: Sequence[Entry], store: Store, settings: Settings) -> list[Entry]:
    """The same cells, each with its stored record where that can be used again."""
    if settings.fresh:
        return list(entries)
    return [replace(entry, stored=_usable(store, entry.cell)) for entry in entries]


def _usable(store: Store, cell: Cell) -> RunRecord | None:
    record = store.read(cell.key)
    if record is None:
        return None
    outcomes = {record.outcome, *(stage.outcome for stage in record.stages)}
    if "crashed" in outcomes:
        return None
    if "time_limit" in outcomes:
        before = json.loads(store.request_text(cell.key)).get("cell", {}).get("time_limit", 0.0)
        return record if before >= cell.time_limit else None
    return record


def run_campaign(settings: Settings, narrator: Narrator) -> Outcome:
    """Run what is not stored and write campaign.json, results.csv, violation.csv, starts.csv, front.csv and the report.

    Raises TouchstoneError for what the user can mend; KeyboardInterrupt passes through when children are stopped and what finished is written.
    """
    from models.codegen.compiler import find_compiler
    from reports.collected import collected
    from reports.rule import failures
    from validate.provenance import gather
    from validate.violation import measure, write_violation

    entries, left_out = select(settings)
    find_compiler()  # the compiled time step and the FMU need one: better said now than by every cell
    store = Store(settings.out)
    store.prepare()
    entries = with_stored(entries, store, settings)
    provenance = gather(settings.command)
    violation = measure(next((entry.scene for entry in entries if entry.scene.nc), entries[0].scene))
    records = {entry.cell.key: entry.stored for entry in entries if entry.stored is not None}

    def campaign() -> CampaignRecord:
        from reports.record import CampaignRecord

        return CampaignRecord(
            title=TITLE,
            command=settings.command,
            started=provenance.started,
            quick=settings.quick,
            left_out=left_out,
            keys=tuple(entry.cell.key for entry in entries),
            violation=violation,
            provenance=provenance,
        )

    def write() -> tuple[RunRecord, ...]:
        done = tuple(records[entry.cell.key] for entry in entries if entry.cell.key in records)
        write_durably(settings.out / CAMPAIGN, campaign().model_dump_json(indent=1))
        told = collected(done)
        write_results(settings.out / RESULTS, told)
        write_violation(settings.out / VIOLATION, violation)
        write_sweeps(settings.out, told)
        return told

    narrator.begins(len(entries), len(records))
    try:
        for record in _run([entry for entry in entries if entry.stored is None], store, provenance, settings, narrator.runs):
            records[record.key] = record
            narrator.finished(record)
    finally:
        narrator.ends()
        done = write()
    report = load_tools(settings.tools).write_report(settings.out)
    return Outcome(records=done, failures=failures(done), left_out=left_out, report=report)


def _run(
    entries: Sequence[Entry],
    store: Store,
    provenance: ProvenanceRecord,
    settings: Settings,
    watch: Callable[[Sequence[Worker]], None],
) -> Iterator[RunRecord]:
    if not entries:
        return
    from validate.scene_record import scene_record
    from validate.worker import Watchdog, Worker

    scenes = {entry.scene.name: scene_record(entry.scene) for entry in entries}
    by_key = {entry.cell.key: entry for entry in entries}
    with Watchdog() as watchdog:

        def start(cell: Cell) -> Worker:
            return Worker(cell, scenes[cell.scene_name], by_key[cell.key].plan, provenance, store, watchdog)

        engine = LocalEngine(start, settings.jobs, watch)
        with closing(engine.run([entry.cell for entry in entries])) as finished:
            for _, record in finished:
                yield record


def stored_campaign(folder: Path) -> tuple[CampaignRecord, tuple[RunRecord, ...]]:
    """The campaign of a folder and those of its cells that are stored, in order. Raises CampaignError."""
    from pydantic import ValidationError

    from reports.record import CampaignRecord

    path = folder / CAMPAIGN
    try:
        campaign = CampaignRecord.model_validate_json(path.read_bytes())
    except OSError as error:
        raise CampaignError(
            f"{folder}: there is no campaign in this folder ({CAMPAIGN} cannot be read); run one with --out {folder}."
        ) from error
    except ValidationError as error:
        raise CampaignError(
            f"{path}: it is damaged, or of another version ({error.error_count()} fields do not fit); run the campaign again."
        ) from error
    store = Store(folder)
    found = (store.read(key) for key in campaign.keys)
    return campaign, tuple(record for record in found if record is not None)
