"""The loops in C against the loops in Python: the same calls, and therefore the same numbers, bit for bit; and what is said where they cannot run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import python_loops
from foreign_fmu import build_foreign

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import MachineError
from models.fmu import build_fmu
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.fmi import loops
from validate.fmi.description import FmuError, Package, read_package, unpacked
from validate.judge.replay import everyday
from validate.judge.replay import reference as exchange
from validate.judge.replay.result import ReplayOutcome, Run
from validate.judge.replay.subject import find_variables
from validate.judge.replay.tracking import design_feedback
from validate.judge.replay.wiring import Feedback, HeldInputs, Variables

STEPS = 60


def pushed(name: str, hold: Hold = Hold.ZERO_ORDER, steps: int = STEPS) -> Trajectory:
    """Inputs within the scene's bounds, a first body that is thrown at its neighbour, and the motion that they make."""
    scene = load_scene(name)
    waves = np.sin(np.arange(steps)[:, None] / (7.0 + np.arange(scene.nu)))
    half = np.array([min(item.upper, 20.0) for item in scene.inputs])
    u = 0.8 * half * np.round(waves, 1)
    start = np.array(scene.task.start)
    start[scene.nq] += 3.0
    rollout = load_kernel(scene).rollout(start, u, scene.task.step)
    return Trajectory(t=uniform_grid(scene.task.step, steps), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, hold=hold)


def same(one: Run, other: Run) -> None:
    for item in fields(Run):
        left, right = getattr(one, item.name), getattr(other, item.name)
        if isinstance(left, list):
            left, right = np.array(left, dtype=float), np.array(right, dtype=float)
            assert left.shape == right.shape, item.name
            assert left.tobytes() == right.tobytes(), item.name
        else:
            assert left == right, item.name


def reference(package: Package, variables: Variables, start: np.ndarray, inputs: HeldInputs, *, compiled: bool = True) -> Run:
    model = python_loops.PythonModel(package, variables)
    try:
        return (exchange if compiled else python_loops).integrate(model, start, inputs, 1e-10, 1000)
    finally:
        model.close()


def simulate(
    package: Package,
    variables: Variables,
    start: np.ndarray,
    inputs: HeldInputs,
    fineness: int,
    *,
    rolls_back: bool = False,
    compiled: bool = True,
) -> Run:
    loop = everyday.simulate if compiled else python_loops.simulate
    return loop(package, variables, start, inputs, fineness, rolls_back=rolls_back)


def tracked(name: str, plan: Trajectory) -> Feedback:
    scene = load_scene(name)
    return design_feedback(load_kernel(scene), scene, plan)


@pytest.fixture(params=["2.0", "3.0"])
def version(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def carts(version: str) -> Iterator[tuple[Package, Variables]]:
    scene = load_scene("three_cart")
    with unpacked(read_package(build_fmu(scene, version=version))) as package:
        yield package, find_variables(package, scene)


@pytest.mark.parametrize("hold", list(Hold))
def test_cvode_in_c_gives_the_bits_of_cvode_in_python(carts: tuple[Package, Variables], hold: Hold):
    plan = pushed("three_cart", hold)
    runs = [reference(*carts, plan.start, HeldInputs(plan), compiled=compiled) for compiled in (True, False)]
    assert runs[0].outcome is ReplayOutcome.OK
    assert len(runs[0].events) >= 2  # it has to come back to Python and to go on
    same(*runs)


def test_cvode_in_c_with_feedback(version: str):
    scene, plan = load_scene("cart_pole_walls"), pushed("cart_pole_walls")
    feedback = tracked("cart_pole_walls", plan)
    with unpacked(read_package(build_fmu(scene, version=version))) as package:
        variables = find_variables(package, scene)
        runs = [reference(package, variables, plan.start, HeldInputs(plan, feedback), compiled=compiled) for compiled in (True, False)]
    assert len(runs[0].applied) == STEPS
    same(*runs)


@pytest.mark.parametrize("rolls_back", [False, True])
@pytest.mark.parametrize("hold", list(Hold))
def test_stepping_in_c_gives_the_bits_of_stepping_in_python(carts: tuple[Package, Variables], hold: Hold, rolls_back: bool):
    plan = pushed("three_cart", hold)
    for inputs in (lambda: HeldInputs(plan), lambda: HeldInputs(plan, tracked("three_cart", plan))):
        runs = [simulate(*carts, plan.start, inputs(), 20, rolls_back=rolls_back, compiled=compiled) for compiled in (True, False)]
        assert runs[0].outcome is ReplayOutcome.OK
        assert len(runs[0].local) == STEPS * rolls_back
        same(*runs)


FOREIGN = Variables(
    q=(10,), v=(11,), u=(20,), lam=(30,), gap=(31,), energies={}, powers={}, zero=frozenset(), parameters=((40, 2.0),), start=(10, 11), internal_step=None
)  # fmt: skip


def foreign_inputs(steps: int = 40) -> HeldInputs:
    empty = np.zeros((steps + 1, 1))
    return HeldInputs(Trajectory(t=uniform_grid(0.01, steps), q=empty, v=empty, u=np.full((steps, 1), 0.004), lam=np.zeros((steps, 1))))


@pytest.mark.parametrize("mode", ["good", "nan", "fatal"])
def test_somebody_elses_fmu_and_how_it_goes_wrong(tmp_path: Path, mode: str):
    start = np.array([300.0, 2000.0])
    with unpacked(read_package(build_foreign(tmp_path / "cart.fmu", mode))) as package:
        pairs = [
            [reference(package, FOREIGN, start, foreign_inputs(), compiled=compiled) for compiled in (True, False)],
            [simulate(package, FOREIGN, start, foreign_inputs(), 100, compiled=compiled) for compiled in (True, False)],
        ]
    expected = {"good": ReplayOutcome.OK, "nan": ReplayOutcome.NOT_A_NUMBER, "fatal": ReplayOutcome.FATAL}[mode]
    assert [run.outcome for pair in pairs for run in pair] == [expected] * 4
    for pair in pairs:
        same(*pair)


def test_a_step_that_leaves_every_bound_ends_both_loops_alike(carts: tuple[Package, Variables]):
    plan = pushed("three_cart", steps=5)
    wild = Trajectory(t=1e6 * plan.t, q=plan.q, v=plan.v, u=plan.u, lam=plan.lam)
    runs = [simulate(*carts, plan.start, HeldInputs(wild), 20, compiled=compiled) for compiled in (True, False)]
    assert runs[0].outcome in (ReplayOutcome.DIVERGED, ReplayOutcome.NOT_A_NUMBER)
    same(*runs)


def test_without_a_compiler_a_replay_is_refused(carts: tuple[Package, Variables], monkeypatch: pytest.MonkeyPatch):
    plan = pushed("three_cart", steps=10)

    def none() -> None:
        raise MachineError("no C compiler was found.")

    monkeypatch.setattr(loops, "find_compiler", none)
    loops.load.cache_clear()
    try:
        with pytest.raises(MachineError, match="no C compiler"):
            reference(*carts, plan.start, HeldInputs(plan))
        with pytest.raises(MachineError, match="no C compiler"):
            simulate(*carts, plan.start, HeldInputs(plan), 20)
    finally:
        loops.load.cache_clear()


def test_cvode_that_cannot_be_reached_is_named(tmp_path: Path):
    with pytest.raises(MachineError, match=r"CVODE, cannot be reached in .*_cy_cvode\.so.*install scikit-sundae"):
        exchange._addresses(tmp_path / "_cy_cvode.so")


@pytest.mark.parametrize("function", ["fmi2GetDerivatives", "fmi2DoStep"])
def test_a_binary_that_lacks_a_function_is_refused(tmp_path: Path, function: str):
    """Before any loop is begun: FMPy wants all functions of the interface."""
    with unpacked(read_package(build_foreign(tmp_path / "cart.fmu", defines=(f"{function}=another",)))) as package:
        run = reference if function == "fmi2GetDerivatives" else lambda *given: simulate(*given, 20)
        with pytest.raises(FmuError, match=f"cannot be loaded on this machine .a function of FMI is missing in the binary .*{function}"):
            run(package, FOREIGN, np.zeros(2), foreign_inputs())


@pytest.mark.parametrize("status", [-1, 7])
def test_what_is_no_status_of_fmi_is_refused(tmp_path: Path, status: int):
    """FMPy itself lets a negative one pass."""
    wrong = f"fmi2ExitInitializationMode(c)=fmi2ExitInitializationMode(c){{return {status};}}int unused(c)"
    with unpacked(read_package(build_foreign(tmp_path / "cart.fmu", defines=(wrong,)))) as package:
        for run in (
            reference(package, FOREIGN, np.zeros(2), foreign_inputs()),
            simulate(package, FOREIGN, np.zeros(2), foreign_inputs(), 20),
        ):
            assert run.outcome is ReplayOutcome.FMU_FAILED
            assert f"fmi2ExitInitializationMode failed with status {status}" in run.message
