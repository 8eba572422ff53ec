"""Scheduled Execution: three_cart made to step by the activations of a clock, with a countdown clock beside it; and defects of that."""

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
    ("modelDescription.xml", "  <CoSimulation", '  <ScheduledExecution modelIdentifier="three_cart"/>\n  <CoSimulation'),
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
    ("sources/fmi3_absent.h", '    (void)clockReference, (void)activationTime;\n    return not_offered(instance, "fmi3ActivateModelPartition", NO_CLOCKS);\n', _ACTIVATE),
    (
        "sources/fmi3_absent.h",
        '    (void)vr, (void)nvr, (void)intervals, (void)qualifiers;\n    return not_offered(instance, "fmi3GetIntervalDecimal", NO_CLOCKS);\n',
        _INTERVAL,
    ),
)  # fmt: skip


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
        ("the partition of beat cannot be activated at t = 0.01 s", "    lock();\n", "    if (clockReference == 901 && activationTime > 0.0) return fmi3Error;\n    lock();\n"),
        ("the interval of after has the qualifier 7", "fmi3IntervalChanged", "7"),
        ("the interval of after is told as -1 s", "0.004", "-1.0"),
        ("a second run", "    lock();\n", "    static int turns;\n    self->model.v[0] += 1e-9 * turns++;\n    lock();\n"),
    ],
)  # fmt: skip
def test_a_defect_of_clocks_is_found(words: str, old: str, new: str, defective: Callable[..., Path]):
    edits = [(name, before, after.replace(old, new) if after in (_ACTIVATE, _INTERVAL) else after) for name, before, after in _EDITS]
    assert any(old in after for _, _, after in _EDITS)
    row = _row(defective(edits, "3.0"))
    assert row.status is Status.FAILED
    assert words in row.sentence, row.sentence
