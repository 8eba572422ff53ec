"""Which of a stage's two replays its verdict is on, and what of it is shown: the open loop, or the one with tracking feedback."""

from __future__ import annotations

from reports.record import MetricRecord, StageRecord, TraceRecord


def is_tracked(stage: StageRecord) -> bool:
    """Whether the verdict is on the tracked replay."""
    return stage.replay is not None and stage.replay.judged == "feedback"


def judged_metric(stage: StageRecord, name: str) -> MetricRecord | None:
    """A metric; where it is the distance of a replay from the goal (replay_terminal..), that of the judged replay."""
    if is_tracked(stage) and name.startswith("replay_terminal"):
        return stage.metric(f"tracked_{name}")
    return stage.metric(name)


def judged_trace(stage: StageRecord) -> TraceRecord | None:
    """The trace of the judged replay, if it has any points."""
    trace = stage.tracked_trace if is_tracked(stage) else stage.replay_trace
    return trace if trace is not None and trace.t else None
