"""Write the report of a campaign: pages without network access, connected by relative links.

    write_report(Path("runs/all"))  ->  runs/all/report.html, runs/all/pages with a page per scene,
                                    run and topic, and their style and script
    write_single(Path("runs/all"))  ->  runs/all/single.html with everything

Pages depend only on the stored folder. A strict Content-Security-Policy allows only the style and
script in or beside the page. Pages of runs are written only if missing or older than their record
or this program (`is_current`).
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
from types import MappingProxyType
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from models.results.run import RunRecord
from reports import wording
from reports.load import ReportError, Stored, record_files
from reports.load import load as load_campaign
from reports.pages import overview, pareto, run, scene, sweeps, table1, violation
from reports.pages.section import PAGES, REPORT, Report, Section, scene_page
from touchstone_annexes import load, present

SINGLE = "single.html"
_HERE = Path(__file__).parent
_TOP = (overview.build, table1.build, overview.what_failed)
_OF_SCENE = (
    scene.build,
    pareto.build,
    table1.of_scene,
    pareto.ends,
    sweeps.tightening,
    violation.build,
    scene.model,
)
# Other pages by file name, which is the anchor of the section; an annex may be missing.
_OTHERS = MappingProxyType({
    "plans": "reports.pages.plans:build",
    "runs": "reports.pages.run:all_runs",
    "robustness": "reports.pages.robustness:build",
    "sweeps": "reports.pages.sweeps:build",
    "stress-cases": "reports.pages.checks:stress_cases",
    "fmus": "reports.pages.checks:fmus",
    "time-spent": "reports.pages.campaign:time_spent",
    "provenance": "reports.pages.campaign:provenance",
})  # fmt: skip
# Sections that annexes add to the page of one plan, by the name of their data.
_ADDITIONS = MappingProxyType({"engines": "reports.pages.simulators:of_plan"})
# Shared style and script of all pages except report.html.
_STYLE = "report.css"
_SCRIPT = "report.js"
_SCRIPTS = ("common.js", "figures.js", "tables.js", "player.js")
_LEAD = "Does this plan through contact hold? Every plan below was replayed with exact contact, in continuous time, and scored."
_AGAIN = "python -m reports DIR"
_BACK = [(f"../{REPORT}", "The whole report")]
# Bytes at the start of a page that include its run's key.
_HEAD = 2_000
# Fewest pages for which another process is faster.
_WORTH = 8


class Templates:
    """The compiled templates; all have the macros of macros.html.

    templates.render("run.html", view=view, anchor="run"); templates.render("scene.html#model", ..)
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
        functions = inspect.getmembers(wording, inspect.isfunction)
        self._environment.filters |= {
            name: function
            for name, function in functions
            if function.__module__ == wording.__name__
        }
        self._environment.globals["dash"] = wording.DASH
        macros = self._environment.get_template("macros.html").module
        self._environment.globals |= {
            name: macro for name, macro in vars(macros).items() if not name.startswith("_")
        }

    def render(self, name: str, **values: Any) -> str:
        """Return the text of a template, or of one block: file.html#block."""
        file, _, block = name.partition("#")
        template = self._environment.get_template(file)
        return (
            "".join(template.blocks[block](template.new_context(values)))
            if block
            else template.render(**values)
        )


def write_report(folder: Path, jobs: int | None = None) -> Path:
    """Write report.html and all outdated pages, by `jobs` processes (default: all cores).

    Raises ReportError.
    """
    templates = Templates()
    report = Report(load_campaign(folder), folder)
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
    # Last, so that a report younger than its pages' folder is complete.
    write_page(folder / REPORT, _campaign_page(templates, report, _across(report, others)), folder)
    return folder / REPORT


def is_current(folder: Path) -> bool:
    """Return whether report.html is younger than all its sources."""
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
    except OSError:  # another campaign is writing there
        return False


def write_single(folder: Path) -> Path:
    """Write the whole report into one file. Raises ReportError."""
    report = Report(load_campaign(folder), folder, single=True)
    others = _others(report)
    sections = [
        *_across(report, others),
        *(section for one in report.scenes for section in _built(_OF_SCENE, report, one)),
    ]
    sections += [section for sections_of_page in others.values() for section in sections_of_page]
    write_page(folder / SINGLE, _campaign_page(Templates(), report, sections), folder)
    return folder / SINGLE


def render(folder: Path) -> str:
    """Return the text of report.html. Raises ReportError without a folder."""
    report = Report(load_campaign(folder), folder)
    return _campaign_page(Templates(), report, _across(report, _others(report)))


def render_run(
    record: RunRecord, folder: Path, additions: Mapping[str, Any] = MappingProxyType({})
) -> str:
    """Return the page of a run without a campaign.

    folder: with runs/<key>/trajectory.nc etc.; additions: JSON data by name of a section.
    """
    report = Report(Stored(None, (record,)), folder, at="")
    title = f"{record.pipeline} on {record.scene.name}"
    others = [
        load(reference)(additions[name])
        for name, reference in present(_ADDITIONS).items()
        if name in additions
    ]
    return render_sections(
        [run.build(report, record), *others], title=title, lead=record.scene.title
    )


def render_players(folder: Path) -> dict[str, str]:
    """Return pages with only the best plan's motion by scene, for a gallery. Raises ReportError."""
    report, templates = Report(load_campaign(folder), folder, at=""), Templates()
    moving = [
        (one, section)
        for one in report.scenes
        if (section := scene.motion(report, one)) is not None
    ]
    return {
        one.name: page(templates, [section], title=one.title, lead="", again="")
        for one, section in moving
    }


def render_sections(sections: Sequence[Section], *, title: str, lead: str, again: str = "") -> str:
    """Return a page of its own with these sections; again: the command that writes the page."""
    return page(Templates(), sections, title=title, lead=lead, again=again)


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
    """Return a page of sections, with contents, style and script.

    - again: command that writes the page.
    - back: (address, words) of other pages.
    - shared: link style and script files.
    - key: of the page's run.
    """
    style, script = _style(), _script()
    # Some browsers treat local files as different origins.
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


# Content of a frame: the compressed page, a third of its length, and code to unpack it.
_UNPACK = """<!doctype html><meta charset="utf-8"><noscript>This page needs JavaScript.</noscript><script type="module">
const packed = Uint8Array.from(atob("PACKED"), (letter) => letter.charCodeAt(0));
const page = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
document.open();
document.write(page);
document.close();
</script>"""


def framed(page: str) -> str:
    """Return a page in its own frame, isolated from a notebook's style and scripts."""
    inside = _UNPACK.replace("PACKED", base64.b64encode(zlib.compress(page.encode(), 9)).decode())
    return (
        f"<iframe srcdoc='{inside}' sandbox='allow-scripts allow-downloads' title='touchstone' "
        "style='width: 100%; height: 45em; border: 1px solid #8888'></iframe>"
    )


def write_page(target: Path, text: str, aside: Path | None = None) -> None:
    """Write a page atomically; aside: folder while writing. Raises ReportError.

    The temporary name has its owner, so that a campaign can remove it.
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
    """Return the non-empty sections of other pages by file name."""
    makers = {name: load(reference) for name, reference in present(_OTHERS).items()}
    return {
        name: sections for name, make in makers.items() if (sections := _built((make,), report))
    }


def _across(report: Report, others: Mapping[str, Sequence[Section]]) -> list[Section]:
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
    """Write missing and outdated pages of runs.

    Child processes report nothing: pages that fail there are written again here. With threads no
    child is forked.
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the interrupted parent ends this child
    with contextlib.suppress(Exception):  # the parent repeats and reports it
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
    """Return whether a page is of this run, as an earlier run may have had its name."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        return f'name="run" content="{key}"'.encode() in file.read(_HEAD)
    return False


def _is_due(report: Report, page: str, runs: Sequence[RunRecord], newest: int) -> bool:
    times = [
        _time(report.folder / "runs" / run.key / name)
        for run in runs
        for name in ("", "record.json")
    ]
    return _written(report.folder / PAGES / page) <= max(newest, *times)


def _written(path: Path) -> int:
    return _time(path) if path.is_file() else 0


def _time(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _finalized(value: Any) -> Any:
    """Remove control characters from strings that are not markup; escaping follows."""
    return (
        wording.clean(value) if isinstance(value, str) and not isinstance(value, Markup) else value
    )


def _asset(name: str) -> str:
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
