"""The command that repeats one run, and no other of its campaign.

again(record)       python -m validate run mine.toml -k '="three_cart x strict"' --fresh --out runs/again
"""

from __future__ import annotations

import shlex

from reports.records.check_record import CheckRecord
from reports.records.record import RunRecord

# Options of a campaign that say where its scenes and methods come from and how long they have; and others that take a word.
_KEPT = ("--scene", "--plugin", "--tools", "--time-limit")  # --tools: in records from before it was called --plugin
_WITH_A_WORD = (*_KEPT, "-k", "-j", "--jobs", "--out", "--retry", "--engine")


def again(record: RunRecord | CheckRecord) -> str:
    """Into a folder of its own, because a campaign of one run would take the place of the whole one; the recorded command, if it is no campaign's."""
    try:
        words = shlex.split(record.provenance.command)
    except ValueError:
        return record.provenance.command
    if words[1:3] != ["-m", "validate"] or words[3:4] not in (["all"], ["run"]):
        return record.provenance.command
    title = record.title if isinstance(record, CheckRecord) else f"{record.scene.name} x {record.pipeline}"
    quoted = title.replace('"', '""')
    return shlex.join([*words[:4], *_kept(words[4:]), "-k", f'="{quoted}"', "--fresh", "--out", "runs/again"])


def _kept(words: list[str]) -> list[str]:
    """Of the words of a campaign's command those that say which runs there are: the options above and the campaign's file."""
    kept: list[str] = []
    place = 0
    while place < len(words):
        word = words[place]
        width = 2 if word in _WITH_A_WORD else 1
        # What belongs to no option is the campaign's file, whatever it is called.
        if word in _KEPT or word.startswith(tuple(f"{option}=" for option in _KEPT)) or not word.startswith("-"):
            kept += words[place : place + width]
        place += width
    return kept
