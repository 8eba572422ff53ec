"""Step halving by rollback: the run stays as it is, its sum of local errors against the true error, and FMUs that cannot after all."""

from pathlib import Path

import numpy as np
import pytest
from edited_fmu import edited, without
from foreign_fmu import EXCHANGE, FULL_MAP, build_foreign, foreign_plan, write_plan

from models.catalog import load_scene
from models.fmu import build_fmu
from tests.validate.judge.replay.test_replay_fmu import passive
from validate.fmi.description import FmuError, read_package, unpacked
from validate.judge.judgement import wire_fmu
from validate.judge.replay import Replay, ReplayOutcome
from validate.judge.replay import run as run_module
from validate.judge.replay.everyday import offers_rollback, simulate
from validate.judge.replay.run import replay, replay_foreign
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs

CS = '<CoSimulation modelIdentifier="cart" canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true"/>'
ONCE = CS.replace("/>", ' canBeInstantiatedOnlyOncePerProcess="true"/>')
ONCE_EXCHANGE = EXCHANGE.replace("/>", ' canBeInstantiatedOnlyOncePerProcess="true"/>')


def falling(name: str) -> tuple:
    """A scene with a closed form, and the plan without inputs from its start through its first contact."""
    scene = load_scene(name)
    return scene, passive(scene)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_run_that_rolls_back_is_the_plain_one(version: str):
    scene, plan = falling("two_body_collision")
    package = read_package(build_fmu(scene, version))
    variables, inputs = find_variables(package, scene), HeldInputs(plan)
    assert offers_rollback(package, variables)
    with unpacked(package) as there:
        plain = simulate(there, variables, plan.start, inputs, 4)
        rolled = simulate(there, variables, plan.start, inputs, 4, rolls_back=True)
    assert np.array(rolled.outputs).tobytes() == np.array(plain.outputs).tobytes()
    assert len(rolled.local) == scene.task.steps
    assert plain.local == []


@pytest.mark.parametrize("name", ["bouncing_mass", "two_body_collision"])
def test_local_errors_lie_between_the_errors_of_the_two_steps(tmp_path: Path, name: str):
    """Judged is the finer run; the sum is of the coarser one's local errors.

    Alone, carried on by the velocities, it exceeds even the coarser's.
    """
    scene, plan = falling(name)
    path = edited(build_fmu(scene), tmp_path / "cs.fmu", without("ModelExchange"))
    true = replay(scene, build_fmu(scene), plan, fineness=(2,))
    both = replay(scene, path, plan, fineness=(1, 2))
    alone = replay(scene, path, plan, fineness=(2,))
    coarse = replay(scene, path, plan, fineness=(1,))

    def error_of(result: Replay) -> float:
        return float(np.abs(result.q - true.q[true.knots]).max())

    assert true.method == "reference"
    assert len(true.events) == 2
    assert both.error.step_source == "second run and rollback"
    assert both.error.estimate.position == max(
        both.error.step.position, both.error.rollback.position
    )
    assert 2 * error_of(both) < both.error.rollback.position < error_of(coarse)
    assert alone.error.step_source == "rollback"
    assert error_of(coarse) < alone.error.estimate.position < 20 * error_of(coarse)


def test_beside_a_reference_it_is_told_and_changes_nothing():
    scene, plan = falling("bouncing_mass")
    error = replay(scene, build_fmu(scene), plan, fineness=(1, 2)).error
    assert error.step_source == "second run and rollback"
    assert error.rollback is not None
    assert error.estimate == error.everyday or error.estimate == error.tolerance
    # Once every difference is rounding, that is told as well: it is the FMU's own step that is
    # halved.
    assert (
        replay(scene, build_fmu(scene), plan, fineness=(100, 200)).error.step_source
        == "second run and rollback"
    )


def foreign_replay(folder: Path, kinds: str, *defines: str) -> Replay:
    path = build_foreign(folder / "cart.fmu", kinds=kinds, defines=defines)
    (folder / "cart.toml").write_text(FULL_MAP)
    wired = wire_fmu(path, write_plan(folder / "plan.csv"), map_path=folder / "cart.toml")
    return replay_foreign(wired.foreign, wired.package, wired.plan, limits=wired.limits)


def error_against_closed_form(result: Replay) -> float:
    return float(np.abs(result.q[result.knots, 0] - foreign_plan()[:, 1]).max())


def test_a_foreign_fmu_that_heeds_its_step(tmp_path: Path):
    result = foreign_replay(tmp_path, CS, "SAVES=1", "WHOLE_STEPS")
    error = result.error
    assert (result.outcome, result.message.count("rolled back"), error.step_source) == (
        ReplayOutcome.OK,
        0,
        "second run and rollback",
    )
    assert error_against_closed_form(result) < error.estimate.position
    assert error.estimate.position >= error.rollback.position > 0.0


@pytest.mark.parametrize("fineness", [(50, 100, 200), (200,)])
def test_a_foreign_fmu_that_ignores_its_step_has_no_estimate(
    tmp_path: Path, fineness: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(run_module, "FINENESS", fineness)
    error = foreign_replay(tmp_path, CS, "SAVES=1", "OWN_GRID=1e-3").error
    assert (error.estimate, error.rollback, error.step_source) == (None, None, "none")


@pytest.mark.parametrize("saves", ["SAVES=0", "SAVES=1"])
def test_a_foreign_fmu_with_a_longest_step_of_its_own_is_called_until_halving_tells(
    tmp_path: Path, saves: str
):
    """It divides every call into steps of at most 2e-5 s: two runs with calls above that make the same steps, near enough, whatever these are worth."""
    result = foreign_replay(tmp_path, CS, saves)
    assert result.error.step_ratio > 1.5
    assert error_against_closed_form(result) < result.error.estimate.position < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("saves", "words"),
    [
        ("SAVES=0", "fmi2GetFMUstate failed"),
        ("SAVES=2", "not the one it saved"),
        ("SAVES=3", "SIGSEGV"),
    ],
)
def test_a_state_that_cannot_be_saved_costs_the_rollback_alone(
    tmp_path: Path, saves: str, words: str
):
    result = foreign_replay(tmp_path, CS, saves, "WHOLE_STEPS")
    assert result.outcome is ReplayOutcome.OK
    assert "No step was rolled back" in result.message
    assert words in result.message
    assert (result.error.step_source, result.error.rollback) == ("second run", None)
    assert result.error.estimate is not None


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [ONCE, ONCE_EXCHANGE, ONCE_EXCHANGE + ONCE])
def test_one_instance_a_process_is_enough(tmp_path: Path, kinds: str):
    """Every run gets a process of its own; without that claim the second instance is refused."""
    result = foreign_replay(tmp_path, kinds, "SAVES=1", "WHOLE_STEPS", "ONCE")
    error, exchange = result.error, "ModelExchange" in kinds
    assert (result.outcome, result.method) == (
        ReplayOutcome.OK,
        "reference" if exchange else "everyday",
    )
    assert (error.tolerance is not None) == exchange
    assert error.step_source == ("none" if kinds == ONCE_EXCHANGE else "second run and rollback")
    node_error = np.abs(result.q[result.knots, 0] - foreign_plan()[:, 1]).max()
    assert node_error < max(error.estimate.position, 1e-8)


def test_a_second_instance_is_refused_where_nothing_was_said(tmp_path: Path):
    with pytest.raises(FmuError, match="cannot be loaded"):
        foreign_replay(tmp_path, CS, "SAVES=1", "WHOLE_STEPS", "ONCE")
