"""The plots of a stage against motions made by hand: which values each line has, in which unit, and what is said of them."""

import re
from dataclasses import replace

import pytest
from wording import unsaid

from models.results.run import (
    ContactRecord,
    QuantityRecord,
    SceneRecord,
    StageRecord,
    TrackedRecord,
)
from reports.pages.stage_plots import stage_plots
from reports.traces import Motion
from tests.reports import record_factory as factory
from tests.reports.drawn import drawn

PLAN = {
    "x": (1, 2, 3, 4), "a": (0, -1, -2, -3), "y": (5, 6, 7, 9), "lam_left": (0, 2, 5),
    "gap_left": (0.3, 0, -0.1, 0.2), "rub": (-4, 1, 2),
    "u": (1, -3, 2), "w": (0.5, 0.25, 0.125),
}  # fmt: skip
REPLAY = {
    "x": (1, 2.5, 3.5, 4.5), "a": (0, -1, -2, -3.5), "y": (5, 6, 8, 8.5), "lam_left": (0, 3, 6, 0),
    "gap_left": (0.4, -0.1, 0.2, 0.3),
    "rub": (0, -6, 3, 0), "position_error": (0, 0.5, 1, 0.25),
}  # fmt: skip


def scene() -> SceneRecord:
    of = QuantityRecord
    return replace(factory.scene(), coordinates=(of(name="x", unit="m"), of(name="a", unit="rad"), of(name="y", unit="m")), inputs=(of(name="u", unit="N"), of(name="w", unit="N m")), contacts=(ContactRecord(name="left", unit="N"),), frictions=(of(name="rub", unit="N", description="at the floor"),))  # fmt: skip


def stage(**changes: object) -> StageRecord:
    return factory.stage(0, "strict_lcp", None, None, 0.0, **changes)


def plotted(motion: Motion | None = None, one: StageRecord | None = None, **options: bool):
    times = range(4)
    both = Motion(plan=factory.trace(times, **PLAN), replay=factory.trace(times, **REPLAY))
    return stage_plots(scene(), one or stage(), motion or both, **options)


def at(*values: float, times: tuple[float, ...] = (0, 1, 2, 3)) -> list[tuple[float, float]]:
    return list(zip(times, values, strict=False))


def test_every_quantity_is_drawn_in_its_own_plot():
    positions, angles, force, friction, error, gap, inputs = plotted().motion
    assert drawn(positions).lines == {
        "x replay": ("c0", at(1, 2.5, 3.5, 4.5)), "x plan": ("c0 ghost", at(1, 2, 3, 4)),
        "y replay": ("c1", at(5, 6, 8, 8.5)), "y plan": ("c1 ghost", at(5, 6, 7, 9)),
    }  # fmt: skip
    assert not unsaid(positions.words, "plan ends at x 4, y 9 m. … replay ends at x 4.5, y 8.5 m.")
    assert drawn(positions).tags == [("strong c0", "x"), ("strong c1", "y")]
    assert (positions.y.quantity, positions.y.unit, positions.y.low, positions.y.high) == (
        "position",
        "m",
        pytest.approx(0.2),
        pytest.approx(9.8),
    )
    assert (positions.x.quantity, positions.x.unit, positions.x.low, positions.x.high) == (
        "time",
        "s",
        0.0,
        3.0,
    )
    assert list(drawn(angles).lines) == ["a replay", "a plan"]
    assert not unsaid(angles.words, "plan ends at a −3 rad. … replay ends at a −3.5 rad.")
    assert drawn(force).lines == {
        "replay": ("replay", at(0, 3, 6, 0)),
        "plan": ("plan", at(0, 2, 5)),
    }
    assert (force.title, force.y.quantity, force.y.unit, force.y.low, force.y.high) == (
        "Contact force, left", "force", "N", 0.0, pytest.approx(6.3),
    )  # fmt: skip
    assert not unsaid(
        force.words, "in the replay: 6 N. … plan: 5 N. … contact in the replay: 1 to 2 s."
    )
    svg = str(force.markup())
    assert '<rect class="touch" x="178.0" y="26" width="124.0"' in svg, "from 1 to 2 s of 3"
    assert '<rect class="planned-touch" x="178.0" y="20" width="248.0"' in svg, "from 1 to 3 s"
    assert (friction.title, friction.y.quantity) == ("Friction force, at the floor", "force")
    assert drawn(friction).lines == {
        "replay": ("replay", at(0, -6, 3, 0)),
        "plan": ("plan", at(-4, 1, 2)),
    }
    assert not unsaid(
        friction.words, "in the replay: 6 N. … plan: 4 N. … Friction … replay: 1 to 3 s."
    )
    assert drawn(error).lines == {"difference": ("c5", at(0, 0.5, 1, 0.25))}
    assert (error.title, error.y.unit) == ("Position error: replay against plan", "m/rad")
    assert not unsaid(error.words, "1.0 m/rad, at 2 s; at the end … 0.25 m/rad.")
    assert drawn(gap).lines == {
        "replay": ("replay", at(0.4, -0.1, 0.2, 0.3)),
        "plan": ("plan", at(0.3, 0, -0.1, 0.2)),
    }
    assert (gap.title, gap.y.quantity, gap.y.unit) == ("Gap, left", "gap", "m")
    assert not unsaid(
        gap.words, "in the replay: 0.4 m. … plan: 0.3 m. … contact in the replay: 1 to 2 s."
    )
    assert drawn(inputs).lines == {"u": ("c0", at(1, -3, 2)), "w": ("c1", at(0.5, 0.25, 0.125))}
    assert (inputs.title, inputs.y.quantity, inputs.y.unit) == (
        "Inputs of the plan",
        "input",
        "N/N m",
    )
    assert inputs.words == "u lies between −3 and 2 N. w lies between 0.125 and 0.5 N m."
    assert ("strong c0", "u") in drawn(inputs).tags
    assert re.search(rf'x="{inputs.px(1):.1f}"[^>]*>u<', str(inputs.markup())), (
        "named at its largest size"
    )


def test_a_stage_that_another_goes_on_from_shows_motion_forces_and_error_alone():
    found = plotted(one=stage(), whole=False)
    titles = [plot.title.partition(":")[0] for plot in found.motion]
    assert titles == ["Positions", "Positions", "Contact force, left", "Position error"]
    assert found.history == []
    assert plotted().history != []


@pytest.mark.parametrize(
    ("gaps", "words"),
    [
        ((1, 1, 1), "never."),
        ((-1, 1) * 4, "0 to 1 s, 2 to 3 s, 4 to 5 s, 6 to 7 s."),
        ((-1, 1) * 5, "0 to 1 s, 2 to 3 s, 4 to 5 s, 6 to 7 s and more."),
    ],
)
def test_four_times_in_contact_are_told(gaps: tuple[int, ...], words: str):
    trace = factory.trace(range(len(gaps)), gap_left=gaps)
    gap = next(plot for plot in plotted(Motion(replay=trace)).motion if plot.title == "Gap, left")
    assert gap.words.endswith(f"In contact in the replay: {words}")


def feedback() -> StageRecord:
    one = stage()
    assert one.replay is not None
    tracked = TrackedRecord(error_estimate=1e-9, rms=(0.1,), peak=(0.3,))
    return replace(one, replay=replace(one.replay, judged="feedback", tracked=tracked))


def test_with_feedback_the_tracked_replay_is_drawn_and_both_errors():
    tracked = factory.trace(
        (0, 1, 2, 3),
        **REPLAY | {"x": (1, 2, 3, 4.25), "position_error": (0, 1e-9, 0.02, 0.01), "u": (1, -4, 3)},
    )
    both = Motion(
        plan=factory.trace(range(4), **PLAN),
        replay=factory.trace(range(4), **REPLAY),
        tracked=tracked,
    )
    found = plotted(both, feedback())
    assert [key.words for key in found.keys] == [
        "plan",
        "replay with feedback",
        "replay in contact",
        "plan in contact",
    ]
    assert [key.words for key in plotted().keys] == [
        "plan",
        "replay",
        "replay in contact",
        "plan in contact",
    ]
    assert drawn(found.motion[0]).lines["x replay"] == ("c0", at(1, 2, 3, 4.25))
    errors = next(plot for plot in found.motion if plot.title.startswith("Position error"))
    # A millionth of the largest is the least that is drawn.
    assert drawn(errors).lines == {
        "inputs alone": ("c3", at(1e-6, 0.5, 1, 0.25)),
        "with feedback": ("c5", at(1e-6, 1e-6, 0.02, 0.01)),
    }
    assert (errors.y.log, errors.y.quantity, errors.y.unit) == (True, "largest difference", "m/rad")
    assert errors.y.low == pytest.approx(1e-6 * 10**-0.3)
    assert not unsaid(
        errors.words,
        "Inputs alone: … 1.0 m/rad, … end 0.25 m/rad. With feedback: … 0.020 m/rad, … end 0.010 m/rad.",
    )
    assert drawn(errors).tags == [("strong c3", "inputs alone"), ("strong c5", "with feedback")]
    inputs = found.motion[-1]
    assert inputs.title == "Inputs of the plan (dotted) and with feedback"
    assert drawn(inputs).lines == {
        "u with feedback": ("c0", at(1, -4, 3)),
        "u": ("c0 ghost", at(1, -3, 2)),
        "w": ("c1", at(0.5, 0.25, 0.125)),
    }
    assert inputs.y.low == pytest.approx(-4.35)


@pytest.mark.parametrize(
    ("values", "iterations", "log", "shown"),
    [
        ((100.0, 1.0, 1.0), 8, False, [(0, 100), (4, 1), (8, 1)]),
        ((101.0, 2.0, 1.0), 2, True, [(0, 101), (1, 2), (2, 1)]),
        ((101.0, 0.0, 1.0), 1, True, [(0, 101), (2, 1)]),
        ((101.0, -1.0, 1.0), 2, False, [(0, 101), (1, -1), (2, 1)]),
        ((0.0, 0.0, 5.0), 2, False, [(0, 0), (1, 0), (2, 5)]),
    ],
)  # fmt: skip
def test_a_history_is_drawn_over_all_iterations(
    values: tuple, iterations: int, log: bool, shown: list
):
    (plot,) = plotted(one=stage(history={"inf_pr": values}, iterations=iterations)).history
    assert (plot.title, plot.y.log, plot.width, plot.height) == (
        "primal infeasibility",
        log,
        340,
        180,
    )
    assert drawn(plot).lines == {"primal infeasibility": ("c0", shown)}
    assert (plot.x.quantity, plot.x.low, plot.x.high) == (
        "iteration",
        0.0,
        2.0 * max(1.0, iterations / 2),
    )
    assert plot.words.startswith(f"From {values[0]:g} to {values[-1]:g}.")


def test_eight_columns_of_a_history_are_drawn_and_none_of_one_iteration():
    history = {f"column_{place}": (1.0, 2.0) for place in range(9)}
    assert [plot.title for plot in plotted(one=stage(history=history)).history] == [
        f"column {place}" for place in range(8)
    ]
    assert plotted(one=stage(history={"mu": (1.0,)})).history == []


BARE = {"has_plan": False, "replay": None, "metrics": (), "history": {}}


@pytest.mark.parametrize(
    ("changes", "motion", "absent"),
    [
        ({}, None, []),
        ({"history": {}}, None, ["no history"]),
        ({"history": {}, "kind": "given"}, None, []),
        (BARE, Motion(), ["There is no plan"]),
        ({}, Motion(problems=("a file is cut.",)),
         ["a file is cut.", "No planned trajectory is stored.", "No replay … no plan to replay"]),
        ({"replay": None}, Motion(plan=factory.trace(range(4), **PLAN)),
         ["No replay … was not replayed"]),
    ],
)  # fmt: skip
def test_what_is_absent_has_its_reason(changes: dict, motion: Motion | None, absent: list[str]):
    found = plotted(motion, stage(**changes)).absent
    assert len(found) == len(absent)
    assert not unsaid(found, " … ".join(absent))


def test_the_replays_own_words_are_the_reason():
    one = stage()
    one = replace(one, replay=replace(one.replay, message="the FMU crashed."))
    assert plotted(Motion(plan=factory.trace(range(4), **PLAN)), one).absent == [
        "No replay is stored: the FMU crashed."
    ]


@pytest.mark.parametrize("left", ["metrics", "replay", "has_plan"])
def test_a_stage_is_empty_where_it_left_nothing(left: str):
    full = stage()
    assert stage(**BARE).is_empty
    assert not stage(**{**BARE, left: getattr(full, left)}).is_empty


def test_without_columns_nothing_is_drawn():
    assert plotted(Motion(plan=factory.trace(range(4), other=(1, 2, 3, 4)))).motion == []
    assert plotted(Motion()).motion == []
    only = plotted(Motion(replay=factory.trace((1, 2, 5), x=(1, 2, 3)))).motion
    assert [plot.words for plot in only] == ["The replay ends at x 3 m."]
    assert (only[0].x.low, only[0].x.high) == (1.0, 5.0)
