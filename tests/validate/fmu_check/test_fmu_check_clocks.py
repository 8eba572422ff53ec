"""Clocks: three_cart made to step by the activations of a clock, with a countdown clock beside it, or with clocks that tick in its events; and defects of that."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from validate.fmu_check import FmuCheckRow, Status, check_fmu

_NAME = "clocks and their partitions"
_ACTIVATE = """    (void)clockReference;
    Instance *self = instance;
    double dt = activationTime - self->model.time;
    const Observer nobody = {NULL, NULL, NULL};
    int event;
    lock();
    const Status status = do_step(self, "fmi3ActivateModelPartition", self->model.time, &dt, &nobody, &event);
    unlock();
    if (clockReference == 901) clock_update(environment);
    return said(status);
"""
_INTERVAL = """    (void)vr, (void)nvr, (void)instance;
    intervals[0] = 0.004;
    qualifiers[0] = fmi3IntervalChanged;
    return fmi3OK;
"""
_EDITS = (
    (
        "modelDescription.xml",
        "  <CoSimulation",
        '  <ScheduledExecution modelIdentifier="three_cart"/>\n  <CoSimulation',
    ),
    (
        "modelDescription.xml",
        "  <ModelVariables>\n",
        '  <ModelVariables>\n    <Clock name="beat" valueReference="901" causality="input" intervalVariability="constant" intervalCounter="1" resolution="100" priority="1"/>\n'
        '    <Clock name="after" valueReference="902" causality="input" intervalVariability="countdown" priority="0"/>\n',
    ),
    (
        "sources/fmi3.c",
        "fmi3Instance fmi3InstantiateScheduledExecution(",
        "static fmi3ClockUpdateCallback clock_update;\nstatic fmi3LockPreemptionCallback lock;\nstatic fmi3UnlockPreemptionCallback unlock;\nstatic void *environment;\n"
        "fmi3Instance fmi3InstantiateScheduledExecution(",
    ),
    (
        "sources/fmi3.c",
        '    FAIL(&draft, "fmi3InstantiateScheduledExecution: the FMU is for Model Exchange and Co-Simulation.");\n    return NULL;\n',
        "    clock_update = clockUpdate, lock = lockPreemption, unlock = unlockPreemption, environment = instanceEnvironment;\n"
        '    return new_instance(&draft, "fmi3InstantiateScheduledExecution", instanceName, instantiationToken, "instantiation token");\n',
    ),
    (
        "sources/fmi3_absent.h",
        '    (void)clockReference, (void)activationTime;\n    return not_offered(instance, "fmi3ActivateModelPartition", NO_CLOCKS);\n',
        _ACTIVATE,
    ),
    (
        "sources/fmi3_absent.h",
        '    (void)vr, (void)nvr, (void)intervals, (void)qualifiers;\n    return not_offered(instance, "fmi3GetIntervalDecimal", NO_CLOCKS);\n',
        _INTERVAL,
    ),
)


# Ticks in Event Mode: `beat` counts itself in `sum`, every fifth makes `done` tick, each makes
# `after` tick 4 ms later; `pulse` takes `given`.
_CLOCKS = """    <Clock name="beat" valueReference="901" causality="input" intervalVariability="constant" intervalDecimal="0.01" shiftDecimal="0.005"/>
    <Clock name="pulse" valueReference="902" causality="input" intervalVariability="triggered"/>
    <Clock name="done" valueReference="903" causality="output" intervalVariability="triggered"/>
    <Clock name="after" valueReference="904" causality="input" intervalVariability="countdown"/>
    <Clock name="often" valueReference="907" causality="input" intervalVariability="fixed" supportsFraction="true"/>
    <Int32 name="sum" valueReference="905" causality="output" variability="discrete" initial="calculated" clocks="901"/>
    <Int32 name="given" valueReference="906" causality="input" variability="discrete" start="3" clocks="902"/>
"""
_INT32 = """fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, fmi3Int32 values[], size_t nValues)
{
    Instance *self = instance;
    (void)nValues;
    for (size_t i = 0; i < nvr; i++) {
        if (self->model.phase != PHASE_INITIALIZATION && !(vr[i] == 905 ? self->beat : self->pulse)) return fmi3Error;
        values[i] = vr[i] == 905 ? self->sum : self->given + 3;
    }
    return fmi3OK;
}
fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, const fmi3Int32 values[], size_t nValues)
{
    Instance *self = instance;
    (void)nValues;
    if (nvr != 1 || vr[0] != 906 || !self->pulse) return fmi3Error;
    self->given = values[0] - 3;
    return fmi3OK;
}
"""
_GET_CLOCK = """    const Instance *self = instance;
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] != 903) return fmi3Error;
        values[i] = self->done;
    }
    return fmi3OK;
"""
_SET_CLOCK = """    Instance *self = instance;
    for (size_t i = 0; i < nvr; i++) {
        if (!values[i]) return fmi3Error;
        if (vr[i] == 901) self->beat = 1, self->sum++, self->wait = 1, self->done = self->sum % 5 == 0;
        if (vr[i] == 902) self->pulse = 1;
    }
    return fmi3OK;
"""
_WAITS = """    Instance *self = instance;
    for (size_t i = 0; i < nvr; i++) {
        intervals[i] = vr[i] == 904 ? 0.004 : 0.025;
        qualifiers[i] = vr[i] == 907 || self->wait ? fmi3IntervalChanged : fmi3IntervalNotYetKnown;
        if (vr[i] == 904) self->wait = 0;
    }
    return fmi3OK;
"""
_FRACTION = "    (void)vr, (void)nvr, (void)instance;\n    counters[0] = 1, resolutions[0] = 40, qualifiers[0] = fmi3IntervalChanged;\n    return fmi3OK;\n"
_SHIFT = "    (void)vr, (void)nvr, (void)instance;\n    shifts[0] = 0.001;\n    return fmi3OK;\n"
_ENDED = "    ((Instance *)instance)->beat = ((Instance *)instance)->pulse = ((Instance *)instance)->done = 0;\n"
_ABSENT = "sources/fmi3_absent.h"
_TICKING = (
    ("modelDescription.xml", "  <ModelVariables>\n", f"  <ModelVariables>\n{_CLOCKS}"),
    (
        "modelDescription.xml",
        "  <ModelStructure>\n",
        '  <ModelStructure>\n    <Output valueReference="903"/>\n    <Output valueReference="905"/>\n',
    ),
    (
        "modelDescription.xml",
        "    <EventIndicator ",
        '    <InitialUnknown valueReference="903"/>\n    <EventIndicator ',
    ),
    (
        "sources/instance.h",
        "    int log_events;\n",
        "    int log_events;\n    int beat, pulse, done, sum, given, wait;\n",
    ),
    (_ABSENT, "NO_VARIABLES(Int32)\n", _INT32),
    (
        _ABSENT,
        '    (void)vr, (void)values;\n    return said(no_variables(instance, "fmi3GetClock", "Clock", nvr));\n',
        _GET_CLOCK,
    ),
    (
        _ABSENT,
        '    (void)vr, (void)values;\n    return said(no_variables(instance, "fmi3SetClock", "Clock", nvr));\n',
        _SET_CLOCK,
    ),
    (
        _ABSENT,
        '    (void)vr, (void)nvr, (void)intervals, (void)qualifiers;\n    return not_offered(instance, "fmi3GetIntervalDecimal", NO_CLOCKS);\n',
        _WAITS,
    ),
    (
        _ABSENT,
        '    (void)vr, (void)nvr, (void)counters, (void)resolutions, (void)qualifiers;\n    return not_offered(instance, "fmi3GetIntervalFraction", NO_CLOCKS);\n',
        _FRACTION,
    ),
    (
        _ABSENT,
        '    (void)vr, (void)nvr, (void)shifts;\n    return not_offered(instance, "fmi3GetShiftDecimal", NO_CLOCKS);\n',
        _SHIFT,
    ),
    (
        "sources/fmi3.c",
        '    *nextEventTime = 0.0;\n    return said(update_discrete_states(self, "fmi3UpdateDiscreteStates"));\n',
        f'    *nextEventTime = 0.0;\n{_ENDED}    return said(update_discrete_states(self, "fmi3UpdateDiscreteStates"));\n',
    ),
)


@pytest.mark.slow
def test_clocks_tick_in_events_and_what_is_clocked_is_read_then_only(
    defective: Callable[..., Path],
):
    """Twenty beats from 5 ms on until 0.2 s, the countdown 4 ms after each, a fixed clock at 1, 26, .. 176 ms, pulses every 20 ms; no other check minds the clocks."""
    report = check_fmu(defective(_TICKING, "3.0"))
    assert not report.failures(), [(row.title, row.sentence) for row in report.failures()]
    found = [row for row in report.rows if row.name == "clocks tick in Event Mode"]
    assert [row.type for row in found] == ["ME", "CS"]
    for row in found:
        assert row.status is Status.PASSED, row.sentence
        for words in (
            "beat 20 times",
            "pulse 10 times",
            "done 4 times",
            "after 20 times",
            "often 8 times",
        ):
            assert words in row.sentence, row.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "old", "new"),
    [
        (
            "done is still active after fmi3UpdateDiscreteStates at t = 0.045 s",
            "->done = 0;",
            "->pulse;",
        ),
        (
            "beat ticks at t = 0.015 s its variables cannot be read",
            "        if (self->model.phase != PHASE_INIT",
            "        if (self->sum == 2) return fmi3Error;\n        if (self->model.phase != PHASE_INIT",
        ),
        (
            "beat cannot be activated at t = 0.025 s",
            "        if (!values[i]) return",
            "        if (self->sum == 2 && vr[i] == 901) return",
        ),
        (
            "interval of often is told as 0.025 s, and as the fraction 1/50",
            "resolutions[0] = 40",
            "resolutions[0] = 50",
        ),
        ("interval of often is not yet known", "vr[i] == 907 || self->wait", "self->wait"),
        ("shift of often is told as -0.001 s", "0.001", "-0.001"),
        ("a second run", "self->sum++", "self->sum += turns++"),
    ],
)
def test_a_defect_of_ticks_is_found_in_either_interface(
    words: str, old: str, new: str, defective: Callable[..., Path]
):
    edits = [
        (
            name,
            before,
            after.replace(old, new).replace(
                _SET_CLOCK[:28], f"    static int turns;\n    (void)turns;\n{_SET_CLOCK[:28]}"
            ),
        )
        for name, before, after in _TICKING
    ]
    assert any(old in after for _, _, after in _TICKING)
    found = [
        row
        for row in check_fmu(defective(edits, "3.0"), names=["clocks tick in Event Mode"]).rows
        if row.name == "clocks tick in Event Mode"
    ]
    assert [(row.status, words in row.sentence) for row in found] == [(Status.FAILED, True)] * 2, [
        row.sentence for row in found
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"), [('resolution="100"', 'resolution="0"'), ('priority="1"', 'priority="first"')]
)
def test_a_clock_whose_numbers_are_none_is_told(old: str, new: str, must_find: Callable[..., None]):
    edits = [(name, before, after.replace(old, new)) for name, before, after in _EDITS]
    must_find(new, _NAME, "of a clock is no number", edits, "3.0")


def _row(fmu: Path) -> FmuCheckRow:
    report = check_fmu(fmu, names=[_NAME])
    assert report.types == ("ME", "CS", "SE")
    (row,) = [row for row in report.rows if row.name == _NAME]
    return row


@pytest.mark.slow
def test_clocks_tick_and_countdowns_follow(defective: Callable[..., Path]):
    """Twenty beats 10 ms apart, each of which sets the countdown to 4 ms."""
    row = _row(defective(_EDITS, "3.0"))
    assert row.status is Status.PASSED, row.sentence
    for words in ("beat 20 times", "after 20 times", "20 updates of clocks"):
        assert words in row.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "old", "new"),
    [
        ("1 locks of preemption are not given back", "    unlock();\n", ""),
        ("the partition of beat cannot be activated at t = 0.01 s", "    lock();\n",
         "    if (clockReference == 901 && activationTime > 0.0) return fmi3Error;\n    lock();\n"),
        ("the interval of after has the qualifier 7", "fmi3IntervalChanged", "7"),
        ("the interval of after is told as -1 s", "0.004", "-1.0"),
        ("a second run", "    lock();\n",
         "    static int turns;\n    self->model.v[0] += 1e-9 * turns++;\n    lock();\n"),
    ],
)  # fmt: skip
def test_a_defect_of_clocks_is_found(
    words: str, old: str, new: str, must_find: Callable[..., None]
):
    edits = [
        (name, before, after.replace(old, new) if after in (_ACTIVATE, _INTERVAL) else after)
        for name, before, after in _EDITS
    ]
    assert any(old in after for _, _, after in _EDITS)
    must_find(words, _NAME, words, edits, "3.0")
