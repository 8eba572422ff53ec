"""A linear hold heads for the plan's last row in the last step: a double integrator under a ramp, against its closed form."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Hold, Trajectory, read_csv, write_csv
from models.trajectory_netcdf import read_netcdf, write_netcdf
from tests.validate.judge.replay.test_replay_fmu import mass_on_a_line
from validate.judge.replay.run import replay
from validate.judge.replay.wiring import Effort, Feedback, HeldInputs, Variables, measure_effort
from validate.processes.isolated import Limits, packed, unpacked_from

MASS = 2.0
T = np.array([0.0, 0.1, 0.3, 0.5])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return mass_on_a_line().with_task(start=(0.2, -1.0))


def ramp(end: bool = True) -> Trajectory:
    """F = 3 - 10 t; without its end the last step is constant."""
    u = 3 - 10 * T
    empty = np.zeros((4, 1))
    return Trajectory(
        t=T,
        q=empty + 0.2,
        v=empty - 1.0,
        u=u[:-1, None],
        lam=np.zeros((3, 0)),
        hold=Hold.LINEAR,
        u_end=u[-1:] if end else None,
    )


@pytest.mark.slow
@pytest.mark.parametrize("limits", [None, Limits(seconds=100.0)], ids=["here", "child"])
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_ramp_is_integrated_to_its_end(scene: Scene, limits: Limits | None, version: str):
    result = replay(scene, build_fmu(scene, version=version), ramp(), limits=limits, track=False)
    assert result.ok, result.message
    t = result.t
    assert result.q[:, 0] == pytest.approx(
        0.2 - t + (3 * t**2 / 2 - 10 * t**3 / 6) / MASS, abs=1e-11
    )
    assert result.v[:, 0] == pytest.approx(-1 + (3 * t - 5 * t**2) / MASS, abs=1e-11)
    assert result.error.everyday.position < 1e-6, (
        "FMI 3.0 has stairs instead of the line: 2e-7; without the end it would be 7e-3"
    )
    cut = replay(
        scene, build_fmu(scene, version=version), ramp(end=False), limits=limits, track=False
    )
    # The last 0.2 s hold 0 N instead of going on to -2 N.
    assert cut.v[-1, 0] - result.v[-1, 0] == pytest.approx(0.2 * 2.0 / 2 / MASS, abs=1e-11)


def test_slopes_end_at_the_last_row():
    held = HeldInputs(ramp())
    assert held.slopes[:, 0] == pytest.approx([-10.0, -10.0, -10.0])
    assert HeldInputs(ramp(end=False)).slopes[:, 0] == pytest.approx([-10.0, -10.0, 0.0])


def test_end_of_a_ramp_is_stored_with_the_plan(scene: Scene, tmp_path: Path):
    write_csv(tmp_path / "plan.csv", ramp(), scene)
    write_netcdf(tmp_path / "plan.nc", ramp(), scene)
    for plan in (read_csv(tmp_path / "plan.csv", scene), read_netcdf(tmp_path / "plan.nc", scene)):
        assert (plan.hold, plan.u_end.tolist()) == (Hold.LINEAR, [-2.0])


def test_inputs_change_their_units_with_their_end():
    plan = ramp().with_inputs_in(np.array([0.001]), np.array([5.0]))
    assert plan.u_end == pytest.approx([4.998])
    assert plan.u[0] == pytest.approx([5.003])


# Inputs as functions of time, and what feedback adds to them


def inputs_of(
    u: list[list[float]],
    hold: Hold = Hold.ZERO_ORDER,
    feedback: Feedback | None = None,
    end: list[float] | None = None,
) -> HeldInputs:
    steps = len(u)
    states = np.zeros((steps + 1, 1))
    plan = Trajectory(
        t=0.5 * np.arange(steps + 1), q=states, v=states, u=np.array(u), lam=np.zeros((steps, 0)),
        hold=hold,
        u_end=None if end is None else np.array(end),
    )  # fmt: skip
    return HeldInputs(plan, feedback)


def test_an_integrator_stops_where_any_input_jumps():
    """Two inputs of which the second jumps into the third step, the first into the fifth: no integration may go on beyond the next jump."""
    held = inputs_of([[1.0, 2.0], [1.0, 2.0], [1.0, 3.0], [1.0, 3.0], [0.0, 3.0]])
    assert held.breaks.tolist() == [True, False, True, False, True]
    assert held.stops == [2, 2, 4, 4, 5]
    assert (held.linear, held.slopes.any(), held.begin(2, None).tolist()) == (
        False,
        False,
        [1.0, 3.0],
    )


def test_lines_that_go_on_are_no_jump_and_those_that_turn_are():
    held = inputs_of([[0.0], [1.0], [2.0], [2.0]], Hold.LINEAR, end=[2.0])
    assert (held.slopes.ravel().tolist(), held.breaks.tolist()) == (
        [2.0, 2.0, 0.0, 0.0],
        [True, False, True, False],
    )
    assert held.stops == [2, 2, 4, 4]
    assert held.linear


LAW = Feedback(
    gains=np.array([[[2.0, -1.0]], [[3.0, 0.5]]]),
    reference=np.array([[1.0, 0.0], [2.0, 1.0], [0.0, 0.0]]), u=np.array([[0.5], [-0.5]]),
    lower=np.array([-4.0]), upper=np.array([3.0]), scale=np.array([3.5]),
)  # fmt: skip


@pytest.mark.parametrize(
    ("state", "expected"), [([1.5, 0.5], 0.25), ([0.0, 0.0], -0.5 + 6.0), ([4.0, 1.0], -6.5)]
)
def test_feedback_asks_for_its_correction_and_gets_what_the_bounds_allow(
    state: list[float], expected: float
):
    """-0.5 + 3 (2 - q) + 0.5 (1 - v) at the second node."""
    free = np.array([np.inf])
    wanted = -0.5 + 3.0 * (2.0 - state[0]) + 0.5 * (1.0 - state[1])
    assert replace(LAW, lower=-free, upper=free).at(1, np.array(state)).tolist() == [
        pytest.approx(wanted)
    ]
    held = inputs_of([[0.5], [-0.5]], feedback=LAW)
    assert held.begin(1, np.array(state)).tolist() == [pytest.approx(min(max(wanted, -4.0), 3.0))]
    assert (held.values[1].tolist(), held.breaks.tolist()) == (
        [pytest.approx(min(max(wanted, -4.0), 3.0))],
        [True, True],
    )
    assert held.begin(0, None).tolist() == [0.5], "at its own start a plan is not corrected"


@pytest.mark.parametrize(
    ("u", "end", "state", "expected"),
    [
        (0.5, 2.5, [-9.0, 0.0], 3.0 - 2.0),
        (0.5, -1.5, [9.0, 0.0], -4.0 + 2.0),
        (0.5, -1.5, [-9.0, 0.0], 3.0),
    ],
)
def test_a_correction_of_a_line_stays_within_the_bounds_at_both_ends(
    u: float, end: float, state: list[float], expected: float
):
    held = inputs_of(
        [[u]], Hold.LINEAR, replace(LAW, gains=LAW.gains[:1], u=np.array([[u]])), [end]
    )
    assert held.begin(0, np.array(state)).tolist() == [pytest.approx(expected)]


def test_the_law_in_other_units_turns_its_bounds_where_the_scale_does():
    other = LAW.in_units(
        (np.array([2.0, 4.0]), np.array([1.0, -1.0])), (np.array([-10.0]), np.array([5.0]))
    )
    assert (other.lower.tolist(), other.upper.tolist(), other.scale.tolist()) == (
        [-25.0],
        [45.0],
        [35.0],
    )
    assert other.gains.tolist() == [[[-40.0, 40.0]], [[-60.0, -20.0]]]
    assert (other.reference.tolist(), other.u.tolist()) == (
        [[0.0, 0.25], [0.5, 0.5], [-0.5, 0.25]],
        [[0.0], [10.0]],
    )


def asking(
    u: list[list[float]], hold: Hold = Hold.ZERO_ORDER, end: list[float] | None = None
) -> Trajectory:
    """A plan at rest at 0, 1 and 3 s."""
    still = np.zeros((3, 1))
    return Trajectory(
        t=np.array([0.0, 1.0, 3.0]),
        q=still,
        v=still,
        u=np.array(u),
        lam=np.zeros((2, 0)),
        hold=hold,
        u_end=end,
    )


def test_an_effort_is_weighed_by_time_scale_and_what_the_plan_asks_itself():
    """Added 1 of 2 for 1 s and -3 of 2 for 2 s; the other input 0.5 of 4 throughout.

    The plan itself: 2 and 0, and -4 throughout.
    """
    law: Any = SimpleNamespace(
        scale=np.array([2.0, 4.0]), lower=np.array([-3.0, -9.0]), upper=np.array([3.0, 9.0])
    )  # fmt: skip
    plan, applied = asking([[2.0, -4.0], [0.0, -4.0]]), np.array([[3.0, -3.5], [-3.0, -3.5]])
    effort = measure_effort(plan, applied, law)
    rms = np.sqrt((1.0 + 2 * 9.0) / 3), 0.5
    own = np.sqrt(4.0 / 3), 4.0
    assert effort.rms == pytest.approx(rms)
    assert effort.peak == (3.0, 0.5)
    assert (effort.rms_share, effort.peak_share) == (pytest.approx(rms[0] / 2.0), 1.5)
    share = np.hypot(rms[0] / 2, rms[1] / 4) / np.hypot(own[0] / 2, own[1] / 4)
    assert effort.plan_share == pytest.approx(share, rel=0.01), "the step at 1 s is in a window"
    assert effort.saturated == 1.0
    law.upper = np.array([3.1, 9.0])
    assert measure_effort(plan, applied, law).saturated == 0.5
    early = measure_effort(plan, applied[:1], law)
    assert (early.peak, early.rms) == ((1.0, 0.5), pytest.approx((1.0, 0.5)))
    nothing = measure_effort(plan, applied[:0], law)
    assert nothing == Effort(
        rms=(0.0, 0.0),
        peak=(0.0, 0.0),
        rms_share=0.0,
        peak_share=0.0,
        plan_share=0.0,
        saturated=0.0,
    )
    none = np.zeros((2, 2))
    assert measure_effort(asking(none.tolist()), applied, law).plan_share is None
    law.lower = law.upper = np.zeros(2)
    still = measure_effort(asking(none.tolist()), none, law)
    assert (still.plan_share, still.saturated) == (0.0, 0.0)


def test_effort_dither_counts_for_nothing_in_the_share():
    """Added and planned inputs are averaged over a fiftieth of the plan."""
    t, rows = np.linspace(0.0, 1.0, 1001), np.arange(1000)
    law: Any = SimpleNamespace(
        scale=np.array([2.0]), lower=np.full(1, -np.inf), upper=np.full(1, np.inf)
    )
    zero = np.zeros((1001, 1))
    dither = 10.0 * np.where(rows % 2, 1.0, -1.0)[:, None]
    for own in (np.ones((1000, 1)), np.ones((1000, 1)) + dither):
        plan = Trajectory(t=t, q=zero, v=zero, u=own, lam=np.zeros((1000, 0)))
        assert measure_effort(plan, own + 0.3, law).plan_share == pytest.approx(0.3)
        assert measure_effort(plan, own + dither, law).plan_share == pytest.approx(0.0, abs=1e-9)


def test_references_reach_a_child_as_they_are():
    given = Variables(
        q=(1, 2), v=(3,), u=(4,), lam=(5,), gap=(6,), energies={"kinetic_energy": 7},
        powers={"input_power": 8}, zero=frozenset({"a", "b"}),
        parameters=((9, 1.5),), start=(10, 11), internal_step=12, choices=((13, 2),),
        friction=(14,),
    )  # fmt: skip
    assert unpacked_from(packed(given)) == (given,)
    assert (given.outputs, given.rates) == ((1, 2, 3, 5, 6, 14, 7), (5, 8))
