/* FMI 2.0: functions common to both types that make, lead through its states, save and free an instance. */
#include "fmi2_instance.h"

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation;
    (void)visible;
    if (!functions || !functions->logger) return NULL; /* without a logger nothing can be told */
    Instance refused = {.logger = functions->logger, .environment = functions->componentEnvironment, .name = (char *)"?"};
    if (!instanceName || !instanceName[0]) {
        FAIL(&refused, "fmi2Instantiate: the instance name is missing.");
        return NULL;
    }
    refused.name = (char *)instanceName;
    if (!fmuGUID || strcmp(fmuGUID, MODEL_GUID) != 0) {
        FAIL(&refused, "fmi2Instantiate: the GUID does not match; this binary belongs to another modelDescription.xml (its own is " MODEL_GUID ").");
        return NULL;
    }
    if (fmuType != fmi2ModelExchange && fmuType != fmi2CoSimulation) {
        FAIL(&refused, "fmi2Instantiate: the FMU type %d is neither Model Exchange nor Co-Simulation.", (int)fmuType);
        return NULL;
    }
    const size_t length = strlen(instanceName) + 1;
    Instance *self = calloc(1, sizeof *self);
    char *name = malloc(length);
    if (!self || !name) {
        free(self);
        free(name);
        FAIL(&refused, "fmi2Instantiate: out of memory.");
        return NULL;
    }
    memcpy(name, instanceName, length);
    self->name = name;
    self->type = fmuType;
    self->logger = functions->logger;
    self->environment = functions->componentEnvironment;
    self->log_events = loggingOn;
    model_start(&self->model);
    self->model.phase = PHASE_INSTANTIATED;
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
    Instance *self = allowed(c, "fmi2SetDebugLogging", PHASES_ALL);
    if (!self) return fmi2Error;
    int events = nCategories == 0;
    for (size_t i = 0; i < nCategories; i++) {
        if (!categories || !categories[i]) return FAIL(self, "fmi2SetDebugLogging: a log category is missing.");
        if (strcmp(categories[i], "logEvents") == 0) events = 1;
        else if (strcmp(categories[i], "logStatusError") != 0)
            return FAIL(self, "fmi2SetDebugLogging: an unknown log category was given; there are logEvents and logStatusError.");
    }
    if (events) self->log_events = loggingOn;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
    fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined; /* the step of Co-Simulation is fixed, and Model Exchange has the importer's tolerance */
    (void)tolerance;
    Instance *self = allowed(c, "fmi2SetupExperiment", PHASE_INSTANTIATED);
    if (!self) return fmi2Error;
    if (!isfinite(startTime)) return FAIL(self, "fmi2SetupExperiment: the start time is not a finite number.");
    if (stopTimeDefined && !(stopTime >= startTime))
        return FAIL(self, "fmi2SetupExperiment: the stop time %g s lies before the start time %g s.", stopTime, startTime);
    self->model.time = self->model.start_time = startTime;
    self->model.stop_defined = stopTimeDefined != 0;
    self->model.stop_time = stopTimeDefined ? stopTime : 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *self = allowed(c, "fmi2EnterInitializationMode", PHASE_INSTANTIATED);
    if (!self) return fmi2Error;
    self->model.phase = PHASE_INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *self = allowed(c, "fmi2ExitInitializationMode", PHASE_INITIALIZATION);
    if (!self || evaluated(self) != fmi2OK) return fmi2Error;
    self->model.frozen = self->type == fmi2ModelExchange;
    self->model.phase = self->model.frozen ? PHASE_EVENT : PHASE_STEP_COMPLETE;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *self = allowed(c, "fmi2Terminate", PHASES_RUNNING);
    if (!self) return fmi2Error;
    self->model.phase = PHASE_TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *self = allowed(c, "fmi2Reset", PHASES_ALL);
    if (!self) return fmi2Error;
    model_start(&self->model);
    self->model.phase = PHASE_INSTANTIATED;
    return fmi2OK;
}

/* A saved state is the bytes of a Model behind a head that says which model it belongs to. */
typedef struct {
    char guid[sizeof MODEL_GUID];
    Model model;
} SavedState;

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *self = allowed(c, "fmi2GetFMUstate", PHASES_ALL);
    if (!self) return fmi2Error;
    if (!FMUstate) return FAIL(self, "fmi2GetFMUstate: the place for the state is missing.");
    if (!*FMUstate) *FMUstate = calloc(1, sizeof(SavedState));
    SavedState *saved = *FMUstate;
    if (!saved) return FAIL(self, "fmi2GetFMUstate: out of memory.");
    memcpy(saved->guid, MODEL_GUID, sizeof MODEL_GUID);
    memcpy(&saved->model, &self->model, sizeof self->model);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    Instance *self = allowed(c, "fmi2SetFMUstate", PHASES_ALL);
    if (!self) return fmi2Error;
    const SavedState *saved = FMUstate;
    if (!saved) return FAIL(self, "fmi2SetFMUstate: the state is missing.");
    const int needed = self->type == fmi2ModelExchange ? PHASE_STEP_COMPLETE : PHASE_EVENT | PHASE_CONTINUOUS;
    if (saved->model.phase & needed) return FAIL(self, "fmi2SetFMUstate: the state was saved by an instance of the other FMU type.");
    memcpy(&self->model, &saved->model, sizeof self->model);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    if (!allowed(c, "fmi2FreeFMUstate", PHASES_ALL)) return fmi2Error;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    Instance *self = allowed(c, "fmi2SerializedFMUstateSize", PHASES_ALL);
    if (!self) return fmi2Error;
    if (!FMUstate || !size) return FAIL(self, "fmi2SerializedFMUstateSize: the state or the place for its size is missing.");
    *size = sizeof(SavedState);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    Instance *self = allowed(c, "fmi2SerializeFMUstate", PHASES_ALL);
    if (!self) return fmi2Error;
    if (!FMUstate || !serializedState) return FAIL(self, "fmi2SerializeFMUstate: the state or the place for its bytes is missing.");
    if (size < sizeof(SavedState))
        return FAIL(self, "fmi2SerializeFMUstate: %lu bytes are needed, but there is room for %lu.", (unsigned long)sizeof(SavedState), (unsigned long)size);
    memcpy(serializedState, FMUstate, sizeof(SavedState));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate)
{
    Instance *self = allowed(c, "fmi2DeSerializeFMUstate", PHASES_ALL);
    if (!self) return fmi2Error;
    if (!serializedState || !FMUstate) return FAIL(self, "fmi2DeSerializeFMUstate: the bytes or the place for the state are missing.");
    if (size != sizeof(SavedState) || memcmp(serializedState, MODEL_GUID, sizeof MODEL_GUID) != 0)
        return FAIL(self, "fmi2DeSerializeFMUstate: these %lu bytes are not a state of this model.", (unsigned long)size);
    if (!*FMUstate) *FMUstate = calloc(1, sizeof(SavedState));
    if (!*FMUstate) return FAIL(self, "fmi2DeSerializeFMUstate: out of memory.");
    memcpy(*FMUstate, serializedState, sizeof(SavedState));
    return fmi2OK;
}
