"""Sentences of the summary that tell numbers: of relaxed stages, and of the cheapest plans."""

from __future__ import annotations

from reports.pages import summary
from reports.pages.section import Report
from reports.records.load import Stored


def _sentences(*runs) -> list[str]:
    section = summary.build(Report(Stored("x", None, runs, (), (), 0)))
    assert section is not None
    return [one.text for one in section.values["sentences"]]


def test_relaxed_stages_without_a_plan_are_no_relaxed_stages_that_keep_their_limits(factory):
    run = factory.run("relaxed+strict", "relaxed_lcp", "strict_lcp")
    first, second, third, last = run.stages
    changed = (
        first.model_copy(update={"verdict": "no plan", "metrics": (), "cost": None}),
        second.model_copy(update={"verdict": "violates"}),
        third.model_copy(update={"verdict": "holds"}),
        last,
    )
    (told,) = [text for text in _sentences(run.model_copy(update={"stages": changed})) if "relaxations" in text]
    assert told.startswith(
        "1 of 2 relaxed stages with a plan violates, as relaxations are expected to, missing the goal by 0.0050 to 0.0050 after the replay; "
        "each is judged by all that it claims, its contact forces too."
    )
    assert told.endswith(" holds. 1 other came back without a plan.")
    lost = [stage.model_copy(update={"verdict": "no plan", "metrics": (), "cost": None}) for stage in run.stages[:3]]
    assert "No relaxed stage came back with a plan, of 3." in _sentences(run.model_copy(update={"stages": (*lost, last)}))


def test_a_plan_that_meets_its_goal_to_the_last_bit_reaches_it(factory):
    cheap, exact = factory.run("relu_gd", None, "relu_gd"), factory.run("strict", None, "strict_lcp")
    (stage,) = exact.stages
    metrics = [item.model_copy(update={"value": 0.0}) if item.name == "discrete_terminal_error" else item for item in stage.metrics]
    exact = exact.model_copy(update={"stages": (stage.model_copy(update={"metrics": tuple(metrics), "verdict": "holds"}),)})
    (stage,) = cheap.stages
    cheap = cheap.model_copy(update={"stages": (stage.model_copy(update={"cost": 400.0, "verdict": "holds"}),)})
    (told,) = [text for text in _sentences(cheap, exact) if "cheapest" in text]
    assert "The cheapest that also reaches the goal on its own grid is by strict_lcp: cost 496.63" in told


def test_a_free_end_is_not_told_as_an_error_that_nobody_measured(factory):
    run = factory.run("strict", None, "strict_lcp")
    (stage,) = run.stages
    stage = stage.model_copy(update={"metrics": (), "verdict": "holds"})
    scene = factory.scene()
    free = scene.model_copy(update={"goal": (None,) * len(scene.goal)})
    (told,) = [text for text in _sentences(run.model_copy(update={"stages": (stage,), "scene": free})) if "cheapest" in text]
    assert told.endswith("cost 496.63; the scene leaves its end free.")
    (told,) = [text for text in _sentences(run.model_copy(update={"stages": (stage,)})) if "cheapest" in text]
    assert told.endswith("terminal error after the replay: not measured.")


def _ended(factory, scene: str, name: str, verdict: str, **changes):
    run = factory.run("strict", None, "strict_lcp", key=f"{scene}-{name}", verdict=verdict, **changes)
    return run.model_copy(update={"scene": factory.scene(scene), "pipeline": name})


def test_both_ways_to_hold_count_as_solved_and_are_told_apart(factory):
    runs = [_ended(factory, "bank", "a", "holds"), _ended(factory, "bank", "b", "holds with feedback")]
    runs += [_ended(factory, "hill", "a", "holds with feedback"), _ended(factory, "dale", "a", "violates")]
    runs += [_ended(factory, "moor", "a", "consistent"), _ended(factory, "moor", "b", "not applicable", outcome="refused")]
    told = _sentences(*runs)
    assert "3 of 4 runs that end with exact contact hold, 2 of them with feedback (1 not applicable, 1 consistent)." in told
    assert "a on hill and b on bank hold with feedback, not for the inputs alone." in told or (
        "b on bank and a on hill hold with feedback, not for the inputs alone." in told
    )
    assert "2 of 3 scenes are solved: a plan of them holds, with feedback or without; with feedback alone hill." in told
    section = summary.build(Report(Stored("x", None, tuple(runs), (), (), 0)))
    assert section is not None
    assert section.values["counts"] == {
        "holds": 1,
        "holds with feedback": 2,
        "violates": 1,
        "undecided": 0,
        "no plan": 0,
        "not applicable": 1,
        "consistent": 1,
    }


def test_what_nothing_is_asked_of_is_counted_with_no_holds(factory):
    (told,) = [text for text in _sentences(_ended(factory, "moor", "a", "consistent")) if "exact contact" in text]
    assert told == "No run that ends with exact contact could hold (1 consistent)."
    assert not [text for text in _sentences(_ended(factory, "moor", "a", "consistent")) if "scenes are solved" in text]
