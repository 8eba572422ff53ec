"""Verdict on a plan, and the names of its metrics."""

from __future__ import annotations

from enum import StrEnum


class Verdict(StrEnum):
    """Verdict on a plan, as the word of tables, files and sentences.

    - `holds`: all questions are answered yes for the inputs alone.
    - `holds with feedback`: only with limited feedback.
    - `violates`: one certainly fails.
    - `undecided`: none fails, one is undecided.
    - `no plan`: nothing to judge.
    - `not applicable`: the method does not apply, or neither claims nor goals exist.
    - `consistent`: nothing is wrong, and there is no goal.
    """

    HOLDS = "holds"
    HOLDS_WITH_FEEDBACK = "holds with feedback"
    VIOLATES = "violates"
    UNDECIDED = "undecided"
    NO_PLAN = "no plan"
    NOT_APPLICABLE = "not applicable"
    CONSISTENT = "consistent"

    @property
    def is_good(self) -> bool:
        """Return whether the plan holds, with or without feedback."""
        return self in HOLD


# Verdicts of plans that hold.
HOLD = (Verdict.HOLDS, Verdict.HOLDS_WITH_FEEDBACK)
# Prefix of metrics with feedback.
TRACKED = "tracked_"
# Prefix of metrics of the feedback's effort.
FEEDBACK = "feedback_"
