/* Co-Simulation: the FMU integrates with its own fixed step. Version-free, see instance.h. */
#ifndef STEPPING_H
#define STEPPING_H

#include "access.h"

typedef enum { STEP_OK, STEP_EVENT, STEP_MASS, STEP_NOT_FINITE } StepResult;

/* Callbacks within a communication step, which may be NULL. Offsets are seconds after its
 * beginning. */
typedef struct {
    void *context;
    void (*set_inputs)(void *context, double offset);                    /* may change the Model's u */
    void (*step_finished)(void *context, double offset, double *finish); /* the Model is at `offset`; may shorten the step to *finish */
} Observer;

#include "integrator.h"

/* Relative difference of equal times; importers accumulate their steps. */
#define TIME_TOLERANCE 1e-9

/* More internal steps in one communication step would look like a hang. */
#define MOST_INTERNAL_STEPS 1e9

static inline double same_time(double t, double dt)
{
    return TIME_TOLERANCE * fmax(fabs(t), dt);
}

/* Refuse an invalid step with a logged sentence. */
static inline Status check_step(const Instance *self, const char *function, double t, double dt)
{
    const Model *m = &self->model;
    if (!isfinite(t) || !isfinite(dt)) return FAIL(self, "%s: the time or the step is not a finite number.", function);
    if (dt < 0.0) return FAIL(self, "%s: the step %g s is negative.", function, dt);
    if (fabs(t - m->time) > same_time(m->time, dt))
        return FAIL(self, "%s: the communication point is %.12g s, but the model is at %.12g s.", function, t, m->time);
    if (m->stop_defined && t + dt - m->stop_time > same_time(m->stop_time, dt))
        return FAIL(self, "%s: the step ends at %.12g s, after the stop time %.12g s.", function, t + dt, m->stop_time);
    if (!(dt / m->internal_step <= MOST_INTERNAL_STEPS))
        return FAIL(self, "%s: a step of %g s would take %g internal steps of %g s; choose a larger internal_step.", function, dt, dt / m->internal_step, m->internal_step);
    return STATUS_OK;
}

/* Step from t by *dt, which becomes the elapsed seconds: fewer if a contact changes and early
 * return is allowed, or if the observer ends the step. *event: whether a contact waits for event
 * mode. */
static inline Status do_step(Instance *self, const char *function, double t, double *dt, const Observer *observer, int *event)
{
    *event = 0;
    if (!self || check_step(self, function, t, *dt) != STATUS_OK) return STATUS_ERROR;
    if (*dt == 0.0) return STATUS_OK;
    Model *m = &self->model;
    const double wanted = *dt;
    /* Equal steps that divide dt; the tolerance absorbs a quotient rounded above an integer. */
    const double quotient = ceil(wanted / m->internal_step * (1.0 - TIME_TOLERANCE));
    const StepResult result = model_step(m, t, dt, quotient < 1.0 ? 1 : (long)quotient, self->early_return_allowed, observer);
    if (result == STEP_MASS || result == STEP_NOT_FINITE) {
        m->phase = PHASE_ERROR;
        return FAIL(self, "%s: between %.12g s and %.12g s %s; the state is that of the last good step.", function, t, t + wanted,
            step_trouble(m, result));
    }
    if (result == STEP_EVENT && !self->event_mode_used) model_update_modes(m);
    *event = result == STEP_EVENT && self->event_mode_used;
    return STATUS_OK;
}

/* Set the first time derivatives of inputs for the next step. */
static inline Status set_input_rates(void *instance, const char *function, References of, const int *orders, const double *values)
{
    Instance *self = allowed_type(instance, function, PHASES_STARTING | PHASE_STEP_COMPLETE, CO_SIMULATION);
    if (!self) return STATUS_ERROR;
    if (!INPUTS_SLOPE) return FAIL(self, "%s: inputs are held over a step; derivatives of them are not offered.", function);
    if (of.count > 0 && (!of.references || !orders || !values)) return FAIL(self, "%s: value references, orders or values are missing.", function);
    for (size_t i = 0; i < of.count; i++) {
        const Variable *variable = variable_of(self, function, of.references[i]);
        if (!variable) return STATUS_ERROR;
        if (variable->kind != KIND_INPUT) return FAIL(self, "%s: %s is not an input.", function, variable->name);
        if (orders[i] != 1) return FAIL(self, "%s: order %d was given for %s; only the first derivative is supported.", function, orders[i], variable->name);
        if (!isfinite(values[i])) return FAIL(self, "%s: the derivative given to %s is not a finite number.", function, variable->name);
    }
    for (size_t i = 0; i < of.count; i++) self->model.u_rate[MODEL_VARIABLES[of.references[i]].index] = values[i];
    return STATUS_OK;
}

#endif
