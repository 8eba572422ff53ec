/* FMI 2.0 for Co-Simulation. */
#include "fmi2_instance.h"
#include "stepping.h"

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
    *value = fmi2False; /* the model never ends a simulation by itself */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)value;
    return no_status(c, "fmi2GetStringStatus", s);
}
