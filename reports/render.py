"""Writes the report of a campaign: one self-contained file that asks nothing of any network.

    write_report(Path("runs/all"))  ->  runs/all/report.html

The page is a pure function of the records in the folder: no clock, no machine, no solver. A strict Content-Security-Policy
allows exactly the style and the script that are inside it, by their hashes.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import os
import socket
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from reports.article import written
from reports.kept import kept
from reports.outlines import Outlines
from reports.pages import (
    errata,
    fmus,
    front,
    matrix,
    pareto,
    provenance,
    runs,
    scene,
    stability,
    summary,
    table1,
    tightening,
    time_spent,
    tolerance,
    violation,
)
from reports.pages.section import Report, Section
from reports.parcels import Block, Parcels, Token
from reports.records.load import ReportError, Stored, load
from reports.shelf import Shelf
from reports.templating import Templates

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
    errata,
    time_spent,
    provenance,
)
# A page of this many characters is there at once in any browser; what would be longer folds its long parts.
LARGEST_PLAIN = 2_000_000
# A section shorter than this stays as it is: unfolding it would cost more than it saves.
_SMALL = 20_000
_SCRIPTS = ("report.js", "fold.js", "matrix.js", "tables.js", "player.js")


@dataclass(frozen=True)
class Drawn:
    """A report whose sections are drawn, and not yet put on pages; bodies: markup with tokens of `parcels`."""

    report: Report
    parcels: Parcels
    templates: Templates
    shelf: Shelf
    bodies: list[tuple[Section, Token]]

    @property
    def title(self) -> str:
        campaign = self.report.stored.campaign
        return campaign.title if campaign else "Campaign without its record"

    def page(self, sections: list[tuple[Section, str]], blocks: Sequence[Block] = (), about: str = "") -> str:
        """One page with these sections; the contents name all of them. `about`: what this page is, where there are several."""
        campaign = self.report.stored.campaign
        return page(
            self.templates,
            self.parcels,
            title=self.title,
            about=about,
            quick=campaign.quick if campaign else False,
            lead="Does this plan through contact hold? Every plan below was replayed through the true contact dynamics and scored there.",
            again="python -m reports DIR",
            contents=[section for section, _ in self.bodies],
            sections=sections,
            blocks=blocks,
        )


def page(templates: Templates, parcels: Parcels, *, sections: list[tuple[Section, str]], **words: Any) -> str:
    """A page of sections whose texts are markup, with its style and script; words: what else page.html tells."""
    style, script = _asset("report.css"), "\n".join(_asset(name) for name in _SCRIPTS)
    return templates.render(
        "page.html",
        parcels,
        sections=[(section, Markup(text)) for section, text in sections],
        policy=f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; base-uri 'none'; form-action 'none'",
        style=Markup(style),
        script=Markup(script),
        **words,
    )


def write_report(folder: Path) -> Path:
    """Render the records of a campaign's folder to its report.html; the text of before is used again if nothing changed. Raises ReportError."""
    target = folder / "report.html"
    write_page(target, kept(folder, "report", lambda: render(folder)))
    return target


def write_page(target: Path, text: str) -> None:
    """Write a page, whole or not at all. Raises ReportError.

    What is not finished says whose it is, as in all of a campaign's folder, so that it is removed there if we are killed.
    """
    part = target.with_name(f".partial-page-{uuid.uuid4().hex}-{os.getpid()}-{socket.gethostname()}")
    try:
        part.write_bytes(text.encode("utf-8", errors="replace"))
        os.replace(part, target)
    except OSError as problem:
        with contextlib.suppress(OSError):
            part.unlink()
        raise ReportError(
            f"{target}: the report cannot be written ({problem.strerror}); free the place or choose another folder."
        ) from problem


def render(folder: Path, *, largest: int = LARGEST_PLAIN) -> str:
    """The page's text; parts of it are folded if it is longer than `largest` characters otherwise. Raises ReportError if there is no such folder."""
    drawn = draw(folder)
    parcels, bodies = drawn.parcels, [body for _, body in drawn.bodies]
    texts, blocks = [parcels.inline(body) for body in bodies], []
    if sum(map(len, texts)) > largest:
        texts, blocks = parcels.folded(bodies, drawn.shelf.kept)
    drawn.shelf.tidy()
    return drawn.page([(section, text) for (section, _), text in zip(drawn.bodies, texts, strict=True)], blocks)


def draw(folder: Path) -> Drawn:
    """All sections of a campaign's report. Raises ReportError if there is no such folder."""
    templates, parcels = Templates(), Parcels()
    outlines = _outlines(folder, templates)
    report = Report(load(folder, outlines.read), outlines, parcels)
    sections = [section for part in _PAGES if (section := part.build(report)) is not None]
    bodies = [(section, _body(templates, parcels, section)) for section in sections]
    return Drawn(report, parcels, templates, outlines.shelf, bodies)


def outlined(folder: Path) -> Stored:
    """What the report is made of, without traces: for tables beside it. Raises ReportError if there is no such folder."""
    return load(folder, _outlines(folder, Templates()).read)


def _outlines(folder: Path, templates: Templates) -> Outlines:
    return Outlines(folder, lambda run: written(templates, run))


def _body(templates: Templates, parcels: Parcels, section: Section) -> Token:
    body = templates.render(section.template, parcels, section=section, **section.values)
    return parcels.keep(section.anchor, body) if section.folds and len(body) > _SMALL else Token(body)


def _asset(name: str) -> str:
    """One of our own files, as it stands between the tags: the hash is over exactly this text."""
    return "\n" + (_HERE / "assets" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
