"""Each seeded defect of instances, saved states, values and time is found, and by the check that is there for it."""

import pytest

_EQUATIONS = "sources/equations.h"
_INSTANCE = "sources/instance.h"
_MODEL = "sources/model.h"
_STEPPING = "sources/stepping.h"
_RESTORE = "    model_copy(&self->model, &saved->model);\n"
_SERIALIZE = "    memcpy(bytes, state, sizeof(SavedState));\n"
_STEP = "    Model *m = &self->model;\n    const double wanted = *dt;\n"

# (the defect, the check that must fail, words of its sentence, edits that seed it: (file, old, new)), and the version of FMI if not 2.0.
_DEFECTS = (
    ("set state does nothing", "set state restores", "differs", ((_INSTANCE, _RESTORE, ""),)),
    ("set state keeps the velocities", "set state restores", "differs",
     ((_INSTANCE, _RESTORE, f"    double kept[NQ];\n    memcpy(kept, self->model.v, sizeof kept);\n{_RESTORE}    memcpy(self->model.v, kept, sizeof kept);\n"),)),
    ("serialising forgets a parameter", "serialised state loads elsewhere", "in a new process",
     ((_INSTANCE, _SERIALIZE, f"{_SERIALIZE}    ((SavedState *)bytes)->model.p[1] = 2.0;\n"),)),
    ("serialising forgets the inputs", "serialised state loads elsewhere", "serialised state, input_power differs", ((_INSTANCE, _SERIALIZE, f"{_SERIALIZE}    ((SavedState *)bytes)->model.u[0] = 0.0;\n"),)),
    ("a serialised state is an address", "serialised state loads elsewhere", "in a new process",
     ((_INSTANCE, _SERIALIZE,
       f"{_SERIALIZE}    void *copy = malloc(sizeof(Model));\n    memcpy(copy, &((const SavedState *)state)->model, sizeof(Model));\n"
                "    memcpy(&((SavedState *)bytes)->model, &copy, sizeof copy);\n"),
      (_INSTANCE, "    memcpy(*state, bytes, sizeof(SavedState));\n",
       "    memcpy(*state, bytes, sizeof(SavedState));\n    void *copy;\n"
                "    memcpy(&copy, &((const SavedState *)bytes)->model, sizeof copy);\n    memcpy(&((SavedState *)*state)->model, copy, sizeof(Model));\n"))),
    ("the last successful time is a step ahead", "stop time is respected", "the last successful time is told as 0.05 s; it is 0.04 s",
     (("sources/fmi2.c", "*value = self->model.time;", "*value = self->model.time + 0.01;"),
      ("sources/fmi2.c", "    int event;\n    return said(do_step(",
       "    int event;\n    const Model *m = &((Instance *)c)->model;\n"
                "    if (m->stop_defined && m->time > m->stop_time - 1e-9) return fmi2Discard;\n    return said(do_step("))),
    ("the time variable stands still", "time after a step", "the variable time says", ((_EQUATIONS, "case KIND_TIME: return m->time;", "case KIND_TIME: return m->start_time;"),)),
    ("an output becomes NaN", "values stay finite", "kinetic_energy is nan",
     ((_EQUATIONS, "case KIND_KINETIC_ENERGY: return ", "case KIND_KINETIC_ENERGY: if (m->time > 3.0) return NAN; return "),)),
    ("a parameter is not taken", "start values are obeyed", "c was set to 2.02",
     ((_EQUATIONS, "case KIND_PARAMETER: m->p[variable->index] = value; break;", "case KIND_PARAMETER: if (variable->index != 1) m->p[variable->index] = value; break;"),)),
    ("an initial state is not taken", "start values are obeyed", "q2 was set to 3.03",
     ((_EQUATIONS, "case KIND_POSITION: m->q[variable->index] = value; break;", "case KIND_POSITION: if (variable->index != 1) m->q[variable->index] = value; break;"),)),
    ("a parameter is set back when initialisation ends", "start values are obeyed", "after it",
     ((_EQUATIONS, "    if (m->evaluated) return 0;\n", "    if (m->phase > 2) m->p[1] = 2.0;\n    if (m->evaluated) return 0;\n"),)),
    ("reset forgets a parameter", "reset equals a fresh instance", "after reset",
     ((_INSTANCE, "    model_start(&self->model);\n    return change_phase",
       "    const double kept = self->model.p[1];\n    model_start(&self->model);\n    self->model.p[1] = kept;\n    return change_phase"),)),
    ("instances share a value", "instances do not disturb each other", "beside another instance",
     ((_STEPPING, _STEP,
       f"{_STEP}    static double cached_at = -1.0, cached;\n    if (m->time != cached_at) {{\n        cached_at = m->time;\n        cached = m->u[0];\n    }}\n    m->u[0] = cached;\n"),)),
    ("an instance is not freed", "freed instances give memory back", "bytes of allocated memory", ((_INSTANCE, "    free(self->name);\n", ""),)),
    ("a saved state is not freed", "freed instances give memory back", "bytes of allocated memory", ((_INSTANCE, "        free(*state);\n", ""),)),
    ("reading has a side effect", "order of reading does not matter", "differs",
     ((_EQUATIONS, "case KIND_FORCE: return m->lam[i];", "case KIND_FORCE: ((Model *)m)->v[0] += 1e-9; return m->lam[i];"),)),
    ("a run depends on the runs before", "runs repeat", "in a second run",
     ((_MODEL, "    memset(m, 0, sizeof *m);\n", "    memset(m, 0, sizeof *m);\n    static int starts;\n    m->u_rate[0] = 1e-3 * starts++;\n"),)),
    ("the stop time is ignored", "stop time is respected", "is answered with OK", ((_STEPPING, "if (m->stop_defined && ", "if (0 && "),)),
    ("a step crashes", "starts and ends", "SIGABRT", ((_STEPPING, _STEP, f"{_STEP}    abort();\n"),)),
    ("a step ends the process with success", "starts and ends", "exit code 0", ((_STEPPING, _STEP, f"{_STEP}    exit(0);\n"),)),
    ("a step hangs after a while", "runs repeat", "it hung", ((_STEPPING, _STEP, f"{_STEP}    for (volatile int n = 1; n && m->time > 0.5;) n = 1;\n"),)),
    ("FMI 3: set state does nothing", "set state restores", "differs", ((_INSTANCE, _RESTORE, ""),), "3.0"),
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("defect", _DEFECTS, ids=lambda defect: defect[0])
def test_defect_is_found(defect: tuple, must_find):
    must_find(*defect)
