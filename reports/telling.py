"""Tells of a record as soon as it is stored: its outline and its section are kept beside the campaign, so that the page is only put together later.

    tell(Path("runs/all"), text)        text: of a record.json in that folder

The templates are compiled when this is imported: processes that are forked after that find them so.
"""

from __future__ import annotations

from pathlib import Path

from reports.article import TEMPLATE, written
from reports.outlines import Outlines
from reports.templating import Templates

_TEMPLATES = Templates()
_TEMPLATES.compile(TEMPLATE, "macros.html")


def tell(folder: Path, text: bytes) -> None:
    """Keep in DIR/.told what a report of this folder needs of a record. Raises pydantic's ValidationError."""
    Outlines(folder, lambda run: written(_TEMPLATES, run)).read(text)
