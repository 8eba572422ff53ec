"""The campaign that a folder holds: what it was, and what its tasks are called.

campaign_of(Path("runs/all")).keys
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from models.errors import TouchstoneError
from reports.records.load import CAMPAIGN, other_version
from reports.records.record import CampaignRecord
from validate.store.store import RECORD, Store

# What a campaign that ran nothing leaves as it was: the report says when its results were made.
_OF_THE_CALL = ("command", "started", "provenance")


class CampaignError(TouchstoneError):
    """Nothing selected, or a folder that holds no campaign."""


def check_folder(folder: Path, names: Iterable[str]) -> None:
    """Raise CampaignError if another version wrote the folder, or if it has files of these names and no campaign.

    names: of the files that a campaign writes.
    """
    if sentence := other_version(folder):
        raise CampaignError(sentence)
    if (folder / CAMPAIGN).exists() or any(folder.glob(f"runs/*/{RECORD}")):
        return
    taken = [name for name in names if (folder / name).exists()]
    if taken:
        raise CampaignError(
            f"--out {folder}: it holds no campaign, but {' and '.join(taken)}, which a campaign would replace; name a folder that is new, or a campaign's."
        )


def title_of(task: Mapping[str, Any]) -> str:
    """What a task is called, of what was asked for.

    Raises LookupError or TypeError where that is damaged.
    """
    if "pipeline" not in task:
        return f"{task['kind']}: {task['name']}"
    return f"{task['scene_name']} x {task['pipeline']['name']}"


def identity(task: Mapping[str, Any]) -> str:
    """What a task is called, whatever its content.

    Of data that came from a file, and may be damaged.
    """
    pipeline = task.get("pipeline")
    if isinstance(pipeline, Mapping):
        return json.dumps([task.get("scene_name"), pipeline.get("name")])
    return json.dumps([task.get("kind"), task.get("name"), task.get("scene")])


def stored_names(store: Store, keys: Iterable[str]) -> dict[str, str]:
    """Key -> what the task is called. Tasks of which nothing can be read are left out.

    It is read from what was asked for, in a hundredth of the time of the record; only where that is
    damaged from the record.
    """
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
    path = folder / CAMPAIGN
    try:
        return CampaignRecord.model_validate_json(path.read_bytes())
    except OSError as error:
        raise CampaignError(
            f"{folder}: there is no campaign in this folder ({CAMPAIGN} cannot be read); run one with --out {folder}."
        ) from error
    except ValidationError as error:
        sentence = (
            other_version(folder)
            or f"{path}: it is damaged ({error.error_count()} fields do not fit); run the campaign again."
        )
        raise CampaignError(sentence) from error


def found_campaign(folder: Path) -> CampaignRecord | None:
    """The campaign of a folder; None where there is none that can be read."""
    with contextlib.suppress(CampaignError):
        return campaign_of(folder)
    return None


def with_others(
    store: Store, earlier: CampaignRecord, selected: Mapping[str, str]
) -> tuple[str, ...]:
    """The keys of a part of the campaign that a folder holds and of all its other runs that are stored, each behind what it stood behind.

    selected: what a task of the part is called (`identity`) -> its key.
    """
    keys, place = list(selected.values()), 0
    for key in earlier.keys:
        task = store.request(key)
        mine = key if key in keys else selected.get(identity(task))
        if mine is None and task and (store.runs / key / RECORD).is_file():
            keys.insert(place, key)
            mine = key
        if mine is not None:
            place = keys.index(mine) + 1
    return tuple(keys)


def same_campaign(one: CampaignRecord, other: CampaignRecord) -> bool:
    """Whether two campaigns differ in nothing but when and how they were called."""
    return one.model_copy(update={name: getattr(other, name) for name in _OF_THE_CALL}) == other
