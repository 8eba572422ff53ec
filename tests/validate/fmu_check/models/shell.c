/* A small FMI 2.0 FMU for tests, Model Exchange and Co-Simulation with explicit Euler, around a model that defines
 *   IDENTIFIER, NX, NZ, NR (reals; value references 1..NR, 0 is time), NI (integers; 100..), SOLVER_STEP [s],
 *   struct Model with `double r[], int i[]`, its states among the reals: STATE(k), RATE(k) are places in r,
 *   start(m), calculate(m) (rates and outputs), indicate(m, z), update(m) (1 if states changed), next_event(m). */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define ROOM(n) ((n) > 0 ? (n) : 1)
typedef struct {
    double time, start, stop;
    int stopped, solver_steps;
    double r[ROOM(NR) + 1];
    int i[ROOM(NI)];
    double z[ROOM(NZ)];
} Model;

#include "model.h"

typedef struct {
    Model m; /* first: what is saved */
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char name[64];
} Instance;

#define SELF Instance *self = c; if (!self) return fmi2Error
static fmi2Status refuse(Instance *self, const char *why)
{
    self->logger(self->environment, self->name, fmi2Error, "error", why);
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { (void)c; (void)on; (void)n; (void)names; return fmi2OK; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where, const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)type; (void)where; (void)visible; (void)logging;
    if (strcmp(guid, "{" IDENTIFIER "}") != 0) return NULL;
    Instance *self = calloc(1, sizeof *self);
    if (!self) return NULL;
    self->logger = functions->logger;
    self->environment = functions->componentEnvironment;
    snprintf(self->name, sizeof self->name, "%s", name);
    start(&self->m);
    return self;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean with, fmi2Real tolerance, fmi2Real begin, fmi2Boolean stops, fmi2Real stop)
{
    (void)with; (void)tolerance;
    SELF;
    self->m.time = self->m.start = begin;
    self->m.stopped = stops;
    self->m.stop = stop;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { SELF; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    SELF;
    if (NZ) indicate(&self->m, self->m.z);
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { SELF; return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c)
{
    SELF;
    memset(&self->m, 0, sizeof self->m);
    start(&self->m);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    SELF;
    calculate(&self->m);
    for (size_t k = 0; k < n; k++) {
        if (vr[k] > NR) return refuse(self, "unknown real");
        value[k] = vr[k] ? self->m.r[vr[k]] : self->m.time;
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    SELF;
    for (size_t k = 0; k < n; k++) {
        if (!vr[k] || vr[k] > NR) return refuse(self, "unknown real");
        self->m.r[vr[k]] = value[k];
    }
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    SELF;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] < 100 || vr[k] >= 100 + NI) return refuse(self, "unknown integer");
        value[k] = self->m.i[vr[k] - 100];
    }
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    SELF;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] < 100 || vr[k] >= 100 + NI) return refuse(self, "unknown integer");
        self->m.i[vr[k] - 100] = value[k];
    }
    return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) { (void)vr; (void)value; SELF; return n ? refuse(self, "no booleans") : fmi2OK; }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) { (void)vr; (void)value; SELF; return n ? refuse(self, "no booleans") : fmi2OK; }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) { (void)vr; (void)value; SELF; return n ? refuse(self, "no strings") : fmi2OK; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) { (void)vr; (void)value; SELF; return n ? refuse(self, "no strings") : fmi2OK; }

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    SELF;
    if (!*state) *state = malloc(sizeof(Model));
    memcpy(*state, &self->m, sizeof(Model));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { SELF; memcpy(&self->m, state, sizeof(Model)); return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { SELF; free(*state); *state = NULL; return fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) { (void)state; SELF; *size = sizeof(Model); return fmi2OK; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) { SELF; memcpy(bytes, state, size); return fmi2OK; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    SELF;
    if (!*state) *state = malloc(sizeof(Model));
    memcpy(*state, bytes, size);
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu, const fmi2ValueReference k[], size_t nk, const fmi2Real dk[], fmi2Real du[])
{
    SELF;
    calculate(&self->m);
    return slope(&self->m, u, nu, k, nk, dk, du) ? refuse(self, "no derivatives") : fmi2OK;
}

fmi2Status fmi2EnterEventMode(fmi2Component c) { SELF; return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    SELF;
    memset(info, 0, sizeof *info);
    info->valuesOfContinuousStatesChanged = update(&self->m);
    info->nextEventTime = next_event(&self->m);
    info->nextEventTimeDefined = isfinite(info->nextEventTime);
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { SELF; return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no, fmi2Boolean *event, fmi2Boolean *end) { (void)no; SELF; *event = *end = fmi2False; return fmi2OK; }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { SELF; self->m.time = time; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { SELF; for (size_t k = 0; k < n; k++) self->m.r[STATE(k)] = x[k]; return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { SELF; for (size_t k = 0; k < n; k++) x[k] = self->m.r[STATE(k)]; return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { SELF; calculate(&self->m); for (size_t k = 0; k < n; k++) dx[k] = self->m.r[RATE(k)]; return fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { SELF; if (n) indicate(&self->m, z); return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { SELF; for (size_t k = 0; k < n; k++) x[k] = 1.0; return fmi2OK; }

/* The solver has a grid of its own from the start time on: between its points nothing but the time moves. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean no)
{
    (void)no;
    SELF;
    Model *m = &self->m;
    const double end = now + step;
    if (m->stopped && end > m->stop + 1e-9 * step) return refuse(self, "the step ends after the stop time");
    while (m->start + (m->solver_steps + 1) * SOLVER_STEP < end + 1e-6 * SOLVER_STEP) {
        calculate(m);
        for (int k = 0; k < NX; k++) m->r[STATE(k)] += SOLVER_STEP * m->r[RATE(k)];
        m->time = m->start + ++m->solver_steps * SOLVER_STEP;
        update(m);
    }
    m->time = end;
    return fmi2OK;
}
fmi2Status fmi2CancelStep(fmi2Component c) { SELF; return fmi2Error; }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[]) { (void)vr; (void)n; (void)order; (void)value; SELF; return fmi2Error; }
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) { (void)vr; (void)n; (void)order; (void)value; SELF; return fmi2Error; }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) { (void)s; (void)value; SELF; return fmi2Discard; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    SELF;
    if (s != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = self->m.time;
    return fmi2OK;
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) { (void)s; (void)value; SELF; return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) { (void)s; (void)value; SELF; return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value) { (void)s; (void)value; SELF; return fmi2Discard; }
