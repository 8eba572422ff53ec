"""What the metrics are computed from, by numbers that can be followed by hand: costs on any grid, printed digits, forces and motions in between."""

import math
from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import KernelError, load_kernel
from models.scene import Limit
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.judge.replay.result import ReplayOutcome
from validate.judge.replay.wiring import HeldInputs
from validate.judge.score import _metric
from validate.judge.score.depths import deepest, penetrations_within
from validate.judge.score.evidence import Evidence, _at_times
from validate.judge.score.own_steps import Stepper
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


def priced(
    t: list[float],
    u: list[list[float]],
    step: float,
    rows: tuple[Any, Any, Any],
    hold: Hold = Hold.LINEAR,
    end: Any = (5.0,),
) -> Any:
    """q, v, u of which the cost is asked, each time.

    And the cost, of inputs alone, and 7 at the end.
    """
    empty = np.zeros((len(t), 1))
    plan = Trajectory(
        t=np.array(t),
        q=empty,
        v=empty,
        u=np.array(u),
        lam=empty[1:],
        hold=hold,
        u_end=None if end is None else np.array(end),
    )
    asked: list[Any] = []

    def cost(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> float:
        asked.append((q.ravel().tolist(), v.ravel().tolist(), u.ravel().tolist()))
        return float((u**2).sum()) + 7.0

    case: Any = SimpleNamespace(
        scene=SimpleNamespace(task=SimpleNamespace(step=step)), h=np.diff(plan.t), trajectory=plan,
        held_inputs=HeldInputs(plan),
        kernel=SimpleNamespace(cost=cost),
    )  # fmt: skip
    return asked, Evidence.cost_of(case, *(np.array(part) for part in rows), plan.u)


def test_a_cost_is_asked_at_the_starts_of_the_tasks_own_steps():
    """q = t^3 from four rows, one of which is told twice: the first counts.

    Inputs are lines of 8 and of 20/3 a second.
    """
    t = np.array([0.0, 0.25, 0.25, 0.5])
    q, v = t[:, None] ** 3, 3.0 * t[:, None] ** 2
    q[2], v[2] = 9.0, 9.0
    own = np.array([0.0, 0.125, 0.25, 0.375, 0.5])
    ((found, *others), _) = priced([0.0, 0.25, 0.5], [[1.0], [3.0]], 0.125, (t, q, v))
    assert not others
    assert found[0] == pytest.approx((own**3).tolist(), abs=1e-15)
    assert found[1] == pytest.approx((3.0 * own**2).tolist(), abs=1e-15)
    assert found[2] == pytest.approx([1.0, 2.0, 3.0, 4.0])


def test_inputs_that_change_within_a_step_of_the_task_count_for_their_part():
    """Inputs 0, 4, 0, 8, at 0, 0.1, 0.5, 0.9 of steps of 0.5: at the starts of the steps they are nothing. States are those of the starts."""
    t = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
    asked, found = priced(
        [0.0, 0.1, 0.5, 0.9, 1.0],
        [[0.0], [4.0], [0.0], [8.0]],
        0.5,
        (t, t[:, None], -t[:, None]),
        Hold.ZERO_ORDER,
        None,
    )
    assert found == pytest.approx(0.8 * 16.0 + 0.2 * 64.0 + 7.0)
    assert asked[1:] == [
        ([x, 1.0], [-x, -1.0], [u]) for x, u in ((0.0, 0.0), (0.0, 4.0), (0.5, 0.0), (0.5, 8.0))
    ]


def test_on_the_tasks_own_grid_a_cost_is_that_of_the_rows():
    t, q, v = (
        np.array([0.0, 0.25, 0.5]),
        np.array([[1.0], [2.0], [3.0]]),
        np.array([[4.0], [5.0], [6.0]]),
    )
    assert priced([0.0, 0.25, 0.5], [[7.0], [8.0]], 0.25, (t, q, v))[0] == [
        ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0])
    ]
    more = np.array(
        [0.0, 0.1, 0.25, 0.4, 0.5]
    )  # rows between the nodes: those at the nodes are taken as they are
    values = np.arange(5.0)[:, None]
    assert priced([0.0, 0.25, 0.5], [[7.0], [8.0]], 0.25, (more, values, -values))[0] == [
        ([0.0, 2.0, 4.0], [0.0, -2.0, -4.0], [7.0, 8.0])
    ]


def test_a_plan_shorter_than_half_a_step_costs_one():
    t, rows = np.array([0.0, 0.04]), np.array([[1.0], [2.0]])
    found = priced([0.0, 0.04], [[7.0]], 0.1, (t, rows, 10 * rows), Hold.ZERO_ORDER, None)
    assert found[0] == [([1.0, 2.0], [10.0, 20.0], [7.0])]


@pytest.mark.parametrize(("share", "ok"), [(1.001, True), (0.999, False)])
@pytest.mark.parametrize("rows", [1, 20])
def test_a_cost_is_held_to_its_limit_as_that_of_the_motion_however_many_rows_a_plan_has(
    share: float, ok: bool, rows: int
):
    """A pendulum falls against its wall, made hard: with a row at its start and its end the cubic between them makes it a fifth dearer."""
    scene, parts = load_scene("wall_pendulum").with_parameters(k=2e3, w=0.12), 2000
    fine = load_kernel(scene).rollout(
        np.array(scene.task.start), np.zeros((20 * parts, 1)), scene.task.step / parts
    )
    cost = float((fine.q[:-1:parts] ** 2 + fine.v[:-1:parts] ** 2).sum())
    scene = replace(scene, limits=(Limit(metric="cost", value=share * cost, reason="a test"),))
    steps, every = 20 // rows, parts * rows
    plan = Trajectory(
        t=uniform_grid(scene.task.step * rows, steps),
        q=fine.q[::every],
        v=fine.v[::every],
        u=np.zeros((steps, 1)),
        lam=np.zeros((steps, 1)),
    )
    metric = _metric(
        next(entry for entry in TABLE if entry.name == "cost"), Evidence(scene, plan, None)
    )
    assert (metric.ok, metric.error) == (ok, 0.0)
    assert metric.value > 1.1 * cost if rows > 1 else metric.value == pytest.approx(cost, rel=1e-12)


def test_rows_are_found_but_for_the_rounding_of_their_times():
    t = np.array([0.0, 0.05, 0.1 * (1 + 3e-13), 0.2])
    q = np.arange(4.0)[:, None]
    found = _at_times(np.array([0.0, 0.1]), t, q, -q)
    assert (found[0].tolist(), found[1].tolist()) == ([[0.0], [2.0]], [[0.0], [-2.0]])
    between = _at_times(np.array([0.15]), t, q, np.full((4, 1), 10.0))
    assert between[0][0, 0] == pytest.approx(2.5)


# Printed digits


def test_each_group_has_its_own_last_digit():
    """Four decimals of positions and five of velocities of half a nominal.

    Three of inputs of 8 N, none of times on a grid, two of forces of 20 N.
    """
    random = np.random.default_rng(1)
    q, v, u, lam = (
        random.normal(size=(5, 3)),
        random.normal(size=(5, 3)),
        random.normal(size=(4, 2)),
        20.0 * random.normal(size=(4, 2)),
    )
    printed = {
        "q": np.round(q, 4),
        "v": np.round(v, 5),
        "u": np.round(u, 3),
        "lam": np.round(lam, 2),
    }
    case = carts(0.01 * np.arange(5), **printed)
    assert [case.printing[group] for group in ("t", "q", "v", "u", "lam")] == pytest.approx(
        [0.0, 5e-5, 5e-6, 5e-4, 5e-3]
    )
    with pytest.raises(KeyError):
        case.printing["x"]
    late = carts([0.0, 0.0101, 0.0213, 0.0318, 0.0402], **printed)
    assert late.printing["t"] == pytest.approx(5e-5)
    assert carts([0.0, 1.01, 2.13, 3.18, 4.02], **printed).printing["t"] == pytest.approx(5e-3)
    assert carts([0.0, 0.01, 0.02, 0.04, 0.05], **printed).printing["t"] == 0.0, (
        "a hundredth is more than a tenth of a step"
    )


@pytest.mark.parametrize(("group", "expected"), [("u", 0.5), ("lam", 1.0), ("v", 2.0 * 0.5)])
def test_what_printing_does_to_an_acceleration(group: str, expected: float):
    """Of 1 kg each: inputs push one cart, a force two of which the middle one may be pushed twice.

    Damping makes 2 m/s^2 of 1 m/s.
    """
    case = carts(0.01 * np.arange(21))
    case.__dict__["printing"] = dict.fromkeys(("t", "q", "v", "u", "lam"), 0.0) | {group: 0.5}
    assert case.printing_acceleration == pytest.approx(expected, rel=1e-6)


def test_printed_positions_change_the_forces_of_contacts():
    """Pressed 0.1 m together: 0.01 m each make at most 0.6 N on either side of the middle cart."""
    case = carts(0.01 * np.arange(21), q=np.tile([2.0, 2.4, 2.8], (21, 1)))
    case.__dict__["printing"] = {"q": 0.01, "v": 0.0, "u": 0.0, "lam": 0.0}
    assert case.printing_acceleration == pytest.approx(30.0 * 0.04, rel=1e-6)


# Friction


def test_friction_is_limited_at_both_ends_of_a_step_unless_a_scheme_says_where():
    limits = {1.0: [[-1.0, 3.0]], 2.0: [[2.0, 0.5]]}
    case: Any = SimpleNamespace(
        trajectory=SimpleNamespace(lam="forces", scheme=None), q=np.array([[1.0], [2.0]]),
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
        assert case.true_end == pytest.approx(np.concatenate([q[-1], v[-1]]), abs=1e-13)


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
    case._replay = SimpleNamespace(**vars(replay), outcome=ReplayOutcome.OK, ok=True)
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
    case._replay.applied = np.array([[0.0, 0.0], [-40.0, 0.0]])
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
    case._replay = SimpleNamespace(
        outcome=ReplayOutcome.DIVERGED, t=np.array([0.0, 0.25, 0.75]), ok=False
    )
    with pytest.raises(LeavesBounds, match=r"leaves every bound after 0\.75 s"):
        case.replay  # noqa: B018
    case._replay = SimpleNamespace(
        outcome=ReplayOutcome.CRASHED, t=np.array([0.0]), ok=False, message=""
    )
    with pytest.raises(Unmeasured, match=r"did not get to the end: The FMU crashed\.$"):
        case.replay  # noqa: B018


def test_the_motion_with_the_inputs_alone_is_the_replays_as_far_as_it_got():
    case = carts([0.0, 0.01], q=np.array([[2.0, 2.4, 4.0], [2.0, 3.0, 4.0]]))
    assert (case.opened_q is case.trajectory.q, case.opened_lam.tolist()) == (
        True,
        [pytest.approx([3.0, 0.0]), [0.0, 0.0]],
    )
    case._replay = SimpleNamespace(t=np.zeros(0), q=None, lam=None)
    assert case.opened_q is case.trajectory.q
    case._replay = SimpleNamespace(t=np.zeros(1), q="its own", lam="and its forces")
    assert (case.opened_q, case.opened_lam) == ("its own", "and its forces")


def test_ends_ask_for_velocities_only_where_the_goal_has_one():
    free = np.array([1.0, np.nan])
    case: Any = SimpleNamespace(
        goal=free,
        scene=SimpleNamespace(nq=1),
        q=np.array([[1.0], [2.0]]),
        need=lambda part: asked.append(part),
    )
    asked: list[str] = []
    assert of("end", case).tolist() == [2.0, 0.0]
    case.goal, case.v = np.array([np.nan, 3.0]), np.array([[5.0], [6.0]])
    assert of("end", case).tolist() == [2.0, 6.0]
    case.replay = SimpleNamespace(end="there")
    assert (of("replay_end", case), asked) == ("there", ["q", "v"])
    case.goal, asked[:] = free, []
    assert (of("replay_end", case), asked) == ("there", ["q"])


def test_a_window_of_forces_knows_their_means_where_impulses_are_told():
    """Three steps, two rows each: a bounce in the second that no row tells, but whose impulse is 0.6 N s in 0.2 s."""
    lam = np.zeros((7, 1))
    lam[6] = 5.0
    impulse = np.array([0.0, 0.0, 0.0, 0.3, 0.6, 0.6, 0.6])[:, None]
    case: Any = SimpleNamespace(
        need=lambda part: None,
        trajectory=SimpleNamespace(steps=3, t=np.array([0.0, 0.2, 0.4, 0.6])),
        step_of=np.array([0, 0, 1, 1, 2, 2]),
        replay=SimpleNamespace(lam=lam, contact_impulse=impulse, knots=np.array([0, 2, 4, 6])),
    )  # fmt: skip
    least, largest = of("force_window", case)
    assert (least.ravel().tolist(), largest.ravel().tolist()) == (
        [0.0, 0.0, 0.0],
        [pytest.approx(3.0), 5.0, 5.0],
    )
    case.replay.contact_impulse = None
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


# Small steps within the plan's


class Falling:
    """A kernel of one coordinate under its input, whose parts are exact but for an error that shrinks with them."""

    def __init__(self, error: float = 0.0, jump: bool = False) -> None:
        self.scene, self.error, self.jump, self.parts = SimpleNamespace(nl=1), error, jump, []

    def rollouts(self, x: np.ndarray, u: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        count = u.shape[1]
        self.parts.append((len(x), count, h))
        q, v = x[:, :1].copy(), x[:, 1:].copy()
        for part in range(count):
            q += h * (v + h * u[:, part] / 2)
            v += h * u[:, part]
        lam = np.cumsum(np.abs(u), axis=1)
        off = (-1.0) ** len(self.parts) if self.jump else 1.0 / count
        return lam, np.hstack([q, v + self.error * off])


def stepper(
    kernel: Falling,
    t: list[float],
    u: list[float],
    hold: Hold = Hold.ZERO_ORDER,
    end: float | None = None,
) -> Stepper:
    states = np.zeros((len(t), 1))
    plan = Trajectory(
        t=np.array(t),
        q=states,
        v=states,
        u=np.array(u)[:, None],
        lam=states[1:],
        hold=hold,
        u_end=None if end is None else np.array([end]),
    )
    return Stepper(kernel, HeldInputs(plan))


def size_of(dv: np.ndarray) -> np.ndarray:
    return np.abs(dv[:, 0])


def none() -> float:
    """By which nothing is small."""
    return 0.0


X = np.array([[1.0, 2.0], [3.0, -1.0], [0.0, 0.0]])


def test_each_step_is_run_from_its_own_state_under_its_own_input():
    """Steps of 0.5, 0.25 and 0.5 s; of equal length together."""
    kernel = Falling()
    found = stepper(kernel, [0.0, 0.5, 0.75, 1.25], [4.0, -8.0, 2.0]).run(X, size_of, 1.0, none)
    assert found.ends == pytest.approx(
        np.array([[1 + 1 + 0.5, 4.0], [3 - 0.25 - 0.25, -3.0], [0.25, 1.0]])
    )
    assert kernel.parts == [(1, 50, 0.005), (2, 50, 0.01), (1, 100, 0.0025), (2, 100, 0.005)]
    assert (found.least.ravel().tolist(), found.most.ravel().tolist()) == (
        [4.0, 8.0, 2.0],
        [400.0, 800.0, 200.0],
    )


def test_inputs_that_are_lines_are_taken_in_the_middle_of_each_part():
    """From 4 to 8 in half a second: their mean is 6, wherever it is cut."""
    found = stepper(Falling(), [0.0, 0.5], [4.0], Hold.LINEAR, 8.0).run(X[:1], size_of, 1.0, none)
    assert found.ends[0, 1] == pytest.approx(2.0 + 0.5 * 6.0, abs=1e-12)
    assert found.least[0, 0] == pytest.approx(4.0 + 4.0 / 200)


@pytest.mark.parametrize(("error", "parts"), [(0.0, 100), (0.09, 100), (0.11, 200), (0.21, 400)])
def test_parts_are_doubled_until_they_change_less_than_a_thousandth(error: float, parts: int):
    """An error of 1/n changes by half of what it was at n/2: 0.1/100 of a scale of 1."""
    kernel = Falling(error)
    stepper(kernel, [0.0, 0.5], [0.0]).run(X[:1], size_of, 1.0, none)
    assert kernel.parts[-1][1] == parts


def test_only_steps_that_are_not_settled_go_on_and_what_never_settles_is_said():
    kernel = Falling(0.11)
    with pytest.raises(Unmeasured, match=r"at t = 0 s, .*not to be had: 12800 parts"):
        stepper(Falling(1.0, jump=True), [0.0, 0.5], [0.0]).run(X[:1], size_of, 1.0, none)
    stepper(kernel, [0.0, 0.5, 1.0], [0.0, 0.0]).run(
        X[:2], lambda dv: np.abs(dv[:, 0]) * np.array([1.0, 0.1]), 1.0, none
    )
    assert [(rows, parts) for rows, parts, _ in kernel.parts] == [(2, 50), (2, 100), (1, 200)]


def test_what_never_settles_is_known_well_enough_where_little_force_is_left_open():
    """It jumps by 2 to the end of a step of half a second: a force of 4, and a thousandth of 4100 is more."""
    jumping = Falling(1.0, jump=True)
    found = stepper(jumping, [0.0, 0.5], [0.0]).run(X[:1], size_of, 1.0, lambda: 4100.0)
    assert found.ends[0, 1] in (1.0, 3.0)
    with pytest.raises(Unmeasured):
        stepper(Falling(1.0, jump=True), [0.0, 0.5], [0.0]).run(X[:1], size_of, 1.0, lambda: 3900.0)


def test_a_position_that_changes_counts_as_a_velocity_over_its_step():
    """Off by 0.11/n in position over a step of half a second: twice that in velocity."""
    kernel = Falling()

    def off(x: np.ndarray, u: np.ndarray, h: float) -> Any:
        lam, ends = Falling.rollouts(kernel, x, u, h)
        return lam, ends + np.array([0.055 / u.shape[1], 0.0])

    kernel.rollouts = off
    stepper(kernel, [0.0, 0.5], [0.0]).run(X[:1], size_of, 1.0, none)
    assert kernel.parts[-1][1] == 200


def test_departures_arrive_at_each_next_position():
    """Under -9 and 3: x moves by h v + h^2 u/2, so v = (move - h^2 u/2)/h.

    Off by 1 it changes by 1/h.
    """
    q = np.array([[1.0], [2.0], [1.5]])
    found = stepper(Falling(), [0.0, 0.5, 0.75], [-9.0, 3.0]).departures(
        q, np.array([0.0]), np.array([1.0])
    )
    assert found.v.ravel() == pytest.approx([(1.0 + 9.0 / 8) / 0.5, (-0.5 - 3.0 / 32) / 0.25])
    assert np.abs(found.missed).max() < 1e-10
    assert found.gains == pytest.approx([2.0, 4.0], rel=1e-6)


def test_a_position_that_is_never_reached_is_missed():
    """It moves as it likes: the best of all tries is told, and by how much it misses."""
    kernel = Falling()
    kernel.rollouts = lambda x, u, h: (
        np.zeros((len(x), 1, 1)),
        np.hstack([np.clip(x[:, 1:], -1.0, 1.0), x[:, 1:]]),
    )
    found = stepper(kernel, [0.0, 0.5], [0.0]).departures(
        np.array([[0.0], [3.0]]), np.array([0.5]), np.array([1.0])
    )
    assert found.missed.ravel() == pytest.approx([2.0], abs=1e-3)
