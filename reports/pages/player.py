"""Data of the scene player: shapes, poses of plan and replay, forces, on a common grid of frames."""

from __future__ import annotations

import json
from dataclasses import dataclass

from markupsafe import Markup

from reports.judged import is_tracked, judged_trace
from reports.record import RunRecord, StageRecord, TraceRecord
from reports.traces import at, force

# Frames of a film: smooth at the speed of the clock for a few seconds of motion, and 20 kB a run.
_FRAMES = 151


@dataclass(frozen=True)
class Film:
    """JSON for the script, safe inside a script element."""

    data: Markup
    stage: StageRecord
    words: str


def film(run: RunRecord) -> Film | None:
    """The film of the last stage with poses, or None."""
    shapes = [shape for shape in run.scene.shapes if shape.size]
    stage = next((stage for stage in reversed(run.stages) if _poses(stage.plan_trace) or _poses(judged_trace(stage))), None)
    if stage is None or not shapes:
        return None
    replay = judged_trace(stage)
    tracks = [trace for trace in (stage.plan_trace, replay) if trace is not None and trace.t]
    begin, end = min(trace.t[0] for trace in tracks), max(trace.t[-1] for trace in tracks)
    if end <= begin:
        return None
    times = [begin + (end - begin) * place / (_FRAMES - 1) for place in range(_FRAMES)]
    data = {
        "t": [round(t, 4) for t in times],
        "shapes": [{"name": shape.name, "kind": shape.kind, "size": list(shape.size)} for shape in shapes],
        "plan": _track(stage.plan_trace, [shape.name for shape in shapes], times),
        "replay": _track(replay, [shape.name for shape in shapes], times),
        "contacts": [contact.name for contact in run.scene.contacts],
        "plan_force": _forces(stage.plan_trace, [contact.name for contact in run.scene.contacts], times),
        "replay_force": _forces(replay, [contact.name for contact in run.scene.contacts], times),
    }
    how = "replayed with tracking feedback" if is_tracked(stage) else "replayed"
    words = f"The bodies of {run.scene.name} moving as planned (dashed outline) and as {how} (filled), with the contact forces as bars (above: planned, below: replayed)."
    return Film(script_json(data), stage, words)


def script_json(data: object) -> Markup:
    """JSON that cannot end the script element it stands in; NaN is refused, because JSON has none."""
    return Markup(json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c").replace("\u2028", "\\u2028"))


def _poses(trace: TraceRecord | None) -> bool:
    return trace is not None and bool(trace.t) and any(trace.poses.values())


def _track(trace: TraceRecord | None, names: list[str], times: list[float]) -> list[list[list[float]] | None] | None:
    if trace is None or not trace.t:
        return None
    track: list[list[list[float]] | None] = []
    for name in names:
        poses = trace.poses.get(name)
        if not poses:
            track.append(None)
            continue
        parts = [tuple(pose[axis] for pose in poses) for axis in range(3)]
        track.append([[round(at(trace.t, part, t), 5) for part in parts] for t in times])
    return track


def _forces(trace: TraceRecord | None, contacts: list[str], times: list[float]) -> list[list[float] | None] | None:
    if trace is None or not trace.t:
        return None
    columns = [force(trace, name) for name in contacts]
    return [[round(at(trace.t, values, t), 4) for t in times] if values else None for values in columns]
