/* FMI 3.0 for Co-Simulation: event mode, early return and intermediate update. */
#include "fmi3_instance.h"
#include "stepping.h"

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

/* A communication step on its way. */
typedef struct {
    Instance *self;
    double begin;
} Communication;

/* Tentative: within an internal step the importer may set inputs, nothing else. */
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

/* After an internal step the importer may get values, and ask for an early return. */
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
    *terminateSimulation = fmi3False; /* the model never ends a simulation by itself */
    *eventHandlingNeeded = event != 0;
    *earlyReturn = status == STATUS_OK && dt < communicationStepSize;
    *lastSuccessfulTime = self->model.time;
    return said(status);
}
