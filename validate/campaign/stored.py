"""Read the campaign of a folder, and the names of its tasks.

campaign_of(Path("runs/all")).keys
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from models.errors import TouchstoneError
from models.results.run import CampaignRecord
from models.results.stored import from_json
from reports.load import CAMPAIGN, other_version
from validate.store.store import RECORD, Store

# Fields that a campaign without runs leaves unchanged: the report shows the date of the results.
_OF_THE_CALL = ("command", "started", "provenance")


class CampaignError(TouchstoneError):
    """An empty selection, or a folder without a campaign."""


def check_folder(folder: Path, names: Iterable[str]) -> None:
    """Raise CampaignError if a campaign must not write into the folder.

    The folder must not come from another version. A folder without a campaign must not contain files
    of these names.

    names: files that a campaign writes.
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
    """Return the title of a task from its request.

    Raises LookupError or TypeError if the request is damaged.
    """
    if "pipeline" not in task:
        return f"{task['kind']}: {task['name']}"
    return f"{task['scene_name']} x {task['pipeline']['name']}"


def identity(task: Mapping[str, Any]) -> str:
    """Return the name of a task, which does not depend on the task's content.

    Damaged data of a file are accepted.
    """
    pipeline = task.get("pipeline")
    if isinstance(pipeline, Mapping):
        return json.dumps([task.get("scene_name"), pipeline.get("name")])
    return json.dumps([task.get("kind"), task.get("name"), task.get("scene")])


def stored_names(store: Store, keys: Iterable[str]) -> dict[str, str]:
    """Return the titles of the tasks, by key; unreadable tasks are omitted.

    Reading a request takes a hundredth of the time of a record. Records are read only for damaged
    requests.
    """
    names = {}
    for key in keys:
        try:
            names[key] = title_of(store.request(key))
        except (LookupError, TypeError):  # damaged or unknown request
            record = store.read(key)
            if record is not None:
                names[key] = record.title
    return names


def campaign_of(folder: Path) -> CampaignRecord:
    """Return the campaign of a folder. Raises CampaignError."""
    path = folder / CAMPAIGN
    try:
        return from_json(CampaignRecord, path.read_bytes())
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
    """Return the campaign of a folder, None if there is no readable one."""
    with contextlib.suppress(CampaignError):
        return campaign_of(folder)
    return None


def with_others(
    store: Store, earlier: CampaignRecord, selected: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the keys of the selected tasks and of the folder's other stored tasks.

    Each other key keeps its predecessor of the earlier campaign.

    selected: `identity` of a task -> its key.
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
    """Return whether two campaigns differ only in command, date and provenance."""
    return replace(one, **{name: getattr(other, name) for name in _OF_THE_CALL}) == other
