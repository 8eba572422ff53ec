"""An instance of an FMU, call by call: with a binary that answers what the test says, of either version of FMI."""

import ctypes
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Discard, fmi2Error, fmi2LastSuccessfulTime, fmi2Terminated

from validate.fmi.archive import FmuError, binary_name
from validate.fmi.description import Package
from validate.fmi.instance import (
    CLASSES,
    EVENT_ROUNDS,
    Instance,
    Lacking,
    Misbehaviour,
    References,
    StepAnswer,
    TerminationRequested,
    endless,
    faults_of,
    load_instance,
)

TWO = CLASSES[2, "CS"]
THREE = CLASSES[3, "CS"]


def bare(kind: Any, **answers: Any) -> tuple[Any, list[Any]]:
    """FMPy's object without a binary: each named call is noted, and answered so."""
    fmu = object.__new__(kind)
    log: list[Any] = []

    def answering(name: str, answer: Any) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            log.append((name, *given, *named.items()))
            if isinstance(answer, Exception):
                raise answer
            return answer(*given) if callable(answer) else answer

        return call

    fmu.component = "component"
    for name, answer in answers.items():
        setattr(fmu, name, answering(name, answer))
    return fmu, log


def refused(status: int) -> FMICallException:
    return FMICallException(function="x", status=status)


# The two versions


@pytest.mark.parametrize(
    ("status", "terminated", "expected"),
    [
        (None, None, StepAnswer(event=False, ends=False, early=False, reached=2.5)),
        (fmi2Discard, True, StepAnswer(event=False, ends=True, early=False, reached=2.5)),
        (fmi2Discard, False, None),
        (fmi2Discard, refused(fmi2Error), None), (fmi2Error, True, None),
    ],
)  # fmt: skip
def test_a_step_that_is_discarded_ends_only_where_the_fmu_says_so(
    status: int | None, terminated: Any, expected: StepAnswer | None
):
    fmu, log = bare(
        TWO, doStep=None if status is None else refused(status), getBooleanStatus=terminated
    )
    if expected is None:
        with pytest.raises(FMICallException):
            fmu.step(2.0, 0.5)
    else:
        assert fmu.step(2.0, 0.5) == expected
    assert log[0] == ("doStep", 2.0, 0.5)
    assert log[1:] == ([("getBooleanStatus", fmi2Terminated)] if status == fmi2Discard else [])


def test_the_last_successful_time_is_asked_of_fmi_2_alone():
    fmu, log = bare(TWO, getRealStatus=1.25)
    assert (fmu.last_successful_time(), log) == (1.25, [("getRealStatus", fmi2LastSuccessfulTime)])
    assert bare(TWO, getRealStatus=refused(fmi2Error))[0].last_successful_time() is None
    assert bare(THREE)[0].last_successful_time() is None
    fmu, log = bare(THREE, doStep=(True, False, True, 2.25))
    assert fmu.step(2.0, 0.5) == StepAnswer(event=True, ends=False, early=True, reached=2.25)


@pytest.mark.parametrize(
    ("kind", "type_of", "values", "name", "held"),
    [
        (TWO, "Real", [1.5, -2.5], "Real", [1.5, -2.5]),
        (TWO, "Integer", [2.0, 3.0], "Integer", [2, 3]),
        (TWO, "Enumeration", [3.0, 1.0], "Integer", [3, 1]),
        (TWO, "Boolean", [1.0, 0.0], "Boolean", [1, 0]),
        (THREE, "Float64", [1.5, -2.5], "Float64", [1.5, -2.5]),
        (THREE, "Float32", [1.5, -2.5], "Float32", [1.5, -2.5]),
        (THREE, "Int32", [2.0, -7.0], "Int32", [2, -7]),
        (THREE, "UInt8", [2.0, 255.0], "UInt8", [2, 255]),
        (THREE, "Boolean", [2.0, 0.0], "Boolean", [True, False]),
        (THREE, "Enumeration", [3.0, 1.0], "Int64", [3, 1]),
    ],
)  # fmt: skip
def test_values_are_handed_over_by_the_call_of_their_type_as_c_has_them(
    kind: Any, type_of: str, values: list[float], name: str, held: list[Any]
):
    """Two entries of one array, or two variables; FMI 3.0 is told how many entries there are."""
    calls = {f"{kind.prefix}{verb}{name}": None for verb in ("Get", "Set")}
    fmu, log = bare(kind, **calls)
    several = fmu.references(type_of, [7] if kind is THREE else [7, 9], 2)
    several.values[:] = values
    fmu.transfer("Set", several)
    fmu.transfer("Get", several)
    size = (2,) if kind is THREE else ()
    assert log == [
        (call, "component", several.array, several.count, several.memory, *size)
        for call in reversed(calls)
    ]
    assert (list(several.memory), list(several.array)) == (held, [7] if kind is THREE else [7, 9])
    several.forget()
    assert (
        np.isnan(several.values).all()
        if several.values.dtype.kind == "f"
        else not several.values.any()
    )


def test_doubles_are_handed_over_in_the_order_of_each_version():
    two, log_2 = bare(TWO, fmi2GetReal=None, fmi2SetReal=None)
    three, log_3 = bare(THREE, fmi3GetFloat64=None, fmi3SetFloat64=None)
    some = References([3, 4, 8, 9])
    for fmu in (two, three):
        fmu.transfer("Get", some)
        fmu.transfer("Set", some)
    given = ("component", some.array, 4, some.memory)
    assert log_2 == [("fmi2GetReal", *given), ("fmi2SetReal", *given)]
    assert log_3 == [("fmi3GetFloat64", *given, 4), ("fmi3SetFloat64", *given, 4)]


def test_each_version_sets_up_and_derives_by_its_own_calls():
    two, log = bare(
        TWO, setupExperiment=None, enterInitializationMode=None, getDirectionalDerivative=[2.0]
    )
    two.setup(1.0, 2.0, 1e-6)
    two.enter(1.0, 2.0, 1e-6)
    assert two.directional([1], [2], [3.0], 4) == [2.0]
    assert log == [
        ("setupExperiment", ("tolerance", 1e-6), ("startTime", 1.0), ("stopTime", 2.0)),
        ("enterInitializationMode",),
        ("getDirectionalDerivative", [1], [2], [3.0]),
    ]  # fmt: skip
    three, log = bare(
        THREE,
        enterInitializationMode=None,
        getDirectionalDerivative=[2.0],
        getAdjointDerivative=[3.0],
    )
    three.setup(1.0, 2.0, 1e-6)
    three.enter(1.0, 2.0, 1e-6)
    assert (three.directional([1], [2], [3.0], 4), three.adjoint([5], [6], [7.0], 8)) == (
        [2.0],
        [3.0],
    )
    assert log == [
        ("enterInitializationMode", ("tolerance", 1e-6), ("startTime", 1.0), ("stopTime", 2.0)),
        ("getDirectionalDerivative", [1], [2], [3.0], ("nSensitivity", 4)),
        ("getAdjointDerivative", [5], [6], [7.0], ("nSensitivity", 8)),
    ]  # fmt: skip


def test_each_versions_model_exchange_gives_rates_and_ends_events_by_its_own_calls():
    def tells(component: Any, info: Any) -> None:
        (
            info._obj.newDiscreteStatesNeeded,
            info._obj.nextEventTimeDefined,
            info._obj.nextEventTime,
        ) = 1, 1, 2.5

    def answers(component: Any, *places: Any) -> None:
        for place, value in zip(places, (True, False, False, False, True, 2.5), strict=True):
            place._obj.value = value

    two, log_2 = bare(CLASSES[2, "ME"], fmi2GetDerivatives=None, fmi2NewDiscreteStates=tells)
    three, log_3 = bare(
        CLASSES[3, "ME"], fmi3GetContinuousStateDerivatives=None, fmi3UpdateDiscreteStates=answers
    )
    for fmu in (two, three):
        fmu.rates("into", 2)
        assert fmu.update() == (True, False, False, False, True, 2.5)
    assert (log_2[0], log_2[1][0]) == (
        ("fmi2GetDerivatives", "component", "into", 2),
        "fmi2NewDiscreteStates",
    )
    assert (log_3[0], log_3[1][0]) == (
        ("fmi3GetContinuousStateDerivatives", "component", "into", 2),
        "fmi3UpdateDiscreteStates",
    )


@pytest.mark.parametrize(
    ("status", "raised", "fatal"),
    [
        (0, False, False),
        (1, False, False),
        (2, True, False),
        (3, True, False),
        (4, True, True),
        (17, True, False),
    ],
)
def test_a_status_is_refused_unless_it_is_ok_or_a_warning(status: int, raised: bool, fatal: bool):
    """Also one that FMI does not know; and what is fatal is remembered."""
    fmu, _ = bare(TWO)

    class Function:
        restype = ctypes.c_int

        def __call__(self, *given: Any) -> int:
            return status

    fmu._functions = {"fmi2DoStep": Function()}
    if raised:
        with pytest.raises(FMICallException) as caught:
            fmu._call("fmi2DoStep", 1.0)
        assert (caught.value.status, caught.value.function) == (status, "fmi2DoStep")
    else:
        assert fmu._call("fmi2DoStep", 1.0) == status
    assert fmu.fatal is fatal
    Function.restype = ctypes.c_void_p  # type: ignore[assignment]
    assert fmu._call("fmi2DoStep", 1.0) == status, "an address is no status"
    with pytest.raises(FMICallException):
        fmu.refuse("x", fmi2Error)
    assert fmu.fatal is fatal, "once fatal, always fatal; and nothing else is"


# The instance


def made(major: int = 2, kind: str = "CS", **description: Any) -> tuple[Instance, list[Any]]:
    """An instance whose calls are noted. Answers are given by `instance.fmu.NAME = ..`."""
    log: list[Any] = []
    instance = object.__new__(Instance)
    given = {
        "fmiVersion": f"{major}.0",
        "numberOfContinuousStates": 2,
        "numberOfEventIndicators": 3,
    } | description
    instance.description, instance.kind, instance.options = SimpleNamespace(**given), kind, {}
    instance.time, instance.next_event, instance._needs_tool = math.nan, math.inf, False

    class Calls:
        component = "component"
        fatal = False
        messages, last_message = 0, ""
        prefix = f"fmi{major}"

        def __getattr__(self, name: str) -> Any:
            return lambda *given: log.append((name, *given))

    instance.fmu = Calls()
    return instance, log


def test_an_initialisation_sets_first_what_is_set_before_and_then_the_inputs():
    instance, log = made()
    memory: list[Any] = []
    instance.fmu.transfer = lambda verb, what: memory.append(
        (verb, list(what.array), list(what.memory), what.count)
    )
    instance.initialise(1.5, [(12, 0.5), (13, -2.0)], References([3]), np.array([7.0]))
    assert [call[0] for call in log] == ["setup", "enter", "exitInitializationMode"]
    assert log[0] == ("setup", 1.5, None, None)
    assert log[1] == ("enter", 1.5, None, None)
    assert memory == [("Set", [12, 13], [0.5, -2.0], 2), ("Set", [3], [7.0], 1)]
    assert instance.time == 1.5


def test_whole_numbers_are_chosen_where_there_are_some():
    instance, log = made()
    instance.choose([])
    instance.fmu.references = THREE.references
    instance.choose([(4, 1), (5, 2)])
    ((call, verb, what),) = log
    assert (call, verb, what.kind, list(what.array), list(what.memory)) == (
        "transfer",
        "Set",
        "Int64",
        [4, 5],
        [1, 2],
    )


def test_nothing_is_read_or_written_where_there_is_nothing():
    instance, log = made()
    assert instance.read(References([])).tolist() == []
    instance.write(References([]), [])
    assert log == []
    some = References([3, 4])
    instance.fmu.transfer = lambda verb, what: what.memory.__setitem__(
        slice(None), [5.0, 6.0] if verb == "Get" else []
    )
    assert (instance.read(some).tolist(), some.count) == ([5.0, 6.0], 2)


@pytest.mark.parametrize(
    ("component", "fatal"), [("component", False), (None, False), ("component", True)]
)
def test_what_lives_is_ended_and_freed_and_nothing_after_a_fatal_status(
    component: Any, fatal: bool
):
    instance, log = made(3)
    instance.fmu.component, instance.fmu.fatal = component, fatal
    instance.unload()
    lives = component is not None and not fatal
    assert (
        log == [("terminate",), ("fmi3FreeInstance", "component"), ("freeLibrary",)]
        if lives
        else log == ([] if fatal else [("freeLibrary",)])
    )
    if lives:
        assert instance.fmu.component is None
        log.clear()
        instance.close()
        assert log == []


def test_what_does_not_terminate_is_freed_all_the_same():
    instance, log = made()
    instance.fmu.terminate = Mock(side_effect=refused(fmi2Error))
    instance.close()
    assert log == [("fmi2FreeInstance", "component")]


def test_an_event_goes_round_until_the_fmu_is_content():
    """Again, ends, nominals changed, states changed, a next event, its time."""
    instance, log = made(kind="ME")
    rounds = [
        (True, False, False, True, False, 9.0),
        (True, False, True, False, True, 8.0),
        (False, False, False, False, True, 7.5),
    ]
    instance.fmu.update = iter(rounds).__next__
    assert instance.event() is True
    assert (log, instance.next_event) == ([("enterEventMode",), ("leave",)], 7.5)
    instance.fmu.update = lambda: (False, False, True, False, False, 7.0)
    assert (instance.settle(), instance.next_event) == (False, math.inf)
    instance.time, instance.fmu.update = 1.25, lambda: (False, True, False, False, False, 0.0)
    with pytest.raises(TerminationRequested, match=r"end the simulation at t = 1\.25 s") as caught:
        instance.settle()
    assert caught.value.time == 1.25
    count: list[int] = []
    instance.fmu.update = lambda: count.append(1) or (True, False, False, False, False, 0.0)
    with pytest.raises(Misbehaviour, match=f"did not end after {EVENT_ROUNDS} rounds"):
        instance.settle()
    assert len(count) == EVENT_ROUNDS == 100
    assert str(endless()) == "the event iteration did not end after 100 rounds"


def test_states_and_indicators_are_read_into_memory_of_their_size():
    instance, _ = made(kind="ME")

    def filled(array: Any, size: int) -> None:
        array[:] = [10.0 * size + index for index in range(size)]

    for name in (
        "getContinuousStates",
        "getNominalsOfContinuousStates",
        "rates",
        "getEventIndicators",
    ):
        setattr(instance.fmu, name, filled)
    assert (
        instance.states().tolist()
        == instance.nominals().tolist()
        == instance.rates().tolist()
        == [20.0, 21.0]
    )
    assert instance.indicators().tolist() == [30.0, 31.0, 32.0]
    none, _ = made(kind="ME", numberOfContinuousStates=0)
    none.fmu.getContinuousStates = lambda array, size: None
    assert none.states().tolist() == []


def test_a_move_sets_time_and_states_where_there_are_some():
    instance, log = made(kind="ME")
    moved: list[Any] = []
    instance.fmu.setContinuousStates = lambda array, size: moved.append((list(array), size))
    instance.move(2.5, np.array([1.0, -1.0]))
    assert (instance.time, log, moved) == (2.5, [("setTime", 2.5)], [([1.0, -1.0], 2)])
    none, log = made(kind="ME", numberOfContinuousStates=0)
    none.move(1.0, np.empty(0))
    assert log == [("setTime", 1.0)]


def test_a_completed_step_may_want_an_event_or_the_end():
    instance, _ = made(kind="ME")
    for event in (True, False):
        instance.fmu.completedIntegratorStep = lambda event=event: (event, False)
        assert instance.completed() is event
    instance.time, instance.fmu.completedIntegratorStep = 3.5, lambda: (False, True)
    with pytest.raises(TerminationRequested, match=r"t = 3\.5 s"):
        instance.completed()


@pytest.mark.parametrize("flag", [True, False])
def test_whether_steps_are_told_is_the_other_way_round_in_fmi_3(flag: bool):
    two, _ = made(2, "ME", modelExchange=SimpleNamespace(completedIntegratorStepNotNeeded=flag))
    three, _ = made(3, "ME", modelExchange=SimpleNamespace(needsCompletedIntegratorStep=flag))
    assert (two.wants_steps, three.wants_steps) == (not flag, flag)


def test_a_step_that_asks_for_the_end_says_where_it_would_have_ended():
    instance, _ = made()
    instance.fmu.step = lambda time, length: StepAnswer(True, False, False, time + 2 * length)
    assert instance.do_step(1.0, 0.25) == StepAnswer(True, False, False, 1.5)
    instance.fmu.step = lambda time, length: StepAnswer(False, True, False, time)
    with pytest.raises(TerminationRequested, match=r"t = 1\.25 s"):
        instance.do_step(1.0, 0.25)


def test_saved_states_are_kept_in_the_place_that_is_given():
    instance, log = made()
    place = ctypes.c_void_p(5)
    assert instance.save(place) is place
    fresh = instance.save()
    assert (isinstance(fresh, ctypes.c_void_p), log[0]) == (True, ("save_to", place))
    instance.restore(place)
    instance.forget(place)
    assert log[2:] == [("setFMUState", place), ("freeFMUState", place)]


def test_what_the_fmu_said_last_ends_a_sentence():
    instance, _ = made()
    assert instance.quote() == ""
    for text in (b"first", b"no   license\nfound" + b"!" * 300):
        instance._log("instance", 3, b"category", text)
    assert instance.quote() == "; it said: no license found" + "!" * 184
    instance._log(None)
    assert instance.quote() == ""


@pytest.mark.parametrize("needs_tool", [True, False])
def test_an_fmu_that_gives_no_instance_lacks_its_tool_or_misbehaves(needs_tool: bool):
    instance, _ = made()
    instance.fmu.make, instance._needs_tool = Mock(side_effect=Exception("null")), needs_tool
    with pytest.raises(
        Lacking if needs_tool else Misbehaviour, match="the FMU returned no instance"
    ) as caught:
        instance.instantiate()
    assert ("needs the tool" in str(caught.value)) is needs_tool
    instance.fmu.make = Mock(side_effect=refused(fmi2Error))
    with pytest.raises(FMICallException):
        instance.instantiate()


@pytest.mark.parametrize(
    ("error", "there", "kind", "words"),
    [
        (
            AttributeError("fmi2DoStep"),
            False,
            Misbehaviour,
            r"missing in the binary \(fmi2DoStep\)",
        ),
        (
            OSError("libtool.so.2: cannot open shared object file"),
            False,
            Lacking,
            r"its binary needs libtool\.so\.2, which neither",
        ),
        (
            OSError("libtool.so.2: cannot open shared object file"),
            True,
            Misbehaviour,
            r"cannot be loaded \(libtool",
        ),
        (
            Exception("No platform binary"),
            False,
            Misbehaviour,
            r"cannot be loaded \(No platform binary\)",
        ),
    ],
)
def test_a_binary_that_does_not_load_says_why(error, there, kind, words, tmp_path, monkeypatch):
    if there:
        (tmp_path / "binaries").mkdir()
        (tmp_path / "binaries/libtool.so.2").write_bytes(b"")

    def fails(**given: Any) -> Any:
        assert given == {
            "guid": "g",
            "modelIdentifier": "m",
            "unzipDirectory": str(tmp_path),
            "instanceName": "replay",
        }
        raise error

    monkeypatch.setitem(CLASSES, (2, "ME"), fails)
    interface, other = (
        SimpleNamespace(modelIdentifier="m", needsExecutionTool=False),
        SimpleNamespace(modelIdentifier="other", needsExecutionTool=True),
    )
    description = SimpleNamespace(
        fmiVersion="2.0", guid="g", modelExchange=interface, coSimulation=other
    )
    with pytest.raises(kind, match=words):
        Instance(description, tmp_path, "ME", "replay")
    package: Any = SimpleNamespace(description=description, folder=tmp_path, path="x.fmu")
    with pytest.raises(FmuError, match=rf"FMU x\.fmu: .*on this machine.*{words}"):
        load_instance(package, "ME")


def test_a_binary_that_does_not_load_is_called_as_in_its_archive(tmp_path: Path):
    name = binary_name("2.0", "m")
    (tmp_path / name).parent.mkdir(parents=True)
    (tmp_path / name).write_bytes(b"hello")
    interface = SimpleNamespace(modelIdentifier="m", needsExecutionTool=False)
    description = SimpleNamespace(
        fmiVersion="2.0", guid="g", modelExchange=interface, coSimulation=None
    )
    with pytest.raises(Misbehaviour, match=rf"the binary cannot be loaded \(.* {name}: ") as caught:
        Instance(description, tmp_path, "ME", "replay")
    assert str(tmp_path) not in str(caught.value)


def test_a_fault_becomes_a_sentence_about_its_file():
    with (
        pytest.raises(FmuError, match=r"^FMU a/b\.fmu: .*end the simulation at t = 2 s\.$"),
        faults_of(Path("a/b.fmu")),
    ):
        raise TerminationRequested(2.0)


# What it offers


@pytest.mark.parametrize("said", ["true", "1", "false", None])
def test_an_ability_is_claimed_by_the_interface_that_says_so(said: str | None):
    given = {} if said is None else {"can": said}
    description = SimpleNamespace(modelExchange="me", coSimulation="cs")
    kinds: dict[str, dict[str, str]] = {"CoSimulation": given, "ModelExchange": {}}
    package = Package(
        path=Path("x"), digest="d", version="3.0", kinds=kinds, unpacked=0, description=description
    )
    assert package.can("CoSimulation", "can") is (said in ("true", "1"))
    assert not package.can("ModelExchange", "can")
    assert (package.is_three, package.exchange, package.cosimulation) == (True, "me", "cs")
    package = replace(package, kinds={}, version="2.0")
    assert (package.is_three, package.exchange, package.cosimulation) == (False, None, None)
