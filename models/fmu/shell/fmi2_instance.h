/* What one FMI 2.0 instance is, which call is allowed when, and how failures are told. */
#ifndef FMI2_INSTANCE_H
#define FMI2_INSTANCE_H

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "equations.h"
#include "fmi2Functions.h"

/* Static libraries need names of their own: FMI2_FUNCTION_PREFIX, which some copies of the standard header ignore. */
#ifdef FMI2_FUNCTION_PREFIX
#undef fmi2FullName
#define PREFIXED_AGAIN(prefix, name) prefix##name
#define PREFIXED(prefix, name) PREFIXED_AGAIN(prefix, name)
#define fmi2FullName(name) PREFIXED(FMI2_FUNCTION_PREFIX, name)
#endif

/* Phases of the state machine; bits, so that a set of them says where a call is allowed. */
enum {
    PHASE_INSTANTIATED = 1,
    PHASE_INITIALIZATION = 2,
    PHASE_EVENT = 4,
    PHASE_CONTINUOUS = 8,
    PHASE_STEP_COMPLETE = 16,
    PHASE_TERMINATED = 32,
    PHASE_ERROR = 64
};
#define PHASES_RUNNING (PHASE_EVENT | PHASE_CONTINUOUS | PHASE_STEP_COMPLETE)
#define PHASES_READABLE (PHASE_INITIALIZATION | PHASES_RUNNING | PHASE_TERMINATED | PHASE_ERROR)
#define PHASES_ALL (PHASE_INSTANTIATED | PHASES_READABLE)

typedef struct {
    Model model; /* first: all that get/set/serialise of an FMU state copies */
    fmi2Type type;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    int log_events;
    char *name;
} Instance;

static inline const char *phase_name(int phase)
{
    switch (phase) {
    case PHASE_INSTANTIATED: return "instantiated";
    case PHASE_INITIALIZATION: return "initialization mode";
    case PHASE_EVENT: return "event mode";
    case PHASE_CONTINUOUS: return "continuous-time mode";
    case PHASE_STEP_COMPLETE: return "step complete";
    case PHASE_TERMINATED: return "terminated";
    case PHASE_ERROR: return "error";
    default: return "unknown";
    }
}

/* Tell the importer; the text must not contain '%', because the logger formats it once more. Returns `status`. */
static inline fmi2Status tell(const Instance *self, fmi2Status status, const char *category, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    self->logger(self->environment, self->name, status, category, text);
    return status;
}

#define FAIL(self, ...) tell(self, fmi2Error, "logStatusError", __VA_ARGS__)

/* The instance behind a component if `function` may be called now; NULL (and a logged sentence) if not. */
static inline Instance *allowed(fmi2Component component, const char *function, int phases)
{
    Instance *self = component;
    if (self && !(self->model.phase & phases)) {
        FAIL(self, "%s must not be called in the state '%s'.", function, phase_name(self->model.phase));
        return NULL;
    }
    return self;
}

/* As `allowed`, for functions of one of the two FMU types. */
static inline Instance *allowed_type(fmi2Component component, const char *function, int phases, fmi2Type type)
{
    const Instance *self = component;
    if (self && self->type != type) {
        FAIL(self, "%s belongs to %s, but the instance was made for %s.", function, type == fmi2CoSimulation ? "Co-Simulation" : "Model Exchange",
            type == fmi2CoSimulation ? "Model Exchange" : "Co-Simulation");
        return NULL;
    }
    return allowed(component, function, phases);
}

/* Make the model's results current. */
static inline fmi2Status evaluated(Instance *self)
{
    if (model_evaluate(&self->model)) return FAIL(self, "at t = %g s the mass matrix is not positive definite; check the masses and lengths.", self->model.time);
    return fmi2OK;
}

/* The row of a value reference, or NULL and a logged sentence. */
static inline const Variable *variable_of(const Instance *self, const char *function, fmi2ValueReference reference)
{
    if (reference < VARIABLE_COUNT) return &MODEL_VARIABLES[reference];
    FAIL(self, "%s: there is no variable with value reference %u; the model has %d.", function, reference, VARIABLE_COUNT);
    return NULL;
}

#endif
