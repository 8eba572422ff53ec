/* FMI 2.0: functions common to both types that make, lead through its states, save and free an instance. */
#include "fmi2_instance.h"
#include "saved_state.h"

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

static void write_log(const Instance *self, int status, const char *category, const char *text)
{
    ((fmi2CallbackLogger)self->logger)(self->environment, self->name, (fmi2Status)status, category, text);
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation;
    (void)visible;
    if (!functions || !functions->logger) return NULL; /* without a logger nothing can be told */
    Instance draft = {.type = fmuType == fmi2ModelExchange ? MODEL_EXCHANGE : CO_SIMULATION, .log_events = loggingOn};
    draft.logger = (Callback)functions->logger;
    draft.environment = functions->componentEnvironment;
    draft.write = write_log;
    draft.name = (char *)"?";
    if (fmuType != fmi2ModelExchange && fmuType != fmi2CoSimulation) {
        FAIL(&draft, "fmi2Instantiate: the FMU type %d is neither Model Exchange nor Co-Simulation.", (int)fmuType);
        return NULL;
    }
    return new_instance(&draft, "fmi2Instantiate", instanceName, fmuGUID, "GUID");
}

void fmi2FreeInstance(fmi2Component c)
{
    free_instance(c);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[])
{
    return said(set_logging(c, "fmi2SetDebugLogging", loggingOn, nCategories, categories));
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
    fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined; /* the step of Co-Simulation is fixed, and Model Exchange has the importer's tolerance */
    (void)tolerance;
    Instance *self = allowed(c, "fmi2SetupExperiment", PHASE_INSTANTIATED);
    return self ? said(set_experiment(self, "fmi2SetupExperiment", startTime, stopTimeDefined, stopTime)) : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return said(change_phase(allowed(c, "fmi2EnterInitializationMode", PHASE_INSTANTIATED), PHASE_INITIALIZATION));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return said(exit_initialization(c, "fmi2ExitInitializationMode"));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    return said(change_phase(allowed(c, "fmi2Terminate", PHASES_RUNNING), PHASE_TERMINATED));
}

fmi2Status fmi2Reset(fmi2Component c)
{
    return said(reset(c, "fmi2Reset"));
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    return said(save_state(c, "fmi2GetFMUstate", FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    return said(restore_state(c, "fmi2SetFMUstate", FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    return said(free_state(c, "fmi2FreeFMUstate", FMUstate));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    return said(serialized_size(c, "fmi2SerializedFMUstateSize", FMUstate, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    return said(serialize(c, "fmi2SerializeFMUstate", FMUstate, serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate)
{
    return said(deserialize(c, "fmi2DeSerializeFMUstate", serializedState, size, FMUstate));
}
