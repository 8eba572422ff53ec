/* FMI 2.0 for Model Exchange. */
#include "exchange.h"
#include "fmi2_instance.h"

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
