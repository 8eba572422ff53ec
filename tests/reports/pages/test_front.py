"""Cost against terminal error, and CPU time against error and cost: every mark at its values, and fronts as staircases."""

from dataclasses import replace

import pytest
from wording import unsaid

from models.results.run import RunRecord
from reports.load import Stored
from reports.pages import overview, pareto
from reports.pages.section import Report
from reports.plots import Axis, Plot
from tests.reports.drawn import Mark, drawn
from tests.reports.record_factory import judged, ran, scene

POSITION = "replay_terminal_position_error"
VELOCITY = "replay_terminal_velocity_error"
# Style and marker in the legend: the four families, and what holds.
KEYS = [
    ("c1", "circle"),
    ("c3", "circle"),
    ("c0", "circle"),
    ("c2", "circle"),
    ("c2 full", "circle"),
]


def ended(
    name: str,
    position: float | None,
    cost: float | None,
    verdict: str = "holds",
    velocity: float = 0.5,
    **changes,
) -> RunRecord:
    metrics = (
        () if position is None else (judged(POSITION, position), judged(VELOCITY, velocity, "m/s"))
    )
    return ran(name, *metrics, cost=cost, verdict=verdict, **changes)


def report(*runs: RunRecord) -> Report:
    return Report(Stored(None, runs))


def section(*runs: RunRecord) -> dict:
    told = report(*runs)
    found = pareto.ends(told, told.scenes[0])
    assert (found.anchor, found.title) == ("front-1", "Cost against terminal error")
    return found.values


def test_every_stage_stands_at_its_error_and_cost_and_the_front_is_a_staircase():
    runs = [
        ended("far", 0.4, 100.0, "violates", 0.1), ended("near", 0.1, 300.0, velocity=0.4),
        ended("dear", 0.2, 400.0, "undecided"), ended("middle", 0.2, 200.0),
        ended("exact", 0.0, 600.0), ended("lost", None, 5.0), ended("unpriced", 0.3, None),
    ]  # fmt: skip
    found = section(*runs)
    positions, velocities = found["plots"]
    assert drawn(positions).marks == [
        Mark(
            "c2",
            "circle",
            "far: cost 100.00, position 0.40 m, velocity 0.10 m/s, violates",
            "pages/three_cart--far.html",
            (0.4, 100.0),
        ),
        Mark(
            "c2 full",
            "circle",
            "near: cost 300.00, position 0.10 m, velocity 0.40 m/s, holds",
            "pages/three_cart--near.html",
            (0.1, 300.0),
        ),
        Mark(
            "c2",
            "circle",
            "dear: cost 400.00, position 0.20 m, velocity 0.50 m/s, undecided",
            "pages/three_cart--dear.html",
            (0.2, 400.0),
        ),
        Mark(
            "c2 full",
            "circle",
            "middle: cost 200.00, position 0.20 m, velocity 0.50 m/s, holds",
            "pages/three_cart--middle.html",
            (0.2, 200.0),
        ),
        Mark(
            "c2 full",
            "circle",
            "exact: cost 600.00, position 0 m, velocity 0.50 m/s, holds",
            "pages/three_cart--exact.html",
            (1e-12, 600.0),
        ),
    ]
    top, right = float(f"{positions.y.high:.4g}"), float(f"{positions.x.high:.4g}")
    path = [
        (1e-12, top), (1e-12, 600.0), (0.1, 600.0), (0.1, 300.0), (0.2, 300.0), (0.2, 200.0),
        (0.4, 200.0), (0.4, 100.0), (right, 100.0),
    ]  # fmt: skip
    style, corners = drawn(positions).lines["front"]
    assert (style, corners) == ("front", [pytest.approx(place, rel=2e-4) for place in path])
    assert not unsaid(
        positions.words,
        "5 stages; … exact (cost 600.00 at 0), near (… 300.00 at 0.10), middle (… 200.00 at 0.20) and far (… 100.00 at 0.40).",
    )
    assert [row.label for row in found["best"]] == ["exact", "near", "middle", "far"]
    assert [row.label for row in found["absent"]] == ["lost", "unpriced"]
    assert (positions.title, positions.x.quantity, positions.x.unit) == (
        "Cost against terminal position error, after the replay", "terminal position error", "m",
    )  # fmt: skip
    assert (velocities.title, velocities.x.quantity, velocities.x.unit) == (
        "Cost against terminal velocity error, after the replay", "terminal velocity error", "m/s",
    )  # fmt: skip
    assert [mark.at for mark in drawn(velocities).marks] == [
        (0.1, 100.0),
        (0.4, 300.0),
        (0.5, 400.0),
        (0.5, 200.0),
        (0.5, 600.0),
    ]
    assert drawn(positions).lines["best known cost of an exact plan: 490.55"][1][0][1] == 490.6
    assert (
        positions.x.log,
        positions.y.log,
        positions.y.quantity,
        positions.width,
        positions.height,
    ) == (True, False, "cost", 720, 400)
    assert positions.y.high == pytest.approx(650.0), "a tenth of 500 above 600"
    assert positions.x.high == pytest.approx(0.4 * 10 ** (0.06 * 11.60206), rel=1e-6)
    assert {words for style, words in drawn(positions).tags if style == "strong"} == {
        "exact",
        "near",
        "middle",
        "far",
    }
    assert [(key.style, key.marker) for key in positions.keys] == [*KEYS, ("front", "")]


@pytest.mark.parametrize(("dearest", "log"), [(2000.0, False), (2001.0, True)])
def test_costs_that_span_more_than_twenty_are_logarithmic(dearest: float, log: bool):
    (plot, _) = section(ended("a", 0.1, dearest), ended("b", 0.2, 100.0))["plots"]
    assert plot.y.log is log
    assert section(ended("a", 0.1, dearest), ended("b", 0.2, -100.0))["plots"][0].y.log is False


def test_without_a_known_cost_there_is_no_level_and_units_that_differ_are_not_told():
    bare = replace(scene(), answers=())
    other = ran("other", judged(POSITION, 0.3, "rad"), cost=9.0, of=bare)
    told = section(ran("one", judged(POSITION, 0.2), cost=5.0, of=bare), other)
    (plot,) = told["plots"]
    assert (list(drawn(plot).lines), plot.x.unit) == (["front"], "")
    assert plot.y.low == pytest.approx(4.6)
    empty = report(ended("a", None, None))
    assert pareto.ends(empty, empty.scenes[0]) is None


@pytest.mark.parametrize(
    ("method", "style"),
    [
        ("relaxed_lcp", "c1"),
        ("softplus_dc", "c1"),
        ("softplus_gd", "c3"),
        ("relu_gd", "c3"),
        ("strict_lcp", "c0"),
        ("mpcc", "c2"),
    ],
)
def test_a_mark_is_of_the_family_of_its_method_and_filled_where_the_plan_holds(
    method: str, style: str
):
    for verdict, words in (("holds", f"{style} full"), ("violates", style)):
        (errors, _) = section(ended(method, 0.1, 5.0, verdict))["plots"]
        assert [mark.style for mark in drawn(errors).marks] == [words]


def test_of_points_with_one_error_the_cheaper_is_unbeaten_and_equal_costs_are_beaten():
    points = [
        (2.0, 5.0, "b"),
        (1.0, 7.0, "dear"),
        (1.0, 6.0, "a"),
        (3.0, 5.0, "same"),
        (4.0, 4.0, "c"),
    ]
    assert [name for _, _, name in pareto.unbeaten(points)] == ["a", "b", "c"]  # pyright: ignore[reportArgumentType]


def test_no_points_have_no_staircase():
    plot = Plot("none", Axis("x", "", 0.0, 1.0), Axis("y", "", 0.0, 1.0))
    pareto.draw_front(plot, [])
    assert drawn(plot).lines == {}


def replayed(
    name: str,
    error: float | None,
    cost: float | None,
    cpu: float,
    verdict: str = "holds",
    ends: bool | None = True,
    **changes,
) -> RunRecord:
    far = judged("replay_terminal_position_error", 0.04, limit=0.06, ok=ends)
    return ran(
        name,
        judged("replay_error", error, reason="it crashed.", limit=0.02),
        far,
        cost=cost,
        cpu=cpu,
        verdict=verdict,
        **changes,
    )


def speed(*runs: RunRecord) -> list:
    told = report(*runs)
    found = pareto.build(told, told.scenes[0])
    return found.values["views"]


def test_cpu_time_is_drawn_against_error_and_against_cost():
    runs = [
        replayed("quick", 0.02, 500.0, 2.0), replayed("best", 0.001, 400.0, 8.0),
        replayed("wrong", 0.5, 90.0, 1.0, "violates", False),
        replayed("tick", 1e-13, 450.0, 1e-4, "undecided", None),
        replayed("loose", 0.03, 300.0, 4.0, "violates"),
    ]  # fmt: skip
    error, cost = speed(*runs)
    ends = "ends off the goal by position 0.040 m"
    assert drawn(error[0]).marks == [
        Mark("c2 full", "circle",
             f"quick, pipeline quick, stage 1: 2.00 CPU s, replay error 0.020, {ends}, holds",
             "pages/three_cart--quick.html", (2.0, 0.02)),
        Mark("c2 full", "circle",
             f"best, pipeline best, stage 1: 8.00 CPU s, replay error 0.0010, {ends}, holds",
             "pages/three_cart--best.html", (8.0, 0.001)),
        Mark("c2", "circle",
             f"wrong, pipeline wrong, stage 1: 1.00 CPU s, replay error 0.50, {ends}, violates",
             "pages/three_cart--wrong.html", (1.0, 0.5)),
        Mark("c2", "circle",
             f"tick, pipeline tick, stage 1: 0.001 CPU s, replay error 3.0×10⁻⁹, {ends}, undecided",
             "pages/three_cart--tick.html", (1e-3, 3e-9)),
        Mark("c2", "circle",
             f"loose, pipeline loose, stage 1: 4.00 CPU s, replay error 0.030, {ends}, violates",
             "pages/three_cart--loose.html", (4.0, 0.03)),
    ]  # fmt: skip
    assert [mark.at for mark in drawn(cost[0]).marks] == [
        (2.0, 500.0),
        (8.0, 400.0),
        (4.0, 300.0),
    ], "those that end where the scene allows"
    assert drawn(cost[0]).lines["front"][1][1:-1] == [(2.0, 500.0), (8.0, 500.0), (8.0, 400.0)], (
        "of those that hold"
    )
    assert not unsaid(cost[1], "Not compared … 2 plans.")
    assert drawn(error[0]).lines["front"][1][1] == (1e-3, 3e-9), "of all"
    assert (error[0].y.quantity, error[0].y.unit, error[0].y.log, error[0].x.unit) == (
        "replay error",
        "m",
        True,
        "s",
    )
    assert [(view[0].width, view[0].height) for view in (error, cost)] == [(720, 400)] * 2
    assert [(key.style, key.marker) for key in cost[0].keys] == [*KEYS, ("front", "")]
    assert [key.words for key in cost[0].keys] == [
        "relaxed contact", "gradient descent", "exact contact", "ours", "filled: holds",
        "front: no stage is both faster and better",
    ]  # fmt: skip
    assert (cost[0].y.quantity, cost[0].y.log, cost[0].x.quantity) == (
        "cost",
        False,
        "CPU time, with the stages before",
    )
    level = next(words for words in drawn(cost[0]).lines if words != "front")
    assert not unsaid(level, "best known … 490.55")
    assert not unsaid(
        cost[0].words,
        "3 stages; on the front … first: quick (2.00 s, 500.00) and best (8.00 s, 400.00).",
    )
    assert error[0].x.low == pytest.approx(1e-3 * 10 ** -(0.06 * 3.90309), rel=1e-6)
    assert error[0].y.high == pytest.approx(0.5 * 10 ** (0.06 * 8.22185), rel=1e-4)


@pytest.mark.parametrize(
    ("least", "log"), [(24.6, False), (24.5, True), (0.0, False), (-5.0, False)]
)
def test_costs_far_apart_are_logarithmic(least: float, log: bool):
    """The best known cost, 490.55, is one of them."""
    assert speed(replayed("a", 0.01, least, 1.0))[1][0].y.log is log


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ([(1.0, 0.01)], "No other plan … better, whatever"),
        ([(1.0, 0.01), (1.04, 0.001)],
         "takes as long, 1.04 s (b): replay error 0.0010 m, 10 times nearer … nothing further."),
        ([(1.0, 0.01), (1.06, 0.00951)], "No other plan … more than 5 %, whatever"),
        ([(1.0, 0.01), (1.06, 0.00949)], "takes 1.1 times as long, 1.06 s (b)"),
        ([(1.0, 0.01), (2.0, 0.00951), (3.0, 0.005)],
         "by more than 5 % takes 3.0 times as long, 3.00 s (c)"),
        ([(1.0, 0.02), (2.0, 2e-5)], "1000 times nearer to its replay. More"),
        ([(1.0, 0.02), (2.0, 1.9e-5)], "more than 1000 times nearer … More"),
        ([(2.0, 0.02), (4.0, 0.01), (20.0, 0.002)],
         "takes 10 times as long as the first, 20.00 s (c): … 0.0020 m, 10 times nearer"),
    ],
)  # fmt: skip
def test_what_more_time_buys(steps: list[tuple[float, float]], said: str):
    error = speed(
        *(
            replayed(name, missed, 500.0, cpu)
            for name, (cpu, missed) in zip("abc", steps, strict=False)
        )
    )[0]
    assert not unsaid(error[1], said)
    assert not unsaid(error[1], f"least CPU time … {steps[0][0]:.2f} s (a), replay error ")


@pytest.mark.parametrize(
    ("costs", "said"),
    [
        ((400.0, 300.0), "cost 300.00, 25 % cheaper. More"),
        ((400.0, 399.7), "No other plan … more than 0.1 %"),
        ((400.0, 399.5), "0.12 % cheaper"), ((0.0, -3.0), "cost −3.00, cheaper. More"),
        ((-2.0, -3.0), "cost −3.00, cheaper. More"),
    ],
)  # fmt: skip
def test_what_more_time_saves(costs: tuple[float, ...], said: str):
    cost = speed(
        *(
            replayed(name, 0.01, price, cpu)
            for name, cpu, price in zip("ab", (1.0, 2.0), costs, strict=True)
        )
    )[1]
    assert not unsaid(cost[1], said)


def test_of_a_stage_that_holds_with_feedback_that_replay_counts():
    run = replayed("followed", 0.6, 500.0, 1.0, "holds with feedback", False)
    (one,) = run.stages
    assert one.replay is not None
    tracked = (
        judged("tracked_replay_error", 0.004, limit=0.02),
        judged("tracked_replay_terminal_position_error", 0.01, limit=0.06, ok=True),
    )
    stage = replace(
        one, metrics=(*one.metrics, *tracked), replay=replace(one.replay, judged="feedback")
    )
    error, cost = speed(replace(run, stages=(stage,)))
    assert [mark.at for mark in drawn(error[0]).marks] == [(1.0, 0.004)]
    assert [mark.style for mark in drawn(cost[0]).marks] == ["c2 full"]
    assert "followed, which holds with feedback" in error[1]


def test_where_no_replay_is_limited_the_plans_own_grid_decides():
    grid = judged("discrete_terminal_error", 0.1, limit=0.05, ok=False)
    (error,) = speed(ran("off", judged("replay_error", 0.01), grid, cost=5.0))
    assert error[0].title == "CPU time against replay error"
    assert len(speed(ran("free", judged("replay_error", 0.01), cost=5.0))) == 2, (
        "nothing is limited: the end is free"
    )


def test_why_a_method_has_no_point():
    told = report(
        ran("lost", outcome="time_limit", verdict="no plan", message="it was late. And more."),
        ran("mute", outcome="crashed", verdict="no plan", message=""),
        ran("unknown", judged("replay_error", None, reason="the FMU crashed.")),
        replayed("good", 0.01, 5.0, 1.0), ran("refuses", outcome="refused", verdict="no plan"),
    )  # fmt: skip
    found = pareto.build(told, told.scenes[0])
    assert found is not None
    assert [(row.label, why) for row, why in found.values["failed"]] == [
        ("lost", "time limit, no plan: it was late"), ("mute", "crashed, no plan"),
        ("unknown", "its replay error is not known: the FMU crashed."),
    ]  # fmt: skip
    assert found.values["refused"] == ["refuses"]
    assert (found.anchor, found.title) == ("pareto-1", "All methods: speed against error")
    nothing = report(ran("lost", outcome="crashed", verdict="no plan"))
    empty = pareto.build(nothing, nothing.scenes[0])
    assert empty.values["views"] == []
    assert not unsaid(empty.values["nothing"], "No stage … could be replayed")


def test_where_nothing_holds_or_nothing_is_planned_it_says_so():
    bad = replayed("bad", 0.3, 490.0, 1.0, "violates")
    assert not unsaid(speed(bad)[0][1], "None of 1 plan holds")
    told = report(replace(bad, scene=replace(bad.scene, inputs=())))
    free = pareto.build(told, told.scenes[0])
    assert (free.values["views"], free.values["failed"], free.values["nothing"][:28]) == (
        [],
        [],
        "This scene has no inputs: no",
    )


def test_the_first_screen_has_speed_against_error_of_all_scenes():
    """Pipelines that hold on all three scenes have a median.

    One that is slower and worse than another is not named.
    """
    scenes = [scene(name) for name in ("bank", "hill", "moor")]
    runs = [
        ran(name, judged("replay_error", error * factor), cpu=cpu * factor, of=where,
            verdict=verdict)
        for name, cpu, error,
        verdict in (("fast", 1.0, 0.02, "holds"), ("exact", 4.0, 0.001, "holds"),
                    ("worse", 5.0, 0.03, "holds"), ("wrong", 0.1, 1e-5, "violates"))
        for factor, where in zip((1.0, 3.0, 2.0), scenes, strict=True)
    ]  # fmt: skip
    told = report(*(replace(run, key=f"{run.key}-{run.scene.name}") for run in runs))
    values = overview.build(told).values
    plot = values["plot"]
    top, right = float(f"{plot.y.high:.4g}"), float(f"{plot.x.high:.4g}")
    assert drawn(plot).lines["front"][1] == [
        pytest.approx(place, rel=2e-4)
        for place in [(2.0, top), (2.0, 0.04), (8.0, 0.04), (8.0, 0.002), (right, 0.002)]
    ]
    assert [words for style, words in drawn(plot).tags if style == "strong"] == ["fast", "exact"]
    assert drawn(plot).marks[0] == Mark(
        "c2 full",
        "circle",
        "fast on bank: holds; 1.00 CPU s, error 0.020",
        "pages/bank--fast.html",
        (1.0, 0.02),
    )
    assert drawn(plot).marks[-1].at == (0.2, 2e-5)
    assert not unsaid(
        plot.words,
        "relaxations at their tightest ε. 3 of 12 plans violate (hollow). The line joins fast and exact: no other pipeline is better",
    )
    assert (plot.x.quantity, plot.x.unit, plot.y.quantity, plot.y.unit) == (
        "CPU time, with the stages before",
        "s",
        "replay error",
        "m or rad",
    )
    assert [(key.style, key.words) for key in values["keys"]][:2] == [
        ("c1", "relaxed contact"),
        ("c3", "gradient descent"),
    ]
    assert (plot.width, plot.height) == (560, 400)
    about = values["about"]
    assert (about["what"], about["where"], about["when"]) == (
        "3 scenes by 4 pipelines, 12 runs", "Some Processor 2.6 GHz, 2 cores", "2025-01-02 03:04",
    )  # fmt: skip
    assert (about["time"], about["command"]) == ("48.00 CPU s", "python -m validate all")


def test_an_error_too_small_to_tell_is_drawn_as_the_replays_own():
    told = report(ran("tick", judged("replay_error", 1e-13), cpu=1e-5))
    assert drawn(overview.build(told).values["plot"]).marks[0].at == (1e-3, 3e-9)
    one = replace(told.stored.runs[0].stages[0], replay=None)
    told = report(replace(told.stored.runs[0], stages=(one,)))
    assert drawn(overview.build(told).values["plot"]).marks[0].at == (1e-3, 1e-12)
