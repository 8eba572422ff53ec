"""Figures of the tracked replay and of the feedback, and which replay the limits are for.

Each figure of a replay in continuous time has a twin in the tracked replay: `replay_terminal_error` and `tracked_terminal_error`, `ghost_impulse` and
`tracked_ghost_impulse`. A scene limits the first; the limit goes to the twin where the tracked replay is the one that is judged (`Replay.judged`).
What needs no replay - the plan's forces, its inputs under the true law on its own grid - is judged either way. So is the effort: feedback that does
more than correct a plan makes another one, and it is the plan that is to hold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from models.scene_annotations import Limit
from validate.replay.feedback import Effort
from validate.replay.growth import Growth
from validate.replay.result import Replay
from validate.replay.subject import Subject
from validate.score.evidence import Evidence, Unmeasured
from validate.score.table import TABLE, Entry
from validate.score.verdict import EFFORT, TWINS

# Exact plans whose step is coarse for the contact (h w = 0.9) need up to 0.23 to be followed through an impact, others some hundredths; plans with
# force from a distance need 0.65 to 1.1 where that force matters.
EFFORT_LIMIT = Limit(
    figure=EFFORT,
    value=0.25,
    reason="a quarter of what the inputs can give, in the root mean square, corrects a plan; more makes another one",
)


@dataclass(frozen=True)
class Asked:
    """A row of the table, and the scene's limit that it is held against, if any."""

    entry: Entry
    limit: Limit | None


def asked(scene: Subject, replay: Replay | None) -> list[Asked]:
    """Every figure that applies, in the order of the table, then those of growth, tracked replay and feedback."""
    tracked = replay is not None and replay.judged is not replay
    rows = [Asked(entry, None if tracked and entry.name in TWINS else scene.limit(entry.name)) for entry in TABLE if entry.applies(scene)]
    if replay is None or replay.growth is None:
        return rows
    rows += [Asked(entry, None) for entry in _GROWTH]
    if replay.tracked is not None:
        rows += [
            Asked(_twin(entry), scene.limit(entry.name) if tracked else None)
            for entry in TABLE
            if entry.name in TWINS and entry.applies(scene)
        ]
        rows.append(Asked(_FEEDBACK[0], (scene.limit(EFFORT) or EFFORT_LIMIT) if tracked else None))
        rows += [Asked(entry, None) for entry in _FEEDBACK[1:]]
    return rows


def judged_words(replay: Replay | None) -> str:
    """What the verdict's sentence begins with where there are two replays: which one is judged, why, and what the feedback took."""
    if replay is None or replay.tracked is None or replay.growth is None or replay.tracked.effort is None:
        return ""
    times = f"an error may grow {_rounded(replay.growth.amplification)} times"
    if replay.judged is replay:
        return f"judged in the open loop, where {times}: "
    effort = replay.tracked.effort
    return (
        f"judged with tracking feedback, because in the open loop {times}; the feedback took {_rounded(100 * effort.rms_share)} % of half the inputs' range "
        f"(root mean square), at most {_rounded(100 * effort.peak_share)} %: "
    )


def _rounded(value: float) -> str:
    """Two digits, without a power of ten up to a million: 5600, 0.34."""
    text = float(f"{value:.2g}")
    return f"{text:.0f}" if 10.0 <= text < 1e6 else f"{text:g}"


def _twin(entry: Entry) -> Entry:
    def measure(case: Evidence) -> float | tuple[float, float]:
        return entry.measure(case.tracked)

    return Entry(name=TWINS[entry.name], unit=entry.unit, meaning=f"with tracking feedback: {entry.meaning}", measure=measure)


def _entry(name: str, unit: str, meaning: str, measure: Callable[[Evidence], float]) -> Entry:
    return Entry(name=name, unit=lambda scene: unit, meaning=meaning, measure=measure)


def _growth(case: Evidence) -> Growth:
    if case.opened.growth is None:
        raise Unmeasured("the true contact law leads out of every bound.")
    return case.opened.growth


def _effort(case: Evidence) -> Effort:
    replay = case.tracked.replay
    if replay.effort is None:
        raise Unmeasured("the replay had no feedback.")
    return replay.effort


_GROWTH = (
    _entry(
        "amplification", "1", "how many times larger an error of the state may become along the plan in the open loop (nominals as units)",
        lambda case: _growth(case).amplification,
    ),
    _entry("growth_rate", "1/s", "rate with which amplification = exp(rate T)", lambda case: _growth(case).rate),
)  # fmt: skip
_FEEDBACK = (
    _entry(
        EFFORT, "1", "root mean square of what the feedback added to the plan's inputs, as a share of half their range; the largest over the inputs",
        lambda case: _effort(case).rms_share,
    ),
    _entry("feedback_peak", "1", "largest value of what the feedback added, as a share of half the range", lambda case: _effort(case).peak_share),
    _entry("feedback_saturated", "1", "share of the steps in which the feedback stood at a bound", lambda case: _effort(case).saturated),
)  # fmt: skip
