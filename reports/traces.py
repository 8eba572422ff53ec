"""Reads the thinned traces of a stage: columns by name, phases of contact, a value between two times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from reports.records.record import SceneRecord, TraceRecord

# A planned force below this is none: a thousandth of the smallest force worth drawing [N].
_FORCE_OF_CONTACT = 1e-3


def column(trace: TraceRecord | None, name: str) -> Sequence[float] | None:
    """The column, or None if the trace lacks it."""
    values = trace.columns.get(name) if trace is not None else None
    return values if values else None


def force(trace: TraceRecord | None, contact: str) -> Sequence[float] | None:
    return column(trace, f"lam_{contact}") or column(trace, contact)


def gap(trace: TraceRecord | None, contact: str) -> Sequence[float] | None:
    return column(trace, f"gap_{contact}")


def contact_phases(trace: TraceRecord | None, contact: str) -> list[tuple[float, float]]:
    """Intervals of time in contact: where the gap is not positive, or where a force acts if no gap is stored."""
    if trace is None:
        return []
    gaps, forces = gap(trace, contact), force(trace, contact)
    if gaps is not None:
        touching = np.asarray(gaps) <= 0
    elif forces is not None:
        touching = np.abs(forces) > _FORCE_OF_CONTACT  # friction has two directions
    else:
        return []
    times = np.asarray(trace.t)[: len(touching)]
    changes = np.flatnonzero(np.diff(touching[: len(times)], prepend=False, append=False))
    # A phase ends at the first time without contact; one that lasts to the end, with the last time.
    ends = times[np.minimum(changes, len(times) - 1)].tolist() if len(times) else []
    return list(zip(ends[::2], ends[1::2], strict=True))


def at_all(times: Sequence[float], values: Sequence[float], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    """The values at many times, linear between the stored times and constant beyond them."""
    length = min(len(times), len(values))
    return np.interp(wanted, times[:length], values[:length])


def position_error(
    scene: SceneRecord, plan: TraceRecord | None, replay: TraceRecord | None
) -> tuple[Sequence[float], Sequence[float]] | None:
    """Times and the largest difference over the coordinates between plan and replay; stored, or computed at the plan's times."""
    stored = column(replay, "position_error")
    if replay is not None and stored is not None:
        return replay.t, stored
    if plan is None or replay is None:
        return None
    pairs = [(column(plan, item.name), column(replay, item.name)) for item in scene.coordinates]
    usable = [(planned, replayed) for planned, replayed in pairs if planned is not None and replayed is not None]
    if not usable or not replay.t:
        return None
    times = np.asarray(plan.t)[: min([len(plan.t), *(len(planned) for planned, _ in usable)])]
    errors = [np.abs(np.asarray(planned)[: len(times)] - at_all(replay.t, replayed, times)) for planned, replayed in usable]
    return times.tolist(), np.max(errors, axis=0).tolist()
