"""Each seeded defect of what an FMU does to its host, keeps or forgets is found, and by the check that is there for it. Prototypes stand in the edits: C99 has no POSIX."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from shell_fmu import FOREIGN, RATE, SKIP_SLOPE, STATE, Foreign, build_shell

from validate.fmu_check import Status, check_fmu

_EQUATIONS, _EXCHANGE, _INSTANCE, _STEPPING = (
    f"sources/{name}.h" for name in ("equations", "exchange", "instance", "stepping")
)
_STEP = "    Model *m = &self->model;\n    const double wanted = *dt;\n"
_RESTORE = "    model_copy(&self->model, &saved->model);\n"
_SAVE = "    model_copy(&saved->model, &self->model);\n"
_RATES = "    model_rates(&self->model, rates);\n"
_HOST = "leaves its host as it was"
_LEAKS = "freed instances give memory back"
_RESTORES = "set state restores"
_AGREE = "Model Exchange equals Co-Simulation"


def _in_step(code: str) -> tuple[tuple[str, str, str], ...]:
    return ((_STEPPING, _STEP, f"{_STEP}    {code}\n"),)


def _kept(what: str) -> tuple[tuple[str, str, str], ...]:
    """A restored state but for one member."""
    return (
        (
            _INSTANCE,
            _RESTORE,
            f"    const Model was = self->model;\n{_RESTORE}    self->model.{what} = was.{what};\n",
        ),
    )


# (the defect, the check that must fail, words of its sentence, edits that seed it: (file, old,
# new)), and the version of FMI if not 2.0.
_DEFECTS = (
    (
        "it changes the folder",
        _HOST,
        "the working folder is /",
        _in_step('extern int chdir(const char *); chdir("/");'),
    ),
    (
        "it closes a descriptor",
        _HOST,
        "file descriptor 0 is closed",
        _in_step("extern int close(int); close(0);"),
    ),
    ("it prints", _HOST, "prints on the standard output: 'step", _in_step('printf("step\\n");')),
    (
        "it takes a signal",
        _HOST,
        "the handler of SIGFPE",
        _in_step("extern void *signal(int, void *); signal(8, (void *)1);"),
    ),
    (
        "it changes the environment",
        _HOST,
        "variable TZ",
        _in_step('extern int setenv(const char *, const char *, int); setenv("TZ", "XXX3", 1);'),
    ),
    (
        "it changes the rounding",
        _HOST,
        "rounding of numbers is upward",
        _in_step("extern int fesetround(int); fesetround(0x800);"),
    ),
    (
        "it flushes denormal numbers",
        _HOST,
        "denormal numbers is zero",
        _in_step("__builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);"),
    ),
    (
        "it traps divisions by zero",
        _HOST,
        "floating-point errors is on",
        _in_step("extern int feenableexcept(int); feenableexcept(4);"),
    ),
    (
        "it changes the mask of files",
        _HOST,
        "the mask of new files is 777",
        _in_step("extern unsigned umask(unsigned); umask(0777);"),
    ),
    (
        "it sets the alarm",
        _HOST,
        "the alarm clock is set",
        _in_step("extern unsigned alarm(unsigned); alarm(1000);"),
    ),
    (
        "it leaves a process",
        _HOST,
        "1 process behind",
        _in_step(
            "static int made; extern int fork(void), pause(void); if (!made++ && fork() == 0) for (;;) pause();"
        ),
    ),
    (
        "it leaves a process that hides",
        _HOST,
        "behind",
        _in_step(
            "static int made; extern int fork(void), pause(void), setsid(void); if (!made++ && fork() == 0) { if (fork()) exit(0); setsid(); for (;;) pause(); }"
        ),
    ),
    (
        "it leaves a thread",
        _HOST,
        "thread",
        _in_step(
            "extern int pthread_create(unsigned long *, void *, void *(*)(void *), void *), pause(void); unsigned long id; pthread_create(&id, NULL, (void *(*)(void *))pause, NULL);"
        ),
    ),
    (
        "it leaves files open",
        _HOST,
        "files open",
        _in_step('extern int open(const char *, int, ...); open("/dev/null", 0);'),
    ),
    (
        "it leaves a file",
        _HOST,
        "trace.txt' is new or changed",
        _in_step('FILE *file = fopen("trace.txt", "w"); if (file) fclose(file);'),
    ),
    (
        "a step keeps 100 bytes",
        _LEAKS,
        "bytes of allocated memory",
        _in_step("if (!malloc(100)) abort();"),
    ),
    (
        "an evaluation keeps 100 bytes",
        _LEAKS,
        "bytes of allocated memory",
        ((_EXCHANGE, _RATES, f"    if (!malloc(100)) abort();\n{_RATES}"),),
    ),
    ("a state is restored but for the time", _RESTORES, "time differs by", _kept("time")),
    (
        "a saved state goes on with its instance",
        _RESTORES,
        "differs",
        (
            (_INSTANCE, _SAVE, f"{_SAVE}    static SavedState *mine;\n    mine = saved;\n"),
            (_INSTANCE, _RESTORE, ""),
        ),
    ),
    (
        "a state is serialised with what lies around",
        "serialised state loads elsewhere",
        "different bytes",
        (
            (
                _INSTANCE,
                "    memcpy(bytes, state, sizeof(SavedState));\n",
                "    memcpy(bytes, state, sizeof(SavedState));\n    static char around;\n    ((SavedState *)bytes)->guid[sizeof MODEL_GUID - 1] = around++;\n",
            ),
        ),
    ),
    (
        "directional derivatives are a ten-thousandth too large",
        "directional derivatives",
        "finite differences give",
        (
            (
                _EQUATIONS,
                "case KIND_VELOCITY_RATE: return d->a[i];",
                "case KIND_VELOCITY_RATE: return 1.0001 * d->a[i];",
            ),
        ),
    ),
    (
        "derivatives of states are a ten-thousandth too large",
        "derivatives are those of the states",
        "der(v",
        (
            (
                _EXCHANGE,
                _RATES,
                f"{_RATES}    for (int i = 0; i < NQ; i++) rates[NQ + i] = 1.0001 * self->model.a[i];\n",
            ),
            (
                _EQUATIONS,
                "case KIND_VELOCITY_RATE: return m->a[i];",
                "case KIND_VELOCITY_RATE: return 1.0001 * m->a[i];",
            ),
        ),
    ),
    (
        "Co-Simulation hears inputs a step late",
        _AGREE,
        "more than steps and tolerances explain",
        _in_step("static double late; const double now = m->u[0]; m->u[0] = late; late = now;"),
    ),
    (
        "the time of Model Exchange stands still",
        "time after a step",
        "the variable time says",
        ((_EXCHANGE, "    self->model.time = time;\n", ""),),
    ),
    (
        "FMI 3: any token will do",
        "another FMU's token is refused",
        "which is not its own",
        ((_INSTANCE, "strcmp(token, MODEL_GUID) != 0", "0"),),
        "3.0",
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize("defect", _DEFECTS, ids=lambda defect: defect[0])
def test_defect_of_a_guest_is_found(defect: tuple, must_find):
    must_find(*defect)


# A thousand time events in ten seconds, each of which adds a hundredth to a state that otherwise
# stands still.
_TICKER = Foreign(
    name="ticker",
    macros="#define NX 1\n#define NZ 0\n#define NR 2\n#define NI 1\n#define SOLVER_STEP 1e-2\n#define MISSED -1\n#define STATE(k) ((k) + 1)\n#define RATE(k) ((k) + 2)\n",
    code="""
static void start(Model *m) { m->i[0] = 1; }
static void calculate(Model *m) { m->r[2] = 0.0; }
static void indicate(Model *m, double *z) { (void)m; (void)z; }
static double next_event(const Model *m) { return 0.01 * m->i[0]; }
static int update(Model *m)
{
    int changed = 0;
    for (; m->time >= next_event(m) - 1e-9; m->i[0]++, changed = 1)
        if (!(m->solver_steps && m->i[0] == MISSED)) m->r[1] += 0.01;
    return changed;
}
"""
    + SKIP_SLOPE,
    reals=(("x", STATE, 'start="0"'), ("der(x)", RATE, 'derivative="2"')),
    states=(2,),
    integers='<ScalarVariable name="ticks" valueReference="100" causality="local" variability="discrete" initial="exact"><Integer start="1"/></ScalarVariable>',
    experiment='startTime="0" stopTime="10" stepSize="0.02"',
)


@pytest.mark.slow
@pytest.mark.parametrize(("missed", "status"), [(-1, Status.PASSED), (617, Status.FAILED)])
def test_one_event_of_a_thousand_that_is_missed_is_found(
    missed: int, status: Status, tmp_path: Path
):
    model = replace(_TICKER, macros=_TICKER.macros.replace("MISSED -1", f"MISSED {missed}"))
    (row,) = [
        row
        for row in check_fmu(build_shell(model, tmp_path), names=[_AGREE]).rows
        if row.name == _AGREE
    ]
    assert row.status is status, row.sentence
    assert ("x differs at t = 6.1" in row.sentence) == (status is Status.FAILED), row.sentence


@pytest.mark.slow
def test_a_state_that_is_restored_but_for_one_integer_is_found(tmp_path: Path):
    """The number of steps its solver has made, which no variable shows."""
    restore = "memcpy(&self->m, state, sizeof(Model));"
    edit = (
        restore,
        f"const int kept = self->m.solver_steps; {restore} self->m.solver_steps = kept;",
    )
    model = next(model for model in FOREIGN if model.name == "van_der_pol")
    rows = check_fmu(build_shell(model, tmp_path, edit), names=[_RESTORES]).rows
    (row,) = [row for row in rows if (row.name, row.type) == (_RESTORES, "CS")]
    assert row.status is Status.FAILED, row.sentence
    assert "differs" in row.sentence


@pytest.mark.parametrize(
    ("declared", "status"),
    [('tolerance="1e-4"', Status.PASSED), ('tolerance="1e-6"', Status.FAILED)],
)
def test_states_may_be_off_by_the_declared_tolerance(declared: str, status: Status, tmp_path: Path):
    """A solver inside that is 2e-4 of each step off."""
    loop = """    while (m->start + (m->solver_steps + 1) * SOLVER_STEP < end + 1e-6 * SOLVER_STEP) {
        calculate(m);
        for (int k = 0; k < NX; k++) m->r[STATE(k)] += SOLVER_STEP * m->r[RATE(k)];
        m->time = m->start + ++m->solver_steps * SOLVER_STEP;
"""
    inexact = """    for (int once = 0; once < 1; once++) {
        calculate(m);
        for (int k = 0; k < NX; k++) m->r[STATE(k)] += 1.0002 * step * m->r[RATE(k)];
        m->time = end;
"""
    model = next(model for model in FOREIGN if model.name == "van_der_pol")
    experiment = f'startTime="0" stopTime="1" stepSize="0.001" {declared}'
    model = replace(model, experiment=experiment)
    name = "derivatives are those of the states"
    rows = check_fmu(build_shell(model, tmp_path, (loop, inexact)), names=[name]).rows
    (row,) = [row for row in rows if row.name == name]
    assert row.status is status, row.sentence


@pytest.mark.slow
def test_binary_of_a_draft_of_the_standard_is_found(tmp_path: Path):
    edit = ("return fmi2Version;", 'return "2.0-beta.1";')
    name = "starts and ends"
    rows = check_fmu(build_shell(FOREIGN[0], tmp_path, edit), names=[name]).rows
    found = [row.sentence for row in rows if row.name == name and row.status is Status.FAILED]
    assert found, rows
    assert "the binary says that it is FMI 2.0-beta.1, the description says 2.0" in found[0]
