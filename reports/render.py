"""Writes the report of a campaign: one self-contained file that asks nothing of any network.

    write_report(Path("runs/all"))  ->  runs/all/report.html

The page is a pure function of the records in the folder: no clock, no machine, no solver. A strict Content-Security-Policy
allows exactly the style and the script that are inside it, by their hashes.
"""

from __future__ import annotations

import base64
import hashlib
import os
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from reports import wording
from reports.load import ReportError, load
from reports.pages import (
    balance,
    cosimulation,
    errata,
    fmus,
    front,
    matrix,
    order,
    pareto,
    provenance,
    replay_speed,
    rigid_limit,
    runs,
    scaling,
    scene,
    stability,
    suite,
    summary,
    table1,
    tightening,
    time_spent,
    tolerance,
    violation,
)
from reports.pages.section import Report, Section

_HERE = Path(__file__).parent
_PAGES = (
    summary,
    matrix,
    stability,
    table1,
    violation,
    tightening,
    front,
    pareto,
    tolerance,
    runs,
    scene,
    fmus,
    replay_speed,
    rigid_limit,
    balance,
    cosimulation,
    errata,
    suite,
    scaling,
    order,
    time_spent,
    provenance,
)


def write_report(folder: Path) -> Path:
    """Render the records of a campaign's folder to its report.html. Raises ReportError."""
    page = render(folder)
    target = folder / "report.html"
    part = folder / f".report.{os.getpid()}.html"
    try:
        part.write_bytes(page.encode("utf-8", errors="replace"))
        os.replace(part, target)
    except OSError as problem:
        part.unlink(missing_ok=True)
        raise ReportError(
            f"{target}: the report cannot be written ({problem.strerror}); free the place or choose another folder."
        ) from problem
    return target


def render(folder: Path) -> str:
    """The page's text. Raises ReportError if there is no such folder."""
    report = Report(load(folder))
    environment = _environment()
    sections = [section for page in _PAGES if (section := page.build(report)) is not None]
    style, script = _asset("report.css"), _asset("report.js") + "\n" + _asset("player.js")
    campaign = report.stored.campaign
    return environment.get_template("page.html").render(
        title=campaign.title if campaign else "Campaign without its record",
        quick=campaign.quick if campaign else False,
        sections=[(section, _body(environment, section)) for section in sections],
        policy=f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; base-uri 'none'; form-action 'none'",
        style=Markup(style),
        script=Markup(script),
    )


def _body(environment: Environment, section: Section) -> Markup:
    return Markup(environment.get_template(section.template).render(section=section, **section.values))


def _asset(name: str) -> str:
    """One of our own files, as it stands between the tags: the hash is over exactly this text."""
    return "\n" + (_HERE / "assets" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_finalized,
    )
    for name in (
        "number",
        "cost",
        "error",
        "seconds",
        "percent",
        "plain",
        "spaced",
        "clean",
        "verdict",
        "count",
        "small",
        "product",
        "unit",
        "capital",
    ):
        environment.filters[name] = getattr(wording, name)
    environment.globals["dash"] = wording.DASH
    environment.globals["windows"] = tolerance.windows_text
    return environment


def _finalized(value: Any) -> Any:
    """Every string that reaches the page without being markup loses its control characters; escaping comes after."""
    return wording.clean(value) if isinstance(value, str) and not isinstance(value, Markup) else value
