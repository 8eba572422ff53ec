/* FMI 2.0 for Co-Simulation: the FMU integrates with its own fixed step and the true contact law. */
#include "fmi2_instance.h"
#include "integrator.h"

/* Two times are the same if they differ by less than this share: importers add up their steps. */
#define TIME_TOLERANCE 1e-9

/* More internal steps than this in one communication step would look like a hang. */
#define MOST_INTERNAL_STEPS 1e9

static double same_time(double t, double dt)
{
    return TIME_TOLERANCE * fmax(fabs(t), dt);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[], const fmi2Real value[])
{
    const char *function = "fmi2SetRealInputDerivatives";
    Instance *self = allowed_type(c, function, PHASE_INSTANTIATED | PHASE_INITIALIZATION | PHASE_STEP_COMPLETE, fmi2CoSimulation);
    if (!self) return fmi2Error;
    if (nvr > 0 && (!vr || !order || !value)) return FAIL(self, "%s: value references, orders or values are missing.", function);
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = variable_of(self, function, vr[i]);
        if (!variable) return fmi2Error;
        if (variable->kind != KIND_INPUT) return FAIL(self, "%s: %s is not an input.", function, variable->name);
        if (order[i] != 1) return FAIL(self, "%s: order %d was given for %s; only the first derivative is supported.", function, order[i], variable->name);
        if (!isfinite(value[i])) return FAIL(self, "%s: the derivative given to %s is not a finite number.", function, variable->name);
    }
    for (size_t i = 0; i < nvr; i++) self->model.u_rate[MODEL_VARIABLES[vr[i]].index] = value[i];
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[], fmi2Real value[])
{
    const char *function = "fmi2GetRealOutputDerivatives";
    Instance *self = allowed_type(c, function, PHASE_STEP_COMPLETE | PHASE_TERMINATED | PHASE_ERROR, fmi2CoSimulation);
    if (!self) return fmi2Error;
    if (nvr > 0 && (!vr || !order || !value)) return FAIL(self, "%s: value references, orders or the place for the values are missing.", function);
    if (nvr > 0 && evaluated(self) != fmi2OK) return fmi2Error;
    Tangent tangent; /* the direction in which time moves everything; held inputs do not move */
    memset(&tangent, 0, sizeof tangent);
    memcpy(tangent.q, self->model.v, sizeof tangent.q);
    memcpy(tangent.v, self->model.a, sizeof tangent.v);
    if (model_tangent(&self->model, &tangent)) return FAIL(self, "%s: the mass matrix is not positive definite.", function);
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = variable_of(self, function, vr[i]);
        if (!variable) return fmi2Error;
        if (order[i] != 1) return FAIL(self, "%s: order %d was asked of %s; only the first derivative is supported.", function, order[i], variable->name);
        value[i] = model_value_tangent(&self->model, &tangent, variable);
    }
    return fmi2OK;
}

/* Refuse a step that cannot be meant: a sentence is logged. */
static fmi2Status check_step(const Instance *self, double t, double dt)
{
    const Model *m = &self->model;
    if (!isfinite(t) || !isfinite(dt)) return FAIL(self, "fmi2DoStep: the time or the step is not a finite number.");
    if (dt < 0.0) return FAIL(self, "fmi2DoStep: the step %g s is negative.", dt);
    if (fabs(t - m->time) > same_time(m->time, dt))
        return FAIL(self, "fmi2DoStep: the communication point is %.12g s, but the model is at %.12g s.", t, m->time);
    if (m->stop_defined && t + dt - m->stop_time > same_time(m->stop_time, dt))
        return FAIL(self, "fmi2DoStep: the step ends at %.12g s, after the stop time %.12g s.", t + dt, m->stop_time);
    if (!(dt / m->internal_step <= MOST_INTERNAL_STEPS))
        return FAIL(self, "fmi2DoStep: a step of %g s would take %g internal steps of %g s; choose a larger internal_step.", dt, dt / m->internal_step, m->internal_step);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    Instance *self = allowed_type(c, "fmi2DoStep", PHASE_STEP_COMPLETE, fmi2CoSimulation);
    if (!self || check_step(self, currentCommunicationPoint, communicationStepSize) != fmi2OK) return fmi2Error;
    const double dt = communicationStepSize;
    if (dt == 0.0) return fmi2OK;
    /* Equal steps that divide dt; the share forgives a quotient that rounding lifts above a whole number. */
    const double quotient = ceil(dt / self->model.internal_step * (1.0 - TIME_TOLERANCE));
    const StepResult result = model_step(&self->model, dt, quotient < 1.0 ? 1 : (long)quotient);
    if (result != STEP_OK) {
        self->model.phase = PHASE_ERROR;
        return FAIL(self, "fmi2DoStep: between %.12g s and %.12g s %s; the state is that of the last good step.", currentCommunicationPoint,
            currentCommunicationPoint + dt, result == STEP_MASS ? "the mass matrix lost its definiteness" : "a state became infinite or not a number (internal_step too large?)");
    }
    self->model.time = currentCommunicationPoint + dt;
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    const Instance *self = c;
    return self ? FAIL(self, "fmi2CancelStep: steps are synchronous, there is none to cancel.") : fmi2Error;
}

#define PHASES_STATUS (PHASE_STEP_COMPLETE | PHASE_TERMINATED | PHASE_ERROR)

static fmi2Status no_status(fmi2Component c, const char *function, fmi2StatusKind kind)
{
    const Instance *self = allowed_type(c, function, PHASES_STATUS, fmi2CoSimulation);
    return self ? FAIL(self, "%s: the status %d is not available, because steps are synchronous.", function, (int)kind) : fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)value;
    return no_status(c, "fmi2GetStatus", s);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    if (s != fmi2LastSuccessfulTime) return no_status(c, "fmi2GetRealStatus", s);
    const Instance *self = allowed_type(c, "fmi2GetRealStatus", PHASES_STATUS, fmi2CoSimulation);
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
    if (!allowed_type(c, "fmi2GetBooleanStatus", PHASES_STATUS, fmi2CoSimulation) || !value) return fmi2Error;
    *value = fmi2False; /* the model never ends a simulation by itself */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)value;
    return no_status(c, "fmi2GetStringStatus", s);
}
