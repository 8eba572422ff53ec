"""A part of `python -m benchmarks verdicts` that takes seconds: exact plans hold, wrong ones do not and are told why, and a search finds no way round."""

import ast
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks import ROOT
from benchmarks.verdicts import exact, search, wrong
from benchmarks.verdicts.command import differs
from benchmarks.verdicts.plans import REFUSED, Case, Plan, judged, motion_of, scene_of
from models.catalog import load_scene
from tests.oracles.scene_motion import Motion

SCENES = ("three_cart", "wall_pendulum", "transport")
EXACT = {
    "three_cart": (
        "true forces at the start", "true forces at the end", "forces averaged over the step",
        "without force columns", "without velocities",
        "inputs alone", "inputs alone, no final time", "4 decimals, forces start",
        "4 decimals, forces end", "4 decimals, forces mean",
        "a grid four times finer", "an irregular grid", "a grid five times coarser", "linear hold",
        "Runge-Kutta 4 at the task's step",
        "semi-implicit Euler of 1 ms, every tenth", "the method's own plan, its scheme declared",
    ),
    "wall_pendulum": ("forces averaged over the step", "without velocities and forces",
                      "4 decimals, forces start", "linear hold", "a grid four times finer"),
    "transport": ("true forces at the start", "forces averaged over the step",
                  "without force columns", "4 decimals, forces end"),
}  # fmt: skip
WRONG = {
    "three_cart": (
        "bodies through each other, to the goal", "inputs alone through each other",
        "the plan of wall_pendulum", "3 of 500 steps", "5 s appended",
        "ten times the inputs", "another start, 1e-4 off", "at the goal from the start on",
        "nothing done", "nothing done, states of a plan that does",
        "inputs mirrored", "a spike of one velocity",
        "invented forces of 100 N", "a spike of force, there and back",
        "forces mirrored", "relaxed, as its method declares it",
        "relaxed, forces and scheme deleted", "relaxed, velocities and forces deleted",
        "relaxed, inputs alone",
    ),
    "wall_pendulum": ("3 of 20 steps", "invented forces of 100 N",
                      "relaxed, forces and scheme deleted", "too costly, on a coarse grid"),
    "transport": ("friction works with the slip", "friction ten times too large", "nothing done",
                  "one step beyond the bounds"),
}  # fmt: skip


def _chosen(cases: list[Case], words: dict[str, tuple[str, ...]]) -> list[Case]:
    by_name = {case.name: case for case in cases}
    return [by_name[f"{scene}: {name}"] for scene, names in words.items() for name in names]


def _exact_cases() -> list[Case]:
    return _chosen(list(exact.cases(SCENES)), EXACT)


def _wrong_cases() -> list[Case]:
    return _chosen(list(wrong.cases(SCENES)), WRONG)


@pytest.fixture
def said(tmp_path: Path) -> Callable[[Case], str]:
    """What differs from what is expected of a case, or nothing."""

    def say(case: Case) -> str:
        plan = case.plan if isinstance(case.plan, Plan) else case.plan()
        answer = judged(
            scene_of(case.scene), plan.write(tmp_path / "plan.csv", scene_of(case.scene))
        )
        fault = differs(case, answer)
        return f"{fault}: {answer.verdict}: {answer.why}" if fault else ""

    return say


@pytest.mark.slow
@pytest.mark.parametrize(
    "place",
    range(sum(map(len, EXACT.values()))),
    ids=[f"{s}-{n}" for s, names in EXACT.items() for n in names],
)
def test_an_exact_plan_holds_however_it_is_written(place: int, said):
    assert said(_exact_cases()[place]) == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    "place",
    range(sum(map(len, WRONG.values()))),
    ids=[f"{s}-{n}" for s, names in WRONG.items() for n in names],
)
def test_a_wrong_plan_does_not_hold_and_is_told_why(place: int, said):
    assert said(_wrong_cases()[place]) == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three_cart", "wall_pendulum"])
def test_a_search_finds_no_way_round(name: str, tmp_path: Path):
    result = search.run([name], 6, 4, tmp_path)
    assert result["wrong"] >= 4
    assert result["finds"] == []


@pytest.mark.slow
def test_the_oracle_says_nothing_against_exact_plans():
    oracle = search.Oracle("three_cart")
    for case in _exact_cases():
        if case.scene == "three_cart":
            plan = case.plan if isinstance(case.plan, Plan) else case.plan()
            assert oracle.wrong(plan.text(scene_of("three_cart"))) == "", case.name


def test_a_refusal_is_an_answer(tmp_path: Path):
    (tmp_path / "plan.csv").write_text("t,u1\n0,1\n1,\n", encoding="utf-8")
    assert judged(scene_of("three_cart"), tmp_path / "plan.csv").verdict == REFUSED


def test_scene_motion_shares_no_code_with_the_judge():
    names = set()
    for path in (ROOT / "tests" / "oracles").glob("scene_*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                names.add(node.module)
            elif isinstance(node, ast.Import):
                names |= {item.name for item in node.names}
    ours = {name for name in names if name.split(".")[0] in ("models", "formulations", "validate")}
    assert ours == {"models.scene"}


def test_the_motion_is_that_of_equations_written_by_hand():
    """Three carts, as their paper has them, without events and by another integrator."""
    scene = scene_of("three_cart")
    t = scene.task.step * np.arange(101)
    u = np.tile([4.0, -3.0], (100, 1))

    def rates(_: float, x: np.ndarray) -> list[float]:
        left, right = (30.0 * max(0.5 - (x[i + 1] - x[i]), 0.0) for i in (0, 1))
        return [
            *x[3:],
            4.0 - 2.0 * x[3] - left,
            -2.0 * x[4] + left - right,
            -3.0 - 2.0 * x[5] + right,
        ]

    path = motion_of("three_cart").run(t, u)
    by_hand = solve_ivp(
        rates,
        (0.0, 1.0),
        scene.task.start,
        method="LSODA",
        rtol=1e-11,
        atol=1e-12,
        max_step=0.001,
        t_eval=t,
    )
    np.testing.assert_allclose(np.hstack([path.q, path.v]), by_hand.y.T, atol=1e-8)
    assert path.depth.max() > 0.05
    np.testing.assert_allclose(
        np.diff(path.v.sum(axis=1)) / 0.01,
        1.0 - 2.0 * np.diff(path.q.sum(axis=1)) / 0.01,
        atol=1e-8,
    )


def test_stick_and_slip_are_those_of_dry_friction():
    """Cargo on a cart: below mu g it is carried, above it slips, and after the push ends it slips on until it is as fast as the cart."""
    scene = load_scene("transport")
    motion, mass = Motion(scene), 3.0
    start = np.array([0.0, 0.0, 0.0, 0.0])
    t = 0.01 * np.arange(201)
    u = np.zeros((200, 1))
    u[:50], u[50:100] = 5.0, 12.0  # 5/3 m/s^2 < mu g = 1.962 m/s^2 < (12 - mu m g)/m_c
    path = motion.run(t, u, start=start)
    g = 0.2 * 9.81
    np.testing.assert_allclose(path.v[50], 5.0 / mass * 0.5, rtol=1e-9)
    np.testing.assert_allclose(path.friction_mean[:50, 0], 5.0 / mass, rtol=1e-9)
    np.testing.assert_allclose(
        path.v[100], path.v[50] + 0.5 * np.array([g, (12.0 - g) / 2.0]), rtol=1e-9
    )
    caught = (path.v[100, 1] - path.v[100, 0]) / (g + g / 2.0)
    after = t >= 1.0 + caught + 0.02
    np.testing.assert_allclose(path.v[after, 0], path.v[after, 1], rtol=1e-9)
    np.testing.assert_allclose(path.v[-1] @ [1.0, 2.0], 5.0 * 0.5 + 12.0 * 0.5, rtol=1e-9)
