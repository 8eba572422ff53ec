/* FMI 3.0: functions common to both types that make, lead through its states, save and free an instance. */
#include "access.h"
#include "fmi3_instance.h"
#include "saved_state.h"

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

static void write_log(const Instance *self, int status, const char *category, const char *text)
{
    if (self->logger) ((fmi3LogMessageCallback)self->logger)(self->environment, (fmi3Status)status, category, text);
}

static Instance draft_of(InterfaceType type, fmi3Boolean loggingOn, fmi3InstanceEnvironment environment, fmi3LogMessageCallback logMessage)
{
    Instance draft = {.type = type, .log_events = loggingOn};
    draft.logger = (Callback)logMessage;
    draft.environment = environment;
    draft.write = write_log;
    draft.name = (char *)"?";
    return draft;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage)
{
    (void)resourcePath;
    (void)visible;
    const Instance draft = draft_of(MODEL_EXCHANGE, loggingOn, instanceEnvironment, logMessage);
    return new_instance(&draft, "fmi3InstantiateModelExchange", instanceName, instantiationToken, "instantiation token");
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    const char *function = "fmi3InstantiateCoSimulation";
    (void)resourcePath;
    (void)visible;
    Instance draft = draft_of(CO_SIMULATION, loggingOn, instanceEnvironment, logMessage);
    draft.event_mode_used = eventModeUsed;
    draft.early_return_allowed = earlyReturnAllowed;
    draft.update = (Callback)intermediateUpdate;
    for (size_t i = 0; requiredIntermediateVariables && i < nRequiredIntermediateVariables; i++) {
        const Variable *variable = typed_variable(&draft, function, requiredIntermediateVariables[i], 0);
        if (!variable) return NULL;
        draft.sets_inputs |= variable->kind == KIND_INPUT;
    }
    return new_instance(&draft, function, instanceName, instantiationToken, "instantiation token");
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
    fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    const Instance draft = draft_of(CO_SIMULATION, loggingOn, instanceEnvironment, logMessage);
    FAIL(&draft, "fmi3InstantiateScheduledExecution: the FMU is for Model Exchange and Co-Simulation.");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free_instance(instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories, const fmi3String categories[])
{
    return said(set_logging(instance, "fmi3SetDebugLogging", loggingOn, nCategories, categories));
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance, fmi3Float64 startTime,
    fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    (void)toleranceDefined; /* the step of Co-Simulation is fixed, and Model Exchange has the importer's tolerance */
    (void)tolerance;
    const char *function = "fmi3EnterInitializationMode";
    Instance *self = allowed(instance, function, PHASE_INSTANTIATED);
    if (!self || set_experiment(self, function, startTime, stopTimeDefined, stopTime) != STATUS_OK) return fmi3Error;
    return said(change_phase(self, PHASE_INITIALIZATION));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return said(exit_initialization(instance, "fmi3ExitInitializationMode"));
}

/* From continuous-time mode, or from step mode of an instance that was made for event mode. */
fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    Instance *self = instance;
    if (self && self->type == CO_SIMULATION && !self->event_mode_used)
        return said(FAIL(self, "fmi3EnterEventMode: the instance was made without event mode."));
    return said(change_phase(allowed(instance, "fmi3EnterEventMode", PHASES_RUNNING), PHASE_EVENT));
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate, fmi3Boolean *terminateSimulation,
    fmi3Boolean *nominalsOfContinuousStatesChanged, fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
    fmi3Float64 *nextEventTime)
{
    Instance *self = allowed(instance, "fmi3UpdateDiscreteStates", PHASE_EVENT);
    if (!self) return fmi3Error;
    if (!discreteStatesNeedUpdate || !terminateSimulation || !nominalsOfContinuousStatesChanged || !valuesOfContinuousStatesChanged
        || !nextEventTimeDefined || !nextEventTime)
        return said(FAIL(self, "fmi3UpdateDiscreteStates: the place for an answer is missing."));
    *discreteStatesNeedUpdate = *terminateSimulation = *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = *nextEventTimeDefined = fmi3False;
    *nextEventTime = 0.0;
    return said(update_discrete_states(self, "fmi3UpdateDiscreteStates"));
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return said(change_phase(allowed(instance, "fmi3Terminate", PHASES_RUNNING), PHASE_TERMINATED));
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    return said(reset(instance, "fmi3Reset"));
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return said(save_state(instance, "fmi3GetFMUState", FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    return said(restore_state(instance, "fmi3SetFMUState", FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return said(free_state(instance, "fmi3FreeFMUState", FMUState));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    return said(serialized_size(instance, "fmi3SerializedFMUStateSize", FMUState, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    return said(serialize(instance, "fmi3SerializeFMUState", FMUState, serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size, fmi3FMUState *FMUState)
{
    return said(deserialize(instance, "fmi3DeserializeFMUState", serializedState, size, FMUState));
}
