"""An FMU by Model Exchange under CVODE: the order of its calls, events, bounds, and how each loop ends."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.validate.judge.replay.test_replay_reference import Point, PointInC, free, plan
from validate.fmi.instance import Misbehaviour, References, TerminationRequested
from validate.fmi.loops import Reason
from validate.judge.replay import reference
from validate.judge.replay.reference import PARTS
from validate.judge.replay.result import ReplayOutcome, Run, Stop
from validate.judge.replay.wiring import Variables


class Told:
    """An FMU for Model Exchange whose calls are noted."""

    state_count = 2
    indicator_count = 1
    wants_steps = False
    next_event = math.inf

    def __init__(self) -> None:
        self.log: list[Any] = []
        self.fmu = SimpleNamespace(
            enterEventMode=lambda: self.log.append("enter"), directional=self.directional
        )
        self.changed = False

    def __getattr__(self, name: str) -> Any:
        return lambda *given: self.log.append((name, *given))

    def states(self) -> np.ndarray:
        return np.array([8.0, 9.0])

    def nominals(self) -> np.ndarray:
        return np.array([-1.0, 4.0])

    def settle(self) -> bool:
        return self.changed

    def read(self, references: References) -> np.ndarray:
        return np.array(references.array[:], dtype=float)

    def write(self, references: References, values: Any) -> None:
        self.log.append(("write", references.array[:], list(values)))

    def move(self, time: float, states: np.ndarray) -> None:
        self.log.append(("move", time, states.tolist()))

    def directional(
        self, unknowns: Any, knowns: list[int], seed: list[float], size: int
    ) -> list[float]:
        assert (seed, size) == ([1.0], len(unknowns))
        return [10.0 * unknown + knowns[0] for unknown in unknowns]


@pytest.fixture
def exchange(monkeypatch: pytest.MonkeyPatch) -> tuple[reference.ExchangeModel, Told]:
    told = Told()
    monkeypatch.setattr(
        reference, "load_instance", lambda package, kind: told if kind == "ME" else None
    )
    variables = Variables(q=(1,), v=(2,), u=(5,), lam=(3,), gap=(), energies={},
                          powers={"input_power": 6}, zero=frozenset(), parameters=((7, 0.5),),
                          start=(1, 2),
                          internal_step=None, choices=((8, 1),))  # fmt: skip
    return reference.ExchangeModel(None, variables), told  # type: ignore[arg-type]


def test_an_fmu_is_started_moved_and_asked_in_its_order(
    exchange: tuple[reference.ExchangeModel, Told],
):
    model, told = exchange
    assert (model.states, model.indicators, model.accumulated, model.outputs) == (2, 1, 2, 3)
    x = model.start(0.25, np.array([3.0, 4.0]), np.array([6.0]))
    assert (x.tolist(), model.nominal.tolist()) == ([8.0, 9.0], [1.0, 4.0]), (
        "a nominal that is none is 1"
    )
    assert told.log[0] == ("choose", ((8, 1),))
    (name, time, settings, inputs, u) = told.log[1]
    assert (name, time, settings, inputs.array[:], u.tolist()) == (
        "initialise",
        0.25,
        [(7, 0.5), (1, 3.0), (2, 4.0)],
        [5],
        [6.0],
    )
    told.log.clear()
    assert model.read(1.5, np.array([1.0, 2.0, 70.0, 80.0])).tolist() == [1.0, 2.0, 3.0]
    assert told.log == [("move", 1.5, [1.0, 2.0])]
    assert model.jacobian(2.5, np.array([1.0, 2.0]), [3, 4], [5, 6, 7]).tolist() == [
        [35.0, 36.0, 37.0],
        [45.0, 46.0, 47.0],
    ]
    told.log.clear()
    y = np.array([1.0, 2.0, 70.0])
    assert model.event(3.5, y, None) is y
    told.changed = True
    assert model.event(3.5, y, np.array([6.5])).tolist() == [8.0, 9.0, 70.0]
    assert told.log == [
        ("move", 3.5, [1.0, 2.0]),
        "enter",
        ("move", 3.5, [1.0, 2.0]),
        "enter",
        ("write", [5], [6.5]),
    ]
    model.close()
    assert told.log[-1] == ("unload",)


def integration(**more: Any) -> Any:
    """An integration in progress: two states and one sum, of which a state is out of bounds at 10 and at 20."""
    found = object.__new__(reference._Integration)
    given = {
        "run": Run(), "event_budget": 2, "y": np.array([1.0, -2.0, 3.0]),
        "_bound": np.array([10.0, 20.0]), "step": 0,
        "model": SimpleNamespace(states=2, event=lambda time, y, u: y + 0.5, read=lambda time,
                                 y: np.array([time, *y]), instance=SimpleNamespace(next_event=7.0)),
        "_loop": SimpleNamespace(time=2.5, fault_time=1.5, flag=-4, fmu="fmu", begin=0.0),
        "_set_inputs": lambda: None,
        "_values": np.array([1.0]), "_slopes": np.array([2.0]),
        "inputs": SimpleNamespace(linear=False, values=np.zeros((1, 1))),
        "_solver": SimpleNamespace(roots=np.array([0, -1, 1]), renew=lambda time: None, memory=1,
                                   vector=2),
    } | more  # fmt: skip
    found.__dict__.update(given)
    return found


def test_events_are_noted_by_the_slope_of_their_indicator_until_there_are_too_many():
    one = integration()
    one._note(1.5)
    assert one.run.events == [(1.5, 1, True), (1.5, 2, False)]
    with pytest.raises(Stop, match=r"More than 2 contact events by t = 2 s\.") as caught:
        one._note(2.0)
    assert caught.value.outcome is ReplayOutcome.EVENT_BUDGET


@pytest.mark.parametrize(("time", "target", "falls"),
                         [(2.0, 2.0, True), (2.0, 2.0 + 1.5e-13, True), (2.0, 2.0 + 3e-13, False),
                          (0.1, 0.1 - 0.9e-13, True), (0.1, 0.1 - 1.2e-13, False),
                          (-5.0, -5.0 + 4e-13, True)])  # fmt: skip
@pytest.mark.parametrize("knot", [True, False])
def test_an_event_falls_on_a_point_but_for_rounding(
    time: float, target: float, falls: bool, knot: bool
):
    one = integration()
    assert one._after_event(time, target, knot) is falls
    assert one.run.t == [target if falls else time]
    assert one.run.knots == ([0] if knot and falls else [])
    assert (one.y.tolist(), one.run.accumulated[0].tolist()) == ([1.5, -1.5, 3.5], [3.5])
    assert one.run.outputs[0].tolist() == [target if falls else time, 1.5, -1.5, 3.5]
    assert (one._loop.time, one._loop.next_event) == (target if falls else time, 7.0)


@pytest.mark.parametrize(("y", "words"),
                         [([10.0, 0.0, 0.0], "left every bound"),
                          ([0.0, -20.0, 0.0], "left every bound"),
                          ([math.nan, 0.0, 0.0], "left every bound"),
                                          ([9.99, -19.99, math.inf],
                                           "Work or impulse was not a finite number"),
                                           ([9.99, -19.99, 1e300], "")])  # fmt: skip
def test_states_have_bounds_and_sums_are_numbers(y: list[float], words: str):
    one = integration(y=np.array(y))
    if words:
        with pytest.raises(Stop, match=rf"{words} at t = 0\.5 s") as caught:
            one._within_bounds(0.5)
        assert caught.value.outcome is (
            ReplayOutcome.DIVERGED if "bound" in words else ReplayOutcome.NOT_A_NUMBER
        )
    else:
        one._within_bounds(0.5)


def test_an_output_that_is_no_number_ends_the_run():
    one = integration()
    one.model.read = lambda time, y: np.array([math.nan])
    with pytest.raises(Stop, match=r"output was not.*finite number at t = 0\.5 s"):
        one._record(0.5, knot=True)
    assert one.run.t == []


@pytest.mark.parametrize(
    ("reason", "raised", "words"),
    [
        (Reason.DONE, None, ""), (Reason.WANTS_END, TerminationRequested, r"t = 2\.5 s"),
        (Reason.NEVER_SETTLES, Misbehaviour, "did not end"),
        (Reason.RATE_NOT_FINITE, Stop, r"A rate of change was not a finite number at t = 1\.5 s"),
        (Reason.OUTPUT_NOT_FINITE, Stop, r"An output was not a finite number at t = 2\.5 s"),
        (Reason.SOLVER_FAILED, Stop, r"CVODE stopped at t = 2\.5 s: "),
        (Reason.STOP_TIME_REFUSED, RuntimeError, r"CVODE refused its stop time at t = 2\.5 s"),
        (Reason.SETUP_REFUSED, RuntimeError, r"CVODE refused to be set up at t = 2\.5 s"),
    ],
)  # fmt: skip
def test_each_reason_of_a_loop_has_its_words(
    reason: Reason, raised: Any, words: str, monkeypatch: pytest.MonkeyPatch
):
    one = integration()
    if raised is None:
        one._check(int(reason))
    else:
        with pytest.raises(raised, match=words):
            one._check(int(reason))
    one.y = np.array([10.0, 0.0, 0.0])
    for gone in (Reason.OUT_OF_BOUNDS, Reason.SUM_NOT_FINITE, Reason.SOLVER_FAILED):
        with pytest.raises(Stop, match="left every bound"):
            one._check(int(gone))
    refused: list[Any] = []

    def refuse(*given: Any) -> Any:
        refused.append(given)
        raise KeyError

    monkeypatch.setattr(reference.loops, "refuse", refuse)
    with pytest.raises(KeyError):
        one._check(int(Reason.CALL_REFUSED))
    assert refused == [(one.model.instance, "fmu")]


def test_points_of_a_step_are_taken_as_the_loop_came_to_them():
    one = integration(
        targets=np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]), step=1,
        _outputs=np.arange(6.0).reshape(2, 3, 1),
        _sums=10 + np.arange(6.0).reshape(2, 3, 1),
    )  # fmt: skip
    one._take(0, 2)
    assert (one.run.t, one.run.knots) == ([0.4, 0.5], [])
    one._take(2, 2)
    one._take(2, 3)
    one._take(3, 3)
    assert (one.run.t, one.run.knots) == ([0.4, 0.5, 0.6], [2])
    assert [row.tolist() for row in one.run.outputs] == [[3.0], [4.0], [5.0]]
    assert [row.tolist() for row in one.run.accumulated] == [[13.0], [14.0], [15.0]]


def test_cvode_is_told_where_to_look_and_how_exactly():
    """Three points a step.

    No step longer than asked or than the plan, none that does not change the time any more; a tenth
    of the tolerance of each nominal.
    """
    held = plan([1.0, 2.0], 0.5)
    point = PointInC(Point(free))
    one = reference._Integration(point, held, 1e-9, 7, Run(), 3, math.inf)  # type: ignore[arg-type]
    loop, solver = one._loop, one._solver
    assert one.targets.tolist() == [
        [pytest.approx(0.5 / 3), pytest.approx(1.0 / 3), 0.5],
        [pytest.approx(0.5 + 0.5 / 3), pytest.approx(0.5 + 1.0 / 3), 1.0],
    ]
    assert (solver.rtol, solver.min_step, solver.max_step, solver.max_steps) == (
        1e-9,
        4e-16,
        1.0,
        100_000,
    )
    assert (loop.wants_steps, loop.linear) == (False, False)
    point.nominal = np.array([1.0, 100.0])
    one.over_all_steps(np.array([5.0, 0.5]))
    one.close()
    assert one._bound.tolist() == [5e9, 1e11]
    assert one._absolute == pytest.approx([0.1 * 1e-9, 0.1 * 1e-9 * 100.0, 0.1 * 1e-9])
    short = reference._Integration(PointInC(Point(free)), held, 1e-9, 7, Run(), 1, 0.125)  # type: ignore[arg-type]
    assert (short._solver.max_step, short.targets.tolist()) == (0.125, [[0.5], [1.0]])
    short.close()
    assert PARTS == 3
