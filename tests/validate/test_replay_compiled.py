"""The loops in C against the loops in Python: the same calls, and therefore the same numbers, bit for bit; and a clean way back where C cannot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from foreign_fmu import build_foreign

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import MachineError
from models.fmu import build_fmu
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.fmi.package import Package, read_package, unpacked
from validate.judge.replay.compiled import integration, library
from validate.judge.replay.everyday import simulate
from validate.judge.replay.reference import ExchangeModel, Integration, Run, integrate
from validate.judge.replay.result import ReplayOutcome
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


def reference(package: Package, variables: Variables, start: np.ndarray, inputs: HeldInputs, *, compiled: bool) -> Run:
    model = ExchangeModel(package, variables)
    try:
        return integrate(model, start, inputs, 1e-10, 1000, compiled=compiled)
    finally:
        model.close()


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


def test_the_loops_in_c_are_those_that_run(carts: tuple[Package, Variables], monkeypatch: pytest.MonkeyPatch):
    """Otherwise the tests above compare Python with Python."""

    def broken(*_: object) -> None:
        raise AssertionError("a loop of Python")

    plan = pushed("three_cart")
    monkeypatch.setattr(Integration, "advance", broken)
    monkeypatch.setattr("validate.fmi.instance.Instance.do_step", broken)
    assert reference(*carts, plan.start, HeldInputs(plan), compiled=True).outcome is ReplayOutcome.OK
    assert simulate(*carts, plan.start, HeldInputs(plan), 20, rolls_back=True).outcome is ReplayOutcome.OK
    with pytest.raises(AssertionError, match="a loop of Python"):
        reference(*carts, plan.start, HeldInputs(plan), compiled=False)


FOREIGN = Variables(
    q=(10,), v=(11,), u=(20,), lam=(30,), gap=(31,), energies={}, powers={}, zero=frozenset(), parameters=((40, 2.0),), start=(10, 11), internal_step=None
)  # fmt: skip


@pytest.mark.parametrize("mode", ["good", "nan", "fatal"])
def test_somebody_elses_fmu_and_how_it_goes_wrong(tmp_path: Path, mode: str):
    steps = 40
    empty = np.zeros((steps + 1, 1))
    plan = Trajectory(t=uniform_grid(0.01, steps), q=empty, v=empty, u=np.full((steps, 1), 0.004), lam=np.zeros((steps, 1)))
    start = np.array([300.0, 2000.0])
    with unpacked(read_package(build_foreign(tmp_path / "cart.fmu", mode))) as package:
        pairs = [
            [reference(package, FOREIGN, start, HeldInputs(plan), compiled=compiled) for compiled in (True, False)],
            [simulate(package, FOREIGN, start, HeldInputs(plan), 100, compiled=compiled) for compiled in (True, False)],
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


def test_without_a_compiler_python_does_it(carts: tuple[Package, Variables], monkeypatch: pytest.MonkeyPatch):
    plan = pushed("three_cart", steps=10)
    compiled = reference(*carts, plan.start, HeldInputs(plan), compiled=True), simulate(*carts, plan.start, HeldInputs(plan), 20)

    def none() -> None:
        raise MachineError("no C compiler was found.")

    monkeypatch.setattr(library, "find_compiler", none)
    library.load.cache_clear()
    try:
        assert library.load() is None
        same(compiled[0], reference(*carts, plan.start, HeldInputs(plan), compiled=True))
        same(compiled[1], simulate(*carts, plan.start, HeldInputs(plan), 20))
    finally:
        library.load.cache_clear()


def test_without_the_addresses_of_cvode_python_drives_it(carts: tuple[Package, Variables], monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    plan = pushed("three_cart", steps=10)
    compiled = reference(*carts, plan.start, HeldInputs(plan), compiled=True)
    assert integration._addresses(tmp_path / "_cy_cvode.so") is None
    monkeypatch.setattr(integration, "solver_addresses", lambda: None)
    same(compiled, reference(*carts, plan.start, HeldInputs(plan), compiled=True))


def test_a_binary_that_lacks_a_function_is_left_to_python(carts: tuple[Package, Variables]):
    """FMI 3.0 has no call for slopes of inputs: asked for it, the loops in C are not begun."""
    package, variables = carts
    model = ExchangeModel(package, variables)
    rates, outputs, inputs = model.references
    try:
        assert library.describe(model.instance, ["GetReal"], inputs=inputs, outputs=outputs, rates=rates) is not None
        described = library.describe(model.instance, ["SetRealInputDerivatives"], inputs=inputs, outputs=outputs)
        assert (described is None) is package.is_three
    finally:
        model.close()
