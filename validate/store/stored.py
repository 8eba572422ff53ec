"""The campaign that a folder holds: what it was, and which of its cells failed.

campaign, records = stored_campaign(Path("runs/all"))
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from validate.plan.runs import CampaignError, PlannedCheck, PlannedRun, identity
from validate.store.store import Store

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import CampaignRecord, RunRecord

CAMPAIGN = "campaign.json"
# What a campaign that ran nothing leaves as it was told: the report says when its results were made.
_OF_THE_CALL = ("command", "started", "provenance")
# What damaged content raises where it is read.
_NO_CAMPAIGN = (ValueError, AttributeError, RecursionError)


def stored_campaign(folder: Path) -> tuple[CampaignRecord, tuple[RunRecord | ExaminationRecord, ...]]:
    """The campaign of a folder and those of its cells that are stored, in order. Raises CampaignError."""
    campaign = campaign_of(folder)
    store = Store(folder)
    found = (store.read(key) for key in campaign.keys)
    return campaign, tuple(record for record in found if record is not None)


def title_of(cell: Mapping[str, Any]) -> str:
    """What a cell is called, of what was asked for. Raises LookupError or TypeError where that is damaged."""
    if "pipeline" not in cell:
        return f"{cell['kind']}: {cell['name']}"
    pipeline = cell["pipeline"]
    part = "" if not pipeline["part"] else " ({} of {})".format(*pipeline["part"])
    return f"{cell['scene_name']} x {pipeline['name']}{part}"


def stored_names(store: Store, keys: Iterable[str]) -> dict[str, str]:
    """Key -> what the cell is called, by what was asked for, which is read in a hundredth of the time of its record; only where that cannot be read by
    the record. Cells of which there is neither are left out."""
    names = {}
    for key in keys:
        try:
            names[key] = title_of(store.request(key))
        except (LookupError, TypeError):  # damaged, or of nothing that is known
            record = store.read(key)
            if record is not None:
                names[key] = record.title
    return names


def campaign_of(folder: Path) -> CampaignRecord:
    """The campaign of a folder. Raises CampaignError."""
    from pydantic import ValidationError

    from reports.records.record import CampaignRecord

    path = folder / CAMPAIGN
    try:
        return CampaignRecord.model_validate_json(path.read_bytes())
    except OSError as error:
        raise CampaignError(
            f"{folder}: there is no campaign in this folder ({CAMPAIGN} cannot be read); run one with --out {folder}."
        ) from error
    except ValidationError as error:
        if sentence := earlier_schema(folder):
            raise CampaignError(f"{sentence.partition(': ')[0]}; run the campaign again.") from error
        raise CampaignError(
            f"{path}: it is damaged, or of another version ({error.error_count()} fields do not fit); run the campaign again."
        ) from error


def earlier_schema(folder: Path) -> str:
    """Why nothing of a folder is used again whose campaign was recorded by another version; empty where there is none, or it is of this one."""
    from reports.records.record import SCHEMA_VERSION

    try:
        version = json.loads((folder / CAMPAIGN).read_bytes())["schema_version"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return ""
    if version == SCHEMA_VERSION:
        return ""
    return (
        f"{folder} holds the records of schema {version!s:.20}, which hold other things than those of schema {SCHEMA_VERSION}: "
        "none of them is used, and what is selected is run again."
    )


def only_last_failed(entries: Sequence[PlannedRun | PlannedCheck], store: Store) -> list[PlannedRun | PlannedCheck]:
    """Of these cells those that failed when the folder's campaign last ran, to be run anew, and those that are stored, as they are.

    What is neither is left out. Raises CampaignError where there is no campaign, or nothing of this choice failed.
    """
    from reports.rule import failed_keys

    _, records = stored_campaign(store.folder)
    failed = {identity(store.request(key)) for key in failed_keys(records)}
    again = {entry.cell.key for entry in entries if identity(entry.cell.to_json()) in failed}
    if not again:
        hint = "drop --last-failed."
        if failed:
            named = sorted(" x ".join(str(part) for part in json.loads(name)[:2]) for name in failed)
            more = f" and {len(named) - 3} more" if len(named) > 3 else ""
            hint = f"what did is not selected ({', '.join(named[:3])}{more}): select it as it was, by -k, --scene, --plugin or the file of `run`."
        raise CampaignError(f"nothing to run: nothing that is selected failed when the campaign in {store.folder} last ran; {hint}")
    why = "it failed the last time"
    return [
        replace(entry, stored=None, why=why) if entry.cell.key in again else entry
        for entry in entries
        if entry.cell.key in again or entry.stored is not None
    ]


def campaign_text(folder: Path) -> str:
    """What a folder's campaign is, apart from the call; empty if there is none that can be read."""
    try:
        return of_content((folder / CAMPAIGN).read_bytes())
    except (OSError, *_NO_CAMPAIGN):
        return ""


def of_content(campaign: str | bytes) -> str:
    """Of the text of a campaign.json, what is not of the call. Raises one of _NO_CAMPAIGN for what is none."""
    return json.dumps({name: value for name, value in json.loads(campaign).items() if name not in _OF_THE_CALL}, sort_keys=True)
