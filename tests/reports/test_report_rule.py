"""The rule of a campaign, case by case, on records."""

import html
import re
from dataclasses import replace
from pathlib import Path

import pytest
from wording import unsaid

from reports.render import write_report
from reports.rule import RESULTS, RULE, failures


def words_of(folder: Path) -> str:
    """The text of a campaign's report."""
    return " ".join(
        html.unescape(
            re.sub(r"<[^>]*>", " ", write_report(folder).read_text(encoding="utf-8"))
        ).split()
    )


def ended(
    factory,
    outcome: str,
    verdict: str,
    *,
    scene: str = "bank",
    direct: bool = True,
    paper: bool = False,
    pipeline: str = "strict",
):
    run = factory.run(
        pipeline,
        None,
        "strict_lcp",
        outcome=outcome,
        verdict=verdict,
        must_hold=direct,
        message="a reason.",
    )
    place = replace(run.scene, name=scene)
    last = replace(
        run.stages[-1],
        **{
            "outcome": outcome,
            "verdict": verdict,
            "why": "a limit",
            **({} if paper else {"paper": {}}),
        },
    )
    return replace(run, scene=place, stages=(*run.stages[:-1], last))


@pytest.mark.parametrize(
    "outcome", ["iteration_limit", "time_limit", "stalled", "diverged", "infeasible", "refused"]
)
@pytest.mark.parametrize("verdict", ["violates", "undecided", "no plan"])
def test_an_honest_ending_is_a_result(factory, outcome: str, verdict: str):
    assert failures([ended(factory, "solved", "holds"), ended(factory, outcome, verdict)]) == ()


def test_a_scene_needs_a_cell_that_holds_once_a_direct_method_ran(factory):
    stuck = ended(factory, "iteration_limit", "violates")
    relaxed = ended(factory, "solved", "violates", direct=False, pipeline="softplus_dc")
    assert failures([stuck, relaxed]) == ("bank: no run holds (strict iteration limit, violates)",)
    assert failures([relaxed]) == (), "nothing direct was selected"
    assert failures([ended(factory, "refused", "not applicable"), relaxed]) == (), (
        "nothing direct ran"
    )
    assert failures([stuck, ended(factory, "solved", "holds", direct=False)]) == ()
    elsewhere = ended(factory, "solved", "holds", scene="other")
    assert (
        failures([stuck], among=[stuck, ended(factory, "solved", "holds", pipeline="mpcc")]) == ()
    ), "an earlier run of the folder holds"
    assert failures([stuck, elsewhere]) == (
        "bank: no run holds (strict iteration limit, violates)",
    ), "another scene does not help"


def test_feedback_is_enough_only_on_a_scene_that_says_that_it_is_unstable(factory):
    run = ended(factory, "solved", "holds with feedback")
    assert failures([run]) == ("bank x strict: holds with feedback - a limit",)
    unstable = replace(run, scene=replace(run.scene, unstable="It falls over."))
    assert failures([unstable]) == ()
    good = ended(factory, "solved", "holds")
    stuck = ended(factory, "iteration_limit", "violates")
    assert failures([stuck, unstable]) == (), "either word solves a scene"
    assert failures([stuck, good]) == ()


def test_a_scene_that_asks_for_nothing_needs_no_plan_that_holds(factory):
    assert failures([ended(factory, "solved", "consistent")]) == ()
    assert failures([ended(factory, "solved", "undecided")]) == (
        "bank x strict: undecided - a limit",
        "bank: no run holds (strict solved, undecided)",
    )


@pytest.mark.slow
def test_the_report_says_the_rule_and_its_verdict_in_these_words(factory, tmp_path):
    good = words_of(factory.store(tmp_path / "good", [factory.run("strict", None, "strict_lcp")]))
    assert "All required checks passed." in good
    assert all(sentence in good for sentence in (*RULE, *RESULTS))
    bad = words_of(factory.store(tmp_path / "bad", [ended(factory, "crashed", "no plan")]))
    assert not unsaid(bad, "bank x strict: crashed - a reason.")
