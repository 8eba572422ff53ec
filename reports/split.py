"""The same report as pages in a folder: the summary and the matrix on index.html, a page for each other section, a page for each run.

    write_pages(Path("runs/all"))  ->  runs/all/report/index.html

Nothing is folded, so that every page can be read without its script. Each page is self-contained; only links lead to the others.
"""

from __future__ import annotations

import contextlib
import hashlib
import html
import json
import re
from pathlib import Path

from reports.kept import kept
from reports.pages.section import Section
from reports.records.load import ReportError
from reports.render import Drawn, draw, write_page

INDEX = "index.html"
_FIRST = ("summary", "matrix")
_ARTICLE = re.compile(r'<article class="run" id="([^"]+)".*?</article>', re.DOTALL)
_WHOLE = re.compile(r'<details class="whole"[^>]*>.*?</details>', re.DOTALL)
_TITLE = re.compile(r"<h3[^>]*>(.*?)</h3>", re.DOTALL)
_ANCHOR = re.compile(r' id="([^"]+)"')
_OF_RUN = re.compile(r"run-\d+\.html")
_LINK = re.compile(r' href="#([^"]+)"')


def write_pages(folder: Path) -> Path:
    """Write the pages to the folder `report` in the campaign's folder; the path of the first. Raises ReportError.

    Pages that are there as they were written, of what is still the same, are left as they are; those of runs that the campaign no longer has are
    removed, so that no old address tells of them.
    """
    target = folder / "report"
    pages: dict[str, str] = {}

    def made() -> str:
        pages.update(split(draw(folder)))
        return json.dumps({name: hashlib.sha256(text.encode("utf-8", errors="replace")).hexdigest() for name, text in pages.items()})

    digests = json.loads(kept(folder, "pages", made))
    if not pages and not _stand(target, digests):
        made()
    try:
        target.mkdir(exist_ok=True)
    except OSError as problem:
        raise ReportError(
            f"{target}: the pages cannot be written ({problem.strerror}); free the place or choose another folder."
        ) from problem
    for name, text in pages.items():
        write_page(target / name, text)
    for page in target.glob("run-*.html"):
        if page.name not in digests and _OF_RUN.fullmatch(page.name):
            with contextlib.suppress(OSError):
                page.unlink()
    return target / INDEX


def _stand(target: Path, digests: dict[str, str]) -> bool:
    """Whether each of these pages is there, byte by byte."""
    try:
        return all(hashlib.sha256((target / name).read_bytes()).hexdigest() == digest for name, digest in digests.items())
    except OSError:
        return False


def split(drawn: Drawn) -> dict[str, str]:
    """The text of every page by its file's name; links between them are relative."""
    bodies: dict[str, list[tuple[Section, str]]] = {INDEX: []}
    about: dict[str, str] = {INDEX: ""}
    for section, body in drawn.bodies:
        if section.anchor == "runs":
            listed = _ARTICLE.sub(lambda found: _WHOLE.sub(f'<p><a href="{found[1]}.html">Motion, stages and log</a></p>', found[0]), body)
            bodies["runs.html"], about["runs.html"] = [(section, drawn.parcels.inline(listed))], section.title
            for found in _ARTICLE.finditer(body):
                name = f"{found[1]}.html"
                text = drawn.parcels.inline(found[0].replace('<details class="whole">', '<details class="whole" open>'))
                bodies[name], about[name] = [(Section(f"one-{found[1]}", "Run", ""), text)], _words(found[0])
        elif section.anchor in _FIRST:
            bodies[INDEX].append((section, drawn.parcels.inline(body)))
        else:
            bodies[f"{section.anchor}.html"], about[f"{section.anchor}.html"] = [(section, drawn.parcels.inline(body))], section.title
    # Where an anchor is: on the page of its own run rather than in the list of all of them.
    places = {anchor: name for name, anchors in _anchors(bodies).items() for anchor in anchors}
    return {name: _linked(drawn.page(parts, about=about[name]), name, places) for name, parts in bodies.items()}


def _anchors(bodies: dict[str, list[tuple[Section, str]]]) -> dict[str, list[str]]:
    """Anchors of every page; of those that are on two, the later page counts, and pages of runs come after their list."""
    return {
        name: [anchor for section, text in parts for anchor in (section.anchor, *_ANCHOR.findall(text))] for name, parts in bodies.items()
    }


def _linked(page: str, name: str, places: dict[str, str]) -> str:
    def link(found: re.Match[str]) -> str:
        place = places.get(found[1], name)
        return found[0] if place == name else f' href="{place}#{found[1]}"'

    return _LINK.sub(link, page)


def _words(article: str) -> str:
    """The heading of a run without its markup; it is escaped once more on its way into the title."""
    found = _TITLE.search(article)
    plain = re.sub(r"<[^>]+>", "", found[1]) if found else ""
    return " ".join(html.unescape(plain).split())
