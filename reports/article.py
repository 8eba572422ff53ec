"""The section of one run as text that knows neither its number nor its rows': made from its record alone, so it can be kept with it.

article = written(templates, run);  article.placed(parcels, "run-7", [3, 4, None], opened=False)  ->  the token of the section on its page
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

from reports.pages.runs import view_of
from reports.parcels import CLOSES, OPENS, Parcels, Token
from reports.records.record import RunRecord
from reports.templating import Templates

TEMPLATE = "article.html"
# Marks that are filled on the page: its parts by number, the anchor, whether it is open, the row of each stage.
ANCHOR, OPEN = Token(f"{OPENS}a{CLOSES}"), Token(f"{OPENS}o{CLOSES}")
_MARK = re.compile(f"{OPENS}(\\d+|a|o|r\\d+){CLOSES}")


@dataclass(frozen=True)
class Article:
    """`text` with marks; parts: (block, text with marks) of what a large page folds, inner ones first."""

    text: str
    parts: tuple[tuple[str, str], ...]

    def placed(self, parcels: Parcels, anchor: str, rows: Sequence[int | None], *, opened: bool) -> Token:
        """The section on a page; rows: of each stage, the number of its row in the tables, None where another run tells it."""
        tokens: list[str] = []

        def filled(found: re.Match[str]) -> str:
            mark = found[1]
            if mark == "a":
                return anchor
            if mark == "o":
                return " open" if opened else ""
            if mark.startswith("r"):
                row = rows[int(mark[1:])]
                return f"row {row}, " if row else ""
            return tokens[int(mark)]

        for block, text in self.parts:
            tokens.append(parcels.keep(block, _MARK.sub(filled, text)))
        return Token(_MARK.sub(filled, self.text))

    def to_json(self) -> str:
        return json.dumps([self.text, self.parts], ensure_ascii=False)

    @classmethod
    def from_json(cls, text: str) -> Article:
        """Raises ValueError."""
        told, parts = json.loads(text)
        return cls(told, tuple((block, part) for block, part in parts))


def written(templates: Templates, run: RunRecord) -> Article:
    """The section of a run, from its whole record."""
    parcels = Parcels()
    rows = [Token(f"{OPENS}r{place}{CLOSES}") for place in range(len(run.stages))]
    text = templates.render(TEMPLATE, parcels, view=view_of(run), anchor=ANCHOR, opened=OPEN, rows=rows)
    return Article(text, parcels.parts)
