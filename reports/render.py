"""Writes the report of a campaign: pages that ask nothing of any network, and lead to each other by relative links.

    write_report(Path("runs/all"))  ->  runs/all/report.html, and in runs/all/pages a page for each scene and each run
    write_single(Path("runs/all"))  ->  runs/all/single.html, which holds all of it

Pages are pure functions of what is stored in the folder: no clock, no machine, no solver. A strict Content-Security-Policy allows exactly the style and
the script that are inside a page, by their hashes. What goes across runs is drawn from the numbers of the records each time; a run's page, which costs
far more, only if there is none that is younger than its record and this program. `is_current` says whether anything would change.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import multiprocessing
import os
import signal
import socket
import threading
import uuid
from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from reports.pages import (
    errata,
    fmus,
    front,
    matrix,
    overview,
    pareto,
    provenance,
    run,
    runs,
    scene,
    scenes,
    stability,
    summary,
    table1,
    tightening,
    time_spent,
    tolerance,
    violation,
)
from reports.pages.section import PAGES, Report, Section, run_page, scene_page
from reports.records.load import ReportError, load, record_files
from reports.records.record import RunRecord, SceneRecord
from reports.templating import Templates

REPORT, SINGLE = "report.html", "single.html"
_HERE = Path(__file__).parent
_ACROSS = (
    overview,
    summary,
    matrix,
    stability,
    table1,
    violation,
    front,
    pareto,
    tolerance,
    runs,
    scenes,
    fmus,
    errata,
    time_spent,
    provenance,
)
_SCRIPTS = ("report.js", "matrix.js", "tables.js", "player.js")
_LEAD = "Does this plan through contact hold? Every plan below was replayed through the true contact dynamics and scored there."
_SCENE_LEAD = "What the scene is: its equations, quantities and known answers, and how plans on it change while ε is tightened."
# Fewer pages than this a process are written sooner without it.
_WORTH = 8


def write_report(folder: Path, jobs: int | None = None) -> Path:
    """Write the page of each scene, those of the runs that are out of date, and report.html; on so many processes (all cores). Raises ReportError."""
    templates = Templates()
    report = Report(load(folder), folder)
    if report.scenes:
        _make(folder / PAGES)
    beside = Report(report.stored, folder, at="")
    for one in report.scenes:
        write_page(folder / PAGES / scene_page(one), _of_scene(templates, beside, one), folder)
    _write_runs(templates, beside, len(os.sched_getaffinity(0)) if jobs is None else jobs)
    # Last: a report that is younger than the folder of its pages has all of them.
    write_page(folder / REPORT, _across(templates, report), folder)
    return folder / REPORT


def is_current(folder: Path) -> bool:
    """Whether report.html is younger than all it is made of and leads to; of a campaign whose runs are all stored, it says then what it would say anew."""
    written = _written(folder / REPORT)
    if not (folder / PAGES).is_dir() or written <= max(_program(), _time(folder / "campaign.json"), _time(folder / PAGES)):
        return False
    try:
        return all(written > _time(path) for record in record_files(folder) for path in (record.parent, *record.parent.iterdir()))
    except OSError:  # another campaign is at work there
        return False


def write_single(folder: Path) -> Path:
    """Write all that `write_report` writes into one file. Raises ReportError."""
    templates = Templates()
    report = Report(load(folder), folder, single=True)
    sections = _sections(report)
    for one in report.scenes:
        sections += _scene_sections(report, one)
    write_page(folder / SINGLE, _campaign_page(templates, report, sections), folder)
    return folder / SINGLE


def render(folder: Path) -> str:
    """The text of report.html. Raises ReportError if there is no such folder."""
    return _across(Templates(), Report(load(folder), folder))


def page(
    templates: Templates,
    sections: Sequence[Section],
    *,
    title: str,
    lead: str,
    again: str,
    quick: bool = False,
    back: Sequence[tuple[str, str]] = (),
) -> str:
    """A page of these sections, with its contents, style and script. again: the command that writes it anew; back: (address, words) of other pages."""
    style, script = _asset("report.css"), "\n".join(_asset(name) for name in _SCRIPTS)
    return templates.render(
        "page.html",
        sections=[(item, Markup(templates.render(item.template, section=item, **item.values))) for item in sections],
        policy=f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; base-uri 'none'; form-action 'none'",
        style=Markup(style),
        script=Markup(script),
        title=title,
        lead=lead,
        again=again,
        quick=quick,
        back=back,
    )


def write_page(target: Path, text: str, aside: Path | None = None) -> None:
    """Write a page, whole or not at all; aside: where it stands while it is written (beside its place). Raises ReportError.

    What is not finished says whose it is, as in all of a campaign's folder, so that it is removed there if we are killed.
    """
    part = (aside or target.parent) / f".partial-page-{uuid.uuid4().hex}-{os.getpid()}-{socket.gethostname()}"
    try:
        part.write_bytes(text.encode("utf-8", errors="replace"))
        os.replace(part, target)
    except OSError as problem:
        with contextlib.suppress(OSError):
            part.unlink()
        raise ReportError(
            f"{target}: the report cannot be written ({problem.strerror}); free the place or choose another folder."
        ) from problem


def _make(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as problem:
        raise ReportError(
            f"{folder}: the pages cannot be written ({problem.strerror}); free the place or choose another folder."
        ) from problem


def _sections(report: Report) -> list[Section]:
    return [section for part in _ACROSS if (section := part.build(report)) is not None]


def _across(templates: Templates, report: Report) -> str:
    """The text of report.html."""
    return _campaign_page(templates, report, _sections(report))


def _campaign_page(templates: Templates, report: Report, sections: Sequence[Section]) -> str:
    campaign = report.stored.campaign
    title = campaign.title if campaign else "Campaign without its record"
    again = "python -m reports --single-file DIR" if report.single else "python -m reports DIR"
    return page(templates, sections, title=title, lead=_LEAD, again=again, quick=bool(campaign and campaign.quick))


def _of_scene(templates: Templates, report: Report, one: SceneRecord) -> str:
    back = [(f"../{REPORT}", "The whole report"), (f"../{REPORT}#scenes", "All scenes")]
    return page(templates, _scene_sections(report, one), title=one.name, lead=_SCENE_LEAD, again="python -m reports DIR", back=back)


def _scene_sections(report: Report, one: SceneRecord) -> list[Section]:
    return [section for section in (scene.build(report, one), tightening.build(report, one)) if section is not None]


def _of_run(templates: Templates, report: Report, one: RunRecord) -> str:
    back = [
        (f"../{REPORT}", "The whole report"),
        (f"../{REPORT}#matrix", "Scenes and pipelines"),
        (report.scene_link(one.scene), f"The scene {one.scene.name}"),
    ]
    title = f"{one.pipeline} on {one.scene.name}"
    return page(templates, [run.build(report, one)], title=title, lead=one.scene.title, again="python -m reports DIR", back=back)


def _write_runs(templates: Templates, report: Report, jobs: int) -> None:
    """Write the pages of runs that are missing, or older than their record or this program.

    By processes that nobody needs to hear from: what one of them leaves undone, whatever the reason, is done, or said, here. Where there are threads,
    which do not survive a fork, all of it is.
    """
    due = _due(report)
    jobs = min(jobs, len(due) // _WORTH)
    if jobs > 1 and threading.active_count() == 1:
        context = multiprocessing.get_context("fork")
        children = [context.Process(target=_write_some, args=(templates, report, due[place::jobs]), daemon=True) for place in range(jobs)]
        for child in children:
            child.start()
        for child in children:
            child.join()
        due = _due(report)
    for one in due:
        _write_run(templates, report, one)


def _write_some(templates: Templates, report: Report, some: Sequence[RunRecord]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # our parent, which is interrupted too, ends us
    with contextlib.suppress(Exception):  # whatever it is, it comes again where it is said
        for one in some:
            _write_run(templates, report, one)


def _write_run(templates: Templates, report: Report, one: RunRecord) -> None:
    write_page(report.folder / PAGES / run_page(one), _of_run(templates, report, one), report.folder)


def _program() -> int:
    """When the last of our own files was written [ns]."""
    return max(path.stat().st_mtime_ns for path in _HERE.rglob("*") if path.is_file() and "__pycache__" not in path.parts)


def _due(report: Report) -> list[RunRecord]:
    program = _program()
    return [
        one
        for one, parts in zip(report.stored.runs, report.stored.parts, strict=True)
        if _written(report.folder / PAGES / run_page(one))
        <= max(program, *(_written(report.folder / "runs" / part.key / "record.json") for part in parts))
    ]


def _written(path: Path) -> int:
    """When a file was last written [ns]; 0 where there is none."""
    return _time(path) if path.is_file() else 0


def _time(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _asset(name: str) -> str:
    """One of our own files, as it stands between the tags: the hash is over exactly this text."""
    return "\n" + (_HERE / "assets" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


__all__ = ["PAGES", "is_current", "page", "render", "write_page", "write_report", "write_single"]
