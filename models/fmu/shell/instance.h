/* One instance behind an FMI: allowed calls, error reports, start, saved states, end.
 *
 * Version-free: fmi2.c and fmi3.c provide the standards' names and types. Every function takes
 * the name of its FMI function for messages. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "equations.h"

/* The numbers of both fmi2Status and fmi3Status. */
typedef enum { STATUS_OK = 0, STATUS_ERROR = 3 } Status;

typedef enum { MODEL_EXCHANGE = 0, CO_SIMULATION = 1 } InterfaceType;

/* Phases of the state machine, as bits of the set of phases in which a call is allowed. */
enum {
    PHASE_INSTANTIATED = 1,
    PHASE_INITIALIZATION = 2,
    PHASE_EVENT = 4,
    PHASE_CONTINUOUS = 8,
    PHASE_STEP_COMPLETE = 16, /* step mode of FMI 3.0 */
    PHASE_TERMINATED = 32,
    PHASE_ERROR = 64,
    PHASE_INPUT_UPDATE = 128, /* intermediate update mode, inputs may be set */
    PHASE_OUTPUT_UPDATE = 256 /* intermediate update mode, values may be read */
};
#define PHASES_STARTING (PHASE_INSTANTIATED | PHASE_INITIALIZATION)
#define PHASES_RUNNING (PHASE_EVENT | PHASE_CONTINUOUS | PHASE_STEP_COMPLETE)
#define PHASES_READABLE (PHASE_INITIALIZATION | PHASES_RUNNING | PHASE_TERMINATED | PHASE_ERROR)
#define PHASES_ALL (PHASE_INSTANTIATED | PHASES_READABLE) /* all between two calls of the importer */

typedef void (*Callback)(void); /* any callback, cast back by the version that stored it */

typedef struct Instance {
    Model model; /* first: the saved part of an FMU state */
    InterfaceType type;
    int event_mode_used; /* FMI 3.0 Co-Simulation: contacts change in event mode only */
    int early_return_allowed; /* FMI 3.0 Co-Simulation: a step may end at a changing contact */
    int log_events;
    int sets_inputs; /* the importer sets inputs within a step */
    Callback logger, update;
    void *environment;
    const char *resources; /* location of the FMU's resources, during creation */
    void (*write)(const struct Instance *self, int status, const char *category, const char *text);
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
    case PHASE_INPUT_UPDATE:
    case PHASE_OUTPUT_UPDATE: return "intermediate update mode";
    default: return "unknown";
    }
}

/* Report to the importer. The text must not contain '%', because FMI 2.0's logger formats it
 * again. Return `status`. */
static inline Status tell(const Instance *self, Status status, const char *category, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    self->write(self, (int)status, category, text);
    return status;
}

#define FAIL(self, ...) tell(self, STATUS_ERROR, "logStatusError", __VA_ARGS__)

/* Return the instance behind a pointer if `function` may be called now, else NULL after logging. */
static inline Instance *allowed(void *instance, const char *function, int phases)
{
    Instance *self = instance;
    if (self && !(self->model.phase & phases)) {
        FAIL(self, "%s must not be called in the state '%s'.", function, phase_name(self->model.phase));
        return NULL;
    }
    return self;
}

/* As `allowed`, for functions of one interface type. */
static inline Instance *allowed_type(void *instance, const char *function, int phases, InterfaceType type)
{
    const Instance *self = instance;
    if (self && self->type != type) {
        FAIL(self, "%s belongs to %s, but the instance was made for %s.", function, type == CO_SIMULATION ? "Co-Simulation" : "Model Exchange",
            type == CO_SIMULATION ? "Model Exchange" : "Co-Simulation");
        return NULL;
    }
    return allowed(instance, function, phases);
}

/* Evaluate the model if needed. */
static inline Status evaluated(Instance *self)
{
    if (model_evaluate(&self->model)) return FAIL(self, "at t = %g s %s.", self->model.time, model_trouble(&self->model));
    return STATUS_OK;
}

/* Return the row of a value reference, or NULL after logging. */
static inline const Variable *variable_of(const Instance *self, const char *function, unsigned int reference)
{
    if (reference < VARIABLE_COUNT) return &MODEL_VARIABLES[reference];
    FAIL(self, "%s: there is no variable with value reference %u; the model has %d.", function, reference, VARIABLE_COUNT);
    return NULL;
}

static inline void free_instance(void *instance)
{
    Instance *self = instance;
    if (!self) return;
    model_close(&self->model);
    free(self->name);
    free(self);
}

/* Return a new instance with the settings of `draft` (its name is copied), or NULL after
 * logging. token_word: the standard's name of the token. */
static inline Instance *new_instance(const Instance *draft, const char *function, const char *name, const char *token, const char *token_word)
{
    Instance refused = *draft;
    refused.name = (char *)(name && name[0] ? name : "?");
    if (!name || !name[0]) {
        FAIL(&refused, "%s: the instance name is missing.", function);
        return NULL;
    }
    if (!token || strcmp(token, MODEL_GUID) != 0) {
        FAIL(&refused, "%s: the %s does not match; this binary belongs to another modelDescription.xml (its own is " MODEL_GUID ").", function, token_word);
        return NULL;
    }
    const size_t length = strlen(name) + 1;
    Instance *self = calloc(1, sizeof *self);
    char *copy = malloc(length);
    if (!self || !copy) {
        free(self);
        free(copy);
        FAIL(&refused, "%s: out of memory.", function);
        return NULL;
    }
    *self = *draft;
    memcpy(copy, name, length);
    self->name = copy;
    const char *trouble = model_open(&self->model, draft->resources);
    if (trouble) {
        FAIL(self, "%s: %s.", function, trouble);
        free_instance(self);
        return NULL;
    }
    model_start(&self->model);
    self->model.phase = PHASE_INSTANTIATED;
    return self;
}

static inline Status set_logging(void *instance, const char *function, int on, size_t count, const char *const categories[])
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    int events = count == 0;
    for (size_t i = 0; i < count; i++) {
        if (!categories || !categories[i]) return FAIL(self, "%s: a log category is missing.", function);
        if (strcmp(categories[i], "logEvents") == 0) events = 1;
        else if (strcmp(categories[i], "logStatusError") != 0)
            return FAIL(self, "%s: an unknown log category was given; there are logEvents and logStatusError.", function);
    }
    if (events) self->log_events = on;
    return STATUS_OK;
}

/* Set start and stop time of the experiment. */
static inline Status set_experiment(Instance *self, const char *function, double start, int stop_defined, double stop)
{
    if (!isfinite(start)) return FAIL(self, "%s: the start time is not a finite number.", function);
    if (stop_defined && !(stop >= start)) return FAIL(self, "%s: the stop time %g s lies before the start time %g s.", function, stop, start);
    self->model.time = self->model.start_time = start;
    self->model.stop_defined = stop_defined != 0;
    self->model.stop_time = stop_defined ? stop : 0.0;
    return STATUS_OK;
}

/* Change to the phase `next` from one of `phases`. */
static inline Status change_phase(Instance *self, int next)
{
    if (!self) return STATUS_ERROR;
    self->model.phase = next;
    return STATUS_OK;
}

static inline Status exit_initialization(void *instance, const char *function)
{
    Instance *self = allowed(instance, function, PHASE_INITIALIZATION);
    if (!self || evaluated(self) != STATUS_OK) return STATUS_ERROR;
    self->model.frozen = self->type == MODEL_EXCHANGE || self->event_mode_used;
    return change_phase(self, self->model.frozen ? PHASE_EVENT : PHASE_STEP_COMPLETE);
}

static inline Status reset(void *instance, const char *function)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    model_start(&self->model);
    return change_phase(self, PHASE_INSTANTIATED);
}

/* Event mode, the only phase in which frozen contacts change. Modes depend on states only: one
 * update suffices. */
static inline Status update_discrete_states(void *instance, const char *function)
{
    Instance *self = allowed(instance, function, PHASE_EVENT);
    if (!self) return STATUS_ERROR;
    if (model_update_modes(&self->model) && self->log_events)
        tell(self, STATUS_OK, "logEvents", "at t = %.12g s a contact opened or closed.", self->model.time);
    return STATUS_OK;
}

/* A saved state: the bytes of a Model after a head that identifies model and kind of instance. */
typedef struct {
    char guid[sizeof MODEL_GUID];
    int type, event_mode_used;
    Model model;
} SavedState;

static inline Status save_state(void *instance, const char *function, void **state)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!state) return FAIL(self, "%s: the place for the state is missing.", function);
    if (!*state) *state = calloc(1, sizeof(SavedState));
    SavedState *saved = *state;
    if (!saved) return FAIL(self, "%s: out of memory.", function);
    memcpy(saved->guid, MODEL_GUID, sizeof MODEL_GUID);
    saved->type = (int)self->type;
    saved->event_mode_used = self->event_mode_used;
    model_copy(&saved->model, &self->model);
    return STATUS_OK;
}

static inline Status restore_state(void *instance, const char *function, const void *state)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    const SavedState *saved = state;
    if (!saved) return FAIL(self, "%s: the state is missing.", function);
    if (saved->type != (int)self->type) return FAIL(self, "%s: the state was saved by an instance of the other FMU type.", function);
    if (saved->event_mode_used != self->event_mode_used)
        return FAIL(self, "%s: the state was saved by an instance that was made %s event mode.", function, saved->event_mode_used ? "with" : "without");
    model_copy(&self->model, &saved->model);
    return STATUS_OK;
}

static inline Status free_state(void *instance, const char *function, void **state)
{
    if (!allowed(instance, function, PHASES_ALL)) return STATUS_ERROR;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return STATUS_OK;
}

static inline Status serialized_size(void *instance, const char *function, const void *state, size_t *size)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!state || !size) return FAIL(self, "%s: the state or the place for its size is missing.", function);
    *size = sizeof(SavedState);
    return STATUS_OK;
}

static inline Status serialize(void *instance, const char *function, const void *state, void *bytes, size_t size)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!state || !bytes) return FAIL(self, "%s: the state or the place for its bytes is missing.", function);
    if (size < sizeof(SavedState))
        return FAIL(self, "%s: %lu bytes are needed, but there is room for %lu.", function, (unsigned long)sizeof(SavedState), (unsigned long)size);
    memcpy(bytes, state, sizeof(SavedState));
    return STATUS_OK;
}

static inline Status deserialize(void *instance, const char *function, const void *bytes, size_t size, void **state)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!bytes || !state) return FAIL(self, "%s: the bytes or the place for the state are missing.", function);
    if (size != sizeof(SavedState) || memcmp(bytes, MODEL_GUID, sizeof MODEL_GUID) != 0)
        return FAIL(self, "%s: these %lu bytes are not a state of this model.", function, (unsigned long)size);
    if (!*state) *state = calloc(1, sizeof(SavedState));
    if (!*state) return FAIL(self, "%s: out of memory.", function);
    memcpy(*state, bytes, sizeof(SavedState));
    return STATUS_OK;
}

#endif
