"""Cells that must hold and do not: named one by one where they are few, scene by scene where they are many, refusals by their reason."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from reports.pages.judged_cells import direct, scene_by_scene
from reports.pages.table1 import conclude
from reports.record import TraceRecord
from reports.rows import rows_of


def ended(factory, number: int, scene: str, verdict: str, **changes):
    run = factory.run("strict", None, "strict_lcp", key=f"strict-{number}", verdict=verdict, stages=(), **changes)
    return run.model_copy(update={"scene": factory.scene(scene), "pipeline": f"p{number}"})


def test_many_cells_are_told_scene_by_scene(factory):
    runs = [ended(factory, number, "bank", "violates", outcome="solved", message="Too far.") for number in range(10)]
    runs += [
        ended(factory, 10 + number, "bank", "no plan", outcome="refused", message=f"m{number}: scene bank has no wall.")
        for number in range(3)
    ]
    runs += [ended(factory, 20, "hill", "holds", outcome="solved")]
    (sentence,) = direct(tuple(runs), whole=True)
    assert sentence.text == (
        "1 of 14 cells that end in a direct method hold. Of the others 10 violate a limit and 3 are of methods that do not apply to the scene; "
        "scene by scene below."
    )
    bank, hill = scene_by_scene(tuple(runs))
    assert (bank.words, hill.words, hill.sentences) == ("0 of 10 cells hold", "1 of 1 cell holds", [])
    assert [one.text for one in bank.sentences[-2:]] == ["p9: violates. Too far.", "p10, p11 and p12 do not apply: scene bank has no wall."]


def test_few_cells_are_named_where_they_are_counted(factory):
    runs = tuple(ended(factory, number, "bank", "violates", outcome="solved", message="Too far.") for number in range(12))
    assert [one.text for one in direct(runs, whole=True)[1:]] == [f"p{number} on bank: violates. Too far." for number in range(12)]
    assert scene_by_scene(runs) == []


def test_a_cold_cost_of_nought_is_no_whole_to_take_a_part_of(factory):
    cold, warm = factory.run("strict", None, "strict_lcp"), factory.run("softplus_dc+strict", "softplus_dc", "strict_lcp")
    nothing = cold.model_copy(update={"stages": (cold.stages[0].model_copy(update={"cost": 0.0}),)})
    text = " ".join(conclude(rows_of((nothing, warm))))
    assert f"after softplus_dc cost {warm.stages[-1].cost:.2f} at" in text


def test_a_column_longer_than_its_times_is_no_trace():
    with pytest.raises(ValidationError, match="q1 has 3 values at 1 times"):
        TraceRecord.model_validate({"t": [0.0], "columns": {"q1": [0.0, 1.0, 2.0]}})


def test_a_plan_that_violates_says_which_limit_however_its_method_ended(factory):
    (stage,) = factory.run("strict", None, "strict_lcp").stages
    stage = stage.model_copy(
        update={"outcome": "stalled", "verdict": "violates", "why": "the replay misses the goal by 0.1 m, limit 0.05 m"}
    )
    run = factory.run("p", None, "strict_lcp", verdict="violates", outcome="stalled", message="No step lowers the loss.", stages=(stage,))
    told = direct((run,), whole=True)[1].text
    assert told.startswith("p on three_cart: violates. The replay misses the goal by 0.1 m, limit 0.05 m. ")
    assert told.endswith("No step lowers the loss.")
    solved = run.model_copy(update={"outcome": "solved", "message": stage.why})
    assert direct((solved,), whole=True)[1].text == "p on three_cart: violates. The replay misses the goal by 0.1 m, limit 0.05 m."
