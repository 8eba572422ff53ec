"""Sweeps: which runs are one, along which number, and what is drawn of them; seeds as a spread."""

import re

import pytest
from wording import unsaid

from reports.pages import sweeps, tightening
from reports.pages.section import Report
from reports.records.load import Stored
from reports.records.record import RunRecord, SceneRecord


def scene(factory, name: str, **changes) -> SceneRecord:
    """Three carts with another stiffness, start, or grid."""
    plain = factory.scene(name)
    k = changes.pop("k", 30.0)
    parameters = tuple(item.model_copy(update={"value": k}) if item.name == "k" else item for item in plain.parameters)
    return plain.model_copy(update={"parameters": parameters, **changes})


def run(factory, name: str, where: SceneRecord, cost: float, verdict: str = "holds", error: float = 0.01, **options) -> RunRecord:
    one = factory.run("strict", None, "strict_lcp", key=f"{name}-{where.name}", verdict=verdict)
    (stage,) = one.stages
    metrics = tuple(item.model_copy(update={"value": error}) if item.name == "replay_error" else item for item in stage.metrics)
    stage = stage.model_copy(update={"cost": cost, "verdict": verdict, "metrics": metrics, "options": {**stage.options, **options}})
    return one.model_copy(update={"pipeline": name, "scene": where, "stages": (stage,)})


def found(*runs: RunRecord) -> list[sweeps.Sweep]:
    section = sweeps.build(Report(Stored("x", None, runs, (), (), 0)))
    return [] if section is None else section.values["sweeps"]


def marks(plot) -> list[tuple[float, float]]:
    """Pixels of the marks of a plot."""
    return [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', str(plot.markup(hidden=False)))]


def test_seeds_are_a_spread_about_their_median(factory):
    where = scene(factory, "bank")
    runs = [run(factory, f"draws seed {seed}", where, cost, seed=seed) for seed, cost in enumerate((480.0, 500.0, 610.0))]
    far = [
        run(factory, f"draws seed {seed}", scene(factory, "bank_k_60", k=60.0), cost, "holds" if seed else "violates", seed=seed)
        for seed, cost in enumerate((700.0, 710.0, 720.0))
    ]
    (sweep,) = found(*runs, *far)
    assert sweep.axis.name == "k"
    assert {item.curve for item in sweep.runs} == {"draws"}
    assert not unsaid(sweep.words, "k = 30 N/m (3 of 3 seeds) and 60 N/m (2 of 3 seeds).")
    cost = sweep.first[0]
    assert cost.words.startswith("draws: 5 to 7.1"), "medians times 0.01 s"
    drawn = str(cost.markup(hidden=False))
    assert drawn.count("draws, spread") == 2
    (alone,) = found(*runs)
    assert (alone.axis.name, alone.words) == ("seed", "3 of 3 seeds hold.")


def test_two_swept_numbers_are_curves_over_the_one_with_more_values(factory):
    runs = [
        run(factory, "strict", scene(factory, f"s_{k}_{start}", k=k, start=(start, 3.0, 4.0, 0.0, 0.0, 0.0)), k * start)
        for k in (1.0, 2.0, 3.0)
        for start in (1.5, 2.0)
    ]
    (sweep,) = found(*runs)
    assert sweep.axis.name == "k"
    assert [key.words for key in sweep.keys] == ["start q1 = 1.5 m", "start q1 = 2 m"]


def test_what_goes_with_the_axis_is_told_by_it(factory):
    """The length of a step with the number of steps, over one horizon; costs of several grids are not put side by side."""
    runs = [run(factory, "strict", scene(factory, f"s_{steps}", steps=steps, step=5.0 / steps), 4.9 * steps) for steps in (100, 200, 400)]
    (sweep,) = found(*runs)
    assert sweep.keys == []
    assert [item.run.integral_cost for item in sweep.runs] == [pytest.approx(24.5)] * 3
    assert not unsaid(sweep.words, "Grids differ: … integral costs, not sums")
    assert "Integral cost (cost times h) against step h" not in [plot.title for plot in sweep.first], "24.5 on every grid: nothing to draw"


def test_an_option_of_many_values_is_swept_over_pipelines_that_are_named_after_it(factory):
    where = scene(factory, "bank")
    runs = [run(factory, f"work {work}", where, 500.0 - work, work=work) for work in (1, 10, 100)]
    (sweep,) = found(*runs)
    assert (sweep.axis.name, [item.x for item in sweep.runs]) == ("strict_lcp work", [1.0, 10.0, 100.0])
    assert sweep.first[0].x.log, "two powers of ten"
    assert found(*runs[:2]) == [], "two pipelines are two pipelines"


def test_runs_that_differ_in_more_than_numbers_are_no_sweep(factory):
    where = scene(factory, "bank")
    assert found(run(factory, "a", where, 1.0, rule="x"), run(factory, "b", where, 2.0, rule="y")) == []
    assert found(run(factory, "a", where, 1.0), run(factory, "a", factory.scene("hill"), 2.0)) == [], "nothing differs but the name"
    many = [
        run(factory, "a", scene(factory, f"s{place}", k=float(place), start=tuple(float(place + item) for item in range(6))), 1.0 + place)
        for place in range(3)
    ]
    assert found(*many) == [], "seven numbers at once are another scene"
    assert found(*factory.runs()) == []


def test_metrics_are_drawn_against_eps_on_the_page_of_the_scene(factory, tmp_path):
    report = Report(Stored("x", None, tuple(factory.runs()), (), (), 0), tmp_path)
    section = tightening.build(report, report.scenes[0])
    plots = {plot.title: plot for plot in section.values["against"]}
    off = plots["Replay terminal position error against ε"]
    values = [0.8 * value for value in (0.4512, 0.2666, 0.1201)]
    expected = [(off.px(eps), off.py(value)) for eps, value in zip((1e-3, 1e-5, 1e-7), values, strict=True)]
    drawn = marks(off)
    assert all(any(place == pytest.approx(other, abs=0.06) for other in drawn) for place in expected)
    assert len(section.values["keys"]) == 3
