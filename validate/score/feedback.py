"""Metrics of the replay with feedback, and what the feedback took.

Each metric of the replay has a twin there: `replay_error` and `tracked_replay_error`, `ghost_impulse` and `tracked_ghost_impulse`; the same limits hold.
The effort is limited: feedback that does more than correct a plan makes another one, and it is the plan that is to hold.
"""

from __future__ import annotations

import numpy as np

from validate.replay.feedback import Effort
from validate.replay.result import Growth
from validate.score.evidence import Evidence
from validate.score.result import LeavesBounds, Question, Unmeasured
from validate.score.table import TABLE, Entry
from validate.score.verdict import EFFORT, SHARE, TRACKED

# Exact plans whose step is coarse for the contact (h w = 0.9) need up to 0.23 to be followed through an impact, others some hundredths; plans with
# force from a distance need 0.65 to 1.1 where that force matters.
_MOST_EFFORT = (0.25, "a quarter of what the inputs can give, in the root mean square, corrects a plan; more makes another one")
_MOST_SHARE = (0.5, "half of what the plan itself gives, in the root mean square, corrects a plan; more makes another one")


def feedback_entries(effort: Effort | None) -> list[Entry]:
    """Rows of the replay with feedback; effort: None where there was no feedback."""
    if effort is None:
        return []
    return [*(_twin(entry) for entry in TABLE if entry.of_replay), *FEEDBACK]


def _twin(entry: Entry) -> Entry:
    return Entry(
        name=f"{TRACKED}{entry.name}", question=entry.question, unit=entry.unit, meaning=f"with feedback: {entry.meaning}",
        measure=lambda case: entry.measure(case.tracked), applies=entry.applies, needs=entry.needs, default=entry.default,
    )  # fmt: skip


def limit_name(name: str) -> str:
    """By which metric a scene limits this one."""
    return name.removeprefix(TRACKED)


def _effort(case: Evidence) -> Effort:
    replay = case.opened.tracked
    if replay is None or replay.effort is None:
        raise Unmeasured("the replay had no feedback.")
    return replay.effort


def _bounded_effort(case: Evidence) -> float:
    if not any(np.isfinite((item.lower, item.upper)).all() for item in case.scene.inputs):
        raise Unmeasured("the inputs have no bounds.")
    return _effort(case).rms_share


def _plan_share(case: Evidence) -> float:
    share = _effort(case).plan_share
    if share is None:
        raise LeavesBounds("the plan's own inputs are zero: all that moves it is the feedback's.")
    return share


def _growth(case: Evidence) -> Growth:
    if case.opened.growth is None:
        raise Unmeasured("the true contact law leads out of every bound.")
    return case.opened.growth


FEEDBACK = (
    Entry(
        name=EFFORT, question=Question.MOTION, unit=lambda scene: "1", measure=_bounded_effort,
        applies=lambda scene: any(np.isfinite((item.lower, item.upper)).all() for item in scene.inputs), default=_MOST_EFFORT,
        meaning="root mean square of what the feedback added to the plan's inputs, as a share of half their range; the largest over the inputs",
    ),
    Entry(
        name=SHARE, question=Question.MOTION, unit=lambda scene: "1", measure=_plan_share, default=_MOST_SHARE,
        meaning="root mean square of what the feedback added, as a share of that of the plan's own inputs, all inputs in halves of their ranges",
    ),
    Entry(
        name="feedback_peak", question=Question.SHOWN, unit=lambda scene: "1", measure=lambda case: _effort(case).peak_share,
        meaning="largest value of what the feedback added, as a share of half the range",
    ),
    Entry(
        name="feedback_saturated", question=Question.SHOWN, unit=lambda scene: "1", measure=lambda case: _effort(case).saturated,
        meaning="share of the steps in which the feedback stood at a bound",
    ),
)  # fmt: skip
GROWTH = (
    Entry(
        name="amplification", question=Question.SHOWN, unit=lambda scene: "1", measure=lambda case: _growth(case).amplification,
        meaning="how many times larger an error of the state may become along the plan in the open loop (nominals as units)",
    ),
    Entry(
        name="growth_rate", question=Question.SHOWN, unit=lambda scene: "1/s", measure=lambda case: _growth(case).rate,
        meaning="rate with which amplification = exp(rate T)",
    ),
)  # fmt: skip
