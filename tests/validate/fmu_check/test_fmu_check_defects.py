"""Each seeded defect of equations, derivatives, events, binary, description, instances, saved states, values, time and Co-Simulation's steps is found, by the check that is there for it."""

import pytest

_XML = "modelDescription.xml"
_EQUATIONS = "sources/equations.h"
_EXCHANGE = "sources/exchange.h"
_INTEGRATOR = "sources/integrator.h"
_INSTANCE = "sources/instance.h"
_MODEL = "sources/model.h"
_STEPPING = "sources/stepping.h"
_RESTORE = "    model_copy(&self->model, &saved->model);\n"
_SERIALIZE = "    memcpy(bytes, state, sizeof(SavedState));\n"
_STEP = "    Model *m = &self->model;\n    const double wanted = *dt;\n"
_FMI3 = "sources/fmi3.c"
_UPDATE = '    return said(update_discrete_states(self, "fmi3UpdateDiscreteStates"));'
_EVENT = "event mode of Co-Simulation"
_EARLY = "early return"
_BETWEEN = "intermediate update"
_SLOPES = "input derivatives"
_TOLD = "    *lastSuccessfulTime = self->model.time;"
_FINISHED = "self->environment, step->begin + offset, fmi3False, fmi3True, fmi3True, self->early_return_allowed != 0, &early, &when);"

# (the defect, the check that must fail, words of its sentence, edits that seed it: (file, old,
# new)), and the version of FMI if not 2.0.
_DEFECTS = (
    (
        "derivatives of accelerations have the wrong sign",
        "directional derivatives",
        "finite differences give",
        (
            (
                _EQUATIONS,
                "case KIND_VELOCITY_RATE: return d->a[i];",
                "case KIND_VELOCITY_RATE: return -d->a[i];",
            ),
        ),
    ),
    (
        "one entry is a little more than a thousandth too large, in contact only",
        "directional derivatives",
        "d lam_left",
        (
            (
                _EQUATIONS,
                "case KIND_FORCE: return d->lam[i];",
                "case KIND_FORCE: return i ? d->lam[i] : 1.0012 * d->lam[i];",
            ),
        ),
    ),
    (
        "derivatives of accelerations are a little more than a thousandth too large",
        "directional derivatives",
        "finite differences give",
        (
            (
                _EQUATIONS,
                "case KIND_VELOCITY_RATE: return d->a[i];",
                "case KIND_VELOCITY_RATE: return 1.0012 * d->a[i];",
            ),
        ),
    ),
    (
        "the column of the inputs is zero",
        "directional derivatives",
        "/ d u1",
        (
            (
                _EQUATIONS,
                "if (scene_acceleration_jvp(m->q, m->v, m->u, m->lam, m->p, d->q, d->v, d->u,",
                "double zero[ROOM(NU)] = {0};\n    if (scene_acceleration_jvp(m->q, m->v, m->u, m->lam, m->p, d->q, d->v, zero,",
            ),
        ),
    ),
    (
        "Co-Simulation has another gain by a thousandth",
        "Model Exchange equals Co-Simulation",
        "more than steps and tolerances explain",
        ((_INTEGRATOR, "u[i] = inputs->value[i]", "u[i] = 1.001 * inputs->value[i]"),),
    ),
    (
        "a start value is another one in the XML by a ten-thousandth",
        "start values are the XML's",
        "c is 2 in the binary, 2.0002",
        ((_XML, 'unit="N s/m" start="2.0"', 'unit="N s/m" start="2.0002"'),),
    ),
    (
        "a nominal is another one in the XML by a ten-thousandth",
        "nominals are the XML's",
        "state 0 has the nominal 1",
        ((_XML, 'start="2.0" nominal="1.0"', 'start="2.0" nominal="1.0001"'),),
    ),
    (
        "FMI 3: an adjoint is a ten-thousandth too large",
        "adjoint derivatives",
        "the adjoint of",
        (
            (
                _EQUATIONS,
                "case KIND_GAP: bar->phi[i] -= weight; break;",
                "case KIND_GAP: bar->phi[i] -= 1.0001 * weight; break;",
            ),
        ),
        "3.0",
    ),
    (
        "FMI 3: an indicator is not its variable by a ten-thousandth",
        "event indicators announce events",
        "event indicator 0",
        ((_EQUATIONS, "indicators[i] = -m->phi[i];", "indicators[i] = -1.0001 * m->phi[i];"),),
        "3.0",
    ),
    (
        "a function is not exported",
        "exported functions",
        "fmi2GetDirectionalDerivative",
        (
            (
                "sources/fmi2.c",
                "fmi2Status fmi2GetDirectionalDerivative(",
                "fmi2Status unknown_name(",
            ),
        ),
    ),
    (
        "an output depends on more than it says",
        "dependencies are complete",
        "input_power changes with v3",
        (
            (_XML, 'dependencies="5 7 14 15"', 'dependencies="5 14 15"'),
            (
                _XML,
                'dependenciesKind="dependent dependent dependent dependent"/>',
                'dependenciesKind="dependent dependent dependent"/>',
            ),
        ),
    ),
    (
        "a factor is not constant",
        "dependencies are complete",
        "constant factor",
        (
            (
                _XML,
                '<Unknown index="16" dependencies="2 3" dependenciesKind="dependent dependent"',
                '<Unknown index="16" dependencies="2 3" dependenciesKind="constant constant"',
            ),
        ),
    ),
    (
        "an acceleration has the unit of a velocity",
        "variables are consistent",
        "der(v1) has the unit m/s",
        ((_XML, 'unit="m/s^2" derivative="5"', 'unit="m/s" derivative="5"'),),
    ),
    (
        "an acceleration is in other units of length than its velocity",
        "variables are consistent",
        "their factors are 0.001 and 1",
        (
            (
                _XML,
                '<Unit name="m/s^2">\n      <BaseUnit m="1" s="-2"',
                '<Unit name="m/s^2">\n      <BaseUnit factor="0.001" m="1" s="-2"',
            ),
        ),
    ),
    (
        "a unit is not defined",
        "description is valid",
        "furlong",
        ((_XML, 'unit="m" start="2.0"', 'unit="furlong" start="2.0"'),),
    ),
    (
        "a start lies outside its range",
        "variables are consistent",
        "k starts at -3",
        ((_XML, 'unit="N/m" start="30.0"', 'unit="N/m" start="-3"'),),
    ),
    (
        "a value reference does not exist",
        "variables can be read",
        "value reference 220",
        (
            (
                _XML,
                'name="dissipated_power" valueReference="22"',
                'name="dissipated_power" valueReference="220"',
            ),
        ),
    ),
    (
        "two derivatives are swapped in the array",
        "states and derivatives are the listed ones",
        "derivative",
        (
            (
                _EXCHANGE,
                "    model_rates(&self->model, rates);\n",
                "    model_rates(&self->model, rates);\n    rates[0] = self->model.v[1];\n    rates[1] = self->model.v[0];\n",
            ),
        ),
    ),
    (
        "two derivatives are swapped in the XML",
        "states and derivatives are the listed ones",
        "state",
        (
            (_XML, 'derivative="2"', 'derivative="0"'),
            (_XML, 'derivative="3"', 'derivative="2"'),
            (_XML, 'derivative="0"', 'derivative="3"'),
        ),
    ),
    (
        "an event indicator never changes its sign",
        "event indicators announce events",
        "missing or wrong",
        ((_EQUATIONS, "indicators[i] = -m->phi[i];", "indicators[i] = fabs(m->phi[i]) + 1e-3;"),),
    ),
    (
        "event indicators are missing",
        "event indicators announce events",
        "missing or wrong",
        ((_XML, 'numberOfEventIndicators="2"', 'numberOfEventIndicators="0"'),),
    ),
    (
        "an event indicator is a sign",
        "event indicators announce events",
        "jumps over zero",
        (
            (
                _EQUATIONS,
                "indicators[i] = -m->phi[i];",
                "indicators[i] = m->phi[i] > 0.0 ? -1.0 : 1.0;",
            ),
        ),
    ),
    # Instances, saved states, values and time.
    ("set state does nothing", "set state restores", "differs", ((_INSTANCE, _RESTORE, ""),)),
    (
        "set state keeps the velocities",
        "set state restores",
        "differs",
        (
            (
                _INSTANCE,
                _RESTORE,
                f"    double kept[NQ];\n    memcpy(kept, self->model.v, sizeof kept);\n{_RESTORE}    memcpy(self->model.v, kept, sizeof kept);\n",
            ),
        ),
    ),
    (
        "serialising forgets a parameter",
        "serialised state loads elsewhere",
        "in a new process",
        ((_INSTANCE, _SERIALIZE, f"{_SERIALIZE}    ((SavedState *)bytes)->model.p[1] = 2.0;\n"),),
    ),
    (
        "serialising forgets the inputs",
        "serialised state loads elsewhere",
        "serialised state, input_power differs",
        ((_INSTANCE, _SERIALIZE, f"{_SERIALIZE}    ((SavedState *)bytes)->model.u[0] = 0.0;\n"),),
    ),
    (
        "a serialised state is an address",
        "serialised state loads elsewhere",
        "in a new process",
        (
            (
                _INSTANCE,
                _SERIALIZE,
                f"{_SERIALIZE}    void *copy = malloc(sizeof(Model));\n    memcpy(copy, &((const SavedState *)state)->model, sizeof(Model));\n"
                "    memcpy(&((SavedState *)bytes)->model, &copy, sizeof copy);\n",
            ),
            (
                _INSTANCE,
                "    memcpy(*state, bytes, sizeof(SavedState));\n",
                "    memcpy(*state, bytes, sizeof(SavedState));\n    void *copy;\n"
                "    memcpy(&copy, &((const SavedState *)bytes)->model, sizeof copy);\n    memcpy(&((SavedState *)*state)->model, copy, sizeof(Model));\n",
            ),
        ),
    ),
    (
        "the last successful time is a step ahead",
        "stop time is respected",
        "the last successful time is told as 0.05 s; it is 0.04 s",
        (
            ("sources/fmi2.c", "*value = self->model.time;", "*value = self->model.time + 0.01;"),
            (
                "sources/fmi2.c",
                "    int event;\n    return said(do_step(",
                "    int event;\n    const Model *m = &((Instance *)c)->model;\n"
                "    if (m->stop_defined && m->time > m->stop_time - 1e-9) return fmi2Discard;\n    return said(do_step(",
            ),
        ),
    ),
    (
        "the time variable stands still",
        "time after a step",
        "the variable time says",
        ((_EQUATIONS, "case KIND_TIME: return m->time;", "case KIND_TIME: return m->start_time;"),),
    ),
    (
        "an output becomes NaN",
        "values stay finite",
        "kinetic_energy is nan",
        (
            (
                _EQUATIONS,
                "case KIND_KINETIC_ENERGY: return ",
                "case KIND_KINETIC_ENERGY: if (m->time > 3.0) return NAN; return ",
            ),
        ),
    ),
    (
        "a parameter is not taken",
        "start values are obeyed",
        "c was set to 2.02",
        (
            (
                _EQUATIONS,
                "case KIND_PARAMETER: m->p[variable->index] = value; break;",
                "case KIND_PARAMETER: if (variable->index != 1) m->p[variable->index] = value; break;",
            ),
        ),
    ),
    (
        "an initial state is not taken",
        "start values are obeyed",
        "q2 was set to 3.03",
        (
            (
                _EQUATIONS,
                "case KIND_POSITION: m->q[variable->index] = value; break;",
                "case KIND_POSITION: if (variable->index != 1) m->q[variable->index] = value; break;",
            ),
        ),
    ),
    (
        "a parameter is set back when initialisation ends",
        "start values are obeyed",
        "after it",
        (
            (
                _EQUATIONS,
                "    if (m->evaluated) return 0;\n",
                "    if (m->phase > 2) m->p[1] = 2.0;\n    if (m->evaluated) return 0;\n",
            ),
        ),
    ),
    (
        "reset forgets a parameter",
        "reset equals a fresh instance",
        "after reset",
        (
            (
                _INSTANCE,
                "    model_start(&self->model);\n    return change_phase",
                "    const double kept = self->model.p[1];\n    model_start(&self->model);\n    self->model.p[1] = kept;\n    return change_phase",
            ),
        ),
    ),
    (
        "instances share a value",
        "instances do not disturb each other",
        "beside another instance",
        (
            (
                _STEPPING,
                _STEP,
                f"{_STEP}    static double cached_at = -1.0, cached;\n    if (m->time != cached_at) {{\n        cached_at = m->time;\n        cached = m->u[0];\n    }}\n    m->u[0] = cached;\n",
            ),
        ),
    ),
    (
        "an instance is not freed",
        "freed instances give memory back",
        "bytes of allocated memory",
        ((_INSTANCE, "    free(self->name);\n", ""),),
    ),
    (
        "a saved state is not freed",
        "freed instances give memory back",
        "bytes of allocated memory",
        ((_INSTANCE, "        free(*state);\n", ""),),
    ),
    (
        "reading has a side effect",
        "order of reading does not matter",
        "differs",
        (
            (
                _EQUATIONS,
                "case KIND_FORCE: return m->lam[i];",
                "case KIND_FORCE: ((Model *)m)->v[0] += 1e-9; return m->lam[i];",
            ),
        ),
    ),
    (
        "a run depends on the runs before",
        "runs repeat",
        "in a second run",
        (
            (
                _MODEL,
                "    memset(m, 0, sizeof *m);\n",
                "    memset(m, 0, sizeof *m);\n    static int starts;\n    m->u_rate[0] = 1e-3 * starts++;\n",
            ),
        ),
    ),
    (
        "the stop time is ignored",
        "stop time is respected",
        "is answered with OK",
        ((_STEPPING, "if (m->stop_defined && ", "if (0 && "),),
    ),
    (
        "a step crashes",
        "starts and ends",
        "SIGABRT",
        ((_STEPPING, _STEP, f"{_STEP}    abort();\n"),),
    ),
    (
        "a step ends the process with success",
        "starts and ends",
        "exit code 0",
        ((_STEPPING, _STEP, f"{_STEP}    exit(0);\n"),),
    ),
    (
        "a step hangs after a while",
        "runs repeat",
        "it hung",
        ((_STEPPING, _STEP, f"{_STEP}    for (volatile int n = 1; n && m->time > 0.5;) n = 1;\n"),),
    ),
    (
        "FMI 3: set state does nothing",
        "set state restores",
        "differs",
        ((_INSTANCE, _RESTORE, ""),),
        "3.0",
    ),
    # Event mode, early return, intermediate update and input derivatives.
    (
        "events are not announced",
        _EVENT,
        "stands still",
        ((_FMI3, "*eventHandlingNeeded = event != 0;", "*eventHandlingNeeded = fmi3False;"),),
        "3.0",
    ),
    (
        "an event changes the motion",
        _EVENT,
        "than without",
        (
            (
                "sources/instance.h",
                "    if (model_update_modes(&self->model) && ",
                "    if (model_update_modes(&self->model) && (self->model.v[2] += 0.7) && ",
            ),
        ),
        "3.0",
    ),
    (
        "events are not handled",
        _EVENT,
        "stands still",
        (("sources/instance.h", "    if (model_update_modes(&self->model) && ", "    if (0 && "),),
        "3.0",
    ),
    (
        "an update of events moves something",
        _EVENT,
        "called once more it changes values",
        ((_FMI3, _UPDATE, f"    self->model.v[0] += 1e-9;\n{_UPDATE}"),),
        "3.0",
    ),
    (
        "updates are asked for without end",
        _EVENT,
        "did not end",
        ((_FMI3, _UPDATE, f"    *discreteStatesNeedUpdate = fmi3True;\n{_UPDATE}"),),
        "3.0",
    ),
    (
        "reset keeps something of a run with event mode",
        _EVENT,
        "after reset",
        (
            (
                "sources/instance.h",
                "    model_start(&self->model);\n    return change_phase",
                "    const double time = self->model.time;\n"
                "    model_start(&self->model);\n    if (self->event_mode_used && time > 1.0) self->model.q[0] += 1e-9;\n    return change_phase",
            ),
        ),
        "3.0",
    ),
    (
        "it returns early unasked",
        _EARLY,
        "which was not allowed",
        (
            (
                _STEPPING,
                "quotient, self->early_return_allowed, observer);",
                "quotient, self->event_mode_used, observer);",
            ),
        ),
        "3.0",
    ),
    (
        "the time of an early return is that of the step's end",
        _EARLY,
        "the variable time says",
        (
            (
                _FMI3,
                _TOLD,
                "    *lastSuccessfulTime = currentCommunicationPoint + communicationStepSize;",
            ),
        ),
        "3.0",
    ),
    (
        "an early return is not told",
        _EARLY,
        "did not return early, and that it reached",
        (
            (
                _FMI3,
                "*earlyReturn = status == STATUS_OK && dt < communicationStepSize;",
                "*earlyReturn = fmi3False;",
            ),
        ),
        "3.0",
    ),
    (
        "a wish to return early is not heard",
        _EARLY,
        "was asked at",
        ((_FMI3, "    if (wanted < *finish) *finish", "    if (0) *finish"),),
        "3.0",
    ),
    (
        "intermediate update never comes",
        _BETWEEN,
        "never called",
        ((_FMI3, "self->update ? step_finished : NULL", "NULL"),),
        "3.0",
    ),
    (
        "intermediate update tells a time since the step began",
        _BETWEEN,
        "it is called for t =",
        ((_FMI3, _FINISHED, _FINISHED.replace("step->begin + offset", "offset")),),
        "3.0",
    ),
    (
        "intermediate update offers what is not allowed",
        _BETWEEN,
        "offers an early return",
        ((_FMI3, _FINISHED, _FINISHED.replace("self->early_return_allowed != 0", "fmi3True")),),
        "3.0",
    ),
    (
        "values may be got and are refused",
        _BETWEEN,
        "that is refused",
        (
            (
                _FMI3,
                "self->model.phase = PHASE_OUTPUT_UPDATE;",
                "self->model.phase = PHASE_INPUT_UPDATE;",
            ),
        ),
        "3.0",
    ),
    (
        "being watched moves the model",
        _BETWEEN,
        "than without",
        (
            (
                _FMI3,
                "    self->model.phase = PHASE_OUTPUT_UPDATE;",
                "    self->model.u[0] = 9.0;\n    self->model.phase = PHASE_OUTPUT_UPDATE;",
            ),
        ),
        "3.0",
    ),
    (
        "slopes are taken and forgotten",
        _SLOPES,
        "no slope",
        ((_STEPPING, "index] = values[i];", "index] = 0.0 * values[i];"),),
        "2.0",
    ),
    (
        "slopes are per step, not per second",
        _SLOPES,
        "with sloping inputs",
        ((_STEPPING, "index] = values[i];", "index] = 0.1 * values[i];"),),
        "2.0",
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize("defect", _DEFECTS, ids=lambda defect: defect[0])
def test_defect_is_found(defect: tuple, must_find):
    must_find(*defect)
