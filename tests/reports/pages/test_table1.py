"""The paper's Table I against a second copy of its numbers, read off the paper once more.

The table of stages and what is concluded from it, from rows whose numbers all differ.
"""

from dataclasses import replace

import pytest
from wording import unsaid

from models.results.run import QuantityRecord, RunRecord, SceneRecord
from reports.load import Stored
from reports.pages import sweeps, table1
from reports.pages.section import Report
from reports.paper import SCENE, TABLE_1, TIGHTENING_FIGURES
from reports.rows import rows_of
from tests.reports import record_factory as factory
from tests.reports.drawn import Mark, drawn
from tests.reports.record_factory import judged, ran

# Methods, eps, then cost, stability, physics, time, as printed.
PRINTED = """
strict_lcp              -     40779.28 0.00    0.00   31.56
relu_gd                 -       542.56 0.04    0.16   49.59
relaxed_lcp             1e-2    484.21 0.00    2.99 1407.90
relaxed_lcp             1e-3    561.00 0.00    0.34  580.77
relaxed_lcp             1e-4    469.94 0.00    0.03  430.16
relaxed_lcp strict_lcp  -     46415.20 0.00    0.00   20.73
relaxed_lcp relu_gd     -       492.06 0.00    0.20    0.27
softplus_dc             1e-3    197.86 0.00 2445.98   11.64
softplus_dc             1e-5    261.23 0.00  625.11    9.78
softplus_dc             1e-7    339.53 0.00  239.50   12.40
softplus_dc strict_lcp  -     16619.35 0.00    0.00  100.07
softplus_dc relu_gd     -       360.31 0.00    0.20    1.43
softplus_gd             1e-3    149.18 0.41    0.01    4.07
softplus_gd             1e-5    166.45 0.27    0.11    3.77
softplus_gd             1e-7    215.14 0.20    0.12    2.94
softplus_gd strict_lcp  -      3748.30 0.00    0.00  151.54
softplus_gd relu_gd     -       309.42 0.05    0.21    2.38
"""


def test_table_one():
    for row, line in zip(TABLE_1, PRINTED.split("\n")[1:-1], strict=True):
        *methods, eps, cost, stability, physics, time = line.split()
        assert row.methods == tuple(methods), line
        assert row.eps == (None if eps == "-" else float(eps)), line
        assert row.numbers == {
            "cost": float(cost),
            "stability": float(stability),
            "physics": float(physics),
            "time": float(time),
        }, line


def test_figures():
    assert TIGHTENING_FIGURES == {
        "softplus_dc": "Fig. 4",
        "softplus_gd": "Fig. 5",
        "relaxed_lcp": "Fig. 6",
    }


POSITION = "replay_terminal_position_error"
GRID = "discrete_terminal_position_error"


def report(*runs: RunRecord) -> Report:
    return Report(Stored(None, runs))


def said(*runs: RunRecord) -> list[str]:
    return table1.conclude(rows_of(runs, lambda run: ""))


def beside(
    name: str, ours: float | None, theirs: float | None, missed: float = 0.1, **changes
) -> RunRecord:
    """A row that the paper has too."""
    paper = {} if theirs is None else {"cost": theirs}
    return ran(
        name,
        judged(POSITION, missed),
        cost=ours,
        paper=paper or {"stability": 0.0},
        kind="other",
        **changes,
    )


def test_costs_that_agree_with_the_print_are_counted():
    known = [
        beside("same", 100.0, 100.0099),
        beside("off", 103.0, 100.0),
        beside("far", 94.0, 100.0),
        beside("lost", None, 5.0),
    ]
    assert not unsaid(
        said(*known)[0],
        "1 of 3 stages … printed digits (1 part in 10\u202f000): same. … −6.00\u202f%, of far.",
    )
    assert not unsaid(
        said(known[0])[0], "1 of 1 stage … paper's printed digits (1 part in 10\u202f000)."
    )
    assert said(known[1])[0].startswith("0 of 1 stage that both have")
    assert said(beside("just", 100.0, 100.0101))[0].startswith("0 of 1")
    assert said(ran("ours alone", cost=5.0, kind="other")) == []


@pytest.mark.parametrize(
    ("ours", "theirs", "held"),
    [
        (100.0, 200.0, True),
        (100.0, 200.0, False),
        (100.0, 199.0, None),
        (0.0, 9.0, None),
        (-1.0, 9.0, None),
        (9.0, -1.0, None),
    ],
)
def test_a_solver_that_returns_twice_the_cost_has_failed(
    ours: float, theirs: float, held: bool | None
):
    found = said(beside("dear", ours, theirs, 0.25, verdict="holds" if held else "violates"))
    told = [line for line in found if line.startswith("dear: ours")]
    assert len(told) == (held is not None)
    if told:
        assert not unsaid(
            told[0], "dear: ours 100.00 (… 0.25 m), the paper's 200.00, 2.0 times as much."
        )
        assert ("its solver stopped far from the optimum" in told[0]) is held


def test_a_cost_that_is_twice_the_papers_is_ours_to_mend():
    found = said(
        beside("worse", 300.0, 100.0, 0.5),
        beside("dear", 10.0, 340.0, 0.25),
        beside("near", 199.0, 100.0),
    )
    _, dear, worse = found
    assert not unsaid(
        dear,
        "dear: ours 10.00 (… 0.25 m), the paper's 340.00, 34 times … the method is not to blame.",
    )
    assert not unsaid(
        worse, "worse: ours 300.00 (… 0.50 m), the paper's 100.00, so ours is the worse"
    )
    (_, worse) = said(beside("worse", 200.0, 100.0, 0.5))
    assert not unsaid(
        worse, "worse: ours 200.00 (… 0.50 m), the paper's 100.00, so ours is the worse"
    )


def chain(
    name: str,
    first: str,
    cost: float | None,
    missed: float,
    total: float,
    cold: bool = False,
    of: SceneRecord | None = None,
) -> RunRecord:
    """strict_lcp, cold or after another method."""
    last = factory.stage(0 if cold else 1, "strict_lcp", None, None, 0.0)
    last = replace(last, paper={}, cost=cost, metrics=(judged(POSITION, missed),), seconds=replace(last.seconds, total=total))  # fmt: skip
    before = ran(first, kind="indirect", cost=1.0).stages[0]
    stages = (last,) if cold else (before, last)
    return factory.run(
        name, None, "strict_lcp", stages=stages, key=name, scene=of or factory.scene()
    )


def test_what_a_warm_start_gives():
    bare = replace(factory.scene(), answers=())
    runs = [
        chain("cold", "", 100.0, 0.1, 8.0, True, bare),
        chain("a+strict", "a", 90.0, 0.2, 2.5, of=bare),
        chain("b+strict", "b", 125.0, 0.4, 3.5, of=bare),
        chain("c+strict", "c", None, 0.4, 3.5, of=bare),
    ]  # fmt: skip
    (line,) = said(*runs)
    assert not unsaid(
        line,
        "strict_lcp cold: cost 100.00, … 0.10 m off the goal, 8.00 s. … after a −10\u202f% cost, 0.20 m … 2.50 s … after b +25\u202f% cost, 0.40 m … 3.50 s",
    )
    assert said(runs[0]) == said(runs[1]) == said(*runs[1:]) == []
    unpriced = chain("cold", "", None, 0.1, 8.0, True, bare)
    assert said(unpriced, runs[1]) == []


@pytest.mark.parametrize(
    ("planned", "truly", "cheats"),
    [
        (1e-3, 0.05, True),
        (1.01e-3, 0.05, False),
        (1e-3, 0.049, False),
        (None, 0.05, False),
        (1e-3, None, False),
    ],
)
def test_plans_that_reach_the_goal_in_their_own_model_only(
    planned: float | None, truly: float | None, cheats: bool
):
    metrics = [
        judged("terminal_error", planned), judged("discrete_terminal_error", truly),
        judged(GRID, 0.07),
        judged("discrete_terminal_velocity_error", 0.5, "m/s"),
    ]  # fmt: skip
    found = said(ran("soft", *metrics, kind="indirect"))
    assert len(found) == cheats
    assert not unsaid(found, *["in their own model only: … soft misses by 0.070 m."] * cheats)


def test_the_physics_of_gradient_descent_is_exactly_nought():
    assert not unsaid(
        said(ran("relu_gd", judged("physics", 0.0), kind="other"))[0],
        "ReLU gradient descent is exactly 0",
    )
    odd = said(
        ran("relu_gd", judged("physics", 0.25), kind="other"),
        ran("relu_gd", judged("physics", 0.0), kind="other", eps=1e-3),
        ran("x", judged("physics", 9.0), kind="other"),
    )
    assert len(odd) == 1
    assert not unsaid(odd[0], "must be exactly 0 … not in relu_gd: 0.25.")
    assert said(ran("relu_gd", kind="other")) == []


@pytest.mark.parametrize(
    ("cost", "below"),
    [
        (80.0, True),
        (100.0 * (1 - 2e-6), True),
        (100.0 * (1 - 0.5e-6), False),
        (101.0, False),
        (None, False),
    ],
)
def test_costs_below_the_best_known_are_bought_with_error(cost: float | None, below: bool):
    known = replace(
        factory.scene(), answers=(QuantityRecord(name="best known cost", unit="1", value=100.0),)
    )
    found = said(ran("cheap", judged(GRID, 0.13), cost=cost, of=known))
    price = f"{cost:.2f}" if cost else ""
    start = f"The best known cost of an exact plan is 100.00. Plans of direct methods below it buy their cost with terminal error on their own grid: cheap ({price} at 0.13 m)."
    assert [line.startswith(start) for line in found] == ([True] if below else [])
    assert said(ran("cheap", judged(GRID, 0.13), cost=cost, of=known, kind="indirect")) == []
    assert said(ran("cheap", judged(GRID, 0.13), cost=cost, of=replace(known, answers=()))) == []


def timed(name: str, ours: float, theirs: float) -> RunRecord:
    run = beside(name, 100.0, 100.0)
    (stage,) = run.stages
    stage = replace(
        stage, paper={"cost": 100.0, "time": theirs}, seconds=replace(stage.seconds, wall=ours)
    )
    return replace(run, stages=(stage,))


def test_clocks_are_compared_over_the_rows_that_both_have():
    last = said(timed("a", 1.0, 30.0), timed("b", 3.0, 50.0))[-1]
    assert not unsaid(
        last, "take 4.00 s here and 80.00 s in the paper (2 of its 17 rows) … 20 times as long."
    )
    assert (
        "in the paper, on other machines"
        in said(*(timed(f"row {place}", 1.0, 2.0) for place in range(17)))[-1]
    )
    assert len(said(timed("a", 0.0, 30.0))) == 1
    assert len(said(beside("a", 100.0, 100.0))) == 1


THEIRS = {"cost": 100.0}  # of the paper, beside a stage of its scene


def test_cells_tell_both_parts_of_each_end():
    metrics = (
        judged("terminal_position_error", 0.1), judged("terminal_velocity_error", 0.2, "m/s"),
        judged("terminal_error", 0.3), judged(GRID, 0.4),
        judged("discrete_terminal_velocity_error", 0.5, "m/s"),
        judged("discrete_terminal_error", None, reason="it is not known."), judged(POSITION, 0.7),
        judged("replay_terminal_velocity_error", 0.8, "m/s"), judged("replay_terminal_error", 0.9),
    )  # fmt: skip
    section = table1.build(report(ran("a", *metrics, why="a reason", paper=THEIRS)))
    assert (section.anchor, section.title, section.values["beside"]) == (
        "table1",
        "Table I: ours beside the paper",
        True,
    )
    ((_, ends),) = section.values["rows"]
    assert ends == {
        "plan": table1.TerminalError(0.1, 0.2, 0.3, None, "a reason"),
        "grid": table1.TerminalError(0.4, 0.5, None, None, "it is not known."),
        "replay": table1.TerminalError(0.7, 0.8, 0.9, None, "a reason"),
    }  # fmt: skip
    assert section.values["units"] == ("m", "m/s")
    assert len(section.values["lacks"]) == 17
    none = table1.build(report(ran("a", why="", paper=THEIRS)))
    assert none.values["rows"][0][1]["plan"] == table1.TerminalError(
        None, None, None, None, "no plan"
    )
    assert none.values["units"] == ("", "")
    both = table1.build(
        report(
            ran("a", judged(POSITION, 1.0), paper=THEIRS), ran("b", judged(POSITION, 1.0, "rad"))
        )
    )
    assert both.values["units"] == ("", "")


def test_where_feedback_is_judged_the_inputs_alone_stand_beside_it():
    run = ran(
        "a",
        judged(POSITION, 0.7),
        judged(f"tracked_{POSITION}", 0.01),
        verdict="holds with feedback",
        paper=THEIRS,
    )
    (stage,) = run.stages
    stage = replace(stage, replay=replace(stage.replay, judged="feedback"))
    ends = table1.build(report(replace(run, stages=(stage,)))).values["rows"][0][1]
    assert (
        ends["replay"].position,
        ends["replay"].alone,
        ends["plan"].alone,
        ends["grid"].alone,
    ) == (0.01, 0.7, None, None)
    assert (
        table1.build(report(ran("a", judged(POSITION, 0.7), paper=THEIRS)))
        .values["rows"][0][1]["replay"]
        .alone
        is None
    )


def test_other_scenes_have_a_table_of_their_own():
    hill = factory.scene("hill")
    told = report(ran("a", paper=THEIRS), ran("b", of=hill))
    assert table1.of_scene(replace(told, single=True), told.scenes[0]) is None, (
        "Table I stands in the same file"
    )
    first = table1.of_scene(told, told.scenes[0])
    assert (first.anchor, first.title, first.values["beside"]) == (
        "stages-1",
        "All methods on three_cart",
        True,
    )
    section = table1.of_scene(told, told.scenes[1])
    assert (section.anchor, section.title, section.values["beside"], section.values["lacks"]) == (
        "stages-2",
        "All methods on hill",
        False,
        [],
    )
    assert table1.build(report(ran("b", of=hill))) is None


def test_a_scene_of_ones_own_that_is_called_as_the_papers_has_no_table_1():
    """The paper's numbers stand beside the stages on the catalog's scene alone."""
    own = report(ran("a"))
    assert own.scenes[0].name == SCENE
    assert table1.build(own) is None
    section = table1.of_scene(replace(own, single=True), own.scenes[0])
    assert (section.title, section.values["beside"], section.values["lacks"]) == (
        "All methods on three_cart",
        False,
        [],
    )


def relaxed(tmp_path, name: str, schedule: dict[float, float], paper: bool = False) -> RunRecord:
    """A relaxation at several eps with the error of each.

    The plan of each is 1 s long, at 10 eps.
    """
    stages = []
    for place, (eps, missed) in enumerate(schedule.items()):
        one = ran(
            "softplus_dc",
            judged(POSITION, missed),
            judged("physics_scaled", missed**2, "s"),
            kind="indirect",
            eps=eps,
            cost=None,
        ).stages[0]
        stages.append(
            replace(one, index=place, has_plan=True, method_title="Softplus", paper={"cost": 1.0} if paper else {}, options={"of": name}),
        )  # fmt: skip
    run = factory.run(name, None, "strict_lcp", stages=tuple(stages), key=name)
    folder = tmp_path / "runs" / name
    folder.mkdir(parents=True)
    for stage in stages:
        place = stage.index + 1
        columns = {
            "t": [0.0, 0.5, 1.0], "q1": [10 * stage.eps, 0.0, place],
            "lam_left": [1.0, -4.0 * place], "gap_left": [0.5, 0.25, -place],
            "u1": [float(place), 0.5],
        }  # fmt: skip
        factory.write_motion(
            folder / factory.stage_files(stage.index, len(stages))["trajectory"], columns
        )
    return run


def test_plans_are_drawn_from_the_loosest_to_the_tightest(tmp_path):
    run = relaxed(tmp_path, "one", {1e-3: 0.2, 1e-1: 0.4, 1e-5: 0.1}, paper=True)
    told = Report(Stored(None, (run,)), tmp_path)
    section = sweeps.tightening(told, told.scenes[0])
    assert (section.anchor, section.title, section.entries) == (
        "tightening-1", "Figs. 4–6: plans while ε is tightened",
        (("tightening-1-1", "Fig. 4: Softplus"),),
    )  # fmt: skip
    (sweep,) = section.values["sweeps"]
    assert [(key.style, key.words) for key in sweep.keys] == [
        ("s0", "ε = 10⁻¹"),
        ("s2", "ε = 10⁻³"),
        ("s5", "ε = 10⁻⁵"),
    ]
    assert [row.stage.eps for row in sweep.rows] == [1e-1, 1e-3, 1e-5]
    plots = {plot.title: plot for plot in sweep.plots}
    assert list(plots) == ["Positions", "Contact force, left", "Gap, left", "Input u1"]
    assert drawn(plots["Positions"]).lines == {
        "q1, ε = 10⁻¹": ("s0", [(0.0, 1.0), (0.5, 0.0), (1.0, 2.0)]),
        "q1, ε = 10⁻³": ("s2", [(0.0, 0.01), (0.5, 0.0), (1.0, 1.0)]),
        "q1, ε = 10⁻⁵": ("s5", [(0.0, 1e-4), (0.5, 0.0), (1.0, 3.0)]),
    }  # fmt: skip
    assert plots["Positions"].words == "q1 ε = 10⁻⁵: from 0.00010 to 3 m."
    assert drawn(plots["Positions"]).tags == [("strong", "q1")]
    assert (
        plots["Positions"].height, plots["Positions"].y.quantity, plots["Positions"].y.unit,
        plots["Positions"].y.high,
    ) == (300, "position", "m", pytest.approx(3.24))  # fmt: skip
    force = plots["Contact force, left"]
    assert drawn(force).lines["ε = 10⁻¹"] == ("s0", [(0.0, 1.0), (0.5, -8.0)])
    assert not unsaid(
        force.words,
        "ε = 10⁻¹: … 8 N at 0.5 s. ε = 10⁻³: … 4 N at 0.5 s. ε = 10⁻⁵: … 12 N at 0.5 s.",
    )
    assert drawn(force).tags == [("s0", "ε = 10⁻¹"), ("s2", "ε = 10⁻³"), ("s5", "ε = 10⁻⁵")]
    assert (force.y.quantity, force.y.unit, force.y.low, force.y.high, force.x.high) == (
        "force", "N", pytest.approx(-12.65), pytest.approx(1.65), 1.0,
    )  # fmt: skip
    assert drawn(plots["Gap, left"]).lines["ε = 10⁻⁵"] == (
        "s5",
        [(0.0, 0.5), (0.5, 0.25), (1.0, -3.0)],
    )
    assert (
        plots["Gap, left"].y.quantity,
        plots["Gap, left"].y.unit,
        drawn(plots["Gap, left"]).tags,
    ) == ("gap", "m", [])
    assert (plots["Input u1"].y.quantity, plots["Input u1"].y.unit) == ("u1", "N")
    assert plots["Input u1"].words.startswith("ε = 10⁻¹: largest size 2 N at 0 s.")
    off, physics = section.values["against"]
    assert (off.title, physics.title, physics.y.unit) == (
        "Replay terminal position error against ε",
        "Physics scaled against ε",
        "s",
    )
    assert drawn(off).lines == {"Softplus": ("c0", [(1e-5, 0.1), (1e-3, 0.2), (1e-1, 0.4)])}
    link = "pages/three_cart--one.html"
    assert drawn(off).marks[0] == Mark(
        "c0 full",
        "circle",
        "softplus_dc ε = 10⁻¹: replay terminal position error 0.4 m, holds",
        link,
        (0.1, 0.4),
    )
    assert (off.x.log, off.x.quantity, off.x.unit, section.values["keys"]) == (True, "ε", "", [])


def test_the_same_relaxation_with_other_options_is_another_sweep(tmp_path):
    runs = (
        relaxed(tmp_path, "one", {1e-3: 0.2, 1e-5: 0.1}),
        relaxed(tmp_path, "two", {1e-3: 0.3, 1e-5: 0.15}), relaxed(tmp_path, "single", {1e-3: 0.3}),
    )  # fmt: skip
    (tmp_path / "runs" / "two" / "trajectory-1.nc").unlink(missing_ok=True)
    for path in (tmp_path / "runs" / "two").glob("*"):
        path.unlink()
    told = Report(Stored(None, runs), tmp_path)
    section = sweeps.tightening(told, told.scenes[0])
    assert section.title == "Plans while ε is tightened"
    assert [entry[1] for entry in section.entries] == ["Softplus (one)", "Softplus (two)"]
    one, two = section.values["sweeps"]
    assert (one.absent, two.absent, two.plots, [key.style for key in one.keys]) == (
        "",
        "No plan is stored for ε = 10⁻³, ε = 10⁻⁵.",
        [],
        ["s0", "s5"],
    )
    assert [key.words for key in section.values["keys"]] == ["Softplus (one)", "Softplus (two)"]
    off = section.values["against"][0]
    assert drawn(off).lines["Softplus (two)"] == ("c1", [(1e-5, 0.15), (1e-3, 0.3)])
    none = Report(Stored(None, runs[2:]), tmp_path)
    assert sweeps.tightening(none, none.scenes[0]) is None
