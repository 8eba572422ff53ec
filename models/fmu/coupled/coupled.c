/* FMI 2.0 for Co-Simulation around a contact: outputs y are functions of inputs and parameters
 * x, without state.
 *
 * contact_model.h (generated) has the functions, sizes and limits. Value references: 0 is the
 * time, then x, then y. Outputs follow the inputs immediately, also between steps. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "contact_model.h" /* MODEL_GUID, INPUT_COUNT, X_COUNT, Y_COUNT, X_START, X_LOWER, X_UPPER; contact_* functions */
#include "fmi2Functions.h"

/* Static libraries need unique names: FMI2_FUNCTION_PREFIX, which some copies of the standard
 * header ignore. */
#ifdef FMI2_FUNCTION_PREFIX
#undef fmi2FullName
#define PREFIXED_AGAIN(prefix, name) prefix##name
#define PREFIXED(prefix, name) PREFIXED_AGAIN(prefix, name)
#define fmi2FullName(name) PREFIXED(FMI2_FUNCTION_PREFIX, name)
#endif

/* Relative difference of equal times; importers accumulate their steps. */
#define TIME_TOLERANCE 1e-9

enum { MADE = 1, INITIALIZING = 2, READY = 4, TERMINATED = 8 };
#define READABLE (INITIALIZING | READY | TERMINATED)
#define ANY (MADE | READABLE)

/* Flat: copying the bytes copies the state. */
typedef struct {
    char guid[sizeof MODEL_GUID];
    double time, stop_time;
    double x[X_COUNT];
    int stop_defined, phase;
} State;

typedef struct {
    State state;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char *name;
} Instance;

/* Report a refused call to the importer. The text must not contain '%', because the logger
 * formats it again. */
static fmi2Status refuse(const Instance *self, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    self->logger(self->environment, self->name, fmi2Error, "logStatusError", text);
    return fmi2Error;
}

/* Return the instance if `function` may be called in its phase with `count` values, else NULL
 * after logging. */
static Instance *allowed(fmi2Component c, const char *function, int phases, const void *references, const void *values, size_t count)
{
    Instance *self = c;
    if (!self) return NULL;
    if (!(self->state.phase & phases)) {
        refuse(self, "%s must not be called in this state of the instance.", function);
        return NULL;
    }
    if (count > 0 && (!references || !values)) {
        refuse(self, "%s: value references or values are missing.", function);
        return NULL;
    }
    return self;
}

static fmi2Status change_phase(fmi2Component c, const char *function, int from, int to)
{
    Instance *self = allowed(c, function, from, NULL, NULL, 0);
    if (!self) return fmi2Error;
    self->state.phase = to;
    return fmi2OK;
}

static void start(State *state)
{
    static const double values[] = X_START;
    memset(state, 0, sizeof *state);
    memcpy(state->guid, MODEL_GUID, sizeof MODEL_GUID);
    memcpy(state->x, values, sizeof state->x);
    state->phase = MADE;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation, (void)visible, (void)loggingOn;
    if (!functions || !functions->logger) return NULL; /* without a logger nothing can be reported */
    Instance draft = {.logger = functions->logger, .environment = functions->componentEnvironment, .name = (char *)"?"};
    if (!instanceName || !instanceName[0]) return refuse(&draft, "fmi2Instantiate: the instance name is missing."), NULL;
    draft.name = (char *)instanceName;
    if (fmuType != fmi2CoSimulation) return refuse(&draft, "fmi2Instantiate: this FMU is for Co-Simulation only."), NULL;
    if (!fmuGUID || strcmp(fmuGUID, MODEL_GUID) != 0)
        return refuse(&draft, "fmi2Instantiate: the GUID does not match; this binary belongs to another modelDescription.xml."), NULL;
    Instance *self = malloc(sizeof *self);
    char *name = malloc(strlen(instanceName) + 1);
    if (!self || !name) {
        free(self);
        free(name);
        return refuse(&draft, "fmi2Instantiate: out of memory."), NULL;
    }
    strcpy(name, instanceName);
    *self = draft;
    self->name = name;
    start(&self->state);
    return self;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *self = c;
    if (!self) return;
    free(self->name);
    free(self);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[])
{
    (void)loggingOn; /* errors are always logged, nothing else is */
    const Instance *self = allowed(c, "fmi2SetDebugLogging", ANY, categories, categories, nCategories);
    if (!self) return fmi2Error;
    for (size_t i = 0; i < nCategories; i++)
        if (!categories[i] || strcmp(categories[i], "logStatusError") != 0)
            return refuse(self, "fmi2SetDebugLogging: an unknown log category was given; there is logStatusError.");
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
    fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined, (void)tolerance;
    Instance *self = allowed(c, "fmi2SetupExperiment", MADE, NULL, NULL, 0);
    if (!self) return fmi2Error;
    if (!isfinite(startTime)) return refuse(self, "fmi2SetupExperiment: the start time is not a finite number.");
    if (stopTimeDefined && !(stopTime >= startTime))
        return refuse(self, "fmi2SetupExperiment: the stop time %g s lies before the start time %g s.", stopTime, startTime);
    self->state.time = startTime;
    self->state.stop_defined = stopTimeDefined != 0;
    self->state.stop_time = stopTimeDefined ? stopTime : 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return change_phase(c, "fmi2EnterInitializationMode", MADE, INITIALIZING); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return change_phase(c, "fmi2ExitInitializationMode", INITIALIZING, READY); }
fmi2Status fmi2Terminate(fmi2Component c) { return change_phase(c, "fmi2Terminate", READY, TERMINATED); }

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *self = allowed(c, "fmi2Reset", ANY, NULL, NULL, 0);
    if (!self) return fmi2Error;
    start(&self->state);
    return fmi2OK;
}

/* Values and derivatives */

/* Return whether the surfaces touch, which selects the expression of the outputs. */
static double closed(const State *state) { return contact_penetration(state->x) > 0.0 ? 1.0 : 0.0; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    const Instance *self = allowed(c, "fmi2GetReal", READABLE, vr, value, nvr);
    if (!self) return fmi2Error;
    const double mode = closed(&self->state);
    double y[Y_COUNT];
    contact_outputs(self->state.x, &mode, y);
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] > X_COUNT + Y_COUNT) return refuse(self, "fmi2GetReal: there is no variable with value reference %u.", vr[i]);
        value[i] = vr[i] == 0 ? self->state.time : vr[i] <= X_COUNT ? self->state.x[vr[i] - 1] : y[vr[i] - 1 - X_COUNT];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    static const double lower[] = X_LOWER, upper[] = X_UPPER;
    Instance *self = allowed(c, "fmi2SetReal", MADE | INITIALIZING | READY, vr, value, nvr);
    if (!self) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] < 1 || vr[i] > X_COUNT) return refuse(self, "fmi2SetReal: the variable with value reference %u cannot be set, or is none.", vr[i]);
        if (vr[i] > INPUT_COUNT && self->state.phase == READY) return refuse(self, "fmi2SetReal: parameters are fixed after the initialization.");
        if (!isfinite(value[i])) return refuse(self, "fmi2SetReal: the value given to reference %u is not a finite number.", vr[i]);
        if (value[i] < lower[vr[i] - 1] || value[i] > upper[vr[i] - 1])
            return refuse(self, "fmi2SetReal: %g is outside the limits of value reference %u.", value[i], vr[i]);
    }
    for (size_t i = 0; i < nvr; i++) self->state.x[vr[i] - 1] = value[i];
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
    const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    const Instance *self = allowed(c, "fmi2GetDirectionalDerivative", READABLE, vKnown_ref, dvKnown, nKnown);
    if (!self || (nUnknown > 0 && (!vUnknown_ref || !dvUnknown))) return fmi2Error;
    const double mode = closed(&self->state);
    double dx[X_COUNT] = {0.0}, dy[Y_COUNT];
    for (size_t i = 0; i < nKnown; i++) {
        const int known = vKnown_ref[i] >= 1 && vKnown_ref[i] <= (self->state.phase == INITIALIZING ? X_COUNT : INPUT_COUNT);
        if (!known) return refuse(self, "fmi2GetDirectionalDerivative: value reference %u is not a known.", vKnown_ref[i]);
        dx[vKnown_ref[i] - 1] += dvKnown[i];
    }
    contact_tangent(self->state.x, &mode, dx, dy);
    for (size_t i = 0; i < nUnknown; i++) {
        if (vUnknown_ref[i] <= X_COUNT || vUnknown_ref[i] > X_COUNT + Y_COUNT)
            return refuse(self, "fmi2GetDirectionalDerivative: value reference %u is not an output.", vUnknown_ref[i]);
        dvUnknown[i] = dy[vUnknown_ref[i] - 1 - X_COUNT];
    }
    return fmi2OK;
}

#define NO_VARIABLES(NAME, TYPE)                                                                       \
    fmi2Status NAME(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, TYPE value[])          \
    {                                                                                                  \
        const Instance *self = allowed(c, #NAME, ANY, vr, value, nvr);                                 \
        if (!self) return fmi2Error;                                                                   \
        return nvr == 0 ? fmi2OK : refuse(self, #NAME ": all variables of this FMU are real numbers."); \
    }
NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

/* Saved states */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    const Instance *self = allowed(c, "fmi2GetFMUstate", ANY, FMUstate, FMUstate, 1);
    if (!self) return fmi2Error;
    if (!*FMUstate) *FMUstate = malloc(sizeof(State));
    if (!*FMUstate) return refuse(self, "fmi2GetFMUstate: out of memory.");
    memcpy(*FMUstate, &self->state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    Instance *self = allowed(c, "fmi2SetFMUstate", ANY, FMUstate, FMUstate, 1);
    if (!self) return fmi2Error;
    memcpy(&self->state, FMUstate, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    if (!allowed(c, "fmi2FreeFMUstate", ANY, NULL, NULL, 0)) return fmi2Error;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    if (!allowed(c, "fmi2SerializedFMUstateSize", ANY, FMUstate, size, 1)) return fmi2Error;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    const Instance *self = allowed(c, "fmi2SerializeFMUstate", ANY, FMUstate, serializedState, 1);
    if (!self) return fmi2Error;
    if (size < sizeof(State)) return refuse(self, "fmi2SerializeFMUstate: %lu bytes are needed.", (unsigned long)sizeof(State));
    memcpy(serializedState, FMUstate, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate)
{
    const Instance *self = allowed(c, "fmi2DeSerializeFMUstate", ANY, FMUstate, serializedState, 1);
    if (!self) return fmi2Error;
    if (size != sizeof(State) || memcmp(serializedState, MODEL_GUID, sizeof MODEL_GUID) != 0)
        return refuse(self, "fmi2DeSerializeFMUstate: these bytes are not a state of this model.");
    if (!*FMUstate) *FMUstate = malloc(sizeof(State));
    if (!*FMUstate) return refuse(self, "fmi2DeSerializeFMUstate: out of memory.");
    memcpy(*FMUstate, serializedState, sizeof(State));
    return fmi2OK;
}

/* Co-Simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    Instance *self = allowed(c, "fmi2DoStep", READY, NULL, NULL, 0);
    if (!self) return fmi2Error;
    State *state = &self->state;
    const double t = currentCommunicationPoint, dt = communicationStepSize;
    if (!isfinite(t) || !isfinite(dt) || dt < 0.0) return refuse(self, "fmi2DoStep: a step of %g s from %g s is impossible.", dt, t);
    if (fabs(t - state->time) > TIME_TOLERANCE * fmax(fabs(t), dt))
        return refuse(self, "fmi2DoStep: the communication point is %.12g s, but the model is at %.12g s.", t, state->time);
    if (state->stop_defined && t + dt - state->stop_time > TIME_TOLERANCE * fmax(fabs(state->stop_time), dt))
        return refuse(self, "fmi2DoStep: the step ends at %.12g s, after the stop time %.12g s.", t + dt, state->stop_time);
    state->time = t + dt;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    const Instance *self = allowed(c, "fmi2GetRealStatus", READY | TERMINATED, value, value, 1);
    if (!self) return fmi2Error;
    if (s != fmi2LastSuccessfulTime) return refuse(self, "fmi2GetRealStatus: the status %d is not available, because steps are synchronous.", (int)s);
    *value = self->state.time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    const Instance *self = allowed(c, "fmi2GetBooleanStatus", READY | TERMINATED, value, value, 1);
    if (!self) return fmi2Error;
    if (s != fmi2Terminated) return refuse(self, "fmi2GetBooleanStatus: the status %d is not available, because steps are synchronous.", (int)s);
    *value = fmi2False; /* the model never ends a simulation */
    return fmi2OK;
}

/* Refuse a function that has no use here. */
static fmi2Status absent(fmi2Component c, const char *function, const char *reason)
{
    const Instance *self = allowed(c, function, ANY, NULL, NULL, 0);
    return self ? refuse(self, "%s: %s", function, reason) : fmi2Error;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return absent(c, "fmi2SetRealInputDerivatives", "nothing is integrated, so inputs have no course within a step.");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return absent(c, "fmi2GetRealOutputDerivatives", "derivatives of outputs are not offered.");
}

fmi2Status fmi2CancelStep(fmi2Component c) { return absent(c, "fmi2CancelStep", "steps are synchronous, there is none to cancel."); }

#define NO_STATUS(NAME, TYPE)                                                                         \
    fmi2Status NAME(fmi2Component c, const fmi2StatusKind s, TYPE *value)                             \
    {                                                                                                 \
        (void)s, (void)value;                                                                         \
        return absent(c, #NAME, "this status is not available, because steps are synchronous.");      \
    }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)
