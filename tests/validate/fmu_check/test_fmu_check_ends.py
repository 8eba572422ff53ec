"""An FMU that ends the simulation itself is run again, and shorter: that is no failure.

One that never makes a step is.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from validate.fmu_check import Status, check_fmu

_FILE = "sources/fmi2.c"
_ANSWER = "fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)\n{\n"
_STEP = "    int event;\n    return said(do_step("
_NAMES = (
    "values stay finite",
    "runs repeat",
    "set state restores",
    "serialised state loads elsewhere",
    "reset equals a fresh instance",
)


def ending_at(time: float) -> tuple[tuple[str, str, str], ...]:
    """Edits: from this time on, a step is discarded and fmi2Terminated is true."""
    return (
        (
            _FILE,
            _STEP,
            f"    int event;\n    if (((Instance *)c)->model.time > {time} - 1e-9) return fmi2Discard;\n    return said(do_step(",
        ),
        (
            _FILE,
            _ANSWER,
            f"{_ANSWER}    if (c && s == fmi2Terminated) {{ *value = fmi2True; return fmi2OK; }}\n",
        ),
    )


@pytest.mark.slow
def test_an_end_in_the_middle_is_no_failure(defective: Callable[..., Path]):
    report = check_fmu(defective(ending_at(0.35)), names=_NAMES)
    rows = {row.name: row for row in report.rows if row.type == "CS"}
    assert report.ok, report.failures()
    assert {rows[name].status for name in _NAMES} == {Status.PASSED}
    assert "over 35 steps" in rows["values stay finite"].sentence


@pytest.mark.slow
def test_an_end_before_the_first_step_is_one(defective: Callable[..., Path]):
    report = check_fmu(defective(ending_at(0.0)), names=["starts and ends"])
    assert [(row.name, row.type) for row in report.failures()] == [("starts and ends", "CS")]
    assert "which leaves nothing to check" in report.failures()[0].sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    ("declared", "status"), [("", Status.FAILED), ('fixedInternalStepSize="0.1" ', Status.ADVICE)]
)
def test_a_step_below_the_one_made_inside_is_advice_where_that_is_declared(
    defective: Callable[..., Path], declared: str, status: Status
):
    edits = (
        (
            "sources/fmi3.c",
            "*lastSuccessfulTime = self->model.time;",
            "*lastSuccessfulTime = 0.1 * (int)(10.0 * self->model.time + 1e-9);",
        ),
        ("modelDescription.xml", "<CoSimulation", f"<CoSimulation {declared}"),
    )
    report = check_fmu(defective(edits, "3.0"), names=["time after a step"])
    (row,) = [row for row in report.rows if (row.name, row.type) == ("time after a step", "CS")]
    assert (row.status, report.ok) == (status, status is Status.ADVICE)
    assert "says 0 s at t = 0.01 s" in row.sentence
    assert ("0.1 s; propose a multiple" in row.sentence) == bool(declared)
