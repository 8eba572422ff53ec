"""How a metric is measured, on cases of two or three numbers that the other evidence does not hide."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.schemes import Scheme
from validate.judge.score import measures
from validate.judge.score.verdict import Contradicted, LeavesBounds, Unmeasured

# Half a unit of the last digit of each.
PRINTED = {"q": 0.01, "v": 0.02}


def test_a_start_without_velocities_is_one_of_positions():
    """A plan that says none, and a scene without inertia, where the inputs make them."""

    def case(missing: frozenset[str], relaxation: int | None) -> Any:
        return SimpleNamespace(
            scene=SimpleNamespace(nq=1, coordinates=[SimpleNamespace(nominal=0.5)]),
            task_start=np.array([1.0, 2.0]), goal=np.array([1.0, 2.25]),
            has_inertia=relaxation is None, q=np.array([[0.9]]), lacking={},
            trajectory=SimpleNamespace(missing=missing, v=np.array([[2.3]])),
            rounding={"q": np.array([[0.01]]), "v": np.array([[0.02]])},
        )  # fmt: skip

    whole = measures.start_error(case(frozenset(), None))
    assert (whole.values.tolist(), whole.scales.tolist(), whole.allowed.tolist()) == (
        pytest.approx([0.1, 0.3]),
        [0.5, 0.25],
        [0.01, 0.02],
    )
    for given in ((frozenset({"v"}), None), (frozenset(), 0)):
        found = measures.start_error(case(*given))
        assert (found.values.tolist(), found.scales.tolist(), found.allowed.tolist()) == (
            pytest.approx([0.1]),
            [0.5],
            [0.01],
        )


def test_a_range_with_one_end_or_none_is_as_large_as_what_is_given():
    inf = math.inf
    lower, upper = (
        np.array([-2.0, -inf, -3.0, -inf, 0.0, -inf]),
        np.array([3.0, -4.0, inf, inf, inf, 0.0]),
    )
    assert measures._ranges(lower, upper).tolist() == [5.0, 4.0, 3.0, 1.0, 1.0, 1.0]


def foreign(lam: Any, gap: Any, **more: Any) -> Any:
    """Somebody's FMU with two contacts, replayed in pieces of 1 to 4 s."""
    contacts = [SimpleNamespace(name="left"), SimpleNamespace(name="right")]
    scene = SimpleNamespace(lacks={}, contacts=contacts, depths=(0.1, 0.1))
    return SimpleNamespace(
        scene=scene,
        replay=SimpleNamespace(lam=np.array(lam)),
        replay_gap=np.array(gap),
        duration=np.array([1.0, 2.0, 3.0, 4.0]),
        **more,
    )


def test_the_stiffness_of_somebodys_fmu_is_what_its_forces_and_gaps_say():
    error = SimpleNamespace(gap=0.01)
    lam, gap = np.zeros((5, 2)), np.full((5, 2), 0.1)
    assert measures._impulse_error(foreign(lam, gap, error=error)) == 0.0
    lam[1, 0], lam[2, 1], gap[1:3] = 6.0, 8.0, [[-0.02, 0.1], [-0.05, -0.1]]
    # 6 N at 0.02 m are 300 N/m, 8 N at 0.1 m are 80; they touch for 1 + 2 s and for 2 + 3 s.
    assert measures._impulse_error(foreign(lam, gap, error=error)) == pytest.approx(
        300.0 * 8.0 * 0.01
    )
    lam[1, 1], gap[1, 1] = (
        5e4,
        -0.00099,
    )  # of a damper, where a contact begins that goes a hundred times as deep: it touches for 1 s more
    assert measures._impulse_error(foreign(lam, gap, error=error)) == pytest.approx(
        300.0 * 9.0 * 0.01
    )
    gap[1, 1] = -0.00101
    assert measures._impulse_error(foreign(lam, gap, error=error)) == pytest.approx(
        5e4 / 0.00101 * 9.0 * 0.01
    )
    assert measures._impulse_error(foreign(lam, np.abs(gap), error=error)) == 0.0, (
        "a force over an open gap says nothing of stiffness"
    )


@pytest.mark.parametrize("contact", [0, 1])
def test_a_contact_that_pushes_while_its_gap_is_open_has_a_map_that_is_wrong(contact: int):
    """Rows stand for 1, 3, 5, 7 and 4 s (twice what lies around them).

    It pushes at all but the fourth, a little being nothing: 13 s.
    """
    lam, gap = np.zeros((5, 2)), np.full((5, 2), -0.2)
    lam[:, contact] = 10.0, 10.0, 10.0, 0.09, 10.0
    gap[:, contact] = -1.0, 0.5, 0.6, 0.9, 0.009

    with pytest.raises(Contradicted, match=f"contact {('left', 'right')[contact]} .*open in 62 %"):
        measures._check_gaps(foreign(lam, gap))
    lam[3, contact] = 0.11  # a hundredth of the largest force is one: 15 of 20 s
    with pytest.raises(Contradicted, match="open in 75 %"):
        measures._check_gaps(foreign(lam, gap))
    lam[3, contact] = 0.0
    for changes in ({"depths": (None, None)}, {"lacks": {"lam": "no"}}, {"lacks": {"gap": "no"}}):
        blind = foreign(lam, gap)
        blind.scene.__dict__.update(changes)
        measures._check_gaps(blind)
    gap[1, contact] = -0.5  # 5 of 13 s are less than half
    measures._check_gaps(foreign(lam, gap))
    gap[1, contact], gap[2, contact] = 0.5, -0.6
    gap[0, contact], gap[4, contact] = 1.0, -0.1  # 4 of 13 s
    measures._check_gaps(foreign(lam, gap))


def test_grid_order_is_that_of_the_last_halving():
    for errors, order in (
        ([0.8, 0.4, 0.05], 3.0), ([0.8, 0.101, 0.0505], 1.0), ([0.8, 0.0], 7.0),
        ([1.0, 1e-9], 7.0), ([1.0, 1.5], math.log2(1 / 1.5)),
    ):  # fmt: skip
        case: Any = SimpleNamespace(grid_errors=errors)
        assert measures.grid_order(case) == pytest.approx(order)
    with pytest.raises(Unmeasured, match="far below the limit"):
        measures.grid_order(SimpleNamespace(grid_errors=[0.1]))


@pytest.mark.parametrize("applied", [None, np.array([[7.0], [8.0]])])
def test_replay_cost_all_rows_and_their_error(applied: np.ndarray | None):
    asked: list[tuple[Any, ...]] = []

    def cost_of(t: np.ndarray, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> float:
        asked.append((t.tolist(), u))
        return float((q**2).sum() - 3.0 * v.sum())

    replay = SimpleNamespace(
        applied=applied, t=np.array([0.0, 0.1, 0.25, 0.5]),
        q=np.array([[1.0], [2.0], [3.0], [4.0]]), v=np.array([[0.5], [0.25], [1.0], [2.0]]),
    )  # fmt: skip
    plan_u = np.array([[5.0], [6.0]])
    case: Any = SimpleNamespace(
        replay=replay, trajectory=SimpleNamespace(u=plan_u),
        need=lambda *parts: asked.append(parts), cost_of=cost_of,
        error=SimpleNamespace(state=0.125),
    )  # fmt: skip
    q, v = replay.q, replay.v
    value, error = measures.replay_cost(case)
    assert value == pytest.approx((q**2).sum() - 3 * v.sum())
    more, less = (
        sign * 2 * 0.125 * q.sum() + 4 * (0.125**2 - sign * 3 * 0.125) for sign in (1.0, -1.0)
    )
    assert error == pytest.approx(max(abs(more), abs(less)))
    assert asked[0] == ("q", "v")
    assert asked[1] == (replay.t.tolist(), plan_u if applied is None else applied)
    case.error.state = math.inf
    assert measures.replay_cost(case) == (pytest.approx(value), math.inf)


def test_the_end_on_its_own_grid_may_miss_what_the_plan_may():
    def case(limit: Any) -> Any:
        scene = SimpleNamespace(
            limit=lambda name: limit if name == "terminal_velocity_error" else None,
            coordinates=[SimpleNamespace(nominal=0.5)],
            nq=1,
        )
        end, goal = np.array([5.0, 1.0]), np.array([0.5, 0.25])
        return SimpleNamespace(
            scene=scene,
            trajectory=SimpleNamespace(steps=4),
            rounding={"q": np.array([[0.01]])},
            true_motion=(end[None, :1], end[None, 1:]),
            goal=goal,
        )

    for limit, allowed in (
        (None, 0.0),
        (SimpleNamespace(value=None), 0.0),
        (SimpleNamespace(value=0.3), 0.3),
    ):
        found = measures.end_error(case(limit), "discrete_", "velocity")
        assert (found.values, found.allowed, found.scales) == (
            0.75,
            allowed,
            pytest.approx(4 * (1e-6 * 0.5 + 0.01)),
        )
    assert measures.end_error(case(None), "discrete_", "position").values == 4.5


def test_a_collocation_plan_without_a_solution_has_left_its_scheme():
    finite = np.array([0.1, 0.2])
    case: Any = SimpleNamespace(
        rounding={"q": np.array([[0.01]]), "v": np.array([[0.02]])}, h=np.array([0.1, 0.2]),
        trajectory=SimpleNamespace(scheme=Scheme.RADAU_IIA_2), collocation_defect=finite,
        scene=SimpleNamespace(nq=1, coordinates=[SimpleNamespace(nominal=0.5)]),
        printing_acceleration=0.7,
    )  # fmt: skip
    found = measures.defect(case)
    assert (found.values.tolist(), found.allowed.tolist()) == (
        [0.1, 0.2],
        pytest.approx([0.02 + 0.2 * 0.02, 0.04 + 0.2 * 0.7]),
    )
    case.collocation_defect = np.array([0.1, np.inf])
    with pytest.raises(LeavesBounds, match=f"scheme {Scheme.RADAU_IIA_2.value}"):
        measures.defect(case)
