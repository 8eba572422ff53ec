/* FMI 2.0: its names and types for the version-free functions of instance.h, access.h,
 * exchange.h and stepping.h. */
#include "fmi2Functions.h"

#include "access.h"
#include "exchange.h"
#include "instance.h"
#include "stepping.h"

/* Static libraries need unique names: FMI2_FUNCTION_PREFIX, which some copies of the standard
 * header ignore. */
#ifdef FMI2_FUNCTION_PREFIX
#undef fmi2FullName
#define PREFIXED_AGAIN(prefix, name) prefix##name
#define PREFIXED(prefix, name) PREFIXED_AGAIN(prefix, name)
#define fmi2FullName(name) PREFIXED(FMI2_FUNCTION_PREFIX, name)
#endif

typedef char same_status_numbers[(int)fmi2OK == (int)STATUS_OK && (int)fmi2Error == (int)STATUS_ERROR ? 1 : -1];

/* The status of a version-free function. */
static inline fmi2Status said(Status status)
{
    return status == STATUS_OK ? fmi2OK : fmi2Error;
}

/* ---- Make an instance, change its states, save and free it. ---- */

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
    (void)visible;
    if (!functions || !functions->logger) return NULL; /* without a logger nothing can be reported */
    Instance draft = {.type = fmuType == fmi2ModelExchange ? MODEL_EXCHANGE : CO_SIMULATION, .log_events = loggingOn};
    draft.logger = (Callback)functions->logger;
    draft.environment = functions->componentEnvironment;
    draft.resources = fmuResourceLocation;
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

/* ---- Get and set variables by value reference; directional derivatives. ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    return said(get_reals(c, "fmi2GetReal", (References){vr, nvr}, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    return said(set_reals(c, "fmi2SetReal", (References){vr, nvr}, value));
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    const Instance *self = readable(c, "fmi2GetInteger", vr, value, nvr);
    if (!self) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = typed_variable(self, "fmi2GetInteger", vr[i], 1);
        if (!variable) return fmi2Error;
        value[i] = (fmi2Integer)model_value(&self->model, variable);
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    Instance *self = writable(c, "fmi2SetInteger", vr, value, nvr);
    if (!self) return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (check_assignment(self, "fmi2SetInteger", vr[i], (double)value[i], 1) != STATUS_OK) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) model_assign(&self->model, &MODEL_VARIABLES[vr[i]], (double)value[i]);
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    (void)vr, (void)value;
    return said(no_variables(c, "fmi2GetBoolean", "Boolean", nvr));
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    (void)vr, (void)value;
    return said(no_variables(c, "fmi2SetBoolean", "Boolean", nvr));
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr, (void)value;
    return said(no_variables(c, "fmi2GetString", "String", nvr));
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr, (void)value;
    return said(no_variables(c, "fmi2SetString", "String", nvr));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
    const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    const JacobianProduct product = {.unknowns = {vUnknown_ref, nUnknown}, .knowns = {vKnown_ref, nKnown}, .seed = dvKnown, .seeds = nKnown,
        .result = dvUnknown, .results = nUnknown, .parameter_phases = PHASE_INITIALIZATION};
    return said(directional_derivative(c, "fmi2GetDirectionalDerivative", &product));
}

/* ---- Model Exchange. ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    return said(change_phase(allowed_type(c, "fmi2EnterEventMode", PHASE_EVENT | PHASE_CONTINUOUS, MODEL_EXCHANGE), PHASE_EVENT));
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo)
{
    Instance *self = allowed_type(c, "fmi2NewDiscreteStates", PHASE_EVENT, MODEL_EXCHANGE);
    if (!self) return fmi2Error;
    if (!eventInfo) return said(FAIL(self, "fmi2NewDiscreteStates: the place for the event information is missing."));
    eventInfo->newDiscreteStatesNeeded = fmi2False;
    eventInfo->terminateSimulation = fmi2False;
    eventInfo->nominalsOfContinuousStatesChanged = fmi2False;
    eventInfo->valuesOfContinuousStatesChanged = fmi2False;
    eventInfo->nextEventTimeDefined = fmi2False;
    eventInfo->nextEventTime = 0.0;
    return said(update_discrete_states(self, "fmi2NewDiscreteStates"));
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return said(change_phase(allowed_type(c, "fmi2EnterContinuousTimeMode", PHASE_EVENT, MODEL_EXCHANGE), PHASE_CONTINUOUS));
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint, fmi2Boolean *enterEventMode,
    fmi2Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    int event = 0;
    const Status status = integrator_step_completed(c, "fmi2CompletedIntegratorStep", enterEventMode ? terminateSimulation : NULL, &event);
    if (status != STATUS_OK) return fmi2Error;
    *enterEventMode = event ? fmi2True : fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    return said(set_time(c, "fmi2SetTime", time));
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    return said(set_states(c, "fmi2SetContinuousStates", x, nx));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    return said(get_rates(c, "fmi2GetDerivatives", derivatives, nx));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    return said(get_indicators(c, "fmi2GetEventIndicators", eventIndicators, ni));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    return said(get_states(c, "fmi2GetContinuousStates", x, nx));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    return said(get_nominals(c, "fmi2GetNominalsOfContinuousStates", x_nominal, nx));
}

/* ---- Co-Simulation. ---- */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[], const fmi2Real value[])
{
    return said(set_input_rates(c, "fmi2SetRealInputDerivatives", (References){vr, nvr}, order, value));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[], fmi2Real value[])
{
    return said(output_derivatives(c, "fmi2GetRealOutputDerivatives", (References){vr, nvr}, order, value));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    const Observer nobody = {NULL, NULL, NULL};
    double dt = communicationStepSize;
    int event;
    return said(do_step(allowed_type(c, "fmi2DoStep", PHASE_STEP_COMPLETE, CO_SIMULATION), "fmi2DoStep", currentCommunicationPoint, &dt, &nobody, &event));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    const Instance *self = c;
    return self ? said(FAIL(self, "fmi2CancelStep: steps are synchronous, there is none to cancel.")) : fmi2Error;
}

#define PHASES_STATUS (PHASE_STEP_COMPLETE | PHASE_TERMINATED | PHASE_ERROR)

static fmi2Status no_status(fmi2Component c, const char *function, fmi2StatusKind kind)
{
    const Instance *self = allowed_type(c, function, PHASES_STATUS, CO_SIMULATION);
    return self ? said(FAIL(self, "%s: the status %d is not available, because steps are synchronous.", function, (int)kind)) : fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)value;
    return no_status(c, "fmi2GetStatus", s);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    if (s != fmi2LastSuccessfulTime) return no_status(c, "fmi2GetRealStatus", s);
    const Instance *self = allowed_type(c, "fmi2GetRealStatus", PHASES_STATUS, CO_SIMULATION);
    if (!self || !value) return fmi2Error;
    *value = self->model.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)value;
    return no_status(c, "fmi2GetIntegerStatus", s);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    if (s != fmi2Terminated) return no_status(c, "fmi2GetBooleanStatus", s);
    if (!allowed_type(c, "fmi2GetBooleanStatus", PHASES_STATUS, CO_SIMULATION) || !value) return fmi2Error;
    *value = fmi2False; /* the model never ends a simulation */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)value;
    return no_status(c, "fmi2GetStringStatus", s);
}
