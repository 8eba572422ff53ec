"""A sound FMU that refuses values which its description does not exclude: one finding, with variable, value and the FMU's words; no other check fails by it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from shell_fmu import NO_EVENTS, PARAMETER, RATE, SKIP_SLOPE, STATE, Foreign, build_shell

from validate.fmu_check import CheckReport, FmuCheckRow, Status, check_fmu

pytestmark = pytest.mark.slow
_ACCEPTED = "values are accepted"

# A tank with an outlet, h' = q - k sqrt(h), which starts empty. Neither its level nor its inflow may
# be negative, and the outlet is 2 wide at most, as at its start: the description says nothing of it.
_TANK = Foreign(
    name="tank",
    macros="""#define NX 1
#define NZ 0
#define NR 4
#define NI 0
#define SOLVER_STEP 1e-3
#define STATE(k) ((k) + 1)
#define RATE(k) ((k) + 2)
#define WRONG(m) ((m)->r[1] < 0.0 ? 1 : (m)->r[3] < 0.0 ? 3 : (m)->r[4] > 2.0 ? 4 : 0)
#define WHY(m) (WRONG(m) == 1 ? "the level is below 0" : WRONG(m) == 3 ? "no inflow below 0" : "the outlet is 2 wide at most")
""",
    code="""
enum { H = 1, DER_H, Q, K };
static void start(Model *m) { m->r[K] = 2.0; }
static void calculate(Model *m) { m->r[DER_H] = m->r[Q] - m->r[K] * sqrt(m->r[H]); }
static int slope(const Model *m, const unsigned *u, size_t nu, const unsigned *k, size_t nk, const double *dk, double *du)
{
    double d[NR + 1] = {0};
    for (size_t i = 0; i < nk; i++) d[k[i]] += dk[i];
    d[DER_H] = d[Q] - d[K] * sqrt(m->r[H]) - (d[H] != 0.0 ? m->r[K] * d[H] / (2.0 * sqrt(m->r[H])) : 0.0);
    for (size_t i = 0; i < nu; i++) du[i] = d[u[i]];
    return 0;
}
"""
    + NO_EVENTS,
    reals=(
        ("h", STATE, 'start="0"'),
        ("der(h)", RATE, 'derivative="2"'),
        ("q", 'causality="input" variability="continuous"', 'start="0"'),
        ("k", PARAMETER, 'start="2"'),
    ),
    states=(2,),
    experiment='startTime="0" stopTime="1" stepSize="0.01" tolerance="1e-4"',
    slopes=True,
)
# The same with h' = q - k (h - 1), which starts at rest.
_EASY = replace(
    _TANK,
    name="easy",
    code="""
enum { H = 1, DER_H, Q, K };
static void start(Model *m) { m->r[H] = 1.0; m->r[K] = 2.0; }
static void calculate(Model *m) { m->r[DER_H] = m->r[Q] - m->r[K] * (m->r[H] - 1.0); }
"""
    + NO_EVENTS
    + SKIP_SLOPE,
    reals=(("h", STATE, 'start="1"'), *_TANK.reals[1:]),
    slopes=False,
)
_VALUES = ("k = 2.02 is refused", "q = -0.1 is refused")
_SET = (
    "self->m.r[vr[k]] = value[k];",
    "self->m.r[vr[k]] = value[k];\n        if (WRONG(&self->m)) return refuse(self, WHY(&self->m));",
)
_INITIALISED = (
    "    if (NZ) indicate(&self->m, self->m.z);",
    "    if (WRONG(&self->m)) return refuse(self, WHY(&self->m));",
)
_STEPPED = (
    "    const double end = now + step;",
    "    const double end = now + step;\n    if (WRONG(m)) return refuse(self, WHY(m));",
)
_DERIVED = (
    "fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { SELF;",
    "fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { SELF; if (WRONG(&self->m)) return refuse(self, WHY(&self->m));",
)
_MOVED = (
    "for (size_t k = 0; k < n; k++) self->m.r[STATE(k)] = x[k]; return fmi2OK; }",
    "for (size_t k = 0; k < n; k++) self->m.r[STATE(k)] = x[k]; return WRONG(&self->m) ? refuse(self, WHY(&self->m)) : fmi2OK; }",
)
# Once it has refused a call it refuses all but to be reset and freed, as the standard lets it.
_OFFENDED = (
    "#define SELF Instance *self = c; if (!self) return fmi2Error",
    "#define SELF Instance *self = c; if (!self || self->name[0] == '!') return fmi2Error",
)
_REMEMBERS = (
    "    self->logger(self->environment",
    "    self->name[0] = '!'; self->logger(self->environment",
)


def _found(report: CheckReport) -> list[FmuCheckRow]:
    return [row for row in report.rows if row.status in (Status.FAILED, Status.ADVICE)]


@pytest.mark.parametrize(
    "edits",
    [
        pytest.param((_SET, _MOVED), id="set"),
        pytest.param((_SET, _MOVED, _OFFENDED, _REMEMBERS), id="set, then nothing else"),
        pytest.param((_INITIALISED, _STEPPED, _DERIVED), id="later"),
        pytest.param(
            (_INITIALISED, _STEPPED, _DERIVED, _OFFENDED, _REMEMBERS), id="later, then nothing else"
        ),
    ],
)
def test_refused_values_one_finding(edits: tuple[tuple[str, str], ...], tmp_path: Path):
    report = check_fmu(build_shell(_TANK, tmp_path, *edits))
    (row,) = _found(report)
    assert row.name == _ACCEPTED
    assert row.status is Status.ADVICE, "nothing contradicts the description"
    for value in _VALUES:
        assert value in row.sentence, row.sentence
    assert "it said: no inflow below 0; declare its min (its start, 0, is accepted)" in row.sentence
    assert "it said: the outlet is 2 wide at most; declare its max" in row.sentence
    passed = {item.title for item in report.rows if item.status is Status.PASSED}
    names = (
        "runs repeat",
        "reset equals a fresh instance",
        "start values are obeyed",
        "directional derivatives",
    )
    assert passed >= {f"{name} ({kind})" for name in names for kind in ("ME", "CS")}, report.rows


def test_refused_value_within_its_declared_range_fails(tmp_path: Path):
    reals = (*_EASY.reals[:3], ("k", PARAMETER, 'start="2" max="3"'))
    model = replace(_EASY, reals=reals)
    report = check_fmu(build_shell(model, tmp_path, _SET), names=[_ACCEPTED, "runs repeat"])
    (row,) = report.failures()
    assert (row.name, row.clause) == (_ACCEPTED, "FMI 2.0.4, 2.1.7")
    assert "k = 2.02 is refused" in row.sentence
    assert "though its max is 3" in row.sentence


def test_variable_that_takes_no_value_fails_once(tmp_path: Path):
    edit = (_SET[0], f'if (vr[k] == 4) return refuse(self, "k is fixed");\n        {_SET[0]}')
    report = check_fmu(build_shell(_EASY, tmp_path, edit))
    (row,) = report.failures()
    assert "k cannot be set, not even to its start: k = 2 is refused" in row.sentence
    assert row.sentence.count("it said: k is fixed") == 1


def test_run_that_inputs_end_is_one_finding(tmp_path: Path):
    """The level may not pass 1.01, which only moving inputs reach."""
    macros = (
        _EASY.macros.replace("(m)->r[1] < 0.0", "(m)->r[1] > 1.01")
        .replace("(m)->r[3] < 0.0", "0")
        .replace("(m)->r[4] > 2.0", "0")
        .replace("the level is below 0", "the level is above 1.01")
    )
    report = check_fmu(build_shell(replace(_EASY, macros=macros), tmp_path, _STEPPED, _DERIVED))
    (row,) = _found(report)
    assert (row.name, row.status) == (_ACCEPTED, Status.ADVICE)
    assert "with inputs between q = -0.1 and q = 0.1: the run at t = " in row.sentence
    assert "it said: the level is above 1.01" in row.sentence


def test_run_that_ends_by_itself_fails_once_and_others_are_shorter(tmp_path: Path):
    end = 'if (end > 0.505) return refuse(self, "half a second is enough");'
    names = [_ACCEPTED, "values stay finite", "runs repeat", "reset equals a fresh instance"]
    fmu = build_shell(_EASY, tmp_path, (_STEPPED[0], f"{_STEPPED[0]}\n    {end}"))
    report = check_fmu(fmu, names=names)
    (row,) = report.failures()
    assert (row.name, row.type) == (_ACCEPTED, "CS")
    assert "the run at t = 0.5 s is refused" in row.sentence
    (run,) = [
        item for item in report.rows if (item.name, item.type) == ("values stay finite", "CS")
    ]
    assert "over 50 steps" in run.sentence


def test_value_that_crashes_is_named_and_avoided(tmp_path: Path):
    edit = (_SET[0], f"if (vr[k] == 4 && value[k] > 2.0) abort();\n        {_SET[0]}")
    report = check_fmu(build_shell(_EASY, tmp_path, edit))
    (row,) = report.failures()
    assert row.name == _ACCEPTED
    assert "with k = 2.02 it crashed with signal 6 (SIGABRT)" in row.sentence


def test_checks_by_themselves_avoid_refused_values(tmp_path: Path):
    """The search is made when a check meets a refusal."""
    names = ["runs repeat", "start values are obeyed", "Model Exchange equals Co-Simulation"]
    report = check_fmu(build_shell(_EASY, tmp_path, _SET, _MOVED), names=names)
    assert report.ok, report.failures()
    assert _ACCEPTED not in {row.name for row in report.rows}


def test_refusal_of_fmi3_is_one_finding(defective: Callable[..., Path]):
    """Inputs of three_cart are bounded; one more than 1 is refused, and the bounds say 15 and more."""
    old = "    if (!phases) return FAIL(self, "
    new = f'    if (kind == KIND_INPUT && value > 1.0) return FAIL(self, "%s: %s is too much: %g", function, variable->name, value);\n{old}'
    report = check_fmu(defective((("sources/access.h", old, new),), "3.0"))
    (row,) = report.failures()
    assert row.name == _ACCEPTED
    assert "u1 = " in row.sentence
    assert "is too much" in row.sentence
