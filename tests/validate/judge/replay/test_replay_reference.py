"""The reference integrator against closed forms, on small models written in Python: no FMU, no generated C.

By the loop in C, which calls them as it calls an FMU, and by its oracle in Python.
"""

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import python_loops

from models.trajectory import Hold, Trajectory, uniform_grid
from validate.fmi.instance import References
from validate.judge.replay import reference
from validate.judge.replay.reference import PARTS
from validate.judge.replay.result import ReplayOutcome, Run
from validate.judge.replay.wiring import HeldInputs

RTOL = 1e-12
Force = Callable[[float, float, float, bool], float]
Gap = Callable[[float], float]


class Point:
    """One coordinate, dv/dt = force(q, v, u, contact mode): the mode is frozen between events, as in an FMU."""

    accumulated = 1
    outputs = 2
    next_event = math.inf

    def __init__(
        self,
        force: Force,
        gap: Gap | None = None,
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

    states = 2
    major = 2
    fatal = False
    component = 1

    def __init__(self, point: Point) -> None:
        self.point, self.instance, self.fmu = point, self, self
        self.next_event, self.nominal, self.wants_steps = (
            point.next_event,
            point.nominal,
            point.wants_steps,
        )
        self.indicators, self.accumulated, self.outputs = (
            point.indicators,
            point.accumulated,
            point.outputs,
        )
        self.references = References([2]), References([0, 1]), References([3])
        self.start, self.read, self.event = point.start, point.read, point.event
        self._time, self._y = 0.0, np.zeros(3)
        self._functions = {
            name: ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *types)(
                lambda *given, call=call: call(*given) or 0
            )
            for name, (call, *types) in self._calls().items()
        }

    def address(self, name: str) -> int:
        return ctypes.cast(self._functions[name], ctypes.c_void_p).value or 0

    def _calls(self) -> dict[str, tuple[Any, ...]]:
        """Each returns nothing, where an FMU says that all is well."""

        def set_time(_: int, time: float) -> None:
            self._time = time

        def set_states(_: int, x: int, n: int) -> None:
            self._y[:2] = doubles(x, n)

        def get_derivatives(_: int, rates: int, n: int) -> None:
            doubles(rates, n)[:] = self._rates()[:n]

        def get_real(_: int, references: int, n: int, values: int) -> None:
            known = [*self._y[:2], self._rates()[2]]
            doubles(values, n)[:] = [
                known[reference] for reference in (ctypes.c_uint * n).from_address(references)
            ]

        def set_real(_: int, references: int, n: int, values: int) -> None:
            self.point.set_inputs(doubles(values, n)[:])

        def get_indicators(_: int, values: int, n: int) -> None:
            self.point.indicate(self._time, self._y, np.frombuffer(doubles(values, n)))

        def completed(_: int, last: int, event: Any, ends: Any) -> None:
            event[0] = self.point.step_completed(self._time, self._y)

        def new_discrete_states(_: int, info: int) -> None:
            self.point.event(
                self._time, self._y, np.array([self.point.u])
            )  # inputs jumped; events of gaps come by `event`

        flag = ctypes.POINTER(ctypes.c_int)
        return {
            "SetTime": (set_time, ctypes.c_double), "SetContinuousStates": (set_states, *_STATES),
            "GetContinuousStates": (lambda *_: 0, *_STATES),
            "GetDerivatives": (get_derivatives, *_STATES), "GetReal": (get_real, *_VALUES),
            "SetReal": (set_real, *_VALUES),
            "GetEventIndicators": (get_indicators, *_STATES),
            "CompletedIntegratorStep": (completed, ctypes.c_int, flag, flag),
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
    return HeldInputs(
        Trajectory(
            t=grid,
            q=zeros,
            v=zeros,
            u=np.array(u, dtype=float)[:, None],
            lam=np.zeros((steps, 0)),
            hold=hold,
        )
    )


def free(q: float, v: float, u: float, closed: bool) -> float:
    return u


def test_held_inputs_give_the_exact_parabolas(integrate: Integrate):
    u = [1.0, -2.0, -2.0, 0.5]
    run = integrate(Point(free), np.zeros(2), plan(u, 0.25), RTOL, 10)
    q = v = work = 0.0
    for value, knot in zip(u, run.knots[1:], strict=True):
        q, v, work = (
            q + 0.25 * v + value * 0.25**2 / 2,
            v + 0.25 * value,
            work + value * (0.25 * v + value * 0.25**2 / 2),
        )
        assert run.outputs[knot] == pytest.approx([q, v], abs=1e-12)
        assert run.accumulated[knot][0] == pytest.approx(work, abs=1e-12)


def test_ramped_inputs_are_applied_within_the_step(integrate: Integrate):
    """u = t on [0, 1]: q = t^3/6 at every recorded point. The last step of the plan is held."""
    steps = 6
    run = integrate(
        Point(free), np.zeros(2), plan(uniform_grid(0.2, steps - 1), 0.2, Hold.LINEAR), RTOL, 10
    )
    assert len(run.t) == steps * PARTS + 1
    for t, (q, v) in zip(run.t, run.outputs, strict=True):
        if t <= 1.0:
            assert q == pytest.approx(t**3 / 6, abs=1e-12)
            assert v == pytest.approx(t**2 / 2, abs=1e-12)
    held = integrate(Point(free), np.zeros(2), plan(uniform_grid(0.2, steps - 1), 0.2), RTOL, 10)
    assert (
        abs(held.outputs[-1][0] - run.outputs[-1][0]) > 1e-2
    )  # the hold convention makes a difference that a test can see


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
    model = Point(
        lambda q, v, u, closed: -gravity - (stiffness * q if closed else 0.0), gap=lambda q: q
    )
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
        Point(lambda q, v, u, closed: -10.0, gap=lambda q: q, bounce=0.5),
        np.array([1.0, 0.0]),
        plan([0.0] * 200, 0.01),
        RTOL,
        12,
    )
    assert run.outcome is ReplayOutcome.EVENT_BUDGET
    assert "12" in run.message
    first = math.sqrt(0.2)
    assert [time for time, _, _ in run.events[:3]] == pytest.approx(
        [first, 2 * first, 2.5 * first], abs=1e-9
    )
    assert run.t[-1] < 3 * first


def test_a_state_that_runs_away_is_an_outcome(integrate: Integrate):
    run = integrate(
        Point(lambda q, v, u, closed: v * v),
        np.array([0.0, 1.0]),
        plan([0.0] * 200, 0.01),
        RTOL,
        10,
    )
    assert run.outcome in (ReplayOutcome.DIVERGED, ReplayOutcome.INTEGRATION_FAILED)
    assert 0.9 < run.t[-1] < 1.0  # v = 1/(1 - t)
    assert np.isfinite(np.array(run.outputs)).all()


def test_exponential_growth_stops_at_the_bound(integrate: Integrate):
    run = integrate(
        Point(lambda q, v, u, closed: 400.0 * q),
        np.array([1.0, 20.0]),
        plan([0.0] * 300, 0.01),
        RTOL,
        10,
    )
    assert run.outcome is ReplayOutcome.DIVERGED
    assert run.t[-1] == pytest.approx(math.log(1e9) / 20, abs=0.1)


def test_a_rate_that_is_no_number_is_an_outcome(integrate: Integrate):
    run = integrate(
        Point(lambda q, v, u, closed: math.nan if q > 0.5 else 1.0),
        np.zeros(2),
        plan([0.0] * 200, 0.01),
        RTOL,
        10,
    )
    assert run.outcome is ReplayOutcome.NOT_A_NUMBER
    assert "finite" in run.message
    assert np.isfinite(np.array(run.outputs)).all()


def test_a_model_that_wants_to_know_its_steps_is_told_and_moves_the_same(integrate: Integrate):
    def spring(q: float, v: float, u: float, closed: bool) -> float:
        return -10.0 - (1e3 * q if closed else 0.0)

    told, untold = Point(spring, gap=lambda q: q, wants_steps=True), Point(spring, gap=lambda q: q)
    runs = [
        integrate(model, np.array([0.2, 0.0]), plan([0.0] * 40, 0.01), RTOL, 10)
        for model in (told, untold)
    ]
    assert told.steps >= 120
    assert untold.steps == 0
    assert runs[0].outputs[-1] == pytest.approx(runs[1].outputs[-1], abs=1e-9)
    assert len(runs[0].events) == len(runs[1].events) == 2


# What is done with the answers of CVODE and of the FMU
