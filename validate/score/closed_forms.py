"""What the replay of a scene can be held against where the scene states it in closed form (models.scene_annotations.Answer.measure).

Each measure gives the value and how wrong the replay may make it. They speak of the first contact of the replay: the first that closes, and
the time until that one opens again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from models.dynamics import derive
from validate.replay.result import Event
from validate.score.evidence import Evidence
from validate.score.result import Unmeasured


def _first_contact(case: Evidence) -> tuple[Event, Event]:
    """The events at which the first contact closes and opens."""
    events = case.replay.events
    closing = next((event for event in events if event.closes), None)
    if closing is None:
        raise Unmeasured("no contact closes in the replay.")
    opening = next((event for event in events if not event.closes and event.contact == closing.contact and event.time > closing.time), None)
    if opening is None:
        raise Unmeasured(f"contact {closing.contact} does not open again in the replay.")
    return closing, opening


def _gap_rate(case: Evidence, event: Event) -> float:
    """Rate of the gap of an event's contact at the event [m/s]."""
    row = int(np.argmin(np.abs(case.replay.t - event.time)))
    return _rate(case, row, [contact.name for contact in case.scene.contacts].index(event.contact))


def _rate(case: Evidence, row: int, contact: int) -> float:
    dynamics, replay = derive(case.equations), case.replay
    return float(dynamics.function(dynamics.gap_jacobian, dynamics.q)(replay.q[row])[contact] @ replay.v[row])


def _closing_time(case: Evidence) -> tuple[float, float]:
    closing, _ = _first_contact(case)
    return closing.time, case.error.gap / abs(_gap_rate(case, closing))


def _duration(case: Evidence) -> tuple[float, float]:
    closing, opening = _first_contact(case)
    return opening.time - closing.time, sum(case.error.gap / abs(_gap_rate(case, event)) for event in (closing, opening))


def _restitution(case: Evidence) -> tuple[float, float]:
    before, after = (_gap_rate(case, event) for event in _first_contact(case))
    return -after / before, 2.0 * case.error.state / abs(before)


def _depth(case: Evidence) -> tuple[float, float]:
    """Between the rows of the replay too: the gap there is the cubic with the gaps and their rates at both ends."""
    t, gap = case.replay.t, case.replay.gap
    deepest, contact = np.unravel_index(int(np.argmin(gap)), gap.shape)
    rows = range(max(0, int(deepest) - 1), min(len(t) - 1, int(deepest) + 1))
    s = np.linspace(0.0, 1.0, 2001)  # the depth is flat where it is largest: half a step there is 1e-7 of the fall since the row before
    lowest = 0.0
    for row in rows:
        h = t[row + 1] - t[row]
        ends, rates = gap[row : row + 2, contact], [h * _rate(case, at, int(contact)) for at in (row, row + 1)]
        cubic = (
            (1 + 2 * s) * (1 - s) ** 2 * ends[0] + s * (1 - s) ** 2 * rates[0] + s**2 * (3 - 2 * s) * ends[1] - s**2 * (1 - s) * rates[1]
        )
        lowest = min(lowest, float(cubic.min()))
    return -lowest, case.error.gap


MEASURES: dict[str, Callable[[Evidence], tuple[float, float]]] = {
    "closing time": _closing_time,
    "contact time": _duration,
    "restitution": _restitution,
    "depth": _depth,
}


def answer_error(case: Evidence) -> tuple[float, float]:
    """Largest distance of the replay from a measured answer of the scene, in that answer's tolerance, and its own error in the same unit."""
    distances, errors = [], []
    for answer in case.scene.answers:
        if answer.measure:
            value, error = MEASURES[answer.measure](case)
            distances.append(abs(value - answer.value) / answer.tolerance)
            errors.append(error / answer.tolerance)
    return max(distances), max(errors)
