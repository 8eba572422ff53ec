"""The reference integrator against closed forms, on small models written in Python: no FMU, no generated C.

By the loop in C, which calls them as it calls an FMU, and by its oracle in Python.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import python_loops

from models.errors import MachineError
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.fmi.instance import Misbehaviour, References, TerminationRequested
from validate.fmi.loops import Reason
from validate.judge.replay import reference
from validate.judge.replay.reference import PARTS
from validate.judge.replay.result import ReplayOutcome, Run, Stop
from validate.judge.replay.wiring import HeldInputs, Variables

RTOL = 1e-12


class Point:
    """One coordinate, dv/dt = force(q, v, u, contact mode): the mode is frozen between events, as in an FMU."""

    accumulated = 1
    outputs = 2
    next_event = math.inf

    def __init__(
        self,
        force: Callable[[float, float, float, bool], float],
        gap: Callable[[float], float] | None = None,
        bounce: float | None = None,
        wants_steps: bool = False,
    ) -> None:
        self.force, self.gap, self.bounce, self.wants_steps = force, gap, bounce, wants_steps
        self.indicators = 0 if gap is None else 1
        self.nominal = np.ones(2)
        self.u = 0.0
        self.closed = False
        self.events = 0
        self.steps = 0

    def start(self, time: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        self.set_inputs(u)
        self.closed = self.gap is not None and self.gap(state[0]) < 0
        return np.array(state)

    def set_inputs(self, u: Sequence[float] | np.ndarray) -> None:
        self.u = float(u[0]) if len(u) else 0.0

    def rates(self, time: float, y: np.ndarray, rates: np.ndarray) -> None:
        rates[:] = y[1], self.force(y[0], y[1], self.u, self.closed), self.u * y[1]

    def indicate(self, time: float, y: np.ndarray, values: np.ndarray) -> None:
        values[0] = self.gap(y[0]) if self.gap else 1.0

    def read(self, time: float, y: np.ndarray) -> np.ndarray:
        return np.array(y[:2])

    def event(self, time: float, y: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        self.events += 1
        if u is not None:
            self.set_inputs(u)
            return y
        if self.bounce is not None:
            return np.array([0.0, -self.bounce * y[1], y[2]])
        self.closed = y[1] < 0
        return y

    def step_completed(self, time: float, y: np.ndarray) -> bool:
        self.steps += 1
        return False


_STATES = (ctypes.c_void_p, ctypes.c_size_t)
_VALUES = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)


def doubles(address: int, count: int) -> ctypes.Array[ctypes.c_double]:
    return (ctypes.c_double * count).from_address(address)


class PointInC:
    """A Point in the clothes of a Model Exchange FMU of FMI 2.0: functions with addresses, for the loop in C. Value references: q 0, v 1, power 2, u 3."""

    states, major, fatal, component = 2, 2, False, 1

    def __init__(self, point: Point) -> None:
        self.point, self.instance, self.fmu = point, self, self
        self.next_event, self.nominal, self.wants_steps = point.next_event, point.nominal, point.wants_steps
        self.indicators, self.accumulated, self.outputs = point.indicators, point.accumulated, point.outputs
        self.references = References([2]), References([0, 1]), References([3])
        self.start, self.read, self.event = point.start, point.read, point.event
        self._time, self._y = 0.0, np.zeros(3)
        self._functions = {
            name: ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *types)(call) for name, (call, *types) in self._calls().items()
        }

    def address(self, name: str) -> int:
        return ctypes.cast(self._functions[name], ctypes.c_void_p).value or 0

    def _calls(self) -> dict[str, tuple[Any, ...]]:
        def set_time(_: int, time: float) -> int:
            self._time = time
            return 0

        def set_states(_: int, x: int, n: int) -> int:
            self._y[:2] = doubles(x, n)
            return 0

        def get_derivatives(_: int, rates: int, n: int) -> int:
            doubles(rates, n)[:] = self._rates()[:n]
            return 0

        def get_real(_: int, references: int, n: int, values: int) -> int:
            known = [*self._y[:2], self._rates()[2]]
            doubles(values, n)[:] = [known[reference] for reference in (ctypes.c_uint * n).from_address(references)]
            return 0

        def set_real(_: int, references: int, n: int, values: int) -> int:
            self.point.set_inputs(doubles(values, n)[:])
            return 0

        def get_indicators(_: int, values: int, n: int) -> int:
            self.point.indicate(self._time, self._y, np.frombuffer(doubles(values, n)))
            return 0

        def completed(_: int, last: int, event: Any, ends: Any) -> int:
            event[0] = self.point.step_completed(self._time, self._y)
            return 0

        def new_discrete_states(_: int, info: int) -> int:
            self.point.event(self._time, self._y, np.array([self.point.u]))  # inputs jumped; events of gaps come by `event`
            return 0

        flag = ctypes.POINTER(ctypes.c_int)
        return {
            "SetTime": (set_time, ctypes.c_double), "SetContinuousStates": (set_states, *_STATES), "GetContinuousStates": (lambda *_: 0, *_STATES),
            "GetDerivatives": (get_derivatives, *_STATES), "GetReal": (get_real, *_VALUES), "SetReal": (set_real, *_VALUES),
            "GetEventIndicators": (get_indicators, *_STATES), "CompletedIntegratorStep": (completed, ctypes.c_int, flag, flag),
            "EnterEventMode": (lambda _: 0,), "EnterContinuousTimeMode": (lambda _: 0,),
            "NewDiscreteStates": (new_discrete_states, ctypes.c_void_p),
        }  # fmt: skip

    def _rates(self) -> list[float]:
        rates = np.empty(3)
        self.point.rates(self._time, self._y, rates)
        return rates.tolist()


Integrate = Callable[[Point, np.ndarray, HeldInputs, float, int], Run]


@pytest.fixture(params=["C", "Python"])
def integrate(request: pytest.FixtureRequest) -> Integrate:
    if request.param == "Python":
        return python_loops.integrate
    return lambda model, *given: reference.integrate(PointInC(model), *given)  # type: ignore[arg-type] - it has what the loop asks for


def plan(u: Sequence[float], step: float, hold: Hold = Hold.ZERO_ORDER) -> HeldInputs:
    steps = len(u)
    zeros = np.zeros((steps + 1, 1))
    grid = uniform_grid(step, steps)
    return HeldInputs(Trajectory(t=grid, q=zeros, v=zeros, u=np.array(u, dtype=float)[:, None], lam=np.zeros((steps, 0)), hold=hold))


def free(q: float, v: float, u: float, closed: bool) -> float:
    return u


def test_held_inputs_give_the_exact_parabolas(integrate: Integrate):
    u = [1.0, -2.0, -2.0, 0.5]
    run = integrate(Point(free), np.zeros(2), plan(u, 0.25), RTOL, 10)
    q = v = work = 0.0
    for value, knot in zip(u, run.knots[1:], strict=True):
        q, v, work = q + 0.25 * v + value * 0.25**2 / 2, v + 0.25 * value, work + value * (0.25 * v + value * 0.25**2 / 2)
        assert run.outputs[knot] == pytest.approx([q, v], abs=1e-12)
        assert run.accumulated[knot][0] == pytest.approx(work, abs=1e-12)


def test_ramped_inputs_are_applied_within_the_step(integrate: Integrate):
    """u = t on [0, 1]: q = t^3/6 at every recorded point. The last step of the plan is held."""
    steps = 6
    run = integrate(Point(free), np.zeros(2), plan(uniform_grid(0.2, steps - 1), 0.2, Hold.LINEAR), RTOL, 10)
    assert len(run.t) == steps * PARTS + 1
    for t, (q, v) in zip(run.t, run.outputs, strict=True):
        if t <= 1.0:
            assert q == pytest.approx(t**3 / 6, abs=1e-12)
            assert v == pytest.approx(t**2 / 2, abs=1e-12)
    held = integrate(Point(free), np.zeros(2), plan(uniform_grid(0.2, steps - 1), 0.2), RTOL, 10)
    assert abs(held.outputs[-1][0] - run.outputs[-1][0]) > 1e-2  # the hold convention makes a difference that a test can see


def test_a_ramp_that_turns_restarts_the_integrator_where_it_turns(integrate: Integrate):
    u = np.array([0.0, 1.0, 0.0, -1.0, 0.0])
    run = integrate(Point(free), np.zeros(2), plan(u, 0.5, Hold.LINEAR), RTOL, 10)
    q = v = 0.0
    for first, last in zip(u, np.append(u[1:], u[-1]), strict=True):
        q, v = q + 0.5 * v + 0.25 * (first / 3 + last / 6), v + 0.25 * (first + last)
    assert run.outputs[-1] == pytest.approx([q, v], abs=1e-12)


def test_inputs_that_do_not_change_cost_no_restart(integrate: Integrate):
    model = Point(free)
    integrate(model, np.zeros(2), plan([1.0] * 50, 0.01), RTOL, 10)
    assert model.events == 0


def test_a_bounce_on_a_spring_is_timed_to_the_closed_form(integrate: Integrate):
    mass, gravity, stiffness, drop = 1.0, 9.81, 1000.0, 0.5
    rate, speed = math.sqrt(stiffness / mass), math.sqrt(2 * gravity * drop)
    fall = speed / gravity
    contact = (2 * math.pi - 2 * math.atan2(speed / rate, mass * gravity / stiffness)) / rate
    model = Point(lambda q, v, u, closed: -gravity - (stiffness * q if closed else 0.0), gap=lambda q: q)
    run = integrate(model, np.array([drop, 0.0]), plan([0.0] * 70, 0.01), RTOL, 10)
    assert [closes for _, _, closes in run.events] == [True, False]
    assert [time for time, _, _ in run.events] == pytest.approx([fall, fall + contact], abs=1e-10)
    q, v = run.outputs[-1]
    assert v**2 / 2 + gravity * q == pytest.approx(gravity * drop, rel=1e-10)


def test_events_are_points_of_the_grid_and_knots_stay_the_plan(integrate: Integrate):
    model = Point(lambda q, v, u, closed: -10.0 - (1e3 * q if closed else 0.0), gap=lambda q: q)
    held = plan([0.0] * 40, 0.01)
    run = integrate(model, np.array([0.2, 0.0]), held, 1e-10, 10)
    assert np.array(run.t)[run.knots].tolist() == held.times.tolist()
    assert all(time in run.t for time, _, _ in run.events)
    assert (np.diff(run.t) > 0).all()


def test_a_bouncing_ball_that_comes_to_rest_ends_with_its_event_budget(integrate: Integrate):
    """Zeno: restitution 1/2 from 1 m at 10 m/s^2 rests after sqrt(0.2)*3 = 1.34 s, after infinitely many events."""
    run = integrate(
        Point(lambda q, v, u, closed: -10.0, gap=lambda q: q, bounce=0.5), np.array([1.0, 0.0]), plan([0.0] * 200, 0.01), RTOL, 12
    )
    assert run.outcome is ReplayOutcome.EVENT_BUDGET
    assert "12" in run.message
    first = math.sqrt(0.2)
    assert [time for time, _, _ in run.events[:3]] == pytest.approx([first, 2 * first, 2.5 * first], abs=1e-9)
    assert run.t[-1] < 3 * first


def test_a_state_that_runs_away_is_an_outcome(integrate: Integrate):
    run = integrate(Point(lambda q, v, u, closed: v * v), np.array([0.0, 1.0]), plan([0.0] * 200, 0.01), RTOL, 10)
    assert run.outcome in (ReplayOutcome.DIVERGED, ReplayOutcome.INTEGRATION_FAILED)
    assert 0.9 < run.t[-1] < 1.0  # v = 1/(1 - t)
    assert np.isfinite(np.array(run.outputs)).all()


def test_exponential_growth_stops_at_the_bound(integrate: Integrate):
    run = integrate(Point(lambda q, v, u, closed: 400.0 * q), np.array([1.0, 20.0]), plan([0.0] * 300, 0.01), RTOL, 10)
    assert run.outcome is ReplayOutcome.DIVERGED
    assert run.t[-1] == pytest.approx(math.log(1e9) / 20, abs=0.1)


def test_a_rate_that_is_no_number_is_an_outcome(integrate: Integrate):
    run = integrate(Point(lambda q, v, u, closed: math.nan if q > 0.5 else 1.0), np.zeros(2), plan([0.0] * 200, 0.01), RTOL, 10)
    assert run.outcome is ReplayOutcome.NOT_A_NUMBER
    assert "finite" in run.message
    assert np.isfinite(np.array(run.outputs)).all()


def test_a_model_that_wants_to_know_its_steps_is_told_and_moves_the_same(integrate: Integrate):
    def spring(q: float, v: float, u: float, closed: bool) -> float:
        return -10.0 - (1e3 * q if closed else 0.0)

    told, untold = Point(spring, gap=lambda q: q, wants_steps=True), Point(spring, gap=lambda q: q)
    runs = [integrate(model, np.array([0.2, 0.0]), plan([0.0] * 40, 0.01), RTOL, 10) for model in (told, untold)]
    assert told.steps >= 120
    assert untold.steps == 0
    assert runs[0].outputs[-1] == pytest.approx(runs[1].outputs[-1], abs=1e-9)
    assert len(runs[0].events) == len(runs[1].events) == 2


# What is done with the answers of CVODE and of the FMU


class Told:
    """An FMU for Model Exchange whose calls are noted."""

    state_count, indicator_count, wants_steps, next_event = 2, 1, False, math.inf

    def __init__(self) -> None:
        self.log: list[Any] = []
        self.fmu = SimpleNamespace(enterEventMode=lambda: self.log.append("enter"), directional=self.directional)
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

    def directional(self, unknowns: Any, knowns: list[int], seed: list[float], size: int) -> list[float]:
        assert (seed, size) == ([1.0], len(unknowns))
        return [10.0 * unknown + knowns[0] for unknown in unknowns]


@pytest.fixture
def exchange(monkeypatch: pytest.MonkeyPatch) -> tuple[reference.ExchangeModel, Told]:
    told = Told()
    monkeypatch.setattr(reference, "load_instance", lambda package, kind: told if kind == "ME" else None)
    variables = Variables(q=(1,), v=(2,), u=(5,), lam=(3,), gap=(), energies={}, powers={"input_power": 6}, zero=frozenset(), parameters=((7, 0.5),), start=(1, 2),
                          internal_step=None, choices=((8, 1),))  # fmt: skip
    return reference.ExchangeModel(None, variables), told  # type: ignore[arg-type]


def test_an_fmu_is_started_moved_and_asked_in_its_order(exchange: tuple[reference.ExchangeModel, Told]):
    model, told = exchange
    assert (model.states, model.indicators, model.accumulated, model.outputs) == (2, 1, 2, 3)
    x = model.start(0.25, np.array([3.0, 4.0]), np.array([6.0]))
    assert (x.tolist(), model.nominal.tolist()) == ([8.0, 9.0], [1.0, 4.0]), "a nominal that is none is 1"
    assert told.log[0] == ("choose", ((8, 1),))
    (name, time, settings, inputs, u) = told.log[1]
    assert (name, time, settings, inputs.array[:], u.tolist()) == ("initialise", 0.25, [(7, 0.5), (1, 3.0), (2, 4.0)], [5], [6.0])
    told.log.clear()
    assert model.read(1.5, np.array([1.0, 2.0, 70.0, 80.0])).tolist() == [1.0, 2.0, 3.0]
    assert told.log == [("move", 1.5, [1.0, 2.0])]
    assert model.jacobian(2.5, np.array([1.0, 2.0]), [3, 4], [5, 6, 7]).tolist() == [[35.0, 36.0, 37.0], [45.0, 46.0, 47.0]]
    told.log.clear()
    y = np.array([1.0, 2.0, 70.0])
    assert model.event(3.5, y, None) is y
    told.changed = True
    assert model.event(3.5, y, np.array([6.5])).tolist() == [8.0, 9.0, 70.0]
    assert told.log == [("move", 3.5, [1.0, 2.0]), "enter", ("move", 3.5, [1.0, 2.0]), "enter", ("write", [5], [6.5])]
    model.close()
    assert told.log[-1] == ("unload",)


def integration(**more: Any) -> Any:
    """An integration in progress: two states and one sum, of which a state is out of bounds at 10 and at 20."""
    found = object.__new__(reference._Integration)
    given = {
        "run": Run(), "event_budget": 2, "y": np.array([1.0, -2.0, 3.0]), "_bound": np.array([10.0, 20.0]), "_roots": np.array([0, -1, 1]), "step": 0,
        "model": SimpleNamespace(states=2, event=lambda time, y, u: y + 0.5, read=lambda time, y: np.array([time, *y]), instance=SimpleNamespace(next_event=7.0)),
        "_loop": SimpleNamespace(time=2.5, fault_time=1.5, flag=-4, fmu="fmu"), "_set_inputs": lambda: None,
        "_loops": SimpleNamespace(integration_renew=lambda at: 0), "_at": 0,
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


@pytest.mark.parametrize(("time", "target", "falls"), [(2.0, 2.0, True), (2.0, 2.0 + 1.5e-13, True), (2.0, 2.0 + 3e-13, False), (0.1, 0.1 - 0.9e-13, True), (0.1, 0.1 - 1.2e-13, False), (-5.0, -5.0 + 4e-13, True)])  # fmt: skip
@pytest.mark.parametrize("knot", [True, False])
def test_an_event_falls_on_a_point_but_for_rounding(time: float, target: float, falls: bool, knot: bool):
    one = integration()
    assert one._after_event(time, target, knot) is falls
    assert one.run.t == [target if falls else time]
    assert one.run.knots == ([0] if knot and falls else [])
    assert (one.y.tolist(), one.run.accumulated[0].tolist()) == ([1.5, -1.5, 3.5], [3.5])
    assert one.run.outputs[0].tolist() == [target if falls else time, 1.5, -1.5, 3.5]
    assert (one._loop.time, one._loop.next_event) == (target if falls else time, 7.0)


@pytest.mark.parametrize(("y", "words"), [([10.0, 0.0, 0.0], "left every bound"), ([0.0, -20.0, 0.0], "left every bound"), ([math.nan, 0.0, 0.0], "left every bound"),
                                          ([9.99, -19.99, math.inf], "Work or impulse was not a finite number"), ([9.99, -19.99, 1e300], "")])  # fmt: skip
def test_states_have_bounds_and_sums_are_numbers(y: list[float], words: str):
    one = integration(y=np.array(y))
    if words:
        with pytest.raises(Stop, match=rf"{words} at t = 0\.5 s") as caught:
            one._within_bounds(0.5)
        assert caught.value.outcome is (ReplayOutcome.DIVERGED if "bound" in words else ReplayOutcome.NOT_A_NUMBER)
    else:
        one._within_bounds(0.5)


def test_an_output_that_is_no_number_ends_the_run():
    one = integration()
    one.model.read = lambda time, y: np.array([math.nan])
    with pytest.raises(Stop, match=r"An output was not a finite number at t = 0\.5 s"):
        one._record(0.5, knot=True)
    assert one.run.t == []


@pytest.mark.parametrize(
    ("reason", "raised", "words"),
    [
        (Reason.DONE, None, ""), (Reason.WANTS_END, TerminationRequested, r"t = 2\.5 s"), (Reason.NEVER_SETTLES, Misbehaviour, "did not end"),
        (Reason.RATE_NOT_FINITE, Stop, r"A rate of change was not a finite number at t = 1\.5 s"), (Reason.OUTPUT_NOT_FINITE, Stop, r"An output was not a finite number at t = 2\.5 s"),
        (Reason.SOLVER_FAILED, Stop, r"CVODE stopped at t = 2\.5 s: "), (Reason.STOP_TIME_REFUSED, RuntimeError, r"CVODE refused its stop time at t = 2\.5 s"),
        (Reason.SETUP_REFUSED, RuntimeError, r"CVODE refused to be set up at t = 2\.5 s"),
    ],
)  # fmt: skip
def test_each_reason_of_a_loop_has_its_words(reason: Reason, raised: Any, words: str, monkeypatch: pytest.MonkeyPatch):
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
        targets=np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]),
        step=1,
        _outputs=np.arange(6.0).reshape(2, 3, 1),
        _sums=10 + np.arange(6.0).reshape(2, 3, 1),
    )
    one._take(0, 2)
    assert (one.run.t, one.run.knots) == ([0.4, 0.5], [])
    one._take(2, 2)
    one._take(2, 3)
    one._take(3, 3)
    assert (one.run.t, one.run.knots) == ([0.4, 0.5, 0.6], [2])
    assert ([row.tolist() for row in one.run.outputs], [row.tolist() for row in one.run.accumulated]) == (
        [[3.0], [4.0], [5.0]],
        [[13.0], [14.0], [15.0]],
    )


def test_a_solver_that_is_missing_damaged_or_of_another_version_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for spec in (None, SimpleNamespace(submodule_search_locations=[str(tmp_path)]), SimpleNamespace(submodule_search_locations=None)):
        monkeypatch.setattr(reference.importlib.util, "find_spec", lambda name, spec=spec: spec)
        with pytest.raises(MachineError, match="CVODE, is missing"):
            reference.solver_addresses.__wrapped__()
    (tmp_path / "_cy_cvode.py").write_text("")
    (tmp_path / "_cy_cvode.x.so").write_bytes(b"nothing")
    monkeypatch.setattr(reference.importlib.util, "find_spec", lambda name: SimpleNamespace(submodule_search_locations=[str(tmp_path)]))
    with pytest.raises(MachineError, match=r"cannot be reached in .*_cy_cvode\.x\.so \("):
        reference.solver_addresses.__wrapped__()
    monkeypatch.undo()
    assert len(reference.solver_addresses()) == len(reference.SOLVER)
    monkeypatch.setattr(reference, "_VERSION", 6)
    with pytest.raises(MachineError, match=r"is of SUNDIALS 7 in .*, not 6"):
        reference.solver_addresses.__wrapped__()


def test_cvode_is_told_where_to_look_and_how_exactly():
    """Three points a step; no step longer than asked or than the plan, none that does not change the time any more; a tenth of the tolerance of each nominal."""
    held = plan([1.0, 2.0], 0.5)
    point = PointInC(Point(free))
    one = reference._Integration(point, held, 1e-9, 7, Run(), 3, math.inf)  # type: ignore[arg-type]
    loop = one._loop
    assert one.targets.tolist() == [
        [pytest.approx(0.5 / 3), pytest.approx(1.0 / 3), 0.5],
        [pytest.approx(0.5 + 0.5 / 3), pytest.approx(0.5 + 1.0 / 3), 1.0],
    ]
    assert (loop.rtol, loop.min_step, loop.max_step, loop.max_steps, loop.wants_steps, loop.linear) == (
        1e-9,
        4e-16,
        1.0,
        100_000,
        False,
        False,
    )
    point.nominal = np.array([1.0, 100.0])
    one.over_all_steps(np.array([5.0, 0.5]))
    one.close()
    assert one._bound.tolist() == [5e9, 1e11]
    assert one._absolute == pytest.approx([0.1 * 1e-9, 0.1 * 1e-9 * 100.0, 0.1 * 1e-9])
    short = reference._Integration(PointInC(Point(free)), held, 1e-9, 7, Run(), 1, 0.125)  # type: ignore[arg-type]
    assert (short._loop.max_step, short.targets.tolist()) == (0.125, [[0.5], [1.0]])
    short.close()
    assert PARTS == 3
