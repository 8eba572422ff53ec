"""Model Exchange against Co-Simulation about events: a jump may come as much sooner or later as the state's error over its slope, and nothing else may be off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from shell_fmu import RATE, SKIP_SLOPE, STATE, Foreign, build_shell

from validate.fmu_check import FmuCheckRow, Status, check_fmu

pytestmark = pytest.mark.slow
_AGREE = "Model Exchange equals Co-Simulation"
_LOCAL = 'causality="local" variability="continuous" initial="calculated"'

# A tank that cools, T' = -T, whose heater's light goes on where T falls below EDGE; and a reading of
# T in other units. EDGE is passed 2e-6 s after the communication point 0.3.
_COOLING = Foreign(
    name="cooling",
    macros="#define NX 1\n#define NZ 1\n#define NR 4\n#define NI 1\n#define SOLVER_STEP 1e-2\n#define STATE(k) ((k) + 1)\n#define RATE(k) ((k) + 2)\n"
    "#define EDGE (exp(-0.300002))\n",
    code="""
enum { T = 1, DER_T, LIGHT, READING };
static void start(Model *m) { m->r[T] = 1.0; }
static void calculate(Model *m)
{
    m->r[DER_T] = -m->r[T];
    m->r[LIGHT] = m->i[0] ? 5.0 : 0.0;
    m->r[READING] = 2.0 + 0.1 * m->r[T];
}
static void indicate(Model *m, double *z) { z[0] = m->r[T] - EDGE; }
static int update(Model *m) { m->i[0] = m->r[T] <= EDGE; return 0; }
static double next_event(const Model *m) { (void)m; return HUGE_VAL; }
"""
    + SKIP_SLOPE,
    reals=(
        ("T", STATE, 'start="1"'),
        ("der(T)", RATE, 'derivative="2"'),
        ("light", _LOCAL, ""),
        ("reading", _LOCAL, ""),
    ),
    states=(2,),
    integers='<ScalarVariable name="on" valueReference="100" causality="local" variability="discrete" initial="exact"><Integer start="0"/></ScalarVariable>',
    experiment='startTime="0" stopTime="1" stepSize="0.01" tolerance="1e-4"',
    indicators=1,
)
_LOOP = """    while (m->start + (m->solver_steps + 1) * SOLVER_STEP < end + 1e-6 * SOLVER_STEP) {
        calculate(m);
        for (int k = 0; k < NX; k++) m->r[STATE(k)] += SOLVER_STEP * m->r[RATE(k)];
        m->time = m->start + ++m->solver_steps * SOLVER_STEP;
        update(m);
    }
"""


def _row(model: Foreign, folder: Path, motion: str) -> FmuCheckRow:
    """motion: of Co-Simulation, in C, until `end`."""
    fmu = build_shell(model, folder, (_LOOP, f"{{ {motion} }}\n"))
    (row,) = [row for row in check_fmu(fmu, names=[_AGREE]).rows if row.name == _AGREE]
    return row


def test_jump_within_the_error_of_its_time_is_no_difference(tmp_path: Path):
    """1e-5 too cold, which the tolerance allows, it has passed the edge at 0.3 s already."""
    row = _row(_COOLING, tmp_path, "m->r[T] = (1.0 - 1e-5) * exp(-end); update(m);")
    assert row.status is Status.PASSED, row.sentence
    assert "but for 1 that jump within the error of an event's time" in row.sentence


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        pytest.param(
            "m->r[T] = exp(-end); if (end > 0.325) update(m);",
            "light differs at t = 0.32 s: 0 by Co-Simulation, 5 by Model Exchange",
            id="an event that comes late",
        ),
        pytest.param(
            "m->r[T] = exp(-end) * (end > 0.605 && end < 0.615 ? 1.02 : 1.0); update(m);",
            "T differs at t = 0.61 s",
            id="a state away from events",
        ),
        pytest.param(
            "m->r[T] = exp(-end) * (end > 0.295 && end < 0.305 ? 0.98 : 1.0); update(m);",
            "T differs at t = 0.3 s",
            id="a state that does not jump, at the event",
        ),
        pytest.param(
            "m->r[T] = exp(-end);",
            "light differs at t = 0.32 s",
            id="an event that is missed",
        ),
    ],
)
def test_difference_about_an_event_is_found(motion: str, words: str, tmp_path: Path):
    row = _row(_COOLING, tmp_path, motion)
    assert row.status is Status.FAILED, row.sentence
    assert words in row.sentence


# A mass that flies at 1 m/s, and at the wall at 0.502 m turns back, three times as fast.
_BOUNCING = replace(
    _COOLING,
    name="bouncing",
    macros="#define NX 2\n#define NZ 1\n#define NR 4\n#define NI 1\n#define SOLVER_STEP 1e-2\n#define STATE(k) (1 + 2 * (k))\n#define RATE(k) (2 + 2 * (k))\n",
    code="""
enum { X = 1, DER_X, V, DER_V };
static void start(Model *m) { m->r[V] = 1.0; }
static void calculate(Model *m) { m->r[DER_X] = m->r[V]; m->r[DER_V] = 0.0; }
static void indicate(Model *m, double *z) { z[0] = m->r[X] - 0.502; }
static int update(Model *m)
{
    if (!(m->r[X] >= 0.502 && m->r[V] > 0.0)) return 0;
    m->r[V] *= -3.0;
    return 1;
}
static double next_event(const Model *m) { (void)m; return HUGE_VAL; }
"""
    + SKIP_SLOPE,
    reals=(
        ("x", STATE, 'start="0"'),
        ("der(x)", RATE, 'derivative="2"'),
        ("v", STATE, 'start="1"'),
        ("der(v)", RATE, 'derivative="4"'),
    ),
    states=(2, 4),
)


@pytest.mark.parametrize(("late", "status"), [(8e-5, Status.PASSED), (2e-3, Status.FAILED)])
def test_motion_after_an_event_may_be_as_late_as_the_event(
    late: float, status: Status, tmp_path: Path
):
    """So much behind when it meets the wall, it is behind by three times that on its way back."""
    motion = f"const double s = end - {late} * (end > 0.4); m->r[V] = s < 0.502 ? 1.0 : -3.0; m->r[X] = s < 0.502 ? s : 2.008 - 3.0 * s;"
    row = _row(_BOUNCING, tmp_path, motion)
    assert row.status is status, row.sentence


def test_events_without_states_are_compared(tmp_path: Path):
    """Only the time crosses: there is no error that could move it."""
    code = (
        _COOLING.code.replace("m->r[T] - EDGE", "m->time - 0.300002")
        .replace("m->r[T] <= EDGE", "m->time >= 0.300002")
        .replace("m->r[DER_T] = -m->r[T];", "")
        .replace("0.1 * m->r[T]", "0.1 * m->time")
        .replace("m->r[T] = 1.0;", "(void)m;")
    )
    model = replace(
        _COOLING,
        name="timed",
        macros=_COOLING.macros.replace("NX 1", "NX 0"),
        code=code,
        reals=(("T", _LOCAL, ""), ("rate", _LOCAL, ""), *_COOLING.reals[2:]),
        states=(),
    )
    row = _row(model, tmp_path, "m->time = end; if (end > 0.295) m->i[0] = 1;")
    assert row.status is Status.FAILED, row.sentence
    assert "light differs at t = 0.3 s" in row.sentence


@pytest.mark.parametrize(("rate", "status"), [(1.0, Status.PASSED), (1.02, Status.FAILED)])
def test_error_that_shrinks_with_the_step_is_explained(rate: float, status: Status, tmp_path: Path):
    """Explicit Euler with the communication step is 0.1 to 0.5 % off, a rate of 1.02 is 2 % off."""
    row = _row(_COOLING, tmp_path, f"m->r[T] *= 1.0 - {rate} * step; update(m);")
    assert row.status is status, row.sentence
    assert "with h/5" in row.sentence


def test_steps_that_an_fmu_refuses_are_left_out(tmp_path: Path):
    """It takes multiples of 5 ms alone: h and h/2, but neither h/3 nor h/5, nor a very short step."""
    refusal = """const double end = now + step;
    if (fabs(step / 5e-3 - floor(step / 5e-3 + 0.5)) > 1e-6) return refuse(self, "multiples of 5 ms only");
"""
    exact = (_LOOP, "{ m->r[T] = exp(-end); update(m); }\n")
    fmu = build_shell(_COOLING, tmp_path, exact, ("const double end = now + step;", refusal))
    rows = {row.title: row for row in check_fmu(fmu).rows}
    assert rows[_AGREE].status is Status.PASSED, rows[_AGREE].sentence
    assert "with h/2 of the value's size" in rows[_AGREE].sentence
    rates = rows["derivatives are those of the states (CS)"]
    assert rates.status is Status.NOT_OFFERED, rates.sentence
    assert "it said: multiples of 5 ms only" in rates.sentence
    assert "multiples of 5 ms only" not in "".join(
        row.sentence for row in rows.values() if row.status is Status.FAILED
    )
