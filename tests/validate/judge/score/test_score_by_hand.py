"""Every metric of the score by exact numbers worked out by hand, once more in a mirror, and once more in other units.

A body of two coordinates of different units and sizes rests far from its contacts: every metric is
zero. Then one thing is off at a time, by a number that can be followed by hand, on either side.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
import sympy as sp

from models.scene import Contact, Coordinate, Input, Scene, Task
from models.scene.contacts import Friction
from models.scene.parts import goal_limits
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.judge.replay import Difference, Replay, ReplayError, ReplayOutcome
from validate.judge.score import measures, score
from validate.judge.score.evidence import Evidence
from validate.judge.score.table import TABLE
from validate.judge.score.verdict import Metric

STEPS = 4
H = 0.125
NODES = STEPS + 1
ROWS = 2 * STEPS + 1
M = 2.0
J = 0.5
SIDES = pytest.mark.parametrize("side", [1.0, -1.0], ids=["as it is", "in a mirror"])


@dataclass(frozen=True)
class Sizes:
    """How many of our units one of the body's is: what is 1 m there is `length` m here."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0

    @property
    def force(self) -> float:
        return self.mass * self.length / self.time**2

    def of(self, unit: str) -> float:
        """How much larger a number with this unit is here."""
        work = self.force * self.length
        powers = {
            "m": self.length,
            "s": self.time,
            "N": self.force,
            "J": work,
            "W": work / self.time,
            "N^2": self.force**2,
        }
        over, _, under = unit.partition("/")
        return math.prod(powers.get(name, 1.0) for name in over.split()) / math.prod(
            powers.get(name, 1.0) for name in under.split()
        )


AS_IT_IS = Sizes()


@pytest.fixture(autouse=True)
def all_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the round numbers of this file as exact."""

    def nothing(case: Evidence) -> dict[str, np.ndarray]:
        plan = case.trajectory
        return {group: np.zeros_like(getattr(plan, group)) for group in ("q", "v", "u", "lam")}

    exact = cached_property(nothing)
    exact.__set_name__(Evidence, "rounding")
    monkeypatch.setattr(Evidence, "rounding", exact)


def scene_of(side: float, sizes: Sizes = AS_IT_IS) -> Scene:
    """x [m] over a floor of 100 N/m, an angle a [rad] with a stop of 40 N/m at 1 rad on a lever of 0.5 m, and friction on a lever of 0.25 m."""
    x, a, v, w, f, m = sp.symbols("x a v w f m", real=True)
    L, F, T = sizes.length, sizes.force, sizes.time
    bounds = [(-3.0 * F, 5.0 * F), (-1.0 * F * L, 0.5 * F * L)]
    force, torque = bounds if side > 0 else [(-high, -low) for low, high in bounds]
    speed = [value * L / T for value in ((-2.0, 1.5) if side > 0 else (-1.5, 2.0))]
    return Scene(
        name="by_hand", title="A body on a floor with an arm against a stop",
        source="worked out by hand",
        coordinates=(
            Coordinate(symbol=x, velocity=v, unit="m", nominal=0.5 * L, velocity_lower=speed[0],
                       velocity_upper=speed[1]),
            Coordinate(symbol=a, velocity=w, unit="rad", nominal=2.0),
        ),
        inputs=(Input(symbol=f, unit="N", lower=force[0], upper=force[1]),
                Input(symbol=m, unit="N m", lower=torque[0], upper=torque[1])),
        parameters=(), kinetic_energy=sizes.mass * (M * v**2 + J * L**2 * w**2) / 2,
        potential_energy=sp.Integer(0), forces=(f, m),
        contacts=(
            Contact(
                name="floor", bodies=("body", "floor"), penetration=-side * x,
                stiffness=100.0 * F / L, nominal=0.05 * L, depth=0.4 * L,
                depth_reason="its thickness",
            ),
            Contact(
                name="stop", bodies=("arm", "stop"), penetration=L * (side * a - 1.0) / 2,
                stiffness=40.0 * F / L, nominal=0.1 * L, depth=0.2 * L,
                depth_reason="its thickness",
            ),
        ),
        frictions=(Friction(name="rub", slip=L * w / 4, coefficient=sp.Rational(3, 10),
                            contact="floor", nominal=0.2 * L / T),),
        task=Task(
            start=(side * L, side * 0.4, 0.0, 0.0), goal=(side * L, side * 0.4, 0.0, 0.0),
            running_cost=f**2 + 3 * m**2 + x**2,
            final_cost=7 * a**2 + v**2, step=H * T, steps=STEPS,
        ),
        limits=goal_limits(position=0.01, velocity=0.02,
                           reason="a hundredth, and twice that a second"),
    )  # fmt: skip


def still(rows: int, side: float, length: float) -> np.ndarray:
    return np.tile([side * length, side * 0.4], (rows, 1))


class Case:
    """A plan and its replay at rest, to be changed in place."""

    def __init__(self, side: float, sizes: Sizes = AS_IT_IS) -> None:
        self.side, self.sizes, self.scene = side, sizes, scene_of(side, sizes)
        L, T = sizes.length, sizes.time
        self.plan: dict[str, Any] = {
            "t": uniform_grid(H * T, STEPS), "q": still(NODES, side, L), "v": np.zeros((NODES, 2)),
            "u": np.zeros((STEPS, 2)),
            "lam": np.zeros((STEPS, 3)), "scheme": Scheme.SEMI_IMPLICIT_EULER,
        }  # fmt: skip
        gap = np.tile([1.0 * L, 0.3 * L], (ROWS, 1))
        nothing = np.zeros(ROWS)
        self.replay: dict[str, Any] = {
            "scene": "by_hand", "outcome": ReplayOutcome.OK, "message": "", "method": "reference",
            "t": uniform_grid(H * T / 2, 2 * STEPS),
            "q": still(ROWS, side, L), "v": np.zeros((ROWS, 2)), "lam": np.zeros((ROWS, 2)),
            "gap": gap, "friction": np.zeros((ROWS, 1)),
            "knots": np.arange(0, ROWS, 2), "kinetic_energy": nothing.copy(),
            "potential_energy": nothing.copy(), "contact_energy": nothing.copy(),
            "input_work": nothing.copy(), "dissipated_work": nothing.copy(),
            "contact_impulse": np.zeros((ROWS, 2)), "events": (),
            "event_budget": 100,
            "error": ReplayError(estimate=Difference(position=0.0, state=0.0, gap=0.0)),
            "seconds_reference": 0.0,
            "seconds_everyday": 0.0, "fmu": "none",
        }  # fmt: skip

    def replayed(self) -> Replay:
        return Replay(
            **{
                key: value.copy() if isinstance(value, np.ndarray) else value
                for key, value in self.replay.items()
            }
        )

    def evidence(self, **known: Any) -> Evidence:
        """What is measured from, with some of it given instead of computed."""
        found = Evidence(self.scene, Trajectory(**self.plan), self.replayed())
        found.__dict__.update(known)
        return found

    def metric(self, name: str) -> Metric:
        found = score(self.scene, Trajectory(**self.plan), self.replayed()).metric(name)
        assert found is not None, name
        return found


def test_at_rest_every_metric_is_nothing():
    """But the costs: 1 m squared at the start of four steps, and seven times 0.4 rad squared."""
    case = Case(1.0)
    found = score(case.scene, Trajectory(**case.plan), Replay(**case.replay))
    costs = {metric.name: metric.value for metric in found.metrics if "cost" in metric.name}
    assert costs == pytest.approx({"cost": 4.0 + 7 * 0.16, "replay_cost": 4.0 + 7 * 0.16})
    rest = {
        metric.name: metric.value
        for metric in found.metrics
        if "cost" not in metric.name and metric.value is not None
    }
    assert len(rest) > 20
    assert rest == pytest.approx(dict.fromkeys(rest, 0.0), abs=1e-15)


# What is off, by how much it is found to be, in which unit, and the limit that this is held
# against.
Change = Callable[[Case], None]
FOUND: list[tuple[str, str, float, str, float | None, Change]] = []


def off(
    what: str, name: str, value: float, unit: str, limit: float | None = None
) -> Callable[[Change], Change]:
    def noted(change: Change) -> Change:
        FOUND.append((what, name, value, unit, limit, change))
        return change

    return noted


# What changes its sign in a mirror: of the forces of the plan only friction, in their last column.
_MIRRORED = ("q", "v", "u", "friction")
FRICTION = 2
# The unit of each array, or of its columns.
_UNITS = {
    "t": "s", "q": ("m", "rad"), "v": ("m/s", "rad/s"), "u": ("N", "N m"), "lam": "N", "gap": "m",
    "friction": "N", "contact_impulse": "N s",
    "kinetic_energy": "J", "contact_energy": "J", "input_work": "J", "dissipated_work": "J",
}  # fmt: skip


def put(group: str, place: Any, value: float | np.ndarray) -> Change:
    """Adds to an array of the plan, or of `replay.`: the values are those of the body as it is."""

    def change(case: Case) -> None:
        of_replay, _, name = group.rpartition(".")
        turns = name in _MIRRORED or (group == "lam" and place[1] == FRICTION)
        unit = _UNITS[name] if isinstance(_UNITS[name], str) else _UNITS[name][place[1]]
        (case.replay if of_replay else case.plan)[name][place] += (
            value * case.sizes.of(unit) * (case.side if turns else 1.0)
        )

    return change


def both(*changes: Change) -> Change:
    def change(case: Case) -> None:
        for one in changes:
            one(case)

    return change


def undeclared(case: Case) -> None:
    case.plan["scheme"] = None


for sign in (1.0, -1.0):
    # 0.3 of 2 rad is less than 0.2 of 0.5 m; the task asks for no way, so the nominals are the
    # scale.
    off("start, angle", "start_error", 0.3, "rad", 2e-6)(put("q", (0, 1), sign * 0.3))
    off("start, both", "start_error", 0.2, "m", 0.5e-6)(
        both(put("q", (0, 0), sign * 0.2), put("q", (0, 1), 0.3))
    )
    off("start, speed", "start_error", 0.7, "rad/s", 2e-6)(put("v", (0, 1), sign * 0.7))
    off("end, position", "terminal_position_error", 0.5, "m, rad", 0.01)(
        both(put("q", (-1, 0), sign * 0.3), put("q", (-1, 1), -sign * 0.4))
    )
    off("end, velocity", "terminal_velocity_error", 1.3, "m/s, rad/s", 0.02)(
        both(put("v", (-1, 0), sign * 0.5), put("v", (-1, 1), sign * 1.2))
    )
    off("end, both", "terminal_error", 1.3, "m, rad, m/s, rad/s")(
        both(put("q", (-1, 1), sign * 0.5), put("v", (-1, 0), sign * 1.2))
    )
    # f^2 + 3 m^2 of one step each, and the rest of before; v^2 of the last node.
    off("cost", "cost", 4.0 + 7 * 0.16 + 4.0 + 3 * 0.04 + 0.25, "1")(
        both(
            put("u", (1, 0), sign * 2.0),
            put("u", (3, 1), -sign * 0.2),
            put("v", (-1, 0), sign * 0.5),
        )
    )
    # Two half steps lead to 1.2 or 0.8 and back, by cubics without velocities at their ends.
    off("replayed cost", "replay_cost", 4.0 + sign * 0.2 + 0.04 * 13 / 35 + 7 * 0.16, "1")(
        put("replay.q", (2, 0), sign * 0.2)
    )
    # The last half step ends with 0.6 m/s: x = 1 + 0.3 H (s^3 - s^2).
    off(
        "replayed cost at the end", "replay_cost",
        4.0 - sign * 0.3 * H / 12 + (0.3 * H) ** 2 / 210 + 7 * 0.16 + 0.36, "1",
    )(put("replay.v", (-1, 0), sign * 0.6))  # fmt: skip
    off("inputs", "bound_violation", 0.5, "N", 8e-6)(put("u", (2, 0), 5.5 if sign > 0 else -3.5))
    # A quarter N m of 1.5 N m is more than one N of 8 N.
    off("inputs, both", "bound_violation", 0.25, "N m", 1.5e-6)(
        both(
            put("u", (0, 0), 6.0 if sign > 0 else -4.0),
            put("u", (3, 1), 0.75 if sign > 0 else -1.25),
        )
    )
    off("speed", "velocity_bound_violation", 0.25, "m/s", 3.5e-6)(
        put("v", (3, 0), 1.75 if sign > 0 else -2.25)
    )
    off("speed at the end", "velocity_bound_violation", 0.0, "m/s", 3.5e-6)(
        put("v", (4, 0), 1.75 if sign > 0 else -2.25)
    )
    off("replayed speed", "replay_velocity_bound_violation", 0.25, "m/s", 0.5e-2)(
        put("replay.v", (5, 0), 1.75 if sign > 0 else -2.25)
    )
    # 0.5 of 2 rad is more than 0.1 of 0.5 m.
    off("motion", "replay_error", 0.5, "rad", 2e-2)(
        both(put("replay.q", (4, 1), sign * 0.5), put("replay.q", (6, 0), sign * 0.1))
    )
    off("motion between nodes", "replay_error", 0.0, "m", 0.5e-2)(
        put("replay.q", (3, 1), sign * 0.5)
    )
    off("replayed end", "replay_terminal_position_error", 0.5, "m, rad")(
        both(put("replay.q", (-1, 0), -sign * 0.3), put("replay.q", (-1, 1), sign * 0.4))
    )
    off("replayed end, velocity", "replay_terminal_velocity_error", 1.3, "m/s, rad/s")(
        both(put("replay.v", (-1, 0), sign * 0.5), put("replay.v", (-1, 1), -sign * 1.2))
    )
    off("replayed end, both", "replay_terminal_error", 1.3, "m, rad, m/s, rad/s")(
        both(put("replay.q", (-1, 1), sign * 0.5), put("replay.v", (-1, 0), sign * 1.2))
    )
    # A velocity too much at one node: v[t+1] - v[t] - h a misses by it twice, q by h times it.
    off("step", "defect", 0.06, "m/s", 0.5e-6)(put("v", (3, 0), sign * 0.06))
    off("step, position", "defect", 0.04, "m", 0.5e-6)(put("q", (2, 0), sign * 0.04))
    # What is far: 3 N for one step give v 3 h / M, and x 3 h^2 / M a step after it.
    off("law", "law_error", 3 * 3 * H**2 / M, "m, rad")(put("u", (1, 0), sign * 3.0))
    off(
        "own end",
        "discrete_terminal_error",
        math.hypot(3 * 3 * H**2 / M, 3 * H / M),
        "m, rad, m/s, rad/s",
    )(put("u", (1, 0), sign * 3.0))
    off("own end, position", "discrete_terminal_position_error", 3 * 0.4 * H**2 / J, "m, rad")(
        put("u", (1, 1), sign * 0.4)
    )
    off("own end, velocity", "discrete_terminal_velocity_error", 0.4 * H / J, "m/s, rad/s")(
        put("u", (1, 1), sign * 0.4)
    )
    off("grid", "grid_error", 0.2, "m, rad")(put("replay.q", (6, 1), sign * 0.2))
    off("friction beyond its cone", "friction_violation", 0.7, "N")(
        both(put("lam", (1, 0), 2.0), put("lam", (1, FRICTION), sign * 1.3))
    )
    # 0.6 N are due against a slip of 0.8 / 4 m/s; 0.1 N are there, or 0.1 N push on.
    off(
        "friction that holds too little",
        "friction_dissipation_error",
        (0.6 - sign * 0.1) * 0.2,
        "W",
    )(both(put("lam", (1, 0), 2.0), put("lam", (1, FRICTION), -sign * 0.1), put("v", (2, 1), 0.8)))
    off("friction of the replay", "friction_impulse_error", 0.9 * H, "N s")(
        both(put("lam", (2, FRICTION), sign * 0.9), undeclared)
    )
    off("friction of the plan", "friction_impulse_error", 0.5 * 4 * H, "N s")(
        both(put("replay.friction", (slice(None), 0), sign * 0.5), undeclared)
    )
    # Two joules of kinetic energy are there to be turned over.
    for name, of in (
        ("kinetic_energy", 2.0 + max(0.0, sign * 0.5)), ("input_work", 2.0),
        ("dissipated_work", 2.0), ("contact_energy", 2.0),
    ):  # fmt: skip
        off(f"energy, {name}", "energy_residual_relative", 0.5 / of, "1", 1e-6)(
            both(
                put("replay.kinetic_energy", slice(None), 2.0),
                put(f"replay.{name}", 5, sign * 0.5),
            )
        )
    off("duration", "duration_error", 0.02, "s", H / 2)(
        both(put("t", 4, sign * 0.02), put("replay.t", 8, sign * 0.02))
    )

# What has one sign only.
off("force at a distance", "physics", 2.0 * (2.0 + 100 * 1.0), "N^2")(put("lam", (1, 0), 2.0))
off("force at a distance", "physics", 2.0 * (2.0 + 40 * 0.3), "N^2")(put("lam", (1, 1), 2.0))
off("force at a distance", "physics_scaled", H * 204.0 / 5.0**2, "s", 2e-6 * 0.5 * 2)(
    put("lam", (1, 0), 2.0)
)
off("force at a distance", "physics_scaled", H * 28.0 / 4.0**2, "s")(put("lam", (1, 1), 2.0))
off("force at a distance", "contact_law_error", 2.0 * H, "N s")(
    both(put("lam", (1, 0), 2.0), undeclared)
)
off("force at a distance", "ghost_impulse", 2.0 * H + 3.0 * H, "N s")(
    both(put("lam", (1, 0), 2.0), put("lam", (3, 1), 3.0))
)
# What the replay has while the plan does not counts for nothing, what both have is taken off: 2 N,
# of which 0.5 N are there.
off("more force than there is", "ghost_impulse", 1.5 * H, "N s")(
    both(
        put("lam", (1, 0), 2.0),
        put("replay.lam", (slice(None), 0), 0.5),
        put("replay.lam", (slice(None), 1), 4.0),
    )
)
off("less force than there is", "missed_impulse", 3.5 * 4 * H, "N s")(
    both(
        put("lam", (slice(None), 1), 0.5), put("lam", (slice(None), 0), 2.0),
        put("replay.lam", (slice(None), 1), 4.0),
        put("replay.contact_impulse", (slice(None), 1), 4.0 * H / 2 * np.arange(ROWS)),
    )
)  # fmt: skip
off("force that pulls", "force_sign_violation", 0.5, "N")(
    both(put("lam", (1, 1), -0.5), put("lam", (2, 0), 2.0))
)
off("force not planned", "missed_impulse", 4.0 * 4 * H, "N s")(
    both(
        put("replay.lam", (slice(None), 1), 4.0),
        put("replay.contact_impulse", (slice(None), 1), 4.0 * H / 2 * np.arange(ROWS)),
    )
)


@SIDES
@pytest.mark.parametrize(
    ("what", "name", "value", "unit", "limit", "change"),
    FOUND,
    ids=[f"{n} of {w}" for w, n, *_ in FOUND],
)
def test_what_is_off_is_found_by_exactly_that(what, name, value, unit, limit, change, side):
    case = Case(side)
    change(case)
    found = case.metric(name)
    assert found.value == pytest.approx(value, rel=1e-9, abs=1e-12), what
    assert found.unit == unit
    if limit is not None:
        assert found.limit == pytest.approx(limit, rel=1e-6), (
            "but for the rounding of what is only just in touch"
        )
        assert found.ok is (value < limit)


# Of one unit; a cost adds what it likes.
SCALED = [item for item in FOUND if "," not in item[3] and "cost" not in item[1]]
# What counts as a large velocity is the nominal of its position in a second, whatever the task's
# time is.
PER_SECOND = ("start_error", "replay_velocity_bound_violation", "defect")
# No round numbers: these would look printed.
OTHERS = (
    Sizes(length=math.pi), Sizes(mass=math.e), Sizes(time=math.sqrt(50.0)),
    Sizes(length=0.1 * math.e, mass=0.05 * math.pi, time=math.sqrt(3.0)),
)  # fmt: skip


@pytest.mark.parametrize("sizes", OTHERS, ids=["length", "mass", "time", "all"])
@pytest.mark.parametrize(
    ("what", "name", "value", "unit", "limit", "change"),
    SCALED,
    ids=[f"{n} of {w}" for w, n, *_ in SCALED],
)
def test_in_other_units_it_is_the_same(
    what: str, name: str, value: float, unit: str, limit: float | None, change: Change, sizes: Sizes
):
    """A number in N s grows as a newton second does, and its limit with it: nothing is held against a number of another dimension."""
    case = Case(1.0, sizes)
    change(case)
    found = case.metric(name)
    assert found.value == pytest.approx(
        value * sizes.of(unit), rel=1e-9, abs=1e-12 * sizes.of(unit)
    ), what
    if limit is not None and value > 0.0:
        seconds = sizes.time if name in PER_SECOND and unit.endswith("/s") else 1.0
        assert found.limit == pytest.approx(limit * sizes.of(unit) * seconds, rel=1e-5), (
            "but for the last digits of what is given"
        )


@SIDES
def test_the_deepest_penetration_is_that_against_its_depth(side: float):
    """0.3 of 0.4 m of the floor is less than 0.18 of 0.2 m of the stop."""
    case = Case(side)
    for row, (x, a) in {3: (-0.3, 0.4), 6: (1.0, 1.36)}.items():
        case.replay["q"][row] = side * x, side * a
        case.replay["gap"][row] = x, (1.0 - a) / 2
    found = case.metric("max_penetration")
    assert (found.value, found.limit) == (pytest.approx(0.18), pytest.approx(0.2))
    assert found.ok is True


@SIDES
def test_the_replays_own_error_is_that_of_each_metric(side: float):
    """Positions, states and gaps have errors of their own.

    Of two positions the norm is off by at most sqrt(2) times one.
    """
    case = Case(side)
    case.replay["error"] = ReplayError(estimate=Difference(position=1e-3, state=2e-2, gap=3e-3))
    case.replay["lam"][1:3, 0] = 5.0
    errors = {
        "replay_error": 1e-3,
        "replay_terminal_position_error": 1e-3 * math.sqrt(2.0),
        "replay_terminal_velocity_error": 2e-2,
        "replay_terminal_error": 2e-2,
        "replay_velocity_bound_violation": 2e-2,
        "max_penetration": 3e-3,
        # The stiffest contact for as long as either touches: three pieces of H / 2.
        "ghost_impulse": 100.0 * 3e-3 * 1.5 * H,
        "missed_impulse": 100.0 * 3e-3 * 1.5 * H,
        # x^2 of four nodes, 7 a^2 and v^2 of the last one, each off by 0.02.
        "replay_cost": 4 * (1.02**2 + (0.01 * H) ** 2 / 210 - 1.0) + 7 * (0.42**2 - 0.16) + 0.02**2,
    }
    assert {name: case.metric(name).error for name in errors} == pytest.approx(errors)


@SIDES
def test_inputs_that_are_lines_are_bounded_at_the_end_too(side: float):
    case = Case(side)
    case.plan |= {"u_end": np.array([side * 5.5, 0.0]), "hold": Hold.LINEAR, "scheme": None}
    assert case.metric("bound_violation").value == pytest.approx(0.5)
    case.plan |= {"u_end": None, "hold": Hold.ZERO_ORDER}
    assert case.metric("bound_violation").value == 0.0


def test_a_goal_nearer_than_the_nominal_is_the_scale_of_the_start():
    case = Case(1.0)
    case.scene = replace(case.scene, task=replace(case.scene.task, goal=(1.25, 0.4, 0.0, 0.0)))
    put("q", (0, 0), 0.3)(case)
    assert case.metric("start_error").limit == pytest.approx(0.25e-6)


# Rounding of each number, all different.
ROUNDED = {
    "q": np.full((NODES, 2), 0.01),
    "v": np.full((NODES, 2), 0.02),
    "u": np.full((STEPS, 2), 0.03),
    "lam": np.full((STEPS, 3), 0.05),
}
# Impulse of what is only just in touch: 1e-9 of k L = 5 N over half a second.
GRAZING = 1e-9 * 5.0 * STEPS * H
PUSHES = both(put("lam", (1, 0), 2.0), put("lam", (3, 1), 3.0))


@pytest.mark.parametrize(
    ("name", "change", "allowed"),
    [
        ("start_error", both(), [0.01, 0.01, 0.02, 0.02]),
        ("bound_violation", both(), [0.03] * 2),
        ("velocity_bound_violation", both(), [0.02] * 2),
        ("terminal_position_error", both(), 0.01 * math.sqrt(2.0)),
        ("terminal_velocity_error", both(), 0.02 * math.sqrt(2.0)),
        ("replay_error", both(), [0.01] * 2),
        ("ghost_impulse", PUSHES, 0.5 * 2 * 0.05 + GRAZING),
        ("missed_impulse", both(), 0.5 * 2 * 0.05 + GRAZING),
        ("defect", both(), [*2 * (2 * 0.01 + H * 0.02,), *2 * (2 * 0.02 + H * 0.7,)]),
        # Forces of the floor are off by 100 * 0.01 N, of the stop on its lever by 40 * 0.005 N.
        (
            "physics_scaled", PUSHES,
            H * (0.05 * (4 + 100) + 2 * 1.0 + 0.05 * 1.05) / 5.0**2
            + H * (0.05 * (6 + 12) + 3 * 0.2 + 0.05 * 0.25) / 4.0**2,
        ),
    ],
)  # fmt: skip
def test_rounding_excuses_what_it_may_be_the_cause_of(name: str, change: Change, allowed: Any):
    case = Case(1.0)
    change(case)
    entry = next(entry for entry in TABLE if entry.name == name)
    found = entry.measure(case.evidence(rounding=ROUNDED, printing_acceleration=0.7))
    assert found.allowed == pytest.approx(allowed, rel=1e-9)


def test_force_yardsticks_are_those_of_the_scene():
    """Neither a planned spike nor a replayed one moves them, and impulses count where both have one."""
    case = Case(1.0)
    typical = case.evidence().typical_force
    assert typical > 0.0
    both(put("lam", (1, 0), 1e6), undeclared)(case)
    for name, share in (("force_sign_violation", 1e-6), ("contact_force_error", 5e-3)):
        assert case.metric(name).limit == pytest.approx(share * typical)
    least = 0.01 * typical * STEPS * H / 50
    assert case.metric("ghost_impulse").limit == pytest.approx(least, rel=1e-4)
    put("replay.lam", (slice(None), 0), 4.0)(case)
    assert case.metric("ghost_impulse").limit == pytest.approx(max(least, 0.01 * 4.0 * H), rel=1e-4)


def test_a_damped_contact_is_wrong_by_its_velocities_too():
    case = Case(1.0)
    floor, stop = case.scene.contacts
    case.scene = replace(case.scene, contacts=(replace(floor, damping=sp.Integer(2)), stop))
    case.replay["error"] = ReplayError(estimate=Difference(position=1e-3, state=2e-2, gap=3e-3))
    case.replay["lam"][7:, 0] = 5.0
    found = case.evidence(slopes=(np.array([300.0, 40.0]), np.array([6.0, 7.0])))
    touching = 2 * H / 2
    assert measures._impulse_error(found) == pytest.approx(touching * (300.0 * 3e-3 + 7.0 * 2e-2))


def test_a_lag_moves_contact_impulses_where_its_forces_do_and_by_twice_as_much():
    """0.2 N more at the row in the middle of a step, of the one contact: of the other, and of what plan and replay agree on, nothing is in doubt."""
    case = Case(1.0)
    both(put("lam", (1, 0), 2.0), put("lam", (3, 1), 3.0))(case)
    lagging = Case(1.0)
    lagging.replay["lam"][3, 0] = 0.2
    small, lag = (Difference(position=0.0, state=size, gap=size) for size in (3e-3, 1e-3))
    case.replay |= {"error": ReplayError(estimate=small, lag=lag), "lagging": lagging.replayed()}
    ghost = case.metric("ghost_impulse")
    assert (ghost.value, ghost.error) == (pytest.approx(5.0 * H), pytest.approx(0.4 * H))
    assert case.metric("missed_impulse").error == 0.0
    case.replay["lam"][:, 1] = lagging.replay["lam"][:, 1] = (
        4.0  # touches, and lags by nothing: what is left of the gap's error counts as ever
    )
    case.replay["lagging"] = lagging.replayed()
    assert case.metric("missed_impulse").error == pytest.approx(100.0 * (3e-3 - 1e-3) * 4 * H)


def test_energy_of_a_body_at_rest_is_measured_by_what_moving_would_take():
    """A thousandth of 2/2 0.5^2 + 0.5/2 2^2 J at nominal speeds."""
    case = Case(1.0)
    case.replay["input_work"][4] = 1e-9
    assert case.metric("energy_residual_relative").value == pytest.approx(1e-9 / 1.25e-3)
    for name in ("input_work", "dissipated_work"):
        blind = Case(1.0)
        blind.replay[name] = None
        assert (
            "no outputs input_power and dissipated_power"
            in blind.metric("energy_residual_relative").reason
        )
