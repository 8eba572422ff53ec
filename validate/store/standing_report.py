"""Whether the report of a folder still says what is so: then a campaign that ran nothing need not write it again.

    before = campaign_text(folder)                                  # before campaign.json is written anew, if its content is another
    report = standing_report(folder, before) or write_report(folder)

It stands if it is younger than every record and source of the report, and the campaign differs in nothing but when and how it was
called.
"""

from __future__ import annotations

import json
from pathlib import Path

from validate.execution.process import ROOT
from validate.store.stored import CAMPAIGN

REPORT = "report.html"
# What a campaign that ran nothing leaves as it was told: the report says when its results were made.
_OF_THE_CALL = ("command", "started", "provenance")
# What damaged content raises where it is read.
_NO_CAMPAIGN = (ValueError, AttributeError, RecursionError)


def campaign_text(folder: Path) -> str:
    """What a folder's campaign is, apart from the call; empty if there is none that can be read."""
    try:
        return of_content((folder / CAMPAIGN).read_bytes())
    except (OSError, *_NO_CAMPAIGN):
        return ""


def of_content(campaign: str | bytes) -> str:
    """Of the text of a campaign.json, what is not of the call. Raises one of _NO_CAMPAIGN for what is none."""
    return json.dumps({name: value for name, value in json.loads(campaign).items() if name not in _OF_THE_CALL}, sort_keys=True)


def standing_report(folder: Path, before: str) -> Path | None:
    """The report of the folder if it stands, else None. before: `campaign_text` when the report was written."""
    report = folder / REPORT
    sources = (*folder.glob("runs/*/record.json"), *(ROOT / "reports").rglob("*.*"))
    try:
        written = report.stat().st_mtime_ns
        young = any(path.stat().st_mtime_ns >= written for path in sources if "__pycache__" not in path.parts)
    except OSError:
        return None
    return report if before and not young and campaign_text(folder) == before else None
