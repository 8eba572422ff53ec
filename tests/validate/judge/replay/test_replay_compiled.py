"""The loops in C against the loops in Python: the same calls, and therefore the same numbers, bit for bit; and what is said where they cannot run."""

import ctypes
from collections.abc import Iterator
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import python_loops
from foreign_fmu import build_foreign

from models.catalog import load_scene
from models.codegen import compiler
from models.codegen.kernel import load_kernel
from models.errors import MachineError
from models.fmu import build_fmu
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.fmi import loops
from validate.fmi.description import FmuError, Package, read_package, unpacked
from validate.fmi.instance import Misbehaviour, References
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
    return Trajectory(
        t=uniform_grid(scene.task.step, steps),
        q=rollout.q,
        v=rollout.v,
        u=u,
        lam=rollout.lam,
        hold=hold,
    )


def same(one: Run, other: Run) -> None:
    for item in fields(Run):
        left, right = getattr(one, item.name), getattr(other, item.name)
        if isinstance(left, list):
            left, right = np.array(left, dtype=float), np.array(right, dtype=float)
            assert left.shape == right.shape, item.name
            assert left.tobytes() == right.tobytes(), item.name
        else:
            assert left == right, item.name


def reference(
    package: Package,
    variables: Variables,
    start: np.ndarray,
    inputs: HeldInputs,
    *,
    compiled: bool = True,
) -> Run:
    with closing(python_loops.PythonModel(package, variables)) as model:
        return (exchange if compiled else python_loops).integrate(model, start, inputs, 1e-10, 1000)


def simulate(*given: Any, compiled: bool = True, **how: Any) -> Run:
    return (everyday if compiled else python_loops).simulate(*given, **how)


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
    runs = [
        reference(*carts, plan.start, HeldInputs(plan), compiled=compiled)
        for compiled in (True, False)
    ]
    assert runs[0].outcome is ReplayOutcome.OK
    assert len(runs[0].events) >= 2  # it has to come back to Python and to go on
    same(*runs)


def test_cvode_in_c_with_feedback(version: str):
    scene, plan = load_scene("cart_pole_walls"), pushed("cart_pole_walls")
    feedback = tracked("cart_pole_walls", plan)
    with unpacked(read_package(build_fmu(scene, version=version))) as package:
        variables = find_variables(package, scene)
        runs = [
            reference(package, variables, plan.start, HeldInputs(plan, feedback), compiled=compiled)
            for compiled in (True, False)
        ]
    assert len(runs[0].applied) == STEPS
    same(*runs)


@pytest.mark.parametrize("hold", list(Hold))
def test_stepping_in_c_gives_the_bits_of_stepping_in_python(
    carts: tuple[Package, Variables], hold: Hold
):
    plan = pushed("three_cart", hold)
    for inputs in (lambda: HeldInputs(plan), lambda: HeldInputs(plan, tracked("three_cart", plan))):
        runs = [
            simulate(*carts, plan.start, inputs(), 20, compiled=compiled)
            for compiled in (True, False)
        ]
        assert runs[0].outcome is ReplayOutcome.OK
        same(*runs)


FOREIGN = Variables(
    q=(10,), v=(11,), u=(20,), lam=(30,), gap=(31,), energies={}, powers={}, zero=frozenset(),
    parameters=((40, 2.0),), start=(10, 11), internal_step=None
)  # fmt: skip


def foreign_inputs(steps: int = 40) -> HeldInputs:
    empty = np.zeros((steps + 1, 1))
    return HeldInputs(
        Trajectory(
            t=uniform_grid(0.01, steps),
            q=empty,
            v=empty,
            u=np.full((steps, 1), 0.004),
            lam=np.zeros((steps, 1)),
        )
    )


@pytest.mark.parametrize("mode", ["good", "nan", "fatal"])
def test_somebody_elses_fmu_and_how_it_goes_wrong(tmp_path: Path, mode: str):
    start = np.array([300.0, 2000.0])
    with unpacked(read_package(build_foreign(tmp_path / "cart.fmu", mode))) as package:
        pairs = [
            [
                reference(package, FOREIGN, start, foreign_inputs(), compiled=compiled)
                for compiled in (True, False)
            ],
            [
                simulate(package, FOREIGN, start, foreign_inputs(), 100, compiled=compiled)
                for compiled in (True, False)
            ],
        ]
    expected = {
        "good": ReplayOutcome.OK,
        "nan": ReplayOutcome.NOT_A_NUMBER,
        "fatal": ReplayOutcome.FATAL,
    }[mode]
    assert [run.outcome for pair in pairs for run in pair] == [expected] * 4
    for pair in pairs:
        same(*pair)


def test_a_step_that_leaves_every_bound_ends_both_loops_alike(carts: tuple[Package, Variables]):
    plan = pushed("three_cart", steps=5)
    wild = Trajectory(t=1e6 * plan.t, q=plan.q, v=plan.v, u=plan.u, lam=plan.lam)
    runs = [
        simulate(*carts, plan.start, HeldInputs(wild), 20, compiled=compiled)
        for compiled in (True, False)
    ]
    assert runs[0].outcome in (ReplayOutcome.DIVERGED, ReplayOutcome.NOT_A_NUMBER)
    same(*runs)


def test_without_a_compiler_a_replay_is_refused(
    carts: tuple[Package, Variables], monkeypatch: pytest.MonkeyPatch
):
    plan = pushed("three_cart", steps=10)

    def none() -> None:
        raise MachineError("no C compiler was found.")

    monkeypatch.setattr(compiler, "find_compiler", none)
    loops.load.cache_clear()
    try:
        with pytest.raises(MachineError, match="no C compiler"):
            reference(*carts, plan.start, HeldInputs(plan))
        with pytest.raises(MachineError, match="no C compiler"):
            simulate(*carts, plan.start, HeldInputs(plan), 20)
    finally:
        loops.load.cache_clear()


@pytest.mark.parametrize("function", ["fmi2GetDerivatives", "fmi2DoStep"])
def test_a_binary_that_lacks_a_function_is_refused(tmp_path: Path, function: str):
    """Before any loop is begun: FMPy wants all functions of the interface."""
    with unpacked(
        read_package(build_foreign(tmp_path / "cart.fmu", defines=(f"{function}=another",)))
    ) as package:
        run = reference if function == "fmi2GetDerivatives" else lambda *given: simulate(*given, 20)
        with pytest.raises(FmuError, match=f"missing in the binary .*{function}"):
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


# What the loops are told, and what is done with their answers


def instance_of(major: int = 2) -> Any:
    """An FMU whose functions lie at addresses that say which they are."""
    addresses: list[str] = []

    def address(name: str) -> int:
        addresses.append(name)
        return 1000 + len(addresses)

    refused: list[Any] = []
    return SimpleNamespace(
        major=major, fmu=SimpleNamespace(component=77, address=address), asked=addresses,
        refuse=lambda *given: refused.append(given),
        refused=refused,
    )  # fmt: skip


@pytest.mark.parametrize("major", [2, 3])
def test_an_fmu_is_described_by_its_counts_addresses_and_the_calls_that_are_needed(major: int):
    instance = instance_of(major)
    inputs, outputs, rates = References([3]), References([4, 5]), References([6, 7, 8])
    found = loops.describe(
        instance,
        ["SetTime", "NewDiscreteStates", "GetReal"],
        inputs=inputs,
        outputs=outputs,
        rates=rates,
        states=9,
        indicators=10,
    )
    assert (found.component, found.three, found.states, found.indicators, found.inputs,
            found.outputs, found.rates) == (
        77, major == 3, 9, 10, 1, 2, 3,
    )  # fmt: skip
    assert (found.input_references, found.output_references, found.rate_references) == tuple(
        ctypes.addressof(item.array) for item in (inputs, outputs, rates)
    )
    assert instance.asked == (
        ["GetReal", "SetTime", "NewDiscreteStates"]
        if major == 2
        else ["GetFloat64", "SetTime", "UpdateDiscreteStates"]
    )
    assert {place: call for place, call in enumerate(found.call) if call} == {
        0: 1001,
        2: 1002,
        9: 1003,
    }
    without = loops.describe(instance, [], inputs=inputs, outputs=outputs)
    assert (without.rates, without.states, without.indicators) == (0, 0, 0)
    found.fault_call, found.fault_status = 9, 3
    loops.refuse(instance, found)
    assert instance.refused == [("NewDiscreteStates" if major == 2 else "UpdateDiscreteStates", 3)]


class Loops:
    """Loops that come back for a reason, with the first `done` of their steps made."""

    def __init__(self, reason: Any, done: int) -> None:
        self.reason, self.made, self.calls = reason, done, []

    def step_through(self, place: Any, first: int, last: int) -> int:
        loop: Any = ctypes.cast(place, ctypes.POINTER(loops.structure("stepping"))).contents
        self.calls.append((first, last))
        self.told = {name: getattr(loop, name) for name, *_ in loop._fields_}
        loop.done, loop.reached = min(self.made, last), 0.3
        numbers = (ctypes.c_double * (3 * 4)).from_address(loop.outputs)
        for index in range(3, 3 * 4):
            numbers[index] = 10.0 + index
        return int(self.reason if self.made < last else everyday.Reason.DONE)


def stepped(
    reason: Any,
    done: int,
    monkeypatch: pytest.MonkeyPatch,
    *,
    feedback: Any = None,
    fault: int = 0,
) -> tuple[Run, Loops, Any]:
    """Three steps of half a second of an FMU with three outputs."""
    states = np.zeros((4, 1))
    plan = Trajectory(
        t=0.5 * np.arange(4), q=states, v=states, u=np.ones((3, 1)), lam=np.zeros((3, 0))
    )
    answering = Loops(reason, done)
    run = Run(knots=[0], t=[0.0], outputs=[np.array([1.0, 2.0, 3.0])])
    instance = instance_of()
    monkeypatch.setattr(loops, "load", lambda: answering)
    described = loops.describe(instance, [], inputs=References([3]), outputs=References([4, 5, 6]))
    described.fault_status = fault
    monkeypatch.setattr(loops, "describe", lambda *given, **named: described)
    stepping = everyday.Stepping(
        fmu=instance, given=References([3]), outputs=References([4, 5, 6]),
        inputs=HeldInputs(plan, feedback), parts=1, slopes=False, states=2,
    )  # fmt: skip
    everyday.step_through(stepping, run)
    return run, answering, instance


def test_all_steps_are_recorded_where_they_are_made(monkeypatch: pytest.MonkeyPatch):
    run, answering, _ = stepped(everyday.Reason.DONE, 3, monkeypatch)
    assert (run.t, run.knots, answering.calls) == (
        [0.0, 0.5, 1.0, 1.5],
        [0, 1, 2, 3],
        [(0, 3)],
    )
    assert [row.tolist() for row in run.outputs[1:]] == [
        [13.0, 14.0, 15.0],
        [16.0, 17.0, 18.0],
        [19.0, 20.0, 21.0],
    ]


@pytest.mark.parametrize(
    ("reason", "outcome"),
    [(everyday.Reason.OUTPUT_NOT_FINITE, ReplayOutcome.NOT_A_NUMBER),
     (everyday.Reason.OUT_OF_BOUNDS, ReplayOutcome.DIVERGED),
     (everyday.Reason.CALL_REFUSED, ReplayOutcome.OK)],
)  # fmt: skip
def test_what_ends_a_loop_ends_the_run_at_the_step_that_it_was_in(reason, outcome, monkeypatch):
    run, _, instance = stepped(reason, 1, monkeypatch)
    assert (run.t, run.knots, run.outcome) == ([0.0, 0.5], [0, 1], outcome)
    assert ("t = 1 s" in run.message) is (outcome is not ReplayOutcome.OK)
    assert bool(instance.refused) is (reason is everyday.Reason.CALL_REFUSED)


def test_a_loop_is_told_its_bounds(monkeypatch: pytest.MonkeyPatch):
    """Two of the outputs are states; nothing may be beyond 1e9."""
    _, answering, _ = stepped(everyday.Reason.DONE, 3, monkeypatch)
    names = ("bounded", "bound", "linear", "gives_slopes", "parts")
    assert {name: answering.told[name] for name in names} == {
        "bounded": 2, "bound": 1e9, "linear": 0, "gives_slopes": 0, "parts": 1,
    }  # fmt: skip


def test_a_step_that_ends_early_is_misbehaviour(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(Misbehaviour, match=r"returned early at 0\.3 s.*not allowed"):
        stepped(everyday.Reason.EARLY_RETURN, 1, monkeypatch)


def test_with_feedback_each_step_is_asked_for_with_the_state_before_it(
    monkeypatch: pytest.MonkeyPatch,
):
    law = Feedback(
        gains=np.ones((3, 1, 2)), reference=np.zeros((4, 2)), u=np.ones((3, 1)),
        lower=np.array([-100.0]), upper=np.array([100.0]),
        scale=np.array([1.0]),
    )  # fmt: skip
    run, answering, _ = stepped(everyday.Reason.DONE, 3, monkeypatch, feedback=law)
    assert answering.calls == [(0, 1), (1, 2), (2, 3)]
    assert [row.tolist() for row in run.applied] == [[1.0 - 3.0], [1.0 - 27.0], [1.0 - 33.0]]
    run, answering, _ = stepped(everyday.Reason.OUT_OF_BOUNDS, 1, monkeypatch, feedback=law)
    assert (answering.calls, len(run.applied), run.t) == ([(0, 1), (1, 2)], 2, [0.0, 0.5])


@pytest.mark.parametrize(
    ("linear", "interpolates", "internal", "fineness", "parts", "slopes"),
    [
        (False, False, None, 200, 4, False), (False, False, None, 49, 1, False),
        (False, False, 9, 200, 1, False), (True, True, None, 200, 4, True),
        (True, False, None, 200, 200, False), (True, False, 9, 200, 200, False),
        (False, False, None, 150, 3, False), (False, True, None, 200, 4, False),
        (True, "by FMI 3.0", None, 200, 200, False),
    ],
)  # fmt: skip
def test_a_step_is_cut_as_its_fineness_and_its_inputs_need(
    linear, interpolates, internal, fineness, parts, slopes, monkeypatch
):
    found: list[Any] = []
    log: list[Any] = []
    instance = SimpleNamespace(
        choose=lambda choices: log.append(choices),
        initialise=lambda *given: log.append((given[0], given[1], given[2].array[:],
                                              given[3].tolist())),
        unload=lambda: log.append("unload"), read=lambda references: np.array([1.0, 2.0]),
    )  # fmt: skip
    monkeypatch.setattr(
        everyday, "load_instance", lambda package, kind: instance if kind == "CS" else None
    )
    monkeypatch.setattr(everyday, "step_through", lambda stepping, run: found.append(stepping))
    states = np.zeros((3, 1))
    plan = Trajectory(
        t=np.array([0.5, 1.0, 2.0]), q=states, v=states, u=np.array([[3.0], [4.0]]),
        lam=np.zeros((2, 0)),
        hold=Hold.LINEAR if linear else Hold.ZERO_ORDER,
    )  # fmt: skip
    variables = Variables(q=(1,), v=(2,), u=(5,), lam=(), gap=(), energies={}, powers={},
                          zero=frozenset(), parameters=((6, 0.5),), start=(7,),
                          internal_step=internal, choices=((8, 1),))  # fmt: skip
    package: Any = SimpleNamespace(
        is_three=interpolates == "by FMI 3.0",
        cosimulation=SimpleNamespace(canInterpolateInputs=bool(interpolates)),
    )
    run = everyday.simulate(package, variables, np.array([9.0]), HeldInputs(plan), fineness)
    (stepping,) = found
    own = 0.5 / fineness
    assert (stepping.parts, stepping.slopes, stepping.states) == (parts, slopes, 2)
    assert (stepping.given.array[:], stepping.outputs.array[:]) == ([5], [1, 2])
    settings = [(6, 0.5), (7, 9.0)] + ([] if internal is None else [(internal, own)])
    assert log == [((8, 1),), (0.5, settings, [5], [3.0]), "unload"]
    assert (run.t, run.knots, run.outputs[0].tolist()) == ([0.5], [0], [1.0, 2.0])


@pytest.mark.parametrize(
    ("values", "outcome"),
    [
        ([np.nan, 1.0], ReplayOutcome.NOT_A_NUMBER),
        ([1.0, -2e9], ReplayOutcome.DIVERGED),
        ([1.0, 1e9], ReplayOutcome.OK),
    ],
)
def test_a_first_row_that_is_no_number_or_out_of_bounds_ends_the_run(
    values: list[float], outcome: ReplayOutcome
):
    stepping: Any = SimpleNamespace(
        inputs=SimpleNamespace(times=np.array([0.5, 1.0])),
        fmu=SimpleNamespace(read=lambda outputs: np.array([*values, 1e12])), outputs=None,
        states=2,
    )  # fmt: skip
    run = Run()
    assert everyday.record_start(stepping, run) is (outcome is ReplayOutcome.OK)
    assert (run.outcome, "t = 0.5 s" in run.message, run.t) == (
        outcome, outcome is not ReplayOutcome.OK, [0.5] if outcome is ReplayOutcome.OK else [],
    )  # fmt: skip
