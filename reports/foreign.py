"""Foreign plans and the three questions: own discrete equations, own continuous equations, physics.

    for one in answers(runs):
        one.instance, one.discrete, one.model, one.scene, one.meaning

The answers come from records: the run of a plan on the physics, and on the scene of the plan's own
equations if there is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from models.results.run import OWN_STEP, RunRecord
from models.results.verdict import HOLD, Question
from reports.wording import count, listing, spaced

NOT_ASKED = "not asked"
WRONG_MODEL = "wrong model"
COARSE_GRID = "coarse grid"
# Verdicts without a fault, and the plural of each in a sentence.
_GOOD = {
    **dict(zip(HOLD, ("hold", "hold with feedback"), strict=True)),
    "consistent": "are consistent",
}
# Singular of the verdicts that need another verb.
_ONE = {"consistent": "is consistent"}


@dataclass(frozen=True)
class Answers:
    """One plan of one instance.

    Attributes
    ----------
    run
        The run on the physics.
    own
        The run on the plan's own equations, if there is one.
    discrete
        Answer to the question of the plan's own time step: yes, no, undecided or not asked.
    """

    instance: str
    plan: str
    run: RunRecord
    own: RunRecord | None
    discrete: str

    @property
    def model(self) -> str:
        """The verdict under the plan's own continuous equations."""
        return NOT_ASKED if self.own is None else self.own.verdict

    @property
    def scene(self) -> str:
        """The verdict under the physics."""
        return self.run.verdict

    @property
    def meaning(self) -> str:
        """Return the meaning of the three answers together, or the judge's cause."""
        if self.scene in _GOOD:
            return ""
        if self.discrete == "no":
            return "defect"
        if self.model in _GOOD and self.scene == "violates":
            return WRONG_MODEL
        if self.discrete == "yes" and self.model == "violates":
            return COARSE_GRID
        return self.run.last.cause if self.run.last else ""


def is_given(run: RunRecord) -> bool:
    """Return whether the run judges a plan from a file, and plans nothing."""
    return run.last is not None and run.last.kind == "given"


def planned(runs: Sequence[RunRecord]) -> tuple[RunRecord, ...]:
    """Return the runs that plan."""
    return tuple(run for run in runs if not is_given(run))


def answers(runs: Sequence[RunRecord]) -> list[Answers]:
    """Return the answers for each foreign plan, in the order of the campaign."""
    given = [run for run in runs if run.instance and is_given(run)]
    models = {(run.instance, run.pipeline): run for run in given if run.judged_by == "model"}
    found = []
    for run in given:
        if run.judged_by != "scene":
            continue
        own = models.get((run.instance, run.pipeline))
        found.append(Answers(run.instance, run.pipeline, run, own, _discrete(own or run)))
    return found


def _discrete(run: RunRecord) -> str:
    """Return whether a plan solves its own discrete equations.

    The equations are a time step of the user, or a scheme of ours that the plan declares.
    """
    stage = run.stages[-1]
    if (missed := stage.residuals.get(OWN_STEP)) is not None:
        return "yes" if missed <= 1.0 else "no"
    if stage.options.get("time_step"):
        return "undecided"
    found = (answer for question, answer in stage.questions if question is Question.SCHEME)
    return next(found, NOT_ASKED)


def sentence(found: Sequence[Answers]) -> str:
    """Return the counts of the three answers in one sentence; empty without foreign plans."""
    if not found:
        return ""
    parts = []
    if any(one.discrete != NOT_ASKED for one in found):
        solving = sum(one.discrete == "yes" for one in found)
        parts.append(
            "1 solves its own time step" if solving == 1 else f"{solving} solve their own time step"
        )
    if any(one.own is not None for one in found):
        parts.append(f"{_holding([one.model for one in found])} under their own equations")
    parts.append(f"{_holding([one.scene for one in found])} under the scene's physics")
    meanings = [one.meaning for one in found if one.meaning]
    causes = [f"{meanings.count(cause)} {spaced(cause)}" for cause in dict.fromkeys(meanings)]
    why = f" ({', '.join(causes)})" if causes else ""
    return f"{count(len(found), 'foreign plan')}: {', '.join(parts)}{why}."


def _holding(verdicts: Sequence[str]) -> str:
    """Return how many hold, in words: 7 hold and 3 hold with feedback."""
    words = []
    for name, several in _GOOD.items():
        number = verdicts.count(name)
        if number:
            words.append(f"{number} {_ONE.get(name, name) if number == 1 else several}")
    return listing(words) or "0 hold"
