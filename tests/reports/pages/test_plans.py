"""Foreign plans: the meaning of three answers, the sentence, the page, the table."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import pytest

from models.results.run import OWN_STEP, RunRecord
from models.results.verdict import Question
from reports.foreign import Answers, answers, planned, sentence
from reports.load import Stored
from reports.pages import plans
from reports.pages.section import Report
from reports.render import Templates
from tests.reports import record_factory as factory
from validate.campaign.results import plan_rows


def judged(
    verdict: str,
    by: str = "scene",
    *,
    instance: str = "a",
    cause: str = "unstable",
    missed: float | None = None,
    discrete: Literal["", "yes", "no"] = "",
) -> RunRecord:
    run = factory.run("strict", None, "strict_lcp", key=f"{instance}-{by}", verdict=verdict)
    changes: dict[str, Any] = {"kind": "given", "verdict": verdict, "cause": cause, "paper": {}}
    changes["residuals"] = {} if missed is None else {OWN_STEP: missed}
    changes["questions"] = ((Question.SCHEME, discrete or "not asked"),)
    return replace(
        run,
        instance=instance,
        judged_by=by,
        pipeline="published",
        must_hold=False,
        stages=(replace(run.stages[-1], **changes),),
        scene=factory.scene(instance if by == "scene" else f"{instance}_own_equations"),
    )


def one(*runs: RunRecord) -> Answers:
    (found,) = answers(runs)
    return found


@pytest.mark.parametrize(
    ("missed", "model", "scene", "meaning"),
    [
        (0.1, "holds", "holds", ""),
        (0.1, "holds", "holds with feedback", ""),
        (0.1, "holds", "violates", "wrong model"),
        (0.1, "holds with feedback", "violates", "wrong model"),
        (None, "consistent", "violates", "wrong model"),
        (0.1, "violates", "violates", "coarse grid"),
        (1.1, "violates", "violates", "defect"),
        (1.1, "holds", "violates", "defect"),
        (None, "violates", "violates", "unstable"),
        (0.1, "undecided", "violates", "unstable"),
        (0.1, "holds", "undecided", "unstable"),
    ],
)
def test_meaning_follows_from_three_answers(missed, model: str, scene: str, meaning: str):
    found = one(judged(model, "model", missed=missed), judged(scene, missed=missed))
    assert found.meaning == meaning
    assert found.discrete == {None: "not asked", 0.1: "yes", 1.1: "no"}[missed]


def test_discrete_without_own_step_is_question_six():
    assert one(judged("holds", discrete="no")).discrete == "no"
    assert one(judged("violates", discrete="yes")).discrete == "yes"
    assert one(judged("holds")).model == "not asked"


def test_runs_that_plan_are_no_foreign_plans():
    ours = factory.run("strict", None, "strict_lcp")
    beside = replace(ours, instance="a", judged_by="scene")
    assert answers([ours, beside]) == []
    assert planned([ours, judged("holds")]) == (ours,)
    assert sentence([]) == ""
    assert plans.build(Report(Stored(None, (ours,)))) is None


def test_page_and_table_have_every_plan():
    runs = tuple(
        run
        for name, verdict in (("a", "violates"), ("b", "holds"))
        for run in (
            judged("holds", "model", instance=name, missed=0.1),
            judged(verdict, instance=name, missed=0.1),
        )
    )
    section = plans.build(Report(Stored(None, runs)))
    assert section is not None
    assert section.said == (
        "2 foreign plans: 2 solve their own time step, 2 hold under their own equations, "
        "1 holds under the scene's physics (1 wrong model)."
    )
    page = Templates().render(section.template, section=section, **section.values)
    assert page.count("<tr>") == 3
    assert "wrong model" in page
    table = plan_rows(runs)
    assert [(row["instance"], row["physics"], row["meaning"]) for row in table] == [
        ("a", "violates", "wrong model"),
        ("b", "holds", ""),
    ]
