/* FMI 3.0 for Model Exchange. */
#include "exchange.h"
#include "fmi3_instance.h"

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
