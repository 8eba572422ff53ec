"""What the metrics are computed from, by numbers that can be followed by hand: costs on any grid, printed digits, forces and motions in between."""

import math
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import KernelError
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory
from validate.judge.replay.result import ReplayOutcome
from validate.judge.score import _metric, measures
from validate.judge.score.depths import deepest, penetrations_within
from validate.judge.score.evidence import Evidence
from validate.judge.score.table import TABLE
from validate.judge.score.verdict import LeavesBounds, Unmeasured


def of(name: str, case: Any) -> Any:
    """What Evidence calls so, of a made-up case."""
    found = vars(Evidence)[name]
    return found.func(case) if isinstance(found, cached_property) else found.fget(case)


def carts(t: Any, u: Any = None, **more: Any) -> Evidence:
    """Three carts of 1 kg with c = 2 N s/m at rest, apart.

    Contacts of 30 N/m between carts of 0.5 m.
    """
    nodes = len(t)
    plan = {
        "t": np.array(t), "q": np.tile([2.0, 3.0, 4.0], (nodes, 1)), "v": np.zeros((nodes, 3)),
        "u": np.zeros((nodes - 1, 2)) if u is None else np.array(u),
        "lam": np.zeros((nodes - 1, 2)),
    } | more  # fmt: skip
    return Evidence(load_scene("three_cart"), Trajectory(**plan), None)


# Costs


def pendulum(
    t: np.ndarray, u: np.ndarray, hold: Hold = Hold.ZERO_ORDER, end: float | None = None
) -> Evidence:
    """theta = t^3 on rows t (n,); a step of 0.01 s costs theta^2 + omega^2 + u^2."""
    plan = Trajectory(
        t=t, q=t[:, None] ** 3, v=3.0 * t[:, None] ** 2, u=u[:, None],
        lam=np.zeros((len(t) - 1, 1)), hold=hold, u_end=None if end is None else np.array([end]),
    )  # fmt: skip
    return Evidence(load_scene("wall_pendulum"), plan, None)


# Integral of t^6 + 9 t^4 from 0 to 0.2, over a step.
OF_STATES = (0.2**7 / 7 + 9.0 * 0.2**5 / 5) / 0.01


@pytest.mark.parametrize("rows", [2, 3, 9])
def test_cost_cubic_motion_integral_on_any_rows(rows: int):
    case = pendulum(np.linspace(0.0, 0.2, 5), np.array([0.0, 4.0, -2.0, 1.0]))
    t = np.linspace(0.0, 0.2, 4 * (rows - 1) + 1)
    found = case.cost_of(t, t[:, None] ** 3, 3.0 * t[:, None] ** 2, case.trajectory.u)
    assert found == pytest.approx(OF_STATES + (16.0 + 4.0 + 1.0) * 5.0, rel=1e-12)


def test_cost_sawtooth_integral_of_its_lines():
    """Lines between 1 and -1 N m have a mean square of a third."""
    t = np.linspace(0.0, 0.2, 5)
    case = pendulum(t, np.array([1.0, -1.0, 1.0, -1.0]), Hold.LINEAR, 1.0)
    found = case.cost_of(t, case.q, case.v, case.trajectory.u)
    assert found == pytest.approx(OF_STATES + 20.0 / 3.0, rel=1e-12)
    assert case.cost_of_rows < OF_STATES


def test_cost_event_rows_count_nothing():
    case = pendulum(np.array([0.0, 0.1, 0.2]), np.array([1.0, 2.0]))
    t = np.array([0.0, 0.05, 0.05, 0.1, 0.2])
    found = case.cost_of(t, t[:, None] ** 3, 3.0 * t[:, None] ** 2, case.trajectory.u)
    assert found == pytest.approx(OF_STATES + 50.0, rel=1e-12)


def test_cost_of_rows_is_the_sum_at_the_starts_of_the_steps():
    """A step of the plan counts for its part of the task's."""
    t = np.array([0.0, 0.01, 0.015, 0.2])
    found = pendulum(t, np.array([1.0, 2.0, 3.0])).cost_of_rows
    states = t**6 + 9.0 * t**4
    assert found == pytest.approx(
        1.0 + states[0] + 0.5 * (4.0 + states[1]) + 18.5 * (9.0 + states[2]), rel=1e-12
    )


def test_cost_final_cost_counts_once():
    scene = load_scene("two_discs")
    t, q = np.array([0.0, 1.0]), np.tile(scene.task.start[:4], (2, 1))
    plan = Trajectory(
        t=t, q=q, v=np.zeros((2, 4)), u=np.array([[3.0, 4.0]]), lam=np.zeros((1, 1))
    )  # fmt: skip
    case = Evidence(scene, plan, None)
    assert case.cost_of(t, q, plan.v, plan.u) == pytest.approx(0.01 * 25.0 + 2.0)


# Printed digits


def test_rounding_each_column_has_its_own():
    """Four and two decimals of positions, none of what has all digits."""
    q = np.random.default_rng(1).normal(size=(5, 3))
    q[:, 0], q[:, 1] = np.round(q[:, 0], 4), np.round(q[:, 1], 3)
    case = carts(0.01 * np.arange(5), q=q)
    assert case.rounding["q"].max(axis=0)[:2] == pytest.approx([5e-5, 5e-4])
    assert case.rounding["q"][:, 2].max() < 1e-14
    assert {group: part.shape for group, part in case.rounding.items()} == {
        "q": (5, 3), "v": (5, 3), "u": (4, 2), "lam": (4, 2)
    }  # fmt: skip


@pytest.mark.parametrize(("group", "expected"), [("u", 0.5), ("lam", 1.0), ("v", 2.0 * 0.5)])
def test_what_printing_does_to_an_acceleration(group: str, expected: float):
    """Of 1 kg each: inputs push one cart, a force two of which the middle one may be pushed twice.

    Damping makes 2 m/s^2 of 1 m/s.
    """
    case = carts(0.01 * np.arange(21))
    shapes = {"q": (21, 3), "v": (21, 3), "u": (20, 2), "lam": (20, 2)}
    case.__dict__["rounding"] = {
        name: np.full(shape, 0.5 * (name == group)) for name, shape in shapes.items()
    }
    assert case.printing_acceleration == pytest.approx(expected, rel=1e-6)


def test_printed_positions_change_the_forces_of_contacts():
    """Pressed 0.1 m together: 0.01 m each make at most 0.6 N on either side of the middle cart."""
    case = carts(0.01 * np.arange(21), q=np.tile([2.0, 2.4, 2.8], (21, 1)))
    case.__dict__["rounding"] = {
        "q": np.full((21, 3), 0.01), "v": np.zeros((21, 3)),
        "u": np.zeros((20, 2)), "lam": np.zeros((20, 2)),
    }  # fmt: skip
    assert case.printing_acceleration == pytest.approx(30.0 * 0.04, rel=1e-6)


# Friction


def test_friction_is_limited_at_both_ends_of_a_step_unless_a_scheme_says_where():
    limits = {1.0: [[-1.0, 3.0]], 2.0: [[2.0, 0.5]]}
    case: Any = SimpleNamespace(
        trajectory=SimpleNamespace(scheme=None), q=np.array([[1.0], [2.0]]),
        pressing=("forces", "within", "forces"),
        kernel=SimpleNamespace(friction_limit=lambda q,
                               forces: np.array(limits[q[0, 0]]) if forces == "forces" else None),
    )  # fmt: skip
    least, most = of("friction_limits", case)
    assert (least.tolist(), most.tolist()) == ([[0.0, 0.5]], [[2.0, 3.0]])
    case.trajectory.scheme = Scheme.SEMI_IMPLICIT_EULER
    least, most = of("friction_limits", case)
    assert least.tolist() == most.tolist() == [[0.0, 3.0]]


def test_slip_is_that_of_least_size_at_the_ends_of_a_step():
    """At the end with the geometry of its start.

    Of a plan without a scheme at both ends too, and none where it turns round.
    """
    case: Any = SimpleNamespace(
        trajectory=SimpleNamespace(q=np.array([[10.0], [20.0], [30.0]]),
                                   scheme=Scheme.SEMI_IMPLICIT_EULER),
                                   v=np.array([[1.0], [2.0], [-3.0]]),
        kernel=SimpleNamespace(slip=lambda q, v: q * v),
    )  # fmt: skip
    case.q = case.trajectory.q
    assert of("slip", case).tolist() == [[20.0], [-60.0]]
    case.trajectory.scheme = None
    assert of("slip", case).tolist() == [[10.0], [0.0]]
    case.v = -case.v
    assert of("slip", case).tolist() == [[-10.0], [0.0]]


# Motions


def grid_errors(*errors: float, limit: float | None = 0.4, waived: bool = False) -> list[float]:
    """Return `grid_errors` of motions with these errors of the second position; the replay rests."""
    values = iter(errors)

    def motion(parts: int) -> tuple[np.ndarray, None]:
        return np.array([[0.0, 0.0], [0.0, next(values)]]), None

    own = SimpleNamespace(value=None if waived else limit)
    scene = SimpleNamespace(
        limit=lambda name: own if name == "replay_error" and (limit or waived) else None,
        coordinates=[SimpleNamespace(nominal=0.5), SimpleNamespace(nominal=2.0)],
    )
    case: Any = SimpleNamespace(scene=scene, replay_q=np.zeros((2, 2)), own_motion=motion)
    return of("grid_errors", case)


def test_grid_errors_end_at_a_quarter_of_the_limit():
    assert grid_errors(0.8, 0.4, 0.05, 0.01) == [0.8, 0.4, 0.05]
    assert grid_errors(0.8, 0.101, 0.0505) == [0.8, 0.101, 0.0505]
    assert grid_errors(0.1) == [0.1]
    assert grid_errors(0.00126, 0.00124, limit=None) == [0.00126, 0.00124]
    assert grid_errors(100.0, waived=True) == [100.0]


def test_grid_errors_end_after_two_idle_halvings_or_seven():
    """A hundredth of the missing 0.9 counts as idle."""
    assert len(grid_errors(*[1.0, 1.003] * 4)) == 3
    assert len(grid_errors(*[1.0, 1.011] * 4)) == 8


def test_without_inertia_a_step_takes_up_all_of_a_force():
    given = SimpleNamespace(equations=SimpleNamespace(relaxation_index=1,
        parameters=[SimpleNamespace(value=9.0), SimpleNamespace(value=0.5)]),
        h=np.array([0.25, 1.0]))  # fmt: skip
    assert Evidence._of_steps(given, np.array([[2.0], [3.0]])).tolist() == [[4.0], [1.5]]
    given.equations.relaxation_index = None
    assert Evidence._of_steps(given, np.array([[2.0], [3.0]])).tolist() == [[2.0], [3.0]]


@pytest.mark.parametrize(
    "t", [[0.0, 0.01, 0.02, 0.03], [0.0, 0.01, 0.03, 0.06]], ids=["equal steps", "unequal steps"]
)
@pytest.mark.parametrize("parts", [1, 3])
def test_the_own_motion_is_semi_implicit_euler_in_so_many_parts(t: list[float], parts: int):
    u = [[1.0, -2.0], [3.0, 4.0], [5.0, 6.0]]
    case = carts(t, u, v=np.tile([0.5, 0.0, -0.25], (4, 1)))
    q, v = [np.array([2.0, 3.0, 4.0])], [np.array([0.5, 0.0, -0.25])]
    for h, (left, right) in zip(np.diff(t), u, strict=True):
        at, speed = q[-1], v[-1]
        for _ in range(parts):
            speed = speed + h / parts * (np.array([left, 0.0, right]) - 2.0 * speed)
            at = at + h / parts * speed
        q, v = [*q, at], [*v, speed]
    assert case.own_motion(parts)[0] == pytest.approx(np.array(q), abs=1e-13)
    if parts == 1:
        assert case.true_motion[1] == pytest.approx(np.array(v), abs=1e-13)


def test_the_own_motion_of_a_collocation_plan_is_that_of_its_scheme():
    """Implicit midpoint of free carts with c/m = 2/s: v' (1 + h) = v (1 - h) + h u."""
    u, h = [[1.0, -2.0], [3.0, 4.0]], 0.1
    case = carts(
        [0.0, h, 2 * h], u, v=np.tile([0.5, 0.0, -0.25], (3, 1)), scheme=Scheme.IMPLICIT_MIDPOINT
    )
    q, v = [np.array([2.0, 3.0, 4.0])], [np.array([0.5, 0.0, -0.25])]
    for left, right in u:
        v.append(((1 - h) * v[-1] + h * np.array([left, 0.0, right])) / (1 + h))
        q.append(q[-1] + h * (v[-2] + v[-1]) / 2)
    assert case.true_motion[0] == pytest.approx(np.array(q), abs=1e-9)
    assert case.true_motion[1] == pytest.approx(np.array(v), abs=1e-9)


@pytest.mark.parametrize(
    "t", [0.05 * 2 ** np.arange(11.0), 25.0 * np.arange(11.0)], ids=["unequal steps", "equal steps"]
)
def test_a_step_that_diverges_is_named(t: np.ndarray):
    """h c = 50: each step multiplies the velocity by -49, until nothing is a number any more."""
    case = carts(t * 1e30, v=np.full((11, 3), 1.0))
    with pytest.raises(LeavesBounds, match=r"diverges at step \d+ of 10"):
        case.true_motion  # noqa: B018
    with pytest.raises(LeavesBounds) as once:
        case.own_motion(1)
    with pytest.raises(LeavesBounds) as finer:
        case.own_motion(2)
    steps = [int(str(caught.value).split("step ")[-1].split()[0]) for caught in (once, finer)]
    assert 0 <= steps[1] <= steps[0] < 10


def test_a_motion_that_cannot_be_had_is_a_reason():
    def fails(*arguments: Any) -> Any:
        raise KernelError("singular")

    case = carts([0.0, 0.01], scheme=Scheme.SEMI_IMPLICIT_EULER)
    case.__dict__["kernel"] = SimpleNamespace(acceleration=fails)
    found = _metric(next(entry for entry in TABLE if entry.name == "defect"), case)
    assert (found.value, found.ok, found.reason) == (None, None, "singular")
    assert found.limit is not None, "its question is left open"


def test_between_rows_a_penetration_is_that_of_the_motion_under_the_inputs_of_its_step():
    """Two carts of 1 kg press together, almost without damping: g'' = -2 k g - u1, from a row in the middle of a step whose input is a line."""
    scene = load_scene("three_cart").with_parameters(c=1e-9)
    t = np.array([0.0, 0.1, 0.2])
    plan = Trajectory(t=t, q=np.zeros((3, 3)), v=np.zeros((3, 3)),
                      u=np.array([[1.0, 0.0], [20.0, -4.0]]), lam=np.zeros((2, 2)),
                      hold=Hold.LINEAR, u_end=np.array([10.0, 8.0]))  # fmt: skip
    case = Evidence(scene, plan, None)
    start_q, start_v = np.array([2.0, 2.45, 4.0]), np.array([1.0, -1.0, 0.0])
    replay = SimpleNamespace(t=np.array([0.0, 0.1, 0.15, 0.2]), q=np.array([start_q] * 4),
                             v=np.array([start_v] * 4), applied=None,
                             lam=np.tile([1.5, 0.0], (4, 1)), friction=np.zeros((4, 0)))  # fmt: skip
    case.__dict__ |= {"step_of": np.array([0, 1, 1]), "duration": np.array([0.1, 0.05, 0.05])}
    case.replayed = SimpleNamespace(**vars(replay), outcome=ReplayOutcome.OK, ok=True)
    found = penetrations_within(case, 2, 1000)
    assert found.shape == (1001, 2)
    # From t = 0.15 s on with u1 = 20 - 100 (t - 0.1) N.
    s = np.linspace(0.0, 0.05, 20001)
    depth, rate = 0.05, 2.0
    depths = [depth]
    for time in s[1:]:
        middle = time - 0.5 * (s[1] - s[0])
        rate += (s[1] - s[0]) * (-60.0 * max(depth, 0.0) + 20.0 - 100.0 * (0.05 + middle))
        depth += (s[1] - s[0]) * rate
        depths.append(depth)
    assert found[:, 0] == pytest.approx(np.array(depths)[::20], abs=3e-4)
    case.replayed.applied = np.array([[0.0, 0.0], [-40.0, 0.0]])
    pulled = penetrations_within(case, 2, 1000)[-1, 0]
    assert pulled - found[-1, 0] == pytest.approx(-60.0 * 0.05**2 / 2, rel=0.05)


@pytest.mark.parametrize("k", [1e6, 1e8])
@pytest.mark.parametrize(
    "around", [0.0, 5e-3], ids=["from touch to touch", "a contact far shorter than its piece"]
)
def test_a_contact_between_two_rows_is_as_deep_as_it_was_though_a_shallower_one_has_rows_within(
    k: float, around: float
):
    """Half sines of 1 g without gravity, v/w deep: the first with a row where it is deepest.

    The second, a tenth faster, within one piece.
    """
    scene, w = load_scene("bouncing_mass").with_parameters(m=1e-3, k=k, g=1e-9), math.sqrt(k / 1e-3)
    swing = math.pi / w
    t = np.cumsum([0.0, swing / 2, swing / 2, 0.1, swing + 2.0 * around / 1.1])
    q = np.array([0.0, -1.0 / w, 0.0, around, around])[:, None]
    v = np.array([-1.0, 0.0, 1.0, -1.1, 1.1])[:, None]
    plan = Trajectory(
        t=t[[0, -1]], q=q[[0, -1]], v=v[[0, -1]], u=np.zeros((1, 0)), lam=np.zeros((1, 1))
    )
    error = SimpleNamespace(estimate=SimpleNamespace(gap=1e-12))
    replay: Any = SimpleNamespace(
        t=t, q=q, v=v, gap=q, lam=np.maximum(-k * q, 0.0), friction=np.zeros((5, 0)),
        knots=np.array([0, 4]), applied=None, error=error,
        outcome=ReplayOutcome.OK, ok=True,
    )  # fmt: skip
    depth, unsure = deepest(Evidence(scene, plan, replay))
    assert depth == pytest.approx(1.1 / w, rel=2e-5)
    assert (unsure < 1e-4 / w).all()


def test_what_has_left_every_bound_says_when():
    case = carts([0.0, 0.01])
    case.replayed = SimpleNamespace(
        outcome=ReplayOutcome.DIVERGED, t=np.array([0.0, 0.25, 0.75]), ok=False
    )
    with pytest.raises(LeavesBounds, match=r"leaves every bound after 0\.75 s"):
        case.replay  # noqa: B018
    case.replayed = SimpleNamespace(
        outcome=ReplayOutcome.CRASHED, t=np.array([0.0]), ok=False, message=""
    )
    with pytest.raises(Unmeasured, match=r"did not get to the end: The FMU crashed\.$"):
        case.replay  # noqa: B018


def test_end_error_asks_for_velocities_only_if_the_goal_has_one():
    class Silent(SimpleNamespace):
        """A plan and a replay without velocities."""

        @property
        def v(self) -> np.ndarray:
            raise Unmeasured("no velocities.")

        replay_v = v

    case: Any = Silent(
        goal=np.array([1.0, np.nan]),
        scene=SimpleNamespace(nq=1),
        q=np.array([[1.0], [3.0]]),
        replay_q=np.array([[1.0], [1.5]]),
        error=SimpleNamespace(position=0.1, state=0.5),
    )
    assert measures.end_error(case, "", "").values == 2.0
    assert measures.end_error(case, "replay_", "").values == 0.5
    case.goal = np.array([np.nan, 3.0])
    for of in ("", "replay_"):
        with pytest.raises(Unmeasured, match="no velocities"):
            measures.end_error(case, of, "")


def test_a_window_of_forces_knows_their_means_where_impulses_are_told():
    """Three steps, two rows each: a bounce in the second that no row tells, but whose impulse is 0.6 N s in 0.2 s."""
    lam = np.zeros((7, 1))
    lam[6] = 5.0
    impulse = np.array([0.0, 0.0, 0.0, 0.3, 0.6, 0.6, 0.6])[:, None]
    case: Any = SimpleNamespace(
        need=lambda part: None,
        trajectory=SimpleNamespace(steps=3, t=np.array([0.0, 0.2, 0.4, 0.6])),
        step_of=np.array([0, 0, 1, 1, 2, 2]),
        replayed=SimpleNamespace(
            lam=lam, contact_impulse=impulse, knots=np.array([0, 2, 4, 6]), ok=True
        ),
    )  # fmt: skip
    case.replay, case._replayed_means = case.replayed, of("_replayed_means", case)
    least, largest = of("force_window", case)
    assert (least.ravel().tolist(), largest.ravel().tolist()) == (
        [0.0, 0.0, 0.0],
        [pytest.approx(3.0), 5.0, 5.0],
    )
    case.replay.contact_impulse = None
    case._replayed_means = of("_replayed_means", case)
    assert of("force_window", case)[1].ravel().tolist() == [0.0, 5.0, 5.0]


def test_pieces_of_a_replay_lie_in_the_plans_steps():
    case: Any = SimpleNamespace(
        replay=SimpleNamespace(
            t=np.array([0.0, 0.1, 0.3, 0.7, 0.8, 1.0]), knots=np.array([0, 2, 3, 5])
        )
    )
    assert of("step_of", case).tolist() == [0, 0, 1, 2, 2]
    assert of("duration", case) == pytest.approx([0.1, 0.2, 0.4, 0.1, 0.2])


@pytest.mark.parametrize(
    ("nominal", "step", "expected"),
    [(0.01, 0.01, True), (0.01 * (1 + 5e-10), 0.01, True), (0.01 * (1 + 3e-9), 0.01, False)],
)
def test_steps_that_are_the_tasks_but_for_rounding_are_the_tasks(
    nominal: float, step: float, expected: bool
):
    case: Any = SimpleNamespace(
        trajectory=SimpleNamespace(t=nominal * np.arange(3)),
        scene=SimpleNamespace(task=SimpleNamespace(step=step)),
    )
    assert (of("h", case) == step).all() == expected


def test_an_error_that_nobody_knows_is_infinite():
    case: Any = SimpleNamespace(replay=SimpleNamespace(error=SimpleNamespace(estimate=None)))
    assert vars(of("error", case)) == dict.fromkeys(("position", "state", "gap"), math.inf)


# Forces by one convention


def pressed(**plan: Any) -> Evidence:
    """A mass of 1 kg that falls on a floor of 1e4 N/m, by its closed form: 40 steps of 2.5 ms."""
    scene = load_scene("bouncing_mass").with_parameters(k=1e4)
    w, t = 100.0, 0.0025 * np.arange(41)
    swing = np.hypot(9.81 / w**2, 0.5 / w)
    phase = np.arctan2(9.81 / w**2, 0.5 / w)
    leaves = (np.pi + 2.0 * phase) / w
    angle = w * np.minimum(t, leaves) - phase
    q = -9.81 / w**2 - swing * np.sin(angle)
    v = -swing * w * np.cos(angle)
    late = np.maximum(t - leaves, 0.0)
    q, v = q + v * late - 9.81 * late**2 / 2.0, v - 9.81 * late
    given = {
        "t": t, "q": q[:, None], "v": v[:, None], "u": np.zeros((40, 0)),
        "lam": np.maximum(-1e4 * q[:-1, None], 0.0),
    } | plan  # fmt: skip
    return Evidence(scene, Trajectory(**given), None)


def test_typical_force_is_the_weight_that_rests_on_the_floor():
    assert pressed().typical_force == pytest.approx(9.81, rel=1e-4)


@pytest.mark.parametrize("convention", ["start", "middle", "end", "mean"])
def test_convention_is_the_one_of_the_stated_forces(convention: str):
    laws = pressed().laws
    case = pressed(lam=laws[convention].copy())
    assert case.convention == convention
    mixed = laws["start"].copy()
    mixed[::2] = laws["end"][::2]
    other = pressed(lam=mixed)
    off = other.h @ np.abs(mixed - other.laws[other.convention])
    assert off[0] > 0.01 * (other.h @ mixed)[0]


def test_laws_mean_of_a_step_is_its_impulse():
    case = pressed()
    impulse = float(case.h @ case.laws["mean"][:, 0])
    v = case.v[:, 0]
    assert impulse == pytest.approx(v[-1] - v[0] + 9.81 * 0.1, rel=1e-3)


def test_force_beyond_its_step_is_found_by_its_size():
    lam = pressed().lam.copy()
    lam[-1] += 0.5
    found = measures.contact_force_error(pressed(lam=lam))
    assert (found.values, found.scales) == (pytest.approx(0.5), pytest.approx(9.81, rel=1e-4))


def test_velocities_that_alternate_are_counted_and_coarse_rows_are_not():
    case = pressed()
    assert measures.velocity_error(case).values.max() < 2e-4
    v = case.v.copy()
    v[:, 0] += 0.5 * (-1.0) ** np.arange(41)
    found = measures.velocity_error(pressed(v=v))
    assert found.values.max() == pytest.approx(0.5 * 0.01, rel=0.2)


def test_friction_without_contact_forces_is_limited_by_the_law():
    scene = load_scene("transport")
    q = np.tile(scene.task.start[: scene.nq], (6, 1))
    lam = np.zeros((5, 3))
    lam[2, 2] = 5.0
    plan = Trajectory(
        t=0.02 * np.arange(6), q=q, v=0.0 * q, u=np.zeros((5, 1)), lam=lam,
        missing=frozenset({"lam"}),
    )  # fmt: skip
    case = Evidence(scene, plan, None)
    limit = case.typical_friction
    excess = case.friction_excess[:, 0]
    assert excess.argmax() == 2
    assert 0.0 < excess[2] <= 5.0
    assert (limit > 0.0).all()


def test_relaxed_forces_fall_with_the_gap_and_noise_does_not():
    case = pressed()
    gap = case.q[:-1]
    relaxed = 1e4 * 2e-3 * np.logaddexp(0.0, -gap / 2e-3)
    assert measures.is_relaxed(pressed(lam=relaxed))
    assert not measures.is_relaxed(pressed())
    noise = relaxed * np.random.default_rng(0).uniform(0.0, 2.0, size=relaxed.shape)
    assert not measures.is_relaxed(pressed(lam=noise))
