/* FMI 2.0 for Model Exchange: the importer integrates; contact modes are frozen between events and change only in
 * fmi2NewDiscreteStates, where the event indicators (the gaps) have changed their signs. */
#include "fmi2_instance.h"

#define PHASES_STATES (PHASE_INITIALIZATION | PHASE_EVENT | PHASE_CONTINUOUS | PHASE_TERMINATED | PHASE_ERROR)

/* As allowed_type, and an array of the right length must be there. */
static Instance *allowed_array(fmi2Component c, const char *function, int phases, const void *array, size_t given, size_t needed)
{
    Instance *self = allowed_type(c, function, phases, fmi2ModelExchange);
    if (!self) return NULL;
    if (given != needed || (needed > 0 && !array)) {
        FAIL(self, "%s: an array of %lu numbers is needed, but one of %lu was given.", function, (unsigned long)needed, (unsigned long)(array ? given : 0));
        return NULL;
    }
    return self;
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Instance *self = allowed_type(c, "fmi2EnterEventMode", PHASE_EVENT | PHASE_CONTINUOUS, fmi2ModelExchange);
    if (!self) return fmi2Error;
    self->model.phase = PHASE_EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo)
{
    Instance *self = allowed_type(c, "fmi2NewDiscreteStates", PHASE_EVENT, fmi2ModelExchange);
    if (!self) return fmi2Error;
    if (!eventInfo) return FAIL(self, "fmi2NewDiscreteStates: the place for the event information is missing.");
    if (model_update_modes(&self->model) && self->log_events)
        tell(self, fmi2OK, "logEvents", "at t = %.12g s a contact opened or closed.", self->model.time);
    eventInfo->newDiscreteStatesNeeded = fmi2False; /* modes depend on the states alone: one update is enough */
    eventInfo->terminateSimulation = fmi2False;
    eventInfo->nominalsOfContinuousStatesChanged = fmi2False;
    eventInfo->valuesOfContinuousStatesChanged = fmi2False;
    eventInfo->nextEventTimeDefined = fmi2False;
    eventInfo->nextEventTime = 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Instance *self = allowed_type(c, "fmi2EnterContinuousTimeMode", PHASE_EVENT, fmi2ModelExchange);
    if (!self) return fmi2Error;
    self->model.phase = PHASE_CONTINUOUS;
    return fmi2OK;
}

/* Asks for an event where a contact is beyond its hysteresis in the wrong mode: an importer that does not locate the
 * indicators' roots still gets the right modes, one step late. */
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint, fmi2Boolean *enterEventMode,
    fmi2Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    Instance *self = allowed_type(c, "fmi2CompletedIntegratorStep", PHASE_CONTINUOUS, fmi2ModelExchange);
    if (!self) return fmi2Error;
    if (!enterEventMode || !terminateSimulation) return FAIL(self, "fmi2CompletedIntegratorStep: the place for an answer is missing.");
    double phi[ROOM(NC)];
    int wrong = 0;
    scene_penetration(self->model.q, self->model.p, phi);
    for (int i = 0; i < NC; i++) wrong |= contact_mode(i, phi[i], 0.0, self->model.active[i]) != self->model.active[i];
    *enterEventMode = wrong ? fmi2True : fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    Instance *self = allowed_type(c, "fmi2SetTime", PHASE_EVENT | PHASE_CONTINUOUS, fmi2ModelExchange);
    if (!self) return fmi2Error;
    /* A time beyond stopTime is accepted: integrators with an order above one look past the end and interpolate back. */
    if (!isfinite(time)) return FAIL(self, "fmi2SetTime: the time is not a finite number.");
    self->model.time = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    Instance *self = allowed_array(c, "fmi2SetContinuousStates", PHASE_EVENT | PHASE_CONTINUOUS, x, nx, 2 * NQ);
    if (!self) return fmi2Error;
    for (int i = 0; i < 2 * NQ; i++)
        if (!isfinite(x[i])) return FAIL(self, "fmi2SetContinuousStates: state %d is not a finite number at t = %g s.", i, self->model.time);
    memcpy(self->model.q, x, sizeof self->model.q);
    memcpy(self->model.v, x + NQ, sizeof self->model.v);
    self->model.evaluated = 0;
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    Instance *self = allowed_array(c, "fmi2GetDerivatives", PHASES_STATES, derivatives, nx, 2 * NQ);
    if (!self || evaluated(self) != fmi2OK) return fmi2Error;
    memcpy(derivatives, self->model.v, sizeof self->model.v);
    memcpy(derivatives + NQ, self->model.a, sizeof self->model.a);
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    Instance *self = allowed_array(c, "fmi2GetEventIndicators", PHASES_STATES, eventIndicators, ni, NC);
    if (!self) return fmi2Error;
    double phi[ROOM(NC)];
    scene_penetration(self->model.q, self->model.p, phi);
    for (int i = 0; i < NC; i++) eventIndicators[i] = -phi[i];
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    Instance *self = allowed_array(c, "fmi2GetContinuousStates", PHASES_STATES, x, nx, 2 * NQ);
    if (!self) return fmi2Error;
    memcpy(x, self->model.q, sizeof self->model.q);
    memcpy(x + NQ, self->model.v, sizeof self->model.v);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    Instance *self = allowed_array(c, "fmi2GetNominalsOfContinuousStates", PHASE_INSTANTIATED | PHASES_STATES, x_nominal, nx, 2 * NQ);
    if (!self) return fmi2Error;
    memcpy(x_nominal, STATE_NOMINALS, sizeof STATE_NOMINALS);
    return fmi2OK;
}
