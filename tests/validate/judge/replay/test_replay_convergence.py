"""The replay under inputs that jump at every step, and on grids that divide nothing: it converges as its own order says, or says that it did not."""

from pathlib import Path

import numpy as np
import pytest
from edited_fmu import edited, without
from foreign_fmu import COSIMULATION, FULL_MAP, build_foreign, foreign_plan, write_plan

from models.catalog import load_scene
from models.fmu import build_fmu
from models.trajectory import Hold, Trajectory
from validate.judge.judgement import wire_fmu
from validate.judge.replay import Replay, ReplayOutcome
from validate.judge.replay.run import replay

# Carts 1 and 3 run into the middle one; apart they never meet.
COLLIDING = (2.0, 2.52, 3.05, 0.5, 0.0, -0.5)
APART = (2.0, 3.0, 4.0, 0.0, 0.0, 0.0)
# The Co-Simulation integrates by a method of order four, and finds contacts within its step.
ORDER = 4
FORCE = 20.0
NOISE = 1e-11


@pytest.fixture(scope="module")
def fmu() -> Path:
    return build_fmu(load_scene("three_cart"))


def replayed(
    fmu: Path, t: np.ndarray, u: np.ndarray, hold: Hold, start: tuple[float, ...], **options
) -> Replay:
    scene = load_scene("three_cart").with_task(steps=len(u), start=start)
    q, v = np.tile(start[:3], (len(t), 1)), np.tile(start[3:], (len(t), 1))
    return replay(
        scene, fmu, Trajectory(t=t, q=q, v=v, u=u, lam=np.zeros((len(u), 2)), hold=hold), **options
    )


def bang_bang(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Grid and inputs (steps, 2) that go from one bound to the other at every step."""
    return 0.01 * np.arange(steps + 1), FORCE * np.where(np.arange(steps) % 2 == 0, 1.0, -1.0)[
        :, None
    ] * np.array([[1.0, -1.0]])


def test_bang_bang_without_contact_is_exact(fmu: Path):
    """Polynomials of degree two between the jumps: whoever restarts at each jump has nothing left but rounding."""
    t, u = bang_bang(100)
    result = replayed(fmu, t, u, Hold.ZERO_ORDER, APART, fineness=(2, 4, 8))
    error = result.error
    assert result.outcome is ReplayOutcome.OK
    assert max(error.estimate.position, error.everyday.position) < NOISE
    assert error.step.position < NOISE


def test_bang_bang_through_contacts_has_the_richardson_ratio_of_its_order(fmu: Path):
    t, u = bang_bang(100)
    coarse, fine = (
        replayed(fmu, t, u, Hold.ZERO_ORDER, COLLIDING, fineness=fineness)
        for fineness in ((2, 4), (4, 8))
    )
    assert len(fine.events) >= 4
    ratio = coarse.error.step.position / fine.error.step.position
    assert np.log2(ratio) == pytest.approx(ORDER, abs=0.5)
    assert fine.error.everyday.position < 10 * fine.error.step.position


def test_contacts_shorter_than_the_steps_are_looked_at_more_closely(fmu: Path, tmp_path: Path):
    """Without Model Exchange nothing but the gaps and their rates tells that there was contact between two nodes."""
    only = edited(fmu, tmp_path / "cs.fmu", without("ModelExchange"))
    scene, (t, u) = (
        load_scene("three_cart").with_parameters(k=1e6).with_task(steps=100, start=COLLIDING),
        bang_bang(100),
    )
    plan = Trajectory(
        t=t,
        q=np.tile(COLLIDING[:3], (101, 1)),
        v=np.tile(COLLIDING[3:], (101, 1)),
        u=u,
        lam=np.zeros((100, 2)),
    )
    result, reference = replay(scene, only, plan, fineness=(1, 2, 3, 5)), replay(scene, fmu, plan)
    assert len(reference.events) > 0
    assert (
        np.abs(result.q[result.knots] - reference.q[reference.knots]).max()
        < 3.0 * result.error.estimate.position
        < 1e-2
    )


def test_where_co_simulation_is_too_coarse_for_a_stiff_contact_it_is_made_finer_and_its_distance_is_no_error():
    """A gram on 1e8 N/m is in contact for a fifth of a step of Co-Simulation: two halvings pass it by in the same way, and are half a metre wrong."""
    scene = (
        load_scene("bouncing_mass").with_parameters(m=1e-3, k=1e8).with_task(steps=90, step=0.01)
    )
    t = 0.01 * np.arange(91)
    plan = Trajectory(
        t=t,
        q=np.full((91, 1), 0.5),
        v=np.zeros((91, 1)),
        u=np.zeros((90, 0)),
        lam=np.zeros((90, 1)),
    )
    result = replay(scene, build_fmu(scene), plan)
    fall, omega, sag = np.sqrt(2.0 * 0.5 / 9.81), np.sqrt(1e11), 9.81e-11
    touches = 2.0 * (np.pi - np.arctan2(9.81 * fall / omega, sag)) / omega
    since = 0.9 - fall - touches  # it leaves as fast as it came
    assert result.q[-1, 0] == pytest.approx(
        9.81 * since * (fall - since / 2.0), abs=result.error.estimate.position
    )
    assert result.error.estimate == result.error.tolerance
    assert result.error.estimate.position < 1e-8


def smooth(t: np.ndarray) -> np.ndarray:
    """(n, 2) inputs that no grid holds exactly."""
    return np.column_stack([3 * np.sin(5 * t), -2 * np.cos(4 * t)])


def uneven(steps: int) -> np.ndarray:
    """A grid of one second whose steps are 1 : sqrt(2) : 0.7 : pi/3 long: none is a multiple of another, nor of a step inside."""
    lengths = np.resize([1.0, np.sqrt(2.0), 0.7, np.pi / 3], steps)
    return np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum()])


@pytest.fixture(scope="module")
def exact(fmu: Path) -> np.ndarray:
    """Where the smooth input leads, to 1e-6: as lines on a grid that is 17 times finer than the finest below."""
    return _end(fmu, uneven(1600), Hold.LINEAR)


@pytest.mark.parametrize(("hold", "order"), [(Hold.ZERO_ORDER, 1), (Hold.LINEAR, 2)])
@pytest.mark.parametrize("kind", ["reference", "everyday"])
def test_order_of_the_hold_on_grids_that_divide_nothing(
    hold: Hold, order: int, kind: str, fmu: Path, exact: np.ndarray, tmp_path: Path
):
    """As the plan's grid is refined, the motion goes to that of the smooth input with the order of the hold: 1 held, 2 as lines."""
    file = (
        fmu if kind == "reference" else edited(fmu, tmp_path / "cs.fmu", without("ModelExchange"))
    )
    counts = (24, 48, 96)
    errors = [np.abs(_end(file, uneven(steps), hold) - exact).max() for steps in counts]
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.35)


def _end(fmu: Path, t: np.ndarray, hold: Hold) -> np.ndarray:
    result = replayed(fmu, t, smooth(t[:-1]), hold, COLLIDING, fineness=(2, 4, 8))
    assert result.outcome is ReplayOutcome.OK
    return result.end


@pytest.mark.slow
@pytest.mark.parametrize("declared", [True, False])
def test_an_fmu_that_takes_multiples_of_its_step_alone_is_judged_at_those(
    declared: bool, tmp_path: Path
):
    """Its steps of 2 ms are a fifth of the plan's. How wrong they are no other step tells."""
    path = build_foreign(tmp_path / "cart.fmu", kinds=COSIMULATION, defines=("MULTIPLES_OF=2e-3",))
    if declared:
        step = '<DefaultExperiment stepSize="0.002"/><ModelVariables>'
        path = edited(
            path, tmp_path / "told.fmu", lambda text: text.replace("<ModelVariables>", step)
        )
    (tmp_path / "map.toml").write_text(FULL_MAP, encoding="utf-8")
    plan = write_plan(tmp_path / "plan.csv", plan=foreign_plan())
    for given, estimate in ((FULL_MAP, None), (f"{FULL_MAP}[accuracy]\nposition = 1e-3\n", 1e-3)):
        (tmp_path / "map.toml").write_text(given, encoding="utf-8")
        found = wire_fmu(path, plan, map_path=tmp_path / "map.toml").judge().replay
        assert found.outcome is ReplayOutcome.OK
        assert "communication steps are refused" in found.message
        known = found.error.estimate
        assert (None if known is None else known.position) == estimate
    assert found.q[-1, 0] == pytest.approx(foreign_plan()[-1, 1], abs=5e-3)
