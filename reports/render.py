"""Writes the report of a campaign: pages that ask nothing of any network, and lead to each other by relative links.

    write_report(Path("runs/all"))  ->  runs/all/report.html, and in runs/all/pages a page for each
                                    scene, each run and each thing that is worth one, and the
                                    style and script that these share
    write_single(Path("runs/all"))  ->  runs/all/single.html, which holds all of it

Pages are pure functions of what is stored in the folder: no clock, no machine, no solver. A strict
Content-Security-Policy allows exactly the style and the script that are inside a page, by their
hashes, or the files beside it. What goes across runs is drawn from the numbers of the records each time; a run's page,
which costs far more, only if there is none that is younger than its record and this program.
`is_current` says whether anything would change.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import inspect
import multiprocessing
import os
import re
import signal
import socket
import threading
import uuid
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from reports import wording
from reports.pages import (
    campaign,
    checks,
    overview,
    pareto,
    plans,
    robustness,
    run,
    scene,
    simulators,
    sweeps,
    table1,
    violation,
)
from reports.pages.section import PAGES, REPORT, Report, Section, scene_page
from reports.records.check_record import CheckRecord
from reports.records.engines_record import TruthRecord
from reports.records.load import ReportError, Stored, load, record_files
from reports.records.record import RunRecord
from reports.records.robustness_record import RobustnessRecord

SINGLE = "single.html"
_HERE = Path(__file__).parent
# What report.html shows before its index of the other pages.
_TOP = (overview.build, table1.build, overview.what_failed)
# What the page of a scene shows.
_OF_SCENE = (
    scene.build,
    pareto.build,
    table1.of_scene,
    pareto.ends,
    sweeps.tightening,
    violation.build,
    scene.model,
)
# The other pages by the names of their files, which the first section of each has for its anchor.
_OTHERS = {
    "plans": (plans.build,),
    "runs": (run.all_runs,),
    "robustness": (robustness.build,),
    "sweeps": (sweeps.build,),
    "stress-cases": (checks.stress_cases,),
    "fmus": (checks.fmus,),
    "time-spent": (campaign.time_spent,),
    "provenance": (campaign.provenance,),
}
# Style and script of all pages of a campaign but its report.html, beside them.
_STYLE = "report.css"
_SCRIPT = "report.js"
_SCRIPTS = ("common.js", "figures.js", "tables.js", "player.js")
_LEAD = "Does this plan through contact hold? Every plan below was replayed with exact contact, in continuous time, and scored."
_AGAIN = "python -m reports DIR"
_BACK = [(f"../{REPORT}", "The whole report")]
# Bytes at the start of a page that hold the key of its run.
_HEAD = 2_000
# Fewer pages than this a process are written sooner without it.
_WORTH = 8


class Templates:
    """The templates of this room, each compiled once; all know the macros of macros.html.

    templates = Templates(); templates.render("run.html", view=view, anchor="run");
    templates.render("scene.html#model", ...)
    """

    def __init__(self) -> None:
        self._environment = Environment(
            loader=FileSystemLoader(_HERE / "templates"),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            finalize=_finalized,
        )
        said = inspect.getmembers(wording, inspect.isfunction)
        self._environment.filters |= {
            name: function for name, function in said if function.__module__ == wording.__name__
        }
        self._environment.globals["dash"] = wording.DASH
        macros = self._environment.get_template("macros.html").module
        self._environment.globals |= {
            name: macro for name, macro in vars(macros).items() if not name.startswith("_")
        }

    def render(self, name: str, **values: Any) -> str:
        """The text of one template, or of one block of it: file.html#block."""
        file, _, block = name.partition("#")
        template = self._environment.get_template(file)
        return (
            "".join(template.blocks[block](template.new_context(values)))
            if block
            else template.render(**values)
        )


def write_report(folder: Path, jobs: int | None = None) -> Path:
    """Write report.html and all other pages, those of scenes and runs only if they are out of date.

    On so many processes (all cores). Raises ReportError.
    """
    templates = Templates()
    report = Report(load(folder), folder)
    try:
        (folder / PAGES).mkdir(exist_ok=True)
    except OSError as problem:
        raise _refused(folder / PAGES, "pages", problem) from problem
    write_page(folder / PAGES / _STYLE, _style(), folder)
    write_page(folder / PAGES / _SCRIPT, _script(), folder)
    beside = Report(report.stored, folder, at="")
    others = _others(beside)
    for name, sections in others.items():
        text = page(
            templates,
            sections,
            title=sections[0].title,
            lead=_title(report),
            again=_AGAIN,
            back=_BACK,
            shared=True,
        )
        write_page(folder / PAGES / f"{name}.html", text, folder)
    program = _program()
    for one in report.scenes:
        runs = [run for run in report.stored.runs if run.scene.name == one.name]
        newest = max(program, _time(folder / "campaign.json"))
        if not _is_due(report, scene_page(one), runs, newest):
            continue
        back = [*_BACK, (f"../{REPORT}#index", "All pages")]
        text = page(
            templates,
            _built(_OF_SCENE, beside, one),
            title=one.name,
            lead=one.title,
            again=_AGAIN,
            back=back,
            shared=True,
        )
        write_page(folder / PAGES / scene_page(one), text, folder)
    _write_runs(templates, beside, len(os.sched_getaffinity(0)) if jobs is None else jobs)
    # Last: a report that is younger than the folder of its pages has all of them.
    write_page(folder / REPORT, _campaign_page(templates, report, _across(report, others)), folder)
    return folder / REPORT


def is_current(folder: Path) -> bool:
    """Whether report.html is younger than all it is made of and leads to.

    Of a campaign whose runs are all stored, it says then what it would say anew.
    """
    written = _written(folder / REPORT)
    if not (folder / PAGES).is_dir() or written <= max(
        _program(), _time(folder / "campaign.json"), _time(folder / PAGES)
    ):
        return False
    try:
        return all(
            written > _time(path)
            for record in record_files(folder)
            for path in (record.parent, *record.parent.iterdir())
        )
    except OSError:  # another campaign is at work there
        return False


def write_single(folder: Path) -> Path:
    """Write all that `write_report` writes into one file. Raises ReportError."""
    report = Report(load(folder), folder, single=True)
    others = _others(report)
    sections = [
        *_across(report, others),
        *(section for one in report.scenes for section in _built(_OF_SCENE, report, one)),
    ]
    sections += [section for found in others.values() for section in found]
    write_page(folder / SINGLE, _campaign_page(Templates(), report, sections), folder)
    return folder / SINGLE


def render(folder: Path) -> str:
    """The text of report.html. Raises ReportError if there is no such folder."""
    report = Report(load(folder), folder)
    return _campaign_page(Templates(), report, _across(report, _others(report)))


def render_run(record: RunRecord, folder: Path, engines: Sequence[Mapping[str, Any]] = ()) -> str:
    """The text of the page of a run that belongs to no campaign.

    folder: where its motions are, as in a campaign's: runs/<key>/trajectory.nc and so on; engines:
        what other simulators say of it, as JSON holds that.
    """
    report = Report(Stored(None, (record,)), folder, at="")
    title = f"{record.pipeline} on {record.scene.name}"
    others = simulators.of_plan(engines)
    return page(
        Templates(),
        [run.build(report, record), *others],
        title=title,
        lead=record.scene.title,
        again="",
    )


def render_players(folder: Path) -> dict[str, str]:
    """Scene -> the text of a page with its best plan in motion, and nothing else, for a gallery.

    Raises ReportError.
    """
    report, templates = Report(load(folder), folder, at=""), Templates()
    moving = [
        (one, section)
        for one in report.scenes
        if (section := scene.motion(report, one)) is not None
    ]
    return {
        one.name: page(templates, [section], title=one.title, lead="", again="")
        for one, section in moving
    }


def render_checks(records: Sequence[CheckRecord]) -> str:
    """The text of the page of FMUs that were checked outside of any campaign; at least one."""
    names = ", ".join(record.name for record in records)
    return page(
        Templates(), [checks.fmus_of(records)], title="FMUs under the check", lead=names, again=""
    )


def render_robustness(record: RobustnessRecord, plan: str) -> str:
    """The text of the page of how much a plan can take. plan: what it is called."""
    title = f"How much {plan} can take on {record.scene}"
    return page(
        Templates(),
        [robustness.of_plan(record)],
        title=title,
        lead=record.summary,
        again="",
    )


def render_truth(record: TruthRecord, again: str) -> str:
    """The text of the page of the truth suite. again: the command that makes it anew."""
    return page(
        Templates(),
        [simulators.truth(record)],
        title="The contact truth suite",
        lead=record.summary,
        again=again,
    )


def page(
    templates: Templates,
    sections: Sequence[Section],
    *,
    title: str,
    lead: str,
    again: str,
    quick: bool = False,
    back: Sequence[tuple[str, str]] = (),
    shared: bool = False,
    key: str = "",
) -> str:
    """Return a page of these sections, with its contents, style and script.

    again: the command that writes it again; back: (address, words) of other pages; shared: style
    and script are the files beside it; key: of the run that the page is of.
    """
    style, script = _style(), _script()
    # Some browsers take a local file for another origin than the file beside it.
    allowed = ["'self' file:"] * 2 if shared else [f"'{_hash(style)}'", f"'{_hash(script)}'"]
    return templates.render(
        "page.html",
        sections=[
            (item, Markup(templates.render(item.template, section=item, **item.values)))
            for item in sections
        ],
        policy=f"default-src 'none'; style-src {allowed[0]}; script-src {allowed[1]}; img-src blob:; base-uri 'none'; form-action 'none'",
        key=key,
        shared=(_STYLE, _SCRIPT) if shared else (),
        style=Markup(style),
        script=Markup(script),
        title=title,
        lead=lead,
        again=again,
        quick=quick,
        back=back,
    )


# What a frame holds: the page, a third as long as its text, and what unpacks it. A notebook keeps
# one for every plan that is looked at.
_UNPACK = """<!doctype html><meta charset="utf-8"><noscript>This page needs JavaScript.</noscript><script type="module">
const packed = Uint8Array.from(atob("PACKED"), (letter) => letter.charCodeAt(0));
const page = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
document.open();
document.write(page);
document.close();
</script>"""


def framed(page: str) -> str:
    """A page in a frame of its own, as a notebook shows it: its style and script meet nobody else's."""
    inside = _UNPACK.replace("PACKED", base64.b64encode(zlib.compress(page.encode(), 9)).decode())
    return (
        f"<iframe srcdoc='{inside}' sandbox='allow-scripts allow-downloads' title='touchstone' "
        "style='width: 100%; height: 45em; border: 1px solid #8888'></iframe>"
    )


def write_page(target: Path, text: str, aside: Path | None = None) -> None:
    """Write a page, whole or not at all.

    aside: where it stands while it is written (beside its place). Raises ReportError.

    What is not finished says whose it is, as in all of a campaign's folder, so that it is removed
    there if we are killed.
    """
    part = (
        aside or target.parent
    ) / f".partial-page-{uuid.uuid4().hex}-{os.getpid()}-{socket.gethostname()}"
    try:
        part.write_bytes(text.encode("utf-8", errors="replace"))
        os.replace(part, target)
    except OSError as problem:
        with contextlib.suppress(OSError):
            part.unlink()
        raise _refused(target, "report", problem) from problem


def _refused(place: Path, what: str, problem: OSError) -> ReportError:
    return ReportError(
        f"{place}: the {what} cannot be written ({problem.strerror}); free the place or choose another folder."
    )


def _built(makers: Sequence[Callable[..., Section | None]], *words: object) -> list[Section]:
    return [section for make in makers if (section := make(*words)) is not None]


def _others(report: Report) -> dict[str, list[Section]]:
    """The sections of the other pages, by the names of their files.

    Without those that have none.
    """
    return {
        name: sections for name, makers in _OTHERS.items() if (sections := _built(makers, report))
    }


def _across(report: Report, others: Mapping[str, Sequence[Section]]) -> list[Section]:
    """The sections of report.html."""
    listed = [(name, sections[0]) for name, sections in others.items()]
    return [*_built(_TOP, report), *_built((overview.index,), report, listed)]


def _title(report: Report) -> str:
    campaign = report.stored.campaign
    return campaign.title if campaign else "Campaign without its record"


def _campaign_page(templates: Templates, report: Report, sections: Sequence[Section]) -> str:
    campaign = report.stored.campaign
    again = f"{_AGAIN} --single-file" if report.single else _AGAIN
    return page(
        templates,
        sections,
        title=_title(report),
        lead=_LEAD,
        again=again,
        quick=bool(campaign and campaign.quick),
    )


def _write_runs(templates: Templates, report: Report, jobs: int) -> None:
    """Write the pages of runs that are missing, or older than their record or this program.

    By processes that nobody needs to hear from: what one of them leaves undone, whatever the
    reason, is done, or said, here. Where there are threads, which do not survive a fork, all of it
    is.
    """
    due = _due(report)
    jobs = min(jobs, len(due) // _WORTH)
    if jobs > 1 and threading.active_count() == 1:
        context = multiprocessing.get_context("fork")
        children = [
            context.Process(
                target=_write_some, args=(templates, report, due[place::jobs]), daemon=True
            )
            for place in range(jobs)
        ]
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
    back = [
        *_BACK,
        (report.scene_link(one.scene), f"The scene {one.scene.name}"),
        (report.page_link("runs"), "All runs"),
    ]
    title = f"{one.pipeline} on {one.scene.name}"
    text = page(
        templates,
        [run.build(report, one)],
        title=title,
        lead=one.scene.title,
        again=_AGAIN,
        back=back,
        shared=True,
        key=one.key,
    )
    write_page(report.folder / PAGES / report.pages[one.key], text, report.folder)


def _program() -> int:
    """When the last of our own files was written [ns]."""
    return max(
        path.stat().st_mtime_ns
        for path in _HERE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    )


def _due(report: Report) -> list[RunRecord]:
    program = _program()
    return [
        one
        for one in report.stored.runs
        if (page := report.pages.get(one.key)) is not None
        and (
            _is_due(report, page, [one], program)
            or not _is_of(report.folder / PAGES / page, one.key)
        )
    ]


def _is_of(path: Path, key: str) -> bool:
    """Return whether a page is of the run of this key; one of its name may be of an earlier run."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        return f'name="run" content="{key}"'.encode() in file.read(_HEAD)
    return False


def _is_due(report: Report, page: str, runs: Sequence[RunRecord], newest: int) -> bool:
    """Return whether a page is missing or older than a record of its runs or than `newest` [ns]."""
    times = [
        _time(report.folder / "runs" / run.key / name)
        for run in runs
        for name in ("", "record.json")
    ]
    return _written(report.folder / PAGES / page) <= max(newest, *times)


def _written(path: Path) -> int:
    """When a file was last written [ns]; 0 where there is none."""
    return _time(path) if path.is_file() else 0


def _time(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _finalized(value: Any) -> Any:
    """Every string that reaches the page without being markup loses its control characters.

    Escaping comes after.
    """
    return (
        wording.clean(value) if isinstance(value, str) and not isinstance(value, Markup) else value
    )


def _asset(name: str) -> str:
    """One of our own files, as it stands between the tags, without comments and indents: a campaign has hundreds of pages with it. Hashes are over this text."""
    text = (_HERE / "assets" / name).read_text(encoding="utf-8")
    lines = (line.strip() for line in re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL).splitlines())
    return "\n" + "".join(f"{line}\n" for line in lines if line and not line.startswith("//"))


@cache
def _style() -> str:
    return _asset("report.css")


@cache
def _script() -> str:
    return "\n".join(_asset(name) for name in _SCRIPTS)


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
