"""The time step of every scene of a campaign, looked at before anything runs: is it stable while contacts are closed?

found = time_steps(scenes, Path("runs/all/campaign.json"))     # one record a scene; those of an earlier campaign are used again where the scene is the same
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from models.scene_text import scene_text
from models.stability import step_stability

if TYPE_CHECKING:
    from models.scene import Scene
    from reports.time_step_record import TimeStepRecord


def time_steps(scenes: Iterable[Scene], campaign: Path) -> tuple[TimeStepRecord, ...]:
    """campaign: campaign.json of the folder, which need not be there. Raises MachineError without a compiler."""
    from reports.time_step_record import TimeStepRecord

    known = {(item.scene, item.digest): item for item in _stored(campaign)}
    found = []
    for scene in scenes:
        digest = hashlib.sha256(scene_text(scene).encode()).hexdigest()
        if (scene.name, digest) in known:
            found.append(known[scene.name, digest])
            continue
        said = step_stability(scene)
        found.append(
            TimeStepRecord(
                scene=scene.name,
                digest=digest,
                step=said.step,
                radius=said.radius,
                contacts=said.contacts,
                growth=said.growth,
                largest_step=said.largest_step if math.isfinite(said.largest_step) else None,
                warning=said.sentence,
            )
        )
    return tuple(found)


def _stored(campaign: Path) -> tuple[TimeStepRecord, ...]:
    from pydantic import ValidationError

    from reports.record import CampaignRecord

    try:
        return CampaignRecord.model_validate_json(campaign.read_bytes()).time_steps
    except (OSError, ValidationError):
        return ()
