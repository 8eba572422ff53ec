"""What failed, by cause: each cause once with its runs by scene, the campaign's own failures marked, and what cannot be read."""

import html
import re
from dataclasses import replace

from wording import unsaid

from models.results.check import CheckRecord
from reports.load import Stored, Unreadable, load
from reports.pages import overview
from reports.pages.section import Report
from reports.render import render
from reports.rule import RESULTS, RULE


def ended(factory, scene: str, pipeline: str, verdict: str, outcome: str = "solved", **changes):
    run = factory.run(
        "strict", None, "strict_lcp", key=f"{scene}-{pipeline}", verdict=verdict, outcome=outcome
    )
    metrics = tuple(
        replace(item, value=0.43, limit=0.05, ok=False)
        if item.name == "replay_terminal_position_error"
        else item
        for item in run.stages[0].metrics
    )
    said = {
        "verdict": verdict,
        "outcome": outcome,
        "paper": {},
        "metrics": metrics if verdict == "violates" else (),
        **changes,
    }
    return replace(
        run, scene=factory.scene(scene), pipeline=pipeline, stages=(replace(run.stages[0], **said),)
    )


def section(*runs):
    return overview.what_failed(Report(Stored(None, runs)))


def words(text: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())


def test_a_cause_stands_once_with_its_runs_by_scene(factory):
    runs = [
        ended(factory, "bank", "a", "violates"),
        ended(factory, "hill", "b", "no plan", "infeasible"),
        ended(factory, "hill", "a", "violates"),
    ]
    runs += [ended(factory, "bank", "b", "violates"), ended(factory, "bank", "c", "holds")]
    motion, none = section(*runs).values["groups"]
    assert (motion.amount, none.amount) == (3, 1)
    assert [
        (name, limit, [item.run.pipeline for item in mine])
        for name, _, limit, mine in motion.scenes
    ] == [
        ("bank", "0.050 m", ["a", "b"]),
        ("hill", "0.050 m", ["a"]),
    ]
    assert motion.scenes[0][3][0].by == "0.43 m"
    assert none.scenes[0][3][0].by == ""
    assert section(*runs).values["total"] == 4


def test_runs_that_fail_the_campaign_are_marked_and_others_are_not(factory, tmp_path):
    runs = [
        ended(factory, "bank", "broke", "violates"),
        ended(factory, "bank", "stopped", "violates", "stalled"),
        ended(factory, "bank", "good", "holds"),
    ]
    (group,) = section(*runs).values["groups"]
    assert [(item.run.pipeline, item.must) for _, _, _, mine in group.scenes for item in mine] == [
        ("broke", True),
        ("stopped", False),
    ]
    text = words(render(factory.store(tmp_path / "all", runs)))
    assert "The campaign fails: bank x broke: violates" in text
    assert not unsaid(text, "bank (limit 0.050 m): ✗ … campaign: broke 0.43 m, stopped 0.43 m")
    sound = words(render(factory.store(tmp_path / "sound", runs[1:])))
    assert not unsaid(sound, "✓ All required checks passed … not a failure of the campaign")


def test_where_all_holds_nothing_is_listed(factory, tmp_path):
    text = words(render(factory.store(tmp_path / "all", [ended(factory, "bank", "a", "holds")])))
    assert "All required checks passed." in text
    assert "does not hold" not in text.partition("When a campaign fails")[0]
    assert section().values["asked"] is False


def test_many_files_of_one_reason_are_folded_and_few_are_named(factory, tmp_path):
    runs = [ended(factory, f"scene_{place}", "a", "holds") for place in range(14)]
    folder = factory.store(tmp_path / "all", runs)
    for run in runs[:13]:
        (folder / "runs" / run.key / "record.json").write_text("{}")
    (folder / "runs" / runs[13].key / "record.json").write_text("[")
    values = overview.what_failed(Report(load(folder), folder)).values
    assert [len(files) for _, files in values["unreadable"]] == [13, 1]
    text = render(folder)
    assert re.search(r"<details><summary>13 files: ", text)
    assert f"<code>runs/{runs[13].key}/record.json</code>: it is not complete JSON" in text


def test_what_was_asked_and_whether_all_of_it_is_there(factory):
    run = ended(factory, "bank", "a", "holds")

    def values(*runs, unreadable=(), missing=(), checks=()):
        return overview.what_failed(
            Report(Stored(None, runs, unreadable, missing, 0, checks))
        ).values

    check = CheckRecord(
        key="c", kind="FMU", name="n", expected="", outcome="answered", passed=False,
        found="it is wrong.", wall_seconds=1.0, cpu_seconds=1.0,
        provenance=factory.provenance(),
    )  # fmt: skip
    assert [values()["asked"], values(run)["asked"], values(checks=(check,))["asked"]] == [
        False,
        True,
        True,
    ]
    cut = (Unreadable("a", "it is cut."),)
    assert [
        values(run)["whole"],
        values(run, unreadable=cut)["whole"],
        values(run, missing=("gone",))["whole"],
    ] == [True, False, False]
    assert values(run, missing=("gone",))["missing"] == ("gone",)
    assert values(run, unreadable=cut)["unreadable"] == [("it is cut.", ["a"])]
    assert (
        values(run, checks=(check,))["broken"],
        values(run)["few"],
        values(run)["campaign"],
    ) == (
        ("FMU: n: failed - it is wrong.",),
        12,
        None,
    )
    assert (values()["rule"], values()["results"]) == (RULE, RESULTS)


def test_a_limit_is_told_where_runs_share_it_and_a_link_to_each_scene(factory):
    runs = [ended(factory, "bank", name, "violates") for name in ("a", "b")]
    (stage,) = runs[1].stages
    other = tuple(
        replace(item, limit=0.07) if item.limit == 0.05 else item for item in stage.metrics
    )
    runs[1] = replace(runs[1], stages=(replace(stage, metrics=other),))
    (group,) = section(*runs).values["groups"]
    ((name, link, limit, mine),) = group.scenes
    assert (name, link, limit, [(item.by, item.limit, item.link) for item in mine]) == (
        "bank", "pages/scene-bank.html", "",
        [("0.43 m", "0.050 m", "pages/bank--a.html"), ("0.43 m", "0.070 m", "pages/bank--b.html")],
    )  # fmt: skip
    assert section().anchor == "failures"
    assert section().title == "What failed, by cause"
