"""The time step of every scene of a campaign, looked at before anything runs, whether it is stable while contacts are closed.

found = time_steps(scenes, Path("runs/all/campaign.json"))     # one record a scene; those of an earlier campaign are used again where the scene is the same
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from pydantic import ValidationError

from models.scene import Scene
from models.scene.text import scene_text
from models.stability import step_stability
from reports.records.record import CampaignRecord, TimeStepRecord


def time_steps(scenes: Iterable[Scene], campaign: Path) -> tuple[TimeStepRecord, ...]:
    """campaign: campaign.json of the folder, which need not be there. Raises MachineError without a compiler."""
    known = {(item.scene, item.digest): item for item in _stored(campaign)}
    found = []
    for scene in scenes:
        digest = hashlib.sha256(scene_text(scene).encode()).hexdigest()
        if (scene.name, digest) in known:
            found.append(known[scene.name, digest])
            continue
        stability = step_stability(scene)
        largest = stability.largest_step if math.isfinite(stability.largest_step) else None
        found.append(TimeStepRecord(**{**asdict(stability), "largest_step": largest, "digest": digest, "warning": stability.sentence}))
    return tuple(found)


def _stored(campaign: Path) -> tuple[TimeStepRecord, ...]:
    try:
        return CampaignRecord.model_validate_json(campaign.read_bytes()).time_steps
    except (OSError, ValidationError):
        return ()
