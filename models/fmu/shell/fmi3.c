/* FMI 3.0: its names and types for the version-free functions of instance.h, access.h,
 * exchange.h and stepping.h, and refusals of everything else. */
#include "fmi3Functions.h"

#include "access.h"
#include "exchange.h"
#include "instance.h"
#include "stepping.h"

typedef char same_status_numbers[(int)fmi3OK == (int)STATUS_OK && (int)fmi3Error == (int)STATUS_ERROR ? 1 : -1];

/* The status of a version-free function. */
static inline fmi3Status said(Status status)
{
    return status == STATUS_OK ? fmi3OK : fmi3Error;
}

/* Refuse a function that this FMU does not provide. */
static inline fmi3Status not_offered(fmi3Instance instance, const char *function, const char *why)
{
    const Instance *self = instance;
    return self ? said(FAIL(self, "%s: %s.", function, why)) : fmi3Error;
}

/* ---- Make an instance, change its states, save and free it. ---- */

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
    (void)visible;
    Instance draft = draft_of(MODEL_EXCHANGE, loggingOn, instanceEnvironment, logMessage);
    draft.resources = resourcePath;
    return new_instance(&draft, "fmi3InstantiateModelExchange", instanceName, instantiationToken, "instantiation token");
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    const char *function = "fmi3InstantiateCoSimulation";
    (void)visible;
    Instance draft = draft_of(CO_SIMULATION, loggingOn, instanceEnvironment, logMessage);
    draft.event_mode_used = eventModeUsed;
    draft.early_return_allowed = earlyReturnAllowed;
    draft.update = (Callback)intermediateUpdate;
    draft.resources = resourcePath;
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
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
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

/* From continuous-time mode, or from step mode of an instance with event mode. */
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

/* ---- Get and set variables by value reference; directional and adjoint derivatives. ---- */

/* Every variable is a scalar: one value per value reference. */
static int as_many(fmi3Instance instance, const char *function, size_t references, size_t values)
{
    if (references == values) return 1;
    not_offered(instance, function, "the model has scalars only, so as many values as value references are needed");
    return 0;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, fmi3Float64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3GetFloat64", nvr, nValues)) return fmi3Error;
    return said(get_reals(instance, "fmi3GetFloat64", (References){vr, nvr}, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, const fmi3Float64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3SetFloat64", nvr, nValues)) return fmi3Error;
    return said(set_reals(instance, "fmi3SetFloat64", (References){vr, nvr}, values));
}

/* Enumerations are read and set as Int64. */
fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, fmi3Int64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3GetInt64", nvr, nValues)) return fmi3Error;
    const Instance *self = readable(instance, "fmi3GetInt64", vr, values, nvr);
    if (!self) return fmi3Error;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = typed_variable(self, "fmi3GetInt64", vr[i], 1);
        if (!variable) return fmi3Error;
        values[i] = (fmi3Int64)model_value(&self->model, variable);
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, const fmi3Int64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3SetInt64", nvr, nValues)) return fmi3Error;
    Instance *self = writable(instance, "fmi3SetInt64", vr, values, nvr);
    if (!self) return fmi3Error;
    for (size_t i = 0; i < nvr; i++)
        if (check_assignment(self, "fmi3SetInt64", vr[i], (double)values[i], 1) != STATUS_OK) return fmi3Error;
    for (size_t i = 0; i < nvr; i++) model_assign(&self->model, &MODEL_VARIABLES[vr[i]], (double)values[i]);
    return fmi3OK;
}

/* FMI 3.0 counts parameters among the knowns of both derivatives in every mode. */
static JacobianProduct product_of(const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    return (JacobianProduct){.unknowns = {unknowns, nUnknowns}, .knowns = {knowns, nKnowns}, .seed = seed, .seeds = nSeed, .result = sensitivity,
        .results = nSensitivity, .parameter_phases = PHASES_READABLE};
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[],
    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    const JacobianProduct product = product_of(unknowns, nUnknowns, knowns, nKnowns, seed, nSeed, sensitivity, nSensitivity);
    return said(directional_derivative(instance, "fmi3GetDirectionalDerivative", &product));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[],
    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    const JacobianProduct product = product_of(unknowns, nUnknowns, knowns, nKnowns, seed, nSeed, sensitivity, nSensitivity);
    return said(adjoint_derivative(instance, "fmi3GetAdjointDerivative", &product));
}

/* ---- Model Exchange. ---- */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    return said(change_phase(allowed_type(instance, "fmi3EnterContinuousTimeMode", PHASE_EVENT, MODEL_EXCHANGE), PHASE_CONTINUOUS));
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *enterEventMode,
    fmi3Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    int event = 0;
    const Status status = integrator_step_completed(instance, "fmi3CompletedIntegratorStep", enterEventMode ? terminateSimulation : NULL, &event);
    if (status != STATUS_OK) return fmi3Error;
    *enterEventMode = event != 0;
    *terminateSimulation = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    return said(set_time(instance, "fmi3SetTime", time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    return said(set_states(instance, "fmi3SetContinuousStates", continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t nContinuousStates)
{
    return said(get_rates(instance, "fmi3GetContinuousStateDerivatives", derivatives, nContinuousStates));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
{
    return said(get_indicators(instance, "fmi3GetEventIndicators", eventIndicators, nEventIndicators));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    return said(get_states(instance, "fmi3GetContinuousStates", continuousStates, nContinuousStates));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
{
    return said(get_nominals(instance, "fmi3GetNominalsOfContinuousStates", nominals, nContinuousStates));
}

static fmi3Status size_of(fmi3Instance instance, const char *function, size_t size, size_t *place)
{
    const Instance *self = allowed_type(instance, function, PHASES_ALL, MODEL_EXCHANGE);
    if (!self) return fmi3Error;
    if (!place) return said(FAIL(self, "%s: the place for the number is missing.", function));
    *place = size;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators)
{
    return size_of(instance, "fmi3GetNumberOfEventIndicators", NL, nEventIndicators);
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates)
{
    return size_of(instance, "fmi3GetNumberOfContinuousStates", STATE_COUNT, nContinuousStates);
}

/* ---- Co-Simulation: event mode, early return and intermediate update. ---- */

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    return said(change_phase(allowed_type(instance, "fmi3EnterStepMode", PHASE_EVENT, CO_SIMULATION), PHASE_STEP_COMPLETE));
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, const fmi3Int32 orders[], fmi3Float64 values[],
    size_t nValues)
{
    if (nvr != nValues) return not_offered(instance, "fmi3GetOutputDerivatives", "as many values as value references are needed");
    return said(output_derivatives(instance, "fmi3GetOutputDerivatives", (References){vr, nvr}, orders, values));
}

/* A communication step in progress. */
typedef struct {
    Instance *self;
    double begin;
} Communication;

/* Tentative: within an internal step the importer may only set inputs. */
static void set_inputs(void *context, double offset)
{
    const Communication *step = context;
    Instance *self = step->self;
    fmi3Boolean early = fmi3False;
    fmi3Float64 when = step->begin + offset;
    self->model.phase = PHASE_INPUT_UPDATE;
    ((fmi3IntermediateUpdateCallback)self->update)(self->environment, step->begin + offset, fmi3True, fmi3False, fmi3False, fmi3False, &early, &when);
    self->model.phase = PHASE_STEP_COMPLETE;
}

/* After an internal step the importer may read values, and request an early return. */
static void step_finished(void *context, double offset, double *finish)
{
    const Communication *step = context;
    Instance *self = step->self;
    fmi3Boolean early = fmi3False;
    fmi3Float64 when = step->begin + offset;
    self->model.phase = PHASE_OUTPUT_UPDATE;
    ((fmi3IntermediateUpdateCallback)self->update)(
        self->environment, step->begin + offset, fmi3False, fmi3True, fmi3True, self->early_return_allowed != 0, &early, &when);
    self->model.phase = PHASE_STEP_COMPLETE;
    if (!early || !self->early_return_allowed) return;
    const double wanted = when - step->begin;
    if (wanted < *finish) *finish = wanted > offset ? wanted : offset;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
    fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn,
    fmi3Float64 *lastSuccessfulTime)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    Instance *self = allowed_type(instance, "fmi3DoStep", PHASE_STEP_COMPLETE, CO_SIMULATION);
    if (!self) return fmi3Error;
    if (!eventHandlingNeeded || !terminateSimulation || !earlyReturn || !lastSuccessfulTime)
        return said(FAIL(self, "fmi3DoStep: the place for an answer is missing."));
    Communication step = {self, currentCommunicationPoint};
    const Observer observer = {&step, self->update && self->sets_inputs ? set_inputs : NULL, self->update ? step_finished : NULL};
    double dt = communicationStepSize;
    int event;
    const Status status = do_step(self, "fmi3DoStep", currentCommunicationPoint, &dt, &observer, &event);
    *terminateSimulation = fmi3False; /* the model never ends a simulation */
    *eventHandlingNeeded = event != 0;
    *earlyReturn = status == STATUS_OK && dt < communicationStepSize;
    *lastSuccessfulTime = self->model.time;
    return said(status);
}

#include "fmi3_absent.h"
