"""What events and variabilities allow, and what not: sampling from t = 0 on, times that rounding moves, states that change untold, what moves between events."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from shell_fmu import FOREIGN, NO_EVENTS, PARAMETER, RATE, SKIP_SLOPE, STATE, Foreign, build_shell

from validate.fmu_check import FmuCheckRow, Status, check_fmu

_OBEYED = "start values are obeyed"
_ANNOUNCED = "event indicators announce events"
_TOLD = "events tell that they change states"
_STILL = "variables move as their variability says"
_APART = "instances do not disturb each other"
pytestmark = pytest.mark.slow
_SHELLS = {model.name: model for model in FOREIGN}
_HELD = 'causality="output" variability="discrete" initial="exact"'

# x' = 1 - held, where held is x as it was at the last of the times 0, 0.1, 0.2, ..; those are
# products, of which 3 * 0.1 is a unit in the last place after 0.3.
_SAMPLED = Foreign(
    name="sampled",
    macros="#define NX 1\n#define NZ 0\n#define NR 3\n#define NI 1\n#define SOLVER_STEP 1e-3\n#define STATE(k) ((k) + 1)\n#define RATE(k) ((k) + 2)\n",
    code="""
enum { X = 1, DER_X, HELD };
static void start(Model *m) { (void)m; }
static void calculate(Model *m) { m->r[DER_X] = 1.0 - m->r[HELD]; }
static void indicate(Model *m, double *z) { (void)m; (void)z; }
static double next_event(const Model *m) { return 0.1 * m->i[0]; }
static int update(Model *m)
{
    if (m->time < next_event(m) - 1e-12) return 0;
    m->r[HELD] = m->r[X];
    m->i[0]++;
    return 0;
}
"""
    + SKIP_SLOPE,
    reals=(
        ("x", STATE, 'start="0"'),
        ("der(x)", RATE, 'derivative="2"'),
        ("held", _HELD, 'start="0"'),
    ),
    states=(2,),
    integers='<ScalarVariable name="samples" valueReference="100" causality="local" variability="discrete" initial="exact"><Integer start="0"/></ScalarVariable>',
    experiment='startTime="0" stopTime="1" stepSize="0.02"',
)


def _rows(
    model: Foreign, folder: Path, *names: str, edit: tuple[str, str] = ("", "")
) -> dict[str, FmuCheckRow]:
    """The rows of these checks by the type of FMI; each check has its own where there are more."""
    rows = check_fmu(build_shell(model, folder, edit), names=list(names)).rows
    return {row.type if len(names) == 1 else row.title: row for row in rows if row.name in names}


def test_a_state_that_is_sampled_at_the_start_and_at_rounded_times_is_sound(tmp_path: Path):
    rows = _rows(_SAMPLED, tmp_path, _OBEYED, _ANNOUNCED, _STILL)
    assert {title: row.sentence for title, row in rows.items() if row.status is Status.FAILED} == {}
    assert [
        title for title, row in rows.items() if row.status is Status.PASSED and "ME" in title
    ] == [f"{name} (ME)" for name in (_OBEYED, _STILL, _ANNOUNCED)]


@pytest.mark.parametrize(("early", "status"), [("1e-9", Status.FAILED), ("1e-14", Status.PASSED)])
def test_a_time_event_may_come_early_by_rounding_alone(early: str, status: Status, tmp_path: Path):
    """Looked at 0.1 s and 0.3 s, so much before the times that the FMU told, it has sampled already."""
    code = _SAMPLED.code.replace(
        "return 0.1 * m->i[0];", f"return 0.1 * m->i[0] + {early};"
    ).replace("- 1e-12", f"- 2.0 * {early}")
    row = _rows(replace(_SAMPLED, code=code), tmp_path, _ANNOUNCED)["ME"]
    assert row.status is status, row.sentence


def test_co_simulation_may_sample_as_it_leaves_initialisation(tmp_path: Path):
    rows = _rows(
        _SAMPLED,
        tmp_path,
        _OBEYED,
        edit=("if (NZ) indicate(&self->m, self->m.z);", "update(&self->m);"),
    )
    assert rows["CS"].status is Status.PASSED, rows["CS"].sentence
    assert rows["ME"].status is Status.FAILED, "Model Exchange has Event Mode for that"
    assert "held was set to 0.01 before initialisation, but is 0 after it" in rows["ME"].sentence


def test_a_state_that_an_event_changes_untold_is_found(tmp_path: Path):
    """A ball that falls from 1 m meets the floor with sqrt(2 g), and leaves it with 0.7 of that."""
    ball = _SHELLS["bouncing_ball"]
    assert _rows(ball, tmp_path, _TOLD)["ME"].status is Status.PASSED
    row = _rows(
        ball,
        tmp_path,
        _TOLD,
        edit=("info->valuesOfContinuousStatesChanged = update(&self->m);", "update(&self->m);"),
    )["ME"]
    assert row.status is Status.FAILED
    told = re.search(
        r"v from (\S+) to (\S+) at t = (\S+) s, but valuesOfContinuousStatesChanged is false",
        row.sentence,
    )
    assert told, row.sentence
    speed = math.sqrt(2 * 9.81)
    assert [float(number) for number in told.groups()] == pytest.approx(
        [-speed, 0.7 * speed, speed / 9.81], rel=1e-4
    )
    assert row.clause == "FMI 2.0.4, 3.2.2"


# Where an instance leaves what every instance shows as `last`: each reads its own right after its
# step.
_LEAVES = {
    "CS": ("    m->time = end;\n", "    m->time = end;\n    shared = m->r[1];\n"),
    "ME": (
        "SELF; self->m.time = time;",
        "SELF; self->m.time = time; shared = time + self->m.r[1];",
    ),
}


@pytest.mark.parametrize("kind", ["CS", "ME"])
def test_what_another_instance_does_after_a_step_is_seen(kind: str, tmp_path: Path):
    model = replace(
        _SHELLS["dahlquist"],
        macros=_SHELLS["dahlquist"].macros.replace("NR 3", "NR 4"),
        code="static double shared;\nstatic void start(Model *m) { m->r[1] = 1.0; m->r[3] = 1.0; }\n"
        "static void calculate(Model *m) { m->r[2] = -m->r[3] * m->r[1]; m->r[4] = shared; }\n"
        + NO_EVENTS
        + SKIP_SLOPE,
        reals=(
            *_SHELLS["dahlquist"].reals,
            ("last", 'causality="local" variability="continuous"', ""),
        ),
    )
    rows = _rows(model, tmp_path, _APART, edit=_LEAVES[kind])
    assert [row.status is Status.FAILED for row in (rows["CS"], rows["ME"])] == [
        kind == "CS",
        kind == "ME",
    ], rows
    assert "after a step of another instance, last differs by" in rows[kind].sentence


def _decaying(variability: str, start: float = 1.0) -> Foreign:
    """x' = -x, and what x is beyond 0.5."""
    return Foreign(
        name="decaying",
        macros="#define NX 1\n#define NZ 0\n#define NR 4\n#define NI 0\n#define SOLVER_STEP 1e-2\n#define STATE(k) ((k) + 1)\n#define RATE(k) ((k) + 2)\n",
        code=f"static void start(Model *m) {{ m->r[1] = {start!r}; m->r[4] = 0.5; }}\n"
        "static void calculate(Model *m) { m->r[2] = -m->r[1]; m->r[3] = m->r[1] > m->r[4] ? m->r[1] - m->r[4] : 0.0; }\n"
        + NO_EVENTS
        + SKIP_SLOPE,
        reals=(
            ("x", STATE, f'start="{start!r}"'),
            ("der(x)", RATE, 'derivative="2"'),
            ("beyond", f'causality="local" variability="{variability}" initial="calculated"', ""),
            ("edge", PARAMETER, 'start="0.5"'),
        ),
        states=(2,),
        experiment='startTime="0" stopTime="1" stepSize="0.01"',
    )


@pytest.mark.parametrize("start", [1.0, 0.0])
@pytest.mark.parametrize(
    ("variability", "found"),
    [("fixed", ("CS", "ME")), ("tunable", ("CS", "ME")), ("discrete", ("ME",)), ("continuous", ())],
)
def test_what_moves_between_events_against_its_variability_is_found(
    variability: str, found: tuple[str, ...], start: float, tmp_path: Path
):
    """From 0 it does not move; from another start it does."""
    rows = _rows(_decaying(variability, start), tmp_path, _STILL)
    failed = {kind: row for kind, row in rows.items() if row.status is Status.FAILED}
    assert sorted(failed) == sorted(found), rows
    for row in failed.values():
        assert f"beyond is {variability}, but moves from 0." in row.sentence


def test_a_parameter_that_a_model_changes_by_an_event_is_no_motion(tmp_path: Path):
    """The ball at rest has no gravity: so do the Reference FMUs."""
    ball = _SHELLS["bouncing_ball"]
    rows = _rows(
        replace(ball, experiment='startTime="0" stopTime="10" stepSize="2e-2"'), tmp_path, _STILL
    )
    assert [row.status for row in rows.values()] == [Status.PASSED, Status.PASSED], rows
